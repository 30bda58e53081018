//! A killed process is restarted and the run continues. In lockstep the numbers equal those of an undisturbed run. In
//! real time the missed ticks are not learned from.

mod support;

use std::path::Path;

use support::{Process, ProcessOutcome, TestFolder, assert_no_debris, planner_scenario, read_json, signal_process};

/// The quickest possible restarts.
const QUICK: &str = "\n[restart]\nbackoff_ms = 1\nbackoff_cap_ms = 10\ngive_up_after = 100\nhang_s = 1\n";

fn size(log: &Path) -> u64 {
    std::fs::metadata(log).map_or(0, |m| m.len())
}

/// Sends `signal` to the run's `program` each time when the log exceeds the next of `sizes`. Each signal goes to
/// another process than the one before.
fn signal_at_sizes(run: &mut Process, log: &Path, program: &str, signal: &str, sizes: impl Iterator<Item = u64>) {
    let mut pid = 0;
    for bytes in sizes {
        run.wait_until("a grown log", || size(log) > bytes);
        pid = run.next_child_pid(program, pid);
        signal_process(pid, signal);
    }
}

/// A run of a scenario whose `program` is sent a signal at each of these log sizes; returns its outcome.
fn run_with_signals(
    test_folder: &TestFolder,
    scenario: &str,
    ticks: &str,
    (program, signal): (&str, &str),
    sizes: impl Iterator<Item = u64>,
) -> ProcessOutcome {
    let mut run = test_folder.run(&[scenario, "--ticks", ticks, "--json"]);
    signal_at_sizes(&mut run, &test_folder.log_path(), program, signal, sizes);
    run.wait()
}

/// Numbers that grow to `most` by steps of pseudo-random size.
fn random_steps(mut seed: u64, count: u64, most: u64) -> impl Iterator<Item = u64> {
    (0..count).map(move |i| {
        seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (i * most + (seed >> 33) % most) / count
    })
}

/// The weights hash of an undisturbed run.
fn undisturbed_hash(scenario: &str, ticks: &str) -> String {
    let test_folder = TestFolder::new();
    let outcome = test_folder.run(&[scenario, "--mode", "in-process", "--ticks", ticks, "--json"]).wait().expect(0);
    outcome.json()["weights_hash"].as_str().unwrap().to_owned()
}

/// Checks a run whose `program` was killed and returns the number of its restarts.
fn check(test_folder: &TestFolder, outcome: &ProcessOutcome, program: &str, hash: &str) -> usize {
    let summary = outcome.json();
    assert_eq!(summary["weights_hash"], hash, "{outcome:#?}");
    assert_eq!(summary["lost"], 0, "{outcome:#?}");
    assert_no_debris(test_folder.run_folder());
    let restarts = summary["restarts"].as_array().unwrap();
    assert!(restarts.iter().all(|incident| incident["process"] == program), "{outcome:#?}");
    restarts.len()
}

/// I5.
#[test]
fn a_controller_killed_twenty_times_learns_the_same() {
    let test_folder = TestFolder::new();
    let scenario = test_folder.scenario("paper", &[], QUICK);
    let hash = undisturbed_hash(&scenario, "200000");
    // The log holds one tick in a hundred, in 745 bytes.
    let (kill, sizes) = (("tectum-controller", "KILL"), random_steps(5, 20, 800_000));
    let outcome = run_with_signals(&test_folder, &scenario, "200000", kill, sizes).expect(0);
    assert_eq!(check(&test_folder, &outcome, "controller", &hash), 20);
}

/// The plant stands for the physical world, which does not restart with its driver.
#[test]
fn a_killed_plant_continues_from_its_last_state() {
    let test_folder = TestFolder::new();
    let scenario = test_folder.scenario("paper", &[], QUICK);
    let hash = undisturbed_hash(&scenario, "100000");
    let (kill, sizes) = (("tectum-simulator", "KILL"), random_steps(6, 8, 400_000));
    let outcome = run_with_signals(&test_folder, &scenario, "100000", kill, sizes).expect(0);
    assert_eq!(check(&test_folder, &outcome, "plant", &hash), 8);
}

/// All state of a rule survives: models, memories of states, candidates and traces.
#[test]
fn every_learning_rule_survives_kills() {
    // For each rule so many ticks that they take much longer than a restart.
    for (name, rule, ticks) in [
        ("arm", "learned-reward", 700),
        ("paper", "natural-actor-critic", 20_000),
        ("paper", "actor-critic", 60_000),
        ("paper", "baseline", 60_000),
    ] {
        let test_folder = TestFolder::new();
        let scenario = test_folder.scenario(name, &[("rule", &format!("\"{rule}\"")), ("every", "1")], QUICK);
        let hash = undisturbed_hash(&scenario, &ticks.to_string());
        let (kill, sizes) = (("tectum-controller", "KILL"), random_steps(7, 2, ticks * 745 / 2));
        let outcome = run_with_signals(&test_folder, &scenario, &ticks.to_string(), kill, sizes).expect(0);
        assert_eq!(check(&test_folder, &outcome, "controller", &hash), 2, "{rule}");
    }
}

