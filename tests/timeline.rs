//! Lockstep, real time and a run in one process give the same numbers (invariants I1 and I2).

mod support;

use serde_json::Value;
use support::{TestFolder, assert_no_debris};

fn run(arguments: &[&str]) -> Value {
    let test_folder = TestFolder::new();
    let outcome = test_folder.run(&[arguments, &["--json"]].concat()).wait().expect(0);
    if !arguments.contains(&"in-process") {
        assert_no_debris(test_folder.run_folder());
    }
    outcome.json()
}

/// I1.
#[test]
fn lockstep_is_a_function_of_scenario_and_seed() {
    let arguments = ["paper", "--ticks", "20000", "--seed", "77"];
    let first = run(&arguments);
    let second = run(&arguments);
    let single = run(&[&arguments[..], &["--mode", "in-process"]].concat());
    for key in
        ["weights_hash", "loss_per_tick", "end_error_m", "ticks", "missed", "progress", "reached", "reached_text"]
    {
        assert_eq!(first[key], second[key], "{key}");
        assert_eq!(first[key], single[key], "{key}");
    }
    let rows: Vec<_> = first["progress"].as_array().unwrap().iter().map(|row| row["when"].as_str().unwrap()).collect();
    assert_eq!(rows, ["untrained", "after 10 s", "at the end"]);
    assert!(first["progress"].as_array().unwrap().iter().all(|row| row["test_error_m"].is_f64()), "{first}");
    assert_eq!((&first["ticks"], &first["missed"], &first["lost"]), (&20000.into(), &0.into(), &0.into()));
    let other = run(&["paper", "--ticks", "20000", "--seed", "78", "--mode", "in-process"]);
    assert_ne!(first["weights_hash"], other["weights_hash"]);
}

/// I1 for the learner that uses the time after the command was sent.
#[test]
fn lockstep_equals_one_process_for_a_learner_that_works_after_the_command() {
    let arguments = ["arm", "--ticks", "100", "--seed", "77"];
    let first = run(&arguments);
    let single = run(&[&arguments[..], &["--mode", "in-process"]].concat());
    for key in ["weights_hash", "loss_per_tick", "ticks"] {
        assert_eq!(first[key], single[key], "{key}");
    }
}

/// I1 for the rules that learn before the command is sent.
#[test]
fn lockstep_equals_one_process_for_every_first_order_rule() {
    for rule in ["baseline", "actor-critic", "natural-actor-critic"] {
        let test_folder = TestFolder::new();
        let rule = format!("\"{rule}\"");
        let scenario = test_folder.arm_scenario(&[("rule", &rule), ("ticks", "400")]);
        let (first, single) = (run(&[&scenario]), run(&[&scenario, "--mode", "in-process"]));
        assert_eq!(first["weights_hash"], single["weights_hash"], "{rule}");
    }
}

/// The numbers are the same on every machine and in every build profile, because the mathematics are pure Rust and sums
/// have a fixed order. A change of this hash changes what users can reproduce, and belongs into the change log.
#[test]
fn the_weights_hash_is_pinned() {
    let summary = run(&["paper", "--ticks", "2000", "--seed", "77", "--mode", "in-process"]);
    assert_eq!(summary["weights_hash"], PINNED);
}

const PINNED: &str = "9df8dfa9cf01f16f";

/// I2. A stall of the machine causes a missed tick. I2 does not hold then, and the run is repeated.
#[test]
fn real_time_without_a_miss_equals_lockstep() {
    let test_folder = TestFolder::new();
    let scenario = test_folder.arm_scenario(&[("period_ms", "10")]);
    let lockstep = run(&[&scenario, "--ticks", "200"]);
    for _ in 0..5 {
        let real = run(&[&scenario, "--ticks", "200", "--mode", "realtime"]);
        assert!(real["seconds"].as_f64().unwrap() >= 2.0, "real time runs by the clock: {real}");
        let (wake, answer) = (&real["wake_up_lateness_us"], &real["observation_to_command_us"]);
        assert!(wake["p50"].as_f64() > Some(0.0) && answer["p99"].as_f64() > Some(0.0), "{real}");
        if real["missed"] == 0 {
            assert_eq!(real["weights_hash"], lockstep["weights_hash"]);
            return;
        }
    }
    panic!("every run of five had a miss: this machine cannot keep 10 ms");
}

#[test]
fn two_concurrent_runs_are_isolated() {
    let (first, second) = (TestFolder::new(), TestFolder::new());
    let arguments = |seed| ["paper", "--ticks", "20000", "--json", "--seed", seed];
    let (a, b) = (first.run(&arguments("77")), second.run(&arguments("78")));
    let (a, b) = (a.wait().expect(0).json(), b.wait().expect(0).json());
    let alone = run(&["paper", "--ticks", "20000", "--seed", "78", "--mode", "in-process"]);
    assert_eq!(b["weights_hash"], alone["weights_hash"]);
    assert_ne!(a["weights_hash"], b["weights_hash"]);
}

/// Lockstep must stay correct and must not starve itself when all processes share one core.
#[test]
fn lockstep_gives_the_same_on_one_core() {
    use rustix::thread::{CpuSet, sched_getaffinity, sched_setaffinity};
    let allowed = sched_getaffinity(None).unwrap();
    let first = (0..CpuSet::MAX_CPU).find(|&cpu| allowed.is_set(cpu)).unwrap();
    let mut one = CpuSet::new();
    one.set(first);
    // The started processes inherit the affinity of this thread.
    sched_setaffinity(None, &one).unwrap();
    let pinned = run(&["paper", "--ticks", "5000", "--seed", "77"]);
    sched_setaffinity(None, &allowed).unwrap();
    let free = run(&["paper", "--ticks", "5000", "--seed", "77", "--mode", "in-process"]);
    assert_eq!(pinned["weights_hash"], free["weights_hash"]);
}
