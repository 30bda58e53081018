//! The Python package `tectum` in real runs: controllers, environments of Gymnasium, launching, logs. The tests are
//! ignored by default, because they need a Python with the package and those of `tests/python/requirements.txt`.
//! `.ci/run` installs these and runs the tests:
//!
//! ```text
//! TECTUM_PYTHON=path/to/python cargo test --locked --test python_package -- --ignored
//! ```

mod support;

use serde_json::{Value, json};
use support::python::{programs, python, scenario, script};
use support::{Process, TECTUM, TestFolder, assert_no_debris, children, signal_process};

/// Starts a script of `tests/python` that launches runs.
fn start(test_folder: &TestFolder, name: &str, arguments: &[&str]) -> Process {
    let (variable, python, script) = (format!("TECTUM_BIN={}", programs()), python(), script(name));
    test_folder.start("/usr/bin/env", &[&[variable.as_str(), &python, &script], arguments].concat())
}

#[test]
#[ignore = "needs a Python with the packages of tests/python/requirements.txt, named by TECTUM_PYTHON"]
fn what_needs_no_run_passes_its_own_tests() {
    let test_folder = TestFolder::new();
    let outcome = start(&test_folder, "unit.py", &[]).wait().expect(0);
    assert!(outcome.stderr.contains("\nOK"), "{outcome:#?}");
}

#[test]
#[ignore = "needs a Python with the packages of tests/python/requirements.txt, named by TECTUM_PYTHON"]
fn a_log_reads_as_the_columns_of_its_csv() {
    let test_folder = TestFolder::new();
    let scenario = test_folder.arm_scenario(&[("every", "1")]);
    test_folder.run(&[&scenario, "--ticks", "500"]).wait().expect(0);
    let read = start(&test_folder, "check_read_log.py", &["run", TECTUM]).wait().expect(0).json();
    for (channel, columns) in [("observation", 24), ("command", 17), ("learning", 18)] {
        let compared = &read["compared"][channel];
        assert_eq!((&compared["rows"], &compared["wrong"]), (&json!(500), &json!([])), "{read}");
        assert_eq!(compared["columns"], columns, "{read}");
    }
    assert_eq!((&read["complete"], &read["inputs"][2]), (&json!(true), &json!("theta_1 (rad)")), "{read}");
}

/// Kills the Python process whose script is `name` whenever the run has gone on for some ticks, `times` times.
fn kill(run: &mut Process, name: &str, times: usize) {
    let find = |launcher| children(launcher).into_iter().find(|(pid, _)| command_line(*pid).contains(name));
    let mut previous = 0;
    for _ in 0..times {
        let id = run.id();
        run.wait_until("a process to kill", || find(id).is_some_and(|(pid, _)| pid != previous));
        run.wait_until_ticking();
        previous = find(id).map_or(0, |(pid, _)| pid);
        signal_process(previous, "KILL");
    }
    let id = run.id();
    run.wait_until("the last restart", || find(id).is_some_and(|(pid, _)| pid != previous));
}

fn command_line(pid: u32) -> String {
    let bytes = std::fs::read(format!("/proc/{pid}/cmdline")).unwrap_or_default();
    String::from_utf8_lossy(&bytes).replace('\0', " ")
}

/// The rows of a channel in the run's log, without the start numbers of its writers.
fn rows(test_folder: &TestFolder, channel: &str) -> String {
    let csv = test_folder.start(TECTUM, &["log", "csv", "run", "--channel", channel]).wait().expect(0).stdout;
    let column = csv.lines().next().unwrap().split(',').position(|name| name == "incarnation").unwrap();
    let mut rows = String::new();
    for line in csv.lines() {
        let fields: Vec<_> =
            line.split(',').enumerate().filter(|(i, _)| *i != column).map(|(_, field)| field).collect();
        rows += &(fields.join(",") + "\n");
    }
    rows
}

/// Plant and controller in Python: whichever is killed, the numbers stay the same, and no tick is learned from twice.
#[test]
#[ignore = "needs a Python with the packages of examples/python/requirements.txt, named by TECTUM_PYTHON"]
fn a_controller_and_a_plant_in_python_come_back_as_they_were() {
    let run = |killed: Option<&str>| {
        let test_folder = TestFolder::new();
        let scenario = scenario(&test_folder, "controller.toml", &[("ticks = 4_000", "ticks = 6_000")], "");
        let mut run = test_folder.run(&[&scenario, "--json"]);
        if let Some(name) = killed {
            kill(&mut run, name, 2);
        }
        let summary = run.wait().expect(0).json();
        assert_no_debris(&test_folder.run_folder());
        let restarts = summary["restarts"].as_array().unwrap().len();
        assert_eq!(restarts, killed.map_or(0, |_| 2), "{summary}");
        (summary["weights_hash"].clone(), ["observation", "command", "learning"].map(|name| rows(&test_folder, name)))
    };
    let (whole, controller, plant) = (run(None), run(Some("controller.py")), run(Some("plant.py")));
    assert_eq!(whole, controller);
    assert_eq!(whole, plant);
}

