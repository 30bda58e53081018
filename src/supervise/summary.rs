//! The summary of a run: one object for programs, a table and a figure for people.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde::Serialize;

use super::Launch;
use super::children::ProcessFailure;
use super::evaluation::evaluate;
use super::history::{ends, history};
use super::in_process::StudyResult;
use super::learned_state::LearnedState;
use super::learning_progress::{reached, rows};
use super::log_packing;
use super::restarts::RestartIncident;
use super::supervisor::RunEnd;
use crate::agent::Agent as _;
use crate::clock::RealtimeReport;
use crate::log;
use crate::report::{self, ProgressRow, Reached, RunHistory};
use crate::runtime::{
    ControllerReport, LoggerReport, Mode, PlantReport, PolicySnapshot, RunWarning, StartPoint, TickBudget, exit, judge,
    read_realtime, read_report, read_snapshots, remove_unwritten_reports,
};
use crate::stats::{Percentiles, Window};
use crate::text::thousands;
use crate::wire::Role;

/// How a run ended.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum RunOutcome {
    /// After its last tick.
    Complete,
    /// By a signal.
    Signal(u32),
    /// Because a process failed.
    #[default]
    Failed,
}

/// Means over a stretch of the run.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct WindowSummary {
    /// First tick.
    pub from: u64,
    /// Number of ticks.
    pub ticks: u64,
    /// Loss a tick.
    pub loss: f64,
    /// Loss a tick without what exploration noise alone costs.
    pub loss_without_noise: f64,
    /// Root mean square error, m; null where the plant measures none.
    pub rms_error_m: Option<f64>,
    /// Mean error at the end of a target, m; null where none ended.
    pub end_error_m: Option<f64>,
}

/// What a process asked of the operating system in real time, what it had, and what it was refused.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ProcessRealtime {
    /// Which process.
    pub process: &'static str,
    /// Its report.
    #[serde(flatten)]
    pub report: RealtimeReport,
}

