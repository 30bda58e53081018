//! The outcome of the runs: when the level was reached, the rest of the gap to the optimum, when a change was
//! recovered from.

use std::collections::BTreeMap;

use serde::Serialize;

use super::cost::TickCost;
use super::run::LearnerRun;
use super::{LearnerEntry, ReferenceTable};
use crate::reference::LEVEL;
use crate::scenario::{LearnerConfig, Scenario};
use crate::stats::Spread;

/// The ticks at which losses are reported.
pub(super) const DECADES: [u64; 5] = [1_000, 10_000, 100_000, 1_000_000, 10_000_000];
/// A learner has recovered from a change when its loss is within this factor of the changed arm's optimum.
const RECOVERED: f64 = 1.1;

/// One learner with one seed.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct SeedRow {
    /// Seed of the run.
    pub seed: u64,
    /// Ticks until the loss was at the level or below, before any change.
    pub ticks_to_level: Option<u64>,
    /// Loss at each of [`DECADES`], before any change.
    pub loss_at: [Option<f64>; DECADES.len()],
    /// Loss at the first change, or at the end if there was none.
    pub loss: f64,
    /// Where that loss lies between zero commands (1) and the trajectory optimum (0).
    pub share_of_gap: f64,
    /// Largest loss between reaching the level and the first change.
    pub worst_after_level: Option<f64>,
    /// For each change: ticks until the learner had recovered from it, if that was before the next change.
    pub ticks_to_recover: Vec<Option<u64>>,
    /// Loss at the end.
    pub loss_at_end: f64,
    /// The first tick at which the weights were no longer numbers.
    pub diverged_at: Option<u64>,
    /// XXH3-64 of the weights at the end, hexadecimal.
    pub weights_hash: String,
}

impl SeedRow {
    pub fn of(entry: &LearnerEntry, seed: u64, run: &LearnerRun, references: &ReferenceTable) -> Self {
        let unchanged: Vec<_> = run.tests.iter().take_while(|t| t.condition == 0).collect();
        let level = unchanged.iter().find(|t| t.score.loss <= LEVEL).map(|t| t.tick);
        let loss = unchanged.last().map_or(f64::NAN, |t| t.score.loss);
        let first = &references.conditions[0];
        let (zero, optimum) = (first.zero.loss, first.trajectory_optimum.loss);
        let recovered = |(i, change): (usize, &super::ArmChange)| {
            let enough = RECOVERED * references.conditions[i + 1].trajectory_optimum.loss;
            let found = run.tests.iter().find(|t| t.condition == i + 1 && t.score.loss <= enough)?;
            Some(found.tick - change.tick)
        };
        Self {
            seed,
            ticks_to_level: level,
            loss_at: DECADES.map(|tick| unchanged.iter().find(|t| t.tick == tick).map(|t| t.score.loss)),
            loss,
            share_of_gap: (loss - optimum) / (zero - optimum),
            worst_after_level: level.map(|level| {
                let after = unchanged.iter().filter(|t| t.tick >= level).map(|t| t.score.loss);
                // A loss that is not a number counts as the largest.
                after.fold(0.0, |worst, loss| if loss > worst || loss.is_nan() { loss } else { worst })
            }),
            ticks_to_recover: entry.changes.iter().enumerate().map(recovered).collect(),
            loss_at_end: run.tests.last().map_or(f64::NAN, |t| t.score.loss),
            diverged_at: run.diverged_at,
            weights_hash: run.weights_hash.clone(),
        }
    }
}

/// Times of some ticks, ns. The runs share the cores with each other, so that the larger times include other
/// work.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub(super) struct Times {
    /// Mean.
    pub mean: f64,
    /// Median.
    pub median: f64,
    /// 99th percentile.
    pub p99: f64,
}

