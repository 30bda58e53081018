//! The controller that is replayed: this package's, or a program of your own, which is started for it.

use crate::agent::ShippedAgent;
use crate::runtime::{Controller, ControllerReport, PipeError, PipedController, RunStatistics};
use crate::scenario::Plan;
use crate::wire::{Command, Learning, Observation};

/// A fresh controller of a log's scenario.
pub(super) enum ReplayedController {
    /// A learning rule of this package.
    Shipped(Box<Controller>),
    /// A program of its own, with the statistics of what it was shown.
    Piped(Box<PipedController>, Box<RunStatistics>),
}

impl ReplayedController {
    /// The controller of `plan`.
    ///
    /// # Errors
    /// When the controller's program cannot be started, or refuses the scenario.
    pub fn new(plan: &Plan) -> Result<Self, PipeError> {
        if plan.scenario.controller.is_shipped() {
            return Ok(Self::Shipped(Box::new(Controller::new(plan))));
        }
        Ok(Self::Piped(Box::new(PipedController::start(plan)?), Box::new(RunStatistics::new(plan))))
    }

    /// Its command and its learning record for an observation.
    ///
    /// # Errors
    /// When the controller's program fails.
    pub fn answer(
        &mut self,
        observation: &Observation,
        command: &mut Command,
        learning: &mut Learning,
    ) -> Result<(), PipeError> {
        match self {
            Self::Shipped(controller) => {
                controller.respond(observation, command);
                controller.after_command(observation);
                controller.record(observation, learning);
                Ok(())
            }
            Self::Piped(controller, statistics) => {
                statistics.observe(observation);
                controller.exchange(observation, command, learning)
            }
        }
    }

    /// The statistics so far.
    pub fn statistics(&self) -> &RunStatistics {
        match self {
            Self::Shipped(controller) => controller.statistics(),
            Self::Piped(_, statistics) => statistics,
        }
    }

    /// The agent, if it is one of this package.
    pub fn agent(&self) -> Option<&ShippedAgent> {
        match self {
            Self::Shipped(controller) => Some(controller.agent()),
            Self::Piped(..) => None,
        }
    }

    /// Ends the replay, and gives the report.
    ///
    /// # Errors
    /// When the controller's program fails.
    pub fn finish(self) -> Result<ControllerReport, PipeError> {
        match self {
            Self::Shipped(controller) => Ok(controller.finish()),
            Self::Piped(controller, _) => controller.finish(),
        }
    }
}
