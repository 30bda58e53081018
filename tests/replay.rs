//! Invariant I3: a log replays, bit for bit, and with one byte changed it does not.

mod support;

use std::fs;
use std::path::Path;
use std::time::Duration;

use rand::{Rng as _, RngExt as _};
use serde_json::Value;
use support::bytes::{Body, bodies};
use support::{Outcome, Place, TECTUM, signal_process};
use tectum::log::LogRecord;
use tectum::seed::stream;
use tectum::study::replay::{ReplayError, ReplayResult, replay};
use tectum::wire::{Command, Learning, Observation, flag};

fn replayed(place: &Place, arguments: &[&str]) -> Outcome {
    let mut all = vec!["replay"];
    all.extend(arguments);
    place.start(TECTUM, &all).wait()
}

/// A run of a built-in scenario with every tick in its log, `more` behind its text; the bytes of the log.
fn ran(place: &Place, scenario: &str, more: &str, arguments: &[&str]) -> Vec<u8> {
    let text = fs::read_to_string(format!("scenarios/{scenario}.toml")).unwrap();
    let (head, _) = text.split_once("\n[log]").unwrap();
    let text = format!("{head}\n{more}\n[log]\nevery = 1\nhash_every = 10\n");
    let scenario = place.file("scenario.toml", text);
    let mut all = vec![scenario.to_str().unwrap()];
    all.extend(arguments);
    place.run(&all).wait().expect(0);
    fs::read(place.run_folder().join("log.mcap")).unwrap()
}

/// Few imagined movements, so that debug builds are quick.
const QUICK: &str = "[learner.model]\nmovements = 4\nsteps = 1\nmemory = 64\n";

#[test]
fn lockstep_logs_of_all_kinds_replay() {
    for (scenario, more, ticks) in
        [("paper", "", 4000), ("arm", "", 150), ("eye", "", 2000), ("laplace", "", 1000), ("limited", "", 1000)]
    {
        let place = Place::new();
        ran(&place, scenario, more, &["--ticks", &ticks.to_string(), "--seed", "3", "--json"]);
        let done = replayed(&place, &["run", "--json"]).expect(0).json();
        assert_eq!(done["difference"], Value::Null, "{scenario}");
        for (key, value) in [("observations", ticks), ("commands", ticks), ("learnings", ticks), ("unseen", 0)] {
            assert_eq!(done[key], value, "{scenario}: {done}");
        }
        assert_eq!(done["hashes"], ticks / 10 + 1, "{scenario}: {done}");
        assert_eq!((&done["plant_simulated"], &done["torn"]), (&true.into(), &false.into()));
        assert_eq!(done["warnings"], serde_json::json!([]));
        let summary: Value =
            serde_json::from_str(&fs::read_to_string(place.run_folder().join("summary.json")).unwrap()).unwrap();
        assert_eq!(done["weights_hash"], summary["weights_hash"], "{scenario}");
    }
}

/// Where a sample's header holds the start number of its writer.
const INCARNATION: std::ops::Range<usize> = 48..52;

/// Flips one byte at each of `n` places in the samples of a log without checksums, and requires that every one is found.
fn flips_are_found(log: &[u8], n: usize, unfindable: impl Fn(&Body, usize, u8) -> bool) {
    let place = Place::new();
    let (bodies, end) = bodies(log);
    let torn = &log[..end];
    let whole = replay(&[place.file("torn.mcap", torn)], None, false).unwrap();
    assert_eq!((whole.difference, whole.torn), (None, true));
    let mut rng = stream(8, "flips");
    let mut found = [0; 2];
    // That a writer's last sample is from a later start than those before it, nothing contradicts.
    let lasts = [size_of::<Observation>(), size_of::<Command>(), size_of::<Learning>()]
        .map(|length| bodies.iter().rfind(|body| body.length == length).map(|body| body.at));
    while found[0] + found[1] < n {
        let body = bodies[rng.random_range(0..bodies.len())];
        let offset = rng.random_range(0..body.length);
        let mask = 1_u8 << (rng.next_u32() % 8);
        let start = INCARNATION.contains(&offset) && lasts.contains(&Some(body.at));
        if start || unfindable(&body, offset, mask) {
            continue;
        }
        let mut bytes = torn.to_vec();
        bytes[body.at + offset] ^= mask;
        match replay(&[place.file("flipped.mcap", &bytes)], None, false) {
            Ok(ReplayResult { difference: Some(_), .. }) => found[0] += 1,
            Err(ReplayError::Log(_) | ReplayError::Lost { .. }) => found[1] += 1,
            other => panic!("bit {mask:#04x} of byte {offset} of {:?}: {other:?}", body.sample),
        }
    }
    assert!(found[0] > n / 2, "most are found by replay: {found:?}");
}

