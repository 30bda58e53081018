//! Histograms of three durations of every tick of a real-time run, stored in the log itself.
//!
//! All are computed from the samples alone. So they survive the death of any process, and any reader can
//! recompute them:
//!
//! - *wake-up lateness*: from the tick's scheduled instant (`scheduled_ns` of an observation) to its sensing
//!   (`sensed_ns`). Every tick that the plant skipped right before (`skipped`) adds a sample of its own, from
//!   *its* scheduled instant to the same sensing: a stall of ten ticks is ten late ticks, not one (no
//!   coordinated omission).
//! - *observation to command*: from the sensing (`sensed_ns`, which a command repeats) to the instant at which
//!   the command was sent (`published_ns`). The plant's own lateness is in the first duration, so the two
//!   together are the time from the scheduled instant to the command.
//! - *command to applied*: from `published_ns` of the command of tick k to the sensing of observation k+1, when
//!   the plant has advanced through tick k with it. Counted only if that observation reports that the command
//!   was applied: it was not missed, no tick was skipped in between, and it is not the first observation of a
//!   restarted plant. At a steady cadence this is the rest of the period, plus the lateness of tick k+1.
//!
//! In the metadata record `tectum.histograms` each is stored under its name (`wake_up_lateness`,
//! `observation_to_command`, `command_to_applied`) as text: `value:count` separated by spaces, values in ns in
//! rising order, three significant digits (the largest value of its bucket). Durations longer than a minute
//! count as a minute. Ticks that a thinned log leaves out are counted; samples that never reached the logger
//! are not.

use std::collections::BTreeMap;

use hdrhistogram::Histogram;
use serde::{Deserialize, Serialize};

use super::LogRecord;
use crate::stats::{LONGEST, Percentiles, histogram};
use crate::wire::flag;

/// A command and the observation after it are matched if they are fewer than this many ticks apart in the log's
/// order.
const WINDOW: usize = 64;
/// The shortest period that a scenario can have, ns.
const SHORTEST_PERIOD: u64 = 1_000_000;

/// The three histograms of a run.
#[derive(Debug, Clone)]
pub struct LatencyHistograms {
    period_ns: u64,
    histograms: [Histogram<u64>; 3],
    /// By tick modulo [`WINDOW`]: the tick and the instant at which its command was published; and the tick and
    /// the sensing instant of the observation that reports its command as applied.
    published: [Option<(u64, u64)>; WINDOW],
    applied: [Option<(u64, u64)>; WINDOW],
}

/// The histograms and what has been seen of ticks that are under way: all that counting on needs.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(crate) struct HistogramsState {
    histograms: BTreeMap<String, String>,
    published: Vec<(u64, u64)>,
    applied: Vec<(u64, u64)>,
}

/// Names in the metadata record.
const NAMES: [&str; 3] = ["wake_up_lateness", "observation_to_command", "command_to_applied"];
/// With one of these flags, an observation does not report its preceding command as applied.
const NOT_APPLIED: u32 = flag::FIRST | flag::MISSED | flag::SKIPPED;

impl LatencyHistograms {
    /// Empty histograms; `period_ns` is the tick's period.
    pub fn new(period_ns: u64) -> Self {
        let histograms = std::array::from_fn(|_| histogram());
        let period_ns = period_ns.max(SHORTEST_PERIOD);
        Self { period_ns, histograms, published: [None; WINDOW], applied: [None; WINDOW] }
    }

