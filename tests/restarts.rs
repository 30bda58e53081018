//! A process that is killed comes back, and the run goes on: with the very numbers of an undisturbed one in lockstep, with
//! missed ticks that nobody learns from in real time.

mod support;

use std::path::Path;

use support::{Outcome, Place, Process, assert_no_debris, children, signal_process};

/// Restarts as quick as they can be.
const QUICK: &str = "\n[restart]\nbackoff_ms = 1\nbackoff_cap_ms = 10\ngive_up_after = 100\nhang_s = 1\n";

fn scenario(place: &Place, name: &str, changes: &[(&str, &str)], restart: &str) -> String {
    let text = std::fs::read_to_string(format!("scenarios/{name}.toml")).unwrap() + restart;
    let mut lines: Vec<String> = text.lines().map(str::to_owned).collect();
    for (key, value) in changes {
        *lines.iter_mut().find(|line| line.split(" = ").next() == Some(key)).unwrap() = format!("{key} = {value}");
    }
    place.file("scenario.toml", lines.join("\n")).to_str().unwrap().to_owned()
}

fn size(log: &Path) -> u64 {
    std::fs::metadata(log).map_or(0, |m| m.len())
}

/// Sends `signal` to the run's `program`, each time when its log has grown to another of `sizes`.
fn strike(run: &mut Process, log: &Path, program: &str, signal: &str, sizes: impl Iterator<Item = u64>) {
    let mut last = 0;
    for bytes in sizes {
        run.until("a grown log", || size(log) > bytes);
        let (parent, before) = (run.id(), last);
        run.until("the process, or its successor", || {
            let there = children(parent).into_iter().find(|(pid, name)| name == program && *pid != before);
            last = there.map_or(before, |(pid, _)| pid);
            last != before
        });
        signal_process(last, signal);
    }
}

/// Numbers that grow to `most` by steps of random size, the same ones every time.
fn random_steps(mut seed: u64, count: u64, most: u64) -> impl Iterator<Item = u64> {
    (0..count).map(move |i| {
        seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (i * most + (seed >> 33) % most) / count
    })
}

fn undisturbed(scenario: &str, ticks: &str) -> String {
    let place = Place::new();
    let outcome = place.run(&[scenario, "--mode", "in-process", "--ticks", ticks, "--json"]).wait().expect(0);
    outcome.json()["weights_hash"].as_str().unwrap().to_owned()
}

fn check(place: &Place, outcome: &Outcome, program: &str, hash: &str) -> usize {
    let summary = outcome.json();
    assert_eq!(summary["weights_hash"], hash, "{outcome:#?}");
    assert_eq!(summary["lost"], 0, "{outcome:#?}");
    assert_no_debris(&place.run_folder());
    let back = summary["restarts"].as_array().unwrap();
    assert!(back.iter().all(|incident| incident["process"] == program), "{outcome:#?}");
    back.len()
}

/// I5.
#[test]
fn a_controller_killed_twenty_times_learns_what_it_would_have_learned() {
    let place = Place::new();
    let scenario = scenario(&place, "paper", &[], QUICK);
    let hash = undisturbed(&scenario, "200000");
    let mut run = place.run(&[&scenario, "--ticks", "200000", "--json"]);
    let log = place.run_folder().join("log.mcap");
    // One tick in a hundred is written, in 521 bytes.
    strike(&mut run, &log, "tectum-controller", "KILL", random_steps(5, 20, 800_000));
    assert_eq!(check(&place, &run.wait().expect(0), "controller", &hash), 20);
}

/// The body is the world, which does not start anew because its driver does.
#[test]
fn a_plant_that_is_killed_goes_on_where_it_was() {
    let place = Place::new();
    let scenario = scenario(&place, "paper", &[], QUICK);
    let hash = undisturbed(&scenario, "100000");
    let mut run = place.run(&[&scenario, "--ticks", "100000", "--json"]);
    let log = place.run_folder().join("log.mcap");
    strike(&mut run, &log, "tectum-simulator", "KILL", random_steps(6, 8, 400_000));
    assert_eq!(check(&place, &run.wait().expect(0), "plant", &hash), 8);
}

/// Whatever a rule remembers: models, memories of states, candidates, traces.
#[test]
fn every_rule_survives() {
    // As many ticks as take the rule much longer than a return.
    for (name, rule, ticks) in [
        ("arm", "learned-reward", 700),
        ("paper", "natural-actor-critic", 20_000),
        ("paper", "actor-critic", 60_000),
        ("paper", "baseline", 60_000),
    ] {
        let place = Place::new();
        let scenario = scenario(&place, name, &[("rule", &format!("\"{rule}\"")), ("every", "1")], QUICK);
        let hash = undisturbed(&scenario, &ticks.to_string());
        let mut run = place.run(&[&scenario, "--ticks", &ticks.to_string(), "--json"]);
        let log = place.run_folder().join("log.mcap");
        strike(&mut run, &log, "tectum-controller", "KILL", random_steps(7, 2, ticks * 521 / 2));
        assert_eq!(check(&place, &run.wait().expect(0), "controller", &hash), 2, "{rule}");
    }
}

