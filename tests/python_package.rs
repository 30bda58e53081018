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
        assert_no_debris(test_folder.run_folder());
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
    assert_no_debris(test_folder.run_folder());
    assert_eq!(summary["restarts"][0]["process"], "controller", "{summary}");
    assert_eq!(summary["lost"], 0, "{summary}");
    assert!(summary["missed"].as_u64().unwrap() > 0, "{summary}");
}

/// Both processes in Python: a run that is resumed from a checkpoint in its middle ends as the whole one did.
#[test]
#[ignore = "needs a Python with the packages of examples/python/requirements.txt, named by TECTUM_PYTHON"]
fn a_run_in_python_is_resumed_from_its_checkpoints() {
    let test_folder = TestFolder::new();
    let scenario = scenario(&test_folder, "controller.toml", &[], "");
    let run = test_folder.run(&[&scenario, "--ticks", "3000", "--checkpoint-every", "1000", "--json"]);
    let whole = run.wait().expect(0).json();
    let file = |tick: &str, role: &str| {
        test_folder.run_folder().join("checkpoints").join(format!("{tick}.{role}.safetensors"))
    };
    for tick in ["1000", "2000", "3000"] {
        assert!(file(tick, "plant").exists() && file(tick, "controller").exists(), "{tick}: {whole}");
    }
    for role in ["plant", "controller"] {
        for tick in ["2000", "3000"] {
            std::fs::remove_file(file(tick, role)).unwrap();
        }
    }
    let resume = ["run", "--resume", "run", "--out", "rest", "--json"];
    let resumed = test_folder.start(TECTUM, &resume).wait().expect(0).json();
    assert_eq!((&resumed["resumed_at"], &resumed["lost"]), (&json!(1000), &json!(0)), "{resumed}");
    assert_eq!(resumed["weights_hash"], whole["weights_hash"], "{resumed}");
    let csv = |run: &str| test_folder.tectum("log", &["csv", run, "--channel", "command"]).expect(0).stdout;
    assert!(csv("run").lines().skip(1 + 1000).eq(csv("rest").lines().skip(1)));

    // What is damaged is refused by name, before anything starts.
    let path = file("1000", "controller");
    let mut bytes = std::fs::read(&path).unwrap();
    let at = bytes.len() - 9;
    bytes[at] ^= 1;
    std::fs::write(&path, bytes).unwrap();
    let refused = test_folder.start(TECTUM, &["run", "--resume", "run", "--out", "no"]).wait().expect(2);
    assert!(
        refused.stderr.contains("1000.controller.safetensors") && refused.stderr.contains("damaged"),
        "{refused:#?}"
    );
}

/// Plant and controller in Python keep as many checkpoints as those in Rust, and go on from what is left.
#[test]
#[ignore = "needs a Python with the packages of examples/python/requirements.txt, named by TECTUM_PYTHON"]
fn a_run_in_python_keeps_as_many_checkpoints_as_it_is_told() {
    let test_folder = TestFolder::new();
    let scenario = scenario(&test_folder, "controller.toml", &[], "");
    let often = ["--checkpoint-every", "200", "--keep-checkpoints", "2", "--json"];
    let summary = test_folder.run(&[&[&scenario[..], "--ticks", "1900"], &often[..]].concat()).wait().expect(0).json();
    let kept = std::fs::read_dir(test_folder.run_folder().join("checkpoints")).unwrap();
    let mut kept: Vec<_> = kept.map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
    kept.sort();
    let expected = [1800, 1900].map(|tick| ["controller", "plant"].map(|role| format!("{tick}.{role}.safetensors")));
    assert_eq!(kept, expected.concat(), "{summary}");
    test_folder.start(TECTUM, &["run", "--resume", "run", "--ticks", "2000", "--out", "rest"]).wait().expect(0);
}

/// The launcher's faults of processes need nothing of a process but that it comes back.
#[test]
#[ignore = "needs a Python with the packages of examples/python/requirements.txt, named by TECTUM_PYTHON"]
fn faults_of_processes_change_no_bit_of_a_run_in_python() {
    let run = |faults: &str, restarts: usize| {
        let test_folder = TestFolder::new();
        let scenario = scenario(&test_folder, "controller.toml", &[], faults);
        let summary = test_folder.run(&[&scenario, "--json"]).wait().expect(0).json();
        assert_no_debris(test_folder.run_folder());
        assert_eq!(summary["restarts"].as_array().unwrap().len(), restarts, "{summary}");
        summary["weights_hash"].clone()
    };
    let faults: String = [("controller", "kill", 500), ("plant", "kill", 1000), ("controller", "restart", 1500)]
        .map(|(process, act, at)| format!("[[faults.process]]\nprocess = \"{process}\"\ndo = \"{act}\"\nat = [{at}]\n"))
        .concat();
    assert_eq!(run("", 0), run(&faults, 3));
}

/// A controller in Python with a memory and a generator, on the simulator's arm, beside a rule of this package.
#[test]
#[ignore = "needs a Python with the packages of examples/python/requirements.txt, named by TECTUM_PYTHON"]
fn a_controller_in_python_is_compared_and_a_test_changes_nothing_in_its_run() {
    const MINE: &str = r#"
import tectum

class Mine(tectum.Controller):
    def __init__(self, run):
        self.gain, self.before, self.updates, self.noise = 0.002, 0.0, 0, run.generator("noise")

    def act(self, percept):
        mean = [self.gain * (percept.inputs[0] - percept.inputs[2]) - 0.001 * self.before] * 4
        self.before = float(percept.inputs[2])
        return tectum.Answer([one + 0.003 * self.noise.normal() for one in mean], mean)

    def learn(self, experience):
        self.gain *= 1.0 + 0.001 * experience.reward

    def improve(self):
        self.updates += 1

    def state(self):
        return {"gain": self.gain, "before": self.before, "updates": self.updates, "noise": self.noise}

    def restore(self, state):
        self.gain, self.before, self.updates = state["gain"], state["before"], state["updates"]
        tectum.restore_generator(self.noise, state["noise"])

tectum.main(Mine)
"#;
    let test_folder = TestFolder::new();
    let script = test_folder.write_file("mine.py", MINE);
    let text = format!(
        "name = \"mine\"\nticks = 60\n[plant.arm]\n[controller]\nprogram = {:?}\nargs = [{:?}]\nupdates = 2\n\
         [gate]\nmax_command = 0.05\n",
        python(),
        script.to_str().unwrap()
    );
    let mine = test_folder.write_file("mine.toml", text).to_str().unwrap().to_owned();
    let run = ["run", &mine, "--mode", "in-process", "--seed", "1000", "--out", "alone", "--json"];
    let alone = test_folder.start(TECTUM, &run).wait().expect(0).json();
    let compare = ["compare", "--learners", &format!("paper,{mine}"), "--seeds", "1", "--starts", "1", "--ticks", "60"];
    let more = ["--block", "never", "--out", "run", "--json"];
    let compared = test_folder.start(TECTUM, &[&compare[..], &more].concat()).wait().expect(0).json();
    let learner = &compared["learners"][1];
    assert_eq!((&learner["name"], &learner["weights_hash"][0]), (&json!("mine"), &alone["weights_hash"]), "{compared}");
    let loss = |i: usize| compared["learners"][i]["loss"]["median"].as_f64().unwrap();
    assert!(loss(1) > 0.1 && loss(0) > 0.1 && loss(0) != loss(1), "{compared}");
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
            assert_no_debris(test_folder.run_folder());
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