    /// Counts the next sample, in the order of the log.
    pub fn take(&mut self, record: &LogRecord) {
        match record {
            LogRecord::Observation(s) => {
                let header = &s.header;
                let late = header.sensed_ns.saturating_sub(header.scheduled_ns);
                // This tick and the skipped ones. All durations above a minute are counted as equal.
                let ticks = u64::from(s.skipped) + 1;
                let told_apart = ticks.min(LONGEST / self.period_ns + 1);
                for ago in 0..told_apart {
                    self.record(0, late.saturating_add(ago * self.period_ns));
                }
                if ticks > told_apart {
                    self.histograms[0].saturating_record_n(LONGEST, ticks - told_apart);
                }
                if let Some(tick) = header.tick.checked_sub(1).filter(|_| header.flags & NOT_APPLIED == 0) {
                    let slot = tick as usize % WINDOW;
                    match self.published[slot] {
                        Some((of, at)) if of == tick => self.record(2, header.sensed_ns.saturating_sub(at)),
                        _ => self.applied[slot] = Some((tick, header.sensed_ns)),
                    }
                }
            }
            LogRecord::Command(s) => {
                let header = &s.header;
                self.record(1, header.published_ns.saturating_sub(header.sensed_ns));
                let slot = header.tick as usize % WINDOW;
                match self.applied[slot] {
                    Some((of, at)) if of == header.tick => self.record(2, at.saturating_sub(header.published_ns)),
                    _ => self.published[slot] = Some((header.tick, header.published_ns)),
                }
            }
            LogRecord::Learning(_) | LogRecord::Gap(_) => {}
        }
    }

    fn record(&mut self, which: usize, ns: u64) {
        self.histograms[which].saturating_record(ns);
    }

    /// Wake-up lateness, observation to command, command to applied.
    pub fn percentiles(&self) -> [Option<Percentiles>; 3] {
        self.histograms.each_ref().map(Percentiles::of)
    }

    /// The histograms, ns, in the same order.
    pub fn histograms(&self) -> &[Histogram<u64>; 3] {
        &self.histograms
    }

    /// All that [`set_state`](Self::set_state) needs.
    pub(crate) fn state(&self) -> HistogramsState {
        let [published, applied] = [&self.published, &self.applied].map(|w| w.iter().flatten().copied().collect());
        HistogramsState { histograms: self.to_map(), published, applied }
    }

    /// Replaces everything by `state`. Returns false, and changes nothing, if it is invalid.
    pub(super) fn set_state(&mut self, state: &HistogramsState) -> bool {
        if !self.restore(&state.histograms) {
            return false;
        }
        for (window, seen) in [(&mut self.published, &state.published), (&mut self.applied, &state.applied)] {
            *window = [None; WINDOW];
            seen.iter().for_each(|&(tick, ns)| window[tick as usize % WINDOW] = Some((tick, ns)));
        }
        true
    }

    /// The content of `tectum.histograms`.
    pub(super) fn to_map(&self) -> BTreeMap<String, String> {
        let text = |histogram: &Histogram<u64>| {
            let pairs = histogram.iter_recorded().map(|v| format!("{}:{}", v.value_iterated_to(), v.count_at_value()));
            pairs.collect::<Vec<_>>().join(" ")
        };
        NAMES.iter().zip(&self.histograms).map(|(name, h)| ((*name).to_owned(), text(h))).collect()
    }

