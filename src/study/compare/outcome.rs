//! What the courses say: when the level was reached, what was left of the gap, when a change had been got over.

use std::collections::BTreeMap;

use serde::Serialize;

use super::run::{LearnerRun, TickCost};
use super::{LearnerEntry, ReferenceTable};
use crate::reference::LEVEL;
use crate::scenario::LearnerConfig;
use crate::study::Spread;

/// The instants at which losses are told, ticks.
pub const DECADES: [u64; 5] = [1_000, 10_000, 100_000, 1_000_000, 10_000_000];
/// A change counts as got over when the loss is within this factor of the changed world's optimum.
pub const RECOVERED: f64 = 1.1;

/// One learner with one seed.
#[derive(Debug, Clone, PartialEq)]
pub struct SeedRow {
    /// Seed of the run.
    pub seed: u64,
    /// Ticks until the loss was at the level or below, before any change.
    pub ticks_to_level: Option<u64>,
    /// Loss at each of [`DECADES`], before any change.
    pub loss_at: [Option<f64>; DECADES.len()],
    /// Loss at the first change, or at the end if there was none.
    pub loss: f64,
    /// Of the way from standing still (1) to the trajectory optimum (0), what that loss leaves.
    pub share_of_gap: f64,
    /// Largest loss from the level on until the first change.
    pub worst_after_level: Option<f64>,
    /// For each change: ticks until it had been got over, before the next one.
    pub ticks_to_recover: Vec<Option<u64>>,
    /// Loss at the end.
    pub loss_at_end: f64,
    /// The first tick at which the weights were no longer numbers.
    pub diverged_at: Option<u64>,
    /// XXH3-64 of the weights at the end, hexadecimal.
    pub weights_hash: String,
}

impl SeedRow {
    pub(super) fn of(entry: &LearnerEntry, seed: u64, course: &LearnerRun, references: &ReferenceTable) -> Self {
        let unchanged: Vec<_> = course.samples.iter().take_while(|s| s.world == 0).collect();
        let level = unchanged.iter().find(|s| s.score.loss <= LEVEL).map(|s| s.tick);
        let loss = unchanged.last().map_or(f64::NAN, |s| s.score.loss);
        let (zero, optimum) = (references.worlds[0].zero.loss, references.worlds[0].trajectory_optimum.loss);
        let recovered = |(i, change): (usize, &super::ArmChange)| {
            let enough = RECOVERED * references.worlds[i + 1].trajectory_optimum.loss;
            let found = course.samples.iter().find(|s| s.world == i + 1 && s.score.loss <= enough)?;
            Some(found.tick - change.tick)
        };
        Self {
            seed,
            ticks_to_level: level,
            loss_at: DECADES.map(|tick| unchanged.iter().find(|s| s.tick == tick).map(|s| s.score.loss)),
            loss,
            share_of_gap: (loss - optimum) / (zero - optimum),
            worst_after_level: level.map(|level| {
                let after = unchanged.iter().filter(|s| s.tick >= level).map(|s| s.score.loss);
                // A loss that is no number is the worst of all.
                after.fold(0.0, |worst, loss| if loss > worst || loss.is_nan() { loss } else { worst })
            }),
            ticks_to_recover: entry.changes.iter().enumerate().map(recovered).collect(),
            loss_at_end: course.samples.last().map_or(f64::NAN, |s| s.score.loss),
            diverged_at: course.diverged_at,
            weights_hash: course.weights_hash.clone(),
        }
    }
}

/// Times of some ticks, ns. Runs shared the cores with each other, so that the larger ones hold other people's work.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Times {
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

