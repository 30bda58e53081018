//! One line that shows how the run goes, on standard error, and only when that is a terminal.

use std::io::{IsTerminal as _, Write as _};

use super::Launch;
use super::folder::RunFolder;
use crate::channel::RunServices;
use crate::clock::monotonic_ns;
use crate::process::say;
use crate::programs;
use crate::report::thousands;
use crate::runtime::Mode;
use crate::wire::Role;

/// How often the line is drawn anew, ns.
const EVERY_NS: u64 = 200_000_000;

/// The progress line.
#[derive(Debug)]
pub(crate) struct RunProgress {
    shown: bool,
    name: String,
    ticks: u64,
    realtime: bool,
    /// When it was drawn last, and the ticks then.
    last: (u64, u64),
    /// What the learner had taken then, ns.
    learner_ns: u64,
}

impl RunProgress {
    /// A line for the run, silent unless it is wanted and standard error is a terminal. Says at once which processes are
    /// waited for, because those must be started by somebody.
    pub fn new(launch: &Launch, folder: &RunFolder) -> Self {
        for role in &launch.by_hand {
            let program = match role {
                Role::Plant => launch.plan.scenario.plant.program.as_str(),
                Role::Controller => programs::CONTROLLER,
                Role::Logger => programs::LOGGER,
            };
            say(&format!("waiting for the {}: {program} --run {}", role.name(), folder.path().display()));
        }
        let mut progress = Self::silent(&launch.plan.scenario.name, launch.plan.scenario.ticks);
        progress.shown = launch.progress && std::io::stderr().is_terminal();
        progress.realtime = launch.mode == Mode::Realtime;
        progress
    }

    fn silent(name: &str, ticks: u64) -> Self {
        Self { shown: false, name: name.to_owned(), ticks, realtime: false, last: (0, 0), learner_ns: 0 }
    }

    /// A line for a run in one process.
    pub fn study(name: &str, ticks: u64, wanted: bool) -> Self {
        Self { shown: wanted && std::io::stderr().is_terminal(), ..Self::silent(name, ticks) }
    }

    /// Draws the line from the boards, if it is time.
    pub fn show(&mut self, services: &RunServices) {
        if self.shown && self.due() {
            let (plant, controller) = (services.status(Role::Plant), services.status(Role::Controller));
            let timing = match (self.realtime, plant.missed, services.status(Role::Logger).lost) {
                (true, missed, lost) => {
                    format!(
                        "  learner {:.0} %  missed {missed}  lost {lost}",
                        self.learner_share(controller.learner_ns)
                    )
                }
                _ => String::new(),
            };
            self.draw(plant.ticks, controller.loss, controller.end_error, &timing);
            self.learner_ns = controller.learner_ns;
        }
    }

    /// Draws the line from what is known in one process, if it is time.
    pub fn show_study(&mut self, tick: u64, (loss, end_error): (f32, f32)) {
        if self.shown && self.due() {
            self.draw(tick, loss, end_error, "");
        }
    }

    /// The learner's share of the time since the line was drawn last, %.
    fn learner_share(&self, learner_ns: u64) -> f64 {
        match self.last {
            (0, _) => 0.0,
            (then, _) => {
                100.0 * learner_ns.saturating_sub(self.learner_ns) as f64 / (monotonic_ns() - then).max(1) as f64
            }
        }
    }

    fn due(&self) -> bool {
        monotonic_ns() - self.last.0 >= EVERY_NS
    }

    fn draw(&mut self, tick: u64, loss: f32, end_error: f32, timing: &str) {
        let now = monotonic_ns();
        let rate = match self.last {
            (0, _) => 0.0,
            (then, ticks) => tick.saturating_sub(ticks) as f64 * 1e9 / (now - then) as f64,
        };
        let value = |label: &str, x: f32, unit: &str| {
            if x.is_finite() { format!("  {label} {x:.3}{unit}") } else { String::new() }
        };
        let mut stderr = std::io::stderr().lock();
        // A progress line that cannot be drawn is no reason to end a run.
        let _ = write!(
            stderr,
            "\r{}  {} of {} ticks  {} ticks/s{}{}{timing}\x1b[K",
            self.name,
            thousands(tick),
            thousands(self.ticks),
            thousands(rate as u64),
            value("loss", loss, ""),
            value("end error", end_error, " m"),
        );
        let _ = stderr.flush();
        self.last = (now, tick);
    }

    /// Takes the line away.
    pub fn clear(&self) {
        if self.shown {
            let _ = std::io::stderr().write_all(b"\r\x1b[K");
        }
    }
}
