//! Runs without a planned end: logs in segments, of which the oldest are removed; few checkpoints; restarts without a
//! bound.

mod support;

use std::fs;
use std::path::{Path, PathBuf};
use std::time::Duration;

use serde_json::Value;
use support::{TECTUM, TestFolder, append};
use tectum::log::{LogReader, LogRecord, RunLog, segments};

fn run(test_folder: &TestFolder, arguments: &[&str]) -> Value {
    test_folder.start(TECTUM, &[&["run", "--json"], arguments].concat()).wait().expect(0).json()
}

/// Ticks of the observations in a log of several segments.
fn ticks(folder: &Path) -> Vec<u64> {
    let records = RunLog::open(&segments(folder)).unwrap().map(Result::unwrap);
    let tick = |record: LogRecord| match record {
        LogRecord::Observation(sample) => Some(sample.header.tick),
        LogRecord::Gap(gap) => panic!("nothing is missing: {gap:?}"),
        _ => None,
    };
    records.filter_map(tick).collect()
}

fn names(folder: &Path) -> Vec<String> {
    let name = |path: PathBuf| path.file_name().unwrap().to_str().unwrap().to_owned();
    segments(folder).into_iter().map(name).collect()
}

/// The paper's rule with every tick in its log, and more keys under `[log]`.
fn scenario(test_folder: &TestFolder, log: &str) -> String {
    let file = test_folder.arm_scenario(&[("every", "1")]);
    let text = fs::read_to_string(&file).unwrap();
    fs::write(&file, text.replacen("[log]\n", &format!("[log]\n{log}\n"), 1)).unwrap();
    file
}

/// A log in segments holds what one file holds, and replays.
#[test]
fn a_log_in_segments_is_one_log() {
    let test_folder = TestFolder::new();
    let file = scenario(&test_folder, "rotate = \"100 kB\"");
    let summary = run(&test_folder, &[&file, "--ticks", "1000", "--out", "size"]);
    let folder = test_folder.path().join("size");
    let count = segments(&folder).len();
    assert!((7..=9).contains(&count), "{:?}", names(&folder));
    assert_eq!((&summary["log_segments"], &summary["log_removed_segments"]), (&Value::from(count), &Value::from(0)));
    assert_eq!((&summary["lost"], &summary["failure"]), (&Value::from(0), &Value::Null));
    assert_eq!(ticks(&folder), (0..1000).collect::<Vec<_>>());
    test_folder.tectum("replay", &["size"]).expect(0);
    let info = test_folder.tectum("log", &["info", "size", "--json"]).expect(0).json();
    assert_eq!(info["segments"].as_array().unwrap().len(), count, "{info}");

    // By time: at the same ticks in every run.
    let file = scenario(&test_folder, "rotate = \"10 s\"");
    for out in ["one", "two"] {
        run(&test_folder, &[&file, "--ticks", "500", "--out", out]);
        let folder = test_folder.path().join(out);
        assert_eq!(names(&folder), ["log.mcap", "log-1.mcap", "log-2.mcap"]);
        assert_eq!(ticks(&folder).len(), 500);
        let first = |log: &str| LogReader::open(&folder.join(log)).unwrap().next().unwrap().unwrap();
        assert_eq!(first("log-1.mcap").header().unwrap().tick, 200);
    }
    // A segment that is missing in the middle is found.
    fs::remove_file(test_folder.path().join("one/log-1.mcap")).unwrap();
    let replay = test_folder.tectum("replay", &["one"]).expect(1);
    assert!(replay.stderr.contains("header.tick is 400, and should be 200"), "{replay:#?}");
}

