//! The guard of the real bridge, on the real emulator: torque goes off soon after a bridge or `jog` has died or fallen
//! silent, whatever became of it. The measure is the emulator's own: how far a shaft turned between two instructions.

#[path = "support/emulator.rs"]
mod emulator;
mod support;

use std::io::{BufRead as _, BufReader, Write as _};
use std::os::fd::OwnedFd;
use std::process::{Child, Command, Stdio};

use emulator::Emulator;
use rustix::fs::{Mode, OFlags};
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use serde_json::Value;
use support::{Process, TestFolder, children, signal_process};
use tectum::servo::model::STEP;

const BRIDGE: &str = env!("CARGO_BIN_EXE_tectum-bridge");

/// The period of the scenario, s, and the highest speed of its joints, rad/s.
const PERIOD: f64 = 0.2;
const MAX_SPEED: f64 = 1.0;

/// A chain of four servos that reports each change of torque, and what the scenarios here say of it.
struct Arm {
    emulator: Emulator,
    /// The last report of each servo, by id.
    servos: [Value; 5],
}

impl Arm {
    fn start(test_folder: &TestFolder, protocol: &str) -> Self {
        let arguments = ["--protocol", protocol, "--ids", "1,2,3,4", "--link", "arm", "--trace"];
        let mut emulator = Emulator::start(test_folder, &arguments);
        assert!(emulator.next_report()["port"].is_string());
        let mut arm = Self { emulator, servos: Default::default() };
        arm.wait_for_torque(false);
        arm
    }

    fn take_report(&mut self) {
        for servo in self.emulator.next_report()["servos"].as_array().unwrap() {
            self.servos[servo["id"].as_u64().unwrap() as usize] = servo.clone();
        }
    }

    /// Waits until all servos have torque, or none has.
    fn wait_for_torque(&mut self, on: bool) {
        while self.servos[1..].iter().any(|servo| servo["torque"] != on) {
            self.take_report();
        }
    }

    /// Waits until a shaft turns at its highest speed. A few ticks pass until one does; after hundreds, none will.
    fn wait_for_full_speed(&mut self) {
        let full = 0.98 * MAX_SPEED / STEP;
        let mut looks = 0;
        while self.servos[1..].iter().all(|servo| servo["speed"].as_f64().is_none_or(|speed| speed.abs() < full)) {
            looks += 1;
            assert!(looks < 6_000, "no shaft reaches full speed: {:?}", self.servos);
            self.emulator.send_command("state");
            self.take_report();
            std::thread::park_timeout(std::time::Duration::from_millis(20));
        }
    }

    /// Starts a jog of servo 2 by so many rad at so many rad/s, and waits until the servo has torque.
    fn jog(&mut self, test_folder: &TestFolder, protocol: &str, [by, speed]: [&str; 2]) -> Child {
        let jog = Command::new(BRIDGE)
            .args(["jog", "--port", "arm", "--protocol", protocol, "--id", "2", "--by", by, "--speed", speed])
            .current_dir(test_folder.path())
            .stdin(Stdio::null())
            .spawn()
            .unwrap();
        while self.servos[2]["torque"] != true {
            self.take_report();
        }
        jog
    }

    /// The longest turn of a shaft without an instruction, rad.
    fn unattended(&self) -> f64 {
        self.servos[1..].iter().map(|servo| servo["unattended"].as_f64().unwrap() * STEP).fold(0.0, f64::max)
    }
}

/// A scenario in which four servos turn at their highest speed.
fn scenario(test_folder: &TestFolder, protocol: &str, goal: &str) -> String {
    let text = std::fs::read_to_string("scenarios/servo-emulated.toml").unwrap();
    let (head, tail) = text.split_once("\n[plant.emulator]\n").unwrap();
    let (_, tail) = tail.split_once("[encoder]").unwrap();
    let head = head.replace("\"emulator\" ", "\"arm\" ").replace("\"dynamixel\" ", &format!("\"{protocol}\" "));
    let head = head.replace("max_speed = 12.0", "max_speed = 1.0").replace("period_ms = 50", "period_ms = 200");
    let head = head.replace("goal = \"speed\"", &format!("goal = \"{goal}\""));
    // Position goals need ends.
    let range = if goal == "position" { "range = [-2.0, 2.0]\nmax_speed" } else { "max_speed" };
    let head = head.replace("max_speed", range);
    let tail = tail.replace("\"learned-reward\"", "\"paper\"").replace("sigma = 0.001", "sigma = 0.01");
    let text = format!("{head}\n[encoder]{tail}\n[restart]\nplant = \"never\"\n");
    test_folder.write_file("scenario.toml", text).to_str().unwrap().to_owned()
}

