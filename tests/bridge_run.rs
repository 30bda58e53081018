//! The real bridge in a real run, on the real emulator behind its pseudo-terminal. Torque follows arming and is off
//! however a run ends.

mod support;

use std::io::{BufRead as _, BufReader};
use std::process::{Child, Command, Stdio};
use std::sync::mpsc::{Receiver, channel};

use serde_json::Value;
use support::{TECTUM, TestFolder, WATCHDOG, assert_no_debris, read_json, signal_process};

/// An emulated chain of four servos that reports each change of torque. It is killed when this is dropped.
struct EmulatorProcess {
    child: Child,
    /// A servo's id, and whether its torque is on.
    torque_reports: Receiver<(u64, bool)>,
    /// The last reported torque of each servo, by id.
    torque: [bool; 5],
}

impl EmulatorProcess {
    fn start(test_folder: &TestFolder) -> Self {
        let mut child = Command::new(env!("CARGO_BIN_EXE_tectum-servo-emulator"))
            .args(["--protocol", "dynamixel", "--ids", "1,2,3,4", "--link", "arm", "--trace", "--json"])
            .current_dir(test_folder.path())
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let mut lines = BufReader::new(child.stdout.take().unwrap()).lines();
        // The first line reports that the port exists.
        lines.next().unwrap().unwrap();
        let (sender, torque_reports) = channel();
        std::thread::spawn(move || {
            for line in lines.map_while(Result::ok) {
                let line: Value = serde_json::from_str(&line).unwrap();
                for servo in line["servos"].as_array().unwrap() {
                    let _ = sender.send((servo["id"].as_u64().unwrap(), servo["torque"].as_bool().unwrap()));
                }
            }
        });
        Self { child, torque_reports, torque: [false; 5] }
    }

    /// Waits until all servos have torque, or none has.
    fn wait_for_torque(&mut self, on: bool) {
        while self.torque[1..].iter().any(|torque| *torque != on) {
            let (id, torque) = self
                .torque_reports
                .recv_timeout(WATCHDOG)
                .unwrap_or_else(|_| panic!("{:?}, waiting for {on}", self.torque));
            self.torque[id as usize] = torque;
        }
    }

    /// Whether no servo has reported torque.
    fn stayed_off(&self) -> bool {
        self.torque_reports.try_iter().all(|(_, on)| !on)
    }
}

impl Drop for EmulatorProcess {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// The emulated scenario on this chain instead of the bridge's own emulator.
fn scenario(test_folder: &TestFolder, armed: bool, more: &str) -> String {
    let text = std::fs::read_to_string("scenarios/servo-emulated.toml").unwrap();
    let (head, tail) = text.split_once("\n[plant.emulator]\n").unwrap();
    let (_, tail) = tail.split_once("[encoder]").unwrap();
    let head = head.replace("\"emulator\" ", "\"arm\" ").replace("armed = true ", &format!("armed = {armed} "));
    let tail = tail.replace("\"learned-reward\"", "\"paper\"");
    test_folder.write_file("scenario.toml", format!("{head}\n[encoder]{tail}\n{more}")).to_str().unwrap().to_owned()
}

#[test]
fn an_unarmed_bridge_only_reads() {
    let test_folder = TestFolder::new();
    let chain = EmulatorProcess::start(&test_folder);
    let scenario = scenario(&test_folder, false, "");
    let outcome = test_folder.run(&[&scenario, "--ticks", "30", "--json"]).wait().expect(0);
    assert_eq!(outcome.json()["mode"], "realtime");
    assert!(chain.stayed_off(), "torque was on");
    let report = read_json(test_folder.run_folder().join("bridge.json"));
    assert_eq!(report["armed"], 0, "{report}");
    assert!(report["bus_read"]["count"].as_u64() > Some(20), "{report}");
    assert_no_debris(test_folder.run_folder());
    replays(&test_folder);
}

/// Requires that the log replays, although the bridge limits and stops the arm itself.
fn replays(test_folder: &TestFolder) {
    let replay = test_folder.start(TECTUM, &["replay", "run", "--json"]).wait().expect(0).json();
    assert!(replay["difference"].is_null() && replay["commands"].as_u64() > Some(20), "{replay}");
}

#[test]
fn torque_is_off_however_a_run_ends() {
    let never = "[restart]\nplant = \"never\"\n";
    for (signal, to_the_bridge, more, code) in
        [("TERM", false, "", 143), ("INT", false, "", 130), ("TERM", true, never, 4), ("KILL", true, never, 4)]
    {
        let test_folder = TestFolder::new();
        let mut chain = EmulatorProcess::start(&test_folder);
        let scenario = scenario(&test_folder, true, more);
        let mut run = test_folder.run(&[&scenario, "--ticks", "100000", "--json"]);
        chain.wait_for_torque(true);
        match to_the_bridge {
            true => signal_process(run.child_pid("tectum-bridge"), signal),
            false => run.signal(signal),
        }
        chain.wait_for_torque(false);
        run.wait().expect(code);
        assert_no_debris(test_folder.run_folder());
    }
}

/// A killed bridge is restarted and continues. Its guard may have used the port in between.
#[test]
fn a_killed_bridge_restarts() {
    let test_folder = TestFolder::new();
    let mut chain = EmulatorProcess::start(&test_folder);
    let scenario = scenario(&test_folder, true, "");
    let mut run = test_folder.run(&[&scenario, "--ticks", "100000", "--json"]);
    chain.wait_for_torque(true);
    let report = test_folder.run_folder().join("bridge.json");
    let is_armed = || std::fs::read_to_string(&report).is_ok_and(|text| text.contains("\"armed\": 1,"));
    run.wait_until("the report on the torque", is_armed);
    signal_process(run.child_pid("tectum-bridge"), "KILL");
    chain.wait_for_torque(false);
    chain.wait_for_torque(true);
    run.signal("INT");
    let outcome = run.wait().expect(130);
    assert_eq!(outcome.json()["restarts"][0]["process"], "plant");
    chain.wait_for_torque(false);
    let report = read_json(test_folder.run_folder().join("bridge.json"));
    assert!(report["earlier_bridges"] == 1 && report["armed"] == 2, "{report}");
}
