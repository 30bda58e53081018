//! What is measured on a task: a learner, or a reference controller.

use super::outcome::RunResult;
use super::plan::TaskPlan;
use super::references::{self, ReferenceKind};
use super::run;
use crate::scenario::Rule;
use crate::study::compare::{LEARNERS, name_of};

/// A learner with its preset, or a reference controller.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Candidate {
    /// A reference controller.
    Reference(ReferenceKind),
    /// A learning rule.
    Learner(Rule),
}

impl Candidate {
    /// All of them: first the references, from the one that knows least to the one that knows most.
    pub fn all() -> Vec<Self> {
        ReferenceKind::ALL.map(Self::Reference).into_iter().chain(LEARNERS.map(Self::Learner)).collect()
    }

    /// The name by which it is chosen.
    pub fn name(&self) -> String {
        match self {
            Self::Reference(kind) => kind.name().to_owned(),
            Self::Learner(rule) => name_of(*rule),
        }
    }

    /// Whether it is a reference controller, whose result has no seed.
    pub fn is_reference(&self) -> bool {
        matches!(self, Self::Reference(_))
    }

    /// Whether it can control the task's plant.
    pub(super) fn serves(&self, task: &TaskPlan) -> bool {
        match self {
            Self::Reference(kind) => kind.serves(&task.task),
            Self::Learner(_) => true,
        }
    }

    /// Ticks of its run.
    pub(super) fn ticks(&self, task: &TaskPlan) -> u64 {
        match self {
            Self::Reference(_) => task.test_ticks() * task.conditions() as u64,
            Self::Learner(_) => task.ticks,
        }
    }

    /// Estimated time of its run, ns. It orders the jobs.
    pub(super) fn estimated_ns(&self, task: &TaskPlan) -> u64 {
        let tick_ns = match self {
            Self::Reference(ReferenceKind::IterativeLqr) => 20_000_000,
            Self::Learner(Rule::LearnedReward) => 3_000_000,
            Self::Learner(Rule::ModelPredictive) => 60_000_000,
            Self::Learner(Rule::NaturalActorCritic) => 30_000,
            _ => 3_000,
        };
        tick_ns * self.ticks(task)
    }

    /// Its result on a task with one seed. Calls `go_on` with the ticks done since the last call; the result is `None`
    /// once that returns false.
    pub(super) fn run(&self, task: &TaskPlan, seed: u64, go_on: &dyn Fn(u64) -> bool) -> Option<RunResult> {
        match self {
            Self::Reference(kind) => references::run(*kind, task, go_on),
            Self::Learner(rule) => run::run(task, *rule, seed, go_on),
        }
    }

    /// Its place in [`all`](Self::all).
    fn place(&self) -> usize {
        Self::all().iter().position(|candidate| candidate == self).unwrap_or(usize::MAX)
    }
}

impl Eq for Candidate {}

impl PartialOrd for Candidate {
    fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}

impl Ord for Candidate {
    fn cmp(&self, other: &Self) -> std::cmp::Ordering {
        self.place().cmp(&other.place())
    }
}
