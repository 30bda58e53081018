//! The real bridge in a real run, on the real emulator behind its pseudo-terminal: torque follows arming, and is off however it ends.

mod support;

use std::io::{BufRead as _, BufReader};
use std::process::{Child, Command, Stdio};
use std::sync::mpsc::{Receiver, channel};

use serde_json::Value;
use support::{Place, TECTUM, WATCHDOG, assert_no_debris, signal_process};

/// A chain of four that says each change of torque; dropped, it is killed.
struct EmulatedChain {
    child: Child,
    said: Receiver<(u64, bool)>,
    torque: [bool; 5],
}

impl EmulatedChain {
    fn start(place: &Place) -> Self {
        let mut child = Command::new(env!("CARGO_BIN_EXE_tectum-servo-emulator"))
            .args(["--protocol", "dynamixel", "--ids", "1,2,3,4", "--link", "arm", "--trace", "--json"])
            .current_dir(place.path())
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let mut lines = BufReader::new(child.stdout.take().unwrap()).lines();
        // The first line says that the port is there.
        lines.next().unwrap().unwrap();
        let (tell, said) = channel();
        std::thread::spawn(move || {
            for line in lines.map_while(Result::ok) {
                let line: Value = serde_json::from_str(&line).unwrap();
                for servo in line["servos"].as_array().unwrap() {
                    let _ = tell.send((servo["id"].as_u64().unwrap(), servo["torque"].as_bool().unwrap()));
                }
            }
        });
        Self { child, said, torque: [false; 5] }
    }

    /// Waits until all servos have torque, or none has.
    fn until(&mut self, on: bool) {
        while self.torque[1..].iter().any(|torque| *torque != on) {
            let (id, torque) =
                self.said.recv_timeout(WATCHDOG).unwrap_or_else(|_| panic!("{:?}, waiting for {on}", self.torque));
            self.torque[id as usize] = torque;
        }
    }

    /// Whether torque has never been on since.
    fn stayed_off(&self) -> bool {
        self.said.try_iter().all(|(_, on)| !on)
    }
}

impl Drop for EmulatedChain {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// The emulated scenario, on this chain instead of one of the bridge's own.
fn scenario(place: &Place, armed: bool, more: &str) -> String {
    let text = std::fs::read_to_string("scenarios/servo-emulated.toml").unwrap();
    let (head, tail) = text.split_once("\n[plant.emulator]\n").unwrap();
    let (_, tail) = tail.split_once("[encoder]").unwrap();
    let head = head.replace("\"emulator\" ", "\"arm\" ").replace("armed = true ", &format!("armed = {armed} "));
    let tail = tail.replace("\"learned-reward\"", "\"paper\"");
    place.file("scenario.toml", format!("{head}\n[encoder]{tail}\n{more}")).to_str().unwrap().to_owned()
}

#[test]
fn unarmed_it_only_looks() {
    let place = Place::new();
    let chain = EmulatedChain::start(&place);
    let scenario = scenario(&place, false, "");
    let outcome = place.run(&[&scenario, "--ticks", "30", "--json"]).wait().expect(0);
    assert_eq!(outcome.json()["mode"], "realtime");
    assert!(chain.stayed_off(), "torque was on");
    let account = std::fs::read_to_string(place.run_folder().join("bridge.json")).unwrap();
    let account: Value = serde_json::from_str(&account).unwrap();
    assert_eq!(account["armed"], 0, "{account}");
    assert!(account["bus_read"]["count"].as_u64() > Some(20), "{account}");
    assert_no_debris(&place.run_folder());
    replays(&place);
}

/// The log of an arm that limits and stops itself is learned again like any other.
fn replays(place: &Place) {
    let replay = place.start(TECTUM, &["replay", "run", "--json"]).wait().expect(0).json();
    assert!(replay["difference"].is_null() && replay["commands"].as_u64() > Some(20), "{replay}");
}

#[test]
fn torque_is_off_however_it_ends() {
    let never = "[restart]\nplant = \"never\"\n";
    for (signal, to_the_bridge, more, code) in
        [("TERM", false, "", 143), ("INT", false, "", 130), ("TERM", true, never, 4), ("KILL", true, never, 4)]
    {
        let place = Place::new();
        let mut chain = EmulatedChain::start(&place);
        let scenario = scenario(&place, true, more);
        let mut run = place.run(&[&scenario, "--ticks", "100000", "--json"]);
        chain.until(true);
        match to_the_bridge {
            true => signal_process(run.member("tectum-bridge"), signal),
            false => run.signal(signal),
        }
        chain.until(false);
        run.wait().expect(code);
        assert_no_debris(&place.run_folder());
    }
}

/// A bridge that was killed comes back, on the port that its guard may have had for a moment, and goes on.
#[test]
fn a_bridge_that_was_killed_comes_back() {
    let place = Place::new();
    let mut chain = EmulatedChain::start(&place);
    let scenario = scenario(&place, true, "");
    let mut run = place.run(&[&scenario, "--ticks", "100000", "--json"]);
    chain.until(true);
    signal_process(run.member("tectum-bridge"), "KILL");
    chain.until(false);
    chain.until(true);
    run.signal("INT");
    let outcome = run.wait().expect(130);
    assert_eq!(outcome.json()["restarts"][0]["process"], "plant");
    chain.until(false);
}
