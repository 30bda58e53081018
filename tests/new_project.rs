//! `tectum new`: every kind of project builds, passes its own tests and runs; wrong names and folders are refused.

mod support;

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Duration;

use support::{TECTUM, TestFolder};

/// Building the library for a project takes minutes on a busy machine.
const BUILD_LIMIT: Duration = Duration::from_secs(1800);

/// The folder of the programs under test.
fn programs() -> &'static Path {
    Path::new(TECTUM).parent().unwrap()
}

/// Makes a project and returns its folder. Its name differs from those of the other tests, with which it shares a
/// target folder.
fn new_project(test_folder: &tectum_testkit::TestFolder, kind: &str, language: &str) -> PathBuf {
    let name = format!("mine-{kind}");
    let made = test_folder.tectum("new", &[kind, &name, "--lang", language, "--json"]).expect(0).json();
    assert_eq!((made["kind"].as_str(), made["language"].as_str()), (Some(kind), Some(language)), "{made}");
    assert_eq!(made["tectum"]["path"], env!("CARGO_MANIFEST_DIR"), "{made}");
    test_folder.path().join(made["folder"].as_str().unwrap())
}

/// A command in a project's folder that finds the programs under test, without what cargo tells the tests of this
/// package.
fn command_in(project: &Path, program: impl AsRef<Path>, arguments: &[&str]) -> Command {
    let mut command = Command::new(program.as_ref());
    for (name, _) in std::env::vars_os() {
        let name = name.to_string_lossy();
        if name.starts_with("CARGO_") && name != "CARGO_HOME" {
            command.env_remove(&*name);
        }
    }
    command.args(arguments).current_dir(project).env("TECTUM_BIN", programs());
    command
}

/// Runs the tests of a new project in Rust, then its scenario, each as its README says. Dependencies are those of this
/// package, in the target folder of this test.
fn check_rust(kind: &str) {
    let test_folder = tectum_testkit::TestFolder::new().with_watchdog(BUILD_LIMIT);
    let project = new_project(&test_folder, kind, "rust");
    fs::copy("Cargo.lock", project.join("Cargo.lock")).unwrap();
    let cargo = std::env::var_os("CARGO").map_or_else(|| PathBuf::from("cargo"), PathBuf::from);
    let run_cargo = |arguments: &[&str]| {
        let mut command = command_in(&project, &cargo, arguments);
        command.env("CARGO_TARGET_DIR", programs().parent().unwrap());
        test_folder.start_command(command).wait().expect(0);
    };
    run_cargo(&["fmt", "--check", "--", "--config", "max_width=100,use_small_heuristics=Default"]);
    run_cargo(&["test", "--offline"]);
    let name = project.file_name().unwrap();
    fs::create_dir_all(project.join("target/release")).unwrap();
    std::os::unix::fs::symlink(programs().join(name), project.join("target/release").join(name)).unwrap();
    run_scenario(&test_folder, &project);
    // The project is gone after this test, and with the next one everything of it is built again.
    run_cargo(&["clean", "--offline", "--package", name.to_str().unwrap()]);
}

/// Runs the tests of a new project in Python, then its scenario, as its README says.
fn check_python(kind: &str) {
    let python = PathBuf::from(std::env::var_os("TECTUM_PYTHON").expect("TECTUM_PYTHON names the interpreter"));
    let test_folder = tectum_testkit::TestFolder::new();
    let project = new_project(&test_folder, kind, "python");
    test_folder.start_command(command_in(&project, &python, &["-m", "unittest"])).wait().expect(0);
    run_scenario(&test_folder, &project);
}

fn run_scenario(test_folder: &tectum_testkit::TestFolder, project: &Path) {
    let mut command = command_in(project, TECTUM, &["run", "scenario.toml", "--ticks", "2000", "--json"]);
    // As in an activated virtual environment.
    let python = std::env::var_os("TECTUM_PYTHON").map(PathBuf::from);
    let python = python.as_deref().and_then(Path::parent).map(Path::to_owned);
    let path = std::env::var_os("PATH").unwrap_or_default();
    command.env("PATH", std::env::join_paths(python.into_iter().chain(std::env::split_paths(&path))).unwrap());
    let summary = test_folder.start_command(command).wait().expect(0).json();
    assert_eq!((summary["ended"].as_str(), summary["ticks"].as_u64()), (Some("complete"), Some(2000)), "{summary}");
}

#[test]
#[ignore = "builds the library once more, for a project outside the workspace, which takes minutes"]
fn a_new_plant_in_rust_builds_and_runs() {
    check_rust("plant");
}

#[test]
#[ignore = "builds the library once more, for a project outside the workspace, which takes minutes"]
fn a_new_controller_in_rust_builds_and_runs() {
    check_rust("controller");
}

#[test]
#[ignore = "needs a Python with the package of python/, named by TECTUM_PYTHON"]
fn a_new_plant_in_python_runs() {
    check_python("plant");
}

#[test]
#[ignore = "needs a Python with the package of python/, named by TECTUM_PYTHON"]
fn a_new_controller_in_python_runs() {
    check_python("controller");
}

#[test]
fn the_text_says_what_was_made_and_what_comes_next() {
    let test_folder = TestFolder::new();
    let text = test_folder.tectum("new", &["plant", "my-arm"]).expect(0).stdout;
    let checkout = env!("CARGO_MANIFEST_DIR");
    let first = format!("my-arm: a plant in Rust, 6 files. It refers to Tectum by path, in the checkout {checkout}.\n");
    let run = format!("cargo build --release && {TECTUM} run scenario.toml");
    assert_eq!(text, format!("{first}Next:\n  cd my-arm\n  cargo test\n  {run}\n"));
}

#[test]
fn what_exists_is_kept_and_what_cannot_be_is_refused() {
    let test_folder = TestFolder::new();
    test_folder.tectum("new", &["plant", "mine"]).expect(0);
    let file = test_folder.path().join("mine/src/lib.rs");
    fs::write(&file, "mine").unwrap();
    let refusal = test_folder.refused("new", &["controller", "mine"]);
    assert_eq!(refusal, "tectum: mine exists already; give another name, or move it away");
    assert_eq!(fs::read_to_string(&file).unwrap(), "mine");
    let refusal = test_folder.refused("new", &["plant", "../other"]);
    assert!(refusal.starts_with("tectum: \"../other\" cannot be the name of a project: give a name"), "{refusal}");
    assert_eq!(fs::read_dir(test_folder.path()).unwrap().count(), 1, "nothing else was made");
}
