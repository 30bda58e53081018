//! What a run's end tells: one object for programs, a table and a figure for people.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use serde::Serialize;

use super::Launch;
use super::children::Failure;
use crate::plant::{noise_share, posture};
use crate::report::{self, Reach, Story, Window};
use crate::runtime::{
    Card, ControllerReport, InProcess, LoggerReport, Mode, Percentiles, PlantReport, Snapshot, exit, read_report,
};
use crate::scenario::{ArmTable, Plan};
use crate::wire::{Role, Status};

/// How a run ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Ended {
    /// After its last tick.
    Complete,
    /// By a signal.
    Signal(u32),
    /// Because a process failed.
    Failed,
}

/// Means over a stretch of the run.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Span {
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

/// Everything that a run tells.
#[derive(Debug, Clone, Serialize)]
pub struct Summary {
    /// The scenario's name.
    pub scenario: String,
    /// `lockstep`, `realtime` or `in-process`.
    pub mode: Mode,
    /// Seed of the run.
    pub seed: u64,
    /// How the run ended.
    pub ended: Ended,
    /// Ticks done.
    pub ticks: u64,
    /// Ticks planned.
    pub ticks_planned: u64,
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
    /// Commands that the gate limited.
    pub clamped: u64,
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
    pub first: Option<Span>,
    /// The last twentieth.
    pub last: Option<Span>,
    /// Real time: from a tick's scheduled instant to the plant's waking up, us.
    pub wake_up_lateness_us: Option<Percentiles>,
    /// Real time: from sensing to the sending of the command, us.
    pub observation_to_command_us: Option<Percentiles>,
    /// The run's folder.
    pub folder: PathBuf,
    /// The log; null where there is none.
    pub log: Option<PathBuf>,
    /// Its size, bytes.
    pub log_bytes: u64,
    /// Every how many ticks are in it.
    pub log_every: u64,
    /// The figure; null where there is nothing to draw.
    pub figure: Option<PathBuf>,
    /// What went wrong, one sentence; null where nothing did.
    pub failure: Option<String>,
    #[serde(skip)]
    code: u8,
    #[serde(skip)]
    windows: Option<[Window; 2]>,
    #[serde(skip)]
    story: Option<Story>,
}

/// Part of the run that the first and the last window of the table take.
const SHARE: u64 = 20;

impl Summary {
    /// The summary of a run of processes, from what they left in its folder; for one that left nothing, from what its
    /// board said last.
    pub(super) fn of_run(
        launch: &Launch,
        folder: &Path,
        boards: &[Status; 3],
        ended: Ended,
        failure: Option<Failure>,
        seconds: f64,
    ) -> Self {
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
        let mut summary = Self::new(launch, folder, ended, seconds, &plant, controller);
        let log = Card::log_path(folder);
        summary.log_bytes = std::fs::metadata(&log).map_or(0, |m| m.len());
        summary.log = log.exists().then_some(log);
        summary.lost_by_channel = logger.lost;
        summary.lost = logger.lost.iter().sum();
        if let Some(Failure { code, message, .. }) = failure {
            summary.failure = Some(message);
            if ended == Ended::Failed {
                summary.code = code;
            }
        }
        summary.conclude();
        summary
    }

    /// The summary of a run in one process.
    pub(super) fn of_study(launch: &Launch, folder: &Path, ended: Ended, result: InProcess, seconds: f64) -> Self {
        let mut summary = Self::new(launch, folder, ended, seconds, &result.plant, Some(result.controller));
        summary.conclude();
        summary
    }

