//! Summary of a log for `tectum log info`: its run, whether it is whole or torn, what it holds, and what is
//! missing.

use std::collections::BTreeMap;
use std::fs::File;
use std::path::PathBuf;

use serde::Serialize;

use super::{
    CHANNELS, HISTOGRAMS_METADATA, LatencyHistograms, LogClock, LogError, LogRecord, MISSING_METADATA, MessageCounts,
    RunLog, SegmentEnd, TOTALS_METADATA, WARNINGS_METADATA, in_use,
};
use crate::log::header::flag_words;
use crate::stats::Percentiles;
use crate::text::utc;
use crate::wire::{Command, Observation, flag};

mod text;

/// How a log ends.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum LogState {
    /// It has the end that its logger wrote, and the checksums fit.
    Whole,
    /// The same, but it was torn and then repaired by [`repair`](super::repair()).
    Repaired,
    /// Cut off: its logger or its machine died.
    Torn,
    /// Its logger is still writing it.
    Growing,
}

/// A channel of a log.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ChannelInfo {
    /// Its topic.
    pub topic: String,
    /// Messages in the log.
    pub messages: u64,
    /// Tick of the first message.
    pub first_tick: Option<u64>,
    /// Tick of the last message.
    pub last_tick: Option<u64>,
    /// Messages per second of the run's clock.
    pub per_second: Option<f64>,
    /// Samples that the log states to be missing.
    pub lost_stated: u64,
    /// Samples missing by their sequence numbers, and those stated to be missing after the last one. Null for a
    /// thinned log, whose sequence numbers do not distinguish lost samples from thinned ones.
    pub lost_found: Option<u64>,
    /// Samples left out on purpose, as far as the log states.
    pub thinned: u64,
    /// Samples received twice, of which one was dropped, as far as the log states.
    pub duplicates: u64,
    /// Incarnations of its writer within the run, each with the tick of its first sample in the log.
    pub incarnations: Vec<(u32, u64)>,
    /// Whether statements, sequence numbers and totals agree.
    pub agrees: bool,
}

/// A segment of a log.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SegmentInfo {
    /// The file.
    pub log: PathBuf,
    /// The incarnation of the logger that wrote it.
    pub number: u32,
    /// Its size, bytes.
    pub bytes: u64,
    /// How it ends.
    pub state: LogState,
    /// Where the last whole record of a torn segment ends, bytes from its start.
    pub torn_at: Option<u64>,
    /// The first tick in it.
    pub first_tick: Option<u64>,
    /// The last tick in it.
    pub last_tick: Option<u64>,
    /// Samples that it states to be missing before its first sample: observations, commands, learning records.
    pub missing_before: [u64; 3],
}

/// Summary of a log.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct LogInfo {
    /// The file; for a log in several segments, their folder.
    pub log: PathBuf,
    /// Size of all segments, bytes.
    pub bytes: u64,
    /// How its last segment ends.
    pub state: LogState,
    /// Where the last whole record of a torn log ends, bytes from the start of its last segment.
    pub torn_at: Option<u64>,
    /// Its segments.
    pub segments: Vec<SegmentInfo>,
    /// The tick from which on samples are missing because the disk was full, and why.
    pub missing_from: Option<(u64, String)>,
    /// The scenario's name.
    pub scenario: String,
    /// Its seed.
    pub seed: Option<u64>,
    /// Planned number of ticks.
    pub planned_ticks: Option<u64>,
    /// The mode of the run.
    pub mode: String,
    /// Wall time of tick 0; null in lockstep, whose time is the tick's.
    pub started: Option<String>,
    /// The build that wrote it.
    pub build: String,
    /// Facts about the machine.
    pub machine: BTreeMap<String, String>,
    /// The tick's period, s.
    pub period_s: f64,
    /// Every `every`-th tick is written.
    pub every: u64,
    /// Time from the start of the first tick in the log to the end of the last, s of the run's time.
    pub duration_s: f64,
    /// Whether the run reached its planned end; null where the log was cut off before that was known.
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
    /// Real time: from the sending of a command to the observation that reports that it was applied, us.
    pub command_to_applied_us: Option<Percentiles>,
    /// Whether the three were recounted from the samples in the log, because the log has no end.
    pub recounted: bool,
    /// What did not go well in the run, a sentence for each name; empty for a log that was cut off.
    pub warnings: BTreeMap<String, String>,
    /// How often each flag is set in observations and commands; `FIRST` and `NEW_TARGET` are left out.
    pub flags: BTreeMap<String, u64>,
}

