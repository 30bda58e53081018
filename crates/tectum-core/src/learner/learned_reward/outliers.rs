//! Which rewards the model believes.
//!
//! A reward that contradicts the model may tell of a change of the world, or it may be wrong: a sensor that
//! failed for a tick, a number that was corrupted. The model would fit either, and a wrong one that is a thousand
//! times as large as all others would ruin its weights for good. So a reward is an *outlier* if its error is
//! large for the model, and large compared with all rewards that were believed. The model does not learn from
//! it. Several outliers in a row are no accident: rewards have another size now, and the model begins anew. A
//! change of the world whose rewards are of the usual size is no matter for this file.

use crate::state::{Persist, StateVisitor};

/// Normalised squared error from which a reward can be an outlier.
const LARGE_ERROR: f64 = 25.0;
/// Size of an outlier's error, in multiples of the range of rewards.
const RANGE_FACTOR: f64 = 2.0;
/// Outliers in a row after which they are believed; and the same while no reward was believed yet, when there is
/// nothing that they contradict.
const NEW_SIZE_TICKS: u32 = 50;
const FIRST_SIZE_TICKS: u32 = 8;

/// What is to be done with a reward.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum RewardVerdict {
    /// Learn from it.
    Believe,
    /// Leave it out.
    LeaveOut,
    /// Rewards are this many times as large as the prior has them: forget the model.
    NewSize(f64),
}

/// The range of the rewards that were believed, and counts of outliers.
#[derive(Debug, Clone)]
pub(super) struct OutlierFilter {
    /// Prior standard deviation of the model's weights. A range is never taken to be smaller.
    spread: f64,
    /// Least and greatest reward. They include 0, which the model predicts at first.
    range: [f64; 2],
    /// The same of the outliers in a row up to now.
    doubted_range: [f64; 2],
    doubted: u32,
    /// Whether a reward was believed.
    any_believed: bool,
    /// Outliers that were left out.
    left_out: u64,
}

impl OutlierFilter {
    /// A filter for a model whose weights have the prior standard deviation `spread`.
    pub fn new(spread: f64) -> Self {
        let none = [0.0; 2];
        Self { spread, range: none, doubted_range: none, doubted: 0, any_believed: false, left_out: 0 }
    }

    /// Number of rewards left out.
    pub fn left_out(&self) -> u64 {
        self.left_out
    }

    /// Judges `reward`, which differs from the prediction by `error`; `surprise` is the square of that in units of
    /// its expected variance.
    pub fn judge(&mut self, reward: f64, error: f64, surprise: f64) -> RewardVerdict {
        let range = (self.range[1] - self.range[0]).max(self.spread);
        if surprise < LARGE_ERROR || error.abs() <= RANGE_FACTOR * range {
            self.believe(reward);
            return RewardVerdict::Believe;
        }
        self.doubted_range = with(self.doubted_range, reward);
        self.doubted += 1;
        self.left_out += 1;
        if self.doubted < if self.any_believed { NEW_SIZE_TICKS } else { FIRST_SIZE_TICKS } {
            return RewardVerdict::LeaveOut;
        }
        self.range = self.doubted_range;
        self.believe(reward);
        RewardVerdict::NewSize((self.range[1] - self.range[0]) / self.spread)
    }

    /// Takes `reward` into the range.
    pub fn believe(&mut self, reward: f64) {
        self.range = with(self.range, reward);
        self.doubted_range = [0.0; 2];
        self.doubted = 0;
        self.any_believed = true;
    }
}

/// The range that also contains `reward`.
fn with([least, greatest]: [f64; 2], reward: f64) -> [f64; 2] {
    [least.min(reward), greatest.max(reward)]
}

impl Persist for OutlierFilter {
    fn visit_state(&mut self, visitor: &mut dyn StateVisitor) {
        visitor.numbers("range", &mut self.range);
        visitor.numbers("doubted_range", &mut self.doubted_range);
        visitor.number("doubted", &mut self.doubted);
        visitor.boolean("any_believed", &mut self.any_believed);
        visitor.number("left_out", &mut self.left_out);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn single_outliers_are_left_out_and_a_new_size_is_believed() {
        let mut filter = OutlierFilter::new(1.0);
        // Large for the model, and of the usual size; large and expected.
        assert_eq!(filter.judge(-3.0, -2.0, 1e6), RewardVerdict::Believe);
        assert_eq!(filter.judge(-100.0, -6.1, 24.0), RewardVerdict::Believe);
        let mut filter = OutlierFilter::new(1.0);
        filter.believe(-3.0);
        assert_eq!(filter.judge(-9.0, -6.0, 1e6), RewardVerdict::Believe, "twice the range of 0 to -3");
        for _ in 0..100 {
            assert_eq!(filter.judge(-1000.0, -997.0, 1e6), RewardVerdict::LeaveOut);
            assert_eq!(filter.judge(-3.0, 0.0, 0.0), RewardVerdict::Believe);
        }
        assert_eq!(filter.left_out(), 100);
        for _ in 1..NEW_SIZE_TICKS {
            assert_eq!(filter.judge(-1000.0, -997.0, 1e6), RewardVerdict::LeaveOut);
        }
        assert_eq!(filter.judge(-1000.0, -997.0, 1e6), RewardVerdict::NewSize(1000.0));
        assert_eq!(filter.judge(-2000.0, -2000.0, 1e6), RewardVerdict::Believe);
    }
}
