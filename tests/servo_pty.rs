//! The real `tectum-servo-emulator` behind its pseudo-terminal, accessed through the operating system's serial port.

#[path = "support/emulator.rs"]
mod emulator;
mod support;

use std::path::Path;
use std::process::{Command, ExitStatus, Stdio};

use emulator::{EMULATOR, Emulator};
use serde_json::Value;
use support::{TestFolder, signal_process};
use tectum::servo::bus::{Bus, BusBudget, BusError};
use tectum::servo::model::Protocol;

/// Far longer than any stall of a busy machine.
const BUDGET: BusBudget = BusBudget { read_ns: 4_000_000_000, write_ns: 4_000_000_000 };

/// The next report of one servo's torque: the servo's id, and whether torque is on.
fn next_torque(emulator: &mut Emulator) -> (u64, bool) {
    let report = emulator.next_report();
    let servo = &report["servos"][0];
    (servo["id"].as_u64().unwrap(), servo["torque"].as_bool().unwrap())
}

/// Ends the emulator with a signal.
fn end(mut emulator: Emulator, signal: &str) -> ExitStatus {
    signal_process(emulator.child.id(), signal);
    emulator.child.wait().unwrap()
}

fn open(path: &Path, protocol: Protocol) -> Result<Bus, BusError> {
    Bus::open(path.to_str().unwrap(), protocol, 1_000_000, BUDGET, Box::new(tectum::clock::monotonic_ns))
}

#[test]
fn hosts_reconnect_and_a_joint_without_torque_moves_by_hand() {
    for (protocol, word) in [(Protocol::Dynamixel, "dynamixel"), (Protocol::Feetech, "feetech")] {
        let test_folder = TestFolder::new();
        let link = test_folder.path().join("arm");
        let mut emulator =
            Emulator::start(&test_folder, &["--protocol", word, "--ids", "1,2", "--link", "arm", "--trace"]);
        let first = emulator.next_report();
        assert_eq!((&first["port"], &first["ids"][1]), (&Value::from("arm"), &Value::from(2)), "{first}");
        assert_eq!([next_torque(&mut emulator), next_torque(&mut emulator)], [(1, false), (2, false)]);
        for _ in 0..2 {
            let mut bus = open_again(&link, protocol);
            let series = bus.series();
            let answers = [1, 2].map(|id| bus.ping(id));
            assert_eq!(answers, [true, true]);
            bus.write(2, series.torque_enable, 1).unwrap();
            assert_eq!(next_torque(&mut emulator), (2, true));
            bus.torque_off(&[1, 2]);
            assert_eq!(next_torque(&mut emulator), (2, false));
        }
        let mut bus = open_again(&link, protocol);
        let series = bus.series();
        emulator.send_command("hand 1 3000");
        assert_eq!(emulator.next_report()["servos"][0]["position"], 3000.0);
        assert_eq!(bus.read(1, series.position).unwrap(), 3000);
        let answers = bus.sync_read(&[2, 1], series.state).0.unwrap();
        let positions: Vec<_> =
            answers.iter().map(|answer| series.state.decode(series.position, &answer.bytes)).collect();
        assert_eq!(positions, [Some(2048), Some(3000)]);
        assert!(end(emulator, "TERM").success());
        assert!(link.symlink_metadata().is_err(), "the link goes with the emulator");
    }
}

/// Opens a port that this process has closed. A process that another test starts at that moment still has it until it
/// becomes another program, which takes well under a second.
fn open_again(path: &Path, protocol: Protocol) -> Bus {
    let begin = std::time::Instant::now();
    loop {
        match open(path, protocol) {
            Err(BusError::Busy(_)) if begin.elapsed().as_secs() < 20 => std::thread::yield_now(),
            other => return other.unwrap(),
        }
    }
}

#[test]
fn a_second_host_is_refused_as_busy() {
    let test_folder = TestFolder::new();
    let mut emulator = Emulator::start(&test_folder, &["--link", "arm"]);
    emulator.next_report();
    let link = test_folder.path().join("arm");
    let mut first = open(&link, Protocol::Dynamixel).unwrap();
    assert!(first.ping(1));
    let second = open(&link, Protocol::Dynamixel);
    assert!(matches!(second, Err(BusError::Busy(_))));
    drop(first);
    assert!(open_again(&link, Protocol::Dynamixel).ping(1));
    assert!(matches!(open(&test_folder.path().join("leg"), Protocol::Dynamixel), Err(BusError::NoPort(_))));
    assert!(end(emulator, "INT").success());
}

