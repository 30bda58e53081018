//! What a run's end tells: one object for programs, a table and a figure for people.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use serde::Serialize;

use super::Launch;
use super::children::ProcessFailure;
use super::history::{ends, history};
use super::restarts::RestartIncident;
use super::supervisor::RunEnd;
use crate::clock::RealtimeReport;
use crate::log;
use crate::report::{self, RunHistory, Window, thousands};
use crate::runtime::{
    ControllerReport, InProcess, LoggerReport, Mode, PlantReport, TickBudget, exit, read_realtime, read_report,
    remove_unwritten_reports,
};
use crate::stats::Percentiles;
use crate::wire::Role;

/// How a run ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum RunOutcome {
    /// After its last tick.
    Complete,
    /// By a signal.
    Signal(u32),
    /// Because a process failed.
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

/// Everything that a run tells.
#[derive(Debug, Clone, Serialize)]
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
    /// Ticks planned.
    pub ticks_planned: u64,
    /// The tick with which this part of the run began, if it goes on with another one.
    pub resumed_at: Option<u64>,
    /// Seconds that they took.
    pub seconds: f64,
    /// Ticks a second.
    pub ticks_per_second: f64,
    /// Ticks whose command was not applied.
    pub missed: u64,
    /// Commands that came after their tick.
    pub late: u64,
    /// Ticks that the plant passed over, being late itself.
    pub skipped: u64,
    /// Ticks in which the gate limited what was wanted, for whatever reason.
    pub clamped: u64,
    /// Among them, those in which it limited the change from tick to tick,
    pub step_limited: u64,
    /// kept a joint from going over its limits,
    pub position_limited: u64,
    /// or let commands grow that had just begun to come.
    pub ramped: u64,
    /// Commands that held a value that is not a number.
    pub non_finite: u64,
    /// Ticks in which a fault of the channel let the controller hear nothing.
    pub unheard: u64,
    /// Observations that a fault of the channel let come to it after their tick.
    pub stale: u64,
    /// Samples that did not reach the log, all channels together.
    pub lost: u64,
    /// The same by channel: observation, command, learning.
    pub lost_by_channel: [u64; 3],
    /// XXH3-64 of the final weights, hexadecimal.
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
    /// Real time: from a tick's scheduled instant to its sensing, us; of a run without a logger's report, to the plant's
    /// waking up.
    pub wake_up_lateness_us: Option<Percentiles>,
    /// Real time: from sensing to the sending of the command, us.
    pub observation_to_command_us: Option<Percentiles>,
    /// Real time: from the sending of a command to the observation that tells that it was applied, us.
    pub command_to_applied_us: Option<Percentiles>,
    /// Real time: how the ticks were spent; null in lockstep, where there is no time to spend.
    pub tick_budget: Option<TickBudget>,
    /// Real time: what each process asked of the operating system, what it had and what it was refused; empty otherwise.
    pub realtime: Vec<ProcessRealtime>,
    /// Processes that died or hung and were started again, in order.
    pub restarts: Vec<RestartIncident>,
    /// The run's folder.
    pub folder: PathBuf,
    /// The log; null where there is none. Its folder, if it has several segments.
    pub log: Option<PathBuf>,
    /// Its segments: one, and one more for each logger that was started anew.
    pub log_segments: usize,
    /// The tick from which on samples are missing because the log did not take them; null where it did.
    pub log_missing_from: Option<u64>,
    /// Its size, all segments, bytes.
    pub log_bytes: u64,
    /// Every how many ticks are in it.
    pub log_every: u64,
    /// The figure; null where there is nothing to draw.
    pub figure: Option<PathBuf>,
    /// What was made to go wrong, on purpose: `[faults]` of the scenario in words. Empty for a clean run.
    pub faults: Vec<String>,
    /// What the scenario's settings make likely to go wrong, one sentence each.
    pub warnings: Vec<String>,
    /// What went wrong, one sentence; null where nothing did.
    pub failure: Option<String>,
    #[serde(skip)]
    checkpoint_failure: Option<String>,
    #[serde(skip)]
    code: u8,
    #[serde(skip)]
    windows: Option<[Window; 2]>,
    #[serde(skip)]
    history: Option<RunHistory>,
}

