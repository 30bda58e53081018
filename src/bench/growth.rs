//! `tectum bench growth`: what a tick costs with more joints, more watchers and a longer log.
//!
//! *Joints.* Every learner on planar arms of 2 to 8 joints and on the SO-101, whose target has three coordinates, in
//! this process: the controller's whole tick. *Watchers.* The paper's arm in real time with 0 to 4 processes of `tectum
//! watch --web`. *Log.* The same in lockstep with a complete log, over more and more ticks. *Start.* From the start of
//! `tectum run` to its first observation.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};

use serde::Serialize;

use super::context::{BenchContext, check_signals, write_file};
use super::run_block::{self, RunBlock};
use super::{BenchError, Machine};
use crate::clock::monotonic_ns;
use crate::report::figure::{AxisScales, draw_scales};
use crate::runtime::{Mode, exit};
use crate::scenario::Rule;
use crate::stats::{Percentiles, Spread};
use crate::study::compare::name_of;
use crate::text::thousands;
use crate::timing::{BodyCost, Latencies, SCENARIO, body_cost};

/// The joints of the planar arms.
const JOINTS: std::ops::RangeInclusive<usize> = 2..=8;
/// Most watchers.
const WATCHERS: usize = 4;
/// The tick of a watched run, ns.
const WATCHED_PERIOD_NS: u64 = 20_000_000;
/// Parts of the ticks of the longest log.
const PARTS: [u64; 4] = [100, 25, 5, 1];
/// Runs whose start is timed.
const STARTS: usize = 10;
/// The period against which a tick is compared, us.
const TICK_US: f64 = 50_000.0;

/// What to measure.
#[derive(Debug, Clone)]
pub struct GrowthSettings {
    /// Ticks of the slowest learner; quicker ones run more.
    pub ticks: u64,
    /// For how long each number of watchers watches, s.
    pub seconds: f64,
    /// Ticks of the longest log.
    pub log_ticks: u64,
    /// The folder for the results; without one, `runs/bench-growth-<n>`.
    pub out: Option<PathBuf>,
    /// Show a progress line on standard error.
    pub progress: bool,
}

/// A tick of one learner on one body.
#[derive(Debug, Clone, Serialize)]
struct JointRow {
    learner: String,
    /// `plane` or `space`: where the target lies.
    target: &'static str,
    joints: usize,
    inputs: usize,
    features: usize,
    /// The controller's tick, us.
    tick_us: Percentiles,
    /// Its 99th percentile as a share of 50 ms.
    share_of_50_ms: f64,
}

/// A run with some watchers.
#[derive(Debug, Clone, Serialize)]
struct WatcherRow {
    watchers: usize,
    /// From the sensed observation to the sent command, us; null without a command.
    sensed_to_command_us: Option<Percentiles>,
    /// Ticks without a command in time.
    missed: u64,
}

/// A run with a complete log.
#[derive(Debug, Clone, Serialize)]
struct LogRow {
    ticks: u64,
    ticks_per_second: f64,
}

/// How long runs take to begin.
#[derive(Debug, Clone, Serialize)]
struct StartRow {
    /// From the start of `tectum run --mode realtime` to the first sensed observation, ms; null without a
    /// run.
    first_observation_ms: Option<Spread>,
    /// Runs.
    runs: usize,
}

/// All results: the object of `--json`.
#[derive(Debug, Clone, Serialize)]
pub struct GrowthOutcome {
    joints: Vec<JointRow>,
    watchers: Vec<WatcherRow>,
    log: Vec<LogRow>,
    start: StartRow,
    machine: Machine,
    /// Duration of the bench, s.
    seconds: f64,
    /// The folder with the files.
    folder: PathBuf,
}

/// Measures how costs grow.
///
/// # Errors
/// When the folder cannot be used, a run fails, or a signal ends the bench.
pub fn growth(settings: &GrowthSettings) -> Result<GrowthOutcome, BenchError> {
    check(settings)?;
    let mut context = BenchContext::start(settings.out.as_deref(), "bench-growth", settings.progress)?;
    let joints = joints(settings, &mut context)?;
    let watchers = watchers(settings, &mut context)?;
    let log = log(settings, &mut context)?;
    let start = start(&mut context)?;
    let outcome = GrowthOutcome {
        joints,
        watchers,
        log,
        start,
        seconds: context.seconds(),
        machine: context.machine,
        folder: context.folder.path().to_owned(),
    };
    context.folder.keep();
    outcome.write()?;
    Ok(outcome)
}

fn check(settings: &GrowthSettings) -> Result<(), BenchError> {
    let GrowthSettings { ticks, seconds, log_ticks, .. } = settings;
    let least = run_block::MIN_TICKS;
    let text = if *ticks < 8 {
        format!("--ticks is {ticks}; give at least 8")
    } else if *log_ticks < least {
        format!("--log-ticks is {log_ticks}; give at least {}", thousands(least))
    } else if !(0.1..=3600.0).contains(seconds) {
        format!("--seconds is {seconds}; give 0.1 to 3600")
    } else {
        return Ok(());
    };
    Err(BenchError::Asked(text))
}

