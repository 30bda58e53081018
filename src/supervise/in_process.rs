//! A run in one process, without transport and log. A controller's program of your own is a child of it.

use super::folder::RunFolder;
use super::progress::RunProgress;
use super::summary::{RunOutcome, RunSummary};
use super::{Launch, LaunchError};
use crate::agent::Agent as _;
use crate::clock::{TerminationSignals, monotonic_ns};
use crate::plant::SimulatedPlant;
use crate::runtime::{
    Controller, ControllerReport, PipedController, PipedStart, PlantReport, PolicySnapshot, SnapshotSchedule,
    in_process_over_pipe, simulate,
};
use crate::scenario::Plan;

/// Ticks between two checks for signals and updates of the progress line.
const CHECK_EVERY: u64 = 4096;

/// Runs a scenario with plant and controller in this process. The numbers are those of lockstep; there is no log.
///
/// # Errors
/// When the run cannot start.
pub fn run_in_process(launch: &Launch) -> Result<RunSummary, LaunchError> {
    let signals = TerminationSignals::install().map_err(LaunchError::Signals)?;
    let plan = &launch.plan;
    let plant = simulated_plant(plan)?;
    let controller = beginning(launch)?;
    // Started before the folder exists, so that a program that refuses the scenario leaves nothing behind.
    let piped = match plan.scenario.controller.is_shipped() {
        true => None,
        false => Some(PipedController::start_with(plan, piped_start(launch, &signals))?),
    };
    let folder = RunFolder::create(launch.out.as_deref(), launch.name.as_deref(), &plan.scenario.name)?;
    folder.write_scenario(plan)?;
    folder.keep();
    let mut progress = RunProgress::study(&plan.scenario.name, plan.scenario.ticks, launch.progress);
    let began = monotonic_ns();
    if let Some(controller) = piped {
        let reports = in_process_over_pipe(plan, plant, controller, |tick, statistics| {
            progress.show_study(tick, statistics.now());
            signals.received() == 0
        });
        progress.clear();
        let result = StudyResult::of_reports(reports?);
        let seconds = (monotonic_ns() - began) as f64 / 1e9;
        return Ok(RunSummary::of_study(launch, folder.path(), outcome(&signals), result, seconds));
    }
    let due = SnapshotSchedule::of(plan).map_or_else(Vec::new, |schedule| schedule.due().to_vec());
    let mut snapshots: Vec<PolicySnapshot> = Vec::new();
    let result = simulate(plan, plant, controller, &mut |observation, controller| {
        let tick = observation.header.tick;
        if due.get(snapshots.len()) == Some(&tick) {
            snapshots.extend(controller.policy().map(|policy| PolicySnapshot { tick, policy: policy.clone() }));
        }
        if !tick.is_multiple_of(CHECK_EVERY) {
            return true;
        }
        progress.show_study(tick, controller.statistics().now());
        signals.received() == 0
    });
    let end = result.controller.ticks;
    if !due.is_empty() && snapshots.last().is_none_or(|last| last.tick < end) {
        snapshots.extend(result.agent.policy().map(|policy| PolicySnapshot { tick: end, policy: policy.clone() }));
    }
    let seconds = (monotonic_ns() - began) as f64 / 1e9;
    progress.clear();
    let result = StudyResult { plant: result.plant, controller: result.controller, snapshots };
    Ok(RunSummary::of_study(launch, folder.path(), outcome(&signals), result, seconds))
}

/// What a controller's program begins with.
fn piped_start(launch: &Launch, signals: &TerminationSignals) -> PipedStart {
    let checkpoint = launch.started_from.as_ref().map(|learned| learned.file().to_owned());
    PipedStart { signals: Some(signals.clone()), checkpoint, frozen: launch.frozen }
}

/// The controller with which the run begins; of no use where that is a program of its own.
fn beginning(launch: &Launch) -> Result<Controller, LaunchError> {
    let mut controller = Controller::new(&launch.plan);
    if !launch.plan.scenario.controller.is_shipped() {
        return Ok(controller);
    }
    if launch.frozen {
        controller.freeze();
    }
    if let Some(learned) = &launch.started_from {
        controller.start_from(learned.checkpoint())?;
    }
    Ok(controller)
}

/// What a run in one process leaves.
pub(super) struct StudyResult {
    /// The plant's report.
    pub plant: PlantReport,
    /// The controller's report.
    pub controller: ControllerReport,
    /// The policies that were copied on the way.
    pub snapshots: Vec<PolicySnapshot>,
}

impl StudyResult {
    fn of_reports((plant, controller): (PlantReport, ControllerReport)) -> Self {
        Self { plant, controller, snapshots: Vec::new() }
    }
}

fn outcome(signals: &TerminationSignals) -> RunOutcome {
    match signals.received() {
        0 => RunOutcome::Complete,
        number => RunOutcome::Signal(number),
    }
}

/// The simulated plant of a scenario.
///
/// # Errors
/// [`LaunchError::NotSimulated`] when the plant is a program of its own.
pub(crate) fn simulated_plant(plan: &Plan) -> Result<SimulatedPlant, LaunchError> {
    plan.simulated_plant().ok_or_else(|| LaunchError::NotSimulated(plan.scenario.plant.program.clone()))
}
