//! Plant and controller in one process, without transport and log: the third way to run a tick, for studies.

use super::{Controller, ControllerReport, PlantReport, PlantSide, RunStatistics};
use crate::plant::Plant;
use crate::policy::LinearPolicy;
use crate::scenario::Plan;
use crate::wire::{Command, Observation};

/// What comes of a run in one process.
#[derive(Debug, Clone)]
pub struct InProcess {
    /// The plant's account.
    pub plant: PlantReport,
    /// The controller's account.
    pub controller: ControllerReport,
    /// The policy at the end.
    pub policy: LinearPolicy,
}

/// Runs `plan` with `body`: the same ticks, in the same order, as three processes in lockstep. `watch` is called with
/// the ticks done and the account so far, every 4096 ticks; when it says false the run ends there.
pub fn in_process<P: Plant>(plan: &Plan, body: P, mut watch: impl FnMut(u64, &RunStatistics) -> bool) -> InProcess {
    in_process_seen(plan, body, |observation, controller| {
        let tick = observation.header.tick;
        !tick.is_multiple_of(4096) || watch(tick, controller.statistics())
    })
}

/// The same for whoever wants to see every tick: `see` is called with the observation before it is answered; when it says
/// false the run ends there.
pub fn in_process_seen<P: Plant>(
    plan: &Plan,
    body: P,
    mut see: impl FnMut(&Observation, &Controller) -> bool,
) -> InProcess {
    let mut side = PlantSide::new(body, plan);
    let mut controller = Controller::new(plan);
    let (mut observation, mut command) = (Observation::default(), Command::default());
    for tick in 0..plan.scenario.ticks {
        side.observe(tick, 0, 0, &mut observation);
        if !see(&observation, &controller) {
            break;
        }
        controller.respond(&observation, &mut command);
        controller.after_command(&observation);
        side.step(tick, Some(&command));
    }
    InProcess { plant: side.report, policy: controller.policy().clone(), controller: controller.finish() }
}
