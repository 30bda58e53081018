//! What is measured in a study: a learning rule of this package, or a controller's program of its own, which runs as a
//! child and is tested over the same pipe.

use crate::clock::{process_cpu_ns, thread_cpu_ns};
use crate::policy::Outputs;
use crate::reference::{FrozenAgent, TestPercept};
use crate::runtime::{Controller, ControllerReport, PipeError, PipedController, PipedStart};
use crate::scenario::Plan;
use crate::study::JobProgress;
use crate::wire::{Ahead, Command, Learning, Observation, flag};

/// Flags of a test's observation that a program is told.
const BOUNDARIES: u32 = flag::NEW_TARGET | flag::TERMINATED | flag::TRUNCATED;

/// A learner in its run.
pub(super) enum Subject {
    /// A learner of this package.
    Shipped(Box<Controller>),
    /// A program of its own.
    Piped(Box<PipedController>, Box<Learning>),
}

impl Subject {
    /// The learner of `plan`.
    ///
    /// # Errors
    /// When the controller's program cannot be started, or refuses the scenario.
    pub fn new(plan: &Plan, progress: &JobProgress) -> Result<Self, PipeError> {
        if plan.scenario.controller.is_shipped() {
            return Ok(Self::Shipped(Box::new(Controller::new(plan))));
        }
        let controller = PipedController::start_with(
            plan,
            PipedStart { signals: Some(progress.signals()), ..PipedStart::default() },
        )?;
        Ok(Self::Piped(Box::new(controller), Box::default()))
    }

    /// Its command for an observation.
    ///
    /// # Errors
    /// When the controller's program fails.
    pub fn respond(&mut self, observation: &Observation, command: &mut Command) -> Result<(), PipeError> {
        match self {
            Self::Shipped(controller) => controller.respond(observation, command),
            Self::Piped(controller, _) => controller.ask(observation, command)?,
        }
        Ok(())
    }

    /// What it does once the command has gone out.
    ///
    /// # Errors
    /// When the controller's program fails.
    pub fn after_command(&mut self, observation: &Observation) -> Result<(), PipeError> {
        match self {
            Self::Shipped(controller) => controller.after_command(observation),
            Self::Piped(controller, learning) => controller.receive_learning(learning)?,
        }
        Ok(())
    }

    /// What goes with the last command: commands for the ticks after it, where the scenario has them.
    pub fn ahead(&self) -> Option<&Ahead> {
        match self {
            Self::Shipped(controller) => controller.ahead(),
            Self::Piped(..) => None,
        }
    }

    /// The processor time that it has used, ns; a learner of this package has that of the calling thread.
    pub fn cpu_ns(&self) -> u64 {
        match self {
            Self::Shipped(_) => thread_cpu_ns(),
            Self::Piped(controller, _) => process_cpu_ns(controller.pid()).unwrap_or_default(),
        }
    }

    /// What it has learned in the first `done` ticks of the run of `plan`, for a test. Once that has
    /// [ended](FrozenSubject::end), the run goes on as if there had been no test.
    ///
    /// # Errors
    /// When the controller's program fails.
    pub fn frozen(&mut self, plan: &Plan, done: u64) -> Result<FrozenSubject<'_>, PipeError> {
        match self {
            Self::Shipped(controller) => Ok(FrozenSubject::Agent(FrozenAgent::of(controller.agent(), plan))),
            Self::Piped(controller, _) => {
                controller.begin_test()?;
                let (observation, command) = Default::default();
                Ok(FrozenSubject::Program(Box::new(TestedProgram {
                    controller,
                    done,
                    observation,
                    command,
                    failed: None,
                })))
            }
        }
    }

    /// Ends the run, and gives the controller's report.
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

/// A learner in a test: without exploration noise, and without learning.
pub(super) enum FrozenSubject<'a> {
    /// A learner of this package.
    Agent(FrozenAgent),
    /// A program of its own.
    Program(Box<TestedProgram<'a>>),
}

/// A program in a test.
pub(super) struct TestedProgram<'a> {
    controller: &'a mut PipedController,
    /// Ticks of the run before the test. Those of the test continue them, so that time never goes back.
    done: u64,
    observation: Observation,
    command: Command,
    /// After a failure, the rest of the test is driven with zeros, and has no result.
    failed: Option<PipeError>,
}

impl FrozenSubject<'_> {
    /// The mean command for what it sees in the next tick of the test.
    pub fn command(&mut self, seen: &TestPercept) -> Outputs {
        match self {
            Self::Agent(agent) => agent.command(seen),
            Self::Program(program) => program.command(seen),
        }
    }

    /// Ends the test.
    ///
    /// # Errors
    /// When the controller's program has failed.
    pub fn end(self) -> Result<(), PipeError> {
        match self {
            Self::Agent(_) => Ok(()),
            Self::Program(program) => match program.failed {
                Some(error) => Err(error),
                None => program.controller.end_test(),
            },
        }
    }
}

impl TestedProgram<'_> {
    fn command(&mut self, seen: &TestPercept) -> Outputs {
        if self.failed.is_some() {
            return Outputs::default();
        }
        // The test is another episode than the run.
        let first = if seen.tick == 0 { flag::FIRST | flag::TRUNCATED } else { 0 };
        let header = &mut self.observation.header;
        header.flags = first | seen.flags & BOUNDARIES;
        (header.tick, header.sequence) = (self.done + seen.tick, self.done + seen.tick);
        self.observation.inputs[..seen.inputs.len()].copy_from_slice(seen.inputs);
        self.failed = self.controller.ask(&self.observation, &mut self.command).err();
        std::array::from_fn(|output| self.command.mean[output])
    }
}
