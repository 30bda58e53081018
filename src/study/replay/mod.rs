//! Replays a run from its log and compares every command, every learning record and every hash of the
//! weights, bit for bit (I3).
//!
//! A fresh controller of the log's own scenario receives the observations that the run's controller received,
//! and must give the answers that are in the log. The plant's half is replayed as well: the applied commands
//! and flags must follow from the commands and the gate. With a simulated plant, inputs, rewards and measures
//! must follow from the applied commands. So nearly every changed byte of a log is found:
//!
//! - In lockstep with the simulator, every byte of every sample is checked, timestamps included. A writer's
//!   incarnation may rise from one sample to the next, because a restarted process continues where it was.
//!   Nothing else in the log tells at which sample it rose.
//! - In real time, timestamps are not reproducible. That of publication is in the log twice, and the log
//!   reader compares the two; that of sensing is also in the answer. Nothing else in the log tells when an
//!   observation that got no answer was sensed (it must be between schedule and publication), or the flag
//!   `LATE`.
//! - With a plant of your own, inputs, reward, measures and the flag `NEW_TARGET` are taken from the log. A
//!   wrong value is found when it changes what is learned. Nothing is learned from measures, unused entries,
//!   `NEW_TARGET`, and the last bits of a number that rounding removes.

mod controller;
mod error;
mod follower;
mod off_policy;
mod plant_replay;
mod sample_diff;
mod stamps;
mod text;

use std::path::{Path, PathBuf};

use serde::Serialize;

pub use error::ReplayError;
pub use off_policy::OffPolicy;
pub use sample_diff::Difference;

use crate::agent::ShippedAgent;
use crate::log::{LogRecord, RunLog};
use crate::reference::{FixedArm, Score, TestSet};
use crate::scenario::{ControllerConfig, LearnerConfig, Plan, Rule, Scenario};
use crate::supervise::RunProgress;
use crate::wire::Gap;
use controller::{ReplayStart, ReplayedController};
use follower::{Parted, ReplayFollower};
use off_policy::OffPolicyLearner;
use plant_replay::PlantReplay;
use stamps::StampChecker;

/// The result of a replay.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ReplayResult {
    /// The log.
    pub log: PathBuf,
    /// The scenario's name.
    pub scenario: String,
    /// The run's seed.
    pub seed: u64,
    /// The run's mode: lockstep or real time.
    pub mode: String,
    /// The first difference; null if there is none.
    pub difference: Option<Difference>,
    /// Observations checked.
    pub observations: u64,
    /// Commands checked.
    pub commands: u64,
    /// Learning records checked.
    pub learnings: u64,
    /// Hashes of the weights checked.
    pub hashes: u64,
    /// Observations that the run's controller never received.
    pub unseen: u64,
    /// Whether the plant is the simulator's, and was run again.
    pub plant_simulated: bool,
    /// Whether the log was cut off. It was replayed as far as it goes.
    pub torn: bool,
    /// Hash of the weights at the end of the replay, hexadecimal.
    pub weights_hash: String,
    /// Why a difference may not be a fault of the log: another build wrote it, or the scenario has another
    /// meaning to this build.
    pub warnings: Vec<String>,
    /// With another learner: the score of the log's own learner at the end, without exploration noise, on the
    /// [test set](crate::reference). Null if the plant is not the simulator's arm.
    pub noiseless: Option<Score>,
    /// The result of another learner with the same experience; null unless asked for.
    pub other: Option<OffPolicy>,
}

/// Replays the log in `segments`, which belong to one run and stand in its order.
///
/// With `learner`, a learner of that rule, with its preset, gets the same experience (see [`OffPolicy`]).
/// With `progress`, a progress line is shown on standard error, if that is a terminal.
///
/// # Errors
///
/// [`ReplayError`] if the log cannot be replayed: it is not a log, is damaged, or does not hold every tick.
pub fn replay(segments: &[PathBuf], learner: Option<Rule>, progress: bool) -> Result<ReplayResult, ReplayError> {
    over(RunLog::open(segments)?, learner, progress)
}

/// Replays an open log from its beginning.
///
/// # Errors
///
/// As [`replay`].
pub fn over(mut log: RunLog, learner: Option<Rule>, progress: bool) -> Result<ReplayResult, ReplayError> {
    let path = log.path().to_owned();
    let build = log.run("build").unwrap_or("unknown").to_owned();
    let plan = Scenario::parse(log.scenario(), "scenario.toml")
        .and_then(Scenario::plan)
        .map_err(|error| ReplayError::Scenario { path: path.clone(), error: Box::new(error), build: build.clone() })?;
    check_complete(&log, &path)?;
    let other = learner.map(|rule| other(&plan, rule, &path)).transpose()?;
    let controller = ReplayedController::new(&plan, &ReplayStart::of(&log)?)?;
    let mut run = ReplayFollower::new(&plan, StampChecker::of(&log, &plan), controller, other);
    let mut progress = RunProgress::study(&plan.scenario.name, plan.scenario.ticks, progress);
    let mut difference = None;
    for record in log.by_ref() {
        let record = record.inspect_err(|_| progress.clear())?;
        if let LogRecord::Gap(gap) = &record {
            progress.clear();
            return Err(lost(*gap, &path, &mut log, run.plant().last())?);
        }
        match run.take(&record) {
            Ok(()) => {}
            Err(Parted::Difference(found)) => {
                difference = Some(*found);
                break;
            }
            Err(Parted::Pipe(error)) => {
                progress.clear();
                return Err(error.into());
            }
        }
        if let LogRecord::Observation(s) = &record
            && s.header.tick.is_multiple_of(64)
        {
            progress.show_study(s.header.tick, run.controller.statistics().now());
        }
    }
    progress.clear();
    if difference.is_none() {
        let complete = log.totals().is_some_and(|totals| totals.complete);
        difference = match run.end(is_whole(&log), complete, plan.scenario.ticks) {
            Ok(()) => None,
            Err(Parted::Difference(found)) => Some(*found),
            Err(Parted::Pipe(error)) => return Err(error.into()),
        };
    }
    result(&log, path, &plan, run, difference, &build)
}

