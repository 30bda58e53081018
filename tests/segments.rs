//! A logger that is killed comes back and goes on in a segment of its own: nothing that was written is lost, and what is missing
//! is stated. Readers take the segments as one log, also where plant and controller came back.

mod support;

use std::fs;
use std::path::PathBuf;

use serde_json::Value;
use support::{Outcome, Place, Process, TECTUM, assert_no_debris, children, signal_process};
use tectum::log::{LogInfo, LogRecord, LogState, RunLog, find, segments};

/// The paper's arm with every tick in its log, and restarts as quick as they can be.
fn scenario(place: &Place, changes: &[(&str, &str)]) -> String {
    let path = place.arm(&[&[("every", "1")], changes].concat());
    let quick = "\n[restart]\nbackoff_ms = 1\nbackoff_cap_ms = 5\ngive_up_after = 100\n";
    let text = fs::read_to_string(&path).unwrap() + quick;
    fs::write(&path, text).unwrap();
    path
}

fn size(place: &Place) -> u64 {
    segments(&place.run_folder()).iter().map(|log| fs::metadata(log).map_or(0, |m| m.len())).sum()
}

/// Kills the run's `program` each time when all segments together have grown by another `bytes`.
fn strike(run: &mut Process, place: &Place, program: &str, times: u64, bytes: u64) {
    let mut last = 0;
    for strike in 1..=times {
        run.until("a log that grows", || size(place) > strike * bytes);
        let parent = run.id();
        run.until("the process, or its successor", || {
            let there = children(parent).into_iter().find(|(pid, name)| name == program && *pid != last);
            last = there.map_or(last, |(pid, _)| pid);
            there_is(&children(parent), program, last)
        });
        signal_process(last, "KILL");
    }
}

fn there_is(children: &[(u32, String)], program: &str, pid: u32) -> bool {
    children.iter().any(|(other, name)| *other == pid && name == program)
}

fn tectum(place: &Place, arguments: &[&str]) -> Outcome {
    place.start(TECTUM, arguments).wait()
}

/// All that holds of a log in segments of a run of `ticks` ticks with the summary `summary`.
fn check(place: &Place, summary: &Value, ticks: u64) -> Vec<PathBuf> {
    let files = find(&place.run_folder()).unwrap();
    let mut log = RunLog::open(&files).unwrap();
    let mut counts = log.message_counts();
    let mut order = Vec::new();
    for record in log.by_ref() {
        let record = record.unwrap();
        counts.take(&record);
        let channel = match record {
            LogRecord::Observation(_) => 0,
            LogRecord::Command(_) => 1,
            LogRecord::Learning(_) => 2,
            LogRecord::Gap(_) => continue,
        };
        order.push((record.header().unwrap().tick, channel));
    }
    assert!(log.finished() && order.is_sorted(), "merged by tick over all segments");
    assert!(order.windows(2).all(|pair| pair[0] != pair[1]), "nothing twice");
    let totals = log.totals().unwrap();
    assert!(totals.complete && totals.missing_from.is_none());
    for (i, lane) in counts.channels.iter().enumerate() {
        assert_eq!((lane.contradictions, lane.unexplained), (0, 0), "channel {i}");
        assert_eq!(lane.stated, totals.lost[i], "channel {i}");
        assert_eq!(summary["lost_by_channel"][i], totals.lost[i], "channel {i}");
        assert_eq!(lane.messages + lane.stated, ticks, "channel {i}");
    }
    let info = LogInfo::of(&files).unwrap();
    assert!(info.agrees(), "{info:?}");
    assert_eq!(summary["log_segments"], files.len(), "{summary}");
    assert_eq!(summary["log_bytes"], info.bytes, "{summary}");
    for file in &files {
        // One whose logger was killed before it had described the run is no log.
        assert!(LogInfo::of(std::slice::from_ref(file)).map_or(true, |alone| alone.agrees()), "{}", file.display());
    }
    assert_no_debris(&place.run_folder());
    files
}

#[test]
fn in_lockstep_a_logger_that_is_killed_costs_what_it_says() {
    let place = Place::new();
    let scenario = scenario(&place, &[]);
    let undisturbed =
        tectum(&place, &["run", &scenario, "--mode", "in-process", "--ticks", "60000", "--json", "--out", "one"]);
    let mut run = place.run(&[&scenario, "--ticks", "60000", "--json"]);
    let first = place.run_folder().join("log.mcap");
    run.until_ticking();
    let acknowledged = fs::read(&first).unwrap();
    strike(&mut run, &place, "tectum-logger", 1, 2_000_000);
    run.until("the next segment", || place.run_folder().join("log-1.mcap").exists());
    let left = fs::read(&first).unwrap();
    assert!(left.len() > acknowledged.len() && left.starts_with(&acknowledged), "what was written stays");
    strike(&mut run, &place, "tectum-logger", 5, 2_500_000);
    let summary = run.wait().expect(0).json();
    assert_eq!(summary["weights_hash"], undisturbed.expect(0).json()["weights_hash"]);
    let files = check(&place, &summary, 60_000);
    assert!(files.len() >= 6, "{files:?}");
    assert!(fs::read(&first).unwrap() == left, "a logger touches nothing but its own file");
    assert_eq!(summary["restarts"].as_array().unwrap().len(), 6, "{summary}");
    let text = tectum(&place, &["log", "info", "run"]).expect(0).stdout;
    for words in ["state    ", " segments\n", "log.mcap ", "log-1.mcap ", "torn at byte "] {
        assert!(text.contains(words), "{words}: {text}");
    }

    // A replay goes as far as nothing is missing.
    let text = tectum(&place, &["replay", "run"]).expect(2).stderr;
    assert!(text.contains("states a gap on channel ") && text.contains(" it is what this build makes of it"), "{text}");
    let text = tectum(&place, &["replay", "run/log-1.mcap"]).expect(2).stderr;
    assert!(text.contains("it is a later segment: give the run's folder"), "{text}");

    // All segments made whole, and they say what they said.
    let before = LogInfo::of(&files).unwrap();
    let text = tectum(&place, &["log", "repair", "run"]).expect(0).stdout;
    assert!(text.matches(" was torn at byte ").count() >= 5, "{text}");
    let info = LogInfo::of(&files).unwrap();
    assert!(
        info.segments.iter().all(|segment| matches!(segment.state, LogState::Whole | LogState::Repaired)),
        "{info:?}"
    );
    assert_eq!((info.channels, info.gaps), (before.channels, before.gaps));
    check(
        &place,
        &{
            let mut s = summary;
            s["log_bytes"] = info.bytes.into();
            s
        },
        60_000,
    );
}