impl Times {
    fn of(values: impl Iterator<Item = f64>) -> Self {
        let mut sorted: Vec<f64> = values.collect();
        sorted.sort_unstable_by(f64::total_cmp);
        let at = |share: f64| sorted.get(((sorted.len() as f64 * share) as usize).min(sorted.len().saturating_sub(1)));
        Self {
            mean: sorted.iter().sum::<f64>() / sorted.len().max(1) as f64,
            median: at(0.5).copied().unwrap_or(f64::NAN),
            p99: at(0.99).copied().unwrap_or(f64::NAN),
        }
    }
}

/// The time of a tick of a learner, ns.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub(super) struct Costs {
    /// The whole tick.
    pub tick: Times,
    /// From the observation to the command: learning, encoding, drawing.
    pub before_command: Times,
    /// After the command was sent: improving the policy, and the statistics.
    pub after_command: Times,
}

impl Costs {
    fn of(costs: &[TickCost]) -> Self {
        Self {
            tick: Times::of(costs.iter().map(|c| c.before + c.after)),
            before_command: Times::of(costs.iter().map(|c| c.before)),
            after_command: Times::of(costs.iter().map(|c| c.after)),
        }
    }
}

/// One learner over all seeds.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(super) struct LearnerOutcome {
    /// The rule.
    pub name: String,
    /// Length of a run, ticks.
    pub ticks: u64,
    /// The changes of the arm.
    pub changes: Vec<ChangeOutcome>,
    /// Ticks to the level, seed by seed; null where it was not reached before the first change.
    pub ticks_to_level: Vec<Option<u64>>,
    /// Ticks to recover from the first change, seed by seed; null where the learner did not.
    pub ticks_to_recover: Vec<Option<u64>>,
    /// Loss by number of ticks; null where the run was shorter, or the arm had changed by then.
    pub loss_at: BTreeMap<u64, Option<Spread>>,
    /// Loss at the first change, or at the end if there was none.
    pub loss: Option<Spread>,
    /// Where that loss lies between zero commands (1) and the trajectory optimum (0).
    pub share_of_gap: Option<Spread>,
    /// Largest loss between reaching the level and the first change; null where no seed reached the level.
    pub worst_loss_after_level: Option<Spread>,
    /// Loss at the end, after all changes.
    pub loss_at_end: Option<Spread>,
    /// Median time of a tick, ns.
    pub ns_per_tick: f64,
    /// The time of a tick in more detail.
    pub cost_ns: Costs,
    /// Number of seeds whose weights diverged.
    pub diverged: usize,
    /// The tick at which the weights were no longer numbers, seed by seed; null where they are.
    pub diverged_at: Vec<Option<u64>>,
    /// XXH3-64 of the weights at the end, hexadecimal, seed by seed.
    pub weights_hash: Vec<String>,
    /// The learner's settings.
    pub settings: LearnerSettings,
}

/// `[learner]`, of a rule of this package or of a controller's program of one's own.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(untagged)]
pub(super) enum LearnerSettings {
    /// Of a rule of this package.
    Rule(Box<LearnerConfig>),
    /// Of another program.
    Own(toml::Table),
}

impl LearnerSettings {
    fn of(scenario: &Scenario) -> Self {
        match scenario.controller.is_shipped() {
            true => Self::Rule(Box::new(scenario.learner.clone())),
            false => Self::Own(scenario.own_learner.clone().unwrap_or_default()),
        }
    }
}

/// A change, and the recovery from it.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(super) struct ChangeOutcome {
    /// The change in words.
    pub change: String,
    /// First tick with the change.
    pub tick: u64,
    /// Ticks until the loss was within 10 % of the changed arm's optimum, seed by seed; null where it never
    /// was.
    pub ticks_to_recover: Vec<Option<u64>>,
}

