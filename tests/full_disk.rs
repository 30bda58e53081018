//! A disk that fills up while a run goes on: the loop goes on, the log is closed and says from which tick on it lacks
//! everything, and the run's exit code says so.

mod support;

use std::fs;
use std::path::Path;
use std::process::{Command, Stdio};

use serde_json::Value;
use support::content::read;
use support::{Outcome, Place, TECTUM, assert_no_debris};

/// What holds, whatever the limit was; `why` is said of it.
fn check(place: &Place, outcome: &Outcome, ticks: u64, why: &str) {
    let summary = outcome.json();
    assert_eq!((&summary["ticks"], &summary["ended"]), (&ticks.into(), &"complete".into()), "{outcome:#?}");
    assert!(summary["weights_hash"].is_string(), "the controller came to its end: {summary}");
    assert_no_debris(&place.run_folder());
    let (reader, content) = read(&place.run_folder().join("log.mcap"));
    let missing = reader.missing_from().unwrap();
    assert!(reader.finished() && missing > 1000, "{missing}");
    let expected = format!("tectum: the log lacks everything from tick {} on: the log ", thousands(missing));
    assert!(outcome.stderr.starts_with(&expected) && outcome.stderr.contains(why), "{outcome:#?}");
    assert_eq!(outcome.stderr.lines().count(), 1, "{outcome:#?}");
    assert_eq!((summary["log_missing_from"].as_u64(), &summary["failure"]), (Some(missing), &said(outcome)));
    // All before that tick is there, and what is missing behind is stated.
    let whole: Vec<(u64, u8)> = content.order.iter().copied().filter(|(tick, _)| *tick < missing).collect();
    assert!(whole.iter().copied().eq((0..missing).flat_map(|tick| [(tick, 0), (tick, 1), (tick, 2)])));
    let (totals, counts) =
        (reader.totals().unwrap(), [content.observations.len(), content.commands.len(), content.learnings.len()]);
    assert!(totals.complete && totals.last_tick == Some(ticks - 1), "the logger listened to the end: {totals:?}");
    for (i, count) in counts.into_iter().enumerate() {
        assert_eq!(count as u64 + totals.lost[i], ticks, "channel {i}");
        assert_eq!(content.gaps[i].first, count as u64, "channel {i}");
    }
    // And anybody can see it.
    let text = place.start(TECTUM, &["log", "info", "run"]).wait().expect(0).stdout;
    assert!(text.contains(&format!("missing  from tick {missing} on: ")) && text.contains(why), "{text}");
    let info = place.start(TECTUM, &["log", "info", "run", "--json"]).wait().expect(0).json();
    assert!(info["channels"].as_array().unwrap().iter().all(|channel| channel["agrees"] == true), "{info}");
    let text = place.start(TECTUM, &["replay", "run"]).wait().expect(2).stderr;
    // Of the tick itself, what came before the sample without room may be there.
    let last = if content.commands.last().is_some_and(|c| c.header.tick == missing) { missing } else { missing - 1 };
    assert!(text.contains(&format!("up to tick {last} it is what this build makes of it")), "{text}");
}

/// The message, without the program's name.
fn said(outcome: &Outcome) -> Value {
    outcome.stderr.trim().trim_start_matches("tectum: ").into()
}

fn thousands(n: u64) -> String {
    let text = n.to_string();
    let (head, tail) = text.split_at(text.len().saturating_sub(3));
    if head.is_empty() { tail.to_owned() } else { format!("{head},{tail}") }
}

/// By way of a limit on the size of files, which anybody may set. (It counts for shared memory too, so it lies above what
/// the channels need.)
#[test]
fn a_limit_on_the_size_of_files() {
    let place = Place::new();
    let scenario = place.arm(&[("every", "1")]);
    let limited = format!("ulimit -f 8192; exec {TECTUM} run {scenario} --ticks 30000 --out run --json");
    let outcome = place.start("/bin/sh", &["-c", &limited]).wait().expect(2);
    check(
        &place,
        &outcome,
        30_000,
        "the limit on the size of a file is reached; raise the limit (ulimit -f) or thin the log",
    );
}

/// A disk of its own, in memory, which somebody else fills up while the run goes on.
#[test]
fn a_disk_that_somebody_fills_up() {
    if !may_mount() {
        eprintln!("user namespaces with a mount of their own are not allowed here: not tested");
        return;
    }
    let place = Place::new();
    let scenario = place.arm(&[("every", "1")]);
    fs::create_dir(place.path().join("disk")).unwrap();
    let script = format!(
        "mount -t tmpfs -o size=48m tmpfs disk || exit 9
         {TECTUM} run {scenario} --ticks 40000 --out disk/run --json & run=$!
         until [ -s disk/run/log.mcap ] && [ $(stat -c %s disk/run/log.mcap) -gt 1000000 ]; do sleep 0.001; done
         cat /dev/zero > disk/ballast 2> /dev/null
         wait $run; code=$?
         cp -r disk/run run; exit $code"
    );
    let arguments = ["-r", "-m", "sh", "-c", &script];
    let outcome = place.start(Path::new("unshare"), &arguments).wait().expect(2);
    check(&place, &outcome, 40_000, "no space left on device; free some space");
}

fn may_mount() -> bool {
    let try_it = "mount -t tmpfs tmpfs /mnt";
    let tried = Command::new("unshare").args(["-r", "-m", "sh", "-c", try_it]).stderr(Stdio::null()).status();
    tried.is_ok_and(|status| status.success())
}
