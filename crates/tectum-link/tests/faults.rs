//! What goes wrong on the way or at either end, and what becomes of the two runs: `tests/snapshots/link_faults.txt`.
//!
//! `TECTUM_SNAPSHOTS=write cargo test -p tectum-link --test faults` writes the table anew.

mod common;

use std::fmt::Write as _;
use std::path::Path;

use common::{LinkedMachine, address, pair, pair_over};
use serde_json::Value;
use tectum_testkit::{Process, ProcessOutcome, children, signal_process};

/// Ticks of each run: eight seconds.
const TICKS: [&str; 2] = ["--ticks", "160"];

/// A row of the table.
struct FaultRow {
    fault: &'static str,
    plant: String,
    controller: String,
}

/// What became of a run: its exit code, and whether it went on.
fn became(outcome: ProcessOutcome) -> String {
    let code = outcome.code.map_or("killed".to_owned(), |code| code.to_string());
    let summary: Option<Value> = serde_json::from_str(&outcome.stdout).ok();
    let Some(summary) = summary else { return format!("{code}, no run") };
    let number = |key: &str| summary[key].as_u64().unwrap_or(0);
    let (missed, ticks) = (number("missed"), number("ticks"));
    // How many ticks a fault costs depends on the machine: some, and the run goes on.
    let missed = if missed * 2 < ticks { "goes on" } else { "most missed" };
    match summary["ended"].as_str() {
        Some("complete") => format!("{code}, complete, {missed}"),
        Some(ended) => format!("{code}, {ended}"),
        None => format!("{code}, ended by a signal"),
    }
}

fn row(fault: &'static str, runs: [Process; 2]) -> FaultRow {
    let [plant, controller] = runs.map(|run| became(run.wait()));
    FaultRow { fault, plant, controller }
}

/// Kills all processes of a machine at once, as if it had lost its power.
fn kill_machine(run: Process) {
    let all: Vec<u32> = children(run.id()).into_iter().map(|(pid, _)| pid).chain([run.id()]).collect();
    all.iter().for_each(|&pid| signal_process(pid, "KILL"));
    run.wait();
}

fn over(fault: &'static str, network: &[&str]) -> FaultRow {
    let (_network, _machines, runs) = pair_over(network, &TICKS);
    row(fault, runs)
}

fn killed_link(fault: &'static str, side: usize) -> FaultRow {
    let (_machines, mut runs) = pair("raw", &TICKS);
    runs[0].wait_until_tick(40);
    runs[side].kill_child("tectum-link");
    row(fault, runs)
}

fn ctrl_c(fault: &'static str, side: usize) -> FaultRow {
    let (_machines, mut runs) = pair("raw", &TICKS);
    runs[0].wait_until_tick(40);
    runs[side].signal("INT");
    row(fault, runs)
}

/// A machine that loses its power and is started again.
fn controllers_machine_lost(fault: &'static str) -> FaultRow {
    let address = address("raw");
    let [plant, controller] = ["plant", "controller"].map(LinkedMachine::new);
    let (listen, connect) = (["--listen", &*address], ["--connect", &*address]);
    let (mut at_plant, lost) = (plant.start(listen, &TICKS), controller.start(connect, &TICKS));
    at_plant.wait_until_tick(40);
    kill_machine(lost);
    let again = LinkedMachine::new("controller");
    row(fault, [at_plant, again.start(connect, &TICKS)])
}

fn refused(fault: &'static str, more: [&[&str]; 2]) -> FaultRow {
    let address = address("raw");
    let machines = ["plant", "controller"].map(LinkedMachine::new);
    for (machine, digit) in machines.iter().zip(["a", "b"]) {
        machine.file("key", &(digit.repeat(64) + "\n"));
    }
    let start = |i: usize, option| machines[i].start([option, &address], &[&["--wait", "2"], more[i]].concat());
    row(fault, [start(0, "--listen"), start(1, "--connect")])
}

fn nobody(fault: &'static str) -> FaultRow {
    let machines = ["plant", "controller"].map(LinkedMachine::new);
    row(fault, [0, 1].map(|i| machines[i].start(["--listen", &address("raw")], &["--wait", "1"])))
}

#[test]
fn every_fault_has_the_effect_that_the_table_says() {
    let rows = [
        over("none", &[]),
        over("delay of 5 ms each way", &["--delay-ms", "5"]),
        over("one datagram in 20 is lost", &["--loss", "0.05"]),
        over("the network is cut for a second", &["--cut", "4..5"]),
        killed_link("the link's process on the plant's machine is killed", 0),
        killed_link("the link's process on the controller's machine is killed", 1),
        controllers_machine_lost("the controller's machine is lost and started again"),
        ctrl_c("Ctrl-C on the plant's machine", 0),
        ctrl_c("Ctrl-C on the controller's machine", 1),
        refused("another seed", [&["--seed", "1"], &["--seed", "2"]]),
        refused("another key", [&["--key", "key"], &["--key", "key"]]),
        nobody("nobody there"),
    ];
    let mut table = String::new();
    for FaultRow { fault, plant, controller } in rows {
        writeln!(table, "{fault:<58} plant: {plant:<38} controller: {controller}").unwrap();
    }
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/snapshots/link_faults.txt");
    if std::env::var_os("TECTUM_SNAPSHOTS").is_some() {
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(&path, &table).unwrap();
    }
    let expected = std::fs::read_to_string(&path).unwrap_or_default();
    assert!(table == expected, "TECTUM_SNAPSHOTS=write writes it anew; found\n{table}");
}
