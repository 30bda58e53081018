//! The kill matrix: {each process, the launcher} x {before it is ready, first tick, mid run, last ticks} x {lockstep,
//! real time} x {SIGKILL, SIGSTOP and SIGCONT, SIGTERM, SIGHUP; for the launcher SIGINT, SIGQUIT and closed pipes,
//! too}, at random instants. In every case the run ends, with its last tick, by the signal, or with an error message;
//! nothing is left in shared memory (by a killed launcher: after the next run); every log can be read; and a lockstep
//! run that completed has learned the same as an undisturbed one.
//!
//! By default a few cells are drawn from a fixed seed. To test more of the matrix, give the number of cells:
//!
//! ```text
//! TECTUM_KILLS=1000 cargo test --release --locked --test kills -- --nocapture
//! ```

mod support;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use support::{
    Process, ProcessOutcome, TECTUM, TestFolder, WATCHDOG, append, assert_no_debris, children, has_ended, read_json,
    signal_process,
};
use tectum::log::LogReader;

/// The number of cells when the environment gives none.
const DEFAULT_CELLS: u64 = 24;

/// Who may be struck: the processes by their programs, and the launcher.
const TARGETS: [(&str, &str); 4] = [
    ("tectum-simulator", "plant"),
    ("tectum-controller", "controller"),
    ("tectum-logger", "logger"),
    ("tectum", "launcher"),
];
const LAUNCHER: usize = 3;

/// What may happen to a process.
const OF_PROCESSES: [&str; 4] = ["KILL", "STOP", "TERM", "HUP"];
/// What may happen to the launcher.
const OF_LAUNCHER: [&str; 7] = ["KILL", "STOP", "TERM", "HUP", "INT", "QUIT", CLOSED];
/// Whoever reads what the launcher writes goes away.
const CLOSED: &str = "pipes closed";

/// When in a run it happens.
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
    target: usize,
    time: SignalTime,
    mode: &'static str,
    what: &'static str,
}

/// A small generator of pseudo-random numbers from a fixed seed.
struct CellRng(u64);

impl CellRng {
    fn below(&mut self, n: u64) -> u64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 33) % n
    }

    fn of<T: Copy>(&mut self, list: &[T]) -> T {
        list[self.below(list.len() as u64) as usize]
    }

    fn cell(&mut self) -> Cell {
        let target = self.below(4) as usize;
        Cell {
            target,
            time: self.of(&SIGNAL_TIMES),
            mode: self.of(&["lockstep", "realtime"]),
            what: if target == LAUNCHER { self.of(&OF_LAUNCHER) } else { self.of(&OF_PROCESSES) },
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

/// Waits for the cell's time in the run and then for a random duration. Returns the id of the process to strike, or
/// nothing when the run ended first.
fn wait_for_signal_time(run: &mut Process, cell: Cell, log: &Path, rng: &mut CellRng) -> Option<u32> {
    let (program, parent) = (TARGETS[cell.target].0, run.id());
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
        // The launcher hears signals before it has children.
        let is_target = |(_, name): &(u32, String)| cell.target == LAUNCHER || name == program;
        found = children(parent).into_iter().find(is_target).map(|(pid, _)| pid);
        found = found.map(|pid| if cell.target == LAUNCHER { parent } else { pid });
        (bytes == 0 || size() > bytes) && found.is_some()
    });
    let most = if cell.mode == "lockstep" { 2_000 } else { 20_000 };
    let (began, wait) = (Instant::now(), Duration::from_micros(rng.below(most)));
    while began.elapsed() < wait {
        std::hint::spin_loop();
    }
    found
}

/// Strikes process `pid` of the run.
fn strike(run: &mut Process, pid: u32, cell: Cell, rng: &mut CellRng) {
    if cell.what == CLOSED {
        return run.close_output();
    }
    signal_process(pid, cell.what);
    if cell.what == "STOP" {
        let (began, wait) = (Instant::now(), Duration::from_micros(rng.below(100_000)));
        while began.elapsed() < wait {
            std::thread::yield_now();
        }
        signal_process(pid, "CONT");
    }
}

