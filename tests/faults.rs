//! Faults on demand, between real processes: the same in one process and in three, in lockstep and in real time, and in a
//! replay. And a plant that gives up on its deadlines, or that cannot be limited as asked.

mod support;

use std::fs;
use std::time::Duration;

use serde_json::Value;
use support::{Outcome, Place, TECTUM, assert_no_debris, example, signal_process};
use tectum::log::{LogInfo, LogReader, LogRecord};

/// Every limit of the gate, and every fault that can be told from a clean run.
const GATE: &str = "\
max_command = [0.05, 0.04, 0.05, 0.03]\nmax_step = 0.02\nramp_ticks = 5
positions = [[-0.5, 0.5], [-1.0, 1.0], [-2.0, 2.0], [-100.0, 100.0]]\n";
const FAULTS: &str = r#"
[[faults.channel]]
channel = "observation"
kind = "delay"
probability = 0.03
ticks = 2
[[faults.channel]]
channel = "observation"
kind = "corrupt"
probability = 0.01
value = "nan"
[[faults.channel]]
channel = "observation"
kind = "freeze"
probability = 0.01
ticks = 5
[[faults.channel]]
channel = "command"
kind = "delay"
probability = 0.03
ticks = 3
[[faults.channel]]
channel = "command"
kind = "duplicate"
probability = 0.03
[[faults.channel]]
channel = "command"
kind = "reorder"
probability = 0.02
[[faults.channel]]
channel = "command"
kind = "drop"
probability = 0.02
[[faults.channel]]
channel = "command"
kind = "corrupt"
probability = 0.02
value = "huge"
[[faults.channel]]
channel = "command"
kind = "corrupt"
probability = 0.01
value = "nan"
"#;

/// The quick arm with every tick in its log, more keys under `[gate]` and more tables at the end.
fn scenario(place: &Place, gate: &str, more: &str, changes: &[(&str, &str)]) -> String {
    let path = place.arm(&[&[("every", "1"), ("hash_every", "10")], changes].concat());
    let text = fs::read_to_string(&path).unwrap();
    let text = text.replacen("max_command = 0.05\n", if gate.is_empty() { "max_command = 0.05\n" } else { gate }, 1);
    place.file("scenario.toml", text + "\n" + more).to_str().unwrap().to_owned()
}

fn run(place: &Place, scenario: &str, mode: &str, ticks: &str) -> Value {
    place.run(&[scenario, "--mode", mode, "--ticks", ticks, "--seed", "5", "--json"]).wait().expect(0).json()
}

#[track_caller]
fn replays(place: &Place) -> Value {
    let done = place.start(TECTUM, &["replay", "run", "--json"]).wait().expect(0).json();
    assert_eq!(done["difference"], Value::Null, "{done}");
    done
}

const COUNTS: [&str; 13] = [
    "weights_hash",
    "loss_per_tick",
    "ticks",
    "missed",
    "late",
    "clamped",
    "step_limited",
    "position_limited",
    "ramped",
    "non_finite",
    "unheard",
    "stale",
    "faults",
];

#[test]
fn faults_are_the_same_in_one_process_and_in_three_and_replay() {
    let (place, single) = (Place::new(), Place::new());
    let scenario = scenario(&place, GATE, FAULTS, &[]);
    let three = run(&place, &scenario, "lockstep", "4000");
    let one = run(&single, &scenario, "in-process", "4000");
    for key in COUNTS {
        assert_eq!(three[key], one[key], "{key}");
        assert!(three[key].as_u64() != Some(0), "{key}: {three}");
    }
    assert_eq!(three["lost"], 0, "the log has what was sent");
    assert_no_debris(&place.run_folder());
    assert_eq!(replays(&place)["weights_hash"], three["weights_hash"]);

    // Nobody takes it for a clean run.
    let text = single.start(TECTUM, &["run", &scenario, "--mode", "in-process", "--ticks", "300", "--out", "b"]).wait();
    let text = text.expect(0).stdout;
    for line in [
        "\ngate                    by step ",
        "\nheard                   nothing ",
        "\nfault, on purpose       observation delay by 2, 0.03 a tick\n",
    ] {
        assert!(text.contains(line), "{line}: {text}");
    }
    let info = LogInfo::of(&[place.run_folder().join("log.mcap")]).unwrap();
    for (flag, key) in [("MISSED", "missed"), ("POSITION_LIMITED", "position_limited"), ("UNHEARD", "unheard")] {
        // What came of the last tick is in no observation.
        let (flags, run) = (info.flags[flag], three[key].as_u64().unwrap());
        assert!(flags == run || flags + 1 == run, "{flag}: {flags} {run}");
    }
    assert!(info.to_text().contains("\nflags    "), "{}", info.to_text());
}

