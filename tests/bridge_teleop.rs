//! `tectum-bridge teleop` on two emulated chains: the follower has the leader's angles, every loss or fault of either
//! arm turns its torque off, and the log is that of a run.

#[path = "support/emulator.rs"]
mod emulator;
mod support;

use std::time::Duration;

use emulator::Emulator;
use serde_json::Value;
use support::{Process, TECTUM, TestFolder, assert_no_debris, signal_process};

const BRIDGE: &str = env!("CARGO_BIN_EXE_tectum-bridge");

/// An emulated arm, and the last report of each of its servos.
struct Arm {
    emulator: Emulator,
    ids: Vec<u8>,
    servos: Vec<Value>,
    /// Whether a servo has ever had torque.
    had_torque: bool,
}

impl Arm {
    fn start(test_folder: &TestFolder, link: &str, ids: &[u8]) -> Self {
        let list = ids.iter().map(u8::to_string).collect::<Vec<_>>().join(",");
        let arguments = ["--protocol", "feetech", "--ids", &list, "--link", link, "--trace"];
        let mut emulator = Emulator::start(test_folder, &arguments);
        assert!(emulator.next_report()["port"].is_string());
        let mut arm = Self { emulator, ids: ids.to_vec(), servos: vec![Value::Null; ids.len()], had_torque: false };
        arm.wait_for(|arm| arm.servos.iter().all(|servo| servo["torque"] == false));
        arm
    }

    fn wait_for(&mut self, ready: impl Fn(&Self) -> bool) {
        while !ready(self) {
            let report = self.emulator.next_report();
            self.take(report["servos"].as_array().unwrap());
        }
    }

    fn wait_for_torque(&mut self, on: bool) {
        self.wait_for(|arm| arm.servos.iter().all(|servo| servo["torque"] == on));
    }

    /// Waits until the servos stand at these positions, steps.
    fn wait_for_positions(&mut self, positions: &[f64]) {
        let apart = |servo: &Value, position: &f64| (servo["position"].as_f64().unwrap() - position).abs();
        self.wait_for_state(|arm| arm.servos.iter().zip(positions).all(|(servo, at)| apart(servo, at) <= 3.0));
    }

    /// Asks for the state until `ready`.
    fn wait_for_state(&mut self, ready: impl Fn(&Self) -> bool) {
        let n = self.ids.len();
        while !ready(self) {
            self.emulator.send_command("state");
            loop {
                let report = self.emulator.next_report();
                let servos = report["servos"].as_array().unwrap();
                self.take(servos);
                // A change of torque is reported servo by servo.
                if servos.len() == n {
                    break;
                }
            }
            std::thread::park_timeout(Duration::from_millis(20));
        }
    }

    fn take(&mut self, servos: &[Value]) {
        for servo in servos {
            let place = self.ids.iter().position(|&id| servo["id"] == id).unwrap();
            self.had_torque |= servo["torque"] == true;
            self.servos[place] = servo.clone();
        }
    }
}

/// Two joints follow by their names, in another order, with another range and direction; the gripper is held.
const LEADER: &str = "protocol = \"feetech\"\n[[joints]]\nid = 1\nname = \"pan\"\nrange = [-1.0, 1.0]\n\
    [[joints]]\nid = 2\nname = \"lift\"\nrange = [-1.0, 1.0]\n\
    [[joints]]\nid = 3\nname = \"trigger\"\nrange = [-1.0, 1.0]\n";
const FOLLOWER: &str = "protocol = \"feetech\"\n[[joints]]\nid = 11\nname = \"lift\"\nrange = [-1.5, 1.5]\n\
    [[joints]]\nid = 12\nname = \"pan\"\ndirection = -1\nrange = [-1.5, 1.5]\n\
    [[joints]]\nid = 13\nname = \"gripper\"\nrange = [-1.0, 1.0]\n";

/// Both arms, and a teleoperation between them with these further arguments.
fn start(test_folder: &TestFolder, more: &[&str]) -> (Arm, Arm, Process) {
    let leader = Arm::start(test_folder, "leader", &[1, 2, 3]);
    let follower = Arm::start(test_folder, "follower", &[11, 12, 13]);
    test_folder.write_file("leader.toml", LEADER);
    test_folder.write_file("follower.toml", FOLLOWER);
    let folder = test_folder.run_folder();
    let arguments = ["teleop", "leader", "follower", "--leader-calibration", "leader.toml", "--follower-calibration"];
    let settings =
        ["follower.toml", "--hold", "13", "--period-ms", "100", "--approach-speed", "1.0", "--json", "--out"];
    let run = test_folder.start(BRIDGE, &[&arguments[..], &settings, &[folder.to_str().unwrap()], more].concat());
    (leader, follower, run)
}