impl RunSummary {
    /// The summary of a run of processes, from what they left in its folder; for one that left nothing, from what its
    /// board said last.
    pub(super) fn of_run(launch: &Launch, folder: &Path, end: RunEnd, seconds: f64) -> Self {
        let RunEnd { ended, failure, incidents, boards, .. } = end;
        let board = &boards[Role::Plant as usize];
        let plant = read_report(folder, Role::Plant).unwrap_or_else(|| PlantReport {
            ticks: board.sent,
            missed: board.missed,
            late: board.late,
            skipped: board.lost,
            ..PlantReport::default()
        });
        let controller: Option<ControllerReport> = read_report(folder, Role::Controller);
        let logger: LoggerReport = read_report(folder, Role::Logger).unwrap_or_default();
        remove_unwritten_reports(folder);
        let mut summary = Self::new(launch, folder, ended, seconds, &plant, controller);
        summary.restarts = incidents;
        let realtime_of =
            |role: Role| Some(ProcessRealtime { process: role.name(), report: read_realtime(folder, role)? });
        summary.realtime = Role::ALL.into_iter().filter_map(realtime_of).collect();
        let mut segments = log::segments(folder);
        summary.log_bytes = segments.iter().filter_map(|log| Some(std::fs::metadata(log).ok()?.len())).sum();
        summary.log_segments = segments.len();
        summary.log = if segments.len() > 1 { Some(folder.to_owned()) } else { segments.pop() };
        summary.log_missing_from = logger.missing_from;
        // The logger's counts include those of restarted plants and controllers.
        for (told, counted) in [
            (&mut summary.wake_up_lateness_us, logger.wake_up_lateness),
            (&mut summary.observation_to_command_us, logger.observation_to_command),
            (&mut summary.command_to_applied_us, logger.command_to_applied),
        ] {
            *told = counted.or(*told);
        }
        summary.lost_by_channel = logger.lost;
        summary.lost = logger.lost.iter().sum();
        if let Some(ProcessFailure { code, message, .. }) = failure {
            summary.failure = Some(message);
            if ended == RunOutcome::Failed {
                summary.code = code;
            }
        }
        if let Some(why) = logger.failure {
            let from =
                logger.missing_from.map(|tick| format!("the log lacks everything from tick {} on: ", thousands(tick)));
            summary.complain(exit::INPUT, from.unwrap_or_default() + &why);
        }
        summary.conclude();
        summary
    }

    /// The summary of a run in one process.
    pub(super) fn of_study(launch: &Launch, folder: &Path, ended: RunOutcome, result: InProcess, seconds: f64) -> Self {
        let mut summary = Self::new(launch, folder, ended, seconds, &result.plant, Some(result.controller));
        summary.conclude();
        summary
    }

    fn new(
        launch: &Launch,
        folder: &Path,
        ended: RunOutcome,
        seconds: f64,
        plant: &PlantReport,
        controller: Option<ControllerReport>,
    ) -> Self {
        let plan = &launch.plan;
        let ticks = controller.as_ref().map_or(plant.ticks, |c| c.ticks + c.unseen);
        let windows = controller.as_ref().and_then(|c| ends(&c.windows));
        let span = |w: &Window| WindowSummary {
            from: w.from,
            ticks: w.ticks,
            loss: w.loss,
            loss_without_noise: w.loss_without_noise(),
            rms_error_m: w.rms_error(),
            end_error_m: w.end_error,
        };
        let (first, last) = match &windows {
            Some([first, last]) => (Some(span(first)), Some(span(last))),
            None => (None, None),
        };
        Self {
            scenario: plan.scenario.name.clone(),
            mode: launch.mode,
            seed: plan.scenario.seed,
            ended,
            ticks,
            ticks_planned: plan.scenario.ticks,
            resumed_at: launch.resumed.as_ref().map(|resumed| resumed.tick),
            seconds,
            ticks_per_second: ticks.saturating_sub(launch.resumed.as_ref().map_or(0, |r| r.tick)) as f64
                / seconds.max(1e-9),
            missed: plant.missed,
            late: plant.late,
            skipped: plant.skipped,
            clamped: plant.clamped,
            step_limited: plant.step_limited,
            position_limited: plant.position_limited,
            ramped: plant.ramped,
            non_finite: plant.non_finite,
            unheard: controller.as_ref().map_or(0, |c| c.unheard),
            stale: controller.as_ref().map_or(0, |c| c.stale),
            lost: 0,
            lost_by_channel: [0; 3],
            weights_hash: controller.as_ref().map(|c| c.weights_hash.clone()),
            diverged_at: controller.as_ref().and_then(|c| c.diverged_at),
            loss_per_tick: last.as_ref().map(|s| s.loss),
            end_error_m: last.as_ref().and_then(|s| s.end_error_m),
            first,
            last,
            wake_up_lateness_us: plant.wake_up,
            observation_to_command_us: plant.observation_to_command,
            command_to_applied_us: None,
            tick_budget: controller
                .as_ref()
                .and_then(|c| c.tick_budget)
                .map(|budget| TickBudget { plant_us: plant.work, ..budget }),
            realtime: Vec::new(),
            restarts: Vec::new(),
            folder: folder.to_owned(),
            log: None,
            log_segments: 0,
            log_missing_from: None,
            log_bytes: 0,
            log_every: plan.scenario.log.every,
            figure: None,
            faults: plan.scenario.faults.in_words(),
            warnings: plan.warnings.clone(),
            failure: None,
            checkpoint_failure: plant
                .checkpoint_failure
                .clone()
                .or(controller.as_ref().and_then(|c| c.checkpoint_failure.clone())),
            code: match ended {
                RunOutcome::Complete => exit::OK,
                RunOutcome::Signal(number) => exit::by_signal(number),
                RunOutcome::Failed => exit::PROCESS,
            },
            windows,
            history: controller.map(|c| history(plan, launch.mode, c)),
        }
    }