/// Everything that is reported of a run.
#[derive(Debug, Clone, Default, Serialize)]
pub struct RunSummary {
    /// The scenario's name.
    pub scenario: String,
    /// `lockstep`, `realtime` or `in-process`.
    pub mode: Mode,
    /// Seed of the run.
    pub seed: u64,
    /// How the run ended.
    pub ended: RunOutcome,
    /// Ticks done.
    pub ticks: u64,
    /// Ticks planned; null for an endless run.
    pub ticks_planned: Option<u64>,
    /// The tick with which this part of the run began, if it goes on with another one.
    pub resumed_at: Option<u64>,
    /// What another run had learned, with which this one began; null where it began with a fresh learner.
    pub started_from: Option<StartPoint>,
    /// Whether the learner was frozen: nothing was learned, and nothing explored.
    pub frozen: bool,
    /// Seconds that they took.
    pub seconds: f64,
    /// Ticks a second.
    pub ticks_per_second: f64,
    /// Ticks whose command was not applied.
    pub missed: u64,
    /// Those of them in which the gate applied a command that an earlier one had brought ahead; null where the plant
    /// left no report.
    pub ahead: Option<u64>,
    /// Commands that came after their tick.
    pub late: u64,
    /// Ticks that the plant passed over, being late itself.
    pub skipped: u64,
    /// Ticks in which the gate limited what was wanted, for whatever reason. This count and those that follow are
    /// null where the process that counts left no report, because it was lost for good.
    pub clamped: Option<u64>,
    /// Among them, those in which it limited the change from tick to tick,
    pub step_limited: Option<u64>,
    /// kept a joint from going over its limits,
    pub position_limited: Option<u64>,
    /// or let commands grow that had just begun to come.
    pub ramped: Option<u64>,
    /// Commands that held a value that is not a number.
    pub non_finite: Option<u64>,
    /// Ticks in which a fault of the channel let the controller hear nothing.
    pub unheard: Option<u64>,
    /// Observations that a fault of the channel let come to it after their tick.
    pub stale: Option<u64>,
    /// A plant on hardware: ticks without torque, by the reason. Empty where there were none.
    pub without_torque: BTreeMap<String, u64>,
    /// Samples that did not reach the log, all channels together.
    pub lost: Option<u64>,
    /// The same by channel: observation, command, learning.
    pub lost_by_channel: Option<[u64; 3]>,
    /// What the learner counted, by name; empty where it counts nothing.
    pub learner: BTreeMap<String, u64>,
    /// XXH3-64 of the final weights, or of the learner's whole state if it has none, hexadecimal.
    pub weights_hash: Option<String>,
    /// The first tick at which the weights were no longer numbers; null where they are.
    pub diverged_at: Option<u64>,
    /// Loss a tick over the last twentieth of the run.
    pub loss_per_tick: Option<f64>,
    /// Mean error at the end of a target over the last twentieth of the run, m.
    pub end_error_m: Option<f64>,
    /// The first twentieth.
    pub first: Option<WindowSummary>,
    /// The last twentieth.
    pub last: Option<WindowSummary>,
    /// How far the learner got, tested without noise where it has a linear policy, and as observed; empty where the
    /// plant is not the simulator's arm, or where neither is known.
    pub progress: Vec<ProgressRow>,
    /// How soon it reached its targets, at the beginning and after each change of the arm; empty where that
    /// is unknown.
    pub reached: Vec<Reached>,
    /// The same as a sentence.
    pub reached_text: Option<String>,
    /// Real time: from a tick's scheduled instant to its sensing, us; of a run without a logger's report, to
    /// the plant's waking up.
    pub wake_up_lateness_us: Option<Percentiles>,
    /// Real time: from sensing to the sending of the command, us.
    pub observation_to_command_us: Option<Percentiles>,
    /// Real time: from the sending of a command to the observation that tells that it was applied, us.
    pub command_to_applied_us: Option<Percentiles>,
    /// Real time: how the ticks were spent; null in lockstep, where there is no time to spend.
    pub tick_budget: Option<TickBudget>,
    /// Real time: what each process asked of the operating system, what it had and what it was refused; empty
    /// otherwise.
    pub realtime: Vec<ProcessRealtime>,
    /// Processes that died or hung and were started again, in order.
    pub restarts: Vec<RestartIncident>,
    /// The run's folder.
    pub folder: PathBuf,
    /// The log; null where there is none. Its folder, if it has several segments.
    pub log: Option<PathBuf>,
    /// Its segments: one, and one more for each logger that was started anew, and each `[log] rotate`.
    pub log_segments: usize,
    /// Older segments that were removed because the log had reached `[log] limit_mb`.
    pub log_removed_segments: u64,
    /// Messages that the last logger to come back read again before it listened; 0 where none came back.
    pub log_reread: u64,
    /// The tick from which on samples are missing because the log did not take them; null where it did.
    pub log_missing_from: Option<u64>,
    /// Its size, all segments, bytes.
    pub log_bytes: u64,
    /// Its size before it was packed at the end of the run; null where it was not.
    pub log_unpacked_bytes: Option<u64>,
    /// Every how many ticks are in it.
    pub log_every: u64,
    /// The figure; null where there is nothing to draw.
    pub figure: Option<PathBuf>,
    /// What was made to go wrong, on purpose: `[faults]` of the scenario in words. Empty for a clean run.
    pub faults: Vec<String>,
    /// What did not go well, or may be a mistake; of the scenario's settings first.
    pub warnings: Vec<RunWarning>,
    /// What went wrong, one sentence; null where nothing did.
    pub failure: Option<String>,
    #[serde(skip)]
    checkpoint_failure: Option<String>,
    #[serde(skip)]
    code: u8,
    /// First and last window.
    #[serde(skip)]
    pub(super) windows: Option<[Window; 2]>,
    #[serde(skip)]
    pub(super) history: Option<RunHistory>,
    /// Real time: from the plant's waking up to its observation's being sent.
    #[serde(skip)]
    plant_work_us: Option<Percentiles>,
}

