//! Checkpoints of real runs: when they are written, that a run goes on from one to the very end of an uninterrupted one, and
//! that nothing but a whole checkpoint of the same run is gone on from.

mod support;

use std::fs;
use std::path::Path;

use support::{Place, TECTUM};
use tectum::log::{LogReader, LogRecord};

fn checkpoints(folder: &Path) -> Vec<String> {
    let entries = fs::read_dir(folder.join("checkpoints")).into_iter().flatten().flatten();
    let mut names: Vec<_> = entries.map(|e| e.file_name().into_string().unwrap()).collect();
    names.sort_by_key(|name| {
        (name.split('.').next().unwrap().parse::<u64>().expect("nothing but checkpoints"), name.clone())
    });
    names
}

/// The samples of a log, without what tells runs and starts apart.
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

/// Simulator, learner and log: the whole is one run.
#[test]
fn an_interrupted_run_goes_on_as_if_it_had_not_been() {
    for (scenario, ticks, every) in [("paper", "60000", "1000"), ("arm", "900", "100"), ("eye", "60000", "1000")] {
        let place = Place::new();
        let text = fs::read_to_string(format!("scenarios/{scenario}.toml")).unwrap();
        let text: Vec<_> = text.lines().map(|l| if l.starts_with("every = ") { "every = 1" } else { l }).collect();
        let file = place.file("scenario.toml", text.join("\n"));
        let file = file.to_str().unwrap();
        let run = |arguments: &[&str]| place.start(TECTUM, &[&["run"], arguments].concat());
        run(&[file, "--ticks", ticks, "--out", "whole"]).wait().expect(0);

        let log = place.path().join("run/log.mcap");
        let mut first = place.run(&[file, "--ticks", ticks, "--checkpoint-every", every]);
        first.until("a grown log", || fs::metadata(&log).is_ok_and(|m| m.len() > 200_000));
        first.signal("INT");
        first.wait().expect(130);
        // One of each at the end, unless the machine was so busy that there was no time for it within the second.
        let second = run(&["--resume", "run", "--out", "second", "--json"]).wait().expect(0).json();
        let from = second["resumed_at"].as_u64().unwrap();
        assert!(from > 0 && from < ticks.parse().unwrap(), "{second}");
        let whole = fs::read_to_string(place.path().join("whole/summary.json")).unwrap();
        let whole: serde_json::Value = serde_json::from_str(&whole).unwrap();
        for key in ["weights_hash", "ticks", "last", "end_error_m", "missed", "clamped"] {
            assert_eq!(second[key], whole[key], "{scenario}: {key}");
        }
        let mut pieces = samples(&log);
        pieces.retain(|record| tick(record) < from);
        pieces.extend(samples(&place.path().join("second/log.mcap")));
        assert!(pieces == samples(&place.path().join("whole/log.mcap")), "{scenario}");
        // Their last states are the same, to the byte, but for the run's id.
        let end = format!("checkpoints/{ticks}.controller.safetensors");
        let [a, b] = ["whole", "second"].map(|run| fs::read(place.path().join(run).join(&end)).unwrap().len());
        assert_eq!(a, b);
        let again = run(&["--resume", "second"]).wait().expect(2);
        assert!(again.stderr.contains("the run came to its end"), "{again:#?}");
    }
}

#[test]
fn checkpoints_come_every_so_many_ticks_and_when_asked_for() {
    let place = Place::new();
    let scenario = place.arm(&[]);
    place.run(&[&scenario, "--ticks", "5000", "--checkpoint-every", "2000"]).wait().expect(0);
    let expected: Vec<_> = ["2000", "4000", "5000"]
        .iter()
        .flat_map(|tick| ["controller", "plant"].map(|role| format!("{tick}.{role}.safetensors")))
        .collect();
    assert_eq!(checkpoints(&place.run_folder()), expected);

    let place = Place::new();
    for mode in ["lockstep", "realtime"] {
        let out = place.path().join(mode);
        let scenario = place.endless(mode);
        let all = ["run", &scenario, "--mode", mode, "--out", mode];
        let mut run = place.start(TECTUM, &all);
        let log = out.join("log.mcap");
        run.until("ticks", || fs::metadata(&log).is_ok_and(|m| m.len() > 20_000));
        for count in [2, 4] {
            run.signal("USR1");
            run.until("a pair of checkpoints", || checkpoints_or_drafts(&out) >= count);
        }
        run.signal("INT");
        run.wait().expect(130);
        assert_eq!(checkpoints(&out).len(), 6, "{mode}");
    }
}