/// A run, and the bridge in it: the launcher's child, or one that was started by hand.
fn start_run(test_folder: &TestFolder, protocol: &str, goal: &str, by_hand: bool) -> (Process, Option<Process>, u32) {
    let scenario = scenario(test_folder, protocol, goal);
    let mut arguments = vec![scenario.as_str(), "--ticks", "10000"];
    if by_hand {
        arguments.extend(["--by-hand", "plant"]);
    }
    let mut run = test_folder.run(&arguments);
    if !by_hand {
        let pid = run.child_pid("tectum-bridge");
        return (run, None, pid);
    }
    let manifest = test_folder.run_folder().join("run.json");
    run.wait_until("the run's folder", || manifest.exists());
    let bridge = test_folder.start(BRIDGE, &["--run", "run"]);
    let pid = bridge.id();
    (run, Some(bridge), pid)
}

fn every_signal_leaves_the_arm_still(protocol: &str, by_hand: bool) {
    for signal in ["STOP", "KILL", "HUP", "QUIT", "TSTP"] {
        let test_folder = TestFolder::new();
        let mut arm = Arm::start(&test_folder, protocol);
        let (run, bridge, pid) = start_run(&test_folder, protocol, "speed", by_hand);
        arm.wait_for_torque(true);
        arm.wait_for_full_speed();
        // What ends the bridge may reach the guard too; it takes none of them.
        if signal != "KILL" && signal != "STOP" {
            children(pid).iter().for_each(|(guard, _)| signal_process(*guard, signal));
        }
        signal_process(pid, signal);
        arm.wait_for_torque(false);
        let (turned, most) = (arm.unattended(), 5.0 * PERIOD * MAX_SPEED);
        assert!(turned > 0.0 && turned <= most, "{protocol}, {signal}: {turned} rad; at most {most} rad are allowed");
        // Feetech servos have no watchdog: at full speed they turn until the guard acts, after four silent periods.
        if (protocol, signal) == ("feetech", "STOP") {
            assert!(turned >= 3.5 * PERIOD * MAX_SPEED, "{turned} rad: not at full speed to the end");
        }
        drop(bridge);
        run.wait().expect(4);
    }
}

#[test]
fn dynamixel_started_by_the_launcher() {
    every_signal_leaves_the_arm_still("dynamixel", false);
}

#[test]
fn feetech_started_by_the_launcher() {
    every_signal_leaves_the_arm_still("feetech", false);
}

#[test]
fn dynamixel_started_by_hand() {
    every_signal_leaves_the_arm_still("dynamixel", true);
}

#[test]
fn feetech_started_by_hand() {
    every_signal_leaves_the_arm_still("feetech", true);
}

/// With position goals a servo stops by itself, one tick's travel ahead.
#[test]
fn position_goals_leave_the_arm_still() {
    for (protocol, signal) in [("dynamixel", "STOP"), ("dynamixel", "KILL"), ("feetech", "STOP"), ("feetech", "KILL")] {
        let test_folder = TestFolder::new();
        let mut arm = Arm::start(&test_folder, protocol);
        let (run, _, pid) = start_run(&test_folder, protocol, "position", false);
        arm.wait_for_torque(true);
        arm.wait_for_full_speed();
        signal_process(pid, signal);
        arm.wait_for_torque(false);
        let (turned, most) = (arm.unattended(), 2.0 * PERIOD * MAX_SPEED);
        assert!(turned > 0.0 && turned <= most, "{protocol}, {signal}: {turned} rad; at most {most} rad are allowed");
        run.wait().expect(4);
    }
}