impl LogInfo {
    /// Reads the log in `segments`, which belong to one run and are in order, to its end.
    ///
    /// # Errors
    ///
    /// As [`RunLog::open`] and its iterator. A torn log is no error; a damaged one is.
    pub fn of(segments: &[PathBuf]) -> Result<LogInfo, LogError> {
        Self::over(RunLog::open(segments)?)
    }

    /// Reads a log that is at its beginning.
    ///
    /// # Errors
    ///
    /// As the log's iterator.
    pub fn over(mut log: RunLog) -> Result<LogInfo, LogError> {
        let mut scan = LogScan::new(&log);
        while let Some(record) = log.next() {
            scan.take(&record?, log.segments_begun());
        }
        Ok(scan.finish(&log))
    }

    /// Whether statements, sequence numbers and totals of every channel agree.
    pub fn agrees(&self) -> bool {
        self.channels.iter().all(|channel| channel.agrees)
    }

    /// The object of `--json`.
    pub fn to_json(&self) -> String {
        serde_json::to_string_pretty(self).unwrap_or_default()
    }
}

/// Everything that is counted while a log is read.
struct LogScan {
    period_ns: u64,
    counts: MessageCounts,
    histograms: LatencyHistograms,
    /// One for each segment begun.
    segments: Vec<SegmentContents>,
    /// How often each flag bit is set in observations and commands.
    flags: [u64; 32],
    weights_hash: Option<(String, u64)>,
}

impl LogScan {
    fn new(log: &RunLog) -> Self {
        let period_ns = number(log, "period_ns").unwrap_or(0);
        Self {
            period_ns,
            counts: log.message_counts(),
            histograms: LatencyHistograms::new(period_ns),
            segments: Vec::new(),
            flags: [0; 32],
            weights_hash: None,
        }
    }

    /// Counts the next message; it belongs to the last of the `segments_begun` segments.
    fn take(&mut self, record: &LogRecord, segments_begun: usize) {
        self.counts.take(record);
        self.histograms.take(record);
        // A segment may hold no message.
        self.segments.resize(segments_begun, SegmentContents::default());
        self.segments[segments_begun - 1].take(record);
        if let LogRecord::Observation(Observation { header, .. }) | LogRecord::Command(Command { header, .. }) = record
        {
            let flags = header.flags & !(flag::FIRST | flag::NEW_TARGET);
            (0..32).for_each(|bit| self.flags[bit] += u64::from(flags >> bit & 1));
        }
        if let LogRecord::Learning(s) = record
            && s.header.flags & flag::HASHED != 0
        {
            self.weights_hash = Some((format!("{:016x}", s.weights_hash), s.header.tick));
        }
    }

    /// The summary of a log that has been read to its end.
    fn finish(mut self, log: &RunLog) -> LogInfo {
        self.segments.resize(log.segments_begun(), SegmentContents::default());
        let segments: Vec<_> = self.segments.into_iter().zip(log.segments()).map(|(s, end)| s.info(end)).collect();
        let (state, torn_at) = segments.last().map_or((LogState::Torn, None), |last| (last.state, last.torn_at));
        let metadata = |name: &str| log.current_segment().metadata().get(name);
        // Totals that a repair has counted do not tell whether the run reached its end.
        let totals_recounted = metadata(TOTALS_METADATA).is_some_and(|totals| totals.contains_key("repaired"));
        // The logger's own histograms also count the samples that it did not write.
        let stored = metadata(HISTOGRAMS_METADATA).is_some_and(|map| self.histograms.restore(map));
        let real = log.run("clock") == Some(LogClock::Monotonic.name());
        let [wake_up, answer, applied] = self.histograms.percentiles().map(|percentiles| percentiles.filter(|_| real));
        let text = |key: &str| log.run(key).unwrap_or("unknown").to_owned();
        LogInfo {
            log: log.path().to_owned(),
            bytes: segments.iter().map(|segment| segment.bytes).sum(),
            state,
            torn_at,
            missing_from: log.missing_from().map(|tick| (tick, why_missing(log))),
            scenario: text("name"),
            seed: number(log, "seed"),
            planned_ticks: number(log, "ticks"),
            mode: text("mode"),
            started: number(log, "wall_at_t0_ns").filter(|&ns| ns > 0).map(|ns| utc(ns / 1_000_000_000)),
            build: text("build"),
            machine: machine(log),
            period_s: self.period_ns as f64 / 1e9,
            every: log.every(),
            duration_s: duration_s(&self.counts, self.period_ns),
            complete: log.totals().filter(|_| !totals_recounted).map(|totals| totals.complete),
            weights_hash: self.weights_hash,
            channels: (0..3).map(|i| channel_info(log, &self.counts, i)).collect(),
            gaps: self.counts.gaps,
            wake_up_lateness_us: wake_up,
            observation_to_command_us: answer,
            command_to_applied_us: applied,
            recounted: real && !stored,
            warnings: metadata(WARNINGS_METADATA).cloned().unwrap_or_default(),
            segments,
            flags: (0..32).zip(self.flags).filter(|(_, n)| *n > 0).map(|(bit, n)| (flag_words(1 << bit), n)).collect(),
        }
    }
}

