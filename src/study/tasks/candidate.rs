//! What is measured on a task: a learner, or a reference controller.

use std::sync::Arc;

use super::outcome::RunResult;
use super::plan::TaskPlan;
use super::references::{self, ReferenceKind};
use super::run;
use crate::scenario::{Rule, Scenario};
use crate::study::compare::{LEARNERS, is_path, name_of};
use crate::study::{JobProgress, StudyError};

/// A learner, or a reference controller.
#[derive(Debug, Clone)]
pub enum Candidate {
    /// A reference controller.
    Reference(ReferenceKind),
    /// A learning rule with its preset.
    Learner(Rule),
    /// The `[controller]` and the `[learner]` of a scenario: a program of one's own, or a rule with other settings.
    Own(Arc<Scenario>),
}

impl Candidate {
    /// Those of this package: first the references, from the one that knows least to the one that knows most.
    pub fn all() -> Vec<Self> {
        ReferenceKind::ALL.map(Self::Reference).into_iter().chain(LEARNERS.map(Self::Learner)).collect()
    }

    /// The one of a scenario's file; `None` if `name` is no path.
    ///
    /// # Errors
    /// When there is no such file, or it is invalid.
    pub(super) fn of_path(name: &str) -> Result<Option<Self>, StudyError> {
        if !is_path(name) {
            return Ok(None);
        }
        let own = Scenario::find(name)?;
        // What is wrong with the file as it is has its line there.
        own.clone().plan()?;
        Ok(Some(Self::Own(Arc::new(own))))
    }

    /// The name by which it is chosen; that of a scenario for one's own.
    pub fn name(&self) -> String {
        match self {
            Self::Reference(kind) => kind.name().to_owned(),
            Self::Learner(rule) => name_of(*rule),
            Self::Own(scenario) => scenario.name.clone(),
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
            Self::Learner(_) | Self::Own(_) => true,
        }
    }

    /// Ticks of its run.
    pub(super) fn ticks(&self, task: &TaskPlan) -> u64 {
        match self {
            Self::Reference(_) => task.test_ticks() * task.conditions() as u64,
            Self::Learner(_) | Self::Own(_) => task.ticks,
        }
    }

    /// Estimated time of its run, ns. It orders the jobs.
    pub(super) fn estimated_ns(&self, task: &TaskPlan) -> u64 {
        let tick_ns = match self {
            Self::Reference(ReferenceKind::IterativeLqr) => 20_000_000,
            Self::Learner(Rule::LearnedReward) => 3_000_000,
            Self::Learner(Rule::ModelPredictive) => 60_000_000,
            Self::Learner(Rule::NaturalActorCritic) => 30_000,
            Self::Own(_) => 5_000_000,
            _ => 3_000,
        };
        tick_ns * self.ticks(task)
    }

    /// Its result on a task with one seed; `None` if the study has to stop before.
    ///
    /// # Errors
    /// When a controller's program of one's own fails.
    pub(super) fn run(
        &self,
        task: &TaskPlan,
        seed: u64,
        progress: &JobProgress,
    ) -> Result<Option<RunResult>, StudyError> {
        match self {
            Self::Reference(kind) => Ok(references::run(*kind, task, &|ticks| progress.report(ticks))),
            Self::Learner(_) | Self::Own(_) => run::run(task, self, seed, progress),
        }
    }
}
