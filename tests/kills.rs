//! The kill matrix: each process x {before it is ready, first tick, mid run, last ticks} x {lockstep, real time} x
//! {SIGKILL, SIGSTOP and SIGCONT, SIGTERM}, at random instants. In every case the run ends, with its last tick or
//! with an error message; nothing is left in shared memory; every log can be read; and a lockstep run that completed
//! has learned the same as an undisturbed one.
//!
//! By default a few cells are drawn from a fixed seed. To test more of the matrix, give the number of signals:
//!
//! ```text
//! TECTUM_KILLS=500 cargo test --release --locked --test kills -- --nocapture
//! ```

mod support;

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use support::{Process, TestFolder, append, assert_no_debris, children, signal_process};
use tectum::log::LogReader;

/// The number of signals when the environment gives none.
const DEFAULT_SIGNALS: u64 = 24;

const PROGRAMS: [(&str, &str); 3] =
    [("tectum-simulator", "plant"), ("tectum-controller", "controller"), ("tectum-logger", "logger")];

/// When in a run the signal is sent.
#[derive(Debug, Clone, Copy, PartialEq)]
enum SignalTime {
    BeforeReady,
    FirstTick,
    MidRun,
    LastTicks,
}

const SIGNAL_TIMES: [SignalTime; 4] =
    [SignalTime::BeforeReady, SignalTime::FirstTick, SignalTime::MidRun, SignalTime::LastTicks];

/// One cell of the matrix.
#[derive(Debug, Clone, Copy)]
struct Cell {
    program: usize,
    time: SignalTime,
    mode: &'static str,
    signal: &'static str,
}

/// A small generator of pseudo-random numbers from a fixed seed.
struct CellRng(u64);

impl CellRng {
    fn below(&mut self, n: u64) -> u64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 33) % n
    }

    fn cell(&mut self) -> Cell {
        Cell {
            program: self.below(3) as usize,
            time: SIGNAL_TIMES[self.below(4) as usize],
            mode: ["lockstep", "realtime"][self.below(2) as usize],
            signal: ["KILL", "STOP", "TERM"][self.below(3) as usize],
        }
    }
}

const LOCKSTEP_TICKS: u64 = 20_000;
const REALTIME_TICKS: u64 = 200;
/// Bytes that a tick adds to a log.
const TICK_BYTES: u64 = 745;

fn ticks(mode: &str) -> u64 {
    if mode == "lockstep" { LOCKSTEP_TICKS } else { REALTIME_TICKS }
}

fn start(test_folder: &TestFolder, mode: &str) -> Process {
    let scenario = test_folder.arm_scenario(&[("every", "1"), ("period_ms", "2")]);
    append(&scenario, "\n[restart]\nbackoff_ms = 1\nhang_s = 5\n");
    test_folder.run(&[&scenario, "--mode", mode, "--ticks", &ticks(mode).to_string(), "--json"])
}

/// All segments of a run's log.
fn segments(folder: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten().map(|e| e.path());
    entries.filter(|path| path.extension().is_some_and(|e| e == "mcap")).collect()
}

/// Waits for the cell's time in the run and then for a random duration. Returns the id of the process to signal, or
/// nothing when the run ended first.
fn wait_for_signal_time(run: &mut Process, cell: Cell, log: &Path, rng: &mut CellRng) -> Option<u32> {
    let (program, parent) = (PROGRAMS[cell.program].0, run.id());
    let size = || segments(log.parent().unwrap()).iter().filter_map(|p| Some(p.metadata().ok()?.len())).sum::<u64>();
    let whole = ticks(cell.mode) * TICK_BYTES;
    let bytes = match cell.time {
        SignalTime::BeforeReady => 0,
        SignalTime::FirstTick => 1,
        SignalTime::MidRun => whole / 10 + rng.below(whole * 7 / 10),
        SignalTime::LastTicks => whole - whole / 50,
    };
    let mut found = None;
    run.wait_until_or_end("the time of the signal", || {
        found = children(parent).into_iter().find(|(_, name)| name == program).map(|(pid, _)| pid);
        (bytes == 0 || size() > bytes) && found.is_some()
    });
    let most = if cell.mode == "lockstep" { 2_000 } else { 20_000 };
    let (began, wait) = (Instant::now(), Duration::from_micros(rng.below(most)));
    while began.elapsed() < wait {
        std::hint::spin_loop();
    }
    found
}

/// Runs one cell and returns the exit code of the run.
fn run_cell(cell: Cell, rng: &mut CellRng, undisturbed_hash: &str) -> i32 {
    let test_folder = TestFolder::new();
    let mut run = start(&test_folder, cell.mode);
    let folder = test_folder.run_folder();
    if let Some(pid) = wait_for_signal_time(&mut run, cell, &test_folder.log_path(), rng) {
        signal_process(pid, cell.signal);
        if cell.signal == "STOP" {
            let (began, wait) = (Instant::now(), Duration::from_micros(rng.below(100_000)));
            while began.elapsed() < wait {
                std::thread::yield_now();
            }
            signal_process(pid, "CONT");
        }
    }
    let outcome = run.wait();
    let code = outcome.code.unwrap_or(-1);
    assert!([0, 4].contains(&code), "{cell:?}\n{outcome:#?}");
    if folder.join("run.json").exists() {
        assert_no_debris(&folder);
    }
    for log in segments(&folder) {
        let records = LogReader::open(&log).unwrap_or_else(|e| panic!("{cell:?} {e}\n{outcome:#?}"));
        assert!(records.into_iter().all(|record| record.is_ok()), "{cell:?}\n{outcome:#?}");
    }
    if code == 0 {
        let summary = outcome.json();
        assert_eq!(summary["ended"], "complete", "{cell:?}\n{outcome:#?}");
        assert!(cell.mode != "lockstep" || summary["weights_hash"] == undisturbed_hash, "{cell:?}\n{outcome:#?}");
        // A process that was only stopped is not restarted.
        assert!(cell.signal != "STOP" || summary["restarts"] == serde_json::json!([]), "{cell:?}\n{outcome:#?}");
    } else {
        let role = PROGRAMS[cell.program].1;
        assert!(outcome.stderr.contains(&format!("the {role} ")), "{cell:?}\n{outcome:#?}");
        let restarts = cell.signal == "KILL" && cell.time != SignalTime::BeforeReady;
        assert!(cell.signal != "STOP" && !restarts, "{cell:?}\n{outcome:#?}");
    }
    code
}

#[test]
fn after_any_signal_nothing_hangs_and_nothing_is_lost() {
    let signals =
        std::env::var("TECTUM_KILLS").ok().map_or(DEFAULT_SIGNALS, |text| text.parse().expect("a number of kills"));
    let undisturbed = start(&TestFolder::new(), "lockstep").wait().expect(0).json()["weights_hash"].clone();
    let undisturbed = undisturbed.as_str().unwrap();
    let (mut rng, mut complete) = (CellRng(2026), 0);
    let began = Instant::now();
    for _ in 0..signals {
        complete += u64::from(run_cell(rng.cell(), &mut rng, undisturbed) == 0);
    }
    println!(
        "{signals} signals: {complete} runs completed, {} ended with an error message, in {:?}",
        signals - complete,
        began.elapsed()
    );
}