/// I2 with faults. A stall of the machine makes a miss beyond the faults' own, and then nothing is promised but that the log
/// replays: the run is repeated.
#[test]
fn real_time_has_the_same_faults_as_lockstep() {
    let place = Place::new();
    let scenario = scenario(&place, GATE, FAULTS, &[("period_ms", "10")]);
    let lockstep = run(&place, &scenario, "lockstep", "200");
    for _ in 0..5 {
        let place = Place::new();
        let real = run(&place, &scenario, "realtime", "200");
        if real["lost"] == 0 {
            replays(&place);
        }
        if real["missed"] == lockstep["missed"] && real["late"] == lockstep["late"] {
            for key in COUNTS {
                assert_eq!(real[key], lockstep[key], "{key}");
            }
            return;
        }
    }
    panic!("every run of five had a miss of its own: this machine cannot keep 10 ms");
}

/// A run on the real clock in which one program is stopped for a tenth of a second.
fn stalled(place: &Place, scenario: &str, program: &str, ticks: &str) -> Outcome {
    let mut run = place.run(&[scenario, "--mode", "realtime", "--ticks", ticks, "--json"]);
    let member = run.member(program);
    run.until_ticking();
    signal_process(member, "STOP");
    std::thread::sleep(Duration::from_millis(100));
    signal_process(member, "CONT");
    run.wait()
}

/// What was missed by a fault and what was missed by the clock are told apart, or it does not matter.
#[test]
fn real_time_with_faults_and_misses_of_its_own_replays() {
    for program in ["tectum-controller", "tectum-simulator"] {
        let fine = (0..5).any(|_| {
            let place = Place::new();
            let scenario = scenario(&place, GATE, FAULTS, &[("period_ms", "2")]);
            let summary = stalled(&place, &scenario, program, "400").expect(0).json();
            if summary["lost"] != 0 {
                return false;
            }
            replays(&place);
            true
        });
        assert!(fine, "five runs, and the logger held up in none");
    }
}

/// Another program in the plant's place tells no log where its joints are; what the gate made of them is in it.
#[test]
fn position_limits_of_a_plant_that_cannot_be_run_again_replay() {
    let place = Place::new();
    let rig = place.path().join("rig");
    let simulator = std::path::Path::new(TECTUM).with_file_name("tectum-simulator");
    std::os::unix::fs::symlink(simulator, &rig).unwrap();
    let program = format!("\"{}\"", rig.display());
    let scenario = scenario(&place, GATE, FAULTS, &[("program", &program), ("period_ms", "2")]);
    let summary = run(&place, &scenario, "lockstep", "1000");
    assert!(summary["position_limited"].as_u64() > Some(10), "{summary}");
    assert_eq!(replays(&place)["plant_simulated"], false);
    let fine = (0..5).any(|_| {
        let place = Place::new();
        let summary = stalled(&place, &scenario, "rig", "400").expect(0).json();
        let fine = summary["lost"] == 0 && summary["skipped"].as_u64() > Some(10);
        if fine {
            replays(&place);
        }
        fine
    });
    assert!(fine, "five runs, and the logger held up in none");
}

