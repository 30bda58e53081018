//! What a log is: of which run, whole or torn, how much of what, and what it lacks.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::fs::File;
use std::path::{Path, PathBuf};

use serde::Serialize;

use super::{Account, CHANNELS, GAP_TOPIC, LogError, LogReader, Record, TOTALS_METADATA, in_use};
use crate::log::header::flag_words;
use crate::wire::{Command, Observation, flag};

/// How a log ends.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum State {
    /// At the end that its logger wrote, and the checksums fit.
    Whole,
    /// Likewise, but it was torn once and made whole by [`repair`](super::repair()).
    Repaired,
    /// Cut off: its logger or its machine died.
    Torn,
    /// Nowhere yet: its logger still writes it.
    Growing,
}

/// A channel of a log.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ChannelInfo {
    /// Its topic.
    pub topic: String,
    /// Messages in the log.
    pub messages: u64,
    /// Tick of the first.
    pub first_tick: Option<u64>,
    /// Tick of the last.
    pub last_tick: Option<u64>,
    /// Messages a second of the run's clock.
    pub per_second: Option<f64>,
    /// Samples that the log states to be missing.
    pub lost_stated: u64,
    /// Samples missing by their sequence numbers, and those stated to be missing behind the last; null for a thinned log, in
    /// which sequence numbers cannot tell them from those left out on purpose.
    pub lost_found: Option<u64>,
    /// Samples left out on purpose, so far as the log tells.
    pub thinned: u64,
    /// Statements, sequence numbers and totals say the same.
    pub agrees: bool,
}

/// A log at a glance.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Info {
    /// The file.
    pub log: PathBuf,
    /// Its size, bytes.
    pub bytes: u64,
    /// How it ends.
    pub state: State,
    /// Where the last whole record of a torn log ends, bytes from its start.
    pub torn_at: Option<u64>,
    /// The scenario's name.
    pub scenario: String,
    /// Its seed.
    pub seed: Option<u64>,
    /// Ticks that the run was planned to have.
    pub planned_ticks: Option<u64>,
    /// How ticks followed each other.
    pub mode: String,
    /// Wall time of tick 0; null in lockstep, whose time is the tick's.
    pub started: Option<String>,
    /// The build that wrote it.
    pub build: String,
    /// What is known of the machine.
    pub machine: BTreeMap<String, String>,
    /// The tick's period, s.
    pub period_s: f64,
    /// Every how many ticks are written.
    pub every: u64,
    /// From the start of the first tick in the log to the end of the last one, s of the run's time.
    pub duration_s: f64,
    /// The run came to its planned end; null where the log was cut off before it could say.
    pub complete: Option<bool>,
    /// The last hash of the weights, hexadecimal, and its tick.
    pub weights_hash: Option<(String, u64)>,
    /// Observation, command, learning.
    pub channels: Vec<ChannelInfo>,
    /// Statements of missing samples on the channel `/gap`.
    pub gaps: u64,
    /// What observations and commands in the log are flagged with, and how many are; targets and the first are left out.
    pub flags: BTreeMap<String, u64>,
}

impl Info {
    /// Reads the log at `path` to its end.
    ///
    /// # Errors
    ///
    /// As [`LogReader::open`] and its iterator: a torn log is none, a damaged one is.
    pub fn of(path: &Path) -> Result<Info, LogError> {
        let file = File::open(path).map_err(|e| LogError::read(path, e))?;
        let bytes = file.metadata().map_err(|e| LogError::read(path, e))?.len();
        let growing = in_use(&file);
        let mut info = Self::over(LogReader::over(path, Box::new(file))?, path, bytes)?;
        if growing && info.state == State::Torn {
            info.state = State::Growing;
        }
        Ok(info)
    }

    /// The same from a reader at its beginning.
    ///
    /// # Errors
    ///
    /// As the reader's iterator.
    pub fn over(mut log: LogReader, path: &Path, bytes: u64) -> Result<Info, LogError> {
        let mut account = Account::default();
        let mut weights_hash = None;
        let mut flagged = [0; 32];
        for record in log.by_ref() {
            let record = record?;
            account.take(&record);
            if let Record::Observation(Observation { header, .. }) | Record::Command(Command { header, .. }) = &record {
                let flags = header.flags & !(flag::FIRST | flag::NEW_TARGET);
                (0..32).for_each(|bit| flagged[bit] += u64::from(flags >> bit & 1));
            }
            if let Record::Learning(s) = &record
                && s.header.flags & flag::HASHED != 0
            {
                weights_hash = Some((format!("{:016x}", s.weights_hash), s.header.tick));
            }
        }
        let state = match (log.finished(), log.repaired()) {
            (true, false) => State::Whole,
            (true, true) => State::Repaired,
            (false, _) => State::Torn,
        };
        let text = |key: &str| log.run(key).unwrap_or("unknown").to_owned();
        let number = |key: &str| log.run(key).and_then(|value| value.parse::<u64>().ok());
        let period_ns = number("period_ns").unwrap_or(0);
        let ticks = account.lanes.iter().filter_map(|lane| lane.ticks);
        let span = ticks.reduce(|(a, b), (c, d)| (a.min(c), b.max(d)));
        // Whoever counts the totals of a torn log afterwards has not seen the run's end.
        let counted = log.metadata().get(TOTALS_METADATA).is_some_and(|totals| totals.contains_key("repaired"));
        let machine = log.metadata().get(super::RUN_METADATA);
        let machine = machine
            .into_iter()
            .flatten()
            .filter_map(|(k, v)| Some((k.strip_prefix("machine.")?.to_owned(), v.clone())));
        Ok(Info {
            log: path.to_owned(),
            bytes,
            state,
            torn_at: (state == State::Torn).then(|| log.position()),
            scenario: text("name"),
            seed: number("seed"),
            planned_ticks: number("ticks"),
            mode: text("mode"),
            started: number("wall_at_t0_ns").filter(|&ns| ns > 0).map(utc),
            build: text("build"),
            machine: machine.collect(),
            period_s: period_ns as f64 / 1e9,
            every: log.every(),
            duration_s: span.map_or(0.0, |(first, last)| {
                ((u128::from(last.saturating_sub(first)) + 1) * u128::from(period_ns)) as f64 / 1e9
            }),
            complete: log.totals().filter(|_| !counted).map(|totals| totals.complete),
            weights_hash,
            channels: (0..3).map(|i| channel(&log, &account, i)).collect(),
            gaps: account.gaps,
            flags: (0..32).zip(flagged).filter(|(_, n)| *n > 0).map(|(bit, n)| (flag_words(1 << bit), n)).collect(),
        })
    }

