//! Who may take a place in a run: processes started by hand, other plants, and those that do not fit.

mod support;

use support::{Place, TECTUM, assert_no_debris, example};

fn program(name: &str) -> std::path::PathBuf {
    std::path::Path::new(TECTUM).with_file_name(name)
}

/// A scenario for the example plant.
fn point(place: &Place) -> String {
    let text = std::fs::read_to_string("examples/point.toml").unwrap();
    let program = example("point");
    let text = text.replace("target/release/examples/point", program.to_str().unwrap());
    place.file("point.toml", text).to_str().unwrap().to_owned()
}

#[test]
fn another_plant_takes_the_simulators_place() {
    let place = Place::new();
    let summary = place.run(&[&point(&place), "--ticks", "60000", "--json"]).wait().expect(0).json();
    assert_no_debris(&place.run_folder());
    assert_eq!(summary["ticks"], 60000);
    let error = |span: &str| summary[span]["end_error_m"].as_f64().unwrap();
    assert!(error("last") < 0.6 * error("first"), "the point learns to follow: {summary}");
}

#[test]
fn every_process_can_be_started_by_hand() {
    for (role, name) in
        [("plant", "tectum-simulator"), ("controller", "tectum-controller"), ("logger", "tectum-logger")]
    {
        let place = Place::new();
        let mut run = place.start(TECTUM, &["run", "--name", "demo", "--by-hand", role, "--ticks", "500", "--json"]);
        let manifest = place.path().join("runs/demo/run.json");
        run.until("the run's manifest", || manifest.exists());
        let member = place.start(program(name), &["--run", "demo", "--json"]);
        let account = member.wait().expect(0).json();
        let outcome = run.wait().expect(0);
        assert!(outcome.stderr.contains(&format!("waiting for the {role}: {name} --run runs/demo")), "{outcome:#?}");
        assert_eq!(outcome.json()["ticks"], 500);
        assert_eq!(outcome.json()["lost"], 0);
        if role != "logger" {
            assert_eq!(account["ticks"], 500);
        }
        assert_no_debris(&place.path().join("runs/demo"));
    }
}

#[test]
fn a_process_with_another_scenario_is_refused_in_one_sentence() {
    let place = Place::new();
    let other = place.arm(&[("beta", "0.8")]);
    let mut run = place.start(TECTUM, &["run", "--name", "demo", "--by-hand", "controller", "--ticks", "500"]);
    let manifest = place.path().join("runs/demo/run.json");
    run.until("the run's manifest", || manifest.exists());
    let stranger = ["--run", "demo", "--scenario", &other];
    let outcome = place.start(program("tectum-controller"), &stranger).wait().expect(3);
    assert_eq!(outcome.stderr.lines().count(), 1, "{outcome:#?}");
    assert!(
        outcome.stderr.starts_with("tectum-controller: the controller does not fit the run: its scenario is "),
        "{outcome:#?}"
    );
    // The run still waits, for one that fits.
    place.start(program("tectum-controller"), &["--run", "demo"]).wait().expect(0);
    run.wait().expect(0);
}

#[test]
fn a_role_is_taken_once() {
    let place = Place::new();
    let mut run = place.start(TECTUM, &["run", "--name", "demo", "--mode", "realtime", "--ticks", "100000"]);
    let log = place.path().join("runs/demo/log.mcap");
    run.until("the log", || log.exists());
    let outcome = place.start(program("tectum-controller"), &["--run", "demo"]).wait().expect(1);
    assert!(outcome.stderr.contains("another process already has this role in the run"), "{outcome:#?}");
    run.signal("INT");
    run.wait().expect(130);
    assert_no_debris(&place.path().join("runs/demo"));
}

#[test]
fn a_run_that_is_not_there_is_said_so() {
    let place = Place::new();
    let outcome = place.start(program("tectum-logger"), &["--run", "nowhere"]).wait().expect(2);
    assert!(outcome.stderr.starts_with("tectum-logger: there is no run at nowhere: "), "{outcome:#?}");
    // A run that is over keeps its manifest.
    place.run(&["--ticks", "10"]).wait().expect(0);
    let outcome = place.start(program("tectum-logger"), &["--run", "run"]).wait().expect(2);
    assert!(outcome.stderr.contains("the run is over"), "{outcome:#?}");
}