/// How many times as many ticks a learner runs as the slowest one.
fn ticks_of(rule: Rule, ticks: u64) -> u64 {
    match rule {
        Rule::ModelPredictive => ticks,
        Rule::LearnedReward => 2 * ticks,
        _ => 10 * ticks,
    }
}

fn joints(settings: &GrowthSettings, context: &mut BenchContext) -> Result<Vec<JointRow>, BenchError> {
    let mut rows = Vec::new();
    for rule in Rule::ALL {
        for joints in JOINTS.map(Some).chain([None]) {
            let body = joints.map_or_else(|| "a target in space".to_owned(), |joints| format!("{joints} joints"));
            context.progress.show(&format!("growth: {}, {body}", name_of(rule)));
            let cost = body_cost(rule, joints, ticks_of(rule, settings.ticks), &context.signals)?;
            rows.push(joint_row(&cost));
        }
    }
    Ok(rows)
}

fn joint_row(cost: &BodyCost) -> JointRow {
    JointRow {
        learner: name_of(cost.rule),
        target: if cost.spatial { "space" } else { "plane" },
        joints: cost.joints,
        inputs: cost.inputs,
        features: cost.features,
        tick_us: cost.tick,
        share_of_50_ms: cost.tick.p99 / TICK_US,
    }
}

fn watchers(settings: &GrowthSettings, context: &mut BenchContext) -> Result<Vec<WatcherRow>, BenchError> {
    let ticks = (settings.seconds * 1e9 / WATCHED_PERIOD_NS as f64).max(2.0) as u64;
    let block = RunBlock { mode: Mode::Realtime, ticks, log_every: 1, period_ns: WATCHED_PERIOD_NS, timed: false };
    let mut rows = Vec::new();
    for watchers in 0..=WATCHERS {
        check_signals(&context.signals)?;
        context.progress.show(&format!("growth: {watchers} watchers"));
        let mut watching = Watching::start(context.folder.path(), watchers)?;
        let times = run_block::measure(&block, context.folder.path())?.tick_times;
        // A signal for all of them ends the watchers first.
        check_signals(&context.signals)?;
        watching.check()?;
        let missed = times.iter().rev().skip(1).filter(|times| times.applied_ns.is_none()).count() as u64;
        let mut latencies = Latencies::default();
        latencies.record(&times, 0, WATCHED_PERIOD_NS);
        let sensed_to_command_us = Percentiles::of(&latencies.sensed_to_command);
        rows.push(WatcherRow { watchers, sensed_to_command_us, missed });
    }
    Ok(rows)
}

/// Processes that watch the next run in a folder, from its begin. They are killed when this is dropped.
struct Watching(Vec<Child>);

impl Watching {
    fn start(folder: &Path, watchers: usize) -> Result<Self, BenchError> {
        let mut watching = Self(Vec::new());
        for _ in 0..watchers {
            let mut command = own_command(&["watch", "--wait", "--web", "127.0.0.1:0"])?;
            command.arg(run_block::folder(folder)).stdout(Stdio::null()).stderr(Stdio::null());
            watching.0.push(command.spawn().map_err(not_started)?);
        }
        Ok(watching)
    }

    /// An error if one of them has failed meanwhile.
    fn check(&mut self) -> Result<(), BenchError> {
        for watcher in &mut self.0 {
            if let Some(status) = watcher.try_wait().map_err(not_started)?.filter(|status| !status.success()) {
                return Err(BenchError::Run { code: exit::PROCESS, message: format!("a watcher failed: {status}") });
            }
        }
        Ok(())
    }
}

impl Drop for Watching {
    fn drop(&mut self) {
        for watcher in &mut self.0 {
            let _ = watcher.kill();
            let _ = watcher.wait();
        }
    }
}

/// This program with `arguments`.
fn own_command(arguments: &[&str]) -> Result<Command, BenchError> {
    let mut command = Command::new(std::env::current_exe().map_err(not_started)?);
    command.args(arguments).stdin(Stdio::null());
    Ok(command)
}

fn not_started(cause: std::io::Error) -> BenchError {
    BenchError::Run { code: exit::ERROR, message: format!("tectum itself cannot be started: {cause}") }
}

fn log(settings: &GrowthSettings, context: &mut BenchContext) -> Result<Vec<LogRow>, BenchError> {
    let mut rows = Vec::new();
    for part in PARTS {
        check_signals(&context.signals)?;
        let ticks =
            (settings.log_ticks / part).max(run_block::MIN_TICKS).min(run_block::max_ticks(context.folder.path()));
        context.progress.show(&format!("growth: a log of {} ticks", thousands(ticks)));
        let block = RunBlock { mode: Mode::Lockstep, ticks, log_every: 1, period_ns: 50_000_000, timed: false };
        let outcome = run_block::measure(&block, context.folder.path())?;
        rows.push(LogRow { ticks, ticks_per_second: outcome.ticks_per_second });
    }
    Ok(rows)
}

