//! Runs plant and controller in one process, without transport and log, for studies. Beside lockstep and real
//! time it is the third way to run a tick.

use super::{Controller, ControllerReport, PipeError, PipedController, PlantReport, PlantSide, RunStatistics};
use crate::agent::{Agent, ShippedAgent};
use crate::plant::{Plant, SimulatedPlant};
use crate::scenario::Plan;
use crate::simd::SimdPath;
use crate::wire::{Command, Learning, Observation};

/// The result of a run in one process, with the scenario's learner or an agent of your own.
#[derive(Debug, Clone)]
pub struct InProcess<A = ShippedAgent> {
    /// The plant's report.
    pub plant: PlantReport,
    /// The controller's report.
    pub controller: ControllerReport,
    /// The agent at the end.
    pub agent: A,
}

/// A simulated plant and the scenario's own learner in this process, tick by tick: [`sense`](Self::sense),
/// [`answer`](Self::answer), [`improve`](Self::improve), [`advance`](Self::advance), and again. Studies and benches
/// that look at a run between the parts of a tick use it.
///
/// It has no type parameters, so that its code is compiled in this crate, with full optimisation.
#[derive(Debug, Clone)]
pub struct Simulation {
    side: PlantSide<SimulatedPlant>,
    controller: Controller,
    tick: u64,
    observation: Observation,
    command: Command,
    learning: Learning,
}

impl Simulation {
    /// `plan` with the plant `body` and the controller that `plan` describes.
    pub fn new(plan: &Plan, body: SimulatedPlant) -> Self {
        Self::with_controller(plan, body, Controller::new(plan))
    }

    /// `plan` with the plant `body` and a controller that need not begin anew.
    pub fn with_controller(plan: &Plan, body: SimulatedPlant, controller: Controller) -> Self {
        Self {
            side: PlantSide::new(body, plan),
            controller,
            tick: 0,
            observation: Observation::default(),
            command: Command::default(),
            learning: Learning::default(),
        }
    }

    /// The same simulation with the controller's inner loops on `path`.
    pub fn on(self, path: SimdPath) -> Self {
        Self { controller: self.controller.on(path), ..self }
    }

    /// The plant senses at the start of the tick.
    pub fn sense(&mut self) -> &Observation {
        self.side.observe(self.tick, 0, 0, &mut self.observation);
        &self.observation
    }

    /// The controller learns from the observation's reward, and answers it.
    pub fn answer(&mut self) -> &Command {
        self.controller.respond(&self.observation, &mut self.command);
        &self.command
    }

    /// The controller's work after the command: it improves what it learned, and counts.
    pub fn improve(&mut self) {
        self.controller.after_command(&self.observation);
    }

    /// Fills the learning record of the tick.
    pub fn record(&mut self) -> &Learning {
        self.controller.record(&self.observation, &mut self.learning);
        &self.learning
    }

    /// The plant applies the command, and the tick is over.
    pub fn advance(&mut self) {
        self.side.keep_ahead(self.controller.ahead());
        self.side.step(self.tick, Some(&self.command));
        self.tick += 1;
    }

    /// Hands the controller `observation` in the place of the plant's, without a tick of the plant.
    pub fn answer_to(&mut self, observation: &Observation) -> &Command {
        self.controller.respond(observation, &mut self.command);
        &self.command
    }

    /// The work after the command for `observation`, which is not the plant's, and its learning record.
    pub fn improve_after(&mut self, observation: &Observation) -> &Learning {
        self.controller.after_command(observation);
        self.controller.record(observation, &mut self.learning);
        &self.learning
    }

    /// The plant's last observation.
    pub fn observation(&self) -> &Observation {
        &self.observation
    }

    /// The tick that [`sense`](Self::sense) begins next or has begun.
    pub fn tick(&self) -> u64 {
        self.tick
    }

    /// The controller.
    pub fn controller(&self) -> &Controller {
        &self.controller
    }

