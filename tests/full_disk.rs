//! A disk that fills up during a run. The control loop continues, the log is closed and states the tick from which on
//! everything is missing, and the run's exit code reports it.

mod support;

use std::fs;
use std::path::Path;
use std::process::{Command, Stdio};

use serde_json::Value;
use support::content::read_log;
use support::{ProcessOutcome, TECTUM, TestFolder, assert_no_debris};

/// Checks what must hold for every kind of limit; the messages must contain `why`.
fn check(test_folder: &TestFolder, outcome: &ProcessOutcome, ticks: u64, why: &str) {
    let summary = outcome.json();
    assert_eq!((&summary["ticks"], &summary["ended"]), (&ticks.into(), &"complete".into()), "{outcome:#?}");
    assert!(summary["weights_hash"].is_string(), "the controller came to its end: {summary}");
    assert_no_debris(test_folder.run_folder());
    let (reader, content) = read_log(&test_folder.log_path());
    let missing = reader.missing_from().unwrap();
    assert!(reader.finished() && missing > 1000, "{missing}");
    let expected = format!("tectum: the log lacks everything from tick {} on: the log ", thousands(missing));
    let message = message(outcome);
    assert!(message.starts_with(&expected) && message.contains(why), "{outcome:#?}");
    let failure = Value::from(message.trim_start_matches("tectum: "));
    assert_eq!((summary["log_missing_from"].as_u64(), &summary["failure"]), (Some(missing), &failure));
    // The log is complete before that tick and states what is missing after it.
    let whole: Vec<(u64, u8)> = content.order.iter().copied().filter(|(tick, _)| *tick < missing).collect();
    assert!(whole.iter().copied().eq((0..missing).flat_map(|tick| [(tick, 0), (tick, 1), (tick, 2)])));
    let (totals, counts) =
        (reader.totals().unwrap(), [content.observations.len(), content.commands.len(), content.learnings.len()]);
    assert!(totals.complete && totals.last_tick == Some(ticks - 1), "the logger listened to the end: {totals:?}");
    for (i, count) in counts.into_iter().enumerate() {
        assert_eq!(count as u64 + totals.lost[i], ticks, "channel {i}");
        assert_eq!(content.gaps[i].first, count as u64, "channel {i}");
    }
    // `tectum log info` and `tectum replay` report it.
    let text = test_folder.start(TECTUM, &["log", "info", "run"]).wait().expect(0).stdout;
    assert!(text.contains(&format!("missing  from tick {missing} on: ")) && text.contains(why), "{text}");
    let info = test_folder.start(TECTUM, &["log", "info", "run", "--json"]).wait().expect(0).json();
    assert!(info["channels"].as_array().unwrap().iter().all(|channel| channel["agrees"] == true), "{info}");
    let text = test_folder.start(TECTUM, &["replay", "run"]).wait().expect(2).stderr;
    // The log may contain samples of that tick itself, up to the one that had no room.
    let last = if content.commands.last().is_some_and(|c| c.header.tick == missing) { missing } else { missing - 1 };
    assert!(text.contains(&format!("up to tick {last} it is what this build makes of it")), "{text}");
}

/// The one message. A run that takes longer than ten seconds has said before how far it is.
#[track_caller]
fn message(outcome: &ProcessOutcome) -> &str {
    let lines: Vec<&str> = outcome.stderr.lines().filter(|line| !line.contains(" ticks/s ")).collect();
    assert_eq!(lines.len(), 1, "{outcome:#?}");
    lines[0]
}

/// A number with a comma before the last three digits.
fn thousands(n: u64) -> String {
    let text = n.to_string();
    let (head, tail) = text.split_at(text.len().saturating_sub(3));
    if head.is_empty() { tail.to_owned() } else { format!("{head},{tail}") }
}

/// A limit on the size of files, which every user may set. It also applies to shared memory, so it is larger than the
/// channels' files.
#[test]
fn a_file_size_limit_closes_the_log_and_the_run_completes() {
    let test_folder = TestFolder::new();
    let scenario = test_folder.arm_scenario(&[("every", "1")]);
    let limited = format!("ulimit -f 8192; exec {TECTUM} run {scenario} --ticks 30000 --out run --json");
    let outcome = test_folder.start("/bin/sh", &["-c", &limited]).wait().expect(2);
    check(
        &test_folder,
        &outcome,
        30_000,
        "the limit on the size of a file is reached; raise the limit (ulimit -f) or thin the log",
    );
}

/// A file system in memory, which another program fills up during the run.
#[test]
fn a_full_disk_closes_the_log_and_the_run_completes() {
    if !may_mount() {
        eprintln!("skipped: user namespaces with a mount of their own are not allowed here");
        return;
    }
    let test_folder = TestFolder::new();
    let scenario = test_folder.arm_scenario(&[("every", "1")]);
    fs::create_dir(test_folder.path().join("disk")).unwrap();
    let script = format!(
        "mount -t tmpfs -o size=48m tmpfs disk || exit 9
         {TECTUM} run {scenario} --ticks 40000 --out disk/run --json & run=$!
         until [ -s disk/run/log.mcap ] && [ $(stat -c %s disk/run/log.mcap) -gt 1000000 ]; do sleep 0.001; done
         cat /dev/zero > disk/ballast 2> /dev/null
         wait $run; code=$?
         cp -r disk/run run; exit $code"
    );
    let arguments = ["-r", "-m", "sh", "-c", &script];
    let outcome = test_folder.start(Path::new("unshare"), &arguments).wait().expect(2);
    check(&test_folder, &outcome, 40_000, "no space left on device; free some space");
}

fn may_mount() -> bool {
    let mount = "mount -t tmpfs tmpfs /mnt";
    let status = Command::new("unshare").args(["-r", "-m", "sh", "-c", mount]).stderr(Stdio::null()).status();
    status.is_ok_and(|status| status.success())
}
