//! A killed logger is restarted and continues in a new segment: nothing that was written is lost, and what is missing
//! is stated. Readers take the segments as one log, also across restarts of plant and controller.

mod support;

use std::fs;
use std::path::PathBuf;

use serde_json::Value;
use support::{Process, TestFolder, append, assert_no_debris, signal_process};
use tectum::log::{LogInfo, LogRecord, LogState, RunLog, find, segments};

/// The paper's arm with every tick in its log and with the quickest possible restarts.
fn scenario(test_folder: &TestFolder, changes: &[(&str, &str)]) -> String {
    let path = test_folder.arm_scenario(&[&[("every", "1")], changes].concat());
    append(&path, "\n[restart]\nbackoff_ms = 1\nbackoff_cap_ms = 5\ngive_up_after = 100\n");
    path
}

/// The size of all segments together.
fn log_size(test_folder: &TestFolder) -> u64 {
    segments(&test_folder.run_folder()).iter().map(|log| fs::metadata(log).map_or(0, |m| m.len())).sum()
}

/// Kills the run's `program` each time when all segments together have grown by another `bytes`.
fn kill_at_sizes(run: &mut Process, test_folder: &TestFolder, program: &str, times: u64, bytes: u64) {
    let mut pid = 0;
    for kill in 1..=times {
        run.wait_until("a log that grows", || log_size(test_folder) > kill * bytes);
        pid = run.next_child_pid(program, pid);
        signal_process(pid, "KILL");
    }
}

/// Checks the segmented log of a run of `ticks` ticks against the run's summary. Returns the segments.
fn check(test_folder: &TestFolder, summary: &Value, ticks: u64) -> Vec<PathBuf> {
    let files = find(&test_folder.run_folder()).unwrap();
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
    for (i, channel) in counts.channels.iter().enumerate() {
        assert_eq!((channel.contradictions, channel.unexplained), (0, 0), "channel {i}");
        assert_eq!(channel.stated, totals.lost[i], "channel {i}");
        assert_eq!(summary["lost_by_channel"][i], totals.lost[i], "channel {i}");
        assert_eq!(channel.messages + channel.stated, ticks, "channel {i}");
    }
    let info = LogInfo::of(&files).unwrap();
    assert!(info.agrees(), "{info:?}");
    assert_eq!(summary["log_segments"], files.len(), "{summary}");
    assert_eq!(summary["log_bytes"], info.bytes, "{summary}");
    for file in &files {
        // A file whose logger was killed before it had described the run is not a log.
        assert!(LogInfo::of(std::slice::from_ref(file)).map_or(true, |alone| alone.agrees()), "{}", file.display());
    }
    assert_no_debris(test_folder.run_folder());
    files
}