    /// Runs the ticks of `plan`, of which none has been run. `observer` gets every observation before the controller
    /// responds to it; when it returns false, the run ends there.
    fn run(mut self, ticks: u64, observer: &mut dyn FnMut(&Observation, &Controller) -> bool) -> InProcess {
        while self.tick < ticks {
            self.sense();
            if !observer(&self.observation, &self.controller) {
                break;
            }
            self.answer();
            self.improve();
            self.advance();
        }
        self.finish()
    }

    /// Ends the run, with the reports of both sides.
    pub fn finish(self) -> InProcess {
        let (controller, agent) = self.controller.finish_with_agent();
        InProcess { plant: self.side.into_report(), controller, agent }
    }
}

/// Runs the simulated plant `body` and `controller`, which need not begin anew, like [`in_process_with_observer`]. This
/// one is compiled with full optimisation wherever it is called from.
pub fn simulate(
    plan: &Plan,
    body: SimulatedPlant,
    controller: Controller,
    observer: &mut dyn FnMut(&Observation, &Controller) -> bool,
) -> InProcess {
    Simulation::with_controller(plan, body, controller).run(plan.scenario.ticks, observer)
}

/// Runs `plan` with the plant `body`: the same ticks in the same order as three processes in lockstep.
/// `progress` is called every 4096 ticks with the ticks done and the statistics so far. When it returns false,
/// the run ends there.
pub fn in_process<P: Plant>(plan: &Plan, body: P, mut progress: impl FnMut(u64, &RunStatistics) -> bool) -> InProcess {
    in_process_with_observer(plan, body, |observation, controller| {
        let tick = observation.header.tick;
        !tick.is_multiple_of(4096) || progress(tick, controller.statistics())
    })
}

/// Like [`in_process`], with a call of `observer` in every tick. It gets the observation before the controller
/// responds to it. When it returns false, the run ends there.
pub fn in_process_with_observer<P: Plant>(
    plan: &Plan,
    body: P,
    observer: impl FnMut(&Observation, &Controller) -> bool,
) -> InProcess {
    in_process_with_agent(plan, body, plan.agent(), observer)
}

/// Like [`in_process_with_observer`], with an agent of your own in the place of the scenario's controller: the quick
/// way to test it.
pub fn in_process_with_agent<P: Plant, A: Agent>(
    plan: &Plan,
    body: P,
    agent: A,
    mut observer: impl FnMut(&Observation, &Controller<A>) -> bool,
) -> InProcess<A> {
    let mut side = PlantSide::new(body, plan);
    let mut controller = Controller::with_agent(plan, agent);
    let (mut observation, mut command) = (Observation::default(), Command::default());
    for tick in 0..plan.scenario.ticks {
        side.observe(tick, 0, 0, &mut observation);
        if !observer(&observation, &controller) {
            break;
        }
        controller.respond(&observation, &mut command);
        controller.after_command(&observation);
        side.keep_ahead(controller.ahead());
        side.step(tick, Some(&command));
    }
    let (controller, agent) = controller.finish_with_agent();
    InProcess { plant: side.into_report(), controller, agent }
}

/// Runs `plan` with the plant `body` in this process and a controller's program at the other end of a pipe.
/// `progress` is called every 4096 ticks with the ticks done and the statistics so far. When it returns false, the run
/// ends there.
///
/// # Errors
/// When the controller's program fails.
pub fn in_process_over_pipe<P: Plant>(
    plan: &Plan,
    body: P,
    mut controller: PipedController,
    mut progress: impl FnMut(u64, &RunStatistics) -> bool,
) -> Result<(PlantReport, ControllerReport), PipeError> {
    let mut side = PlantSide::new(body, plan);
    let mut statistics = RunStatistics::new(plan);
    let (mut observation, mut command) = (Observation::default(), Command::default());
    let mut learning = Learning::default();
    for tick in 0..plan.scenario.ticks {
        side.observe(tick, 0, 0, &mut observation);
        if controller.interrupted() || tick.is_multiple_of(4096) && !progress(tick, &statistics) {
            break;
        }
        controller.exchange(&observation, &mut command, &mut learning)?;
        statistics.observe(&observation);
        side.step(tick, Some(&command));
    }
    Ok((side.into_report(), controller.finish()?))
}
