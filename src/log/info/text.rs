//! A log at a glance, for people.

use std::fmt::Write as _;

use super::{ChannelInfo, LogInfo, LogState};
use crate::log::GAP_TOPIC;

impl LogInfo {
    /// The same for people.
    pub fn to_text(&self) -> String {
        let mut text = String::new();
        let or = |value: Option<u64>| value.map_or("-".to_owned(), |value| value.to_string());
        let mut row = |key: &str, value: String| {
            let _ = writeln!(text, "{key:<9}{value}");
        };
        row("log", format!("{} ({} bytes)", self.log.display(), self.bytes));
        let several = self.segments.len() > 1;
        row(
            "state",
            if several { format!("{} segments", self.segments.len()) } else { state(self.state, self.torn_at) },
        );
        if let Some((tick, why)) = &self.missing_from {
            row("missing", format!("from tick {tick} on: {why}"));
        }
        row("run", format!("{}, {}, seed {}", self.scenario, self.mode, or(self.seed)));
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
        row(
            "ticks",
            format!("{} planned, {ticks}; {} s of {} s each", or(self.planned_ticks), self.duration_s, self.period_s),
        );
        if self.every > 1 {
            row("thinned", format!("every {}th tick is written", self.every));
        }
        if let Some((hash, tick)) = &self.weights_hash {
            row("weights", format!("{hash} at tick {tick}"));
        }
        let _ = writeln!(
            text,
            "\n{:<16}{:>12}{:>12}{:>12}{:>10}{:>10}{:>10}",
            "", "messages", "first tick", "last tick", "a second", "lost", "found"
        );
        for c in &self.channels {
            let rate = c.per_second.map_or("-".to_owned(), |rate| format!("{rate:.2}"));
            let [first, last, found] = [c.first_tick, c.last_tick, c.lost_found].map(or);
            let _ = writeln!(
                text,
                "{:<16}{:>12}{first:>12}{last:>12}{rate:>10}{:>10}{found:>10}",
                c.topic, c.messages, c.lost_stated
            );
        }
        let _ = writeln!(text, "{GAP_TOPIC:<16}{:>12}", self.gaps);
        if !self.flags.is_empty() {
            let flags: Vec<_> = self.flags.iter().map(|(name, n)| format!("{name} {n}")).collect();
            let _ = writeln!(text, "\nflags    {}", flags.join("  "));
        }
        if several {
            self.list_segments(&mut text);
        }
        for c in &self.channels {
            if let Some(line) = returns(c) {
                let _ = writeln!(text, "\n{line}");
            }
        }
        self.list_durations(&mut text);
        for c in self.channels.iter().filter(|c| !c.agrees) {
            let _ =
                writeln!(text, "\n{}: what the log states to be lost is not what its sequence numbers say", c.topic);
        }
        text
    }

    fn list_segments(&self, text: &mut String) {
        let _ = writeln!(
            text,
            "\n{:<16}{:>12}{:>12}{:>20}  state",
            "segment", "first tick", "last tick", "missing before it"
        );
        for s in &self.segments {
            let name = s.log.file_name().map_or_else(String::new, |name| name.to_string_lossy().into_owned());
            let [first, last] = [s.first_tick, s.last_tick].map(|t| t.map_or("-".to_owned(), |t| t.to_string()));
            let missing = s.missing_before.map(|n| n.to_string()).join(" ");
            let state = match (s.state, s.torn_at) {
                // How it is made whole, is said once.
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
            let _ = writeln!(text, "{:<23} from the samples in the log, which did not come to its end", "");
        }
    }
}

fn state(state: LogState, torn_at: Option<u64>) -> String {
    match (state, torn_at) {
        (LogState::Torn, Some(at)) => format!("torn at byte {at}: `tectum log repair` makes it whole"),
        (LogState::Growing, Some(at)) => format!("{at} bytes so far; its logger still writes it"),
        (LogState::Repaired, _) => "whole, repaired".to_owned(),
        _ => "whole".to_owned(),
    }
}

/// What a channel's writers did, if there were several.
fn returns(channel: &ChannelInfo) -> Option<String> {
    let (starts, twice) = (&channel.incarnations, channel.duplicates);
    if starts.len() < 2 && twice == 0 {
        return None;
    }
    let starts: Vec<String> = starts.iter().map(|(n, tick)| format!("{n} from tick {tick} on")).collect();
    Some(format!("{}: incarnations {}; {twice} came twice", channel.topic, starts.join(", ")))
}