    /// Says what is wrong with a run that came to its end, draws the figure and leaves the summary in the run's folder.
    fn conclude(&mut self) {
        if let Some(tick) = self.diverged_at {
            self.complain(
                exit::ERROR,
                format!(
                    "the learner diverged at tick {} and has learned nothing since; try smaller steps under [learner]",
                    thousands(tick)
                ),
            );
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

    fn complain(&mut self, code: u8, message: String) {
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

    /// The short report for people.
    pub fn to_text(&self) -> String {
        let mut text = String::new();
        let how = match self.ended {
            RunOutcome::Complete => String::new(),
            RunOutcome::Signal(2) => format!(" of {} (interrupted)", thousands(self.ticks_planned)),
            RunOutcome::Signal(number) => format!(" of {} (ended by signal {number})", thousands(self.ticks_planned)),
            RunOutcome::Failed => format!(" of {} (failed)", thousands(self.ticks_planned)),
        };
        let from = self.resumed_at.map_or(String::new(), |tick| format!(", the last from {} on,", thousands(tick)));
        let _ = writeln!(
            text,
            "{}, {}, seed {}: {} ticks{how}{from} in {:.1} s, {} ticks/s",
            self.scenario,
            self.mode.name(),
            self.seed,
            thousands(self.ticks),
            self.seconds,
            thousands(self.ticks_per_second.round() as u64),
        );
        if let (Some(history), Some([first, last])) = (&self.history, &self.windows) {
            let windows = vec![first.clone(), last.clone()];
            let _ = write!(text, "\n{}\n", report::table(&RunHistory { windows, ..history.clone() }));
        }
        let _ =
            writeln!(text, "missed {}  late {}  lost {}  limited {}", self.missed, self.late, self.lost, self.clamped);
        // Only what happened.
        let mut row = |label: &str, counts: &[(&str, u64)]| {
            let happened: Vec<_> =
                counts.iter().filter(|(_, n)| *n > 0).map(|(what, n)| format!("{what} {n}")).collect();
            if !happened.is_empty() {
                let _ = writeln!(text, "{label:<23} {}", happened.join("  "));
            }
        };
        row(
            "gate",
            &[
                ("by step", self.step_limited),
                ("by position", self.position_limited),
                ("by ramp", self.ramped),
                ("not a number", self.non_finite),
            ],
        );
        row("heard", &[("nothing", self.unheard), ("too late", self.stale)]);
        for fault in &self.faults {
            let _ = writeln!(text, "{:<23} {fault}", "fault, on purpose");
        }
        for role in Role::ALL {
            let back: Vec<_> = self.restarts.iter().filter(|incident| incident.process == role.name()).collect();
            if let Some(last) = back.last() {
                let times = if back.len() == 1 { "once".to_owned() } else { format!("{} times", back.len()) };
                let _ =
                    writeln!(text, "{:<23} {times}; at last {}", format!("started again, {}", role.name()), last.what);
            }
        }
        for (label, percentiles) in [
            ("wake-up lateness", &self.wake_up_lateness_us),
            ("observation to command", &self.observation_to_command_us),
            ("command to applied", &self.command_to_applied_us),
        ] {
            if let Some(p) = percentiles {
                let _ = writeln!(
                    text,
                    "{label:<23} p50 {:.0} us  p99 {:.0} us  p99.9 {:.0} us  max {:.0} us",
                    p.p50, p.p99, p.p999, p.max
                );
            }
        }
        if let Some(budget) = &self.tick_budget {
            let _ = writeln!(text, "{:<23} {}", "tick budget", budget.to_text(24));
        }
        // Only where something was asked for or refused: otherwise all are as they always are.
        if self.realtime.iter().any(|r| !r.report.is_usual()) {
            for ProcessRealtime { process, report } in &self.realtime {
                let _ = writeln!(text, "{:<23} {}", format!("real time, {process}"), report.to_text());
            }
        }
        if let Some(hash) = &self.weights_hash {
            let _ = writeln!(text, "weights {hash}");
        }
        if let Some(log) = &self.log {
            let every = match self.log_every {
                1 => String::new(),
                n => format!(", every {n}th tick"),
            };
            let segments =
                if self.log_segments > 1 { format!(", {} segments", self.log_segments) } else { String::new() };
            let _ =
                writeln!(text, "log     {} ({:.1} MB{segments}{every})", log.display(), self.log_bytes as f64 / 1e6);
        }
        if let Some(figure) = &self.figure {
            let _ = writeln!(text, "figure  {}", figure.display());
        }
        text
    }
}
