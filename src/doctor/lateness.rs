//! Measures how late threads wake up. Two threads sleep until absolute instants at the same time, half a period
//! apart: one under the ordinary scheduler, and one under SCHED_FIFO if that is allowed.

use std::fmt::Write as _;

use hdrhistogram::Histogram;
use serde::Serialize;

use super::Check;
use crate::clock::{monotonic_ns, precise_timers, priority_limit, set_fifo_priority, sleep_until};
use crate::stats::Percentiles;

/// Period of the wake-ups, ns. Much shorter than a tick, to get many samples.
const PERIOD_NS: u64 = 5_000_000;
/// The SCHED_FIFO priority to measure with, unless only a lower one is allowed.
const PRIORITY: u64 = 80;
/// Up to this p99 of the better scheduler the result is fine, us.
const FINE_US: f64 = 1_000.0;
/// From this p99 on, the default period of 50 ms is missed again and again, us.
const PROBLEM_US: f64 = 50_000.0;

/// The measured wake-up lateness.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Lateness {
    /// Period of the wake-ups, ms.
    pub period_ms: f64,
    /// Duration of the measurement, s.
    pub seconds: u32,
    /// Lateness under the ordinary scheduler, us.
    pub ordinary_us: Option<Percentiles>,
    /// Lateness under SCHED_FIFO, us; null where that is not allowed.
    pub fifo_us: Option<Percentiles>,
    /// The SCHED_FIFO priority; null where it is not allowed.
    pub fifo_priority: Option<u32>,
    /// Why SCHED_FIFO was refused.
    pub refused: Option<String>,
}

/// Measures for `seconds`.
pub(super) fn measure(seconds: u32) -> Lateness {
    let priority = priority_limit().clamp(1, PRIORITY) as u32;
    let ticks = u64::from(seconds) * 1_000_000_000 / PERIOD_NS;
    let start = monotonic_ns() + PERIOD_NS;
    let fifo_thread =
        std::thread::spawn(move || set_fifo_priority(priority).map(|()| measure_thread(start + PERIOD_NS / 2, ticks)));
    let ordinary_thread = std::thread::spawn(move || measure_thread(start, ticks));
    // The threads cannot panic; if one did, its value is missing.
    let ordinary_us = ordinary_thread.join().ok().flatten();
    let (fifo_us, refused) = match fifo_thread.join() {
        Ok(Ok(percentiles)) => (percentiles, None),
        Ok(Err(why)) => (None, Some(why)),
        Err(_) => (None, None),
    };
    Lateness {
        period_ms: PERIOD_NS as f64 / 1e6,
        seconds,
        ordinary_us,
        fifo_us,
        fifo_priority: fifo_us.is_some().then_some(priority),
        refused,
    }
}

/// Wakes up `ticks` times. An instant that has already passed counts as a wake-up at once, with its lateness.
fn measure_thread(start: u64, ticks: u64) -> Option<Percentiles> {
    precise_timers();
    let mut lateness_ns = Histogram::<u64>::new_with_max(60_000_000_000, 3).ok()?;
    for tick in 0..ticks {
        let at = start + tick * PERIOD_NS;
        // A signal may end the sleep early.
        while monotonic_ns() < at {
            sleep_until(at);
        }
        lateness_ns.saturating_record(monotonic_ns() - at);
    }
    Percentiles::of(&lateness_ns)
}

impl Lateness {
    /// The verdict on the better scheduler that a run may use.
    pub(super) fn check(&self) -> Check {
        let name = "wake-up lateness";
        let (scheduler, best) = match (self.fifo_us, self.ordinary_us) {
            (Some(fifo), _) => ("SCHED_FIFO", fifo),
            (None, Some(ordinary)) => ("the ordinary scheduler", ordinary),
            (None, None) => return Check::problem(name, "could not be measured", "allow two threads"),
        };
        let found = format!("p99 {:.0} us, max {:.0} us under {scheduler}", best.p99, best.max);
        let remedy = "end what else computes, see the lines above, and give the plant a `priority` and `cores` of its \
                      own under [realtime.plant]";
        match best.p99 {
            p99 if p99 <= FINE_US => Check::fine(name, found),
            p99 if p99 < PROBLEM_US => Check::better(name, found, remedy),
            _ => Check::problem(name, found, format!("ticks of 50 ms would be missed: {remedy}")),
        }
    }

    /// One line per scheduler.
    pub(super) fn to_text(&self) -> String {
        let mut text = format!("wake-up lateness, every {} ms for {} s\n", self.period_ms, self.seconds);
        let fifo = self.fifo_priority.map_or_else(|| "SCHED_FIFO".to_owned(), |p| format!("SCHED_FIFO {p}"));
        for (name, percentiles) in [("ordinary scheduler", self.ordinary_us), (&fifo, self.fifo_us)] {
            let _ = match percentiles {
                Some(p) => writeln!(
                    text,
                    "  {name:<18} p50 {:.0} us  p99 {:.0} us  p99.9 {:.0} us  max {:.0} us  ({} wake-ups)",
                    p.p50, p.p99, p.p999, p.max, p.count
                ),
                None => {
                    let why = self.refused.as_deref().unwrap_or("not measured");
                    writeln!(text, "  {name:<18} {why}")
                }
            };
        }
        text
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::doctor::Verdict;

    #[test]
    fn a_second_has_two_hundred_wake_ups_per_thread() {
        let found = measure(1);
        assert_eq!(found.ordinary_us.unwrap().count, 200);
        assert_eq!(found.fifo_us.is_some(), found.refused.is_none());
        assert!(found.fifo_us.is_none_or(|p| p.count == 200));
        assert_eq!(found.to_text().lines().count(), 3);
    }

    #[test]
    fn the_better_scheduler_decides_the_verdict() {
        let p = |p99| Some(Percentiles { count: 1, p99, max: p99, ..Percentiles::default() });
        let found = |ordinary_us, fifo_us| Lateness {
            period_ms: 5.0,
            seconds: 1,
            ordinary_us,
            fifo_us,
            fifo_priority: None,
            refused: None,
        };
        for (ordinary, fifo, verdict) in [
            (p(90_000.0), p(200.0), Verdict::Fine),
            (p(900.0), None, Verdict::Fine),
            (p(200.0), p(3_000.0), Verdict::CouldBeBetter),
            (p(90_000.0), None, Verdict::Problem),
            (None, None, Verdict::Problem),
        ] {
            assert_eq!(found(ordinary, fifo).check().verdict, verdict);
        }
    }
}
