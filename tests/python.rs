//! Python reads our logs with public packages only, and takes part in runs with the plant, viewer, tracker and MuJoCo
//! arm of `examples/python`. The tests are ignored by default, because they need a Python with the packages of
//! `tests/python/requirements.txt` and `examples/python/requirements.txt`. `.ci/run` installs these and runs the
//! tests:
//!
//! ```text
//! TECTUM_PYTHON=path/to/python cargo test --locked --test python -- --ignored
//! ```

mod support;

use std::fs;

use serde_json::{Value, json};
use support::python::{example, python, python_name, scenario, script};
use support::{TECTUM, TestFolder, assert_no_debris, read_json, signal_process};
use tectum::channel::LOG_BUFFER;
use tectum::wire::{
    Ahead, Command, Control, Header, Learning, MAX_INPUTS, MAX_MEASURES, MAX_OUTPUTS, Observation, Sample, Status,
    Vision, flag, schema_hash,
};

#[test]
#[ignore = "needs a Python with the packages of tests/python/requirements.txt, named by TECTUM_PYTHON"]
fn python_reads_a_whole_log_and_recomputes_its_means() {
    let python = python();
    let test_folder = TestFolder::new();
    let scenario = test_folder.arm_scenario(&[("every", "1")]);
    test_folder.run(&[&scenario, "--ticks", "20000", "--seed", "77"]).wait().expect(0);

    let checked = test_folder.start(&python, &[&script("check_log.py"), "run/log.mcap"]).wait().expect(0).json();
    for topic in ["/observation", "/command", "/learning"] {
        assert_eq!(checked["topics"][topic]["messages"], 20000, "{checked}");
    }
    // Python computes in double precision; the controller's single precision differs by parts in 10^7 of the means.
    let means = [&script("recompute_means.py"), "run/log.mcap", "1e-7"];
    let recomputed = test_folder.start(&python, &means).wait().expect(0).json();
    assert!(recomputed["largest_mean"].as_f64().unwrap() > 1e-4, "{recomputed}");
}

/// A torn log has no summary, which seeking tools read first. A repair adds it.
#[test]
#[ignore = "needs a Python with the packages of tests/python/requirements.txt, named by TECTUM_PYTHON"]
fn python_reads_a_repaired_log() {
    let test_folder = TestFolder::new();
    let scenario = test_folder.arm_scenario(&[("every", "1")]);
    test_folder.run(&[&scenario, "--ticks", "1000"]).wait().expect(0);
    let whole = fs::read(test_folder.log_path()).unwrap();
    for share in [2, 3, 5, 7] {
        test_folder.write_file("torn.mcap", &whole[..whole.len() - whole.len() / share]);
        let repair = ["log", "repair", "torn.mcap", "--out", &format!("{share}.mcap"), "--json"];
        let done = test_folder.start(TECTUM, &repair).wait().expect(0).json();
        let read = [&script("check_repaired.py"), &format!("{share}.mcap")];
        let read = test_folder.start(python(), &read.map(String::as_str)).wait().expect(0).json();
        assert_eq!(read["messages"], read["stated"], "{read}");
        for (i, topic) in ["/observation", "/command", "/learning"].into_iter().enumerate() {
            assert_eq!(read["messages"][topic], done["mended"]["messages"][i], "{read}");
        }
        assert_eq!(read["metadata"]["tectum.totals"]["repaired"], "true", "{read}");
        assert_eq!(read["metadata"]["tectum.repair"]["torn_at"], done["mended"]["torn_at"].to_string(), "{read}");
        assert_eq!(read["attachments"], serde_json::json!(["scenario.toml"]), "{read}");
    }
}

