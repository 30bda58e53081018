//! Two runs on this machine, each with its own folder and domain, and a link between them over loopback: the numbers
//! are those of one machine, deaths and cuts are survived, and strangers stay outside.
//!
//! Without zenoh the carrier is bare UDP (`cargo test -p tectum-link --no-default-features`); with it, both are tried.

mod common;

use std::process::Command;
use std::time::Duration;

use common::{LINK, LinkedMachine, address, carriers, pair, pair_over, start_over};
use tectum_testkit::{Process, TestFolder, program, stop_process_for};

#[test]
fn what_the_network_loses_is_missed_and_nothing_else() {
    let (_network, machines, runs) = pair_over(&["--loss", "0.05"], &["--ticks", "200"]);
    let [plant, _] = runs.map(|run| run.wait().expect(0).json());
    let lost = machines[0].report()["commands_lost"].as_u64().unwrap();
    let missed = plant["missed"].as_u64().unwrap();
    // A tenth of 200 ticks is expected, and a machine that stands still adds some.
    assert!((5..80).contains(&lost), "{lost}");
    assert!(missed.abs_diff(lost) <= 3 + missed / 4, "missed {missed}, lost {lost}");
}

/// There and back takes longer than a tick, so that every command is late. Those that it brings ahead are not.
#[test]
fn commands_ahead_reach_a_plant_for_which_every_command_is_late() {
    let text = std::fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/../../scenarios/arm.toml")).unwrap();
    let scenario = text.replacen("hold_ticks = 2", "hold_ticks = 4", 1) + "\n[link]\nahead = 4\n";
    let machines = ["plant", "controller"].map(|side| LinkedMachine::with_scenario(side, &scenario));
    let (_network, runs) = start_over(&["--delay-ms", "40"], &machines, &["--ticks", "160"]);
    let [plant, controller] = runs.map(|run| run.wait().expect(0).json());
    let (missed, ahead) = (plant["missed"].as_u64().unwrap(), plant["ahead"].as_u64().unwrap());
    assert!(missed >= 130 && ahead + 20 >= missed, "missed {missed}, ahead {ahead}");
    assert!(controller["learner"]["plans"].as_u64() > Some(40), "{controller}");
}

#[test]
fn in_lockstep_a_lossy_network_changes_no_number() {
    let alone = TestFolder::new();
    let arguments = ["run", "arm", "--ticks", "150", "--out", "run", "--json"];
    let alone = alone.start(program("tectum"), &arguments).wait().expect(0).json();
    let (_network, machines, runs) = pair_over(&["--loss", "0.1"], &["--mode", "lockstep", "--ticks", "150"]);
    for run in runs {
        assert_eq!(run.wait().expect(0).json()["weights_hash"], alone["weights_hash"]);
    }
    assert!(machines[0].report()["repeated"].as_u64() > Some(0));
}

#[test]
fn in_lockstep_the_numbers_are_those_of_one_machine() {
    let alone = TestFolder::new();
    let arguments = ["run", "arm", "--ticks", "300", "--out", "run", "--json"];
    let alone = alone.start(program("tectum"), &arguments).wait().expect(0).json();
    for carrier in carriers() {
        let (machines, runs) = pair(carrier, &["--mode", "lockstep", "--ticks", "300"]);
        for (run, machine) in runs.into_iter().zip(&machines) {
            let summary = run.wait().expect(0).json();
            assert_eq!(summary["weights_hash"], alone["weights_hash"], "{carrier}, {}", machine.side);
            assert_eq!(summary["missed"], 0);
            machine.folder.assert_no_debris();
        }
    }
}

#[test]
fn in_real_time_it_learns_and_says_how_long_each_leg_takes() {
    for carrier in carriers() {
        let (machines, runs) = pair(carrier, &["--ticks", "100"]);
        for (run, machine) in runs.into_iter().zip(&machines) {
            let summary = run.wait().expect(0).json();
            assert!(summary["ticks"].as_u64() > Some(90), "{carrier}, {}: {summary}", machine.side);
        }
        let legs = &machines[0].report()["legs"];
        assert!(legs["observation_to_command_us"]["p50"].as_f64() > Some(0.0), "{carrier}: {legs}");
        assert!(machines[1].report()["clock"].is_object(), "{carrier}");
    }
}

#[test]
fn a_link_process_that_is_killed_comes_back() {
    for side in 0..2 {
        let (machines, mut runs) = pair("raw", &["--ticks", "160"]);
        runs[0].wait_until_tick(40);
        runs[side].kill_child("tectum-link");
        for (run, machine) in runs.into_iter().zip(&machines) {
            let summary = run.wait().expect(0).json();
            // A second or so without commands, of eight.
            assert!(summary["missed"].as_u64() < Some(80), "{side}, {}: {summary}", machine.side);
            assert!(summary["ticks"].as_u64() > Some(80), "{side}, {}: {summary}", machine.side);
        }
    }
}