    /// Replaces the histograms by those of `tectum.histograms`. Returns false, and changes nothing, if the
    /// record is invalid.
    pub(super) fn restore(&mut self, map: &BTreeMap<String, String>) -> bool {
        let read = |name: &str| {
            let mut read = histogram();
            for pair in map.get(name)?.split_ascii_whitespace() {
                let (value, count) = pair.split_once(':')?;
                let (value, count) = (value.parse::<u64>().ok()?, count.parse::<u64>().ok()?);
                read.len().checked_add(count)?;
                read.record_n(value, count).ok()?;
            }
            Some(read)
        };
        let [Some(a), Some(b), Some(c)] = NAMES.map(read) else { return false };
        self.histograms = [a, b, c];
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::wire::{Command, Observation};
    use proptest::prelude::*;

    const PERIOD: u64 = 1_000_000;

    fn observation(tick: u64, late_ns: u64, skipped: u32, flags: u32) -> LogRecord {
        let mut s = Observation { skipped, ..Observation::default() };
        (s.header.tick, s.header.flags, s.header.scheduled_ns) = (tick, flags, 7 + tick * PERIOD);
        s.header.sensed_ns = s.header.scheduled_ns + late_ns;
        LogRecord::Observation(s)
    }

    fn command(tick: u64, late_ns: u64, took_ns: u64) -> LogRecord {
        let mut s = Command::default();
        s.header.tick = tick;
        s.header.sensed_ns = 7 + tick * PERIOD + late_ns;
        s.header.published_ns = s.header.sensed_ns + took_ns;
        LogRecord::Command(s)
    }

    fn counted(records: &[LogRecord]) -> LatencyHistograms {
        let mut timings = LatencyHistograms::new(PERIOD);
        records.iter().for_each(|record| timings.take(record));
        timings
    }

    fn values(timings: &LatencyHistograms, which: usize) -> Vec<u64> {
        let h = &timings.histograms[which];
        h.iter_recorded().flat_map(|v| vec![v.value_iterated_to(); v.count_at_value() as usize]).collect()
    }

    #[test]
    fn skipped_ticks_add_their_own_longer_samples() {
        let timings =
            counted(&[observation(0, 100, 0, flag::FIRST), observation(4, 500, 3, flag::SKIPPED | flag::MISSED)]);
        let values = values(&timings, 0);
        let expected = [100, 500, 1_000_500, 2_000_500, 3_000_500_u64];
        assert_eq!(values.len(), expected.len());
        for (ns, expected) in values.iter().zip(expected) {
            assert!(ns.abs_diff(expected) <= expected / 1000, "to three digits: {values:?}");
        }
    }

    #[test]
    fn only_what_was_applied_has_a_time_of_application() {
        let timings = counted(&[
            observation(0, 100, 0, flag::FIRST),
            command(0, 100, 50),
            observation(1, 200, 0, 0),
            command(1, 200, 30),
            // Missed, skipped, and the first observation of a restarted plant.
            observation(2, 100, 0, flag::MISSED | flag::HELD),
            command(2, 100, 40),
            observation(4, 100, 1, flag::SKIPPED),
            command(4, 100, 40),
            observation(5, 0, 0, flag::FIRST),
            // No command came for tick 5.
            observation(6, 0, 0, 0),
        ]);
        assert_eq!(values(&timings, 1), [30, 40, 40, 50]);
        let applied = values(&timings, 2);
        assert_eq!((applied.len(), applied[0] / 1000), (1, (PERIOD + 200 - 150) / 1000));
    }

    #[test]
    fn the_order_of_command_and_observation_does_not_matter() {
        let usual = [observation(0, 9, 0, flag::FIRST), command(0, 9, 50), observation(1, 20, 0, 0)];
        let late = [usual[0], usual[2], usual[1]];
        assert_eq!(counted(&usual).histograms, counted(&late).histograms);
        assert_eq!(values(&counted(&late), 2).len(), 1);
    }

    #[test]
    fn an_invalid_record_changes_nothing() {
        let mut timings = counted(&[observation(0, 100, 0, 0)]);
        let before = timings.histograms.clone();
        for text in ["1:", "x:3", "5", "1:2:3", "-1:2", &format!("1:{} 2:{0}", u64::MAX), &format!("{}:1", u64::MAX)] {
            let mut map = timings.to_map();
            map.insert("command_to_applied".into(), text.into());
            assert!(!timings.restore(&map), "{text}");
            map.remove("command_to_applied");
            assert!(!timings.restore(&map));
        }
        assert_eq!(timings.histograms, before);
    }

    proptest! {
        /// Every bucket that is written is read back.
        #[test]
        fn histograms_are_equal_after_a_round_trip_through_their_text(
            values in prop::collection::vec((0..3_usize, any::<u64>(), 0..50_u32), 0..200),
        ) {
            let mut timings = LatencyHistograms::new(PERIOD);
            for (which, value, shift) in values {
                timings.record(which, value >> shift);
            }
            let mut read = counted(&[observation(3, 5, 0, 0)]);
            prop_assert!(read.restore(&timings.to_map()));
            prop_assert_eq!(&read.histograms, &timings.histograms);
            prop_assert_eq!(read.percentiles(), timings.percentiles());
        }
    }
}
