//! What of a tick is believed: single values far from their prediction teach nothing, two in a row are a new world.
//!
//! A value is an outlier if its squared error is at least 25 predictive variances and exceeds 4 times its usual
//! change. A running mean of the squared errors in units of their variance that stays high is an alarm: the world is
//! another one.

use crate::state::StateVisitor;

/// Squared errors from here on, in predictive variances, are outliers.
const OUTLIER: f64 = 25.0;

/// Part of the usual change's square below which a squared error is small.
const SMALL: f64 = 0.02;

/// Belief in one value.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Belief {
    /// Mean square of its change from tick to tick.
    pub usual: f64,
    seen: f64,
    /// Running mean of the squared errors.
    surprise: f64,
    /// Whether the last value was an outlier.
    pub doubted: bool,
}

/// What to do with a value.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum BeliefVerdict {
    /// Learn it.
    Believed,
    /// Leave it out.
    Outlier,
    /// Learn it, and the one before, which was left out.
    Both,
}

impl Belief {
    /// Whether an error is an outlier's.
    pub fn is_wild(&self, surprise: f64, error: f64) -> bool {
        surprise >= OUTLIER && error * error > 16.0 * self.usual
    }

    /// Judges a value with its squared error in predictive variances, its error and its change.
    pub fn judge(&mut self, surprise: f64, error: f64, change: f64, rate: f64) -> BeliefVerdict {
        let wild = self.is_wild(surprise, error);
        if wild && !self.doubted {
            self.doubted = true;
            return BeliefVerdict::Outlier;
        }
        // An error that is small beside the usual change is no alarm, however precise the model was.
        let matters = (error * error / (SMALL * self.usual + f64::MIN_POSITIVE)).min(1.0);
        self.surprise += rate * (matters * surprise.min(OUTLIER) - self.surprise);
        self.seen += 1.0;
        self.usual += (change * change - self.usual) / self.seen.min(200.0);
        let both = wild && self.doubted;
        self.doubted = false;
        if both { BeliefVerdict::Both } else { BeliefVerdict::Believed }
    }

    /// Whether the errors have been too large for a while.
    pub fn alarmed(&self, level: f64) -> bool {
        self.surprise > level
    }

    /// Begins to measure anew.
    pub fn calm(&mut self) {
        self.surprise = 0.0;
    }

    /// Passes on the state.
    pub fn visit(&mut self, visitor: &mut dyn StateVisitor) {
        let mut numbers = [self.usual, self.seen, self.surprise];
        visitor.numbers("belief", &mut numbers);
        [self.usual, self.seen, self.surprise] = numbers;
        visitor.boolean("doubted", &mut self.doubted);
    }
}
