//! Faults on demand between real processes: equal in one process and in three, in lockstep and in real time, and in a
//! replay. Also a plant that skips too many ticks, and a plant without the joints that a limit needs.

mod support;

use std::fs;
use std::time::Duration;

use serde_json::Value;
use support::{ProcessOutcome, TECTUM, TestFolder, assert_no_debris, example, stop_process_for};
use tectum::log::{LogInfo, LogReader, LogRecord};

/// All limits of the gate.
const GATE: &str = "\
max_command = [0.05, 0.04, 0.05, 0.03]\nmax_step = 0.02\nramp_ticks = 5
positions = [[-0.5, 0.5], [-1.0, 1.0], [-2.0, 2.0], [-100.0, 100.0]]\n";
/// All faults whose effect differs from a run without faults.
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

/// The arm with every tick in its log, other limits under `[gate]` unless `gate` is empty, and more tables at the end.
fn scenario(test_folder: &TestFolder, gate: &str, more: &str, changes: &[(&str, &str)]) -> String {
    let path = test_folder.arm_scenario(&[&[("every", "1"), ("hash_every", "10")], changes].concat());
    let text = fs::read_to_string(&path).unwrap();
    let text = text.replacen("max_command = 0.05\n", if gate.is_empty() { "max_command = 0.05\n" } else { gate }, 1);
    test_folder.write_file("scenario.toml", text + "\n" + more).to_str().unwrap().to_owned()
}

fn run(test_folder: &TestFolder, scenario: &str, mode: &str, ticks: &str) -> Value {
    test_folder.run(&[scenario, "--mode", mode, "--ticks", ticks, "--seed", "5", "--json"]).wait().expect(0).json()
}

