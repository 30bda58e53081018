//! How far the other machine's clock is ahead of this one's.
//!
//! Of many round trips the one that took least time says most: the offset is known to half of that time, whatever the
//! network did. Only the trips of the last seconds count, because clocks drift.

use std::collections::VecDeque;

use crate::message::EchoMessage;

/// Round trips that count.
const TRIPS: usize = 64;
/// Round trips after which the offset is believed.
const ENOUGH: usize = 4;

/// The estimate.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Serialize)]
pub struct ClockOffset {
    /// The other clock less this one, ns.
    pub offset_ns: i64,
    /// The true offset differs by this at most, ns.
    pub uncertainty_ns: u64,
    /// The shortest round trip, ns.
    pub round_trip_ns: u64,
}

impl ClockOffset {
    /// An instant of the other clock on this one, ns.
    pub fn to_own(self, other_ns: u64) -> u64 {
        other_ns.saturating_add_signed(self.offset_ns.saturating_neg())
    }
}

/// Collects round trips.
#[derive(Debug, Default)]
pub struct OffsetEstimator {
    trips: VecDeque<ClockOffset>,
}

impl OffsetEstimator {
    /// Takes an echo that has come back at `now_ns`. Echoes that cannot be true are ignored.
    pub fn take(&mut self, echo: &EchoMessage, now_ns: u64) {
        let EchoMessage { sent_ns, received_ns, returned_ns } = *echo;
        let (Some(away), Some(there)) = (now_ns.checked_sub(sent_ns), returned_ns.checked_sub(received_ns)) else {
            return;
        };
        let Some(round_trip_ns) = away.checked_sub(there) else { return };
        let middle = |from: u64, to: u64| i128::midpoint(i128::from(from), i128::from(to));
        let offset = middle(received_ns, returned_ns) - middle(sent_ns, now_ns);
        let Ok(offset_ns) = i64::try_from(offset) else { return };
        if self.trips.len() == TRIPS {
            self.trips.pop_front();
        }
        self.trips.push_back(ClockOffset { offset_ns, uncertainty_ns: round_trip_ns.div_ceil(2) + 1, round_trip_ns });
    }

    /// Forgets all, because the other clock is another one now.
    pub fn clear(&mut self) {
        self.trips.clear();
    }

    /// The best estimate, after enough round trips.
    pub fn best(&self) -> Option<ClockOffset> {
        let best = self.trips.iter().min_by_key(|trip| trip.round_trip_ns);
        best.copied().filter(|_| self.trips.len() >= ENOUGH)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The true offset lies within the stated uncertainty, however unequal the two ways are.
    #[test]
    fn the_truth_lies_within_the_uncertainty() {
        let mut state = 1_u64;
        let mut random = |below: u64| {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 33) % below
        };
        for offset in [-5_000_000_000_i64, -1, 0, 12_345, 7_000_000_000] {
            let mut estimator = OffsetEstimator::default();
            let mut now = 10_000_000_000_u64;
            for trip in 0..200 {
                assert_eq!(estimator.best().is_some(), trip >= ENOUGH);
                let (out, there, back) = (50_000 + random(20_000_000), random(100_000), 50_000 + random(1_000_000));
                let received = (now + out).checked_add_signed(offset).unwrap();
                let echo = EchoMessage { sent_ns: now, received_ns: received, returned_ns: received + there };
                now += out + there + back;
                estimator.take(&echo, now);
            }
            let best = estimator.best().unwrap();
            assert!(best.offset_ns.abs_diff(offset) <= best.uncertainty_ns, "{offset}: {best:?}");
            assert!(best.uncertainty_ns < 11_000_000, "{best:?}");
            assert_eq!(best.to_own(20_000_000_000).abs_diff(20_000_000_000), best.offset_ns.unsigned_abs());
        }
    }

    #[test]
    fn impossible_echoes_are_ignored() {
        let mut estimator = OffsetEstimator::default();
        for (sent_ns, received_ns, returned_ns) in [(9, 1, 1), (1, 5, 2), (1, 1, 100), (u64::MAX, 0, 0)] {
            estimator.take(&EchoMessage { sent_ns, received_ns, returned_ns }, 5);
        }
        assert!(estimator.trips.is_empty());
    }
}
