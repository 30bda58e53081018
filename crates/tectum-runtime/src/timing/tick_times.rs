//! From the instants of each tick to latencies, with nothing left out: pure arithmetic.
//!
//! The latency of a tick counts from the instant for which it was *scheduled*. A process that stalls skips
//! ticks. Nobody has timed those, but it is known for when they were scheduled and when the stall was over. So
//! each of them is a sample too, as long as the tick would have waited. The same holds for an observation that
//! was never answered: it waited until a later one was answered. To leave such samples out would measure only
//! the good moments (coordinated omission).

use hdrhistogram::Histogram;
use serde::Serialize;

use crate::stats::{Percentiles, histogram};

/// The instants of one tick on CLOCK_MONOTONIC, ns.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct TickTimes {
    /// The tick.
    pub tick: u64,
    /// The instant for which the tick was scheduled.
    pub scheduled_ns: u64,
    /// When the asking side had sensed: the observation is ready to be sent.
    pub sensed_ns: u64,
    /// When the answering side sent its command; `None` if it never did.
    pub sent_ns: Option<u64>,
    /// When the asking side applied that command; `None` if it never did.
    pub applied_ns: Option<u64>,
}

/// The latencies of many ticks, ns.
#[derive(Debug, Clone)]
pub struct Latencies {
    /// From the scheduled instant to the sensed observation.
    pub scheduled_to_sensed: Histogram<u64>,
    /// From there to the sent command.
    pub sensed_to_command: Histogram<u64>,
    /// From there to the applied command.
    pub command_to_applied: Histogram<u64>,
    /// From the sensed observation to the applied command: the last two together.
    pub sensed_to_applied: Histogram<u64>,
    /// From the scheduled instant to the applied command.
    pub scheduled_to_applied: Histogram<u64>,
    /// Ticks that took place.
    pub ticks: u64,
    /// Among them, those whose command was not applied.
    pub missed: u64,
    /// Ticks that were skipped in stalls.
    pub skipped: u64,
}

/// Names of the five series, as in file names.
pub const SERIES: [&str; 5] =
    ["scheduled-to-sensed", "sensed-to-command", "command-to-applied", "sensed-to-applied", "scheduled-to-applied"];

impl Default for Latencies {
    fn default() -> Self {
        Self {
            scheduled_to_sensed: histogram(),
            sensed_to_command: histogram(),
            command_to_applied: histogram(),
            sensed_to_applied: histogram(),
            scheduled_to_applied: histogram(),
            ticks: 0,
            missed: 0,
            skipped: 0,
        }
    }
}

impl Latencies {
    /// Adds the ticks of one block, in order. Ticks before `warm_up` are not counted. `period_ns` is the time
    /// from one tick to the next; 0 where ticks have no schedule. Ticks at the end whose command has not been
    /// applied are not counted either: the block ended before it could be.
    pub fn record(&mut self, tick_times: &[TickTimes], warm_up: u64, period_ns: u64) {
        // From the end, so that the next sent and the next applied command are known.
        let (mut sent, mut applied) = (None, None);
        for (i, times) in tick_times.iter().enumerate().rev() {
            if times.tick < warm_up {
                break;
            }
            sent = times.sent_ns.or(sent);
            applied = times.applied_ns.or(applied);
            let Some(end) = applied else { continue };
            self.ticks += 1;
            self.missed += u64::from(times.applied_ns.is_none());
            note(&mut self.scheduled_to_sensed, times.scheduled_ns, times.sensed_ns);
            if let Some(sent) = sent {
                note(&mut self.sensed_to_command, times.sensed_ns, sent);
            }
            if let (Some(sent), Some(applied)) = (times.sent_ns, times.applied_ns) {
                note(&mut self.command_to_applied, sent, applied);
            }
            note(&mut self.sensed_to_applied, times.sensed_ns, end);
            note(&mut self.scheduled_to_applied, times.scheduled_ns, end);
            // The ticks that the stall before this one has skipped.
            let first_skipped = if i == 0 { times.tick } else { tick_times[i - 1].tick + 1 };
            for skipped in first_skipped.max(warm_up)..times.tick {
                let scheduled = times.scheduled_ns.saturating_sub((times.tick - skipped) * period_ns);
                note(&mut self.scheduled_to_sensed, scheduled, times.sensed_ns);
                note(&mut self.scheduled_to_applied, scheduled, end);
                self.skipped += 1;
            }
        }
    }