/// Requires that the log replays, and returns the result.
#[track_caller]
fn replays(test_folder: &TestFolder) -> Value {
    let done = test_folder.start(TECTUM, &["replay", "run", "--json"]).wait().expect(0).json();
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
fn faults_are_equal_in_one_process_and_in_three_and_replay() {
    let (test_folder, single) = (TestFolder::new(), TestFolder::new());
    let scenario = scenario(&test_folder, GATE, FAULTS, &[]);
    let three = run(&test_folder, &scenario, "lockstep", "4000");
    let one = run(&single, &scenario, "in-process", "4000");
    for key in COUNTS {
        assert_eq!(three[key], one[key], "{key}");
        assert!(three[key].as_u64() != Some(0), "{key}: {three}");
    }
    assert_eq!(three["lost"], 0, "the log has what was sent");
    assert_no_debris(test_folder.run_folder());
    assert_eq!(replays(&test_folder)["weights_hash"], three["weights_hash"]);

    // The summary and the log show that the run had faults.
    let text = single.start(TECTUM, &["run", &scenario, "--mode", "in-process", "--ticks", "300", "--out", "b"]).wait();
    let text = text.expect(0).stdout;
    for line in [
        "\ngate                    by step ",
        "\nheard                   nothing ",
        "\nfault, on purpose       observation delay by 2, 0.03 a tick\n",
    ] {
        assert!(text.contains(line), "{line}: {text}");
    }
    let info = LogInfo::of(&[test_folder.log_path()]).unwrap();
    for (flag, key) in [("MISSED", "missed"), ("POSITION_LIMITED", "position_limited"), ("UNHEARD", "unheard")] {
        // No observation reports the last tick.
        let (flags, run) = (info.flags[flag], three[key].as_u64().unwrap());
        assert!(flags == run || flags + 1 == run, "{flag}: {flags} {run}");
    }
    assert!(info.to_text().contains("\nflags    "), "{}", info.to_text());
}

/// Commands ahead: in one process and in three, when the controller or the plant is killed, and in a replay, there are
/// the same ones. A stalled controller's plant has them in real time, too.
#[test]
fn commands_ahead_are_equal_in_one_process_and_in_three_and_replay() {
    let (test_folder, single) = (TestFolder::new(), TestFolder::new());
    let keys = [("rule", "\"model-predictive\""), ("hold_ticks", "3"), ("hash_every", "10")];
    let scenario = test_folder.scenario("arm", &keys, &format!("{FAULTS}[link]\nahead = 3\n"));
    let one = run(&single, &scenario, "in-process", "240");
    let three = run(&test_folder, &scenario, "lockstep", "240");
    assert!(three["ahead"].as_u64() > Some(10), "{three}");
    for key in COUNTS.iter().chain(&["ahead"]) {
        assert_eq!(three[key], one[key], "{key}");
    }
    assert_eq!(replays(&test_folder)["weights_hash"], three["weights_hash"]);

    for program in ["tectum-controller", "tectum-simulator"] {
        let killed = TestFolder::new();
        let mut run = killed.run(&[&scenario, "--mode", "lockstep", "--ticks", "240", "--seed", "5", "--json"]);
        run.wait_until_ticking();
        run.kill_child(program);
        let killed = run.wait().expect(0).json();
        for key in ["weights_hash", "ahead", "missed"] {
            assert_eq!(killed[key], three[key], "{program} {key}");
        }
    }

    a_stalled_run_replays(&scenario, "tectum-controller", "140", |run| run["ahead"].as_u64() > Some(3));
}

/// I2 with faults. A stall of the machine causes a miss in addition to those of the faults. Then only the replay of
/// the log is required, and the run is repeated.
#[test]
fn real_time_has_the_same_faults_as_lockstep() {
    let test_folder = TestFolder::new();
    let scenario = scenario(&test_folder, GATE, FAULTS, &[("period_ms", "10")]);
    let lockstep = run(&test_folder, &scenario, "lockstep", "200");
    for _ in 0..5 {
        let test_folder = TestFolder::new();
        let real = run(&test_folder, &scenario, "realtime", "200");
        if real["lost"] == 0 {
            replays(&test_folder);
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

/// A run in real time in which one program is stopped for a tenth of a second.
fn stalled(test_folder: &TestFolder, scenario: &str, program: &str, ticks: &str) -> ProcessOutcome {
    let mut run = test_folder.run(&[scenario, "--mode", "realtime", "--ticks", ticks, "--json"]);
    let pid = run.child_pid(program);
    run.wait_until_ticking();
    stop_process_for(pid, Duration::from_millis(100));
    run.wait()
}

/// Requires that the log of a run in which `program` is stalled replays: that of the first of five runs whose log is
/// complete, and which is `wanted`.
#[track_caller]
fn a_stalled_run_replays(scenario: &str, program: &str, ticks: &str, wanted: impl Fn(&Value) -> bool) {
    let replayed = (0..5).any(|_| {
        let test_folder = TestFolder::new();
        let summary = stalled(&test_folder, scenario, program, ticks).expect(0).json();
        let complete = summary["lost"] == 0 && wanted(&summary);
        if complete {
            replays(&test_folder);
        }
        complete
    });
    assert!(replayed, "none of five runs had a complete log and what is wanted of it");
}

/// A log replays whether its ticks were missed because of a fault or because of the clock.
#[test]
fn a_real_time_log_with_faults_and_stalls_replays() {
    let test_folder = TestFolder::new();
    let scenario = scenario(&test_folder, GATE, FAULTS, &[("period_ms", "2")]);
    for program in ["tectum-controller", "tectum-simulator"] {
        a_stalled_run_replays(&scenario, program, "400", |_| true);
    }
}

/// The log of another plant program does not contain its joint angles, but it contains the result of the gate.
#[test]
fn position_limits_of_a_plant_without_simulation_replay() {
    let test_folder = TestFolder::new();
    let rig = test_folder.path().join("rig");
    let simulator = std::path::Path::new(TECTUM).with_file_name("tectum-simulator");
    std::os::unix::fs::symlink(simulator, &rig).unwrap();
    let program = format!("\"{}\"", rig.display());
    let scenario = scenario(&test_folder, GATE, FAULTS, &[("program", &program), ("period_ms", "2")]);
    let summary = run(&test_folder, &scenario, "lockstep", "1000");
    assert!(summary["position_limited"].as_u64() > Some(10), "{summary}");
    assert_eq!(replays(&test_folder)["plant_simulated"], false);
    a_stalled_run_replays(&scenario, "rig", "400", |run| run["skipped"].as_u64() > Some(10));
}

#[test]
fn too_many_skipped_ticks_in_a_row_end_the_run_cleanly() {
    let test_folder = TestFolder::new();
    // A tenth of a second is more than 40 ticks. The test also passes on a machine that stalls as long at the start.
    let overrun = "[overrun]\nmax_consecutive = 40\n";
    let scenario = scenario(&test_folder, "", overrun, &[("period_ms", "2")]);
    let outcome = stalled(&test_folder, &scenario, "tectum-simulator", "100000").expect(4);
    let message = outcome.stderr.lines().last().unwrap();
    for words in [
        "the plant ended: the plant passed over ",
        " ticks in a row up to tick ",
        "and 40 are allowed (`max_consecutive` under [overrun]); give it more than 2 ms a tick",
    ] {
        assert!(message.contains(words), "{words}: {message}");
    }
    assert_no_debris(test_folder.run_folder());
    let mut log = LogReader::open(&test_folder.log_path()).unwrap();
    assert!(log.by_ref().all(|record| record.is_ok()) && log.finished());
    assert!(!log.totals().unwrap().complete);
    // The summary holds the plant's own count, not the last value on its board.
    assert!(outcome.json()["skipped"].as_u64() > Some(40), "{outcome:?}");
}

#[test]
fn position_limits_need_a_plant_with_joints() {
    let test_folder = TestFolder::new();
    let text = fs::read_to_string("examples/point.toml").unwrap();
    let program = format!("program = {:?}", example("point"));
    let text = text.replacen("program = \"target/release/examples/point\"", &program, 1);
    let text = text.replacen("[gate]", "[gate]\npositions = [[-1.0, 1.0]]", 1);
    let path = test_folder.write_file("point.toml", text);
    let outcome = test_folder.run(&[path.to_str().unwrap(), "--ticks", "100"]).wait().expect(2);
    for words in ["`positions` under [gate] needs a plant that tells where its joints are", "take it out"] {
        assert!(outcome.stderr.contains(words), "{words}: {outcome:?}");
    }
}

/// Faults on the learning channel affect only the log. The log states what it lacks.
#[test]
fn samples_that_faults_keep_from_the_logger_are_stated_as_gaps() {
    let test_folder = TestFolder::new();
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
    let clean = test_folder.arm_scenario(&[("every", "1"), ("ticks", "4000")]);
    let scenario = test_folder.write_file("faulty.toml", std::fs::read_to_string(&clean).unwrap() + faults);
    let hash = |arguments: &[&str]| {
        test_folder.start(TECTUM, &[&["run"], arguments].concat()).wait().expect(0).json()["weights_hash"].clone()
    };
    let clean = hash(&[&clean, "--out", "clean", "--json"]);
    assert_eq!(hash(&[scenario.to_str().unwrap(), "--out", "run", "--json"]), clean);
    let log = test_folder.log_path();
    let (mut learning, mut gaps) = (Vec::new(), 0);
    for record in LogReader::open(&log).unwrap() {
        match record.unwrap() {
            LogRecord::Learning(s) => learning.push(s.header.sequence),
            LogRecord::Gap(gap) if gap.channel == 2 => gaps += gap.count,
            LogRecord::Gap(gap) => panic!("{gap:?}"),
            _ => {}
        }
    }
    assert!(learning.is_sorted() && learning.windows(2).all(|pair| pair[0] < pair[1]));
    assert_eq!(learning.len() as u64 + gaps, 4000);
    assert!((1600..2000).contains(&gaps), "{gaps}");
    assert!(!learning.iter().any(|n| (500..600).contains(n) || (1000..2500).contains(n)));
}
