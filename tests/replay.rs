//! Invariant I3: a log replays bit for bit, and a log with one changed byte does not.

mod support;

use std::fs;
use std::path::Path;
use std::time::Duration;

use rand::{Rng as _, RngExt as _};
use serde_json::Value;
use support::bytes::{LoggedMessage, messages};
use support::{TestFolder, planner_scenario, read_json, stop_process_for};
use tectum::log::LogRecord;
use tectum::seed::stream;
use tectum::study::replay::{ReplayError, ReplayResult, replay};
use tectum::wire::{Command, Learning, Observation, flag};

/// Runs a built-in scenario with `more` appended to its text and with every tick in its log. Returns the log. The arm
/// learns by `learned-reward`, which is quick; planners have a test of their own.
fn recorded(test_folder: &TestFolder, scenario: &str, more: &str, arguments: &[&str]) -> Vec<u8> {
    let text = fs::read_to_string(format!("scenarios/{scenario}.toml")).unwrap();
    let (head, _) = text.split_once("\n[log]").unwrap();
    let head = head.replace("\"model-predictive\"", "\"learned-reward\"");
    let text = format!("{head}\n{more}\n[log]\nevery = 1\nhash_every = 10\npack = false\n");
    let scenario = test_folder.write_file("scenario.toml", text);
    let mut all = vec![scenario.to_str().unwrap()];
    all.extend(arguments);
    test_folder.run(&all).wait().expect(0);
    fs::read(test_folder.log_path()).unwrap()
}

/// A model with few imagined movements, so that debug builds are quick.
const QUICK: &str = "[learner.model]\nmovements = 4\nsteps = 1\nmemory = 64\n";

#[test]
fn lockstep_logs_of_all_kinds_replay() {
    for (scenario, more, ticks) in
        [("paper", "", 4000), ("arm", "", 150), ("eye", "", 2000), ("laplace", "", 1000), ("limited", "", 1000)]
    {
        let test_folder = TestFolder::new();
        recorded(&test_folder, scenario, more, &["--ticks", &ticks.to_string(), "--seed", "3", "--json"]);
        let done = test_folder.tectum("replay", &["run", "--json"]).expect(0).json();
        assert_eq!(done["difference"], Value::Null, "{scenario}");
        for (key, value) in [("observations", ticks), ("commands", ticks), ("learnings", ticks), ("unseen", 0)] {
            assert_eq!(done[key], value, "{scenario}: {done}");
        }
        assert_eq!(done["hashes"], ticks / 10 + 1, "{scenario}: {done}");
        assert_eq!((&done["plant_simulated"], &done["torn"]), (&true.into(), &false.into()));
        assert_eq!(done["warnings"], serde_json::json!([]));
        let summary = read_json(test_folder.run_folder().join("summary.json"));
        assert_eq!(done["weights_hash"], summary["weights_hash"], "{scenario}");
    }
}

/// A planner's log replays too, columns and hashes of its whole state included; the test set tests what it learned.
#[test]
fn a_planners_log_replays() {
    let test_folder = TestFolder::new();
    let scenario = planner_scenario(&test_folder, "pendulum", "");
    test_folder.run(&[&scenario, "--ticks", "210"]).wait().expect(0);
    let done = test_folder.tectum("replay", &["run", "--json"]).expect(0).json();
    assert_eq!((&done["difference"], &done["learnings"], &done["hashes"]), (&Value::Null, &210.into(), &4.into()));
    let summary = read_json(test_folder.run_folder().join("summary.json"));
    assert_eq!(done["weights_hash"], summary["weights_hash"]);
    let mut log = tectum::log::LogReader::open(&test_folder.log_path()).unwrap();
    let columns: Vec<_> = log
        .by_ref()
        .filter_map(
            |record| if let LogRecord::Learning(sample) = record.unwrap() { Some(sample.columns) } else { None },
        )
        .collect();
    // The last one is the operations of the tick, in millions.
    assert!(columns[200][7] > 0.1 && columns[200][7] < 25.0, "{:?}", columns[200]);
}