/// A number in the run's description.
fn number(log: &RunLog, key: &str) -> Option<u64> {
    log.run(key)?.parse().ok()
}

/// The facts about the machine in the run's description.
fn machine(log: &RunLog) -> BTreeMap<String, String> {
    let facts = log.description().iter();
    facts.filter_map(|(key, value)| Some((key.strip_prefix("machine.")?.to_owned(), value.clone()))).collect()
}

/// Time from the start of the first tick of all channels to the end of the last, s.
fn duration_s(counts: &MessageCounts, period_ns: u64) -> f64 {
    let ticks = counts.channels.iter().filter_map(|channel| channel.ticks);
    let range = ticks.reduce(|(a, b), (c, d)| (a.min(c), b.max(d)));
    range.map_or(0.0, |(first, last)| {
        ((u128::from(last.saturating_sub(first)) + 1) * u128::from(period_ns)) as f64 / 1e9
    })
}

/// The contents of a segment.
#[derive(Debug, Clone, Default)]
struct SegmentContents {
    ticks: Option<(u64, u64)>,
    missing_before: [u64; 3],
    /// Channels of which a sample has been read.
    has_sample: [bool; 3],
}

impl SegmentContents {
    fn take(&mut self, record: &LogRecord) {
        let channel = match record {
            LogRecord::Observation(_) => 0,
            LogRecord::Command(_) => 1,
            LogRecord::Learning(_) => 2,
            LogRecord::Gap(gap) => {
                if let Some(i) = usize::try_from(gap.channel).ok().filter(|&i| i < 3 && !self.has_sample[i]) {
                    self.missing_before[i] = self.missing_before[i].saturating_add(gap.count);
                }
                return;
            }
        };
        self.has_sample[channel] = true;
        if let Some(tick) = record.header().map(|header| header.tick) {
            self.ticks = Some(self.ticks.map_or((tick, tick), |(first, last)| (first.min(tick), last.max(tick))));
        }
    }

    fn info(self, end: SegmentEnd) -> SegmentInfo {
        // A log read from other sources than a file has no size and no lock.
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

/// Why samples are missing, as the logger of the last segment states it.
fn why_missing(log: &RunLog) -> String {
    let stated = log.current_segment().metadata().get(MISSING_METADATA).and_then(|map| map.get("why"));
    stated.map_or_else(|| "an earlier segment states why".to_owned(), Clone::clone)
}

/// The summary of channel `i`.
fn channel_info(log: &RunLog, counts: &MessageCounts, i: usize) -> ChannelInfo {
    let counts = &counts.channels[i];
    let thinned = log.every() > 1;
    let (totals, before) = (log.totals(), log.log_segment());
    // Samples missing after the last one are known from the totals alone.
    let stated_total = |key: &str| {
        log.current_segment()
            .metadata()
            .get(TOTALS_METADATA)?
            .get(&format!("{}.{key}", CHANNELS[i]))?
            .parse::<u64>()
            .ok()
    };
    let totals_agree = totals.is_none_or(|t| {
        t.lost[i] == counts.stated
            && stated_total("written") == before.written[i].checked_add(counts.messages)
            && t.thinned[i] >= if thinned { counts.unexplained } else { 0 }
    });
    let found = counts.stated.saturating_add(counts.unexplained);
    let duplicates = totals.map_or(before.duplicates[i], |totals| totals.duplicates[i]);
    ChannelInfo {
        topic: log.run(&format!("topic.{}", CHANNELS[i])).map_or_else(|| format!("/{}", CHANNELS[i]), str::to_owned),
        messages: counts.messages,
        first_tick: counts.ticks.map(|(first, _)| first),
        last_tick: counts.ticks.map(|(_, last)| last),
        per_second: counts.rate(),
        lost_stated: counts.stated,
        lost_found: (!thinned).then_some(found),
        thinned: if thinned { totals.map_or(counts.unexplained, |t| t.thinned[i]) } else { 0 },
        duplicates,
        incarnations: counts.incarnations.clone(),
        agrees: totals_agree && counts.contradictions == 0 && (thinned || counts.unexplained == 0),
    }
}
