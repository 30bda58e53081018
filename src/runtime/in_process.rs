//! Runs plant and controller in one process, without transport and log, for studies. Beside lockstep and real
//! time it is the third way to run a tick.

use super::{Controller, ControllerReport, PipeError, PipedController, PlantReport, PlantSide, RunStatistics};
use crate::agent::{Agent, ShippedAgent};
use crate::plant::Plant;
use crate::scenario::Plan;
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
    observer: impl FnMut(&Observation, &Controller<A>) -> bool,
) -> InProcess<A> {
    in_process_with_controller(plan, body, Controller::with_agent(plan, agent), observer)
}

/// Like [`in_process_with_agent`], with a controller that need not begin anew.
pub fn in_process_with_controller<P: Plant, A: Agent>(
    plan: &Plan,
    body: P,
    mut controller: Controller<A>,
    mut observer: impl FnMut(&Observation, &Controller<A>) -> bool,
) -> InProcess<A> {
    let mut side = PlantSide::new(body, plan);
    let (mut observation, mut command) = (Observation::default(), Command::default());
    for tick in 0..plan.scenario.ticks {
        side.observe(tick, 0, 0, &mut observation);
        if !observer(&observation, &controller) {
            break;
        }
        controller.respond(&observation, &mut command);
        controller.after_command(&observation);
        side.step(tick, Some(&command));
    }
    let (controller, agent) = controller.finish_with_agent();
    InProcess { plant: side.report, controller, agent }
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
    Ok((side.report, controller.finish()?))
}
