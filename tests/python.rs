//! Python reads our logs unaided, and takes part in runs: plant, viewer and MuJoCo arm of `examples/python`. Ignored by default,
//! because it needs a Python with the packages of `tests/python/requirements.txt` and `examples/python/requirements.txt`; `.ci/run`
//! makes one and runs it:
//!
//! ```text
//! TECTUM_PYTHON=path/to/python cargo test --locked --test python -- --ignored
//! ```

mod support;

use std::fs;
use std::path::Path;

use serde_json::{Value, json};
use support::{Place, TECTUM, assert_no_debris, signal_process};
use tectum::wire::{Command, Control, Header, Learning, Observation, Sample, Status, Vision, flag};

fn python() -> String {
    std::env::var("TECTUM_PYTHON").unwrap_or_else(|_| "python3".to_owned())
}

fn script(name: &str) -> String {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/python").join(name);
    path.to_str().unwrap().to_owned()
}

fn example(name: &str) -> String {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("examples/python").join(name);
    path.to_str().unwrap().to_owned()
}

/// One of the scenarios of `examples/python` with some texts replaced and others behind, so that it runs anywhere.
#[track_caller]
fn scenario(place: &Place, name: &str, changes: &[(&str, &str)], more: &str) -> String {
    let mut text = fs::read_to_string(example(name)).unwrap();
    let python = format!("{:?}", python());
    let folder = format!("\"{}/", example("").trim_end_matches('/'));
    for (from, to) in
        [("\"target/python/bin/python\"", python.as_str()), ("\"examples/python/", &folder)].iter().chain(changes)
    {
        assert!(text.contains(from), "{name} has no {from}");
        text = text.replacen(from, to, 1);
    }
    place.file("scenario.toml", text + more).to_str().unwrap().to_owned()
}

#[test]
#[ignore = "needs a Python with the packages of tests/python/requirements.txt, named by TECTUM_PYTHON"]
fn python_reads_a_whole_log_and_recomputes_its_means() {
    let python = python();
    let place = Place::new();
    let scenario = place.arm(&[("every", "1")]);
    place.run(&[&scenario, "--ticks", "20000", "--seed", "77"]).wait().expect(0);

    let checked = place.start(&python, &[&script("check_log.py"), "run/log.mcap"]).wait().expect(0).json();
    for topic in ["/observation", "/command", "/learning"] {
        assert_eq!(checked["topics"][topic]["messages"], 20000, "{checked}");
    }
    // In double precision; the controller's single precision differs by parts in 10^7 of the means.
    let means = [&script("recompute_means.py"), "run/log.mcap", "1e-7"];
    let recomputed = place.start(&python, &means).wait().expect(0).json();
    assert!(recomputed["largest_mean"].as_f64().unwrap() > 1e-4, "{recomputed}");
}

/// The summary is what a torn log lacks, and what tools that seek look for first.
#[test]
#[ignore = "needs a Python with the packages of tests/python/requirements.txt, named by TECTUM_PYTHON"]
fn python_reads_a_repaired_log() {
    let place = Place::new();
    let scenario = place.arm(&[("every", "1")]);
    place.run(&[&scenario, "--ticks", "1000"]).wait().expect(0);
    let whole = fs::read(place.run_folder().join("log.mcap")).unwrap();
    for share in [2, 3, 5, 7] {
        place.file("torn.mcap", &whole[..whole.len() - whole.len() / share]);
        let repair = ["log", "repair", "torn.mcap", "--out", &format!("{share}.mcap"), "--json"];
        let done = place.start(TECTUM, &repair).wait().expect(0).json();
        let read = [&script("check_repaired.py"), &format!("{share}.mcap")];
        let read = place.start(python(), &read.map(String::as_str)).wait().expect(0).json();
        assert_eq!(read["messages"], read["stated"], "{read}");
        for (i, topic) in ["/observation", "/command", "/learning"].into_iter().enumerate() {
            assert_eq!(read["messages"][topic], done["mended"]["messages"][i], "{read}");
        }
        assert_eq!(read["metadata"]["tectum.totals"]["repaired"], "true", "{read}");
        assert_eq!(read["metadata"]["tectum.repair"]["torn_at"], done["mended"]["torn_at"].to_string(), "{read}");
        assert_eq!(read["attachments"], serde_json::json!(["scenario.toml"]), "{read}");
    }
}