/// A bridge whose guard has died turns torque off itself, and says so.
#[test]
fn without_its_guard_a_bridge_has_no_torque() {
    let test_folder = TestFolder::new();
    let mut arm = Arm::start(&test_folder, "feetech");
    let (run, _, pid) = start_run(&test_folder, "feetech", "speed", false);
    arm.wait_for_torque(true);
    children(pid).iter().for_each(|(guard, _)| signal_process(*guard, "KILL"));
    arm.wait_for_torque(false);
    run.signal("INT");
    let outcome = run.wait();
    assert!(outcome.stderr.contains("the guard process has died"), "{outcome:#?}");
}

/// `jog` has the same guard as the bridge.
#[test]
fn jog_leaves_no_torque_behind() {
    for (protocol, signal) in [("feetech", "HUP"), ("feetech", "KILL"), ("dynamixel", "STOP")] {
        let test_folder = TestFolder::new();
        let mut arm = Arm::start(&test_folder, protocol);
        let mut jog = arm.jog(&test_folder, protocol, ["2", "0.01"]);
        signal_process(jog.id(), signal);
        arm.wait_for_torque(false);
        assert!(!jog.wait().unwrap().success(), "{protocol}, {signal}");
    }
}

/// A run or `jog` that ends while the cable is out leaves the servos, which keep power and torque, to the
/// guard: it waits for the cable.
#[test]
fn what_ends_while_the_cable_is_out_leaves_no_torque_behind() {
    for protocol in ["feetech", "dynamixel"] {
        let test_folder = TestFolder::new();
        let mut arm = Arm::start(&test_folder, protocol);
        let (mut run, _, _) = start_run(&test_folder, protocol, "position", false);
        arm.wait_for_torque(true);
        arm.emulator.send_command("unplug");
        run.signal("INT");
        run.wait_until_or_end("the end of the run", || false);
        run.wait();
        arm.emulator.send_command("state");
        arm.take_report();
        assert!(arm.servos[1..].iter().all(|servo| servo["torque"] == true), "{protocol}: nobody could tell them");
        arm.emulator.send_command("plug");
        arm.wait_for_torque(false);

        let mut jog = arm.jog(&test_folder, protocol, ["1", "0.02"]);
        arm.emulator.send_command("unplug");
        assert!(!jog.wait().unwrap().success(), "{protocol}");
        arm.emulator.send_command("plug");
        arm.wait_for_torque(false);
    }
}

/// The cable is out for a while: the emulator ends, and another one takes its place under the same name.
#[test]
fn a_cable_that_comes_back_is_used_again() {
    let test_folder = TestFolder::new();
    let mut arm = Arm::start(&test_folder, "feetech");
    let (run, _, _) = start_run(&test_folder, "feetech", "speed", false);
    arm.wait_for_torque(true);
    drop(arm);
    let mut arm = Arm::start(&test_folder, "feetech");
    arm.wait_for_torque(true);
    run.signal("INT");
    let outcome = run.wait().expect(130);
    arm.wait_for_torque(false);
    for text in ["torque may still be on: the port is gone; its cable is out", "the port is open again"] {
        assert!(outcome.stderr.contains(text), "{text}: {outcome:#?}");
    }
    assert!(outcome.stdout.contains("ticks without torque"), "{outcome:#?}");
}

/// A terminal for a program, and its other end, at which a test types.
fn terminal() -> (OwnedFd, std::fs::File) {
    let ours = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC).unwrap();
    grantpt(&ours).unwrap();
    unlockpt(&ours).unwrap();
    let path = ptsname(&ours, Vec::new()).unwrap();
    let theirs = rustix::fs::open(&path, OFlags::RDWR | OFlags::NOCTTY | OFlags::CLOEXEC, Mode::empty()).unwrap();
    (theirs, ours.into())
}