/// What a tick of a learner costs, ns.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Costs {
    /// All of it.
    pub tick: Times,
    /// From the observation to the command: learning, encoding, drawing.
    pub before_command: Times,
    /// After the command has gone out: improving the policy, and the account.
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
pub struct LearnerOutcome {
    /// The rule.
    pub name: String,
    /// Length of a run, ticks.
    pub ticks: u64,
    /// What happened to the arm, and when.
    pub changes: Vec<ChangeOutcome>,
    /// Ticks to the level, seed by seed; null where it was never reached (before the first change).
    pub ticks_to_level: Vec<Option<u64>>,
    /// Ticks to get over the first change, seed by seed; null where it never was.
    pub ticks_to_recover: Vec<Option<u64>>,
    /// Loss after so many ticks; null where the run was shorter, or the arm had changed by then.
    pub loss_at: BTreeMap<u64, Option<Spread>>,
    /// Loss at the first change; without one, at the end.
    pub loss: Option<Spread>,
    /// Of the way from standing still (1) to the trajectory optimum (0), what that loss leaves.
    pub share_of_gap: Option<Spread>,
    /// Largest loss from the level on until the first change; null where no seed reached the level.
    pub worst_loss_after_level: Option<Spread>,
    /// Loss at the end, after all changes.
    pub loss_at_end: Option<Spread>,
    /// Median time of a tick, ns.
    pub ns_per_tick: f64,
    /// The same in more detail.
    pub cost_ns: Costs,
    /// Number of seeds whose weights did not stay numbers.
    pub diverged: usize,
    /// The tick of that, seed by seed; null where they did.
    pub diverged_at: Vec<Option<u64>>,
    /// XXH3-64 of the weights at the end, hexadecimal, seed by seed.
    pub weights_hash: Vec<String>,
    /// The learner's settings.
    pub settings: LearnerConfig,
}

/// A change, and how it was got over.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ChangeOutcome {
    /// What changed.
    pub change: String,
    /// First tick with it.
    pub tick: u64,
    /// Ticks until the loss was within 10 % of the changed world's optimum, seed by seed; null where it never was.
    pub ticks_to_recover: Vec<Option<u64>>,
}

impl LearnerOutcome {
    pub(super) fn of(entry: &LearnerEntry, rows: &[SeedRow], costs: &[TickCost]) -> Self {
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
            settings: entry.plan.scenario.learner.clone(),
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
        let world = |optimum| ReferenceScores {
            world: String::new(),
            zero: score(0.52),
            random: score(0.3),
            damped_least_squares: score(0.03),
            trajectory_optimum: score(optimum),
        };
        ReferenceTable { worlds: vec![world(0.02), world(0.03)] }
    }

    #[test]
    fn a_course_is_read_in_the_worlds_that_it_goes_through() {
        let changes = Changes::These(vec![ArmChange::block(2000)]);
        let entry = LearnerEntry::new(Rule::Paper, Some(4000), &changes, &[]).unwrap();
        let samples =
            [(500, 0, 0.2), (1000, 0, 0.0375), (1500, 0, 0.05), (2000, 0, 0.03), (2020, 1, 0.034), (2500, 1, 0.033)];
        let course = LearnerRun {
            samples: samples
                .map(|(tick, world, loss)| PolicyTest { tick, world, score: Score { loss, miss_m: 0.0 } })
                .to_vec(),
            costs: vec![TickCost { before: 1.0, after: 2.0 }; 3],
            diverged_at: None,
            weights_hash: String::new(),
        };
        let row = SeedRow::of(&entry, 7, &course, &references());
        assert_eq!((row.ticks_to_level, row.worst_after_level), (Some(1000), Some(0.05)));
        assert_eq!(row.loss_at, [Some(0.0375), None, None, None, None]);
        assert_eq!((row.loss, row.loss_at_end), (0.03, 0.033));
        assert!((row.share_of_gap - 0.02).abs() < 1e-12, "{}", row.share_of_gap);
        assert_eq!(row.ticks_to_recover, [Some(500)]);

        let outcome =
            LearnerOutcome::of(&entry, &[row.clone(), SeedRow { ticks_to_level: None, ..row }], &course.costs);
        assert_eq!(outcome.ticks_to_level, [Some(1000), None]);
        assert_eq!(outcome.ticks_to_recover, [Some(500); 2]);
        assert_eq!((outcome.ns_per_tick, outcome.diverged), (3.0, 0));
        let json = serde_json::to_value(&outcome).unwrap();
        assert_eq!(json["loss_at"]["1000"]["median"], 0.0375);
        assert!(json["loss_at"]["10000"].is_null());
    }
}