/// A packed log is read through its index of chunks, and by the package's own reader.
#[test]
#[ignore = "needs a Python with the packages of tests/python/requirements.txt, named by TECTUM_PYTHON"]
fn python_reads_a_packed_log() {
    let test_folder = TestFolder::new();
    let scenario = test_folder.arm_scenario(&[("every", "1")]);
    test_folder.run(&[&scenario, "--ticks", "5000"]).wait().expect(0);
    test_folder.tectum("log", &["pack", "run", "--out", "packed.mcap"]).expect(0);
    let read = test_folder.start(python(), &[&script("check_repaired.py"), "packed.mcap"]).wait().expect(0).json();
    assert_eq!(read["messages"], read["stated"], "{read}");
    for topic in ["/observation", "/inputs", "/outputs", "/applied", "/measures", "/joint_states"] {
        assert_eq!(read["messages"][topic], 5000, "{read}");
    }
    let compare = "import tectum, numpy\n\
                   a, b = tectum.read_log('run'), tectum.read_log('packed.mcap')\n\
                   assert a.complete and b.complete and a.facts == b.facts\n\
                   assert numpy.array_equal(a.observation, b.observation) and len(b.learning) == 5000\n";
    test_folder.start(python(), &["-c", compare]).wait().expect(0);
}

#[test]
#[ignore = "needs a Python with the packages of tests/python/requirements.txt, named by TECTUM_PYTHON"]
fn python_reads_a_checkpoint() {
    let test_folder = TestFolder::new();
    let scenario = test_folder.arm_scenario(&[]);
    let run = test_folder.run(&[&scenario, "--ticks", "3000", "--json"]).wait().expect(0).json();
    let read = [&script("read_checkpoint.py"), "run/checkpoints/3000.controller.safetensors"];
    let read = test_folder.start(python(), &read).wait().expect(0).json();
    assert_eq!(read["weights_hash"], run["weights_hash"], "{read}");
    assert_eq!(read["shape"], serde_json::json!([4, 320]), "{read}");
    assert_eq!(read["facts"]["tick"], 3000, "{read}");
    let names = read["tensors"].as_array().unwrap();
    assert!(names.iter().any(|name| name == "controller.learner.trace.tiles"), "{read}");
}

/// Name, size and fields of a sample, as `tests/python/layouts.py` prints them.
fn layout<S: Sample>() -> (String, Value) {
    let size = |element| match element {
        "uint32" | "float32" => 4,
        "uint64" => 8,
        _ => size_of::<Header>(),
    };
    let fields: Vec<_> = S::FIELDS.iter().map(|f| json!([f.name, f.offset, f.count * size(f.element)])).collect();
    (S::NAME.to_owned(), json!([size_of::<S>(), fields]))
}

/// Layouts, flags and numbers of the package `tectum`.
#[test]
#[ignore = "needs a Python with the packages of examples/python/requirements.txt, named by TECTUM_PYTHON"]
fn the_python_samples_have_the_rust_layout() {
    let test_folder = TestFolder::new();
    let theirs = test_folder.start(python(), &[&script("layouts.py")]).wait().expect(0).json();
    let rust_layouts = [
        layout::<Header>(),
        layout::<Observation>(),
        layout::<Command>(),
        layout::<Ahead>(),
        layout::<Learning>(),
        layout::<Vision>(),
        layout::<Control>(),
        layout::<Status>(),
    ];
    assert_eq!(theirs["samples"], Value::Object(rust_layouts.into_iter().collect()));
    assert_eq!(theirs["schema"], format!("{:016x}", schema_hash()), "python/src/tectum/layouts.py has another SCHEMA");
    assert_eq!(theirs["numbers"], json!([MAX_INPUTS, MAX_OUTPUTS, MAX_MEASURES, LOG_BUFFER]));
    // The C header is made from the Rust flags.
    let header = fs::read_to_string("docs/tectum.h").unwrap();
    for (name, bit) in theirs["flags"].as_object().unwrap() {
        assert!(header.contains(&format!("TECTUM_{name} = 1 << {bit},")), "{name} {bit}");
    }
    assert_eq!(header.matches(" = 1 << ").count(), theirs["flags"].as_object().unwrap().len());
}