    /// Adds the latencies of another block.
    pub fn add(&mut self, block: &Self) {
        for (all, block) in [
            (&mut self.scheduled_to_sensed, &block.scheduled_to_sensed),
            (&mut self.sensed_to_command, &block.sensed_to_command),
            (&mut self.command_to_applied, &block.command_to_applied),
            (&mut self.sensed_to_applied, &block.sensed_to_applied),
            (&mut self.scheduled_to_applied, &block.scheduled_to_applied),
        ] {
            all.add(block).expect("equal bounds");
        }
        self.ticks += block.ticks;
        self.missed += block.missed;
        self.skipped += block.skipped;
    }

    /// The five series in the order of [`SERIES`].
    pub fn series(&self) -> [&Histogram<u64>; 5] {
        [
            &self.scheduled_to_sensed,
            &self.sensed_to_command,
            &self.command_to_applied,
            &self.sensed_to_applied,
            &self.scheduled_to_applied,
        ]
    }

    /// The percentiles of all series.
    pub fn percentiles(&self) -> SeriesPercentiles {
        SeriesPercentiles {
            scheduled_to_sensed_us: Percentiles::of(&self.scheduled_to_sensed),
            sensed_to_command_us: Percentiles::of(&self.sensed_to_command),
            command_to_applied_us: Percentiles::of(&self.command_to_applied),
            sensed_to_applied_us: Percentiles::of(&self.sensed_to_applied),
            scheduled_to_applied_us: Percentiles::of(&self.scheduled_to_applied),
        }
    }
}

/// Records the time between two instants.
fn note(histogram: &mut Histogram<u64>, from: u64, to: u64) {
    histogram.saturating_record(to.saturating_sub(from));
}

/// The percentiles of all series, us; null for a series without samples.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub struct SeriesPercentiles {
    /// From the scheduled instant to the sensed observation.
    pub scheduled_to_sensed_us: Option<Percentiles>,
    /// From there to the sent command.
    pub sensed_to_command_us: Option<Percentiles>,
    /// From there to the applied command.
    pub command_to_applied_us: Option<Percentiles>,
    /// From the sensed observation to the applied command.
    pub sensed_to_applied_us: Option<Percentiles>,
    /// From the scheduled instant to the applied command.
    pub scheduled_to_applied_us: Option<Percentiles>,
}

impl SeriesPercentiles {
    /// In the order of [`SERIES`].
    pub fn all(&self) -> [Option<Percentiles>; 5] {
        [
            self.scheduled_to_sensed_us,
            self.sensed_to_command_us,
            self.command_to_applied_us,
            self.sensed_to_applied_us,
            self.scheduled_to_applied_us,
        ]
    }
}