/// In lockstep with the simulator no byte of a sample is without meaning.
#[test]
fn every_flipped_byte_of_a_lockstep_log_is_found() {
    let log = ran(&Place::new(), "paper", "", &["--ticks", "200"]);
    flips_are_found(&log, 1500, |_, _, _| false);
    let log = ran(&Place::new(), "arm", QUICK, &["--ticks", "60"]);
    flips_are_found(&log, 150, |_, _, _| false);
}

/// A run on the real clock in which one program is stopped for a tenth of a second. `None` when the machine was so busy
/// that the logger lost samples, or that nothing was missed.
fn stalled(program: &str) -> Option<(Place, Vec<u8>)> {
    let place = Place::new();
    let scenario = place.arm(&[("every", "1"), ("period_ms", "2"), ("hash_every", "10")]);
    let mut run = place.run(&[&scenario, "--mode", "realtime", "--ticks", "400", "--json"]);
    let member = run.member(program);
    run.until_ticking();
    signal_process(member, "STOP");
    std::thread::sleep(Duration::from_millis(100));
    signal_process(member, "CONT");
    let summary = run.wait().expect(0).json();
    let log = fs::read(place.run_folder().join("log.mcap")).unwrap();
    (summary["lost"] == 0 && summary["missed"].as_u64() >= Some(20)).then_some((place, log))
}