#[test]
fn the_follower_has_the_leaders_angles() {
    let test_folder = TestFolder::new();
    let (mut leader, mut follower, run) = start(&test_folder, &[]);
    follower.wait_for_torque(true);
    // 0.5 and -0.307 rad of 1.0 are 0.75 and -0.46 of 1.5; the follower's pan turns the other way round.
    leader.emulator.send_command("hand 1 2374");
    leader.emulator.send_command("hand 2 1848");
    follower.wait_for_positions(&[1748.0, 1559.0, 2048.0]);
    // Beyond the end of the leader's range it stays at the end of its own.
    leader.emulator.send_command("hand 2 1000");
    follower.wait_for_positions(&[1070.0, 1559.0, 2048.0]);
    run.signal("INT");
    let outcome = run.wait().expect(130);
    follower.wait_for_torque(false);
    assert!(!leader.had_torque && leader.servos.iter().all(|servo| servo["torque"] == false), "{:?}", leader.servos);
    assert!(outcome.stderr.contains("move nothing: trigger"), "{outcome:#?}");
    assert_eq!(outcome.json()["mode"], "realtime");
    assert_no_debris(test_folder.run_folder());

    let csv = test_folder.tectum("log", &["csv", "run"]).expect(0).stdout;
    assert!(["leader_lift", "leader_pan", "pan", "leader_read_us"].iter().all(|name| csv.contains(name)), "{csv}");
    let replay = test_folder.start(TECTUM, &["replay", "run", "--json"]).wait().expect(0).json();
    assert!(replay["difference"].is_null() && replay["commands"].as_u64() > Some(3), "{replay}");
}

/// Losses: torque goes off, and returns when the arm that was lost is back.
#[test]
fn a_loss_of_either_arm_turns_torque_off() {
    let test_folder = TestFolder::new();
    let (mut leader, mut follower, mut run) = start(&test_folder, &[]);
    follower.wait_for_torque(true);
    for (pulled, back) in [("unplug", Some("plug")), ("fault no-reply:2:0:1.5", None)] {
        leader.emulator.send_command(pulled);
        follower.wait_for_torque(false);
        back.iter().for_each(|back| leader.emulator.send_command(back));
        follower.wait_for_torque(true);
    }
    // The follower's own adapter: what comes first when it is back is torque off.
    follower.emulator.send_command("unplug");
    follower.emulator.send_command("plug");
    follower.wait_for_torque(false);
    follower.wait_for_torque(true);
    // A killed bridge leaves it to its guard, and the next one follows again.
    signal_process(run.child_pid("tectum-bridge"), "KILL");
    follower.wait_for_torque(false);
    follower.wait_for_torque(true);
    run.signal("INT");
    let outcome = run.wait().expect(130);
    follower.wait_for_torque(false);
    for text in ["the leader is lost (", "the leader's port is open again", "servo 2: no answer in time"] {
        assert!(outcome.stderr.contains(text), "{text}: {outcome:#?}");
    }
    assert!(outcome.json()["without_torque"]["the leader is lost"].as_u64() > Some(0), "{outcome:#?}");
    assert_no_debris(test_folder.run_folder());
}

/// A fault of the leader needs a new start, and the run's end is a failure.
#[test]
fn a_fault_of_the_leader_turns_torque_off_for_good() {
    let test_folder = TestFolder::new();
    let (mut leader, mut follower, run) = start(&test_folder, &["--ticks", "60"]);
    follower.wait_for_torque(true);
    leader.emulator.send_command("fault brown-out:2:0:1");
    follower.wait_for_torque(false);
    let outcome = run.wait().expect(4);
    assert!(outcome.stderr.contains("a servo of the leader reports an error"), "{outcome:#?}");
    assert!(outcome.stderr.contains("arm it again"), "{outcome:#?}");
    assert!(follower.servos.iter().all(|servo| servo["torque"] == false));
}

/// What does not fit is refused before any torque, with one sentence.
#[test]
fn arms_that_do_not_fit_are_refused() {
    let test_folder = TestFolder::new();
    test_folder.write_file("leader.toml", LEADER);
    test_folder.write_file("follower.toml", FOLLOWER);
    let files = ["--leader-calibration", "leader.toml", "--follower-calibration", "follower.toml"];
    for (code, message, more) in [
        (2, "joint gripper has no joint of that name", &["leader", "follower"][..]),
        (2, "plant.leader.port is \"same\"", &["same", "same", "--hold", "13"]),
        (2, "--period-ms 1", &["leader", "follower", "--hold", "13", "--period-ms", "1"]),
        (2, "--hold 9", &["leader", "follower", "--hold", "9"]),
        (4, "there is no such port", &["leader", "follower", "--hold", "13", "--ticks", "20"]),
    ] {
        let outcome = test_folder.start(BRIDGE, &[&["teleop"], more, &files].concat()).wait().expect(code);
        assert!(outcome.stderr.contains(message), "{message}: {outcome:#?}");
    }
    let printed = [&["teleop", "leader", "follower", "--hold", "13", "--print"][..], &files].concat();
    let printed = test_folder.start(BRIDGE, &printed).wait().expect(0);
    let file = test_folder.write_file("mine.toml", &printed.stdout);
    tectum::scenario::Scenario::load(&file).unwrap().plan().unwrap();
}