    fn new(
        launch: &Launch,
        folder: &Path,
        ended: Ended,
        seconds: f64,
        plant: &PlantReport,
        controller: Option<ControllerReport>,
    ) -> Self {
        let plan = &launch.plan;
        let ticks = controller.as_ref().map_or(plant.ticks, |c| c.ticks + c.unseen);
        let noise = |tick| match &plan.scenario.plant.arm {
            Some(arm) => noise_share(arm, plan.scenario.policy.sigma, tick),
            None => 0.0,
        };
        let windows = controller.as_ref().and_then(|c| ends(&c.windows));
        let span = |w: &Window| Span {
            from: w.from,
            ticks: w.ticks,
            loss: w.loss,
            loss_without_noise: w.loss - noise(w.from),
            rms_error_m: w.mean_squared_error.map(f64::sqrt),
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
            seconds,
            ticks_per_second: ticks as f64 / seconds.max(1e-9),
            missed: plant.missed,
            late: plant.late,
            skipped: plant.skipped,
            clamped: plant.clamped,
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
            folder: folder.to_owned(),
            log: None,
            log_bytes: 0,
            log_every: plan.scenario.log.every,
            figure: None,
            failure: None,
            code: match ended {
                Ended::Complete => exit::OK,
                Ended::Signal(number) => exit::by_signal(number),
                Ended::Failed => exit::PROCESS,
            },
            windows,
            story: controller.map(|c| story(plan, launch.mode, c, noise(0))),
        }
    }