#[test]
fn in_lockstep_a_killed_logger_loses_nothing() {
    let test_folder = TestFolder::new();
    let scenario = scenario(&test_folder, &[]);
    let undisturbed =
        test_folder.tectum("run", &[&scenario, "--mode", "in-process", "--ticks", "60000", "--json", "--out", "one"]);
    let mut run = test_folder.run(&[&scenario, "--ticks", "60000", "--json"]);
    let first = test_folder.log_path();
    run.wait_until_ticking();
    let acknowledged = fs::read(&first).unwrap();
    kill_at_sizes(&mut run, &test_folder, "tectum-logger", 1, 2_000_000);
    run.wait_until("the next segment", || test_folder.run_folder().join("log-1.mcap").exists());
    let first_segment = fs::read(&first).unwrap();
    assert!(
        first_segment.len() > acknowledged.len() && first_segment.starts_with(&acknowledged),
        "what was written stays"
    );
    kill_at_sizes(&mut run, &test_folder, "tectum-logger", 5, 2_500_000);
    let summary = run.wait().expect(0).json();
    assert_eq!(summary["weights_hash"], undisturbed.expect(0).json()["weights_hash"]);
    let files = check(&test_folder, &summary, 60_000);
    assert!(files.len() >= 6, "{files:?}");
    assert!(fs::read(&first).unwrap() == first_segment, "a logger touches nothing but its own file");
    assert_eq!(summary["restarts"].as_array().unwrap().len(), 6, "{summary}");
    let text = test_folder.tectum("log", &["info", "run"]).expect(0).stdout;
    for words in ["state    ", " segments\n", "log.mcap ", "log-1.mcap ", "torn at byte "] {
        assert!(text.contains(words), "{words}: {text}");
    }

    // The logger before it had left its account: of the 180,000 messages only the last few thousand were read again.
    let reread = summary["log_reread"].as_u64().unwrap();
    assert!((1..20_000).contains(&reread), "{summary}");
    assert!(!test_folder.run_folder().join("logger.account.json").exists(), "the account goes with the run");

    // What was sent while the logger was away was still in the rings.
    assert_eq!(summary["lost"], 0, "{summary}");
    let done = test_folder.tectum("replay", &["run", "--json"]).expect(0).json();
    assert_eq!((&done["difference"], &done["commands"]), (&Value::Null, &60_000.into()), "{done}");
    let text = test_folder.tectum("replay", &["run/log-1.mcap"]).expect(2).stderr;
    assert!(text.contains("it is a later segment: give the run's folder"), "{text}");

    // After a repair all segments are whole and have the same content.
    let before = LogInfo::of(&files).unwrap();
    let text = test_folder.tectum("log", &["repair", "run"]).expect(0).stdout;
    assert!(text.matches(" was torn at byte ").count() >= 5, "{text}");
    let info = LogInfo::of(&files).unwrap();
    assert!(
        info.segments.iter().all(|segment| matches!(segment.state, LogState::Whole | LogState::Repaired)),
        "{info:?}"
    );
    assert_eq!((info.channels, info.gaps), (before.channels, before.gaps));
    let mut summary = summary;
    summary["log_bytes"] = info.bytes.into();
    check(&test_folder, &summary, 60_000);
}

#[test]
fn in_real_time_segments_report_the_runs_durations_and_losses() {
    let test_folder = TestFolder::new();
    let scenario = scenario(&test_folder, &[("period_ms", "2")]);
    let mut run = test_folder.run(&[&scenario, "--mode", "realtime", "--ticks", "100000", "--json"]);
    run.wait_until_ticking();
    kill_at_sizes(&mut run, &test_folder, "tectum-logger", 3, 200_000);
    run.wait_until("a log that grows on", || log_size(&test_folder) > 900_000);
    run.signal("INT");
    let summary = run.wait().expect(130).json();
    let files = find(&test_folder.run_folder()).unwrap();
    assert!(files.len() >= 4 && files.len() == summary["log_segments"].as_u64().unwrap() as usize, "{files:?}");
    let info = LogInfo::of(&files).unwrap();
    assert!(info.agrees() && !info.recounted, "{info:?}");
    let written: Vec<u64> = info.channels.iter().map(|channel| channel.messages).collect();
    for (i, channel) in info.channels.iter().enumerate() {
        assert_eq!(summary["lost_by_channel"][i], channel.lost_stated);
    }
    // A killed logger's segment holds the counts up to its last flush; the next logger continued from these.
    let lateness = info.wake_up_lateness_us.unwrap();
    assert_eq!(summary["wake_up_lateness_us"]["count"], lateness.count, "{summary}");
    assert!(lateness.count >= written[0]);
    assert_eq!(info.observation_to_command_us.unwrap().count, written[1]);
    assert!(info.command_to_applied_us.unwrap().count <= written[1]);
    let table = test_folder.tectum("log", &["csv", "run"]).expect(0).stdout;
    assert_eq!(table.lines().filter(|line| !line.starts_with(',')).count() as u64, 1 + written[0]);
    assert_no_debris(test_folder.run_folder());
}

