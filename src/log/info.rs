//! What a log is: of which run, whole or torn, how much of what, and what it lacks.

use std::collections::BTreeMap;
use std::fs::File;
use std::path::PathBuf;

use serde::Serialize;

use super::{
    CHANNELS, HISTOGRAMS_METADATA, LatencyHistograms, LogClock, LogError, LogRecord, MISSING_METADATA, MessageCounts,
    Percentiles, RunLog, SegmentEnd, TOTALS_METADATA, in_use,
};
use crate::log::header::flag_words;
use crate::wire::{Command, Observation, flag};

mod text;

/// How a log ends.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum LogState {
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
    /// Samples that came twice, of which one was dropped, so far as the log tells.
    pub duplicates: u64,
    /// Start numbers of its writer within the run, each with the tick of its first sample in the log.
    pub incarnations: Vec<(u32, u64)>,
    /// Statements, sequence numbers and totals say the same.
    pub agrees: bool,
}

/// A segment of a log.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SegmentInfo {
    /// The file.
    pub log: PathBuf,
    /// The start number of the logger that wrote it.
    pub number: u32,
    /// Its size, bytes.
    pub bytes: u64,
    /// How it ends.
    pub state: LogState,
    /// Where the last whole record of a torn segment ends, bytes from its start.
    pub torn_at: Option<u64>,
    /// The first tick of a sample in it.
    pub first_tick: Option<u64>,
    /// The last one.
    pub last_tick: Option<u64>,
    /// Samples that it states to be missing before its first: observations, commands, learning records.
    pub missing_before: [u64; 3],
}

/// A log at a glance.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct LogInfo {
    /// The file; for a log in several segments, their folder.
    pub log: PathBuf,
    /// Its size, all segments, bytes.
    pub bytes: u64,
    /// How its last segment ends.
    pub state: LogState,
    /// Where the last whole record of a torn log ends, bytes from the start of its last segment.
    pub torn_at: Option<u64>,
    /// Its segments.
    pub segments: Vec<SegmentInfo>,
    /// The tick from which on samples are missing because there was no room for them, and why.
    pub missing_from: Option<(u64, String)>,
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
    /// Real time: from a tick's scheduled instant to its sensing, us; see [`LatencyHistograms`].
    pub wake_up_lateness_us: Option<Percentiles>,
    /// Real time: from sensing to the sending of the command, us.
    pub observation_to_command_us: Option<Percentiles>,
    /// Real time: from the sending of a command to the observation that tells that it was applied, us.
    pub command_to_applied_us: Option<Percentiles>,
    /// The three were counted from the samples in the log, which did not come to its end.
    pub recounted: bool,
    /// What observations and commands in the log are flagged with, and how many are; targets and the first are left out.
    pub flags: BTreeMap<String, u64>,
}

impl LogInfo {
    /// Reads the log in `segments`, of one run and in their order, to its end.
    ///
    /// # Errors
    ///
    /// As [`RunLog::open`] and its iterator: a torn log is none, a damaged one is.
    pub fn of(segments: &[PathBuf]) -> Result<LogInfo, LogError> {
        Self::over(RunLog::open(segments)?)
    }