/// The gate's ramp, what a faulty channel has under way: all of it is taken up again.
#[test]
fn faults_and_limits_go_on_as_well() {
    for (program, role) in [("tectum-controller", "controller"), ("tectum-simulator", "plant")] {
        let place = Place::new();
        let scenario = scenario(&place, "office", &[("rule", "\"paper\"")], QUICK);
        let hash = undisturbed(&scenario, "20000");
        let mut run = place.run(&[&scenario, "--ticks", "20000", "--json"]);
        let log = place.run_folder().join("log.mcap");
        // 521 bytes a tick.
        strike(&mut run, &log, program, "KILL", random_steps(8, 5, 8_000_000));
        assert_eq!(check(&place, &run.wait().expect(0), role, &hash), 5, "{program}");
    }
}

#[test]
fn a_process_that_hangs_is_killed_and_comes_back() {
    let place = Place::new();
    let scenario = scenario(&place, "paper", &[], QUICK);
    let hash = undisturbed(&scenario, "100000");
    let mut run = place.run(&[&scenario, "--ticks", "100000", "--json"]);
    let log = place.run_folder().join("log.mcap");
    strike(&mut run, &log, "tectum-controller", "STOP", [100_000].into_iter());
    let outcome = run.wait().expect(0);
    assert_eq!(check(&place, &outcome, "controller", &hash), 1);
    assert!(outcome.stderr.contains("the controller gives no sign of life any more and is killed"), "{outcome:#?}");
}

/// In real time the ticks without a controller are missed, flagged and not learned from; what was learned stays.
#[test]
fn in_real_time_the_run_goes_on_and_says_what_it_missed() {
    let place = Place::new();
    let scenario = scenario(&place, "paper", &[("period_ms", "2"), ("every", "1")], QUICK);
    let mut run = place.run(&[&scenario, "--mode", "realtime", "--ticks", "1500", "--json"]);
    let log = place.run_folder().join("log.mcap");
    strike(&mut run, &log, "tectum-controller", "KILL", [100_000, 400_000].into_iter());
    let outcome = run.wait().expect(0);
    let summary = outcome.json();
    assert_eq!(summary["restarts"].as_array().unwrap().len(), 2, "{outcome:#?}");
    let missed = summary["missed"].as_u64().unwrap();
    assert!(missed >= 2 && summary["ticks"].as_u64() > Some(1400), "{outcome:#?}");
    let text = std::fs::read_to_string(place.run_folder().join("controller.json")).unwrap();
    let controller: serde_json::Value = serde_json::from_str(&text).unwrap();
    let (learned, cuts) = (controller["learned"].as_u64().unwrap(), controller["cuts"].as_u64().unwrap());
    assert!(cuts >= 2 && learned + missed < 1500, "{text}");
    assert_no_debris(&place.run_folder());
}

#[test]
fn a_process_that_dies_again_and_again_ends_the_run() {
    let place = Place::new();
    let few = QUICK.replace("give_up_after = 100", "give_up_after = 2");
    let scenario = scenario(&place, "paper", &[("ticks", "10000000")], &few);
    let mut run = place.run(&[&scenario, "--json"]);
    let log = place.run_folder().join("log.mcap");
    strike(&mut run, &log, "tectum-controller", "KILL", [100_000, 200_000, 300_000].into_iter());
    let outcome = run.wait().expect(4);
    assert_eq!(outcome.json()["restarts"].as_array().unwrap().len(), 2, "{outcome:#?}");
    assert!(outcome.json()["failure"].as_str().unwrap().contains("the controller was killed by signal 9"));
    assert_no_debris(&place.run_folder());
}

/// What a scenario makes happen to processes happens, in the given order, and changes nothing in lockstep.
#[test]
fn faults_of_processes_happen_at_their_ticks() {
    let place = Place::new();
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
    let scenario = scenario(&place, "paper", &[], &format!("{QUICK}{faults}"));
    let hash = undisturbed(&scenario, "30000");
    let outcome = place.run(&[&scenario, "--ticks", "30000", "--json"]).wait().expect(0);
    let summary = outcome.json();
    assert_eq!(summary["weights_hash"], hash, "{outcome:#?}");
    let back: Vec<_> = summary["restarts"].as_array().unwrap().iter().map(|r| r["process"].as_str().unwrap()).collect();
    assert_eq!(back, ["controller", "plant", "controller", "controller", "plant"], "{outcome:#?}");
    assert!(summary["faults"].as_array().unwrap().len() == 5, "{outcome:#?}");
    assert_no_debris(&place.run_folder());
}