    /// Statements, sequence numbers and totals of every channel say the same.
    pub fn agrees(&self) -> bool {
        self.channels.iter().all(|channel| channel.agrees)
    }

    /// The object of `--json`.
    pub fn to_json(&self) -> String {
        serde_json::to_string_pretty(self).unwrap_or_default()
    }

    /// The same for people.
    pub fn to_text(&self) -> String {
        let mut text = String::new();
        let state = match (self.state, self.torn_at) {
            (State::Torn, Some(at)) => format!("torn at byte {at}: `tectum log repair` makes it whole"),
            (State::Growing, Some(at)) => format!("{at} bytes so far; its logger still writes it"),
            (State::Repaired, _) => "whole, repaired".to_owned(),
            _ => "whole".to_owned(),
        };
        let or = |value: Option<u64>| value.map_or("-".to_owned(), |value| value.to_string());
        let mut row = |key: &str, value: String| {
            let _ = writeln!(text, "{key:<9}{value}");
        };
        row("log", format!("{} ({} bytes)", self.log.display(), self.bytes));
        row("state", state);
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
        for c in self.channels.iter().filter(|c| !c.agrees) {
            let _ =
                writeln!(text, "\n{}: what the log states to be lost is not what its sequence numbers say", c.topic);
        }
        text
    }
}

fn channel(log: &LogReader, account: &Account, i: usize) -> ChannelInfo {
    let lane = &account.lanes[i];
    let thinned = log.every() > 1;
    let totals = log.totals();
    // What stands behind the last sample is known from the totals alone.
    let said =
        |key: &str| log.metadata().get(TOTALS_METADATA)?.get(&format!("{}.{key}", CHANNELS[i]))?.parse::<u64>().ok();
    let totals_agree = totals.is_none_or(|t| {
        t.lost[i] == lane.stated
            && said("written") == Some(lane.messages)
            && t.thinned[i] >= if thinned { lane.unexplained } else { 0 }
    });
    let found = lane.stated.saturating_add(lane.unexplained);
    ChannelInfo {
        topic: log.run(&format!("topic.{}", CHANNELS[i])).map_or_else(|| format!("/{}", CHANNELS[i]), str::to_owned),
        messages: lane.messages,
        first_tick: lane.ticks.map(|(first, _)| first),
        last_tick: lane.ticks.map(|(_, last)| last),
        per_second: lane.rate(),
        lost_stated: lane.stated,
        lost_found: (!thinned).then_some(found),
        thinned: if thinned { totals.map_or(lane.unexplained, |t| t.thinned[i]) } else { 0 },
        agrees: totals_agree && lane.contradictions == 0 && (thinned || lane.unexplained == 0),
    }
}

/// An instant, ns since 1970, as date and time.
fn utc(ns: u64) -> String {
    let seconds = ns / 1_000_000_000;
    let (days, of_day) = ((seconds / 86_400) as i64, seconds % 86_400);
    // Days to year, month and day of the proleptic Gregorian calendar, with years that begin in March.
    let shifted = days + 719_468;
    let (era, of_era) = (shifted / 146_097, shifted % 146_097);
    let year_of_era = (of_era - of_era / 1460 + of_era / 36_524 - of_era / 146_096) / 365;
    let of_year = of_era - (365 * year_of_era + year_of_era / 4 - year_of_era / 100);
    let from_march = (5 * of_year + 2) / 153;
    let day = of_year - (153 * from_march + 2) / 5 + 1;
    let month = if from_march < 10 { from_march + 3 } else { from_march - 9 };
    let year = year_of_era + era * 400 + i64::from(month <= 2);
    format!("{year:04}-{month:02}-{day:02} {:02}:{:02}:{:02} UTC", of_day / 3600, of_day / 60 % 60, of_day % 60)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn instants_become_dates() {
        for (seconds, date) in [
            (0, "1970-01-01 00:00:00 UTC"),
            (951_782_399, "2000-02-28 23:59:59 UTC"),
            (951_782_400, "2000-02-29 00:00:00 UTC"),
            (1_709_210_096, "2024-02-29 12:34:56 UTC"),
            (1_798_761_599, "2026-12-31 23:59:59 UTC"),
        ] {
            assert_eq!(utc(seconds * 1_000_000_000), date);
        }
    }
}