/// Runs one cell and returns how the run ended.
fn run_cell(cell: Cell, rng: &mut CellRng, undisturbed_hash: &str) -> String {
    let test_folder = TestFolder::new();
    let mut run = start(&test_folder, cell.mode);
    let folder = test_folder.run_folder();
    let mut processes = Vec::new();
    if let Some(pid) = wait_for_signal_time(&mut run, cell, &test_folder.log_path(), rng) {
        processes = children(run.id());
        strike(&mut run, pid, cell, rng);
    }
    let outcome = run.wait();
    if (cell.target, cell.what, outcome.code) == (LAUNCHER, "KILL", None) {
        after_killed_launcher(&test_folder, cell, &processes);
    }
    if folder.join("run.json").exists() {
        assert_no_debris(&folder);
    }
    for log in segments(&folder) {
        let records = LogReader::open(&log).unwrap_or_else(|e| panic!("{cell:?} {e}\n{outcome:#?}"));
        assert!(records.into_iter().all(|record| record.is_ok()), "{cell:?}\n{outcome:#?}");
    }
    let how = if cell.target == LAUNCHER { end_of_launcher(cell, &outcome) } else { end_by_process(cell, &outcome) };
    if how == "completed" {
        let summary = read_json(folder.join("summary.json"));
        assert_eq!(summary["ended"], "complete", "{cell:?}\n{outcome:#?}");
        assert!(cell.mode != "lockstep" || summary["weights_hash"] == undisturbed_hash, "{cell:?}\n{outcome:#?}");
        // A process that was only stopped is not restarted.
        assert!(cell.what != "STOP" || summary["restarts"] == serde_json::json!([]), "{cell:?}\n{outcome:#?}");
    }
    how.to_owned()
}

/// How a run ended of which a process was struck.
fn end_by_process(cell: Cell, outcome: &ProcessOutcome) -> &'static str {
    if outcome.code == Some(0) {
        return "completed";
    }
    assert_eq!(outcome.code, Some(4), "{cell:?}\n{outcome:#?}");
    let role = TARGETS[cell.target].1;
    assert!(outcome.stderr.contains(&format!("the {role} ")), "{cell:?}\n{outcome:#?}");
    let restarts = cell.what == "KILL" && cell.time != SignalTime::BeforeReady;
    assert!(cell.what != "STOP" && !restarts, "{cell:?}\n{outcome:#?}");
    "ended with an error message"
}

/// How a run ended whose launcher was struck. What ends it may have come after its last tick.
fn end_of_launcher(cell: Cell, outcome: &ProcessOutcome) -> &'static str {
    let by_signal = match cell.what {
        "HUP" => Some(129),
        "INT" => Some(130),
        "QUIT" => Some(131),
        "TERM" => Some(143),
        "KILL" => None,
        // What could not be printed is no success.
        CLOSED => Some(1),
        _ => Some(0),
    };
    match outcome.code {
        Some(0) => "completed",
        Some(1) if cell.what == CLOSED => "completed",
        code => {
            assert_eq!(code, by_signal, "{cell:?}\n{outcome:#?}");
            "ended by the launcher's signal"
        }
    }
}

/// The processes of a killed launcher end by themselves, and the next run removes what it has left.
fn after_killed_launcher(test_folder: &TestFolder, cell: Cell, processes: &[(u32, String)]) {
    let began = Instant::now();
    for (pid, name) in processes {
        while !has_ended(*pid) {
            assert!(began.elapsed() < WATCHDOG, "{cell:?}: {name} outlives its launcher");
            std::thread::park_timeout(Duration::from_millis(5));
        }
    }
    let next = ["run", "paper", "--mode", "lockstep", "--ticks", "50", "--out", "next"];
    test_folder.start(TECTUM, &next).wait().expect(0);
}

#[test]
fn after_any_signal_nothing_hangs_and_nothing_is_lost() {
    let cells = std::env::var("TECTUM_KILLS").map_or(DEFAULT_CELLS, |text| text.parse().expect("a number of kills"));
    let undisturbed = start(&TestFolder::new(), "lockstep").wait().expect(0).json()["weights_hash"].clone();
    let undisturbed = undisturbed.as_str().unwrap();
    let (mut rng, mut ends) = (CellRng(2026), BTreeMap::<String, u64>::new());
    let began = Instant::now();
    for number in 1..=cells {
        let cell = rng.cell();
        let how = run_cell(cell, &mut rng, undisturbed);
        *ends.entry(format!("{}: {how}", TARGETS[cell.target].1)).or_default() += 1;
        if number.is_multiple_of(100) {
            println!("{number} cells after {:?}", began.elapsed());
        }
    }
    println!("{cells} cells in {:?}:", began.elapsed());
    ends.iter().for_each(|(how, count)| println!("  {count} {how}"));
}