/// An endless run keeps a log of limited size and few checkpoints; its logger is killed on the way.
#[test]
fn an_endless_run_stays_within_its_limits() {
    let test_folder = TestFolder::new();
    let file = scenario(&test_folder, "rotate = \"100 kB\"\nlimit_mb = 1.0\nsync_s = 0.1");
    append(&file, "\n[restart]\nbackoff_ms = 1\n");
    let arguments = ["run", &file, "--ticks", "endless", "--checkpoint-every", "200", "--keep-checkpoints", "3"];
    let mut run = test_folder.start(TECTUM, &[&arguments[..], &["--out", "run", "--json"]].concat());
    let folder = test_folder.path().join("run");
    let newest = || segments(&folder).len() >= 2 && !folder.join("log.mcap").exists();
    run.wait_until("the first segment's end", newest);
    let first = segments(&folder)[0].clone();
    run.kill_child("tectum-logger");
    run.wait_until("the removal of another", || !first.exists());
    run.signal("INT");
    let outcome = run.wait().expect(130);
    let summary = outcome.json();
    assert_eq!((&summary["ticks_planned"], &summary["log_missing_from"]), (&Value::Null, &Value::Null));
    assert!(summary["log_removed_segments"].as_u64() >= Some(2), "{summary}");
    assert!(summary["log_bytes"].as_u64() <= Some(1_200_000), "{summary}");
    assert_eq!(summary["failure"], Value::Null, "{summary}");
    // Each segment of 100 kB begins with an account, so that no more than one of them is read again, or nothing.
    assert!(summary["log_reread"].as_u64() < Some(1_000), "{summary}");
    let size: u64 = segments(&folder).iter().map(|path| fs::metadata(path).unwrap().len()).sum();
    assert_eq!(summary["log_bytes"].as_u64(), Some(size));
    let checkpoints = fs::read_dir(folder.join("checkpoints")).unwrap().count();
    assert_eq!(checkpoints, 6, "{checkpoints}");
    // What is left can be read, says what came before it, and cannot be replayed.
    let info = test_folder.tectum("log", &["info", "run"]).expect(0).stdout;
    assert!(info.contains("segments"), "{info}");
    let refused = test_folder.tectum("replay", &["run"]).expect(2).stderr;
    assert!(refused.contains("unless `[log] limit_mb` has removed the first"), "{refused}");
    let from = test_folder.start(TECTUM, &["run", "--from", "run", "--ticks", "100", "--out", "next"]);
    from.wait().expect(0);
}

/// Loggers that die before a segment is full keep the log within its limit.
#[test]
fn loggers_that_die_early_keep_the_limit() {
    let test_folder = TestFolder::new();
    let file = scenario(&test_folder, "rotate = \"64 MB\"\nlimit_mb = 10.0");
    let kills =
        "[[faults.process]]\nprocess = \"logger\"\ndo = \"kill\"\nat = [5000, 10000, 15000, 20000, 25000, 30000]\n";
    append(&file, &format!("\n[restart]\nbackoff_ms = 1\nhealthy_s = 0.0\n{kills}"));
    let summary = run(&test_folder, &[&file, "--ticks", "35000", "--out", "run"]);
    let (bytes, removed) = (summary["log_bytes"].as_u64().unwrap(), summary["log_removed_segments"].as_u64().unwrap());
    // 35,000 ticks are 26 MB. The last logger's own segment stays, and grows by what it writes.
    assert!(bytes < 17_000_000 && removed > 0, "{bytes} bytes, {removed} segments removed");
    assert_eq!(summary["lost"], 0, "{summary}");
}

/// More restarts than a board has pages, and the result is that of a run without any.
#[test]
#[ignore = "takes minutes; src/channel has a test of the boards alone"]
fn restarts_have_no_bound() {
    let test_folder = TestFolder::with_watchdog(Duration::from_secs(600));
    let file = test_folder.arm_scenario(&[("every", "1")]);
    let whole = run(&test_folder, &[&file, "--ticks", "20000", "--out", "whole"]);
    let at: Vec<String> = (1..=270).map(|i| (60 * i).to_string()).collect();
    let more = format!(
        "\n[restart]\nbackoff_ms = 0.0\nhealthy_s = 0.0\n[[faults.process]]\nprocess = \"controller\"\ndo = \"kill\"\n\
         at = [{}]\n",
        at.join(", ")
    );
    append(&file, &more);
    let killed = run(&test_folder, &[&file, "--ticks", "20000", "--out", "killed"]);
    assert_eq!(killed["weights_hash"], whole["weights_hash"]);
    let restarts = killed["restarts"].as_array().unwrap();
    assert!(restarts.len() > 256, "{}", restarts.len());
    println!("{} restarts in {} s", restarts.len(), killed["seconds"]);
}

#[test]
fn rules_of_rotation_are_checked() {
    let test_folder = TestFolder::new();
    for (log, what) in [
        ("rotate = \"10\"", "give a size or a time, such as 64 MB or 10 min"),
        ("rotate = 5", "rotate"),
        ("limit_mb = 100.0", "log.limit_mb limits a log of one segment"),
        ("rotate = \"1 MB\"\nlimit_mb = 0.1", "log.limit_mb is 0.1; give 1 to 1000000000 MB"),
        ("sync_s = 0.0", "log.sync_s is 0"),
    ] {
        let text = test_folder.refused("run", &[&scenario(&test_folder, log)]);
        assert!(text.contains(what), "{text}");
    }
    let text = test_folder.tectum("run", &["--keep-checkpoints", "1"]);
    assert!(text.code == Some(2) && text.stderr.contains("give 2 or more, or 0 for all"), "{text:#?}");
}
