//! A run in real time whose logger is stopped for a while and loses samples.

use std::fs;

use serde_json::Value;

use super::{TestFolder, signal_process};

/// Runs the arm in real time with a period of 1 ms and every tick in its log. Stops the logger while the plant advances
/// `ticks` ticks, continues it, and ends the run once the logger has written again. Returns the run's summary.
pub fn run_with_a_stopped_logger(test_folder: &TestFolder, ticks: u64) -> Value {
    let scenario = test_folder.arm_scenario(&[("every", "1"), ("period_ms", "1")]);
    let mut run = test_folder.run(&[&scenario, "--mode", "realtime", "--ticks", "1000000", "--json"]);
    let (plant, logger) = (run.child_pid("tectum-simulator"), run.child_pid("tectum-logger"));
    run.wait_until_ticking();
    signal_process(logger, "STOP");
    run.wait_until("a stopped logger", || is_stopped(logger));
    let log_size = || fs::metadata(test_folder.log_path()).unwrap().len();
    let (switches, size) = (voluntary_switches(plant), log_size());
    run.wait_until("the plant's ticks", || voluntary_switches(plant) >= switches + ticks);
    assert_eq!(log_size(), size, "a stopped logger writes nothing");
    signal_process(logger, "CONT");
    run.wait_until("a log that grows again", || log_size() > size + 1024 * 745);
    run.signal("INT");
    run.wait().expect(130).json()
}

/// Whether the kernel reports the process as stopped.
fn is_stopped(pid: u32) -> bool {
    let stat = fs::read_to_string(format!("/proc/{pid}/stat")).unwrap();
    stat.rsplit_once(") ").is_some_and(|(_, rest)| rest.starts_with('T'))
}

/// How often a process has gone to sleep. In real time, the plant does so once a tick.
fn voluntary_switches(pid: u32) -> u64 {
    let status = fs::read_to_string(format!("/proc/{pid}/status")).unwrap();
    let line = status.lines().find_map(|line| line.strip_prefix("voluntary_ctxt_switches:"));
    line.unwrap().trim().parse().unwrap()
}