/// The bytes of a sample's header that hold its writer's incarnation.
const INCARNATION: std::ops::Range<usize> = 48..52;

/// Flips one bit at each of `n` positions in the samples of a log without checksums, and requires that every flip is
/// found. `undetectable` excludes flips that no other byte of the log contradicts.
fn flips_are_found(log: &[u8], n: usize, undetectable: impl Fn(&LoggedMessage, usize, u8) -> bool) {
    let test_folder = TestFolder::new();
    let (messages, end) = messages(log);
    let torn = &log[..end];
    let whole = replay(&[test_folder.write_file("torn.mcap", torn)], None, false).unwrap();
    assert_eq!((whole.difference, whole.torn), (None, true));
    let mut rng = stream(8, "flips");
    let mut found = [0; 2];
    // A later incarnation in a writer's last sample cannot be detected: nothing contradicts it.
    let last_offsets = [size_of::<Observation>(), size_of::<Command>(), size_of::<Learning>()]
        .map(|length| messages.iter().rfind(|message| message.length == length).map(|message| message.offset));
    while found[0] + found[1] < n {
        let message = messages[rng.random_range(0..messages.len())];
        let offset = rng.random_range(0..message.length);
        let mask = 1_u8 << (rng.next_u32() % 8);
        let last_incarnation = INCARNATION.contains(&offset) && last_offsets.contains(&Some(message.offset));
        if last_incarnation || undetectable(&message, offset, mask) {
            continue;
        }
        let mut bytes = torn.to_vec();
        bytes[message.offset + offset] ^= mask;
        match replay(&[test_folder.write_file("flipped.mcap", &bytes)], None, false) {
            Ok(ReplayResult { difference: Some(_), .. }) => found[0] += 1,
            Err(ReplayError::Log(_) | ReplayError::Lost { .. }) => found[1] += 1,
            other => panic!("bit {mask:#04x} of byte {offset} of {:?}: {other:?}", message.sample),
        }
    }
    assert!(found[0] > n / 2, "most are found by replay: {found:?}");
}

/// In lockstep with the simulator every byte of a sample is determined.
#[test]
fn every_flipped_byte_of_a_lockstep_log_is_found() {
    let log = recorded(&TestFolder::new(), "paper", "", &["--ticks", "200"]);
    flips_are_found(&log, 1500, |_, _, _| false);
    let log = recorded(&TestFolder::new(), "arm", QUICK, &["--ticks", "60"]);
    flips_are_found(&log, 150, |_, _, _| false);
}

/// A run in real time in which one program is stopped for a tenth of a second. Returns nothing when the machine was so
/// busy that the logger lost samples, or when too few ticks were missed.
fn stalled(program: &str) -> Option<(TestFolder, Vec<u8>)> {
    let test_folder = TestFolder::new();
    let scenario = test_folder.arm_scenario(&[("every", "1"), ("period_ms", "2"), ("hash_every", "10")]);
    let mut run = test_folder.run(&[&scenario, "--mode", "realtime", "--ticks", "400", "--json"]);
    let pid = run.child_pid(program);
    run.wait_until_ticking();
    stop_process_for(pid, Duration::from_millis(100));
    let summary = run.wait().expect(0).json();
    let log = fs::read(test_folder.log_path()).unwrap();
    (summary["lost"] == 0 && summary["missed"].as_u64() >= Some(20)).then_some((test_folder, log))
}

