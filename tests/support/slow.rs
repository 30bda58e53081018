//! A run on the real clock whose logger is stopped for a while, and loses samples.

use std::fs;

use serde_json::Value;

use super::{Place, signal_process};

/// Runs the arm at a tick a millisecond with every tick in its log, stops the logger while the plant lives through `ticks`
/// ticks, lets it go on, and ends the run once it has written again. Gives the run's summary.
pub fn run_with_a_stopped_logger(place: &Place, ticks: u64) -> Value {
    let scenario = place.arm(&[("every", "1"), ("period_ms", "1")]);
    let mut run = place.run(&[&scenario, "--mode", "realtime", "--ticks", "1000000", "--json"]);
    let (plant, logger) = (run.member("tectum-simulator"), run.member("tectum-logger"));
    run.until_ticking();
    signal_process(logger, "STOP");
    run.until("a stopped logger", || stopped(logger));
    let written = || fs::metadata(place.run_folder().join("log.mcap")).unwrap().len();
    let (from, size) = (sleeps(plant), written());
    run.until("the plant's ticks", || sleeps(plant) >= from + ticks);
    assert_eq!(written(), size, "a stopped logger writes nothing");
    signal_process(logger, "CONT");
    run.until("a log that grows again", || written() > size + 1024 * 521);
    run.signal("INT");
    run.wait().expect(130).json()
}

/// The process's state, as the kernel has it.
fn stopped(pid: u32) -> bool {
    let stat = fs::read_to_string(format!("/proc/{pid}/stat")).unwrap();
    stat.rsplit_once(") ").is_some_and(|(_, rest)| rest.starts_with('T'))
}

/// How often a process has gone to sleep. On the real clock, the plant does so once a tick.
fn sleeps(pid: u32) -> u64 {
    let status = fs::read_to_string(format!("/proc/{pid}/status")).unwrap();
    let line = status.lines().find_map(|line| line.strip_prefix("voluntary_ctxt_switches:"));
    line.unwrap().trim().parse().unwrap()
}