#[test]
fn faults_can_be_given_in_the_scenario_and_on_the_command_line() {
    let test_folder = TestFolder::new();
    let fault = "[[plant.emulator.faults]]\nkind = \"no-reply\"\nservo = 2\nfrom_s = 0.0\n";
    let table = format!("[plant.emulator]\nmodel = \"XM430-W350\"\n{fault}");
    let text = std::fs::read_to_string("scenarios/paper.toml").unwrap();
    let scenario = test_folder.write_file("arm.toml", format!("{text}\n{table}"));
    let arguments =
        ["--scenario", scenario.to_str().unwrap(), "--link", "arm", "--ids", "1,2,3", "--fault", "cable-out:3"];
    let mut emulator = Emulator::start(&test_folder, &arguments);
    emulator.next_report();
    let budget = BusBudget { read_ns: 300_000_000, ..BUDGET };
    let mut bus = Bus::open(
        test_folder.path().join("arm").to_str().unwrap(),
        Protocol::Dynamixel,
        1_000_000,
        budget,
        Box::new(tectum::clock::monotonic_ns),
    )
    .unwrap();
    // The first two are connected, though the second never answers; the third has no cable.
    let model = bus.series().model;
    assert_eq!(bus.read(1, model).unwrap(), 1020);
    assert_eq!([2, 3].map(|id| bus.ping(id)), [false, false]);
    let torque = bus.series().torque_enable;
    bus.sync_set(&[2, 3], torque, |_| 1).unwrap();
    // The answer to this read shows that the writes before it were processed.
    assert_eq!(bus.read(1, model).unwrap(), 1020);
    emulator.send_command("state");
    let state = emulator.next_report();
    assert_eq!([0, 1, 2].map(|i| state["servos"][i]["torque"].as_bool().unwrap()), [false, true, false]);
}

#[test]
fn the_emulator_ends_with_its_parent_process() {
    let test_folder = TestFolder::new();
    let mut parent = Command::new("cat").stdin(Stdio::piped()).stdout(Stdio::null()).spawn().unwrap();
    let mut emulator = Emulator::start(&test_folder, &["--link", "arm", "--parent", &parent.id().to_string()]);
    emulator.next_report();
    drop(parent.stdin.take());
    parent.wait().unwrap();
    assert!(emulator.child.wait().unwrap().success());
    assert!(test_folder.path().join("arm").symlink_metadata().is_err());
}

#[test]
fn bad_arguments_are_refused_in_one_line() {
    let test_folder = TestFolder::new();
    let file = test_folder.write_file("precious", "words");
    for (arguments, message) in [
        (&["--ids", "253"][..], "--ids 253: the highest id of Dynamixel X is 252"),
        (&["--baud", "1234"], "--baud 1234: Dynamixel X has 9600, "),
        (&["--fault", "gremlins:1"], "--fault gremlins:1: there are no-reply, bad-checksum, "),
        (&["--fault", "slow:x"], "--fault slow:x: \"x\" is no id"),
        (&["--fault", "slow:1:5:2"], "--fault slow:1:5:2: "),
        (&["--fault", "slow:1.5"], "--fault slow:1.5: \"1.5\" is no id"),
        (&["--fault", "slow:1:2:3:4"], "--fault slow:1:2:3:4: "),
        (&["--scenario", "none.toml"], "none.toml"),
        (&["--link", "precious"], "precious: no terminal can be put there: "),
    ] {
        let outcome = test_folder.start(EMULATOR, arguments).wait().expect(2);
        assert!(outcome.stderr.contains(message), "{arguments:?}: {}", outcome.stderr);
        assert_eq!(outcome.stderr.lines().count(), 1, "{}", outcome.stderr);
    }
    assert_eq!(std::fs::read(file).unwrap(), b"words");
}