/// Compares the gate in Python, with all limits and the hold policy in use, with the gate in Rust: `replay` computes
/// every applied command again.
#[test]
#[ignore = "needs a Python with the packages of examples/python/requirements.txt, named by TECTUM_PYTHON"]
fn a_python_plant_is_deterministic_and_its_gate_equals_the_rust_gate() {
    let gate = "[gate]\nmax_step = 0.11\nramp_ticks = 7\npositions = [[-0.2, 0.3]]\nhold_ticks = 1\ndecay_ticks = 6\n";
    let changes = [("[gate]\n", gate), ("max_command = 1.0", "max_command = 0.3"), ("sigma = 0.05", "sigma = 0.2")];
    let faults = "[[faults.channel]]\nchannel = \"observation\"\nkind = \"drop\"\nprobability = 0.3\n\
                  [[faults.channel]]\nchannel = \"observation\"\nkind = \"delay\"\nprobability = 0.02\nticks = 8\n";
    let run = || {
        let test_folder = TestFolder::new();
        let scenario = scenario(&test_folder, "plant.toml", &changes, faults);
        let summary = test_folder.run(&[&scenario, "--ticks", "1500", "--json"]).wait().expect(0).json();
        assert_no_debris(test_folder.run_folder());
        (test_folder, summary)
    };
    let ((test_folder, first), (_, second)) = (run(), run());
    assert_eq!(first["weights_hash"], second["weights_hash"], "{first}\n{second}");
    assert_eq!((&first["ticks"], &first["lost"]), (&json!(1500), &json!(0)), "{first}");
    assert!(first["missed"].as_u64().unwrap() > 300, "{first}");
    let report = read_json(test_folder.run_folder().join("plant.json"));
    for count in ["clamped", "step_limited", "position_limited", "ramped"] {
        assert!(report[count].as_u64().unwrap() > 5, "nothing was {count}: {report}");
    }
    test_folder.start(TECTUM, &["replay", "run"]).wait().expect(0);
}

/// Ticks without an observation have a command ahead, until it is older than the gate holds.
#[test]
#[ignore = "needs a Python with the packages of examples/python/requirements.txt, named by TECTUM_PYTHON"]
fn a_python_plant_takes_commands_ahead() {
    let learner = "[learner]\nrule = \"learned-reward\"\n\n[learner.model]\nmoved = [\"position\"]";
    let changes = [(learner, "[learner]\nrule = \"model-predictive\"\n\n#"), ("[gate]\n", "[gate]\nhold_ticks = 3\n")];
    let more = "[link]\nahead = 2\n[[faults.channel]]\nchannel = \"observation\"\nkind = \"drop\"\nprobability = 0.3\n";
    let test_folder = TestFolder::new();
    let scenario = scenario(&test_folder, "plant.toml", &changes, more);
    let mut run = test_folder.run(&[&scenario, "--ticks", "400", "--json"]);
    run.wait_until_ticking();
    run.kill_child("python");
    let summary = run.wait().expect(0).json();
    let (missed, ahead) = (summary["missed"].as_u64().unwrap(), summary["ahead"].as_u64().unwrap());
    // Of 0.3 missed, those are without that come third in a row or later.
    assert!(ahead < missed && ahead * 10 > missed * 8, "missed {missed}, ahead {ahead}");
    test_folder.start(TECTUM, &["replay", "run"]).wait().expect(0);
}