/// A log also replays with ticks that the controller did not receive and did not learn from, with held, decayed and
/// late commands, and with skipped ticks.
#[test]
fn real_time_logs_with_missed_ticks_replay_and_their_flips_are_found() {
    for program in ["tectum-controller", "tectum-simulator"] {
        let (test_folder, log) = (0..5)
            .find_map(|_| stalled(program))
            .expect("in each of five runs samples were lost or too few ticks missed");
        let done = test_folder.tectum("replay", &["run", "--json"]).expect(0).json();
        assert_eq!(done["difference"], Value::Null, "{done}");
        if program == "tectum-controller" {
            assert!(done["unseen"].as_u64() >= Some(10), "{done}");
        }
        let answered: Vec<u64> = messages(&log)
            .0
            .iter()
            .filter_map(|message| if let LogRecord::Command(c) = message.sample { Some(c.header.tick) } else { None })
            .collect();
        // Not detectable: the instant of an observation that has no command, and the flag of a late command.
        flips_are_found(&log, 700, |message, offset, mask| {
            let LogRecord::Observation(o) = message.sample else { return false };
            let late = (52..56).contains(&offset) && u32::from(mask) << (8 * (offset - 52)) == flag::LATE;
            let sensed = (32..40).contains(&offset) && answered.binary_search(&o.header.tick).is_err() && {
                let flipped = o.header.sensed_ns ^ (u64::from(mask) << (8 * (offset - 32)));
                (o.header.scheduled_ns..=o.header.published_ns).contains(&flipped)
            };
            late || sensed
        });
    }
}

#[test]
fn the_first_difference_is_named() {
    let test_folder = TestFolder::new();
    let log = recorded(&test_folder, "paper", "", &["--ticks", "300"]);
    let (messages, end) = messages(&log);
    let observation = messages
        .iter()
        .find(|message| matches!(message.sample, LogRecord::Observation(o) if o.header.tick == 100))
        .unwrap();
    let command = messages
        .iter()
        .find(|message| matches!(message.sample, LogRecord::Command(c) if c.header.tick == 200))
        .unwrap();
    let learning = messages
        .iter()
        .find(|message| matches!(message.sample, LogRecord::Learning(l) if l.header.tick == 290))
        .unwrap();
    let replay_error = |message: &LoggedMessage, offset: usize| {
        let mut bytes = log[..end].to_vec();
        bytes[message.offset + offset] ^= 1;
        test_folder.write_file("other.mcap", &bytes);
        let outcome = test_folder.tectum("replay", &["other.mcap", "--json"]).expect(1);
        assert_ne!(outcome.json()["difference"], Value::Null);
        outcome.stderr
    };
    // The first input, the reward, the first drawn command, and the weights hash.
    let text = replay_error(observation, 56);
    assert!(
        text.starts_with("tectum: the log other.mcap does not replay: at tick 100, channel observation, inputs[0] is ")
    );
    assert!(text.contains(", and should be "), "{text}");
    assert!(replay_error(observation, 248).contains("at tick 100, channel observation, reward is "));
    assert!(replay_error(command, 120).contains("at tick 200, channel command, drawn[0] is "));
    assert!(replay_error(learning, 168).contains("at tick 290, channel learning, weights_hash is "));
    // A log that still has its checksums is also replayed only to the difference.
    let mut whole = log.clone();
    whole[command.offset + 120] ^= 1;
    test_folder.write_file("whole.mcap", &whole);
    assert!(
        test_folder
            .tectum("replay", &["whole.mcap"])
            .expect(1)
            .stderr
            .contains("at tick 200, channel command, drawn[0] is ")
    );
}

#[test]
fn logs_that_cannot_be_replayed_are_refused_with_a_remedy() {
    let test_folder = TestFolder::new();
    let scenario = test_folder.arm_scenario(&[("every", "7")]);
    test_folder.run(&[&scenario, "--ticks", "100"]).wait().expect(0);
    let text = test_folder.tectum("replay", &["run"]).expect(2).stderr;
    assert!(text.contains("holds every 7th tick only") && text.contains("`every = 1` under [log]"), "{text}");
    let text = test_folder.tectum("replay", &["nowhere"]).expect(2).stderr;
    assert_eq!(text.trim(), "tectum: nowhere does not exist; give a log, or the folder of a run");
}

/// A log of another build gives only a note: the replay itself shows whether the difference matters.
#[test]
fn a_log_of_another_build_is_replayed_with_a_note() {
    let test_folder = TestFolder::new();
    let log = recorded(&test_folder, "paper", "", &["--ticks", "100"]);
    let (_, end) = messages(&log);
    let mut bytes = log[..end].to_vec();
    let build = tectum::BUILD.as_bytes();
    while let Some(at) = bytes.windows(build.len()).position(|w| w == build) {
        bytes[at] = b'9';
    }
    test_folder.write_file("other.mcap", &bytes);
    let done = test_folder.tectum("replay", &["other.mcap", "--json"]).expect(0).json();
    let note = done["warnings"][0].as_str().unwrap();
    assert!(note.starts_with("the log was written by build 9") && note.ends_with(tectum::BUILD), "{note}");
}