#[test]
fn during_a_cut_the_arm_gets_no_command_and_afterwards_it_goes_on() {
    let (machines, mut runs) = pair("raw", &["--ticks", "160"]);
    runs[0].wait_until_tick(40);
    // Half of the link hears and says nothing for 20 ticks.
    let stopped = runs[0].child_pid("tectum-link");
    stop_process_for(stopped, Duration::from_secs(1));
    let [plant, controller] = runs.map(|run| run.wait().expect(0).json());
    let missed = plant["missed"].as_u64().unwrap();
    assert!((15..100).contains(&missed), "{missed} of 20 or so: {plant}");
    assert!(controller["ticks"].as_u64() > Some(60), "{controller}");
    assert!(machines[0].report().is_object());
}

#[test]
fn ctrl_c_on_one_machine_ends_the_run_on_the_other() {
    for side in 0..2 {
        let (machines, mut runs) = pair("raw", &["--ticks", "100000"]);
        runs[0].wait_until_tick(20);
        runs[side].signal("INT");
        let mut outcomes = runs.map(Process::wait).into_iter();
        let [plant, controller] = [outcomes.next().unwrap(), outcomes.next().unwrap()];
        let (stopped, other) = if side == 0 { (plant, controller) } else { (controller, plant) };
        let summary = stopped.expect(130).json();
        assert!(summary["ticks"].as_u64() >= Some(10), "{summary}");
        assert_ne!(other.json()["ended"], "complete", "side {side}");
        machines.iter().for_each(|machine| machine.folder.assert_no_debris());
    }
}

#[test]
fn a_stranger_stays_outside() {
    let key = |digit: &str| digit.repeat(64) + "\n";
    let address = address("raw");
    let (plant, stranger) = (LinkedMachine::new("plant"), LinkedMachine::new("controller"));
    plant.file("key", &key("a"));
    stranger.file("key", &key("b"));
    let more = ["--key", "key", "--wait", "2"];
    let runs = [plant.start(["--listen", &address], &more), stranger.start(["--connect", &address], &more)];
    let said = runs.map(|run| run.wait().expect(2).stderr);
    assert!(said.iter().all(|said| said.contains("gave no answer at")), "{said:?}");
    assert!(said[0].contains("not made with this link's key"), "{said:?}");
}

#[test]
fn the_same_key_lets_in() {
    let address = address("raw");
    let machines = [LinkedMachine::new("plant"), LinkedMachine::new("controller")];
    machines.iter().for_each(|machine| drop(machine.file("key", &("7f".repeat(32) + "\n"))));
    let more = ["--key", "key", "--mode", "lockstep", "--ticks", "200"];
    let runs = [machines[0].start(["--listen", &address], &more), machines[1].start(["--connect", &address], &more)];
    for run in runs {
        run.wait().expect(0);
    }
}

#[test]
fn runs_that_differ_are_refused_before_a_tick() {
    let address = address("raw");
    let machines = [LinkedMachine::new("plant"), LinkedMachine::new("controller")];
    let runs = [
        machines[0].start(["--listen", &address], &["--seed", "1", "--wait", "5"]),
        machines[1].start(["--connect", &address], &["--seed", "2", "--wait", "5"]),
    ];
    for run in runs {
        let outcome = run.wait().expect(3);
        assert!(outcome.stderr.contains("runs another scenario"), "{outcome:#?}");
    }
}

#[test]
fn bad_input_is_one_sentence_and_starts_nothing() {
    let folder = TestFolder::new();
    folder.write_file("short", "abc\n");
    for (arguments, sentence) in [
        (["--listen", "127.0.0.1:7447", "--wait", "1"], "is no address of a link"),
        (["--listen", "raw/0.0.0.0:7447", "--wait", "1"], "no single address"),
        (["--listen", "raw/192.168.7.2:7447", "--wait", "1"], "neither loopback nor one of link.hosts"),
        (["--listen", "raw/127.0.0.1:7447", "--key", "absent"], "the key absent cannot be used"),
        (["--listen", "raw/127.0.0.1:7447", "--key", "short"], "the key short cannot be used"),
    ] {
        let mut command = Command::new(LINK);
        command.args(["plant", "arm", "--out", "run"]).args(arguments);
        let said = folder.start_command(command).wait().expect(2).refusal();
        assert!(said.contains(sentence), "{arguments:?}: {said}");
        assert!(!folder.run_folder().exists(), "{arguments:?}");
    }
}