/// The planner survives kills at any tick: models, refits in progress, memory and plan.
#[test]
fn a_planner_survives_kills() {
    let test_folder = TestFolder::new();
    let scenario = planner_scenario(&test_folder, "pendulum", QUICK);
    let hash = undisturbed_hash(&scenario, "400");
    let (kill, sizes) = (("tectum-controller", "KILL"), random_steps(9, 4, 400 * 745 / 2));
    let outcome = run_with_signals(&test_folder, &scenario, "400", kill, sizes).expect(0);
    assert_eq!(check(&test_folder, &outcome, "controller", &hash), 4);
    let learner = &outcome.json()["learner"];
    assert!(learner["plans"].as_u64().unwrap() > 300 && learner["refits"].as_u64().unwrap() >= 5, "{learner}");
}

/// The state of the gate's ramp and the samples in a faulty channel survive.
#[test]
fn faults_and_gate_limits_survive_kills() {
    for (program, role) in [("tectum-controller", "controller"), ("tectum-simulator", "plant")] {
        let test_folder = TestFolder::new();
        let scenario = test_folder.scenario("office", &[("rule", "\"paper\"")], QUICK);
        let hash = undisturbed_hash(&scenario, "20000");
        // The log grows by 745 bytes a tick.
        let (kill, sizes) = ((program, "KILL"), random_steps(8, 5, 11_000_000));
        let outcome = run_with_signals(&test_folder, &scenario, "20000", kill, sizes).expect(0);
        assert_eq!(check(&test_folder, &outcome, role, &hash), 5, "{program}");
    }
}

#[test]
fn a_hanging_process_is_killed_and_restarted() {
    let test_folder = TestFolder::new();
    let scenario = test_folder.scenario("paper", &[], QUICK);
    let hash = undisturbed_hash(&scenario, "100000");
    let stop = ("tectum-controller", "STOP");
    let outcome = run_with_signals(&test_folder, &scenario, "100000", stop, [100_000].into_iter()).expect(0);
    assert_eq!(check(&test_folder, &outcome, "controller", &hash), 1);
    assert!(outcome.stderr.contains("the controller gives no sign of life any more and is killed"), "{outcome:#?}");
}

/// In real time the ticks without a controller are missed, flagged and not learned from. What was learned before stays.
#[test]
fn in_real_time_a_run_continues_and_counts_missed_ticks() {
    let test_folder = TestFolder::new();
    let scenario = test_folder.scenario("paper", &[("period_ms", "2"), ("every", "1")], QUICK);
    let mut run = test_folder.run(&[&scenario, "--mode", "realtime", "--ticks", "1500", "--json"]);
    let log = test_folder.log_path();
    signal_at_sizes(&mut run, &log, "tectum-controller", "KILL", [100_000, 400_000].into_iter());
    let outcome = run.wait().expect(0);
    let summary = outcome.json();
    assert_eq!(summary["restarts"].as_array().unwrap().len(), 2, "{outcome:#?}");
    let missed = summary["missed"].as_u64().unwrap();
    let (ticks, skipped) = (summary["ticks"].as_u64().unwrap(), summary["skipped"].as_u64().unwrap());
    assert!(missed >= 2 && ticks + skipped == 1500, "{outcome:#?}");
    let report = read_json(test_folder.run_folder().join("controller.json"));
    let (learned, cuts) = (report["learned"].as_u64().unwrap(), report["cuts"].as_u64().unwrap());
    assert!(cuts >= 2 && learned + missed < 1500, "{report}");
    assert_no_debris(test_folder.run_folder());
}

#[test]
fn too_many_restarts_end_the_run() {
    let test_folder = TestFolder::new();
    let few = QUICK.replace("give_up_after = 100", "give_up_after = 2");
    let scenario = test_folder.scenario("paper", &[("ticks", "10000000")], &few);
    let mut run = test_folder.run(&[&scenario, "--json"]);
    let log = test_folder.log_path();
    signal_at_sizes(&mut run, &log, "tectum-controller", "KILL", [100_000, 200_000, 300_000].into_iter());
    let outcome = run.wait().expect(4);
    assert_eq!(outcome.json()["restarts"].as_array().unwrap().len(), 2, "{outcome:#?}");
    assert!(outcome.json()["failure"].as_str().unwrap().contains("the controller was killed by signal 9"));
    assert_no_debris(test_folder.run_folder());
}

/// The process faults of a scenario happen in the given order and change no number in lockstep.
#[test]
fn process_faults_happen_at_their_ticks() {
    let test_folder = TestFolder::new();
    let faults = r#"
[[faults.process]]
process = "controller"
do = "kill"
at = [3000, 9000]

[[faults.process]]
process = "plant"
do = "restart"
at = [6000]

[[faults.process]]
process = "controller"
do = "restart"
at = [12000]

[[faults.process]]
process = "controller"
do = "stop"
for_ms = 30
at = [15000]

[[faults.process]]
process = "plant"
do = "kill"
at = [18000]
"#;
    let scenario = test_folder.scenario("paper", &[], &format!("{QUICK}{faults}"));
    let hash = undisturbed_hash(&scenario, "30000");
    let outcome = test_folder.run(&[&scenario, "--ticks", "30000", "--json"]).wait().expect(0);
    let summary = outcome.json();
    assert_eq!(summary["weights_hash"], hash, "{outcome:#?}");
    let restarts: Vec<_> =
        summary["restarts"].as_array().unwrap().iter().map(|r| r["process"].as_str().unwrap()).collect();
    assert_eq!(restarts, ["controller", "plant", "controller", "controller", "plant"], "{outcome:#?}");
    assert!(summary["faults"].as_array().unwrap().len() == 5, "{outcome:#?}");
    assert_no_debris(test_folder.run_folder());
}
