//! What a call takes: many short batches of each case, in turns, so that a slow moment of the machine befalls all alike, and
//! the least and the middle batch as numbers.

use std::hint::black_box;

use serde::Serialize;

use super::BenchError;
use crate::clock::{TerminationSignals, monotonic_ns};
use crate::study::Spread;

/// Calls of a batch take about this long, ns: long against looking at the clock, short against a slice of the scheduler.
const BATCH_NS: u64 = 100_000;

/// A case: calls `n` times what it is about.
pub(super) struct CallCase<'a, K> {
    /// What tells it from the others.
    pub key: K,
    /// Does it so many times.
    pub calls: Box<dyn FnMut(u64) + 'a>,
}

impl<'a, K> CallCase<'a, K> {
    /// The case of one call.
    pub fn new(key: K, mut call: impl FnMut() + 'a) -> Self {
        let calls = move |n: u64| {
            for _ in 0..n {
                call();
            }
        };
        Self { key, calls: Box::new(calls) }
    }
}

/// What a call took, ns.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct CallTimes {
    /// The middle batch.
    pub median: f64,
    /// The quickest.
    pub min: f64,
    /// The slowest.
    pub max: f64,
    /// Calls in a batch.
    pub calls: u64,
    /// Batches.
    pub batches: u64,
}

/// Runs `batches` batches of each case, in turns.
pub(super) fn in_turns<K>(
    mut cases: Vec<CallCase<K>>,
    batches: u64,
    signals: &TerminationSignals,
) -> Result<Vec<(K, CallTimes)>, BenchError> {
    let mut calls = Vec::with_capacity(cases.len());
    for case in &mut cases {
        calls.push(calibrate(|n| timed(case, n)));
        interrupted(signals)?;
    }
    let mut found = vec![Vec::with_capacity(batches as usize); cases.len()];
    for _ in 0..batches {
        interrupted(signals)?;
        for ((case, &calls), found) in cases.iter_mut().zip(&calls).zip(&mut found) {
            found.push(timed(case, calls) as f64 / calls as f64);
        }
    }
    let told = cases.into_iter().zip(calls).zip(found).filter_map(|((case, calls), found)| {
        let Spread { min, median, max } = Spread::of(found)?;
        Some((case.key, CallTimes { median, min, max, calls, batches }))
    });
    Ok(told.collect())
}

fn interrupted(signals: &TerminationSignals) -> Result<(), BenchError> {
    match signals.received() {
        0 => Ok(()),
        number => Err(BenchError::Signal(number)),
    }
}

fn timed<K>(case: &mut CallCase<K>, calls: u64) -> u64 {
    // Not timed: brings back into the caches what the other cases have driven out.
    (case.calls)(1);
    let began = monotonic_ns();
    (case.calls)(black_box(calls));
    monotonic_ns() - began
}

/// How many calls make a batch.
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
                move |_| {
                    // Each batch is two calls of this, the first of them to warm up.
                    order.borrow_mut().push(key);
                }
            }),
        };
        // Whatever calls take, the last batches are in turns.
        let found = in_turns(vec![case("a"), case("b"), case("c")], 3, &TerminationSignals::default()).unwrap();
        assert_eq!(found.iter().map(|(key, _)| *key).collect::<String>(), "abc");
        assert!(found.iter().all(|(_, ns)| ns.batches == 3 && ns.min <= ns.median && ns.median <= ns.max));
        drop(found);
        let order = order.into_inner();
        assert_eq!(order[order.len() - 18..].concat(), "aabbccaabbccaabbcc");
    }

    #[test]
    fn a_batch_is_as_many_calls_as_its_time_holds() {
        for (ns, calls) in [(100, 1000), (7, BATCH_NS / 7), (2_000_000, 1), (60_000, 2)] {
            let found = calibrate(|n| n * ns);
            assert!(found.abs_diff(calls) <= 1, "{ns} {found}");
        }
    }
}
