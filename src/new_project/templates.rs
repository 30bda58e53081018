//! The files of each kind of project, and what is filled in.

use super::{ProjectKind, ProjectLanguage, TectumSource, name};

/// A file of a project.
pub(super) struct TemplateFile {
    /// Where it goes, in the project's folder.
    pub path: &'static str,
    /// Its text, with placeholders.
    pub text: &'static str,
}

/// The template `templates/$folder/$file.in`.
macro_rules! template {
    ($folder:literal, $path:literal, $file:literal) => {
        TemplateFile { path: $path, text: include_str!(concat!("templates/", $folder, "/", $file, ".in")) }
    };
}

const RUST_PLANT: &[TemplateFile] = &[
    template!("rust_plant", "Cargo.toml", "Cargo.toml"),
    template!("rust_plant", "README.md", "README.md"),
    template!("rust_plant", "scenario.toml", "scenario.toml"),
    template!("rust_plant", "src/lib.rs", "lib.rs"),
    template!("rust_plant", "src/main.rs", "main.rs"),
    template!("rust_plant", "tests/run.rs", "run.rs"),
];

const RUST_CONTROLLER: &[TemplateFile] = &[
    template!("rust_controller", "Cargo.toml", "Cargo.toml"),
    template!("rust_controller", "README.md", "README.md"),
    template!("rust_controller", "scenario.toml", "scenario.toml"),
    template!("rust_controller", "src/lib.rs", "lib.rs"),
    template!("rust_controller", "src/main.rs", "main.rs"),
    template!("rust_controller", "tests/run.rs", "run.rs"),
];

const PYTHON_PLANT: &[TemplateFile] = &[
    template!("python_plant", "README.md", "README.md"),
    template!("python_plant", "scenario.toml", "scenario.toml"),
    template!("python_plant", "plant.py", "plant.py"),
    template!("python_plant", "test_plant.py", "test_plant.py"),
];

const PYTHON_CONTROLLER: &[TemplateFile] = &[
    template!("python_controller", "README.md", "README.md"),
    template!("python_controller", "scenario.toml", "scenario.toml"),
    template!("python_controller", "controller.py", "controller.py"),
    template!("python_controller", "test_controller.py", "test_controller.py"),
];

/// The files of a project.
pub(super) fn files(kind: ProjectKind, language: ProjectLanguage) -> &'static [TemplateFile] {
    match (language, kind) {
        (ProjectLanguage::Rust, ProjectKind::Plant) => RUST_PLANT,
        (ProjectLanguage::Rust, ProjectKind::Controller) => RUST_CONTROLLER,
        (ProjectLanguage::Python, ProjectKind::Plant) => PYTHON_PLANT,
        (ProjectLanguage::Python, ProjectKind::Controller) => PYTHON_CONTROLLER,
    }
}

/// A template's text with everything filled in.
pub(super) fn fill(text: &str, name: &str, tectum: &TectumSource) -> String {
    let dependency = |folder: &str| match tectum {
        TectumSource::Path(path) => format!("{{ path = {:?} }}", path.join(folder)),
        TectumSource::Version(version) => format!("{version:?}"),
    };
    text.replace("{{name}}", name)
        .replace("{{crate}}", &name::crate_name(name))
        .replace("{{tectum}}", &dependency(""))
        .replace("{{testkit}}", &dependency("crates/tectum-testkit"))
        .replace("{{pip}}", &python_package(tectum))
        .replace("{{programs}}", &install_command(tectum))
}

/// What `pip install` is given.
fn python_package(tectum: &TectumSource) -> String {
    match tectum {
        TectumSource::Path(path) => path.join("python").display().to_string(),
        TectumSource::Version(version) => format!("tectum=={version}"),
    }
}

/// The command that installs Tectum's programs.
fn install_command(tectum: &TectumSource) -> String {
    match tectum {
        TectumSource::Path(path) => format!("cargo install --locked --path {}", path.display()),
        TectumSource::Version(version) => format!("cargo install --locked tectum@{version}"),
    }
}

/// The commands that test and run a project.
pub(super) fn next_commands(
    name: &str,
    language: ProjectLanguage,
    tectum: &TectumSource,
    program: &str,
) -> Vec<String> {
    let (enter, run) = (format!("cd {name}"), format!("{program} run scenario.toml"));
    match language {
        ProjectLanguage::Rust => {
            vec![enter, "cargo test".to_owned(), format!("cargo build --release && {run}")]
        }
        ProjectLanguage::Python => vec![
            enter,
            format!("python3 -m venv .venv && . .venv/bin/activate && pip install {}", python_package(tectum)),
            "python -m unittest".to_owned(),
            run,
        ],
    }
}
