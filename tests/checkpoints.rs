//! Checkpoints of real runs: when they are written, that a run resumed from one ends like an uninterrupted run, and
//! that only a whole checkpoint of the same run is accepted.

mod support;

use std::fs;
use std::path::Path;

use support::{TECTUM, TestFolder, append, planner_scenario, read_json, signal_process};
use tectum::log::{LogReader, LogRecord};

/// The names of the checkpoint files, in the order of their ticks.
fn checkpoints(folder: &Path) -> Vec<String> {
    let entries = fs::read_dir(folder.join("checkpoints")).into_iter().flatten().flatten();
    let mut names: Vec<_> = entries.map(|e| e.file_name().into_string().unwrap()).collect();
    names.sort_by_key(|name| {
        (name.split('.').next().unwrap().parse::<u64>().expect("nothing but checkpoints"), name.clone())
    });
    names
}

/// The samples of a log, without run and incarnation numbers.
fn samples(log: &Path) -> Vec<LogRecord> {
    let records = LogReader::open(log).unwrap().map(Result::unwrap);
    records
        .map(|mut record| {
            let header = match &mut record {
                LogRecord::Observation(s) => &mut s.header,
                LogRecord::Command(s) => &mut s.header,
                LogRecord::Learning(s) => &mut s.header,
                LogRecord::Gap(gap) => panic!("a lockstep log lacks nothing: {gap:?}"),
            };
            (header.run, header.incarnation) = (0, 0);
            record
        })
        .collect()
}

fn tick(record: &LogRecord) -> u64 {
    record.header().unwrap().tick
}

/// A planner goes on from its checkpoint as if it had never stopped.
#[test]
fn a_resumed_planner_equals_an_uninterrupted_one() {
    let test_folder = TestFolder::new();
    let file = planner_scenario(&test_folder, "cart-pole", "");
    let run = |arguments: &[&str]| test_folder.start(TECTUM, &[&["run"], arguments].concat());
    run(&[&file, "--ticks", "400", "--out", "whole"]).wait().expect(0);
    let log = test_folder.log_path();
    let mut first = test_folder.run(&[&file, "--ticks", "400", "--checkpoint-every", "50"]);
    first.wait_until("a grown log", || fs::metadata(&log).is_ok_and(|m| m.len() > 80_000));
    first.signal("INT");
    first.wait().expect(130);
    let second = run(&["--resume", "run", "--out", "second", "--json"]).wait().expect(0).json();
    let from = second["resumed_at"].as_u64().unwrap();
    assert!(from > 0 && from < 400, "{second}");
    let whole = read_json(test_folder.path().join("whole/summary.json"));
    for key in ["weights_hash", "learner", "last"] {
        assert_eq!(second[key], whole[key], "{key}");
    }
    let mut parts = samples(&log);
    parts.retain(|record| tick(record) < from);
    parts.extend(samples(&test_folder.path().join("second/log.mcap")));
    assert!(parts == samples(&test_folder.path().join("whole/log.mcap")));
}