/// In lockstep no number may depend on viewers, one of which is stopped.
#[test]
#[ignore = "needs a Python with the packages of examples/python/requirements.txt, named by TECTUM_PYTHON"]
fn viewers_change_nothing() {
    let run = |viewers: usize| {
        let test_folder = TestFolder::new();
        let scenario = scenario(&test_folder, "plant.toml", &[], "");
        let mut run = test_folder.run(&[&scenario, "--ticks", "4000", "--json"]);
        run.wait_until_ticking();
        let viewer = example("viewer.py");
        let arguments = [&viewer, "--run", "run", "--every", "0.05"];
        let started: Vec<_> = (0..viewers)
            .map(|i| {
                let viewer = test_folder.start(python(), &arguments);
                let id = viewer.id();
                // The first viewer is stopped at once.
                if i == 0 {
                    signal_process(id, "STOP");
                }
                (id, viewer)
            })
            .collect();
        let summary = run.wait().expect(0).json();
        for (i, (id, viewer)) in started.into_iter().enumerate() {
            signal_process(id, "CONT");
            let outcome = viewer.wait();
            // The first viewer is too late for the run and may report that.
            assert!(i == 0 || outcome.code == Some(0), "{outcome:#?}");
        }
        summary
    };
    let (alone, watched) = (run(0), run(2));
    assert_eq!(alone["weights_hash"], watched["weights_hash"]);
    assert_eq!((&watched["lost"], &watched["missed"]), (&json!(0), &json!(0)), "{watched}");
}

/// In real time a viewer receives the plant's ticks, also those of the plant that replaces a killed one.
#[test]
#[ignore = "needs a Python with the packages of examples/python/requirements.txt, named by TECTUM_PYTHON"]
fn a_python_plant_runs_in_real_time_and_restarts() {
    let test_folder = TestFolder::new();
    let scenario = scenario(&test_folder, "plant.toml", &[("ticks = 2_000", "ticks = 100_000\nperiod_ms = 10")], "");
    let mut run = test_folder.run(&[&scenario, "--mode", "realtime", "--json"]);
    let name = &python_name();
    let first = run.child_pid(name);
    run.wait_until_ticking();
    let command = format!("exec {} {} --run run --every 0.05 > seen.txt", python(), example("viewer.py"));
    let viewer = test_folder.start("/bin/sh", &["-c", &command]);
    let seen = test_folder.path().join("seen.txt");
    let lines = || fs::read_to_string(&seen).unwrap_or_default().lines().count();
    run.wait_until("a viewer that sees", || lines() > 2);
    signal_process(first, "KILL");
    run.next_child_pid(name, first);
    let before = lines();
    run.wait_until("a viewer that sees the other plant", || lines() > before + 2);
    run.signal("INT");
    let summary = run.wait().expect(130).json();
    assert_no_debris(test_folder.run_folder());
    assert_eq!(summary["restarts"][0]["process"], "plant", "{summary}");
    assert_eq!(summary["lost"], 0, "{summary}");
    // The ticks without a plant are skipped and counted as missed.
    assert!(summary["missed"].as_u64().unwrap() > 0, "{summary}");
    viewer.wait().expect(0);
    test_folder.start(TECTUM, &["log", "info", "run"]).wait().expect(0);
}

/// A tracker in Python is killed, and the next one replaces it.
#[test]
#[ignore = "needs a Python with the packages of examples/python/requirements.txt, named by TECTUM_PYTHON"]
fn a_python_tracker_gives_the_arm_vision() {
    let test_folder = TestFolder::new();
    let text = fs::read_to_string("scenarios/servo-vision.toml").unwrap();
    let text = text.replace("\"learned-reward\"", "\"paper\"").replace("= 100.0 ", "= 500.0 ");
    let scenario = test_folder.write_file("scenario.toml", text);
    let mut run = test_folder.run(&[scenario.to_str().unwrap(), "--ticks", "100000"]);
    let mut observer = None;
    run.wait_until("a run to join", || {
        observer = tectum::runtime::Tracker::join(&test_folder.run_folder()).ok();
        observer.is_some()
    });
    let observer = observer.unwrap();
    let wait_for_vision = |run: &mut support::Process, sees: bool| {
        run.wait_until("an arm that sees, or does not", || {
            let observation = observer.observation().unwrap();
            let aged = |o: &Observation| (0.0..=500.0).contains(&o.measures[5]) && o.header.flags & flag::FIRST == 0;
            observation.is_some_and(|o| aged(&o) == sees)
        });
    };
    wait_for_vision(&mut run, false);
    let script = example("tracker.py");
    let start_tracker = || test_folder.start(python(), &[&script, "--run", "run"]);
    let first = start_tracker();
    wait_for_vision(&mut run, true);
    signal_process(first.id(), "KILL");
    first.wait();
    wait_for_vision(&mut run, false);
    let second = start_tracker();
    wait_for_vision(&mut run, true);
    run.signal("INT");
    run.wait().expect(130);
    second.wait().expect(0);
    assert_no_debris(test_folder.run_folder());
}