#[test]
fn in_real_time_durations_and_losses_are_those_of_the_run() {
    let place = Place::new();
    let scenario = scenario(&place, &[("period_ms", "2")]);
    let mut run = place.run(&[&scenario, "--mode", "realtime", "--ticks", "100000", "--json"]);
    run.until_ticking();
    strike(&mut run, &place, "tectum-logger", 3, 200_000);
    run.until("a log that goes on", || size(&place) > 900_000);
    run.signal("INT");
    let summary = run.wait().expect(130).json();
    let files = find(&place.run_folder()).unwrap();
    assert!(files.len() >= 4 && files.len() == summary["log_segments"].as_u64().unwrap() as usize, "{files:?}");
    let info = LogInfo::of(&files).unwrap();
    assert!(info.agrees() && !info.recounted, "{info:?}");
    let written: Vec<u64> = info.channels.iter().map(|channel| channel.messages).collect();
    for (i, channel) in info.channels.iter().enumerate() {
        assert_eq!(summary["lost_by_channel"][i], channel.lost_stated);
    }
    // A logger that was killed counted what its segment holds, and the next one went on from there.
    let lateness = info.wake_up_lateness_us.unwrap();
    assert_eq!(summary["wake_up_lateness_us"]["count"], lateness.count, "{summary}");
    assert!(lateness.count >= written[0]);
    assert_eq!(info.observation_to_command_us.unwrap().count, written[1]);
    assert!(info.command_to_applied_us.unwrap().count <= written[1]);
    let table = tectum(&place, &["log", "csv", "run"]).expect(0).stdout;
    assert_eq!(table.lines().filter(|line| !line.starts_with(',')).count() as u64, 1 + written[0]);
    assert_no_debris(&place.run_folder());
}

/// In lockstep plant and controller come back as if nothing had been: so does their log, but for their start numbers.
#[test]
fn a_replay_goes_over_the_returns_of_plant_and_controller() {
    let place = Place::new();
    let scenario = scenario(&place, &[]);
    let mut run = place.run(&[&scenario, "--ticks", "20000", "--json"]);
    run.until_ticking();
    strike(&mut run, &place, "tectum-controller", 2, 1_000_000);
    run.until("a log that goes on", || size(&place) > 3_500_000);
    let plant = run.member("tectum-simulator");
    signal_process(plant, "KILL");
    let summary = run.wait().expect(0).json();
    assert_eq!(summary["restarts"].as_array().unwrap().len(), 3, "{summary}");
    check(&place, &summary, 20_000);
    let done = tectum(&place, &["replay", "run", "--json"]).expect(0).json();
    assert_eq!((&done["difference"], &done["commands"]), (&Value::Null, &20_000.into()), "{done}");
    assert_eq!(done["weights_hash"], summary["weights_hash"]);
    let info = tectum(&place, &["log", "info", "run", "--json"]).expect(0).json();
    let starts = |channel: usize| {
        let starts = info["channels"][channel]["incarnations"].as_array().unwrap();
        starts.iter().map(|start| start[0].as_u64().unwrap()).collect::<Vec<_>>()
    };
    assert_eq!((starts(0), starts(1), starts(2)), (vec![0, 1], vec![0, 1, 2], vec![0, 1, 2]), "{info}");
    // A writer that comes back says again what it had said last.
    let twice: u64 = info["channels"].as_array().unwrap().iter().map(|c| c["duplicates"].as_u64().unwrap()).sum();
    assert!(twice > 0, "{info}");
}

/// Everybody else has finished; what the logger that was killed had not written is stated by the next.
#[test]
fn a_logger_that_comes_back_after_the_end_finishes_the_log() {
    let place = Place::new();
    let scenario = scenario(&place, &[]);
    let mut run = place.run(&[&scenario, "--mode", "realtime", "--ticks", "40", "--json"]);
    let logger = run.member("tectum-logger");
    run.until("a log", || fs::metadata(place.run_folder().join("log.mcap")).is_ok_and(|m| m.len() > 10_000));
    signal_process(logger, "STOP");
    let reports = ["plant.json", "controller.json"].map(|name| place.run_folder().join(name));
    run.until("the reports", || reports.iter().all(|path| path.exists()));
    signal_process(logger, "KILL");
    let summary = run.wait().expect(0).json();
    assert!(summary["lost"].as_u64() > Some(0), "{summary}");
    let files = check(&place, &summary, 40);
    assert_eq!(files.len(), 2);
}
