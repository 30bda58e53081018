//! The controller that is replayed: this package's, or a program of your own, which is started for it.

use std::path::{Path, PathBuf};

use super::ReplayError;
use crate::agent::ShippedAgent;
use crate::checkpoint::Checkpoint;
use crate::log::RunLog;
use crate::runtime::{
    Controller, ControllerReport, PipeError, PipedController, PipedStart, RunManifest, RunStatistics,
};
use crate::scenario::Plan;
use crate::wire::{Command, Learning, Observation};

/// What the controller of a log's run began with.
#[derive(Debug, Default)]
pub(super) struct ReplayStart {
    /// The file of what another run had learned; `None` for a fresh learner.
    file: Option<PathBuf>,
    /// Its content.
    checkpoint: Option<Checkpoint>,
    frozen: bool,
}

impl ReplayStart {
    /// What `log` says. What another run had learned is in the folder of the log.
    ///
    /// # Errors
    /// When it is not there, is damaged, or is another than that of the log.
    pub fn of(log: &RunLog) -> Result<Self, ReplayError> {
        let frozen = log.run("frozen") == Some("true");
        let Some(check) = log.run("started_from.check") else { return Ok(Self { frozen, ..Self::default() }) };
        let folder = if log.path().is_dir() { Some(log.path()) } else { log.path().parent() };
        let file = RunManifest::start_path(folder.unwrap_or(Path::new(".")));
        let missing = |cause: String| ReplayError::Start { path: log.path().to_owned(), file: file.clone(), cause };
        let checkpoint = Checkpoint::read(&file).map_err(|error| missing(error.to_string()))?;
        if checkpoint.check() != check {
            return Err(missing("it is another one".to_owned()));
        }
        Ok(Self { file: Some(file), checkpoint: Some(checkpoint), frozen })
    }
}

/// A controller of a log's scenario, at the beginning of the run.
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
    /// When the controller's program cannot be started, or refuses the scenario; when what the run began with does not
    /// fit the learner.
    pub fn new(plan: &Plan, start: &ReplayStart) -> Result<Self, ReplayError> {
        if !plan.scenario.controller.is_shipped() {
            let (checkpoint, frozen) = (start.file.clone(), start.frozen);
            let piped = PipedController::start_with(plan, PipedStart { checkpoint, frozen, ..PipedStart::default() })?;
            return Ok(Self::Piped(Box::new(piped), Box::new(RunStatistics::new(plan))));
        }
        let mut controller = Controller::new(plan);
        if start.frozen {
            controller.freeze();
        }
        if let Some(checkpoint) = &start.checkpoint {
            controller.start_from(checkpoint)?;
        }
        Ok(Self::Shipped(Box::new(controller)))
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