#[test]
#[ignore = "needs a Python with the packages of examples/python/requirements.txt, named by TECTUM_PYTHON"]
fn what_python_does_not_support_is_refused_in_one_sentence() {
    let test_folder = TestFolder::new();
    for program in ["plant.py", "viewer.py", "mujoco_arm.py", "tracker.py"] {
        let outcome = test_folder.start(python(), &[&example(program), "--run", "nowhere"]).wait().expect(2);
        assert!(
            outcome.stderr.lines().count() == 1 && outcome.stderr.contains("there is no run to join in nowhere"),
            "{outcome:#?}"
        );
    }
    let fault = "[[faults.channel]]\nchannel = \"command\"\nkind = \"drop\"\nprobability = 0.1\n";
    let outcome = test_folder.run(&[&scenario(&test_folder, "plant.toml", &[], fault)]).wait().expect(2);
    assert!(outcome.stderr.contains("cannot make faults on its commands"), "{outcome:#?}");
    // A plant without state() that is killed in lockstep loses its state. The run ends with a message and does not
    // continue with other numbers.
    let test_folder = TestFolder::new();
    let mut run = test_folder.run(&[&scenario(&test_folder, "mujoco.toml", &[], ""), "--ticks", "200000"]);
    let plant = run.child_pid(&python_name());
    run.wait_until_ticking();
    signal_process(plant, "KILL");
    let outcome = run.wait().expect(2);
    assert!(outcome.stderr.contains("in lockstep it cannot come back"), "{outcome:#?}");
    assert_no_debris(test_folder.run_folder());
}

#[test]
#[ignore = "needs a Python with the packages of examples/python/requirements.txt, named by TECTUM_PYTHON"]
fn the_mujoco_arm_is_deterministic_and_runs_in_real_time() {
    let run = |arguments: &[&str]| {
        let test_folder = TestFolder::new();
        let scenario = scenario(&test_folder, "mujoco.toml", &[], "");
        let mut all = vec![scenario.as_str(), "--json"];
        all.extend(arguments);
        let summary = test_folder.run(&all).wait().expect(0).json();
        assert_no_debris(test_folder.run_folder());
        summary
    };
    let (first, second) = (run(&["--ticks", "600"]), run(&["--ticks", "600"]));
    assert_eq!(first["weights_hash"], second["weights_hash"], "{first}\n{second}");
    assert_eq!((&first["diverged_at"], &first["lost"]), (&Value::Null, &json!(0)), "{first}");
    let other = run(&["--ticks", "600", "--seed", "2"]);
    assert_ne!(first["weights_hash"], other["weights_hash"]);
    // Half a minute of simulated time is enough for the arm to improve.
    let loss = |span: &str| first[span]["loss"].as_f64().unwrap();
    assert!(loss("last") < 0.5 * loss("first"), "the arm with mass learns: {first}");
    let real = run(&["--ticks", "40", "--mode", "realtime"]);
    // On a loaded machine ticks may be skipped; they are counted.
    let count = |key: &str| real[key].as_u64().unwrap();
    assert_eq!((count("ticks") + count("skipped"), count("lost")), (40, 0), "{real}");
}