/// Plant, learner and log of the two parts together equal those of one run.
#[test]
fn a_resumed_run_equals_an_uninterrupted_one() {
    for (scenario, ticks, every) in [("paper", "60000", "1000"), ("arm", "900", "100"), ("eye", "60000", "1000")] {
        let test_folder = TestFolder::new();
        let text = fs::read_to_string(format!("scenarios/{scenario}.toml")).unwrap();
        let text: Vec<_> = text.lines().map(|l| if l.starts_with("every = ") { "every = 1" } else { l }).collect();
        let file = test_folder.write_file("scenario.toml", text.join("\n"));
        let file = file.to_str().unwrap();
        let run = |arguments: &[&str]| test_folder.start(TECTUM, &[&["run"], arguments].concat());
        run(&[file, "--ticks", ticks, "--out", "whole"]).wait().expect(0);

        let log = test_folder.log_path();
        let mut first = test_folder.run(&[file, "--ticks", ticks, "--checkpoint-every", every]);
        first.wait_until("a grown log", || fs::metadata(&log).is_ok_and(|m| m.len() > 200_000));
        first.signal("INT");
        first.wait().expect(130);
        // The first part ends with a checkpoint of each, unless the machine was too busy to write them within a second.
        let second = run(&["--resume", "run", "--out", "second", "--json"]).wait().expect(0).json();
        let from = second["resumed_at"].as_u64().unwrap();
        assert!(from > 0 && from < ticks.parse().unwrap(), "{second}");
        let whole = read_json(test_folder.path().join("whole/summary.json"));
        for key in ["weights_hash", "ticks", "last", "end_error_m", "missed", "clamped"] {
            assert_eq!(second[key], whole[key], "{scenario}: {key}");
        }
        let mut parts = samples(&log);
        parts.retain(|record| tick(record) < from);
        parts.extend(samples(&test_folder.path().join("second/log.mcap")));
        assert!(parts == samples(&test_folder.path().join("whole/log.mcap")), "{scenario}");
        // Their last checkpoints have the same size; they differ in the run's id.
        let end = format!("checkpoints/{ticks}.controller.safetensors");
        let [a, b] = ["whole", "second"].map(|run| fs::read(test_folder.path().join(run).join(&end)).unwrap().len());
        assert_eq!(a, b);
        let again = run(&["--resume", "second"]).wait().expect(2);
        assert!(again.stderr.contains("the run came to its end"), "{again:#?}");
    }
}

#[test]
fn checkpoints_are_written_periodically_and_on_request() {
    let test_folder = TestFolder::new();
    let scenario = test_folder.arm_scenario(&[]);
    test_folder.run(&[&scenario, "--ticks", "5000", "--checkpoint-every", "2000"]).wait().expect(0);
    let expected: Vec<_> = ["2000", "4000", "5000"]
        .iter()
        .flat_map(|tick| ["controller", "plant"].map(|role| format!("{tick}.{role}.safetensors")))
        .collect();
    assert_eq!(checkpoints(&test_folder.run_folder()), expected);

    let test_folder = TestFolder::new();
    for mode in ["lockstep", "realtime"] {
        let out = test_folder.path().join(mode);
        let scenario = test_folder.endless_scenario(mode);
        let all = ["run", &scenario, "--mode", mode, "--out", mode];
        let mut run = test_folder.start(TECTUM, &all);
        let log = out.join("log.mcap");
        run.wait_until("ticks", || fs::metadata(&log).is_ok_and(|m| m.len() > 20_000));
        for count in [1, 2] {
            run.signal("USR1");
            run.wait_until("a pair of checkpoints", || pairs(&out) >= count);
        }
        run.signal("INT");
        run.wait().expect(130);
        // In real time a process that has passed over the tick takes its own with the next pair.
        assert!(pairs(&out) == 3 && (mode == "realtime" || checkpoints(&out).len() == 6), "{:?}", checkpoints(&out));
    }
}

/// In real time a controller that stands still does not see the tick of the checkpoint. It is announced again.
#[test]
fn a_checkpoint_that_one_of_the_two_has_missed_is_taken_later() {
    let test_folder = TestFolder::new();
    let scenario = test_folder.endless_scenario("realtime");
    let mut run = test_folder.run(&[&scenario, "--mode", "realtime"]);
    run.wait_until_ticking();
    let (controller, folder) = (run.child_pid("tectum-controller"), test_folder.run_folder());
    signal_process(controller, "STOP");
    run.signal("USR1");
    run.wait_until("the plant's checkpoint", || {
        finished_checkpoints(&folder).iter().any(|name| name.contains("plant"))
    });
    assert_eq!(pairs(&folder), 0);
    signal_process(controller, "CONT");
    run.wait_until("a pair of checkpoints", || pairs(&folder) >= 1);
    run.signal("INT");
    run.wait().expect(130);
}

/// The names of the finished checkpoints, while others may be in progress.
fn finished_checkpoints(folder: &Path) -> Vec<String> {
    let entries = fs::read_dir(folder.join("checkpoints")).into_iter().flatten().flatten();
    let names = entries.map(|entry| entry.file_name().to_string_lossy().into_owned());
    names.filter(|name| name.ends_with(".safetensors")).collect()
}