#[test]
fn a_plant_that_passes_over_too_many_ticks_ends_the_run_in_good_order() {
    let place = Place::new();
    // A tenth of a second is more than 40 ticks. A machine that takes as long before there are ticks in the log shows the same.
    let overrun = "[overrun]\nmax_consecutive = 40\n";
    let scenario = scenario(&place, "", overrun, &[("period_ms", "2")]);
    let outcome = stalled(&place, &scenario, "tectum-simulator", "100000").expect(4);
    let message = outcome.stderr.lines().last().unwrap();
    for words in [
        "the plant ended: the plant passed over ",
        " ticks in a row up to tick ",
        "and 40 are allowed (`max_consecutive` under [overrun]); give it more than 2 ms a tick",
    ] {
        assert!(message.contains(words), "{words}: {message}");
    }
    assert_no_debris(&place.run_folder());
    let mut log = LogReader::open(&place.run_folder().join("log.mcap")).unwrap();
    assert!(log.by_ref().all(|record| record.is_ok()) && log.finished());
    assert!(!log.totals().unwrap().complete);
    // What is said of the run is what the plant counted, not what its board said last.
    assert!(outcome.json()["skipped"].as_u64() > Some(40), "{outcome:?}");
}

#[test]
fn limits_of_position_need_a_plant_with_joints() {
    let place = Place::new();
    let text = fs::read_to_string("examples/point.toml").unwrap();
    let program = format!("program = {:?}", example("point"));
    let text = text.replacen("program = \"target/release/examples/point\"", &program, 1);
    let text = text.replacen("[gate]", "[gate]\npositions = [[-1.0, 1.0]]", 1);
    let path = place.file("point.toml", text);
    let outcome = place.run(&[path.to_str().unwrap(), "--ticks", "100"]).wait().expect(2);
    for words in ["`positions` under [gate] needs a plant that tells where its joints are", "take it out"] {
        assert!(outcome.stderr.contains(words), "{words}: {outcome:?}");
    }
}

/// What only the log hears: it lacks that, and says so; nobody else notices.
#[test]
fn what_the_logger_does_not_hear_is_stated() {
    let place = Place::new();
    let faults = r#"
[[faults.channel]]
channel = "learning"
kind = "drop"
probability = 0.05

[[faults.channel]]
channel = "learning"
kind = "delay"
ticks = 3
from = 500
until = 600

[[faults.channel]]
channel = "learning"
kind = "duplicate"
probability = 0.05

[[faults.channel]]
channel = "learning"
kind = "freeze"
ticks = 1500
from = 1000
until = 1001
"#;
    let clean = place.arm(&[("every", "1"), ("ticks", "4000")]);
    let scenario = place.file("faulty.toml", std::fs::read_to_string(&clean).unwrap() + faults);
    let hash = |arguments: &[&str]| {
        place.start(TECTUM, &[&["run"], arguments].concat()).wait().expect(0).json()["weights_hash"].clone()
    };
    let clean = hash(&[&clean, "--out", "clean", "--json"]);
    assert_eq!(hash(&[scenario.to_str().unwrap(), "--out", "run", "--json"]), clean);
    let log = place.run_folder().join("log.mcap");
    let (mut learning, mut gaps) = (Vec::new(), 0);
    for record in LogReader::open(&log).unwrap() {
        match record.unwrap() {
            LogRecord::Learning(s) => learning.push(s.header.sequence),
            LogRecord::Gap(gap) if gap.channel == 2 => gaps += gap.count,
            LogRecord::Gap(gap) => panic!("{gap:?}"),
            _ => {}
        }
    }
    assert!(learning.is_sorted() && learning.windows(2).all(|two| two[0] < two[1]));
    assert_eq!(learning.len() as u64 + gaps, 4000);
    assert!((1600..2000).contains(&gaps), "{gaps}");
    assert!(!learning.iter().any(|n| (500..600).contains(n) || (1000..2500).contains(n)));
}
