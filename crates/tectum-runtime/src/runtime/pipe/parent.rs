//! The parent's half: a controller's program, asked for commands and learning records, and tested.

use std::path::PathBuf;

use super::program::PipedProgram;
use super::{PipeError, Ready, Start, VERSION, json, kind, schema_text};
use crate::clock::TerminationSignals;
use crate::runtime::{ControllerReport, wire_manifest};
use crate::scenario::Plan;
use crate::wire::{Command, Learning, Observation};

/// What a controller's program is to begin with, and until when it is waited for.
#[derive(Debug, Clone, Default)]
pub struct PipedStart {
    /// No wait for an answer lasts for long once one of these signals has come.
    pub signals: Option<TerminationSignals>,
    /// The checkpoint whose learner it begins with; without one, with a fresh learner.
    pub checkpoint: Option<PathBuf>,
    /// Whether the learner is frozen: it neither learns nor explores.
    pub frozen: bool,
}

/// A controller's program, started as a child. Dropped, it is killed.
#[derive(Debug)]
pub struct PipedController {
    program: PipedProgram,
    columns: Vec<String>,
}

impl PipedController {
    /// Starts the controller's program of `plan`, and hands it the scenario.
    ///
    /// # Errors
    /// When it cannot be started, or refuses the scenario.
    pub fn start(plan: &Plan) -> Result<Self, PipeError> {
        Self::start_with(plan, PipedStart::default())
    }

    /// The same, with what `with` says.
    ///
    /// # Errors
    /// When it cannot be started, or refuses the scenario.
    pub fn start_with(plan: &Plan, with: PipedStart) -> Result<Self, PipeError> {
        let (scenario, config) = (&plan.scenario, &plan.scenario.controller);
        let path = scenario
            .find_program(&config.program)
            .map_err(|cause| PipeError::Start { program: config.program.clone(), cause })?;
        let arguments = scenario.resolve_arguments(&config.args);
        let mut program = PipedProgram::start(&config.program, &path, &arguments, scenario.restart.hang_s)?;
        program.signals = with.signals;
        let start = Start {
            version: VERSION,
            schema: schema_text(),
            scenario: plan.scenario.to_toml(),
            source: plan.scenario.source.name().to_owned(),
            folder: plan.scenario.source.folder().map(Into::into),
            start: with.checkpoint.map(|path| std::path::absolute(&path).unwrap_or(path)),
            frozen: with.frozen,
            run: wire_manifest::facts(plan),
        };
        program.send(kind::START, &json(&start))?;
        let ready: Ready = program.receive_json(kind::READY)?;
        if (ready.version, &ready.schema) != (VERSION, &start.schema) {
            let what = format!(
                "it was built for version {} and samples {}, and this is version {VERSION} and {}; build it again",
                ready.version, ready.schema, start.schema
            );
            return Err(program.protocol(what));
        }
        Ok(Self { program, columns: ready.columns })
    }

    /// Names of the agent's own columns in the learning record.
    pub fn columns(&self) -> &[String] {
        &self.columns
    }

    /// Operating-system id of the program's process.
    pub fn pid(&self) -> u32 {
        self.program.pid()
    }

    /// Whether a signal has come: the run is to end.
    pub fn interrupted(&self) -> bool {
        self.program.signal() != 0
    }

    /// One tick: hands over an observation, and receives the command and the learning record.
    ///
    /// # Errors
    /// When the program has ended, hangs, or writes something else.
    pub fn exchange(
        &mut self,
        observation: &Observation,
        command: &mut Command,
        learning: &mut Learning,
    ) -> Result<(), PipeError> {
        self.ask(observation, command)?;
        self.receive_learning(learning)
    }

    /// The first half of a tick: hands over an observation, and receives the command. In a test it is the whole tick.
    ///
    /// # Errors
    /// As for [`exchange`](Self::exchange).
    pub fn ask(&mut self, observation: &Observation, command: &mut Command) -> Result<(), PipeError> {
        self.program.tick = observation.header.tick;
        self.program.send(kind::OBSERVATION, bytemuck::bytes_of(observation))?;
        self.program.receive_sample(kind::COMMAND, bytemuck::bytes_of_mut(command))
    }

    /// The second half of a tick: receives the learning record.
    ///
    /// # Errors
    /// As for [`exchange`](Self::exchange).
    pub fn receive_learning(&mut self, learning: &mut Learning) -> Result<(), PipeError> {
        self.program.receive_sample(kind::LEARNING, bytemuck::bytes_of_mut(learning))
    }

    /// Begins a test: the program keeps its state, answers with its mean commands, and learns nothing.
    ///
    /// # Errors
    /// As for [`exchange`](Self::exchange).
    pub fn begin_test(&mut self) -> Result<(), PipeError> {
        self.program.send(kind::TEST, &[])
    }

    /// Ends a test: the program continues from the state that it kept.
    ///
    /// # Errors
    /// As for [`exchange`](Self::exchange).
    pub fn end_test(&mut self) -> Result<(), PipeError> {
        self.program.send(kind::TESTED, &[])
    }

    /// Ends the run, and receives the controller's report.
    ///
    /// # Errors
    /// As for [`exchange`](Self::exchange).
    pub fn finish(mut self) -> Result<ControllerReport, PipeError> {
        // The end of its standard input tells the program that the run is over.
        self.program.close();
        self.program.receive_json(kind::REPORT)
    }
}