    /// Says what is wrong with a run that came to its end, draws the figure and leaves the summary in the run's folder.
    fn conclude(&mut self) {
        if let Some(tick) = self.diverged_at {
            self.complain(
                exit::ERROR,
                format!(
                    "the learner diverged: from tick {} on its weights are not numbers and the command is zero; \
                     try a smaller learner.alpha_over_variance",
                    thousands(tick)
                ),
            );
        }
        if let Some(story) = &self.story {
            let path = self.folder.join("figure.svg");
            match report::figure::draw(story, &path) {
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
            Ended::Complete => String::new(),
            Ended::Signal(2) => format!(" of {} (interrupted)", thousands(self.ticks_planned)),
            Ended::Signal(number) => format!(" of {} (ended by signal {number})", thousands(self.ticks_planned)),
            Ended::Failed => format!(" of {} (failed)", thousands(self.ticks_planned)),
        };
        let _ = writeln!(
            text,
            "{}, {}, seed {}: {} ticks{how} in {:.1} s, {} ticks/s",
            self.scenario,
            self.mode.name(),
            self.seed,
            thousands(self.ticks),
            self.seconds,
            thousands(self.ticks_per_second.round() as u64),
        );
        if let (Some(story), Some([first, last])) = (&self.story, &self.windows) {
            let windows = vec![first.clone(), last.clone()];
            let _ = write!(text, "\n{}\n", report::table(&Story { windows, ..story.clone() }));
        }
        let _ =
            writeln!(text, "missed {}  late {}  lost {}  limited {}", self.missed, self.late, self.lost, self.clamped);
        for (label, percentiles) in [
            ("wake-up lateness", &self.wake_up_lateness_us),
            ("observation to command", &self.observation_to_command_us),
        ] {
            if let Some(p) = percentiles {
                let _ = writeln!(
                    text,
                    "{label:<23} p50 {:.0} us  p99 {:.0} us  p99.9 {:.0} us  max {:.0} us",
                    p.p50, p.p99, p.p999, p.max
                );
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
            let _ = writeln!(text, "log     {} ({:.1} MB{every})", log.display(), self.log_bytes as f64 / 1e6);
        }
        if let Some(figure) = &self.figure {
            let _ = writeln!(text, "figure  {}", figure.display());
        }
        text
    }
}

/// The first and the last twentieth of a run, or what there is.
fn ends(windows: &[Window]) -> Option<[Window; 2]> {
    let total: u64 = windows.iter().map(|w| w.ticks).sum();
    let share = total / SHARE;
    Some([merge(windows.iter(), share)?, {
        let last = merge(windows.iter().rev(), share)?;
        Window { from: last.from, ..last }
    }])
}

/// Merges windows from the front of `windows` until they hold at least `ticks`.
fn merge<'a>(windows: impl Iterator<Item = &'a Window>, ticks: u64) -> Option<Window> {
    let mut sum: Option<Window> = None;
    for w in windows {
        sum = Some(match sum {
            None => w.clone(),
            Some(s) if s.ticks >= ticks => return Some(s),
            Some(s) => together(&s, w),
        });
    }
    sum
}

/// Two windows as one.
fn together(a: &Window, b: &Window) -> Window {
    let mean = |x: f64, n: u64, y: f64, m: u64| (x * n as f64 + y * m as f64) / (n + m) as f64;
    Window {
        from: a.from.min(b.from),
        ticks: a.ticks + b.ticks,
        loss: mean(a.loss, a.ticks, b.loss, b.ticks),
        mean_squared_error: a.mean_squared_error.zip(b.mean_squared_error).map(|(x, y)| mean(x, a.ticks, y, b.ticks)),
        end_error: match (a.end_error, b.end_error) {
            (Some(x), Some(y)) => Some(mean(x, a.ends, y, b.ends)),
            (x, y) => x.or(y),
        },
        ends: a.ends + b.ends,
    }
}

/// The story that the figure tells.
fn story(plan: &Plan, mode: Mode, controller: ControllerReport, noise_share: f64) -> Story {
    let scenario = &plan.scenario;
    let arm = scenario.plant.arm.as_ref();
    let reach = |switch: &[Snapshot]| arm.and_then(|arm| reach(arm, switch));
    let marks = arm.map_or(&[][..], |arm| &arm.block).iter();
    Story {
        title: format!("{}, {}, seed {}", scenario.name, mode.name(), scenario.seed),
        unit: if arm.is_some() { "m".to_owned() } else { String::new() },
        period_s: plan.period_ns as f64 / 1e9,
        noise_share,
        marks: marks
            .filter(|b| b.tick < controller.ticks + controller.unseen)
            .map(|b| (b.tick, format!("joint {} blocked", b.joint)))
            .collect(),
        first_reach: reach(&controller.first_switch),
        last_reach: reach(&controller.last_switch),
        windows: controller.windows,
    }
}

fn reach(arm: &ArmTable, switch: &[Snapshot]) -> Option<Reach> {
    let first = switch.first()?;
    let joints = arm.lengths.len();
    Some(Reach {
        from: first.tick,
        target: [f64::from(first.inputs[0]), f64::from(first.inputs[1])],
        postures: switch.iter().map(|s| posture(arm, &s.inputs[2..2 + joints])).collect(),
    })
}

/// A number with its thousands set apart.
pub(super) fn thousands(n: u64) -> String {
    let digits = n.to_string();
    let mut text = String::new();
    for (i, digit) in digits.chars().enumerate() {
        if i > 0 && (digits.len() - i).is_multiple_of(3) {
            text.push(',');
        }
        text.push(digit);
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    fn window(from: u64, loss: f64, end_error: Option<f64>) -> Window {
        Window {
            from,
            ticks: 10,
            loss,
            mean_squared_error: Some(loss),
            end_error,
            ends: u64::from(end_error.is_some()),
        }
    }

    #[test]
    fn the_ends_of_a_run_are_its_first_and_last_twentieth() {
        let windows: Vec<Window> = (0..40).map(|i| window(i * 10, i as f64, Some(i as f64))).collect();
        let [first, last] = ends(&windows).unwrap();
        assert_eq!((first.from, first.ticks, first.loss, first.ends), (0, 20, 0.5, 2));
        assert_eq!((last.from, last.ticks, last.loss), (380, 20, 38.5));
        let [first, last] = ends(&windows[..1]).unwrap();
        assert_eq!(first, last);
        assert_eq!(ends(&[]), None);
    }

    #[test]
    fn windows_without_an_end_do_not_dilute_those_with_one() {
        let both = together(&window(0, 1.0, None), &window(10, 3.0, Some(0.5)));
        assert_eq!((both.loss, both.end_error, both.ends), (2.0, Some(0.5), 1));
    }

    #[test]
    fn thousands_are_set_apart() {
        assert_eq!([0, 999, 1000, 1_234_567].map(thousands), ["0", "999", "1,000", "1,234,567"]);
    }
}