/// A histogram of nanoseconds as HdrHistogram's text, in us: the percentile distribution that its plotting
/// tools read.
pub fn hgrm(histogram: &Histogram<u64>) -> String {
    use std::fmt::Write as _;
    let mut text = format!("{:>12} {:>14} {:>10} {:>14}\n\n", "Value", "Percentile", "TotalCount", "1/(1-Percentile)");
    if histogram.is_empty() {
        return text;
    }
    let us = |ns: f64| ns / 1000.0;
    let mut seen = 0;
    for step in histogram.iter_quantiles(5) {
        seen += step.count_since_last_iteration();
        let (value, quantile) = (us(step.value_iterated_to() as f64), step.quantile_iterated_to());
        let _ = match quantile {
            q if q < 1.0 => writeln!(text, "{value:>12.3} {q:>14.12} {seen:>10} {:>14.2}", 1.0 / (1.0 - q)),
            q => writeln!(text, "{value:>12.3} {q:>14.12} {seen:>10}"),
        };
    }
    let (mean, deviation) = (us(histogram.mean()), us(histogram.stdev()));
    let (max, total) = (us(histogram.max() as f64), histogram.len());
    text += &format!("#[Mean    = {mean:>12.3}, StdDeviation   = {deviation:>12.3}]\n");
    text += &format!("#[Max     = {max:>12.3}, Total count    = {total:>12}]\n");
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: u64 = 1_000_000;

    /// The instants of a tick, in ms after its scheduled instant.
    fn times(tick: u64, sensed: u64, sent: Option<u64>, applied: Option<u64>) -> TickTimes {
        let scheduled_ns = (100 + 50 * tick) * MS;
        let at = |ms: u64| scheduled_ns + ms * MS;
        TickTimes { tick, scheduled_ns, sensed_ns: at(sensed), sent_ns: sent.map(at), applied_ns: applied.map(at) }
    }

    fn values(histogram: &Histogram<u64>) -> Vec<u64> {
        let recorded = histogram.iter_recorded();
        recorded.flat_map(|v| vec![(v.value_iterated_to() + MS / 4) / MS; v.count_at_value() as usize]).collect()
    }

    #[test]
    fn a_tick_is_timed_from_its_scheduled_instant() {
        let mut latencies = Latencies::default();
        latencies.record(&[times(0, 1, Some(3), Some(51)), times(1, 2, Some(6), Some(53))], 0, 50 * MS);
        assert_eq!(latencies.series().map(values), [vec![1, 2], vec![2, 4], vec![47, 48], vec![50, 51], vec![51, 53]]);
        assert_eq!((latencies.ticks, latencies.missed, latencies.skipped), (2, 0, 0));
    }

    #[test]
    fn a_stall_adds_the_ticks_that_it_skips() {
        let mut latencies = Latencies::default();
        // Ticks 1 and 2 were skipped: the stall of the asking side ended 7 ms into tick 3.
        latencies.record(&[times(0, 1, Some(2), Some(3)), times(3, 7, Some(9), Some(10))], 0, 50 * MS);
        assert_eq!(values(&latencies.scheduled_to_sensed), [1, 7, 57, 107]);
        assert_eq!(values(&latencies.scheduled_to_applied), [3, 10, 60, 110]);
        assert_eq!(values(&latencies.sensed_to_command), [1, 2], "skipped ticks sense nothing");
        assert_eq!((latencies.ticks, latencies.skipped), (2, 2));
    }

    #[test]
    fn an_unanswered_observation_waits_until_a_later_one_is_answered() {
        let mut latencies = Latencies::default();
        let tick_times = [times(0, 0, None, None), times(1, 0, Some(4), None), times(2, 0, Some(5), Some(6))];
        latencies.record(&tick_times, 0, 50 * MS);
        assert_eq!(values(&latencies.sensed_to_command), [4, 5, 54]);
        assert_eq!(values(&latencies.sensed_to_applied), [6, 56, 106]);
        assert_eq!(values(&latencies.command_to_applied), [1]);
        assert_eq!((latencies.ticks, latencies.missed), (3, 2));
    }

    #[test]
    fn the_warm_up_and_the_open_end_are_not_counted() {
        let mut latencies = Latencies::default();
        let tick_times = [times(0, 9, Some(9), Some(9)), times(1, 1, Some(2), Some(3)), times(2, 8, Some(9), None)];
        latencies.record(&tick_times, 1, 50 * MS);
        assert_eq!((values(&latencies.scheduled_to_sensed), latencies.ticks, latencies.missed), (vec![1], 1, 0));
        latencies.record(&[], 0, 50 * MS);
        assert_eq!(latencies.ticks, 1);
    }

    #[test]
    fn the_text_of_a_histogram_ends_with_its_total() {
        let mut filled = histogram();
        for ns in 1..=1000 {
            filled.record(ns * 1000).unwrap();
        }
        let text = hgrm(&filled);
        let rows: Vec<Vec<f64>> = text
            .lines()
            .skip(2)
            .take_while(|line| !line.starts_with('#'))
            .map(|line| line.split_whitespace().map(|x| x.parse().unwrap()).collect())
            .collect();
        assert!(rows.windows(2).all(|w| w[0][0] <= w[1][0] && w[0][1] <= w[1][1]), "{text}");
        assert_eq!(rows.last().unwrap()[1..3], [1.0, 1000.0]);
        assert!(text.contains("Total count    =         1000"), "{text}");
        assert_eq!(hgrm(&histogram()).lines().count(), 2);
    }
}
