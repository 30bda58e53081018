//! The reference controllers in every condition of the arm.

use std::collections::BTreeMap;

use serde::{Serialize, Serializer};

use super::{ArmChange, ArmChangeKind, LearnerEntry};
use crate::reference::{FixedArm, Score, TestSet};
use crate::study::{JobProgress, StudyError};

/// The arm between two changes: its name and its test.
pub(super) struct Condition {
    pub name: String,
    pub test: TestSet,
}

/// The conditions in which a learner meets the arm, with the test's targets of this seed: at the beginning, and after
/// each change.
pub(super) fn conditions(entry: &LearnerEntry, test_seed: u64) -> Result<Vec<Condition>, StudyError> {
    let plan = &entry.test_plan()?;
    let period_s = plan.scenario.period_ms / 1000.0;
    let config = plan.scenario.plant.arm.clone().unwrap_or_default();
    let test = |tick| TestSet::of_seed(plan, FixedArm::at(&config, period_s, tick), test_seed);
    let name = |change: &ArmChange| match (&entry.changes[..], change.what) {
        ([_], ArmChangeKind::Block(..)) => "blocked".to_owned(),
        _ => format!("{} at {}", change.what, change.tick),
    };
    let first = Condition { name: "unblocked".to_owned(), test: test(0) };
    let changed = |change: &ArmChange| Condition { name: name(change), test: test(change.tick) };
    Ok(std::iter::once(first).chain(entry.changes.iter().map(changed)).collect())
}

/// The scores of the reference controllers in all conditions. In JSON, an object by controller, then by
/// condition.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct ReferenceTable {
    /// At the beginning, and after each change.
    pub conditions: Vec<ReferenceScores>,
}

/// The scores of the reference controllers in one condition.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct ReferenceScores {
    /// Name of the condition.
    pub name: String,
    /// Zero commands.
    pub zero: Score,
    /// Exploration noise alone.
    pub random: Score,
    /// Classical control with the true arm.
    pub damped_least_squares: Score,
    /// The best movements.
    pub trajectory_optimum: Score,
}

impl ReferenceScores {
    /// Measures the reference controllers. `None` if the study has to stop.
    pub fn measure(condition: &Condition, starts: usize, progress: &JobProgress) -> Option<Self> {
        let Condition { name, test } = condition;
        Some(Self {
            name: name.clone(),
            trajectory_optimum: test.optimum(starts, || progress.report(0))?,
            zero: test.zero(),
            random: test.random(),
            damped_least_squares: test.damped_least_squares(),
        })
    }
}

impl ReferenceTable {
    /// The scores by controller, from the one that knows least to the one that knows most.
    pub fn by_controller(&self) -> [(&'static str, Vec<Score>); 4] {
        let over = |score: fn(&ReferenceScores) -> Score| self.conditions.iter().map(score).collect();
        [
            ("zero", over(|c| c.zero)),
            ("random", over(|c| c.random)),
            ("damped-least-squares", over(|c| c.damped_least_squares)),
            ("trajectory-optimum", over(|c| c.trajectory_optimum)),
        ]
    }
}

impl Serialize for ReferenceTable {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let names = || self.conditions.iter().map(|c| c.name.as_str());
        serializer.collect_map(
            self.by_controller().map(|(name, scores)| (name, names().zip(scores).collect::<BTreeMap<_, _>>())),
        )
    }
}