    /// The same from a log at its beginning.
    ///
    /// # Errors
    ///
    /// As the log's iterator.
    pub fn over(mut log: RunLog) -> Result<LogInfo, LogError> {
        let mut account = log.account();
        let mut weights_hash = None;
        let number = |log: &RunLog, key: &str| log.run(key).and_then(|value| value.parse::<u64>().ok());
        let period_ns = number(&log, "period_ns").unwrap_or(0);
        let mut timings = LatencyHistograms::new(period_ns);
        let mut parts = vec![SegmentContents::default()];
        let mut flagged = [0; 32];
        while let Some(record) = log.next() {
            let record = record?;
            account.take(&record);
            timings.take(&record);
            // A segment may hold nothing.
            parts.resize(log.begun(), SegmentContents::default());
            parts[log.begun() - 1].take(&record);
            if let LogRecord::Observation(Observation { header, .. }) | LogRecord::Command(Command { header, .. }) =
                &record
            {
                let flags = header.flags & !(flag::FIRST | flag::NEW_TARGET);
                (0..32).for_each(|bit| flagged[bit] += u64::from(flags >> bit & 1));
            }
            if let LogRecord::Learning(s) = &record
                && s.header.flags & flag::HASHED != 0
            {
                weights_hash = Some((format!("{:016x}", s.weights_hash), s.header.tick));
            }
        }
        parts.resize(log.begun(), SegmentContents::default());
        let segments: Vec<_> = parts.into_iter().zip(log.segments()).map(|(part, end)| part.info(end)).collect();
        let last = segments.last().map_or((LogState::Torn, None), |last| (last.state, last.torn_at));
        let said = |name: &str| log.segment().metadata().get(name);
        // Whoever counts the totals of a torn log afterwards has not seen the run's end.
        let counted = said(TOTALS_METADATA).is_some_and(|totals| totals.contains_key("repaired"));
        // The logger counted what it did not write, too.
        let stored = said(HISTOGRAMS_METADATA).is_some_and(|map| timings.restore(map));
        let real = log.run("clock") == Some(LogClock::Monotonic.name());
        let [wake_up, answer, applied] = timings.percentiles().map(|percentiles| percentiles.filter(|_| real));
        let text = |key: &str| log.run(key).unwrap_or("unknown").to_owned();
        let ticks = account.lanes.iter().filter_map(|lane| lane.ticks);
        let span = ticks.reduce(|(a, b), (c, d)| (a.min(c), b.max(d)));
        let machine = log.description().iter();
        let machine = machine.filter_map(|(k, v)| Some((k.strip_prefix("machine.")?.to_owned(), v.clone())));
        Ok(LogInfo {
            log: log.path().to_owned(),
            bytes: segments.iter().map(|segment| segment.bytes).sum(),
            state: last.0,
            torn_at: last.1,
            missing_from: log.missing_from().map(|tick| (tick, why_missing(&log))),
            scenario: text("name"),
            seed: number(&log, "seed"),
            planned_ticks: number(&log, "ticks"),
            mode: text("mode"),
            started: number(&log, "wall_at_t0_ns").filter(|&ns| ns > 0).map(utc),
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
            wake_up_lateness_us: wake_up,
            observation_to_command_us: answer,
            command_to_applied_us: applied,
            recounted: real && !stored,
            segments,
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
}

/// What a segment holds.
#[derive(Debug, Clone, Default)]
struct SegmentContents {
    ticks: Option<(u64, u64)>,
    missing_before: [u64; 3],
    begun: [bool; 3],
}

impl SegmentContents {
    fn take(&mut self, record: &LogRecord) {
        let channel = match record {
            LogRecord::Observation(_) => 0,
            LogRecord::Command(_) => 1,
            LogRecord::Learning(_) => 2,
            LogRecord::Gap(gap) => {
                if let Some(i) = usize::try_from(gap.channel).ok().filter(|&i| i < 3 && !self.begun[i]) {
                    self.missing_before[i] = self.missing_before[i].saturating_add(gap.count);
                }
                return;
            }
        };
        self.begun[channel] = true;
        if let Some(tick) = record.header().map(|header| header.tick) {
            self.ticks = Some(self.ticks.map_or((tick, tick), |(first, last)| (first.min(tick), last.max(tick))));
        }
    }

    fn info(self, end: SegmentEnd) -> SegmentInfo {
        // What is not in a file is neither long nor in use.
        let file = File::open(&end.path).ok();
        let bytes = file.as_ref().and_then(|file| file.metadata().ok()).map_or(end.position, |file| file.len());
        let state = match (end.finished, end.repaired) {
            (true, false) => LogState::Whole,
            (true, true) => LogState::Repaired,
            (false, _) if file.is_some_and(|file| in_use(&file)) => LogState::Growing,
            (false, _) => LogState::Torn,
        };
        let torn = matches!(state, LogState::Torn | LogState::Growing);
        SegmentInfo {
            log: end.path,
            number: end.number,
            bytes,
            state,
            torn_at: torn.then_some(end.position),
            first_tick: self.ticks.map(|(first, _)| first),
            last_tick: self.ticks.map(|(_, last)| last),
            missing_before: self.missing_before,
        }
    }
}

/// Why samples are missing, in the logger's own words; the last segment's, where it has any.
fn why_missing(log: &RunLog) -> String {
    let said = log.segment().metadata().get(MISSING_METADATA).and_then(|map| map.get("why"));
    said.map_or_else(|| "an earlier segment says why".to_owned(), Clone::clone)
}

fn channel(log: &RunLog, account: &MessageCounts, i: usize) -> ChannelInfo {
    let lane = &account.lanes[i];
    let thinned = log.every() > 1;
    let (totals, before) = (log.totals(), log.begins());
    // What stands behind the last sample is known from the totals alone.
    let said = |key: &str| {
        log.segment().metadata().get(TOTALS_METADATA)?.get(&format!("{}.{key}", CHANNELS[i]))?.parse::<u64>().ok()
    };
    let totals_agree = totals.is_none_or(|t| {
        t.lost[i] == lane.stated
            && said("written") == before.written[i].checked_add(lane.messages)
            && t.thinned[i] >= if thinned { lane.unexplained } else { 0 }
    });
    let found = lane.stated.saturating_add(lane.unexplained);
    let duplicates = totals.map_or(before.duplicates[i], |totals| totals.duplicates[i]);
    ChannelInfo {
        topic: log.run(&format!("topic.{}", CHANNELS[i])).map_or_else(|| format!("/{}", CHANNELS[i]), str::to_owned),
        messages: lane.messages,
        first_tick: lane.ticks.map(|(first, _)| first),
        last_tick: lane.ticks.map(|(_, last)| last),
        per_second: lane.rate(),
        lost_stated: lane.stated,
        lost_found: (!thinned).then_some(found),
        thinned: if thinned { totals.map_or(lane.unexplained, |t| t.thinned[i]) } else { 0 },
        duplicates,
        incarnations: lane.incarnations.clone(),
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
