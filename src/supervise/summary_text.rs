//! The summary of a run as text for people.

use std::fmt::Write as _;

use super::summary::{ProcessRealtime, RunOutcome, RunSummary};
use crate::reference::TARGETS;
use crate::report::{self, RunHistory};
use crate::text::thousands;
use crate::wire::Role;

impl RunSummary {
    /// The short report for people.
    pub fn to_text(&self) -> String {
        let mut text = self.headline();
        if let Some(learning) = self.learning() {
            let _ = write!(text, "\n{learning}\n");
        }
        self.write_counts(&mut text);
        self.write_warnings(&mut text);
        self.write_restarts(&mut text);
        self.write_timing(&mut text);
        self.write_files(&mut text);
        text
    }

    /// Which run it was, how it ended and how long it took.
    fn headline(&self) -> String {
        let planned = self.ticks_planned.map_or(String::new(), |ticks| format!(" of {}", thousands(ticks)));
        let how = match self.ended {
            RunOutcome::Complete => String::new(),
            RunOutcome::Signal(2) => format!("{planned} (interrupted)"),
            RunOutcome::Signal(number) => format!("{planned} (ended by signal {number})"),
            RunOutcome::Failed => format!("{planned} (failed)"),
        };
        let began = self
            .started_from
            .as_ref()
            .map_or(String::new(), |start| format!(", from {} at tick {}", start.source, thousands(start.tick)));
        let frozen = if self.frozen { ", frozen" } else { "" };
        let from = self.resumed_at.map_or(String::new(), |tick| format!(", the last from {} on,", thousands(tick)));
        format!(
            "{}, {}, seed {}{began}{frozen}: {} ticks{how}{from} in {:.1} s, {} ticks/s\n",
            self.scenario,
            self.mode.name(),
            self.seed,
            thousands(self.ticks),
            self.seconds,
            thousands(self.ticks_per_second.round() as u64),
        )
    }

    /// How far the learner got: the table and the sentence, or the means of the first and the last window where the
    /// plant has no targets.
    fn learning(&self) -> Option<String> {
        if !self.progress.is_empty() {
            let table = report::progress_table(&self.progress, TARGETS);
            let sentence = self.reached_text.as_ref().map_or(String::new(), |text| format!("\n{text}.\n"));
            return Some(table + &sentence);
        }
        let (history, windows) = (self.history.as_ref()?, self.windows.as_ref()?);
        Some(report::table(&RunHistory { windows: windows.to_vec(), ..history.clone() }))
    }

    /// What was missed, lost and limited, and the faults that were asked for. Counts of 0 that are usually 0
    /// are left out.
    fn write_counts(&self, text: &mut String) {
        let known = |count: Option<u64>| count.map_or_else(|| "unknown".to_owned(), |n| n.to_string());
        let (lost, limited) = (known(self.lost), known(self.clamped));
        let _ = writeln!(text, "missed {}  late {}  lost {lost}  limited {limited}", self.missed, self.late);
        let mut row = |label: &str, counts: &[(&str, Option<u64>)]| {
            let happened = counts.iter().filter_map(|(what, n)| Some((what, n.filter(|n| *n > 0)?)));
            let happened: Vec<_> = happened.map(|(what, n)| format!("{what} {n}")).collect();
            if !happened.is_empty() {
                let _ = writeln!(text, "{label:<23} {}", happened.join("  "));
            }
        };
        row("missed", &[("with a command ahead", self.ahead)]);
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
        let reasons: Vec<_> = self.without_torque.iter().map(|(why, &n)| (why.as_str(), Some(n))).collect();
        row("ticks without torque", &reasons);
        let learner: Vec<_> = self.learner.iter().map(|(what, &n)| (what.as_str(), Some(n))).collect();
        row("learner", &learner);
        for fault in &self.faults {
            let _ = writeln!(text, "{:<23} {fault}", "fault, on purpose");
        }
    }

    /// What did not go well during the run. The scenario's warnings were printed when it began.
    fn write_warnings(&self, text: &mut String) {
        for warning in self.warnings.iter().filter(|warning| warning.name != "settings") {
            let _ = writeln!(text, "{:<23} {}: {}", "warning", warning.name, warning.text);
        }
    }

    fn write_restarts(&self, text: &mut String) {
        for role in Role::ALL {
            let incidents: Vec<_> = self.restarts.iter().filter(|incident| incident.process == role.name()).collect();
            if let Some(last) = incidents.last() {
                let times = if incidents.len() == 1 { "once".to_owned() } else { format!("{} times", incidents.len()) };
                let _ =
                    writeln!(text, "{:<23} {times}; at last {}", format!("started again, {}", role.name()), last.what);
            }
        }
    }

    /// Real time: percentiles, and what each process asked of the operating system.
    fn write_timing(&self, text: &mut String) {
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
    }

    /// The weights' hash, and where log and figure lie.
    fn write_files(&self, text: &mut String) {
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
            let removed = match self.log_removed_segments {
                0 => String::new(),
                n => format!(", the oldest {} removed at the limit", thousands(n)),
            };
            let megabytes = |bytes: u64| format!("{:.1} MB", bytes as f64 / 1e6);
            let packed = self.log_unpacked_bytes.map_or(String::new(), |n| format!(", packed from {}", megabytes(n)));
            let (log, size) = (log.display(), megabytes(self.log_bytes));
            let _ = writeln!(text, "log     {log} ({size}{packed}{segments}{removed}{every})");
        }
        if let Some(figure) = &self.figure {
            let _ = writeln!(text, "figure  {}", figure.display());
        }
    }
}