/// Size of all these files, bytes.
pub(super) fn total_bytes(files: &[PathBuf]) -> u64 {
    files.iter().filter_map(|file| Some(std::fs::metadata(file).ok()?.len())).sum()
}

impl WindowSummary {
    fn of(window: &Window) -> Self {
        Self {
            from: window.from,
            ticks: window.ticks,
            loss: window.loss,
            loss_without_noise: window.loss_without_noise(),
            rms_error_m: window.rms_error(),
            end_error_m: window.end_error,
        }
    }
}

impl RunSummary {
    /// The summary of a run of processes, from what they left in its folder; for one that left nothing, from
    /// what its status board showed last.
    pub(super) fn of_run(launch: &Launch, folder: &Path, end: RunEnd, seconds: f64) -> Self {
        let RunEnd { ended, failure, incidents, boards, folder_removed_at, .. } = end;
        let board = &boards[Role::Plant as usize];
        let report: Option<PlantReport> = read_report(folder, Role::Plant);
        let whole = report.is_some();
        let plant = report.unwrap_or_else(|| PlantReport {
            ticks: board.sent,
            missed: board.missed,
            late: board.late,
            skipped: board.lost,
            ..PlantReport::default()
        });
        let controller: Option<ControllerReport> = read_report(folder, Role::Controller);
        let logger: Option<LoggerReport> = read_report(folder, Role::Logger);
        remove_unwritten_reports(folder);
        let mut summary = Self::new(launch, folder, ended, seconds);
        summary.add_plant(&plant);
        if !whole {
            summary.forget_gate();
        }
        summary.warnings.extend(judge(&launch.plan, &plant, controller.as_ref()));
        summary.add_bridge(folder);
        summary.add_controller(launch, controller, &read_snapshots(folder, &launch.plan));
        summary.restarts = incidents;
        let report = |role: Role| Some(ProcessRealtime { process: role.name(), report: read_realtime(folder, role)? });
        summary.realtime = Role::ALL.into_iter().filter_map(report).collect();
        let logger = summary.add_log(folder, logger);
        if let Some(ProcessFailure { code, message, .. }) = failure {
            summary.failure = Some(message);
            if ended == RunOutcome::Failed {
                summary.code = code;
            }
        }
        if let Some(tick) = folder_removed_at {
            let (tick, folder) = (thousands(tick), folder.display());
            let message = format!(
                "the run's folder {folder} was removed at about tick {tick}, while the run was going; the log and \
                 whatever else it held until then is lost"
            );
            summary.complain(exit::INPUT, message);
        }
        if let Some(why) = logger.failure {
            let from =
                logger.missing_from.map(|tick| format!("the log lacks everything from tick {} on: ", thousands(tick)));
            summary.complain(exit::INPUT, from.unwrap_or_default() + &why);
        } else if summary.log_bytes < logger.bytes {
            let (is, was) = (thousands(summary.log_bytes), thousands(logger.bytes));
            let message = format!("{is} of the {was} bytes of the log are left: somebody removed or changed it");
            summary.complain(exit::INPUT, message);
        } else if log_packing::is_wanted(&launch.plan.scenario.log, ended, summary.log_bytes) {
            summary.pack_log(&launch.plan.scenario.log, folder);
        }
        summary.conclude();
        summary
    }

    /// The summary of a run in one process.
    pub(super) fn of_study(
        launch: &Launch,
        folder: &Path,
        ended: RunOutcome,
        result: StudyResult,
        seconds: f64,
    ) -> Self {
        let mut summary = Self::new(launch, folder, ended, seconds);
        summary.add_plant(&result.plant);
        (summary.lost, summary.lost_by_channel) = (Some(0), Some([0; 3]));
        summary.warnings.extend(judge(&launch.plan, &result.plant, Some(&result.controller)));
        summary.add_controller(launch, Some(result.controller), &result.snapshots);
        summary.conclude();
        summary
    }

