//! Measures nanoseconds per call: many short batches of each case, in turns, so that a slow moment of the
//! machine affects all cases alike.

use std::hint::black_box;
use std::time::Duration;

use serde::Serialize;

use super::{TimingError, check_signals};
use crate::clock::{TerminationSignals, monotonic_ns};
use crate::simd::SimdPath;
use crate::stats::Spread;

/// The duration of a batch, about, ns: long against reading the clock, short against a time slice of the scheduler.
const BATCH_NS: u64 = 100_000;

/// A piece of code to time.
pub struct CallCase<'a, K> {
    /// Tells it from other cases.
    pub key: K,
    calls: Box<dyn FnMut(u64) + 'a>,
}

impl<'a, K> CallCase<'a, K> {
    /// A case that consists of `call`.
    pub(super) fn new(key: K, mut call: impl FnMut() + 'a) -> Self {
        let calls = move |n: u64| {
            for _ in 0..n {
                call();
            }
        };
        Self { key, calls: Box::new(calls) }
    }

    /// The time of `n` calls.
    pub fn time(&mut self, n: u64) -> Duration {
        let began = monotonic_ns();
        (self.calls)(n);
        Duration::from_nanos(monotonic_ns() - began)
    }
}

/// Names a case whose cost grows with the number of features.
#[derive(Debug, Clone)]
pub struct GrowthKey {
    /// What is called.
    pub what: String,
    /// On which SIMD path.
    pub path: SimdPath,
    /// Number of features.
    pub features: u64,
    /// Number of outputs; 1 where there are none.
    pub outputs: u64,
}

/// The time of a call, over batches, ns.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct CallTimes {
    /// Median of the batches.
    pub median: f64,
    /// The quickest batch.
    pub min: f64,
    /// The slowest batch.
    pub max: f64,
    /// Calls in a batch.
    pub calls: u64,
    /// Batches.
    pub batches: u64,
}

/// Runs `batches` batches of each case, in turns.
///
/// # Errors
/// [`TimingError::Signal`] when a signal comes.
pub fn in_turns<K>(
    mut cases: Vec<CallCase<K>>,
    batches: u64,
    signals: &TerminationSignals,
) -> Result<Vec<(K, CallTimes)>, TimingError> {
    let mut calls = Vec::with_capacity(cases.len());
    for case in &mut cases {
        calls.push(calibrate(|n| timed(case, n)));
        check_signals(signals)?;
    }
    let mut times = vec![Vec::with_capacity(batches as usize); cases.len()];
    for _ in 0..batches {
        check_signals(signals)?;
        for ((case, &calls), times) in cases.iter_mut().zip(&calls).zip(&mut times) {
            times.push(timed(case, calls) as f64 / calls as f64);
        }
    }
    let results = cases.into_iter().zip(calls).zip(times).filter_map(|((case, calls), times)| {
        let Spread { min, median, max } = Spread::of(times)?;
        Some((case.key, CallTimes { median, min, max, calls, batches }))
    });
    Ok(results.collect())
}

/// The time of `calls` calls, ns.
fn timed<K>(case: &mut CallCase<K>, calls: u64) -> u64 {
    // This call is not timed. It brings back into the caches what the other cases have evicted.
    case.time(1);
    case.time(black_box(calls)).as_nanos() as u64
}

/// The number of calls that take about [`BATCH_NS`]. `time` gives the nanoseconds of a number of calls.
fn calibrate(mut time: impl FnMut(u64) -> u64) -> u64 {
    let mut calls = 1;
    loop {
        let ns = time(calls).max(1);
        if ns >= BATCH_NS / 4 || calls >= 1 << 20 {
            return (calls as f64 * BATCH_NS as f64 / ns as f64).round().max(1.0) as u64;
        }
        calls *= 2;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::cell::RefCell;

    #[test]
    fn cases_take_turns() {
        let order = RefCell::new(Vec::new());
        let case = |key: &'static str| CallCase {
            key,
            calls: Box::new({
                let order = &order;
                move |_| order.borrow_mut().push(key)
            }),
        };
        let times = in_turns(vec![case("a"), case("b"), case("c")], 3, &TerminationSignals::default()).unwrap();
        assert_eq!(times.iter().map(|(key, _)| *key).collect::<String>(), "abc");
        assert!(times.iter().all(|(_, ns)| ns.batches == 3 && ns.min <= ns.median && ns.median <= ns.max));
        drop(times);
        // Each batch is two runs of a case, the first of them to warm up. The runs before the last 18 calibrate.
        let order = order.into_inner();
        assert_eq!(order[order.len() - 18..].concat(), "aabbccaabbccaabbcc");
    }

    #[test]
    fn calibration_fills_a_batch() {
        for (ns, calls) in [(100, 1000), (7, BATCH_NS / 7), (2_000_000, 1), (60_000, 2)] {
            let found = calibrate(|n| n * ns);
            assert!(found.abs_diff(calls) <= 1, "{ns} {found}");
        }
    }
}
