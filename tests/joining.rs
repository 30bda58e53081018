//! Which processes may join a run: processes started by hand, other plants, and processes that do not fit the run.

mod support;

use support::{TECTUM, TestFolder, assert_no_debris, example};

/// The path of a program beside `tectum`.
fn program(name: &str) -> std::path::PathBuf {
    std::path::Path::new(TECTUM).with_file_name(name)
}

/// A scenario for the example plant.
fn point(test_folder: &TestFolder) -> String {
    let text = std::fs::read_to_string("examples/point.toml").unwrap();
    let program = example("point");
    let text = text.replace("target/release/examples/point", program.to_str().unwrap());
    test_folder.write_file("point.toml", text).to_str().unwrap().to_owned()
}

#[test]
fn another_plant_program_replaces_the_simulator() {
    let test_folder = TestFolder::new();
    let summary = test_folder.run(&[&point(&test_folder), "--ticks", "60000", "--json"]).wait().expect(0).json();
    assert_no_debris(&test_folder.run_folder());
    assert_eq!(summary["ticks"], 60000);
    let error = |span: &str| summary[span]["end_error_m"].as_f64().unwrap();
    assert!(error("last") < 0.6 * error("first"), "the point learns to follow: {summary}");
}

#[test]
fn a_controller_that_is_not_the_scenarios_is_refused() {
    let test_folder = TestFolder::new();
    let own = point(&test_folder).replace("point.toml", "own.toml");
    let text = std::fs::read_to_string(point(&test_folder)).unwrap();
    std::fs::write(&own, text.replacen("[encoder]", "[controller]\nprogram = \"./own\"\n\n[encoder]", 1)).unwrap();
    let mut run = test_folder.start(TECTUM, &["run", "--name", "demo", &own, "--by-hand", "controller"]);
    let manifest = test_folder.path().join("runs/demo/run.json");
    run.wait_until("the run's manifest", || manifest.exists());
    let message = test_folder.start(program("tectum-controller"), &["--run", "demo"]).wait().expect(2).stderr;
    assert!(
        message.contains("controller.program is \"./own\", and this is tectum-controller; start that"),
        "{message}"
    );
}

#[test]
fn every_process_can_be_started_by_hand() {
    for (role, name) in
        [("plant", "tectum-simulator"), ("controller", "tectum-controller"), ("logger", "tectum-logger")]
    {
        let test_folder = TestFolder::new();
        let mut run =
            test_folder.start(TECTUM, &["run", "--name", "demo", "--by-hand", role, "--ticks", "500", "--json"]);
        let manifest = test_folder.path().join("runs/demo/run.json");
        run.wait_until("the run's manifest", || manifest.exists());
        let process = test_folder.start(program(name), &["--run", "demo", "--json"]);
        let report = process.wait().expect(0).json();
        let outcome = run.wait().expect(0);
        assert!(outcome.stderr.contains(&format!("waiting for the {role}: {name} --run runs/demo")), "{outcome:#?}");
        assert_eq!(outcome.json()["ticks"], 500);
        assert_eq!(outcome.json()["lost"], 0);
        if role != "logger" {
            assert_eq!(report["ticks"], 500);
        }
        assert_no_debris(&test_folder.path().join("runs/demo"));
    }
}

#[test]
fn a_process_with_another_scenario_is_refused_in_one_sentence() {
    let test_folder = TestFolder::new();
    let other = test_folder.arm_scenario(&[("beta", "0.8")]);
    let mut run = test_folder.start(TECTUM, &["run", "--name", "demo", "--by-hand", "controller", "--ticks", "500"]);
    let manifest = test_folder.path().join("runs/demo/run.json");
    run.wait_until("the run's manifest", || manifest.exists());
    let arguments = ["--run", "demo", "--scenario", &other];
    let outcome = test_folder.start(program("tectum-controller"), &arguments).wait().expect(3);
    assert_eq!(outcome.stderr.lines().count(), 1, "{outcome:#?}");
    assert!(
        outcome.stderr.starts_with("tectum-controller: the controller does not fit the run: its scenario is "),
        "{outcome:#?}"
    );
    // The run still waits for a controller that fits.
    test_folder.start(program("tectum-controller"), &["--run", "demo"]).wait().expect(0);
    run.wait().expect(0);
}

#[test]
fn a_role_can_be_taken_only_once() {
    let test_folder = TestFolder::new();
    let mut run = test_folder.start(TECTUM, &["run", "--name", "demo", "--mode", "realtime", "--ticks", "100000"]);
    let log = test_folder.path().join("runs/demo/log.mcap");
    run.wait_until("the log", || log.exists());
    let outcome = test_folder.start(program("tectum-controller"), &["--run", "demo"]).wait().expect(1);
    assert!(outcome.stderr.contains("another process already has this role in the run"), "{outcome:#?}");
    run.signal("INT");
    run.wait().expect(130);
    assert_no_debris(&test_folder.path().join("runs/demo"));
}

#[test]
fn joining_a_missing_or_finished_run_is_refused() {
    let test_folder = TestFolder::new();
    let outcome = test_folder.start(program("tectum-logger"), &["--run", "nowhere"]).wait().expect(2);
    assert!(outcome.stderr.starts_with("tectum-logger: there is no run at nowhere: "), "{outcome:#?}");
    // A finished run keeps its manifest.
    test_folder.run(&["--ticks", "10"]).wait().expect(0);
    let outcome = test_folder.start(program("tectum-logger"), &["--run", "run"]).wait().expect(2);
    assert!(outcome.stderr.contains("the run is over"), "{outcome:#?}");
}