/// With `rearm = "by-hand"`, torque returns after the cable was out when `a` and Enter are typed at the bridge's
/// terminal.
#[test]
fn by_hand_torque_returns_when_it_is_typed() {
    let test_folder = TestFolder::new();
    let mut arm = Arm::start(&test_folder, "feetech");
    let path = scenario(&test_folder, "feetech", "speed");
    let text = std::fs::read_to_string(&path).unwrap();
    let text = text.replace("armed = true ", "rearm = \"by-hand\"\narmed = true ");
    let path = test_folder.write_file("by-hand.toml", text);
    let mut run = test_folder.run(&[path.to_str().unwrap(), "--ticks", "10000", "--by-hand", "plant"]);
    let manifest = test_folder.run_folder().join("run.json");
    run.wait_until("the run's folder", || manifest.exists());
    let (theirs, mut keyboard) = terminal();
    let mut bridge = Command::new(BRIDGE)
        .args(["--run", "run"])
        .current_dir(test_folder.path())
        .stdin(theirs)
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut said = BufReader::new(bridge.stderr.take().unwrap()).lines();
    let mut wait_for = |text: &str| said.by_ref().map(Result::unwrap).find(|line| line.contains(text)).unwrap();
    arm.wait_for_torque(true);
    drop(arm);
    let sentence = wait_for("its cable is out");
    assert!(sentence.contains("arm it again to go on"), "{sentence}");
    let mut arm = Arm::start(&test_folder, "feetech");
    wait_for("the port is open again");
    keyboard.write_all(b"a\n").unwrap();
    arm.wait_for_torque(true);
    run.signal("INT");
    run.wait().expect(130);
    arm.wait_for_torque(false);
    bridge.wait().unwrap();
}

/// A cable that stays out is a failure of the run, not bad input.
#[test]
fn a_cable_that_stays_out_ends_the_run() {
    let test_folder = TestFolder::new();
    let mut arm = Arm::start(&test_folder, "feetech");
    let path = scenario(&test_folder, "feetech", "speed");
    let text = std::fs::read_to_string(&path).unwrap().replace("armed = true ", "reopen_within_s = 0.5\narmed = true ");
    let path = test_folder.write_file("short.toml", text);
    let run = test_folder.run(&[path.to_str().unwrap(), "--ticks", "10000"]);
    arm.wait_for_torque(true);
    drop(arm);
    let outcome = run.wait().expect(4);
    assert!(outcome.stderr.contains("no such port"), "{outcome:#?}");
}

/// What a living bridge says reaches the terminal, and a run whose torque was off at its end does not end as success.
#[test]
fn an_overload_is_told() {
    let test_folder = TestFolder::new();
    let text = std::fs::read_to_string("scenarios/servo-emulated.toml").unwrap();
    let fault = "[[plant.emulator.faults]]\nkind = \"overload\"\nservo = 2\nfrom_s = 1.0\n\n[encoder]\n";
    let text = text.replacen("[encoder]\n", fault, 1).replace("\"learned-reward\"", "\"paper\"");
    let scenario = test_folder.write_file("overload.toml", text);
    let outcome = test_folder.run(&[scenario.to_str().unwrap(), "--ticks", "160"]).wait().expect(4);
    assert!(outcome.stderr.contains("torque is off: a servo is overloaded"), "{outcome:#?}");
    assert!(outcome.stdout.contains("ticks without torque") && outcome.stdout.contains("overloaded"), "{outcome:#?}");
    let info = test_folder.tectum("log", &["info", "run"]).expect(0);
    assert!(info.stdout.contains("TRIPPED"), "{info:#?}");
}

/// The launcher kills a process with its whole group. The guard is not in it, and what it says later is heard.
#[test]
fn the_guard_outlives_the_bridges_process_group() {
    let test_folder = TestFolder::new();
    let mut arm = Arm::start(&test_folder, "feetech");
    let (run, _, pid) = start_run(&test_folder, "feetech", "speed", false);
    arm.wait_for_torque(true);
    arm.wait_for_full_speed();
    let killed = std::process::Command::new("kill").args(["-KILL", "--", &format!("-{pid}")]).status().unwrap();
    assert!(killed.success());
    arm.wait_for_torque(false);
    let outcome = run.wait().expect(4);
    let said = "guard: the process ended without turning torque off; torque is off";
    assert!(outcome.stderr.contains(said), "{outcome:#?}");
}