/// Whether the log was written to its end. A repaired log lacks what it lacked before.
fn is_whole(log: &RunLog) -> bool {
    log.finished() && !log.repaired()
}

/// Checks that the log holds every tick from the run's beginning on.
fn check_complete(log: &RunLog, path: &Path) -> Result<(), ReplayError> {
    if log.every() > 1 {
        return Err(ReplayError::Thinned { path: path.to_owned(), every: log.every() });
    }
    if log.log_segment().begins != [0; 3] {
        let remedy = match log.log_segment().number {
            0 => "its run goes on with another one, whose log it would need",
            _ => {
                "it is a later segment: give the run's folder, with all of them, unless `[log] limit_mb` has removed \
                  the first"
            }
        };
        return Err(ReplayError::Middle { path: path.to_owned(), remedy });
    }
    Ok(())
}

/// The error for a gap in the log; `last` is the last tick that was replayed.
fn lost(gap: Gap, path: &Path, log: &mut RunLog, last: Option<u64>) -> Result<ReplayError, ReplayError> {
    let until = last.map_or("nothing comes before".to_owned(), |tick| {
        format!("up to tick {tick} it is what this build makes of it")
    });
    Ok(ReplayError::Lost {
        path: path.to_owned(),
        channel: ["observation", "command", "learning"].get(gap.channel as usize).copied().unwrap_or("unknown"),
        first: gap.first,
        count: gap.count,
        until,
        behind: behind(log, last)?,
    })
}

fn result(
    log: &RunLog,
    path: PathBuf,
    plan: &Plan,
    run: ReplayFollower,
    difference: Option<Difference>,
    build: &str,
) -> Result<ReplayResult, ReplayError> {
    let test = run.other.as_ref().and_then(|_| test_set(plan, run.plant()));
    let score = |agent: &ShippedAgent| test.as_ref().map(|test| test.score_agent(agent));
    let own = run.controller.agent().and_then(score);
    let others = run.other.as_ref().and_then(|other| score(other.controller().agent()));
    let (counts, seen, plant_simulated) = (run.counts, run.plant().seen(), run.plant().simulated());
    Ok(ReplayResult {
        log: path,
        scenario: plan.scenario.name.clone(),
        seed: plan.scenario.seed,
        mode: log.run("mode").unwrap_or("unknown").to_owned(),
        torn: difference.is_none() && !is_whole(log),
        difference,
        observations: seen,
        commands: counts.answers,
        learnings: counts.records,
        hashes: counts.hashes,
        unseen: counts.unseen,
        plant_simulated,
        weights_hash: run.controller.finish()?.weights_hash,
        warnings: warnings(log, plan, build),
        noiseless: own,
        other: run.other.map(|other| other.finish(others)),
    })
}

/// The test set with the arm in its condition at the end of the log. `None` if the plant is not the
/// simulator's arm.
fn test_set(plan: &Plan, plant: &PlantReplay) -> Option<TestSet> {
    let config = plan.scenario.plant.arm.as_ref().filter(|_| plant.simulated() && plan.scalars.is_empty())?;
    let arm = FixedArm::at(config, plan.scenario.period_ms / 1000.0, plant.last()?);
    Some(TestSet::new(plan, arm))
}

/// A fresh learner of `rule` with its preset.
fn other(plan: &Plan, rule: Rule, path: &Path) -> Result<OffPolicyLearner, ReplayError> {
    let mut scenario = plan.scenario.clone();
    scenario.learner = LearnerConfig::preset(rule);
    (scenario.controller, scenario.own_learner) = (ControllerConfig::default(), None);
    let plan = scenario.plan().map_err(|error| ReplayError::Learner {
        path: path.to_owned(),
        rule,
        error: Box::new(error),
    })?;
    Ok(OffPolicyLearner::new(&plan))
}

/// The ticks after a gap, which cannot be replayed, in words.
fn behind(log: &mut RunLog, last: Option<u64>) -> Result<String, ReplayError> {
    let mut end = None;
    for record in log {
        end = end.max(record?.header().map(|header| header.tick));
    }
    let from = last.map_or(0, |tick| tick + 1);
    Ok(end.filter(|&end| end >= from).map_or_else(String::new, |end| format!(" (ticks {from} to {end})")))
}

/// Why a difference may not be a fault of the log.
fn warnings(log: &RunLog, plan: &Plan, build: &str) -> Vec<String> {
    let mut warnings = Vec::new();
    if build != crate::BUILD {
        warnings.push(format!("the log was written by build {build}, and this is {}", crate::BUILD));
    }
    if log.run("scenario_hash") != Some(&format!("{:016x}", plan.hash)) {
        warnings.push(
            "the scenario in the log means something else to this build than to the one that wrote it".to_owned(),
        );
    }
    warnings
}
