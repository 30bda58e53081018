//! The kill matrix: each process x {before it is ready, first tick, mid run, last ticks} x {lockstep, real time} x {SIGKILL,
//! SIGSTOP and SIGCONT, SIGTERM}, at random instants. Whatever is struck, the run ends, with its last tick or with a sentence;
//! nothing is left in shared memory; every log can be read; and a lockstep run that came to its end has learned what an
//! undisturbed one learns.
//!
//! Here some cells, drawn the same way each time. The large matrix, with the number of kills that is asked for:
//!
//! ```text
//! TECTUM_KILLS=500 cargo test --release --locked --test kills -- --nocapture
//! ```

mod support;

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use support::{Place, Process, assert_no_debris, children, signal_process};
use tectum::log::LogReader;

/// Kills without a number in the environment.
const FEW: u64 = 24;

const PROGRAMS: [(&str, &str); 3] =
    [("tectum-simulator", "plant"), ("tectum-controller", "controller"), ("tectum-logger", "logger")];

/// The moment at which a signal is sent.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Moment {
    BeforeReady,
    FirstTick,
    MidRun,
    LastTicks,
}

const MOMENTS: [Moment; 4] = [Moment::BeforeReady, Moment::FirstTick, Moment::MidRun, Moment::LastTicks];

/// One cell of the matrix.
#[derive(Debug, Clone, Copy)]
struct Cell {
    program: usize,
    moment: Moment,
    mode: &'static str,
    signal: &'static str,
}

/// Numbers that look random, the same ones each time.
struct Dice(u64);

impl Dice {
    fn below(&mut self, n: u64) -> u64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 33) % n
    }

    fn cell(&mut self) -> Cell {
        Cell {
            program: self.below(3) as usize,
            moment: MOMENTS[self.below(4) as usize],
            mode: ["lockstep", "realtime"][self.below(2) as usize],
            signal: ["KILL", "STOP", "TERM"][self.below(3) as usize],
        }
    }
}

const LOCKSTEP_TICKS: u64 = 20_000;
const REALTIME_TICKS: u64 = 200;
/// Bytes that a tick adds to a log.
const TICK_BYTES: u64 = 521;

fn ticks(mode: &str) -> u64 {
    if mode == "lockstep" { LOCKSTEP_TICKS } else { REALTIME_TICKS }
}

fn start(place: &Place, mode: &str) -> Process {
    let scenario = place.arm(&[("every", "1"), ("period_ms", "2")]);
    let quick = "\n[restart]\nbackoff_ms = 1\nhang_s = 5\n";
    std::fs::write(&scenario, std::fs::read_to_string(&scenario).unwrap() + quick).unwrap();
    place.run(&[&scenario, "--mode", mode, "--ticks", &ticks(mode).to_string(), "--json"])
}

/// All segments of a run's log.
fn segments(folder: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten().map(|e| e.path());
    entries.filter(|path| path.extension().is_some_and(|e| e == "mcap")).collect()
}

/// Waits for the moment, and then for a random while less than `most`.
fn await_moment(run: &mut Process, cell: Cell, log: &Path, dice: &mut Dice) -> Option<u32> {
    let (program, parent) = (PROGRAMS[cell.program].0, run.id());
    let size = || segments(log.parent().unwrap()).iter().filter_map(|p| Some(p.metadata().ok()?.len())).sum::<u64>();
    let whole = ticks(cell.mode) * TICK_BYTES;
    let bytes = match cell.moment {
        Moment::BeforeReady => 0,
        Moment::FirstTick => 1,
        Moment::MidRun => whole / 10 + dice.below(whole * 7 / 10),
        Moment::LastTicks => whole - whole / 50,
    };
    let mut found = None;
    run.until_over("the moment", || {
        found = children(parent).into_iter().find(|(_, name)| name == program).map(|(pid, _)| pid);
        (bytes == 0 || size() > bytes) && found.is_some()
    });
    let most = if cell.mode == "lockstep" { 2_000 } else { 20_000 };
    let (began, wait) = (Instant::now(), Duration::from_micros(dice.below(most)));
    while began.elapsed() < wait {
        std::hint::spin_loop();
    }
    found
}

fn strike(cell: Cell, dice: &mut Dice, undisturbed: &str) -> i32 {
    let place = Place::new();
    let mut run = start(&place, cell.mode);
    let folder = place.run_folder();
    if let Some(member) = await_moment(&mut run, cell, &folder.join("log.mcap"), dice) {
        signal_process(member, cell.signal);
        if cell.signal == "STOP" {
            let (began, wait) = (Instant::now(), Duration::from_micros(dice.below(100_000)));
            while began.elapsed() < wait {
                std::thread::yield_now();
            }
            signal_process(member, "CONT");
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
        assert!(cell.mode != "lockstep" || summary["weights_hash"] == undisturbed, "{cell:?}\n{outcome:#?}");
        // A death is in the book, unless the process had finished before it.
        assert!(cell.signal != "STOP" || summary["restarts"] == serde_json::json!([]), "{cell:?}\n{outcome:#?}");
    } else {
        let role = PROGRAMS[cell.program].1;
        assert!(outcome.stderr.contains(&format!("the {role} ")), "{cell:?}\n{outcome:#?}");
        let comes_back = cell.signal == "KILL" && cell.moment != Moment::BeforeReady;
        assert!(cell.signal != "STOP" && !comes_back, "{cell:?}\n{outcome:#?}");
    }
    code
}

#[test]
fn whoever_is_struck_nothing_hangs_and_nothing_is_lost() {
    let kills = std::env::var("TECTUM_KILLS").ok().map_or(FEW, |text| text.parse().expect("a number of kills"));
    let undisturbed = start(&Place::new(), "lockstep").wait().expect(0).json()["weights_hash"].clone();
    let undisturbed = undisturbed.as_str().unwrap();
    let (mut dice, mut complete) = (Dice(2026), 0);
    let began = Instant::now();
    for _ in 0..kills {
        complete += u64::from(strike(dice.cell(), &mut dice, undisturbed) == 0);
    }
    println!(
        "{kills} struck: {complete} came to their end, {} ended with a sentence, in {:?}",
        kills - complete,
        began.elapsed()
    );
}