    /// What the launcher knows of a run that is over; nothing of what its processes reported.
    fn new(launch: &Launch, folder: &Path, ended: RunOutcome, seconds: f64) -> Self {
        let scenario = &launch.plan.scenario;
        Self {
            scenario: scenario.name.clone(),
            mode: launch.mode,
            seed: scenario.seed,
            ended,
            ticks_planned: (!scenario.is_endless()).then_some(scenario.ticks),
            resumed_at: launch.resumed.as_ref().map(|resumed| resumed.tick),
            started_from: launch.started_from.as_ref().map(LearnedState::point),
            frozen: launch.frozen,
            seconds,
            folder: folder.to_owned(),
            log_every: scenario.log.every,
            faults: scenario.faults.in_words(),
            warnings: launch.plan.warnings.iter().map(|text| RunWarning::of_settings(text)).collect(),
            code: match ended {
                RunOutcome::Complete => exit::OK,
                RunOutcome::Signal(number) => exit::by_signal(number),
                RunOutcome::Failed => exit::PROCESS,
            },
            ..Self::default()
        }
    }

    fn add_plant(&mut self, plant: &PlantReport) {
        self.ticks = plant.ticks;
        self.missed = plant.missed;
        self.ahead = Some(plant.ahead);
        self.late = plant.late;
        self.skipped = plant.skipped;
        self.clamped = Some(plant.clamped);
        self.step_limited = Some(plant.step_limited);
        self.position_limited = Some(plant.position_limited);
        self.ramped = Some(plant.ramped);
        self.non_finite = Some(plant.non_finite);
        self.wake_up_lateness_us = plant.wake_up;
        self.observation_to_command_us = plant.observation_to_command;
        self.plant_work_us = plant.work;
        self.checkpoint_failure = plant.checkpoint_failure.clone();
    }

    /// The plant left no report: its board tells nothing of what the gate did.
    fn forget_gate(&mut self) {
        (self.clamped, self.step_limited, self.position_limited) = (None, None, None);
        (self.ramped, self.non_finite, self.ahead) = (None, None, None);
    }

    /// What the bridge on servos reported, if the plant was one.
    fn add_bridge(&mut self, folder: &Path) {
        #[derive(serde::Deserialize)]
        struct TorqueReport {
            without_torque: BTreeMap<String, u64>,
        }
        let text = std::fs::read_to_string(folder.join("bridge.json")).unwrap_or_default();
        if let Ok(report) = serde_json::from_str::<TorqueReport>(&text) {
            self.without_torque = report.without_torque;
        }
    }

    /// What the controller reported, if it did, and the tests of its policies. After the plant's report:
    /// where the two count the same, the controller's number is the run's.
    fn add_controller(&mut self, launch: &Launch, report: Option<ControllerReport>, snapshots: &[PolicySnapshot]) {
        if let Some(controller) = report {
            self.check_beginning(launch, &controller);
            self.ticks = controller.ticks + controller.unseen;
            self.unheard = Some(controller.unheard);
            self.stale = Some(controller.stale);
            self.learner = controller.learner.clone();
            self.weights_hash = Some(controller.weights_hash.clone());
            self.diverged_at = controller.diverged_at;
            self.tick_budget =
                controller.tick_budget.map(|budget| TickBudget { plant_us: self.plant_work_us, ..budget });
            self.checkpoint_failure = self.checkpoint_failure.take().or(controller.checkpoint_failure.clone());
            self.windows = ends(&controller.windows);
            if let Some([first, last]) = &self.windows {
                self.first = Some(WindowSummary::of(first));
                self.last = Some(WindowSummary::of(last));
                self.loss_per_tick = Some(last.loss);
                self.end_error_m = last.end_error;
            }
            // In real time, ticks that the plant passed over are not among those that the controller counts.
            let done = self.ticks.max(snapshots.last().map_or(0, |snapshot| snapshot.tick));
            let begun = launch.started_from.as_ref().and_then(|learned| learned.agent(&launch.plan).ok());
            let start = begun.as_ref().and_then(|agent| agent.policy());
            let phases = evaluate(&launch.plan, done, snapshots, start).unwrap_or_default();
            let first = if start.is_some() { "at the start" } else { "untrained" };
            self.progress = rows(&launch.plan, &phases, &controller.targets, first);
            self.reached = reached(&launch.plan, &phases);
            self.reached_text = report::sentence(&self.reached);
            self.history = Some(history(&launch.plan, launch.mode, controller, &phases));
        }
        let begun = self.ticks.saturating_sub(self.resumed_at.unwrap_or(0));
        self.ticks_per_second = begun as f64 / self.seconds.max(1e-9);
    }

