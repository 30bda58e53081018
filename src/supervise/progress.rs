//! The progress of a run or a study: per cent, ticks, rate, time left, loss and, in real time, missed and lost samples,
//! on a progress line. A run in processes of its own whose standard error is no terminal prints such a line every ten
//! seconds instead, so that whoever reads its output later, or follows it from afar, sees that it gets on.

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
use tectum_view::duration;

/// How often the line is redrawn, ns.
const REDRAW_NS: u64 = 200_000_000;
/// How often a line is printed where there is no terminal, ns.
const PRINT_NS: u64 = 10_000_000_000;

/// The progress line of a run.
#[derive(Debug)]
pub(crate) struct RunProgress {
    line: ProgressLine,
    name: String,
    ticks: u64,
    realtime: bool,
    /// Whether lines are printed, one below the other, because there is no terminal.
    printed: bool,
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
        let progress = Self::study(&scenario.name, scenario.ticks, launch.progress);
        let printed = launch.progress && !progress.line.enabled();
        // The first line comes after the first ten seconds.
        let last = if printed { (monotonic_ns(), 0) } else { (0, 0) };
        Self { realtime: launch.mode == Mode::Realtime, printed, last, ..progress }
    }

    /// The progress of a run or a study in this process.
    pub fn study(name: &str, ticks: u64, wanted: bool) -> Self {
        let line = ProgressLine::new(wanted);
        Self { line, name: name.to_owned(), ticks, realtime: false, printed: false, last: (0, 0), learner_ns: 0 }
    }

    /// Whether a line is drawn again and again.
    pub fn follows(&self) -> bool {
        self.line.enabled()
    }

    /// Draws or prints the line from the status boards, if it is due.
    pub fn show(&mut self, services: &RunServices) {
        if !self.due() {
            return;
        }
        let (plant, controller) = (services.status(Role::Plant), services.status(Role::Controller));
        let timing = if self.realtime {
            let (share, lost) = (self.learner_share(controller.learner_ns), services.status(Role::Logger).lost);
            format!("learner {share:.0} %  missed {}  lost {lost}", plant.missed)
        } else {
            String::new()
        };
        self.draw(plant.ticks, controller.loss, controller.end_error, timing);
        self.learner_ns = controller.learner_ns;
    }

    /// Draws the line from the tick, loss and end error of a run in this process, if it is due.
    pub fn show_study(&mut self, tick: u64, (loss, end_error): (f32, f32)) {
        if self.due() {
            self.draw(tick, loss, end_error, String::new());
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
        let every = if self.printed { PRINT_NS } else { REDRAW_NS };
        (self.line.enabled() || self.printed) && monotonic_ns() - self.last.0 >= every
    }

    fn draw(&mut self, tick: u64, loss: f32, end_error: f32, timing: String) {
        let now = monotonic_ns();
        let rate = match self.last {
            (0, _) => 0.0,
            (then, ticks) => tick.saturating_sub(ticks) as f64 * 1e9 / (now - then) as f64,
        };
        let value = |label: &str, x: f32, unit: &str| {
            if x.is_finite() { format!("{label} {x:.3}{unit}") } else { String::new() }
        };
        let left = self.ticks.saturating_sub(tick) as f64 / rate;
        // A run without an end has no share of it.
        let planned = self.ticks != ENDLESS;
        let parts = [
            self.name.clone(),
            if planned { format!("{} %", 100 * tick / self.ticks.max(1)) } else { String::new() },
            if planned && rate > 0.0 { format!("{} left", duration(left)) } else { String::new() },
            if planned {
                format!("{} of {} ticks", thousands(tick), thousands(self.ticks))
            } else {
                format!("{} ticks", thousands(tick))
            },
            format!("{} ticks/s", thousands(rate as u64)),
            value("loss", loss, ""),
            value("end error", end_error, " m"),
            timing,
        ];
        if self.printed {
            let shown: Vec<&str> = parts.iter().map(String::as_str).filter(|part| !part.is_empty()).collect();
            print_error_line(&format!("tectum: {}", shown.join("  ")));
        } else {
            self.line.show_parts(&parts);
        }
        self.last = (now, tick);
    }

    /// Erases the line.
    pub fn clear(&mut self) {
        self.line.clear();
    }
}
