//! From the instants of each tick to latencies, with nothing left out: pure arithmetic.
//!
//! A tick counts from the instant for which it was *scheduled*. A process that stalls passes ticks over; nobody has timed
//! those, but everybody knows for when they were scheduled and when the stall was over. Each of them is a sample too, as
//! long as it would have waited. So is an observation that was never answered: it waited until a later one was. To leave
//! them out would be to measure only when it goes well (coordinated omission).

use hdrhistogram::Histogram;
use serde::Serialize;

use crate::log::{Percentiles, histogram};

/// The instants of one tick, CLOCK_MONOTONIC, ns.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct TickTimes {
    /// The tick.
    pub tick: u64,
    /// For when it was scheduled.
    pub scheduled: u64,
    /// When the asking side had sensed, or would have: the sample is ready to be sent.
    pub sensed: u64,
    /// When the answering side sent its command; `None` if it never did.
    pub answered: Option<u64>,
    /// When the asking side had that command in hand and applied it; `None` if it never did.
    pub applied: Option<u64>,
}

/// The latencies of many ticks, ns.
#[derive(Debug, Clone)]
pub struct Latencies {
    /// From the scheduled instant to the sensed one.
    pub scheduled_to_sensed: Histogram<u64>,
    /// From there to the sending of the command.
    pub sensed_to_command: Histogram<u64>,
    /// From there to its being applied.
    pub command_to_applied: Histogram<u64>,
    /// From the sensed instant to the command's being applied: the last two together.
    pub sensed_to_applied: Histogram<u64>,
    /// The whole.
    pub scheduled_to_applied: Histogram<u64>,
    /// Ticks that were lived through.
    pub ticks: u64,
    /// Of these, those whose command was not applied.
    pub missed: u64,
    /// Ticks passed over in stalls.
    pub swallowed: u64,
}

/// Names of the five, as in files.
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
            swallowed: 0,
        }
    }
}

impl Latencies {
    /// Takes the tick_times of one block in, which stand in the order of their ticks; those of ticks below `from` only serve to
    /// warm up. `period` is the time from one tick to the next, ns; 0 where nothing is scheduled. Laps at the end whose
    /// command is still out are left out: the block ended before they could.
    pub fn record(&mut self, tick_times: &[TickTimes], from: u64, period: u64) {
        // The next answer and the next application, from the end.
        let (mut answered, mut applied) = (None, None);
        for (i, lap) in tick_times.iter().enumerate().rev() {
            if lap.tick < from {
                break;
            }
            answered = lap.answered.or(answered);
            applied = lap.applied.or(applied);
            let Some(end) = applied else { continue };
            self.ticks += 1;
            self.missed += u64::from(lap.applied.is_none());
            note(&mut self.scheduled_to_sensed, lap.scheduled, lap.sensed);
            if let Some(answered) = answered {
                note(&mut self.sensed_to_command, lap.sensed, answered);
            }
            if let (Some(answered), Some(applied)) = (lap.answered, lap.applied) {
                note(&mut self.command_to_applied, answered, applied);
            }
            note(&mut self.sensed_to_applied, lap.sensed, end);
            note(&mut self.scheduled_to_applied, lap.scheduled, end);
            // What the stall before it has swallowed.
            let before = if i == 0 { lap.tick } else { tick_times[i - 1].tick + 1 };
            for passed in before.max(from)..lap.tick {
                let scheduled = lap.scheduled.saturating_sub((lap.tick - passed) * period);
                note(&mut self.scheduled_to_sensed, scheduled, lap.sensed);
                note(&mut self.scheduled_to_applied, scheduled, end);
                self.swallowed += 1;
            }
        }
    }

    /// Takes the latencies of another block in.
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
        self.swallowed += block.swallowed;
    }

    /// The five in the order of [`SERIES`].
    pub fn series(&self) -> [&Histogram<u64>; 5] {
        [
            &self.scheduled_to_sensed,
            &self.sensed_to_command,
            &self.command_to_applied,
            &self.sensed_to_applied,
            &self.scheduled_to_applied,
        ]
    }

    /// Their percentiles.
    pub fn percentiles(&self) -> SeriesPercentiles {
        let [scheduled_to_sensed_us, sensed_to_command_us, command_to_applied_us, round, whole] =
            self.series().map(Percentiles::of);
        SeriesPercentiles {
            scheduled_to_sensed_us,
            sensed_to_command_us,
            command_to_applied_us,
            sensed_to_applied_us: round,
            scheduled_to_applied_us: whole,
        }
    }
}