    /// A controller's program of one's own may know neither `--from` nor `--freeze`: then it did something else than it
    /// was started for.
    fn check_beginning(&mut self, launch: &Launch, controller: &ControllerReport) {
        let begins = launch.started_from.is_some() && launch.resumed.is_none();
        let program = &launch.plan.scenario.controller.program;
        if begins && controller.started_from.is_none() {
            let message = format!("{program} began with a fresh learner: it does not know --from; build it anew");
            self.complain(exit::PROCESS, message);
        }
        if launch.frozen && !controller.frozen {
            let message = format!("{program} was not frozen: it does not know --freeze; build it anew");
            self.complain(exit::PROCESS, message);
        }
    }

    /// What the log is, and the logger's report of it, if there is one. Returns the report, or an empty one.
    fn add_log(&mut self, folder: &Path, report: Option<LoggerReport>) -> LoggerReport {
        let mut segments = log::segments(folder);
        self.log_bytes = total_bytes(&segments);
        self.log_segments = segments.len();
        self.log = if segments.len() > 1 { Some(folder.to_owned()) } else { segments.pop() };
        let known = report.is_some();
        let logger = report.unwrap_or_default();
        self.log_missing_from = logger.missing_from;
        self.log_removed_segments = logger.removed_segments;
        self.log_reread = logger.reread;
        // The logger's report outlives plants and controllers.
        for (shown, counted) in [
            (&mut self.wake_up_lateness_us, logger.wake_up_lateness),
            (&mut self.observation_to_command_us, logger.observation_to_command),
            (&mut self.command_to_applied_us, logger.command_to_applied),
        ] {
            *shown = counted.or(*shown);
        }
        self.lost_by_channel = known.then_some(logger.lost);
        self.lost = known.then(|| logger.lost.iter().sum());
        logger
    }

    /// Adds what is wrong with a run that came to its end, draws the figure and leaves the summary in the
    /// run's folder.
    fn conclude(&mut self) {
        let failures: Vec<String> =
            self.warnings.iter().filter(|warning| warning.failure).map(|warning| warning.text.clone()).collect();
        for text in failures {
            self.complain(if self.diverged_at.is_some() { exit::ERROR } else { exit::PROCESS }, text);
        }
        if let Some(cause) = self.checkpoint_failure.take() {
            self.complain(exit::INPUT, format!("not all checkpoints were written: {cause}"));
        }
        if let Some(history) = &self.history {
            let path = self.folder.join("figure.svg");
            match report::figure::draw(history, &path) {
                Ok(()) => self.figure = Some(path),
                Err(error) => self.complain(exit::INPUT, error.to_string()),
            }
        }
        let path = self.folder.join("summary.json");
        if let Err(error) = std::fs::write(&path, self.to_json()) {
            self.complain(exit::INPUT, format!("{} cannot be written: {error}", path.display()));
        }
    }

    pub(super) fn complain(&mut self, code: u8, message: String) {
        if self.code == exit::OK {
            self.code = code;
        }
        self.failure.get_or_insert(message);
    }

    /// The exit code that tells how the run ended.
    pub fn exit_code(&self) -> u8 {
        self.code
    }

    /// One JSON object.
    pub fn to_json(&self) -> String {
        serde_json::to_string(self).unwrap_or_default()
    }
}
