//! One block of Tectum itself: a real run of plant, controller and logger as processes of their own, as `tectum run` starts
//! it, and what came of it.

use std::collections::BTreeMap;
use std::path::Path;
use std::time::Duration;

use super::usage::{Usage, UsageObserver};
use super::{BenchError, TickTimes};
use crate::channel::LOG_BUFFER;
use crate::log::{LogRecord, RunLog, segments};
use crate::runtime::{Mode, exit, tick_times};
use crate::scenario::{Plan, Scenario};
use crate::supervise::{Launch, RunOutcome, RunSummary, run};
use crate::wire::Role;

/// The scenario that is run: the paper's arm with the paper's rule.
pub const SCENARIO: &str = "paper";
/// Where a block's run has its folder, within the bench's.
const FOLDER: &str = "block";

/// What is run.
#[derive(Debug, Clone, Copy)]
pub struct RunBlock {
    /// Lockstep or real time.
    pub mode: Mode,
    /// Length.
    pub ticks: u64,
    /// Every how many ticks are in the log.
    pub every: u64,
    /// Time from one tick to the next, ns.
    pub period: u64,
    /// In lockstep: time each tick.
    pub timed: bool,
}

/// What came of it.
#[derive(Debug)]
pub struct BlockOutcome {
    /// Ticks a second, from the first to the last message in the log.
    pub ticks_per_second: f64,
    /// What its processes used.
    pub usage: Usage,
    /// Its ticks, where they can be told: in real time from its log, in lockstep if they were timed.
    pub tick_times: Vec<TickTimes>,
}

/// The plan of a block.
///
/// # Errors
/// [`BenchError::Scenario`], though the scenario is built in.
pub fn plan(block: &RunBlock) -> Result<Plan, BenchError> {
    let mut scenario = Scenario::find(Path::new(SCENARIO))?;
    scenario.ticks = block.ticks;
    scenario.period_ms = block.period as f64 / 1e6;
    scenario.log.every = block.every;
    Ok(scenario.plan()?)
}

/// Runs a block in a folder within `folder`, which is gone afterwards.
///
/// # Errors
/// [`BenchError::Launch`] and [`BenchError::Run`] when the run fails, [`BenchError::Signal`] when a signal ends it,
/// [`BenchError::Log`] when its log cannot be read.
pub fn measure(block: &RunBlock, folder: &Path) -> Result<BlockOutcome, BenchError> {
    let place = folder.join(FOLDER);
    let result = measure_in(block, &place);
    let _ = std::fs::remove_dir_all(&place);
    result
}

fn measure_in(block: &RunBlock, place: &Path) -> Result<BlockOutcome, BenchError> {
    let launch = Launch {
        plan: plan(block)?,
        mode: block.mode,
        out: Some(place.to_owned()),
        name: None,
        by_hand: Vec::new(),
        checkpoint_every: 0,
        stopwatch: block.timed,
        resumed: None,
        progress: false,
    };
    // Rarely in real time, where every look is a wake-up more.
    let every = Duration::from_millis(if block.mode == Mode::Realtime { 500 } else { 50 });
    let observer = UsageObserver::start(place, every);
    let summary = run(&launch);
    let usage = observer.finish();
    let summary = summary?;
    check(&summary)?;
    let tick_times = match block.mode {
        Mode::Realtime => logged(place)?,
        _ if block.timed => timed(place),
        _ => Vec::new(),
    };
    Ok(BlockOutcome { ticks_per_second: summary.ticks_per_second, usage, tick_times })
}

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

/// The ticks of a real-time run from its log.
fn logged(place: &Path) -> Result<Vec<TickTimes>, BenchError> {
    let (mut sensed, mut answers) = (Vec::new(), BTreeMap::new());
    for record in RunLog::open(&segments(place))? {
        match record? {
            LogRecord::Observation(o) => sensed.push([o.header.tick, o.header.scheduled_ns, o.header.sensed_ns]),
            LogRecord::Command(c) => drop(answers.insert(c.header.tick, c.header.published_ns)),
            _ => {}
        }
    }
    Ok(pair(&sensed, &answers))
}

/// From observations (tick, scheduled, sensed; in order) and the instants at which commands were sent, by tick. A command is
/// applied when the plant has woken up the next time and sensed, if it was there by then; one that was not is dropped.
fn pair(sensed: &[[u64; 3]], answers: &BTreeMap<u64, u64>) -> Vec<TickTimes> {
    let lap = |(i, &[tick, scheduled, sensed_ns]): (usize, &[u64; 3])| {
        let answered = answers.get(&tick).copied();
        let next = sensed.get(i + 1).map(|next| next[2]);
        let applied = next.filter(|&next| answered.is_some_and(|answered| answered < next));
        TickTimes { tick, scheduled, sensed: sensed_ns, answered, applied }
    };
    sensed.iter().enumerate().map(lap).collect()
}

/// The ticks of a lockstep run from what its processes have timed. A tick is due when the one before is over.
fn timed(place: &Path) -> Vec<TickTimes> {
    let (Some(plant), Some(controller)) = (tick_times(place, Role::Plant), tick_times(place, Role::Controller)) else {
        return Vec::new();
    };
    let some = |ns: u64| (ns > 0).then_some(ns);
    let mut due = plant.first().map_or(0, |lap| lap[0]);
    let mut all = Vec::with_capacity(plant.len());
    for (tick, (plant, controller)) in plant.iter().zip(&controller).enumerate() {
        all.push(TickTimes {
            tick: tick as u64,
            scheduled: due,
            sensed: plant[0],
            answered: some(controller[1]),
            applied: some(plant[1]),
        });
        due = plant[1];
    }
    all
}

/// The most ticks of a complete log that the disk of `folder` has room for; a tenth is left free.
pub fn room(folder: &Path) -> u64 {
    let Ok(disk) = rustix::fs::statvfs(folder) else { return u64::MAX };
    let free = (disk.f_bavail * disk.f_frsize) as f64 * 0.9;
    (free / crate::log::bytes_per_tick(1)) as u64
}

/// Ticks that a block has at least, so that the logger's buffer is filled more than once.
pub const LEAST: u64 = 2 * LOG_BUFFER as u64;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_command_is_applied_at_the_next_waking_up_if_it_was_there() {
        let sensed = [[0, 100, 101], [1, 150, 152], [4, 300, 301], [5, 350, 351]];
        let answers = BTreeMap::from([(0, 105), (1, 310), (4, 303)]);
        let tick_times = pair(&sensed, &answers);
        let told: Vec<_> = tick_times.iter().map(|lap| (lap.tick, lap.answered, lap.applied)).collect();
        assert_eq!(told, [(0, Some(105), Some(152)), (1, Some(310), None), (4, Some(303), Some(351)), (5, None, None)]);
    }

    #[test]
    fn the_plan_is_the_papers_with_what_was_asked_for() {
        let block = RunBlock { mode: Mode::Lockstep, ticks: 77, every: 3, period: 2_000_000, timed: false };
        let plan = plan(&block).unwrap();
        assert_eq!((plan.scenario.ticks, plan.scenario.log.every, plan.period_ns), (77, 3, 2_000_000));
        assert_eq!(plan.scenario.name, SCENARIO);
    }
}
