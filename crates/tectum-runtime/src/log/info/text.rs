//! The summary of a log as text.

use std::fmt::Write as _;

use super::{ChannelInfo, LogInfo, LogState};
use crate::log::GAP_TOPIC;

impl LogInfo {
    /// The summary as text.
    pub fn to_text(&self) -> String {
        let mut text = String::new();
        self.list_facts(&mut text);
        self.list_channels(&mut text);
        if !self.flags.is_empty() {
            let flags: Vec<_> = self.flags.iter().map(|(name, n)| format!("{name} {n}")).collect();
            let _ = writeln!(text, "\nflags    {}", flags.join("  "));
        }
        if !self.warnings.is_empty() {
            text.push('\n');
        }
        for (name, warning) in &self.warnings {
            let _ = writeln!(text, "warning  {name}: {warning}");
        }
        if self.segments.len() > 1 {
            self.list_segments(&mut text);
        }
        for line in self.channels.iter().filter_map(restarts) {
            let _ = writeln!(text, "\n{line}");
        }
        self.list_durations(&mut text);
        for c in self.channels.iter().filter(|c| !c.agrees) {
            let _ =
                writeln!(text, "\n{}: what the log states to be lost is not what its sequence numbers say", c.topic);
        }
        text
    }

    fn list_facts(&self, text: &mut String) {
        let mut row = |key: &str, value: String| {
            let _ = writeln!(text, "{key:<9}{value}");
        };
        row("log", format!("{} ({} bytes)", self.log.display(), self.bytes));
        let state = match self.segments.len() {
            several @ 2.. => format!("{several} segments"),
            _ => state(self.state, self.torn_at),
        };
        row("state", state);
        if let Some((tick, why)) = &self.missing_from {
            row("missing", format!("from tick {tick} on: {why}"));
        }
        row("run", format!("{}, {}, seed {}", self.scenario, self.mode, or_dash(self.seed)));
        if let Some(started) = &self.started {
            row("started", started.clone());
        }
        row("build", self.build.clone());
        let known = ["host", "kernel", "processor", "cores"].map(|key| self.machine.get(key).map(String::as_str));
        if let [Some(host), Some(kernel), Some(processor), Some(cores)] = known {
            row("machine", format!("{host}, {kernel}, {processor}, {cores} cores"));
        }
        let ticks = match self.complete {
            Some(true) => "all of them",
            Some(false) => "the run ended before",
            None => "the log does not say whether the run came to its end",
        };
        let planned = or_dash(self.planned_ticks);
        row("ticks", format!("{planned} planned, {ticks}; {} s of {} s each", self.duration_s, self.period_s));
        if self.every > 1 {
            row("thinned", format!("every {}th tick is written", self.every));
        }
        if let Some((hash, tick)) = &self.weights_hash {
            row("weights", format!("{hash} at tick {tick}"));
        }
    }

    fn list_channels(&self, text: &mut String) {
        let _ = writeln!(
            text,
            "\n{:<16}{:>12}{:>12}{:>12}{:>10}{:>10}{:>10}",
            "", "messages", "first tick", "last tick", "a second", "lost", "found"
        );
        for c in &self.channels {
            let rate = c.per_second.map_or("-".to_owned(), |rate| format!("{rate:.2}"));
            let [first, last, found] = [c.first_tick, c.last_tick, c.lost_found].map(or_dash);
            let _ = writeln!(
                text,
                "{:<16}{:>12}{first:>12}{last:>12}{rate:>10}{:>10}{found:>10}",
                c.topic, c.messages, c.lost_stated
            );
        }
        let _ = writeln!(text, "{GAP_TOPIC:<16}{:>12}", self.gaps);
    }

    fn list_segments(&self, text: &mut String) {
        let _ = writeln!(
            text,
            "\n{:<16}{:>12}{:>12}{:>20}  state",
            "segment", "first tick", "last tick", "missing before it"
        );
        for s in &self.segments {
            let name = s.log.file_name().map_or_else(String::new, |name| name.to_string_lossy().into_owned());
            let [first, last] = [s.first_tick, s.last_tick].map(or_dash);
            let missing = s.missing_before.map(|n| n.to_string()).join(" ");
            let state = match (s.state, s.torn_at) {
                // The remedy is printed once, below.
                (LogState::Torn, Some(at)) => format!("torn at byte {at}"),
                (other, at) => state(other, at),
            };
            let _ = writeln!(text, "{name:<16}{first:>12}{last:>12}{missing:>20}  {state}");
        }
        if self.segments.iter().any(|s| s.state == LogState::Torn) {
            let _ = writeln!(text, "`tectum log repair` makes what is torn whole");
        }
    }

    fn list_durations(&self, text: &mut String) {
        let all = [
            ("wake-up lateness", &self.wake_up_lateness_us),
            ("observation to command", &self.observation_to_command_us),
            ("command to applied", &self.command_to_applied_us),
        ];
        for (i, (label, p)) in all.into_iter().filter_map(|(label, p)| Some((label, (*p)?))).enumerate() {
            let _ = write!(text, "{}", if i == 0 { "\n" } else { "" });
            let _ = writeln!(
                text,
                "{label:<23} p50 {:.0} us  p99 {:.0} us  p99.9 {:.0} us  max {:.0} us",
                p.p50, p.p99, p.p999, p.max
            );
        }
        if self.recounted {
            let _ = writeln!(text, "{:<23} recounted from the samples in the log, which has no end", "");
        }
    }
}

/// The number, or a dash if there is none.
fn or_dash(value: Option<u64>) -> String {
    value.map_or_else(|| "-".to_owned(), |value| value.to_string())
}

fn state(state: LogState, torn_at: Option<u64>) -> String {
    match (state, torn_at) {
        (LogState::Torn, Some(at)) => format!("torn at byte {at}: `tectum log repair` makes it whole"),
        (LogState::Growing, Some(at)) => format!("{at} bytes so far; its logger still writes it"),
        (LogState::Repaired, _) => "whole, repaired".to_owned(),
        _ => "whole".to_owned(),
    }
}

/// The incarnations of a channel's writer and its duplicates, if there are any.
fn restarts(channel: &ChannelInfo) -> Option<String> {
    let (starts, duplicates) = (&channel.incarnations, channel.duplicates);
    if starts.len() < 2 && duplicates == 0 {
        return None;
    }
    let starts: Vec<String> = starts.iter().map(|(n, tick)| format!("{n} from tick {tick} on")).collect();
    Some(format!("{}: incarnations {}; {duplicates} came twice", channel.topic, starts.join(", ")))
}