/// Off-policy learning with the log's own rule from the same start must give what the log's learner has learned.
#[test]
fn another_learner_learns_from_the_same_experience() {
    let test_folder = TestFolder::new();
    recorded(&test_folder, "paper", "", &["--ticks", "2000"]);
    let learned_from_log = |rule: &str| {
        let done = test_folder.tectum("replay", &["run", "--learner", rule, "--json"]).expect(0).json();
        assert_eq!((&done["other"]["rule"], &done["other"]["off_policy"]), (&rule.into(), &true.into()));
        assert_eq!((&done["other"]["learned"], &done["other"]["cuts"]), (&1999.into(), &0.into()), "{done}");
        (done["other"]["distance"].as_f64().unwrap(), done["other"]["weights_norm"].as_f64().unwrap(), done)
    };
    // The applied command minus the mean equals the noise except in its last bits.
    let (distance, norm, _) = learned_from_log("paper");
    assert!(distance < 1e-8 && norm > 1e-4, "{distance} {norm}");
    let (distance, norm, done) = learned_from_log("baseline");
    assert!(distance > 1e-6 && norm > 1e-4, "{distance} {norm}");
    assert_ne!(done["other"]["weights_hash"], done["weights_hash"]);
    let text = test_folder.tectum("replay", &["run", "--learner", "actor-critic"]).expect(0).stdout;
    assert!(text.contains("off-policy    actor-critic, which did not choose the commands"), "{text}");

    // A model of the reward is learned from the commands alone, whichever learner chose them: the result is equal bit
    // for bit.
    let test_folder = TestFolder::new();
    recorded(&test_folder, "arm", "", &["--ticks", "100"]);
    let done = test_folder.tectum("replay", &["run", "--learner", "learned-reward", "--json"]).expect(0).json();
    assert_eq!(done["other"]["weights_hash"], done["weights_hash"]);
    assert_eq!(done["other"]["distance"], 0.0);
}

/// The message names the gap and the last tick that could be replayed.
#[test]
fn a_log_with_losses_is_replayed_up_to_the_first_gap() {
    use tectum::log::{LogClock, LogHeader, LogReader, LogTotals, LogWriter};
    use tectum::scenario::Scenario;
    use tectum::wire::Gap;
    let test_folder = TestFolder::new();
    recorded(&test_folder, "paper", "", &["--ticks", "100"]);
    let mut log = LogReader::open(&test_folder.log_path()).unwrap();
    let plan = Scenario::parse(log.scenario(), "log").unwrap().plan().unwrap();
    let run = u64::from_str_radix(log.run("run").unwrap(), 16).unwrap();
    let header = LogHeader { clock: LogClock::Virtual, ..LogHeader::new(&plan, run, "lockstep", Default::default()) };
    let path = test_folder.path().join("lossy.mcap");
    let mut lossy = LogWriter::create(Path::new(&path), &header).unwrap();
    for record in log.by_ref().map(Result::unwrap) {
        match record {
            LogRecord::Command(c) if c.header.tick == 40 => {
                lossy.append(&LogRecord::Gap(Gap { channel: 1, first: 40, count: 1, total: 1 })).unwrap();
            }
            other => lossy.append(&other).unwrap(),
        }
    }
    lossy.finish(&LogTotals { lost: [0, 1, 0], last_tick: Some(99), complete: true, ..LogTotals::default() }).unwrap();
    let text = test_folder.tectum("replay", &["lossy.mcap"]).expect(2).stderr;
    for words in [
        "a gap on channel command, 1 missing from sequence number 40 on",
        "up to tick 39 it is",
        "(ticks 40 to 99)",
        "lockstep",
    ] {
        assert!(text.contains(words), "{words}: {text}");
    }
}