/// What the controller did not see it did not learn from; commands held, decayed, late and ticks passed over are part of a
/// log like anything else.
#[test]
fn real_time_logs_with_missed_ticks_replay_and_their_flips_are_found() {
    for program in ["tectum-controller", "tectum-simulator"] {
        let (place, log) = (0..5).find_map(|_| stalled(program)).expect("five runs, and the logger held up in each");
        let done = replayed(&place, &["run", "--json"]).expect(0).json();
        assert_eq!(done["difference"], Value::Null, "{done}");
        if program == "tectum-controller" {
            assert!(done["unseen"].as_u64() >= Some(10), "{done}");
        }
        let answered: Vec<u64> = bodies(&log)
            .0
            .iter()
            .filter_map(|body| if let LogRecord::Command(c) = body.sample { Some(c.header.tick) } else { None })
            .collect();
        // All that no other byte tells: when an observation was sensed that nobody answered, and that a command was late.
        flips_are_found(&log, 700, |body, offset, mask| {
            let LogRecord::Observation(o) = body.sample else { return false };
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
    let place = Place::new();
    let log = ran(&place, "paper", "", &["--ticks", "300"]);
    let (bodies, end) = bodies(&log);
    let observation =
        bodies.iter().find(|b| matches!(b.sample, LogRecord::Observation(o) if o.header.tick == 100)).unwrap();
    let command = bodies.iter().find(|b| matches!(b.sample, LogRecord::Command(c) if c.header.tick == 200)).unwrap();
    let learning = bodies.iter().find(|b| matches!(b.sample, LogRecord::Learning(l) if l.header.tick == 290)).unwrap();
    let said = |body: &Body, offset: usize| {
        let mut bytes = log[..end].to_vec();
        bytes[body.at + offset] ^= 1;
        place.file("other.mcap", &bytes);
        let outcome = replayed(&place, &["other.mcap", "--json"]).expect(1);
        assert_ne!(outcome.json()["difference"], Value::Null);
        outcome.stderr
    };
    // Inputs, reward; drawn; the hash.
    let text = said(observation, 56);
    assert!(
        text.starts_with("tectum: the log other.mcap does not replay: at tick 100, channel observation, inputs[0] is ")
    );
    assert!(text.contains(", and should be "), "{text}");
    assert!(said(observation, 152).contains("at tick 100, channel observation, reward is "));
    assert!(said(command, 88).contains("at tick 200, channel command, drawn[0] is "));
    assert!(said(learning, 104).contains("at tick 290, channel learning, weights_hash is "));
    // A log that still has its checksums is replayed no further either.
    let mut whole = log.clone();
    whole[command.at + 88] ^= 1;
    place.file("whole.mcap", &whole);
    assert!(replayed(&place, &["whole.mcap"]).expect(1).stderr.contains("at tick 200, channel command, drawn[0] is "));
}

#[test]
fn what_cannot_be_replayed_is_refused_with_the_remedy() {
    let place = Place::new();
    let scenario = place.arm(&[("every", "7")]);
    place.run(&[&scenario, "--ticks", "100"]).wait().expect(0);
    let text = replayed(&place, &["run"]).expect(2).stderr;
    assert!(text.contains("holds every 7th tick only") && text.contains("`every = 1` under [log]"), "{text}");
    let text = replayed(&place, &["nowhere"]).expect(2).stderr;
    assert_eq!(text.trim(), "tectum: nowhere does not exist; give a log, or the folder of a run");
}

/// Another build is worth a note, and no more: the numbers say whether it matters.
#[test]
fn a_log_of_another_build_is_replayed_with_a_note() {
    let place = Place::new();
    let log = ran(&place, "paper", "", &["--ticks", "100"]);
    let (_, end) = bodies(&log);
    let mut bytes = log[..end].to_vec();
    let build = tectum::BUILD.as_bytes();
    while let Some(at) = bytes.windows(build.len()).position(|w| w == build) {
        bytes[at] = b'9';
    }
    place.file("other.mcap", &bytes);
    let done = replayed(&place, &["other.mcap", "--json"]).expect(0).json();
    let note = done["warnings"][0].as_str().unwrap();
    assert!(note.starts_with("the log was written by build 9") && note.ends_with(tectum::BUILD), "{note}");
}

/// Off-policy credit, where it must give what the log's own learner has learned: the same rule from the same beginning.
#[test]
fn another_learner_learns_from_the_same_experience() {
    let place = Place::new();
    ran(&place, "paper", "", &["--ticks", "2000"]);
    let taught = |rule: &str| {
        let done = replayed(&place, &["run", "--learner", rule, "--json"]).expect(0).json();
        assert_eq!((&done["other"]["rule"], &done["other"]["off_policy"]), (&rule.into(), &true.into()));
        assert_eq!((&done["other"]["learned"], &done["other"]["cuts"]), (&1999.into(), &0.into()), "{done}");
        (done["other"]["distance"].as_f64().unwrap(), done["other"]["weights_norm"].as_f64().unwrap(), done)
    };
    // What was applied less the mean is the noise, but for its last bits.
    let (distance, norm, _) = taught("paper");
    assert!(distance < 1e-8 && norm > 1e-4, "{distance} {norm}");
    let (distance, norm, done) = taught("baseline");
    assert!(distance > 1e-6 && norm > 1e-4, "{distance} {norm}");
    assert_ne!(done["other"]["weights_hash"], done["weights_hash"]);
    let text = replayed(&place, &["run", "--learner", "actor-critic"]).expect(0).stdout;
    assert!(text.contains("off-policy    actor-critic, which did not choose the commands"), "{text}");

    // A model of the reward is learned from commands, whoever chose them: bit for bit the same.
    let place = Place::new();
    ran(&place, "arm", "", &["--ticks", "100"]);
    let done = replayed(&place, &["run", "--learner", "learned-reward", "--json"]).expect(0).json();
    assert_eq!(done["other"]["weights_hash"], done["weights_hash"]);
    assert_eq!(done["other"]["distance"], 0.0);
}

/// The gap is named, and how far the log was good.
#[test]
fn a_log_with_losses_is_replayed_up_to_the_first() {
    use tectum::log::{LogClock, LogHeader, LogReader, LogTotals, LogWriter};
    use tectum::scenario::Scenario;
    use tectum::wire::Gap;
    let place = Place::new();
    ran(&place, "paper", "", &["--ticks", "100"]);
    let mut log = LogReader::open(&place.run_folder().join("log.mcap")).unwrap();
    let plan = Scenario::parse(log.scenario(), "log").unwrap().plan().unwrap();
    let run = u64::from_str_radix(log.run("run").unwrap(), 16).unwrap();
    let header = LogHeader { clock: LogClock::Virtual, ..LogHeader::new(&plan, run, "lockstep", Default::default()) };
    let path = place.path().join("lossy.mcap");
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
    let text = replayed(&place, &["lossy.mcap"]).expect(2).stderr;
    for words in [
        "a gap on channel command, 1 missing from sequence number 40 on",
        "up to tick 39 it is",
        "(ticks 40 to 99)",
        "lockstep",
    ] {
        assert!(text.contains(words), "{words}: {text}");
    }
}