/// The number of ticks of which both processes have a finished checkpoint.
fn pairs(folder: &Path) -> usize {
    let names = finished_checkpoints(folder);
    names
        .iter()
        .filter(|name| names.contains(&name.replace(".plant.", ".controller.")) && name.contains("plant"))
        .count()
}

#[test]
fn damaged_and_foreign_checkpoints_are_refused() {
    let test_folder = TestFolder::new();
    let scenario = test_folder.arm_scenario(&[]);
    test_folder.run(&[&scenario, "--ticks", "3000", "--checkpoint-every", "2000"]).wait().expect(0);
    let folder = test_folder.run_folder();
    for role in ["plant", "controller"] {
        fs::remove_file(folder.join(format!("checkpoints/3000.{role}.safetensors"))).unwrap();
    }
    let refused = |what: &str| {
        let outcome = test_folder.start(TECTUM, &["run", "--resume", "run", "--out", "second"]).wait().expect(2);
        assert!(outcome.stderr.contains(what) && outcome.stderr.lines().count() == 1, "{what}\n{outcome:#?}");
        assert!(!test_folder.path().join("second").exists());
    };
    let controller = folder.join("checkpoints/2000.controller.safetensors");
    let whole = fs::read(&controller).unwrap();
    let mut flipped = whole.clone();
    *flipped.last_mut().unwrap() ^= 1;
    fs::write(&controller, &flipped).unwrap();
    refused("run/checkpoints/2000.controller.safetensors: the checkpoint is damaged: its checksum does not fit");
    fs::write(&controller, &whole[..whole.len() / 2]).unwrap();
    refused("2000.controller.safetensors: the checkpoint is damaged");
    fs::copy(folder.join("checkpoints/2000.plant.safetensors"), &controller).unwrap();
    refused("its role is plant, here it is controller");
    fs::remove_file(&controller).unwrap();
    refused("there is no checkpoint of both plant and controller");

    // A checkpoint of another run of the same scenario.
    let other = ["run", &scenario, "--ticks", "3000", "--checkpoint-every", "2000", "--out", "other"];
    test_folder.start(TECTUM, &other).wait().expect(0);
    fs::copy(test_folder.path().join("other/checkpoints/2000.controller.safetensors"), &controller).unwrap();
    refused("the checkpoint does not fit: its run is ");
    fs::write(&controller, &whole).unwrap();
    let text = fs::read_to_string(folder.join("scenario.toml")).unwrap();
    fs::write(folder.join("scenario.toml"), text.replace("seed = 1", "seed = 2")).unwrap();
    refused("its scenario is ");
    fs::write(folder.join("scenario.toml"), text).unwrap();
    let nothing = test_folder.start(TECTUM, &["run", "--resume", "nowhere"]).wait().expect(2);
    assert!(nothing.stderr.contains("nowhere: this is not the folder of a run"), "{nothing:#?}");
    test_folder.start(TECTUM, &["run", "--resume", "run", "--out", "second"]).wait().expect(0);
}

/// Processes are killed in the resumed part, before and after the crash store holds its first state.
#[test]
fn a_resumed_run_survives_kills() {
    let test_folder = TestFolder::new();
    let scenario = test_folder.arm_scenario(&[]);
    append(&scenario, "\n[restart]\nbackoff_ms = 1\n");
    let whole = ["run", &scenario, "--ticks", "200000", "--out", "whole", "--json"];
    let whole = test_folder.start(TECTUM, &whole).wait().expect(0).json();
    let mut first = test_folder.run(&[&scenario, "--ticks", "200000", "--checkpoint-every", "1000"]);
    first.wait_until_ticking();
    first.signal("INT");
    first.wait().expect(130);
    let mut second = test_folder.start(TECTUM, &["run", "--resume", "run", "--out", "second", "--json"]);
    for program in ["tectum-controller", "tectum-simulator"] {
        let log = test_folder.path().join("second/log.mcap");
        second.wait_until("the log", || log.exists());
        let pid = second.child_pid(program);
        signal_process(pid, "KILL");
    }
    let second = second.wait().expect(0).json();
    assert_eq!(second["weights_hash"], whole["weights_hash"]);
    assert_eq!(second["restarts"].as_array().unwrap().len(), 2, "{second}");
}
