//! One bench block of Tectum itself: a real run of plant, controller and logger in processes of their own, as
//! `tectum run` starts it, and its result.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::Duration;

use super::BenchError;
use super::usage::{Usage, UsageObserver};
use crate::channel::LOG_BUFFER;
use crate::log::{LogRecord, RunLog, segments};
use crate::runtime::{Mode, exit, tick_times};
use crate::scenario::{Plan, Scenario};
use crate::supervise::{Launch, RunOutcome, RunSummary, run};
use crate::timing::{SCENARIO, TickTimes};
use crate::wire::Role;

/// The scenario of every block: the paper's arm with the paper's rule.
/// The folder of a block's run, within the bench's folder.
const FOLDER: &str = "block";
/// The least number of ticks of a block, so that the logger's buffer fills more than once.
pub(super) const MIN_TICKS: u64 = 2 * LOG_BUFFER as u64;

/// What to run.
#[derive(Debug, Clone, Copy)]
pub(super) struct RunBlock {
    /// Lockstep or real time.
    pub mode: Mode,
    /// Number of ticks.
    pub ticks: u64,
    /// One tick in this many is logged.
    pub log_every: u64,
    /// Time from one tick to the next, ns.
    pub period_ns: u64,
    /// In lockstep: time each tick.
    pub timed: bool,
}

/// The result of one block.
#[derive(Debug)]
pub(super) struct BlockOutcome {
    /// Ticks per second, as in the run's summary.
    pub ticks_per_second: f64,
    /// The resources that its processes used.
    pub usage: Usage,
    /// Its ticks: in real time from its log, in lockstep if they were timed.
    pub tick_times: Vec<TickTimes>,
}

/// The plan of a block.
///
/// # Errors
/// [`BenchError::Scenario`], though the scenario is built in.
pub(super) fn plan(block: &RunBlock) -> Result<Plan, BenchError> {
    let mut scenario = Scenario::find(Path::new(SCENARIO))?;
    scenario.ticks = block.ticks;
    scenario.period_ms = block.period_ns as f64 / 1e6;
    scenario.log.every = block.log_every;
    Ok(scenario.plan()?)
}

/// The folder of the run of a block that is measured in `folder`.
pub(super) fn folder(folder: &Path) -> PathBuf {
    folder.join(FOLDER)
}

/// Runs a block in a folder within `folder`, and removes that folder afterwards.
///
/// # Errors
/// [`BenchError::Launch`] and [`BenchError::Run`] when the run fails, [`BenchError::Signal`] when a signal ends it,
/// [`BenchError::Log`] when its log cannot be read.
pub(super) fn measure(block: &RunBlock, folder: &Path) -> Result<BlockOutcome, BenchError> {
    let run_folder = self::folder(folder);
    let result = measure_in(block, &run_folder);
    let _ = std::fs::remove_dir_all(&run_folder);
    result
}

fn measure_in(block: &RunBlock, folder: &Path) -> Result<BlockOutcome, BenchError> {
    let launch = Launch {
        plan: plan(block)?,
        mode: block.mode,
        out: Some(folder.to_owned()),
        name: None,
        by_hand: Vec::new(),
        checkpoint_every: 0,
        keep_checkpoints: 0,
        stopwatch: block.timed,
        stand_in: None,
        resumed: None,
        started_from: None,
        frozen: false,
        progress: false,
    };
    // Seldom in real time, where every sample of the usage wakes the processor up once more.
    let every = Duration::from_millis(if block.mode == Mode::Realtime { 500 } else { 50 });
    let observer = UsageObserver::start(folder, every);
    let summary = run(&launch);
    let usage = observer.finish();
    let summary = summary?;
    check(&summary)?;
    let tick_times = match block.mode {
        Mode::Realtime => logged(folder)?,
        _ if block.timed => timed(folder),
        _ => Vec::new(),
    };
    Ok(BlockOutcome { ticks_per_second: summary.ticks_per_second, usage, tick_times })
}

