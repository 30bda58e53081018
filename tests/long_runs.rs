//! Long runs take no more memory than short ones. By default they are too short to show much; the numbers in
//! docs/performance.md are those of:
//!
//! ```text
//! TECTUM_TICKS=10000000 cargo test --release --test long_runs -- --ignored --nocapture ten_million
//! TECTUM_TICKS=1000000 TECTUM_RESTARTS=2000 cargo test --release --test long_runs -- --ignored --nocapture restarts
//! ```

mod support;

use std::collections::BTreeMap;
use std::fs;
use std::os::unix::fs::MetadataExt as _;
use std::path::Path;
use std::time::{Duration, Instant};

use support::{TECTUM, TestFolder, append, assert_no_debris, children, domain, shared_memory};

/// Of what memory is measured.
const MEASURED: [&str; 5] = ["/dev/shm", "launcher", "tectum-controller", "tectum-logger", "tectum-simulator"];
/// Memory that may come and go, bytes: pages of libraries, stacks, buffers of the allocator.
const SLACK: u64 = 2 << 20;
/// Time between two readings of a process's memory.
const READ_EVERY: Duration = Duration::from_millis(50);

fn from_environment(name: &str, usual: u64) -> u64 {
    std::env::var(name).map_or(usual, |text| text.parse().unwrap_or_else(|_| panic!("{name} is a number")))
}

/// Memory of a process that is resident, bytes.
fn resident(pid: u32) -> u64 {
    let text = fs::read_to_string(format!("/proc/{pid}/status")).unwrap_or_default();
    let line = text.lines().find_map(|line| line.strip_prefix("VmRSS:"));
    line.and_then(|line| line.trim().trim_end_matches(" kB").parse().ok()).map_or(0, |kb: u64| 1024 * kb)
}

/// Blocks of a file or folder, bytes.
fn blocks(path: &Path) -> u64 {
    let entries = fs::read_dir(path).into_iter().flatten().flatten();
    let own = fs::symlink_metadata(path).map_or(0, |file| 512 * file.blocks());
    own + entries.map(|entry| blocks(&entry.path())).sum::<u64>()
}

/// What a run takes: resident bytes of launcher and processes by name, and the blocks of its files in /dev/shm.
type MemoryUse = BTreeMap<String, u64>;

fn memory_use(launcher: u32, prefix: &str) -> MemoryUse {
    let mut memory = MemoryUse::from([("launcher".to_owned(), resident(launcher))]);
    memory.extend(children(launcher).into_iter().map(|(pid, name)| (name, resident(pid))));
    let files = shared_memory(prefix).into_iter().map(|name| Path::new("/dev/shm").join(name));
    memory.insert("/dev/shm".to_owned(), files.map(|file| blocks(&file)).sum());
    memory
}

/// The most that each took in some readings: a process that is just being started again has not yet all of its memory.
fn most(readings: &[MemoryUse]) -> MemoryUse {
    let mut most = MemoryUse::new();
    for (name, bytes) in readings.iter().flatten() {
        let so_far = most.entry(name.clone()).or_default();
        *so_far = (*so_far).max(*bytes);
    }
    most
}

#[test]
#[ignore = "takes minutes; prints the numbers of docs/performance.md"]
fn ten_million_ticks_in_one_process_take_no_more_memory() {
    let ticks = from_environment("TECTUM_TICKS", 1_000_000);
    let folder = TestFolder::with_watchdog(Duration::from_secs(3600));
    let scenario = folder.arm_scenario(&[]);
    let mut run = folder.run(&[&scenario, "--mode", "in-process", "--ticks", &ticks.to_string(), "--json"]);
    // It writes no log that tells its tick, but all ticks take the same time.
    let (pid, began, mut readings) = (run.id(), Instant::now(), Vec::new());
    run.wait_until_or_end("the end", || {
        let at = began.elapsed();
        if readings.last().is_none_or(|(last, _)| at - *last > READ_EVERY) {
            readings.push((at, resident(pid)));
        }
        false
    });
    let summary = run.wait().expect(0).json();
    readings.retain(|(_, bytes)| *bytes > 0);
    let at = |share: usize| {
        let memory = readings[(readings.len() - 1) * share / 100].1;
        println!("{share} % of {ticks} ticks: {} kB resident", memory >> 10);
        memory
    };
    let (early, late) = (at(10), at(98));
    assert!(late <= early + early / 10 + SLACK, "{early} bytes early, {late} late");
    println!("{} s, weights {}", summary["seconds"], summary["weights_hash"]);
}