fn start(context: &mut BenchContext) -> Result<StartRow, BenchError> {
    context.progress.show("growth: starts");
    let folder = run_block::folder(context.folder.path());
    let mut ms = Vec::new();
    for _ in 0..STARTS {
        check_signals(&context.signals)?;
        let mut command = own_command(&["run", SCENARIO, "--mode", "realtime", "--ticks", "2", "--json", "--out"])?;
        let began = monotonic_ns();
        let output = command.arg(&folder).output().map_err(not_started)?;
        let sensed = run_block::logged(&folder);
        let _ = std::fs::remove_dir_all(&folder);
        // A signal for all of them ends the run first.
        check_signals(&context.signals)?;
        if !output.status.success() {
            let message = String::from_utf8_lossy(&output.stderr).trim().to_owned();
            return Err(BenchError::Run { code: exit::PROCESS, message });
        }
        ms.extend(sensed?.first().map(|first| first.sensed_ns.saturating_sub(began) as f64 / 1e6));
    }
    Ok(StartRow { first_observation_ms: Spread::of(ms), runs: STARTS })
}

impl GrowthOutcome {
    /// One JSON object.
    pub fn to_json(&self) -> String {
        serde_json::to_string(self).unwrap_or_default()
    }

    fn write(&self) -> Result<(), BenchError> {
        write_file(&self.folder.join("growth.json"), &self.to_json())?;
        draw_scales("Cost of a controller's tick by number of joints", &[self.panel()], &self.figure())?;
        Ok(())
    }

    fn figure(&self) -> PathBuf {
        self.folder.join("joints.svg")
    }

    /// Medians over joints, a curve for each learner, and the period of 50 ms.
    fn panel(&self) -> AxisScales {
        let mut curves: Vec<(String, Vec<(f64, f64)>)> = Vec::new();
        for row in self.joints.iter().filter(|row| row.target == "plane") {
            let point = (row.joints as f64, row.tick_us.p50);
            match curves.iter_mut().find(|(name, _)| *name == row.learner) {
                Some((_, curve)) => curve.push(point),
                None => curves.push((row.learner.clone(), vec![point])),
            }
        }
        let ends = [*JOINTS.start(), *JOINTS.end()];
        curves.push(("a tick of 50 ms".to_owned(), ends.map(|joints| (joints as f64, TICK_US)).to_vec()));
        AxisScales {
            name: "median, one process".to_owned(),
            x: "joints".to_owned(),
            y: "us a tick".to_owned(),
            label_x: |x| thousands(x.round() as u64),
            curves,
        }
    }

    /// The tables for people.
    pub fn to_text(&self) -> String {
        let mut text = format!("{}\n", self.machine.to_text());
        let _ = writeln!(
            text,
            "{:<22} {:<6} {:>6} {:>6} {:>8} {:>11} {:>11} {:>9}",
            "learner", "target", "joints", "inputs", "features", "p50 us", "p99 us", "of 50 ms"
        );
        for row in &self.joints {
            let JointRow { learner, target, joints, inputs, features, tick_us, share_of_50_ms } = row;
            let share = format!("{:.1} %", 100.0 * share_of_50_ms);
            let _ = writeln!(
                text,
                "{learner:<22} {target:<6} {joints:>6} {inputs:>6} {features:>8} {:>11.1} {:>11.1} {share:>9}",
                tick_us.p50, tick_us.p99
            );
        }
        text += "\nwatchers   sensed to command p50 us       p99 us   missed\n";
        for row in &self.watchers {
            let of = |pick: fn(&Percentiles) -> f64| row.sensed_to_command_us.as_ref().map_or(f64::NAN, pick);
            let _ = writeln!(
                text,
                "{:<10} {:>24.1} {:>12.1} {:>8}",
                row.watchers,
                of(|p| p.p50),
                of(|p| p.p99),
                row.missed
            );
        }
        text += "\nticks in the log   ticks a second\n";
        for row in &self.log {
            let _ = writeln!(text, "{:>16} {:>16}", thousands(row.ticks), thousands(row.ticks_per_second as u64));
        }
        if let Some(Spread { median, min, max }) = self.start.first_observation_ms {
            let _ = writeln!(
                text,
                "\nstart of `tectum run` to first observation: {median:.0} ms ({min:.0} to {max:.0}, {} runs)",
                self.start.runs
            );
        }
        let _ = writeln!(text, "\nfigure  {} ({:.0} s)", self.figure().display(), self.seconds);
        text
    }
}