/// Whole checkpoints, while others may be being written.
fn checkpoints_or_drafts(folder: &Path) -> usize {
    let entries = fs::read_dir(folder.join("checkpoints")).into_iter().flatten().flatten();
    entries.filter(|e| e.file_name().to_string_lossy().ends_with(".safetensors")).count()
}

#[test]
fn nothing_is_resumed_from_what_does_not_fit() {
    let place = Place::new();
    let scenario = place.arm(&[]);
    place.run(&[&scenario, "--ticks", "3000", "--checkpoint-every", "2000"]).wait().expect(0);
    let folder = place.run_folder();
    for role in ["plant", "controller"] {
        fs::remove_file(folder.join(format!("checkpoints/3000.{role}.safetensors"))).unwrap();
    }
    let refused = |what: &str| {
        let outcome = place.start(TECTUM, &["run", "--resume", "run", "--out", "second"]).wait().expect(2);
        assert!(outcome.stderr.contains(what) && outcome.stderr.lines().count() == 1, "{what}\n{outcome:#?}");
        assert!(!place.path().join("second").exists());
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

    // Another run's, of the same scenario.
    let other = ["run", &scenario, "--ticks", "3000", "--checkpoint-every", "2000", "--out", "other"];
    place.start(TECTUM, &other).wait().expect(0);
    fs::copy(place.path().join("other/checkpoints/2000.controller.safetensors"), &controller).unwrap();
    refused("the checkpoint does not fit: its run is ");
    fs::write(&controller, &whole).unwrap();
    let text = fs::read_to_string(folder.join("scenario.toml")).unwrap();
    fs::write(folder.join("scenario.toml"), text.replace("seed = 1", "seed = 2")).unwrap();
    refused("its scenario is ");
    fs::write(folder.join("scenario.toml"), text).unwrap();
    let nothing = place.start(TECTUM, &["run", "--resume", "nowhere"]).wait().expect(2);
    assert!(nothing.stderr.contains("nowhere: this is not the folder of a run"), "{nothing:#?}");
    place.start(TECTUM, &["run", "--resume", "run", "--out", "second"]).wait().expect(0);
}

/// A kill in the resumed part, before and after the first state is kept there.
#[test]
fn a_resumed_run_survives_kills_too() {
    let place = Place::new();
    let scenario = place.arm(&[]);
    let quick = "\n[restart]\nbackoff_ms = 1\n";
    fs::write(&scenario, fs::read_to_string(&scenario).unwrap() + quick).unwrap();
    let whole = ["run", &scenario, "--ticks", "200000", "--out", "whole", "--json"];
    let whole = place.start(TECTUM, &whole).wait().expect(0).json();
    let mut first = place.run(&[&scenario, "--ticks", "200000", "--checkpoint-every", "1000"]);
    first.until_ticking();
    first.signal("INT");
    first.wait().expect(130);
    let mut second = place.start(TECTUM, &["run", "--resume", "run", "--out", "second", "--json"]);
    for program in ["tectum-controller", "tectum-simulator"] {
        let log = place.path().join("second/log.mcap");
        second.until("the log", || log.exists());
        let member = second.member(program);
        support::signal_process(member, "KILL");
    }
    let second = second.wait().expect(0).json();
    assert_eq!(second["weights_hash"], whole["weights_hash"]);
    assert_eq!(second["restarts"].as_array().unwrap().len(), 2, "{second}");
}