#[test]
#[ignore = "needs a Python with the packages of tests/python/requirements.txt, named by TECTUM_PYTHON"]
fn python_reads_a_checkpoint() {
    let place = Place::new();
    let scenario = place.arm(&[]);
    let run = place.run(&[&scenario, "--ticks", "3000", "--json"]).wait().expect(0).json();
    let read = [&script("read_checkpoint.py"), "run/checkpoints/3000.controller.safetensors"];
    let read = place.start(python(), &read).wait().expect(0).json();
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

#[test]
#[ignore = "needs a Python with the packages of examples/python/requirements.txt, named by TECTUM_PYTHON"]
fn python_has_the_samples_as_they_are() {
    let place = Place::new();
    let told = place.start(python(), &[&script("layouts.py"), &example("")]).wait().expect(0).json();
    let ours = [
        layout::<Header>(),
        layout::<Observation>(),
        layout::<Command>(),
        layout::<Learning>(),
        layout::<Vision>(),
        layout::<Control>(),
        layout::<Status>(),
    ];
    assert_eq!(told, Value::Object(ours.into_iter().collect()));
}

/// The gate in Python with all limits and holds at work, against the one in Rust: `replay` reckons every applied command anew.
#[test]
#[ignore = "needs a Python with the packages of examples/python/requirements.txt, named by TECTUM_PYTHON"]
fn a_plant_in_python_is_deterministic_and_its_gate_is_ours() {
    let gate = "[gate]\nmax_step = 0.11\nramp_ticks = 7\npositions = [[-0.2, 0.3]]\nhold_ticks = 1\ndecay_ticks = 6\n";
    let changes = [("[gate]\n", gate), ("max_command = 1.0", "max_command = 0.3"), ("sigma = 0.05", "sigma = 0.2")];
    let faults = "[[faults.channel]]\nchannel = \"observation\"\nkind = \"drop\"\nprobability = 0.3\n\
                  [[faults.channel]]\nchannel = \"observation\"\nkind = \"delay\"\nprobability = 0.02\nticks = 8\n";
    let run = || {
        let place = Place::new();
        let scenario = scenario(&place, "plant.toml", &changes, faults);
        let summary = place.run(&[&scenario, "--ticks", "1500", "--json"]).wait().expect(0).json();
        assert_no_debris(&place.run_folder());
        (place, summary)
    };
    let ((place, first), (_, second)) = (run(), run());
    assert_eq!(first["weights_hash"], second["weights_hash"], "{first}\n{second}");
    assert_eq!((&first["ticks"], &first["lost"]), (&json!(1500), &json!(0)), "{first}");
    assert!(first["missed"].as_u64().unwrap() > 300, "{first}");
    let account: Value =
        serde_json::from_str(&fs::read_to_string(place.run_folder().join("plant.json")).unwrap()).unwrap();
    for count in ["clamped", "step_limited", "position_limited", "ramped"] {
        assert!(account[count].as_u64().unwrap() > 5, "nothing was {count}: {account}");
    }
    place.start(TECTUM, &["replay", "run"]).wait().expect(0);
}

/// In lockstep nothing may depend on who looks on: a viewer, and one that stands still.
#[test]
#[ignore = "needs a Python with the packages of examples/python/requirements.txt, named by TECTUM_PYTHON"]
fn viewers_change_nothing() {
    let run = |viewers: usize| {
        let place = Place::new();
        let scenario = scenario(&place, "plant.toml", &[], "");
        let mut run = place.run(&[&scenario, "--ticks", "4000", "--json"]);
        run.until_ticking();
        let viewer = example("viewer.py");
        let watch = [&viewer, "--run", "run", "--every", "0.05"];
        let seen: Vec<_> = (0..viewers)
            .map(|i| {
                let viewer = place.start(python(), &watch);
                let id = viewer.id();
                // The first of them never gets further than this.
                if i == 0 {
                    signal_process(id, "STOP");
                }
                (id, viewer)
            })
            .collect();
        let summary = run.wait().expect(0).json();
        for (i, (id, viewer)) in seen.into_iter().enumerate() {
            signal_process(id, "CONT");
            let end = viewer.wait();
            // The first is too late for the run, and says so.
            assert!(i == 0 || end.code == Some(0), "{end:#?}");
        }
        summary
    };
    let (alone, watched) = (run(0), run(2));
    assert_eq!(alone["weights_hash"], watched["weights_hash"]);
    assert_eq!((&watched["lost"], &watched["missed"]), (&json!(0), &json!(0)), "{watched}");
}

/// Real time: a viewer sees the plant's ticks, also those of the plant that comes in the place of one that is killed.
#[test]
#[ignore = "needs a Python with the packages of examples/python/requirements.txt, named by TECTUM_PYTHON"]
fn a_plant_in_python_lives_in_real_time_and_comes_back() {
    let place = Place::new();
    let scenario = scenario(&place, "plant.toml", &[("ticks = 2_000", "ticks = 100_000\nperiod_ms = 10")], "");
    let mut run = place.run(&[&scenario, "--mode", "realtime", "--json"]);
    let name = python();
    let name = Path::new(&name).file_name().unwrap().to_str().unwrap();
    let (run_id, first) = (run.id(), run.member(name));
    run.until_ticking();
    let watch = format!("exec {} {} --run run --every 0.05 > seen.txt", python(), example("viewer.py"));
    let viewer = place.start("/bin/sh", &["-c", &watch]);
    let seen = place.path().join("seen.txt");
    let lines = || fs::read_to_string(&seen).unwrap_or_default().lines().count();
    run.until("a viewer that sees", || lines() > 2);
    signal_process(first, "KILL");
    run.until("another plant", || support::children(run_id).iter().any(|(pid, child)| child == name && *pid != first));
    let before = lines();
    run.until("a viewer that sees the other plant", || lines() > before + 2);
    run.signal("INT");
    let summary = run.wait().expect(130).json();
    assert_no_debris(&place.run_folder());
    assert_eq!(summary["restarts"][0]["process"], "plant", "{summary}");
    assert_eq!(summary["lost"], 0, "{summary}");
    // The ticks in which nobody was there are passed over, and said to be.
    assert!(summary["missed"].as_u64().unwrap() > 0, "{summary}");
    viewer.wait().expect(0);
    place.start(TECTUM, &["log", "info", "run"]).wait().expect(0);
}

/// Trackers in Python: one is killed, and the next one takes over.
#[test]
#[ignore = "needs a Python with the packages of examples/python/requirements.txt, named by TECTUM_PYTHON"]
fn a_tracker_in_python_is_what_the_arm_sees_with() {
    let place = Place::new();
    let text = fs::read_to_string("scenarios/servo-vision.toml").unwrap();
    let text = text.replace("\"learned-reward\"", "\"paper\"").replace("= 100.0 ", "= 500.0 ");
    let scenario = place.file("scenario.toml", text);
    let mut run = place.run(&[scenario.to_str().unwrap(), "--ticks", "100000"]);
    let mut witness = None;
    run.until("a run to look at", || {
        witness = tectum::runtime::Tracker::join(&place.run_folder()).ok();
        witness.is_some()
    });
    let witness = witness.unwrap();
    let until = |run: &mut support::Process, sees: bool| {
        run.until("an arm that sees, or does not", || {
            let observation = witness.observation().unwrap();
            let aged = |o: &Observation| (0.0..=500.0).contains(&o.measures[5]) && o.header.flags & flag::FIRST == 0;
            observation.is_some_and(|o| aged(&o) == sees)
        });
    };
    until(&mut run, false);
    let script = example("tracker.py");
    let track = || place.start(python(), &[&script, "--run", "run"]);
    let first = track();
    until(&mut run, true);
    signal_process(first.id(), "KILL");
    first.wait();
    until(&mut run, false);
    let second = track();
    until(&mut run, true);
    run.signal("INT");
    run.wait().expect(130);
    second.wait().expect(0);
    assert_no_debris(&place.run_folder());
}

#[test]
#[ignore = "needs a Python with the packages of examples/python/requirements.txt, named by TECTUM_PYTHON"]
fn what_python_cannot_do_it_refuses_in_a_sentence() {
    let place = Place::new();
    for program in ["plant.py", "viewer.py", "mujoco_arm.py", "tracker.py"] {
        let end = place.start(python(), &[&example(program), "--run", "nowhere"]).wait().expect(2);
        assert!(
            end.stderr.lines().count() == 1 && end.stderr.contains("there is no run to join in nowhere"),
            "{end:#?}"
        );
    }
    let fault = "[[faults.channel]]\nchannel = \"command\"\nkind = \"drop\"\nprobability = 0.1\n";
    let end = place.run(&[&scenario(&place, "plant.toml", &[], fault)]).wait().expect(2);
    assert!(end.stderr.contains("cannot make faults on its commands"), "{end:#?}");
    // Killed in lockstep it has forgotten who it was; the run ends and says so, and does not go on with other numbers.
    let place = Place::new();
    let mut run = place.run(&[&scenario(&place, "plant.toml", &[], ""), "--ticks", "200000"]);
    let plant = run.member(Path::new(&python()).file_name().unwrap().to_str().unwrap());
    run.until_ticking();
    signal_process(plant, "KILL");
    let end = run.wait().expect(2);
    assert!(end.stderr.contains("in lockstep it cannot come back"), "{end:#?}");
    assert_no_debris(&place.run_folder());
}

#[test]
#[ignore = "needs a Python with the packages of examples/python/requirements.txt, named by TECTUM_PYTHON"]
fn the_mujoco_arm_is_deterministic_and_keeps_time() {
    let run = |arguments: &[&str]| {
        let place = Place::new();
        let scenario = scenario(&place, "mujoco.toml", &[], "");
        let mut all = vec![scenario.as_str(), "--json"];
        all.extend(arguments);
        let summary = place.run(&all).wait().expect(0).json();
        assert_no_debris(&place.run_folder());
        summary
    };
    let (first, second) = (run(&["--ticks", "600"]), run(&["--ticks", "600"]));
    assert_eq!(first["weights_hash"], second["weights_hash"], "{first}\n{second}");
    assert_eq!((&first["diverged_at"], &first["lost"]), (&Value::Null, &json!(0)), "{first}");
    let other = run(&["--ticks", "600", "--seed", "2"]);
    assert_ne!(first["weights_hash"], other["weights_hash"]);
    // Half a minute of its time is enough to see it reach.
    let loss = |span: &str| first[span]["loss"].as_f64().unwrap();
    assert!(loss("last") < 0.5 * loss("first"), "the arm with mass learns: {first}");
    let real = run(&["--ticks", "40", "--mode", "realtime"]);
    // On a loaded machine ticks may be passed over; they are counted.
    let count = |key: &str| real[key].as_u64().unwrap();
    assert_eq!((count("ticks") + count("skipped"), count("lost")), (40, 0), "{real}");
}