/// In lockstep, restarts of plant and controller change nothing in the log except the incarnation numbers.
#[test]
fn a_replay_continues_across_restarts_of_plant_and_controller() {
    let test_folder = TestFolder::new();
    let scenario = scenario(&test_folder, &[]);
    let mut run = test_folder.run(&[&scenario, "--ticks", "20000", "--json"]);
    run.wait_until_ticking();
    kill_at_sizes(&mut run, &test_folder, "tectum-controller", 2, 1_000_000);
    run.wait_until("a log that grows on", || log_size(&test_folder) > 3_500_000);
    let plant = run.child_pid("tectum-simulator");
    signal_process(plant, "KILL");
    let summary = run.wait().expect(0).json();
    assert_eq!(summary["restarts"].as_array().unwrap().len(), 3, "{summary}");
    check(&test_folder, &summary, 20_000);
    let done = test_folder.tectum("replay", &["run", "--json"]).expect(0).json();
    assert_eq!((&done["difference"], &done["commands"]), (&Value::Null, &20_000.into()), "{done}");
    assert_eq!(done["weights_hash"], summary["weights_hash"]);
    let info = test_folder.tectum("log", &["info", "run", "--json"]).expect(0).json();
    let starts = |channel: usize| {
        let starts = info["channels"][channel]["incarnations"].as_array().unwrap();
        starts.iter().map(|start| start[0].as_u64().unwrap()).collect::<Vec<_>>()
    };
    assert_eq!((starts(0), starts(1), starts(2)), (vec![0, 1], vec![0, 1, 2], vec![0, 1, 2]), "{info}");
    // A restarted writer publishes its last sample again.
    let duplicates: u64 = info["channels"].as_array().unwrap().iter().map(|c| c["duplicates"].as_u64().unwrap()).sum();
    assert!(duplicates > 0, "{info}");
}

/// All other processes have finished. The restarted logger writes what the killed one had not written.
#[test]
fn a_logger_restarted_after_the_end_finishes_the_log() {
    let test_folder = TestFolder::new();
    let scenario = scenario(&test_folder, &[]);
    let mut run = test_folder.run(&[&scenario, "--mode", "realtime", "--ticks", "40", "--json"]);
    let logger = run.child_pid("tectum-logger");
    run.wait_until("a log", || fs::metadata(test_folder.log_path()).is_ok_and(|m| m.len() > 10_000));
    signal_process(logger, "STOP");
    let reports = ["plant.json", "controller.json"].map(|name| test_folder.run_folder().join(name));
    run.wait_until("the reports", || reports.iter().all(|path| path.exists()));
    signal_process(logger, "KILL");
    let summary = run.wait().expect(0).json();
    assert_eq!(summary["lost"], 0, "{summary}");
    let files = check(&test_folder, &summary, 40);
    assert_eq!(files.len(), 2);
}

/// A logger that is behind by more than a ring loses the oldest samples, and states them. A replay stops there.
#[test]
fn a_logger_that_is_too_far_behind_states_every_lost_sample() {
    let test_folder = TestFolder::new();
    let scenario = scenario(&test_folder, &[("period_ms", "1")]);
    let mut run = test_folder.run(&[&scenario, "--mode", "realtime", "--ticks", "4000", "--json"]);
    let logger = run.child_pid("tectum-logger");
    run.wait_until_ticking();
    signal_process(logger, "STOP");
    let reports = ["plant.json", "controller.json"].map(|name| test_folder.run_folder().join(name));
    run.wait_until("the reports", || reports.iter().all(|path| path.exists()));
    signal_process(logger, "CONT");
    let summary = run.wait().expect(0).json();
    assert!(summary["lost"].as_u64() > Some(0), "{summary}");
    let text = test_folder.tectum("replay", &["run"]).expect(2).stderr;
    assert!(text.contains("states a gap on channel ") && text.contains(" it is what this build makes of it"), "{text}");
}
