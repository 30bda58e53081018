//! One timeline: lockstep, real time and one process give the same numbers (invariants I1 and I2).

mod support;

use serde_json::Value;
use support::{Place, assert_no_debris};

fn run(arguments: &[&str]) -> Value {
    let place = Place::new();
    let outcome = place.run(&[arguments, &["--json"]].concat()).wait().expect(0);
    if !arguments.contains(&"in-process") {
        assert_no_debris(&place.run_folder());
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

/// I1 for the learner that uses the time after the command has gone out.
#[test]
fn a_learner_that_thinks_longer_is_on_the_same_timeline() {
    let arguments = ["arm", "--ticks", "100", "--seed", "77"];
    let first = run(&arguments);
    let single = run(&[&arguments[..], &["--mode", "in-process"]].concat());
    for key in ["weights_hash", "loss_per_tick", "ticks"] {
        assert_eq!(first[key], single[key], "{key}");
    }
}

/// I1 for the rules that learn before the command goes out.
#[test]
fn every_first_order_rule_is_on_the_same_timeline() {
    for rule in ["baseline", "actor-critic", "natural-actor-critic"] {
        let place = Place::new();
        let rule = format!("\"{rule}\"");
        let scenario = place.arm(&[("rule", &rule), ("ticks", "400")]);
        let (first, single) = (run(&[&scenario]), run(&[&scenario, "--mode", "in-process"]));
        assert_eq!(first["weights_hash"], single["weights_hash"], "{rule}");
    }
}

/// The numbers are the same on every machine and in every build profile: pure-Rust mathematics, fixed order of
/// summation. A change here is a change of what users can reproduce, and belongs into the change log.
#[test]
fn the_numbers_are_pinned() {
    let summary = run(&["paper", "--ticks", "2000", "--seed", "77", "--mode", "in-process"]);
    assert_eq!(summary["weights_hash"], PINNED);
}

const PINNED: &str = "9df8dfa9cf01f16f";

/// I2. A stall of the machine makes a miss, and then nothing is promised: the run is repeated.
#[test]
fn real_time_without_a_miss_is_lockstep() {
    let place = Place::new();
    let scenario = place.arm(&[("period_ms", "10")]);
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
fn two_runs_at_once_do_not_see_each_other() {
    let (here, there) = (Place::new(), Place::new());
    let arguments = |seed| ["paper", "--ticks", "20000", "--json", "--seed", seed];
    let (a, b) = (here.run(&arguments("77")), there.run(&arguments("78")));
    let (a, b) = (a.wait().expect(0).json(), b.wait().expect(0).json());
    let alone = run(&["paper", "--ticks", "20000", "--seed", "78", "--mode", "in-process"]);
    assert_eq!(b["weights_hash"], alone["weights_hash"]);
    assert_ne!(a["weights_hash"], b["weights_hash"]);
}

/// Lockstep must stay right, and must not starve itself, when all processes share one core.
#[test]
fn one_core_is_enough() {
    use rustix::thread::{CpuSet, sched_getaffinity, sched_setaffinity};
    let allowed = sched_getaffinity(None).unwrap();
    let first = (0..CpuSet::MAX_CPU).find(|&cpu| allowed.is_set(cpu)).unwrap();
    let mut one = CpuSet::new();
    one.set(first);
    // This test's own thread, whose affinity the processes inherit.
    sched_setaffinity(None, &one).unwrap();
    let pinned = run(&["paper", "--ticks", "5000", "--seed", "77"]);
    sched_setaffinity(None, &allowed).unwrap();
    let free = run(&["paper", "--ticks", "5000", "--seed", "77", "--mode", "in-process"]);
    assert_eq!(pinned["weights_hash"], free["weights_hash"]);
}