impl LearnerOutcome {
    pub fn of(entry: &LearnerEntry, rows: &[SeedRow], costs: &[TickCost]) -> Self {
        let over = |value: &dyn Fn(&SeedRow) -> Option<f64>| Spread::of(rows.iter().filter_map(value));
        let recover = |i: usize| rows.iter().map(|r| r.ticks_to_recover.get(i).copied().flatten()).collect();
        let cost = Costs::of(costs);
        Self {
            name: entry.name.clone(),
            ticks: entry.plan.scenario.ticks,
            changes: entry
                .changes
                .iter()
                .enumerate()
                .map(|(i, change)| ChangeOutcome {
                    change: change.what.to_string(),
                    tick: change.tick,
                    ticks_to_recover: recover(i),
                })
                .collect(),
            ticks_to_level: rows.iter().map(|r| r.ticks_to_level).collect(),
            ticks_to_recover: recover(0),
            loss_at: DECADES.iter().enumerate().map(|(i, &tick)| (tick, over(&|r| r.loss_at[i]))).collect(),
            loss: over(&|r| Some(r.loss)),
            share_of_gap: over(&|r| Some(r.share_of_gap)),
            worst_loss_after_level: over(&|r| r.worst_after_level),
            loss_at_end: over(&|r| Some(r.loss_at_end)),
            ns_per_tick: cost.tick.median,
            cost_ns: cost,
            diverged: rows.iter().filter(|r| r.diverged_at.is_some()).count(),
            diverged_at: rows.iter().map(|r| r.diverged_at).collect(),
            weights_hash: rows.iter().map(|r| r.weights_hash.clone()).collect(),
            settings: LearnerSettings::of(&entry.plan.scenario),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::run::PolicyTest;
    use super::super::{ArmChange, Changes, ReferenceScores};
    use super::*;
    use crate::reference::Score;
    use crate::scenario::Rule;

    fn references() -> ReferenceTable {
        let score = |loss| Score { loss, miss_m: 0.0 };
        let scores = |optimum| ReferenceScores {
            name: String::new(),
            zero: score(0.52),
            random: score(0.3),
            damped_least_squares: score(0.03),
            trajectory_optimum: score(optimum),
        };
        ReferenceTable { conditions: vec![scores(0.02), scores(0.03)] }
    }

    #[test]
    fn a_run_is_measured_in_the_conditions_of_its_arm() {
        let changes = Changes::These(vec![ArmChange::block(2000)]);
        let entry = LearnerEntry::new(Rule::Paper, Some(4000), &changes, &[]).unwrap();
        let tests =
            [(500, 0, 0.2), (1000, 0, 0.0375), (1500, 0, 0.05), (2000, 0, 0.03), (2020, 1, 0.034), (2500, 1, 0.033)];
        let run = LearnerRun {
            tests: tests
                .map(|(tick, condition, loss)| PolicyTest { tick, condition, score: Score { loss, miss_m: 0.0 } })
                .to_vec(),
            costs: vec![TickCost { before: 1.0, after: 2.0 }; 3],
            diverged_at: None,
            weights_hash: String::new(),
        };
        let row = SeedRow::of(&entry, 7, &run, &references());
        assert_eq!((row.ticks_to_level, row.worst_after_level), (Some(1000), Some(0.05)));
        assert_eq!(row.loss_at, [Some(0.0375), None, None, None, None]);
        assert_eq!((row.loss, row.loss_at_end), (0.03, 0.033));
        assert!((row.share_of_gap - 0.02).abs() < 1e-12, "{}", row.share_of_gap);
        assert_eq!(row.ticks_to_recover, [Some(500)]);

        let outcome = LearnerOutcome::of(&entry, &[row.clone(), SeedRow { ticks_to_level: None, ..row }], &run.costs);
        assert_eq!(outcome.ticks_to_level, [Some(1000), None]);
        assert_eq!(outcome.ticks_to_recover, [Some(500); 2]);
        assert_eq!((outcome.ns_per_tick, outcome.diverged), (3.0, 0));
        let json = serde_json::to_value(&outcome).unwrap();
        assert_eq!(json["loss_at"]["1000"]["median"], 0.0375);
        assert!(json["loss_at"]["10000"].is_null());
    }
}