#[test]
#[ignore = "needs a Python with the packages of examples/python/requirements.txt, named by TECTUM_PYTHON"]
fn a_controller_in_python_comes_back_in_real_time() {
    let test_folder = TestFolder::new();
    let scenario = scenario(&test_folder, "controller.toml", &[("ticks = 4_000", "ticks = 100_000")], "");
    let mut run = test_folder.run(&[&scenario, "--mode", "realtime", "--json"]);
    kill(&mut run, "controller.py", 1);
    run.wait_until_ticking();
    run.signal("INT");
    let summary = run.wait().expect(130).json();
    assert_no_debris(&test_folder.run_folder());
    assert_eq!(summary["restarts"][0]["process"], "controller", "{summary}");
    assert_eq!(summary["lost"], 0, "{summary}");
    assert!(summary["missed"].as_u64().unwrap() > 0, "{summary}");
}

#[test]
#[ignore = "needs a Python with the packages of tests/python/requirements.txt, named by TECTUM_PYTHON"]
fn runs_are_launched_viewed_and_stopped_from_python() {
    let test_folder = TestFolder::new();
    let done = start(&test_folder, "launch.py", &[]).wait().expect(0).json();
    for (key, expected) in
        [("ticks", json!(500)), ("logged", json!(500)), ("same", json!(true)), ("rising", json!(true))]
    {
        assert_eq!(done[key], expected, "{done}");
    }
    assert_eq!(done["ended"][0], 130, "{done}");
    let said: Vec<_> = done["mistakes"].as_array().unwrap().iter().map(Value::to_string).collect();
    for (said, expected) in
        said.iter().zip(["no-such-scenario", "it holds a run already", "--what", "there is no log in"])
    {
        assert!(said.starts_with("[2,") && said.contains(expected), "{said}");
    }
    assert_eq!(said.len(), 4);
}

#[test]
#[ignore = "needs a Python with the packages of examples/python/requirements.txt, named by TECTUM_PYTHON"]
fn a_run_is_an_environment_that_gymnasiums_checker_accepts() {
    let test_folder = TestFolder::new();
    let done = start(&test_folder, "gym_env.py", &["arm", "150", "lockstep"]).wait().expect(0).json();
    assert_eq!(
        (&done["checked"], &done["same"], &done["other"]),
        (&json!(true), &json!(true), &json!(false)),
        "{done}"
    );
    // Every tick but a run's first is learned from; episodes end with a target, after 80 ticks, and with the run.
    assert_eq!(done["reasons"], json!({ "None": 300 }), "{done}");
    assert!(done["ends"].as_u64().unwrap() >= 4, "{done}");
    assert_eq!(done["lost"], 0, "{done}");
    let mistakes = done["mistakes"].to_string();
    assert!(mistakes.contains("has 9 numbers; the plant has 4") && mistakes.contains("not finite"), "{done}");
}

/// Emulated servos at their own period, with the gate and the safety machine behind the environment.
#[test]
#[ignore = "needs a Python with the packages of examples/python/requirements.txt, named by TECTUM_PYTHON"]
fn servos_are_an_environment_in_real_time() {
    let test_folder = TestFolder::new();
    let done = start(&test_folder, "gym_env.py", &["servo-emulated", "40", "realtime"]).wait().expect(0).json();
    assert_eq!(done["lost"], 0, "{done}");
    // Each step is a tick, or has passed over some.
    let steps: u64 = done["reasons"].as_object().unwrap().values().map(|n| n.as_u64().unwrap()).sum();
    assert_eq!(steps, 38, "{done}");
}

#[test]
#[ignore = "needs a Python with the packages of examples/python/requirements.txt, named by TECTUM_PYTHON"]
fn environments_are_plants() {
    for (name, kills) in [("pendulum.toml", 2), ("reacher.toml", 0)] {
        let run = |kills: usize| {
            let test_folder = TestFolder::new();
            let scenario = scenario(&test_folder, name, &[("ticks = 40_000", "ticks = 5_000")], "");
            let mut run = test_folder.run(&[&scenario, "--json"]);
            if kills > 0 {
                kill(&mut run, "tectum.gym", kills);
            }
            let summary = run.wait().expect(0).json();
            assert_no_debris(&test_folder.run_folder());
            assert_eq!((&summary["lost"], &summary["missed"]), (&json!(0), &json!(0)), "{summary}");
            summary["weights_hash"].clone()
        };
        assert_eq!(run(0), run(kills), "{name}");
    }
}

/// A scenario for any environment, written by the package, runs as it is.
#[test]
#[ignore = "needs a Python with the packages of examples/python/requirements.txt, named by TECTUM_PYTHON"]
fn a_scenario_is_written_for_an_environment() {
    let test_folder = TestFolder::new();
    let arguments = ["-m", "tectum.gym", "scenario", "MountainCarContinuous-v0"];
    let written = test_folder.start(python(), &arguments).wait().expect(0).stdout;
    assert!(written.lines().count() <= 30, "{written}");
    let path = test_folder.write_file("written.toml", written);
    let run = test_folder.run(&[path.to_str().unwrap(), "--ticks", "300", "--json"]);
    let summary = run.wait().expect(0).json();
    assert_eq!(summary["ticks"], 300, "{summary}");
    let refused = test_folder.start(python(), &["-m", "tectum.gym", "scenario", "CartPole-v1"]).wait().expect(2);
    assert!(refused.stderr.contains("is a Discrete; a plant has boxes of numbers (Box) alone"), "{refused:#?}");
}
