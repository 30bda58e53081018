//! One run of a sweep: in this process if the plant is simulated, and otherwise in processes of its own.

use std::sync::Mutex;

use serde::{Deserialize, Serialize};

use crate::clock::TerminationSignals;
use crate::runtime::{
    Controller, ControllerReport, Mode, PipeError, PipedController, PipedStart, PlantReport, in_process_over_pipe,
    read_report, simulate,
};
use crate::scenario::Plan;
use crate::stats::Window;
use crate::study::{JobProgress, StudyError, exact};
use crate::supervise::{Launch, RunOutcome, window_ends};
use crate::wire::Role;

/// Ticks between two reports of progress.
const REPORT: u64 = 4096;

/// The result of a run.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(super) struct SweepRun {
    /// Losses and errors over the run.
    #[serde(with = "exact::windows")]
    pub windows: Vec<Window>,
    /// Ticks answered.
    pub ticks: u64,
    /// Ticks without a command that was applied.
    pub missed: u64,
    /// Ticks learned from.
    pub learned: u64,
    /// The first tick at which the learner met a number that is not finite.
    pub diverged_at: Option<u64>,
    /// XXH3-64 of what was learned, hexadecimal.
    pub weights_hash: String,
}

impl SweepRun {
    fn of(plant: &PlantReport, controller: ControllerReport) -> Self {
        Self {
            ticks: controller.ticks,
            missed: plant.missed,
            learned: controller.learned,
            diverged_at: controller.diverged_at,
            weights_hash: controller.weights_hash,
            windows: controller.windows,
        }
    }

    /// The first and the last twentieth.
    pub fn ends(&self) -> Option<[Window; 2]> {
        window_ends(&self.windows)
    }
}

/// Makes the runs of a sweep.
pub(super) struct SweepRunner {
    signals: TerminationSignals,
    /// Held by the run that has processes of its own: several at a time would only take turns on the cores.
    processes: Mutex<()>,
}

impl SweepRunner {
    pub fn new(signals: TerminationSignals) -> Self {
        Self { signals, processes: Mutex::new(()) }
    }

    /// The run of `plan`; `None` if it had to stop.
    pub fn run(&self, plan: &Plan, progress: &JobProgress) -> Result<Option<SweepRun>, StudyError> {
        let Some(body) = plan.simulated_plant() else { return self.run_processes(plan, progress) };
        let go_on = |tick: u64| progress.report(if tick == 0 { 0 } else { REPORT });
        if plan.scenario.controller.is_shipped() {
            let result = simulate(plan, body, Controller::new(plan), &mut |observation, _| {
                let tick = observation.header.tick;
                !tick.is_multiple_of(REPORT) || go_on(tick)
            });
            return Ok(progress.report(0).then(|| SweepRun::of(&result.plant, result.controller)));
        }
        let start = PipedStart { signals: Some(self.signals.clone()), ..PipedStart::default() };
        let piped = PipedController::start_with(plan, start)
            .and_then(|controller| in_process_over_pipe(plan, body, controller, |tick, _| go_on(tick)));
        match piped {
            Ok((plant, controller)) => Ok(progress.report(0).then(|| SweepRun::of(&plant, controller))),
            Err(PipeError::Interrupted { .. }) => Ok(None),
            Err(error) => {
                let (name, seed) = (plan.scenario.name.clone(), plan.scenario.seed);
                Err(StudyError::Controller { name, seed, error })
            }
        }
    }

    /// A run in lockstep, in a folder that is removed when it is over.
    fn run_processes(&self, plan: &Plan, progress: &JobProgress) -> Result<Option<SweepRun>, StudyError> {
        let _turn = self.processes.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        if !progress.report(0) {
            return Ok(None);
        }
        let failed = |why: String| {
            let (name, seed) = (&plan.scenario.name, plan.scenario.seed);
            StudyError::Run { code: crate::runtime::exit::PROCESS, message: format!("{name} with seed {seed}: {why}") }
        };
        let folder = tempfile::tempdir().map_err(|error| failed(format!("no folder for the run: {error}")))?;
        let launch = Launch {
            plan: plan.clone(),
            mode: Mode::Lockstep,
            out: Some(folder.path().join("run")),
            name: None,
            by_hand: Vec::new(),
            checkpoint_every: 0,
            keep_checkpoints: 0,
            stopwatch: false,
            stand_in: None,
            resumed: None,
            started_from: None,
            frozen: false,
            progress: false,
        };
        let summary = crate::supervise::run(&launch)?;
        if matches!(summary.ended, RunOutcome::Signal(_)) {
            return Ok(None);
        }
        if let Some(why) = summary.failure {
            return Err(failed(why));
        }
        let plant: Option<PlantReport> = read_report(&summary.folder, Role::Plant);
        let controller: Option<ControllerReport> = read_report(&summary.folder, Role::Controller);
        let Some((plant, controller)) = plant.zip(controller) else {
            return Err(failed("it left no report".to_owned()));
        };
        progress.report(plan.scenario.ticks);
        Ok(Some(SweepRun::of(&plant, controller)))
    }
}
