//! What is measured in a comparison: a learning rule of this package, or a controller's program of its own, which runs
//! as a child and is tested over the same pipe.

use std::time::Instant;

use serde::{Deserialize, Serialize};

use super::Condition;
use crate::policy::Outputs;
use crate::reference::{Score, TestPercept};
use crate::runtime::{Controller, ControllerReport, PipeError, PipedController, PipedStart};
use crate::scenario::Plan;
use crate::study::JobProgress;
use crate::wire::{Ahead, Command, Learning, Observation, flag};

/// The cost of one tick, ns.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub(super) struct TickCost {
    /// From the observation to the command: learning, encoding, drawing.
    pub before: f64,
    /// After the command was sent.
    pub after: f64,
}

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

    /// One tick. Gives its cost: that of a program of its own includes the way there and back.
    ///
    /// # Errors
    /// When the controller's program fails.
    pub fn tick(
        &mut self,
        observation: &Observation,
        command: &mut Command,
        clock: Option<ClockCost>,
    ) -> Result<Option<TickCost>, PipeError> {
        let began = clock.map(|_| Instant::now());
        match self {
            Self::Shipped(controller) => controller.respond(observation, command),
            Self::Piped(controller, _) => controller.ask(observation, command)?,
        }
        let answered = clock.map(|_| Instant::now());
        match self {
            Self::Shipped(controller) => controller.after_command(observation),
            Self::Piped(controller, learning) => controller.receive_learning(learning)?,
        }
        let cost = |clock: ClockCost, began, answered| TickCost {
            before: clock.between(began, answered),
            after: clock.between(answered, Instant::now()),
        };
        Ok(clock.zip(began).zip(answered).map(|((clock, began), answered)| cost(clock, began, answered)))
    }

    /// What goes with the last command: commands for the ticks after it, where the scenario has them.
    pub fn ahead(&self) -> Option<&Ahead> {
        match self {
            Self::Shipped(controller) => controller.ahead(),
            Self::Piped(..) => None,
        }
    }

    /// Tests what was learned in the first `done` ticks, without exploration noise; the run goes on as if there had
    /// been no test. `None` if the study has to stop.
    ///
    /// # Errors
    /// When the controller's program fails.
    pub fn test(
        &mut self,
        condition: &Condition,
        done: u64,
        progress: &JobProgress,
    ) -> Result<Option<Score>, PipeError> {
        match self {
            Self::Shipped(controller) => Ok(Some(condition.test.score_agent(controller.agent()))),
            Self::Piped(controller, _) => {
                controller.begin_test()?;
                let score = test_over_pipe(controller, condition, done, progress)?;
                controller.end_test()?;
                Ok(score)
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

/// Drives the test's plant with a program's mean commands. After a failure, or once the study has to stop, the rest of
/// the test is driven with zeros, and has no result.
fn test_over_pipe(
    controller: &mut PipedController,
    condition: &Condition,
    done: u64,
    progress: &JobProgress,
) -> Result<Option<Score>, PipeError> {
    let (mut observation, mut command) = (Observation::default(), Command::default());
    let (mut failed, mut stopped) = (None, false);
    let score = condition.test.drive(|&TestPercept { tick, inputs, flags, .. }| {
        stopped |= !progress.report(0);
        if stopped || failed.is_some() {
            return Outputs::default();
        }
        // The test is another episode than the run. Its ticks continue those of the run, so that time never goes back.
        let first = if tick == 0 { flag::FIRST | flag::TRUNCATED } else { 0 };
        observation.header.flags = first | flags & flag::NEW_TARGET;
        (observation.header.tick, observation.header.sequence) = (done + tick, done + tick);
        observation.inputs[..inputs.len()].copy_from_slice(inputs);
        failed = controller.ask(&observation, &mut command).err();
        std::array::from_fn(|output| command.mean[output])
    });
    match failed {
        Some(error) => Err(error),
        None => Ok((!stopped).then_some(score)),
    }
}

/// The cost of reading the clock, ns, which is not counted.
#[derive(Debug, Clone, Copy)]
pub(super) struct ClockCost(f64);

impl ClockCost {
    /// Measures it.
    pub fn measure() -> Self {
        const READS: u32 = 10_000;
        let began = Instant::now();
        for _ in 0..READS {
            std::hint::black_box(Instant::now());
        }
        Self(began.elapsed().as_nanos() as f64 / f64::from(READS))
    }

    fn between(self, from: Instant, to: Instant) -> f64 {
        ((to - from).as_nanos() as f64 - self.0).max(0.0)
    }
}
