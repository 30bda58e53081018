//! A run's numbers in Prometheus' text format, version 0.0.4: names with base units, counters that end with `_total`.

use std::fmt::Write as _;

use crate::run_view::ROLES;
use crate::{RunView, WatchedState};

/// Shares of the wake-up lateness that are given.
const QUANTILES: [f64; 4] = [0.5, 0.9, 0.99, 1.0];

/// The numbers of a run; of none, only that there is none. What only samples tell (lateness, loss) is of those that the
/// watcher took.
pub fn metrics(view: Option<&RunView>) -> String {
    let mut text = MetricsText::default();
    let alive = view.is_some_and(|view| view.ended.is_none());
    text.family("tectum_run_alive", "gauge", "Whether the watched run is alive.");
    text.number("", u64::from(alive));
    let Some(view) = view else { return text.0 };
    add_facts(&mut text, view);
    add_counts(&mut text, view);
    add_processes(&mut text, view);
    add_samples(&mut text, view);
    text.0
}

fn add_facts(text: &mut MetricsText, view: &RunView) {
    let facts = &view.facts;
    let mode = if facts.realtime { "realtime" } else { "lockstep" };
    let labels = [("run", facts.name.as_str()), ("scenario", &facts.scenario), ("mode", mode)];
    let labels = labels.map(|(name, value)| format!("{name}=\"{}\"", escaped(value))).join(",");
    text.family("tectum_run_info", "gauge", "The watched run.");
    text.number(&format!("{labels},seed=\"{}\"", facts.seed), 1);
    text.family("tectum_tick_period_seconds", "gauge", "Period of a tick, on the run's own time.");
    text.value("", "", facts.period_ns as f64 / 1e9);
}

fn add_counts(text: &mut MetricsText, view: &RunView) {
    let [plant, controller, logger] = &view.processes;
    for (name, help, count) in [
        ("tectum_missed_ticks_total", "Ticks whose command had not come in time.", plant.missed),
        ("tectum_late_commands_total", "Commands that came after their tick.", plant.late),
        ("tectum_skipped_ticks_total", "Ticks that the plant passed over.", plant.lost),
        ("tectum_unseen_observations_total", "Observations that the controller did not receive.", controller.lost),
        ("tectum_lost_samples_total", "Samples that the logger lost.", logger.lost),
    ] {
        text.family(name, "counter", help);
        text.number("", count);
    }
}

fn add_processes(text: &mut MetricsText, view: &RunView) {
    let processes = || ROLES.into_iter().zip(&view.processes);
    let label = |role: &str| format!("process=\"{role}\"");
    text.family("tectum_ticks_total", "counter", "Ticks that the process has done.");
    processes().for_each(|(role, process)| text.number(&label(role), process.ticks));
    text.family("tectum_process_restarts_total", "counter", "How often the process was started again.");
    processes().for_each(|(role, process)| text.number(&label(role), process.restarts.into()));
    text.family("tectum_process_up", "gauge", "Whether the process runs its loop.");
    let up = |state: WatchedState| u64::from(state == WatchedState::Running && view.ended.is_none());
    processes().for_each(|(role, process)| text.number(&label(role), up(process.state)));
}

fn add_samples(text: &mut MetricsText, view: &RunView) {
    if let Some(quantiles) = view.wake_up.quantiles(QUANTILES) {
        let help = "From a tick's scheduled instant to its sensing; quantiles of the last 1000 ticks.";
        text.family("tectum_wake_up_lateness_seconds", "summary", help);
        for (share, us) in QUANTILES.into_iter().zip(quantiles) {
            text.value("", &format!("quantile=\"{share}\""), us / 1e6);
        }
        text.value("_sum", "", view.wake_up.sum_us() / 1e6);
        text.value("_count", "", view.wake_up.count() as f64);
    }
    if let Some(loss) = view.recent_loss() {
        text.family("tectum_loss", "gauge", "Mean loss of the last 100 ticks: the reward with its sign turned.");
        text.value("", "", loss);
    }
}

/// The text, and the family that is being written.
#[derive(Default)]
struct MetricsText(String, &'static str);

impl MetricsText {
    fn family(&mut self, name: &'static str, kind: &str, help: &str) {
        let _ = write!(self.0, "# HELP {name} {help}\n# TYPE {name} {kind}\n");
        self.1 = name;
    }

    /// A whole number, with all its digits.
    fn number(&mut self, labels: &str, number: u64) {
        self.sample("", labels, &number.to_string());
    }

    fn value(&mut self, suffix: &str, labels: &str, value: f64) {
        self.sample(suffix, labels, &format!("{value:e}"));
    }

    fn sample(&mut self, suffix: &str, labels: &str, value: &str) {
        let labels = if labels.is_empty() { String::new() } else { format!("{{{labels}}}") };
        let _ = writeln!(self.0, "{}{suffix}{labels} {value}", self.1);
    }
}

/// A label's value.
fn escaped(text: &str) -> String {
    text.replace('\\', "\\\\").replace('"', "\\\"").replace('\n', "\\n")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::run_view::tests::{facts, take_tick};
    use crate::{RunFacts, SeenProcess};

    #[test]
    fn a_run_is_told_with_units_and_all_digits() {
        assert_eq!(metrics(None).lines().last(), Some("tectum_run_alive 0"));
        let mut view = RunView::new(RunFacts { name: "a \"b\\".to_owned(), ..facts() });
        (0..200).for_each(|tick| take_tick(&mut view, tick));
        let process = SeenProcess { state: WatchedState::Running, ticks: (1 << 53) + 1, ..SeenProcess::default() };
        view.boards([process, SeenProcess { restarts: 3, ..process }, process], 1.0);
        let text = metrics(Some(&view));
        for line in [
            "tectum_run_alive 1",
            "tectum_run_info{run=\"a \\\"b\\\\\",scenario=\"arm\",mode=\"realtime\",seed=\"1\"} 1",
            "tectum_tick_period_seconds 5e-2",
            "tectum_ticks_total{process=\"plant\"} 9007199254740993",
            "tectum_process_restarts_total{process=\"controller\"} 3",
            "tectum_process_up{process=\"logger\"} 1",
            "# TYPE tectum_wake_up_lateness_seconds summary",
            "tectum_wake_up_lateness_seconds_count 2e2",
        ] {
            assert!(text.lines().any(|found| found == line), "{line}: {text}");
        }
        let value = |name: &str| {
            let line = text.lines().find(|line| line.starts_with(name)).unwrap();
            line.rsplit_once(' ').unwrap().1.parse::<f64>().unwrap()
        };
        let median = value("tectum_wake_up_lateness_seconds{quantile=\"0.5\"}");
        assert!((median - 60e-6).abs() < 1e-9, "{median}");
        assert!((value("tectum_wake_up_lateness_seconds_sum") - 200.0 * 60e-6).abs() < 1e-9);
        // The losses of ticks 99 to 198, from the observations after them.
        let mean = (100..200).map(|tick| 1.0 / (1.0 + f64::from(tick) / 50.0)).sum::<f64>() / 100.0;
        assert!((value("tectum_loss ") - mean).abs() < 1e-6);
        view.end("the run is over");
        let text = metrics(Some(&view));
        assert!(text.contains("tectum_run_alive 0\n") && text.contains("up{process=\"plant\"} 0\n"), "{text}");
    }
}