/// An error if the run did not end well.
fn check(summary: &RunSummary) -> Result<(), BenchError> {
    if let RunOutcome::Signal(number) = summary.ended {
        return Err(BenchError::Signal(number));
    }
    if summary.ended == RunOutcome::Complete && summary.exit_code() == exit::OK {
        return Ok(());
    }
    let message = summary.failure.clone().unwrap_or_else(|| "it did not come to its end".to_owned());
    Err(BenchError::Run { code: summary.exit_code().max(exit::ERROR), message })
}

/// The ticks of a real-time run, from its log.
pub(super) fn logged(folder: &Path) -> Result<Vec<TickTimes>, BenchError> {
    let (mut sensed, mut commands) = (Vec::new(), BTreeMap::new());
    for record in RunLog::open(&segments(folder))? {
        match record? {
            LogRecord::Observation(o) => sensed.push([o.header.tick, o.header.scheduled_ns, o.header.sensed_ns]),
            LogRecord::Command(c) => drop(commands.insert(c.header.tick, c.header.published_ns)),
            _ => {}
        }
    }
    Ok(pair(&sensed, &commands))
}

/// Pairs observations (tick, scheduled, sensed; in order) with the instants at which commands were sent, by
/// tick. A command is applied when the plant has next woken up and sensed, if it was sent before that; a later
/// one is dropped.
fn pair(sensed: &[[u64; 3]], commands: &BTreeMap<u64, u64>) -> Vec<TickTimes> {
    let times = |(i, &[tick, scheduled_ns, sensed_ns]): (usize, &[u64; 3])| {
        let sent_ns = commands.get(&tick).copied();
        let next = sensed.get(i + 1).map(|next| next[2]);
        let applied_ns = next.filter(|&next| sent_ns.is_some_and(|sent| sent < next));
        TickTimes { tick, scheduled_ns, sensed_ns, sent_ns, applied_ns }
    };
    sensed.iter().enumerate().map(times).collect()
}

/// The ticks of a lockstep run, from the stopwatches of its processes. A tick is due when the one before is over.
fn timed(folder: &Path) -> Vec<TickTimes> {
    let (Some(plant), Some(controller)) = (tick_times(folder, Role::Plant), tick_times(folder, Role::Controller))
    else {
        return Vec::new();
    };
    let some = |ns: u64| (ns > 0).then_some(ns);
    let mut due = plant.first().map_or(0, |instants| instants[0]);
    let mut all = Vec::with_capacity(plant.len());
    for (tick, (plant, controller)) in plant.iter().zip(&controller).enumerate() {
        all.push(TickTimes {
            tick: tick as u64,
            scheduled_ns: due,
            sensed_ns: plant[0],
            sent_ns: some(controller[1]),
            applied_ns: some(plant[1]),
        });
        due = plant[1];
    }
    all
}

/// The greatest number of ticks of a complete log that fits on the disk of `folder`; a tenth of the disk is
/// left free.
pub(super) fn max_ticks(folder: &Path) -> u64 {
    let Ok(disk) = rustix::fs::statvfs(folder) else { return u64::MAX };
    let free = (disk.f_bavail * disk.f_frsize) as f64 * 0.9;
    (free / crate::log::bytes_per_tick(1)) as u64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_command_is_applied_at_the_next_wake_up_if_it_was_sent_before() {
        let sensed = [[0, 100, 101], [1, 150, 152], [4, 300, 301], [5, 350, 351]];
        let commands = BTreeMap::from([(0, 105), (1, 310), (4, 303)]);
        let paired = pair(&sensed, &commands);
        let found: Vec<_> = paired.iter().map(|times| (times.tick, times.sent_ns, times.applied_ns)).collect();
        assert_eq!(
            found,
            [(0, Some(105), Some(152)), (1, Some(310), None), (4, Some(303), Some(351)), (5, None, None)]
        );
    }

    #[test]
    fn the_plan_is_the_papers_with_the_blocks_settings() {
        let block = RunBlock { mode: Mode::Lockstep, ticks: 77, log_every: 3, period_ns: 2_000_000, timed: false };
        let plan = plan(&block).unwrap();
        assert_eq!((plan.scenario.ticks, plan.scenario.log.every, plan.period_ns), (77, 3, 2_000_000));
        assert_eq!(plan.scenario.name, SCENARIO);
    }
}
