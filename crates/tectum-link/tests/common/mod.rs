//! Two machines on this one: each has a folder and a domain of its own, and they meet over loopback.

#![allow(dead_code)] // Each test binary uses only a part of this module.

use std::net::UdpSocket;
use std::path::PathBuf;
use std::process::Command;

use serde_json::Value;
use tectum_testkit::{Process, TestFolder, read_json};

pub const LINK: &str = env!("CARGO_BIN_EXE_tectum-link");

/// The carriers of this build.
pub fn carriers() -> &'static [&'static str] {
    if cfg!(feature = "zenoh") { &["raw", "udp"] } else { &["raw"] }
}

/// An address on loopback that nobody uses.
pub fn address(carrier: &str) -> String {
    format!("{carrier}/127.0.0.1:{}", port())
}

fn port() -> u16 {
    UdpSocket::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port()
}

/// One machine: a folder, and the run in it.
pub struct LinkedMachine {
    pub folder: TestFolder,
    pub side: &'static str,
    /// A shipped scenario, or a file in the folder.
    pub scenario: &'static str,
}

impl LinkedMachine {
    pub fn new(side: &'static str) -> Self {
        Self { folder: TestFolder::new(), side, scenario: "arm" }
    }

    /// One whose scenario has this text.
    pub fn with_scenario(side: &'static str, text: &str) -> Self {
        let machine = Self { scenario: "own.toml", ..Self::new(side) };
        machine.file(machine.scenario, text);
        machine
    }

    pub fn start(&self, meeting: [&str; 2], more: &[&str]) -> Process {
        let mut command = Command::new(LINK);
        command.args([self.side, self.scenario, "--out", "run", "--json"]).args(meeting).args(more);
        self.folder.start_command(command)
    }

    pub fn report(&self) -> Value {
        read_json(self.folder.run_folder().join("link.json"))
    }

    pub fn file(&self, name: &str, text: &str) -> PathBuf {
        self.folder.write_file(name, text)
    }
}

/// Plant and controller on two machines, both started.
pub fn pair(carrier: &str, more: &[&str]) -> ([LinkedMachine; 2], [Process; 2]) {
    let address = address(carrier);
    let machines = [LinkedMachine::new("plant"), LinkedMachine::new("controller")];
    let runs = [machines[0].start(["--listen", &address], more), machines[1].start(["--connect", &address], more)];
    (machines, runs)
}

/// A bad network: `tectum-link network`, which ends with this.
pub struct Network {
    process: Option<Process>,
    _folder: TestFolder,
}

impl Drop for Network {
    fn drop(&mut self) {
        let process = self.process.take().unwrap();
        process.signal("INT");
        process.wait();
    }
}

/// Plant and controller with such a network between them.
pub fn pair_over(network: &[&str], more: &[&str]) -> (Network, [LinkedMachine; 2], [Process; 2]) {
    let machines = ["plant", "controller"].map(LinkedMachine::new);
    let (network, runs) = start_over(network, &machines, more);
    (network, machines, runs)
}

/// Starts both machines with such a network between them.
pub fn start_over(network: &[&str], machines: &[LinkedMachine; 2], more: &[&str]) -> (Network, [Process; 2]) {
    let (plant, near) = (format!("127.0.0.1:{}", port()), format!("127.0.0.1:{}", port()));
    let folder = TestFolder::new();
    let mut command = Command::new(LINK);
    command.args(["network", "--listen", &near, "--to", &plant]).args(network);
    let network = Network { process: Some(folder.start_command(command)), _folder: folder };
    let [listen, connect] = [plant, near].map(|address| format!("raw/{address}"));
    (network, [machines[0].start(["--listen", &listen], more), machines[1].start(["--connect", &connect], more)])
}
