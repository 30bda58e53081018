//! A run done again from its log: every command, every learning record and every hash of the weights, bit for bit (I3).
//!
//! A fresh controller of the log's own scenario is given the log's observations, those that the run's controller saw, and
//! must say what the log says. The plant's half is followed as well: what was applied and flagged must come of the commands
//! through the gate, and with the simulator's bodies, inputs, rewards and measures must come of what was applied. So hardly
//! a byte of a log can be another one without being found:
//!
//! - In lockstep with the simulator, every byte of every sample is checked, stamps included. A writer's start number within
//!   the run may rise from one sample to the next: a process that comes back goes on where it was. At which sample it rose,
//!   nothing else tells.
//! - In real time instants are what they are. That of publication stands twice in the log, and the reader compares them; that
//!   of sensing stands in the answer, too. What nothing else tells is the instant at which an observation that nobody
//!   answered was sensed (it must lie between schedule and publication), and the flag `LATE`.
//! - With a plant of your own, inputs, reward, measures and the flag `NEW_TARGET` are what the controller is told. They are
//!   found wrong by what is learned from them; nothing is learned from measures, entries that are not used, `NEW_TARGET`
//!   and the last bits of a number that rounding takes away.

mod compare;
mod error;
mod follower;
mod off_policy;
mod plant_replay;
mod stamps;

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use serde::Serialize;

pub use compare::Difference;
pub use error::ReplayError;
pub use off_policy::OffPolicy;

use super::reference::{FixedArm, Score, TestSet};
use crate::log::{LogRecord, RunLog};
use crate::report::thousands;
use crate::runtime::Controller;
use crate::scenario::{LearnerConfig, Plan, Rule, Scenario};
use crate::supervise::RunProgress;
use follower::ReplayFollower;
use off_policy::OffPolicyLearner;
use plant_replay::PlantReplay;
use stamps::StampChecker;

/// What came of a replay.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ReplayResult {
    /// The log.
    pub log: PathBuf,
    /// The scenario's name.
    pub scenario: String,
    /// The run's seed.
    pub seed: u64,
    /// How ticks followed each other.
    pub mode: String,
    /// The first difference; null when there is none.
    pub difference: Option<Difference>,
    /// Observations checked.
    pub observations: u64,
    /// Commands checked.
    pub commands: u64,
    /// Learning records checked.
    pub learnings: u64,
    /// Hashes of the weights among them.
    pub hashes: u64,
    /// Observations that the run's controller never saw.
    pub unseen: u64,
    /// The plant is the simulator's, and was run again.
    pub plant_simulated: bool,
    /// The log was cut off, and was replayed as far as it goes.
    pub torn: bool,
    /// Hash of the weights at the end of the replay, hexadecimal.
    pub weights_hash: String,
    /// Why differences may be no fault of the log: another build wrote it, or its scenario means something else to this one.
    pub warnings: Vec<String>,
    /// With another learner: how the log's own does at the end on the [yardstick](super::yardstick), without exploration noise,
    /// for scale. Null if the plant is not the simulator's arm.
    pub noiseless: Option<Score>,
    /// What another learner has learned from the same; null unless asked for.
    pub other: Option<OffPolicy>,
}

/// Replays the log in `segments`, of one run and in their order. With `learner`, a learner of that rule under its preset is given the same experience (see
/// [`OffPolicy`]). With `progress`, a line on standard error shows how far it is, if that is a terminal.
///
/// # Errors
///
/// [`ReplayError`] if there is nothing to replay: no log, a damaged one, one without all ticks.
pub fn replay(segments: &[PathBuf], learner: Option<Rule>, progress: bool) -> Result<ReplayResult, ReplayError> {
    over(RunLog::open(segments)?, learner, progress)
}