/// Runs `ticks` in lockstep, as processes, with a log that is rotated and limited, and restarts that `faults` asks for.
/// Requires that nothing grows from the first tenth to the last, prints it, and returns the summary.
fn measured_run(ticks: u64, every: &str, faults: &str) -> serde_json::Value {
    let folder = TestFolder::with_watchdog(Duration::from_secs(3600));
    let scenario = folder.arm_scenario(&[("every", every)]);
    let text = fs::read_to_string(&scenario).unwrap();
    fs::write(&scenario, text.replacen("[log]\n", "[log]\nrotate = \"2 MB\"\nlimit_mb = 8.0\n", 1)).unwrap();
    append(&scenario, &format!("\n[restart]\nbackoff_ms = 0.0\nhealthy_s = 0.0\n{faults}"));
    let whole = ["run", &scenario, "--mode", "in-process", "--ticks", &ticks.to_string(), "--out", "whole", "--json"];
    let whole = folder.start(TECTUM, &whole).wait().expect(0).json();

    let mut run = folder.run(&[&scenario, "--ticks", &ticks.to_string(), "--json"]);
    let (launcher, log) = (run.id(), folder.run_folder().join("log.mcap"));
    run.wait_until("the log", || log.exists());
    let prefix = domain(folder.run_folder());
    let (mut last, mut readings) = (Instant::now(), Vec::new());
    run.wait_until_or_end("the end", || {
        if last.elapsed() > READ_EVERY {
            last = Instant::now();
            readings.push(memory_use(launcher, &prefix));
        }
        false
    });
    // The processes of the last readings are already at their end, and one that has just been started still has the
    // launcher's name.
    readings.retain(|memory| memory.keys().eq(MEASURED) && memory.values().all(|&bytes| bytes > 0));
    let tenth = readings.len() / 10;
    assert!(tenth > 5, "the run is too short to be measured: {} readings", readings.len());
    let (early, late) = (most(&readings[..tenth]), most(&readings[readings.len() - tenth..]));
    for (name, bytes) in &late {
        let before = early[name];
        println!("{name}: at most {} kB in the first tenth, {} kB in the last", before >> 10, bytes >> 10);
        assert!(*bytes <= before + before / 10 + SLACK, "{name}: {before} bytes early, {bytes} late");
    }
    let summary = run.wait().expect(0).json();
    println!(
        "{ticks} ticks in {} s, {} restarts, log {} bytes in {} segments, {} removed, {} messages reread, weights {}",
        summary["seconds"],
        summary["restarts"].as_array().unwrap().len(),
        summary["log_bytes"],
        summary["log_segments"],
        summary["log_removed_segments"],
        summary["log_reread"],
        summary["weights_hash"]
    );
    assert_eq!(summary["weights_hash"], whole["weights_hash"]);
    assert_eq!(summary["lost"], 0, "{summary}");
    assert!(summary["log_bytes"].as_u64() < Some(11_000_000), "{summary}");
    assert_no_debris(folder.run_folder());
    summary
}

#[test]
#[ignore = "takes minutes; prints the numbers of docs/performance.md"]
fn ten_million_ticks_over_processes_take_no_more_memory() {
    let summary = measured_run(from_environment("TECTUM_TICKS", 1_000_000), "1", "");
    assert_eq!(summary["restarts"], serde_json::json!([]));
}

#[test]
#[ignore = "takes minutes; prints the numbers of docs/performance.md"]
fn many_restarts_take_no_more_memory() {
    let (ticks, restarts) = (from_environment("TECTUM_TICKS", 100_000), from_environment("TECTUM_RESTARTS", 30));
    // Each role in turn, from the first hundredth of the run to the last.
    let faults = ["plant", "controller", "logger"].iter().enumerate().map(|(role, name)| {
        let kills = (0..restarts).filter(|kill| kill % 3 == role as u64);
        let at: Vec<_> = kills.map(|kill| (ticks / 100 + kill * (ticks / 100 * 97) / restarts).to_string()).collect();
        format!("[[faults.process]]\nprocess = \"{name}\"\ndo = \"kill\"\nat = [{}]\n", at.join(", "))
    });
    let summary = measured_run(ticks, "10", &faults.collect::<String>());
    // Kills of a process that come in one look of the launcher, or before it is back, are one.
    assert!(summary["restarts"].as_array().unwrap().len() as u64 >= restarts * 9 / 10);
}
