//! The progress of a run or a study: ticks, rate, loss and, in real time, missed and lost samples, on a
//! progress line.

use super::Launch;
use super::folder::RunFolder;
use super::progress_line::ProgressLine;
use crate::channel::RunServices;
use crate::clock::monotonic_ns;
use crate::process::print_error_line;
use crate::runtime::Mode;
use crate::scenario::limits::ENDLESS;
use crate::text::thousands;
use crate::wire::Role;

/// How often the line is redrawn, ns.
const REDRAW_NS: u64 = 200_000_000;

/// The progress line of a run.
#[derive(Debug)]
pub(crate) struct RunProgress {
    line: ProgressLine,
    name: String,
    ticks: u64,
    realtime: bool,
    /// When the line was last drawn, ns, and the ticks done by then; zero before the first time.
    last: (u64, u64),
    /// The learner's total computing time by then, ns.
    learner_ns: u64,
}

impl RunProgress {
    /// The progress of a run in processes of its own. Prints at once which processes the user has to start by hand.
    pub fn new(launch: &Launch, folder: &RunFolder) -> Self {
        for role in &launch.by_hand {
            let program = match role {
                Role::Plant => launch.plan.scenario.plant.program.as_str(),
                Role::Controller => launch.plan.scenario.controller.program.as_str(),
                Role::Logger => crate::scenario::programs::LOGGER,
            };
            print_error_line(&format!("waiting for the {}: {program} --run {}", role.name(), folder.path().display()));
        }
        let scenario = &launch.plan.scenario;
        Self { realtime: launch.mode == Mode::Realtime, ..Self::study(&scenario.name, scenario.ticks, launch.progress) }
    }

    /// The progress of a run or a study in this process.
    pub fn study(name: &str, ticks: u64, wanted: bool) -> Self {
        let line = ProgressLine::new(wanted);
        Self { line, name: name.to_owned(), ticks, realtime: false, last: (0, 0), learner_ns: 0 }
    }

    /// Draws the line from the status boards, if it is due.
    pub fn show(&mut self, services: &RunServices) {
        if !self.due() {
            return;
        }
        let (plant, controller) = (services.status(Role::Plant), services.status(Role::Controller));
        let timing = if self.realtime {
            let (share, lost) = (self.learner_share(controller.learner_ns), services.status(Role::Logger).lost);
            format!("  learner {share:.0} %  missed {}  lost {lost}", plant.missed)
        } else {
            String::new()
        };
        self.draw(plant.ticks, controller.loss, controller.end_error, &timing);
        self.learner_ns = controller.learner_ns;
    }

    /// Draws the line from the tick, loss and end error of a run in this process, if it is due.
    pub fn show_study(&mut self, tick: u64, (loss, end_error): (f32, f32)) {
        if self.due() {
            self.draw(tick, loss, end_error, "");
        }
    }

    /// The learner's share of the time since the line was last drawn, %.
    fn learner_share(&self, learner_ns: u64) -> f64 {
        match self.last {
            (0, _) => 0.0,
            (then, _) => {
                100.0 * learner_ns.saturating_sub(self.learner_ns) as f64 / (monotonic_ns() - then).max(1) as f64
            }
        }
    }

    fn due(&self) -> bool {
        self.line.enabled() && monotonic_ns() - self.last.0 >= REDRAW_NS
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
        self.line.show(&format!(
            "{}  {}{} ticks  {} ticks/s{}{}{timing}",
            self.name,
            thousands(tick),
            if self.ticks == ENDLESS { String::new() } else { format!(" of {}", thousands(self.ticks)) },
            thousands(rate as u64),
            value("loss", loss, ""),
            value("end error", end_error, " m"),
        ));
        self.last = (now, tick);
    }

    /// Erases the line.
    pub fn clear(&mut self) {
        self.line.clear();
    }
}