fn note(histogram: &mut Histogram<u64>, from: u64, to: u64) {
    histogram.saturating_record(to.saturating_sub(from));
}

/// The percentiles of all series, us; null where there was nothing to time.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub struct SeriesPercentiles {
    /// From the scheduled instant to the sensed one.
    pub scheduled_to_sensed_us: Option<Percentiles>,
    /// From there to the sending of the command.
    pub sensed_to_command_us: Option<Percentiles>,
    /// From there to its being applied.
    pub command_to_applied_us: Option<Percentiles>,
    /// The last two together.
    pub sensed_to_applied_us: Option<Percentiles>,
    /// The whole.
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

/// A histogram of nanoseconds as HdrHistogram's text, in us: the percentile distribution that its plotting tools read.
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

    fn lap(tick: u64, sensed: u64, answered: Option<u64>, applied: Option<u64>) -> TickTimes {
        let scheduled = (100 + 50 * tick) * MS;
        let at = |ms: u64| scheduled + ms * MS;
        TickTimes { tick, scheduled, sensed: at(sensed), answered: answered.map(at), applied: applied.map(at) }
    }

    fn values(histogram: &Histogram<u64>) -> Vec<u64> {
        let recorded = histogram.iter_recorded();
        recorded.flat_map(|v| vec![(v.value_iterated_to() + MS / 4) / MS; v.count_at_value() as usize]).collect()
    }

    #[test]
    fn a_tick_is_timed_from_its_scheduled_instant() {
        let mut found = Latencies::default();
        found.record(&[lap(0, 1, Some(3), Some(51)), lap(1, 2, Some(6), Some(53))], 0, 50 * MS);
        assert_eq!(found.series().map(values), [vec![1, 2], vec![2, 4], vec![47, 48], vec![50, 51], vec![51, 53]]);
        assert_eq!((found.ticks, found.missed, found.swallowed), (2, 0, 0));
    }

    #[test]
    fn a_stall_adds_the_ticks_that_it_swallowed() {
        let mut found = Latencies::default();
        // Ticks 1 and 2 were passed over: the asking side was back 7 ms into tick 3.
        found.record(&[lap(0, 1, Some(2), Some(3)), lap(3, 7, Some(9), Some(10))], 0, 50 * MS);
        assert_eq!(values(&found.scheduled_to_sensed), [1, 7, 57, 107]);
        assert_eq!(values(&found.scheduled_to_applied), [3, 10, 60, 110]);
        assert_eq!(values(&found.sensed_to_command), [1, 2], "nothing was sensed in those");
        assert_eq!((found.ticks, found.swallowed), (2, 2));
    }

    #[test]
    fn what_was_never_answered_waited_until_a_later_one_was() {
        let mut found = Latencies::default();
        let tick_times = [lap(0, 0, None, None), lap(1, 0, Some(4), None), lap(2, 0, Some(5), Some(6))];
        found.record(&tick_times, 0, 50 * MS);
        assert_eq!(values(&found.sensed_to_command), [4, 5, 54]);
        assert_eq!(values(&found.sensed_to_applied), [6, 56, 106]);
        assert_eq!(values(&found.command_to_applied), [1]);
        assert_eq!((found.ticks, found.missed), (3, 2));
    }

    #[test]
    fn the_beginning_warms_up_and_the_end_is_open() {
        let mut found = Latencies::default();
        let tick_times = [lap(0, 9, Some(9), Some(9)), lap(1, 1, Some(2), Some(3)), lap(2, 8, Some(9), None)];
        found.record(&tick_times, 1, 50 * MS);
        assert_eq!((values(&found.scheduled_to_sensed), found.ticks, found.missed), (vec![1], 1, 0));
        found.record(&[], 0, 50 * MS);
        assert_eq!(found.ticks, 1);
    }

    #[test]
    fn the_text_of_a_histogram_ends_with_all_of_it() {
        let mut found = histogram();
        for ns in 1..=1000 {
            found.record(ns * 1000).unwrap();
        }
        let text = hgrm(&found);
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