/// The same from a log at its beginning.
///
/// # Errors
///
/// As [`replay`].
pub fn over(mut log: RunLog, learner: Option<Rule>, progress: bool) -> Result<ReplayResult, ReplayError> {
    let path = log.path().to_owned();
    let path = path.as_path();
    let build = log.run("build").unwrap_or("unknown").to_owned();
    let plan = Scenario::parse(log.scenario(), "scenario.toml").and_then(Scenario::plan).map_err(|error| {
        ReplayError::Scenario { path: path.to_owned(), error: Box::new(error), build: build.clone() }
    })?;
    if log.every() > 1 {
        return Err(ReplayError::Thinned { path: path.to_owned(), every: log.every() });
    }
    if log.log_segment().begins != [0; 3] {
        let remedy = match log.log_segment().number {
            0 => "its run goes on with another one, whose log it would need",
            _ => "it is a later segment: give the run's folder, with all of them",
        };
        return Err(ReplayError::Middle { path: path.to_owned(), remedy });
    }
    let other = learner.map(|rule| other(&plan, rule, path)).transpose()?;
    let mut run = ReplayFollower::new(&plan, StampChecker::of(&log, &plan), other);
    let mut progress = RunProgress::study(&plan.scenario.name, plan.scenario.ticks, progress);
    let mut difference = None;
    for record in log.by_ref() {
        let record = record.inspect_err(|_| progress.clear())?;
        if let LogRecord::Gap(gap) = &record {
            progress.clear();
            let until = run.plant().last().map_or("nothing comes before".to_owned(), |tick| {
                format!("up to tick {tick} it is what this build makes of it")
            });
            let gap = *gap;
            return Err(ReplayError::Lost {
                path: path.to_owned(),
                channel: ["observation", "command", "learning"].get(gap.channel as usize).copied().unwrap_or("unknown"),
                first: gap.first,
                count: gap.count,
                until,
                behind: behind(&mut log, run.plant().last())?,
            });
        }
        if let Err(found) = run.take(&record) {
            difference = Some(*found);
            break;
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
        // What was repaired is as cut off as it was before.
        let whole = log.finished() && !log.repaired();
        difference = run.end(whole, complete, plan.scenario.ticks).err().map(|found| *found);
    }
    let test = run.other.as_ref().and_then(|_| test_set(&plan, run.plant()));
    let noiseless = |controller: &Controller| test.as_ref().map(|test| test.score(controller.policy()));
    let (own, others) =
        (noiseless(&run.controller), run.other.as_ref().and_then(|other| noiseless(other.controller())));
    Ok(ReplayResult {
        log: path.to_owned(),
        scenario: plan.scenario.name.clone(),
        seed: plan.scenario.seed,
        mode: log.run("mode").unwrap_or("unknown").to_owned(),
        torn: difference.is_none() && (!log.finished() || log.repaired()),
        difference,
        observations: run.plant().seen(),
        commands: run.counts.answers,
        learnings: run.counts.records,
        hashes: run.counts.hashes,
        unseen: run.counts.unseen,
        plant_simulated: run.plant().simulated(),
        weights_hash: format!("{:016x}", run.controller.policy().hash()),
        warnings: warnings(&log, &plan, &build),
        noiseless: own,
        other: run.other.map(|other| other.finish(others)),
    })
}

/// The yardstick for the arm as it stands at the end of the log.
fn test_set(plan: &Plan, plant: &PlantReplay) -> Option<TestSet> {
    let table = plan.scenario.plant.arm.as_ref().filter(|_| plant.simulated() && plan.scalars.is_empty())?;
    let world = FixedArm::at(table, plan.scenario.period_ms / 1000.0, plant.last()?);
    Some(TestSet::new(plan, world))
}

/// The fresh learner of `rule`, its constants those of its preset.
fn other(plan: &Plan, rule: Rule, path: &Path) -> Result<OffPolicyLearner, ReplayError> {
    let mut scenario = plan.scenario.clone();
    scenario.learner = LearnerConfig::preset(rule);
    let plan = scenario.plan().map_err(|error| ReplayError::Learner {
        path: path.to_owned(),
        rule,
        error: Box::new(error),
    })?;
    Ok(OffPolicyLearner::new(&plan))
}

/// The ticks behind a gap, of which nothing can be told.
fn behind(log: &mut RunLog, last: Option<u64>) -> Result<String, ReplayError> {
    let mut end = None;
    for record in log {
        end = end.max(record?.header().map(|header| header.tick));
    }
    let from = last.map_or(0, |tick| tick + 1);
    Ok(end.filter(|&end| end >= from).map_or_else(String::new, |end| format!(" (ticks {from} to {end})")))
}

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

impl ReplayResult {
    /// The object of `--json`.
    pub fn to_json(&self) -> String {
        serde_json::to_string_pretty(self).unwrap_or_default()
    }

    /// The first difference in a sentence.
    pub fn failure(&self) -> Option<String> {
        let Difference { tick, channel, field, logged, replayed } = self.difference.as_ref()?;
        Some(format!(
            "the log {} does not replay: at tick {tick}, channel {channel}, {field} is {logged}, and should be {replayed}",
            self.log.display()
        ))
    }

    /// The same as [`to_json`](Self::to_json) for people.
    pub fn to_text(&self) -> String {
        let mut text = format!("{}, {}, seed {}\n\n", self.scenario, self.mode, self.seed);
        let mut row = |key: &str, value: String| {
            let line = format!("{key:<14}{value}");
            let _ = writeln!(text, "{}", line.trim_end());
        };
        for warning in &self.warnings {
            row("note", warning.clone());
        }
        if self.torn {
            row("note", "the log was cut off; it was replayed as far as it goes".to_owned());
        }
        let plant =
            if self.plant_simulated { ", the plant run again" } else { ", inputs and rewards taken as they are" };
        row("observations", format!("{}{plant}", thousands(self.observations)));
        row("commands", thousands(self.commands));
        row(
            "learning",
            format!("{} records, {} hashes of the weights", thousands(self.learnings), thousands(self.hashes)),
        );
        if self.unseen > 0 {
            row("unseen", format!("{} observations that the controller passed by", thousands(self.unseen)));
        }
        row("weights", self.weights_hash.clone());
        row("result", if self.difference.is_some() { "not the same" } else { "the same, bit for bit" }.to_owned());
        if let Some(other) = &self.other {
            row("", String::new());
            row("off-policy", format!("{}, which did not choose the commands that it learned from", name(other.rule)));
            row(
                "learned",
                format!("{} ticks, its trace cut {} times", thousands(other.learned), thousands(other.cuts)),
            );
            row("weights", format!("{}, norm {:.4}", other.weights_hash, other.weights_norm));
            row("distance", format!("{:.3e} between its mean command and the log's, root mean square", other.distance));
            if let (Some(own), Some(score)) = (self.noiseless, other.noiseless) {
                let loss = |score: Score| format!("{:.4} a tick, miss {:.3} m", score.loss, score.miss_m);
                row("loss", format!("{}; the log's own: {} (40 targets, without noise)", loss(score), loss(own)));
            }
            if let Some(tick) = other.diverged_at {
                row("diverged", format!("at tick {tick} its weights were no longer numbers"));
            }
        }
        text
    }
}

/// The rule's name as in a scenario.
fn name(rule: Rule) -> String {
    match serde_json::to_value(rule) {
        Ok(serde_json::Value::String(name)) => name,
        _ => format!("{rule:?}"),
    }
}
