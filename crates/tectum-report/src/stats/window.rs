//! Means over a window of a run's ticks.

use serde::{Deserialize, Deserializer, Serialize};

/// Means over some ticks in a row. Errors are in the plant's unit: metres for the arm.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Window {
    /// First tick.
    pub from: u64,
    /// Number of ticks.
    pub ticks: u64,
    /// Mean loss (reward with its sign turned) per tick; not a number if a reward was none.
    #[serde(deserialize_with = "number_or_nan")]
    pub loss: f64,
    /// What exploration noise alone costs a tick, part of the loss; 0 if unknown.
    pub noise_share: f64,
    /// Mean squared error, in squared units; `None` for a plant that measures none.
    pub mean_squared_error: Option<f64>,
    /// Mean error at the end of the targets that ended here; `None` if none did.
    pub end_error: Option<f64>,
    /// Number of targets that ended here.
    pub ends: u64,
}

/// Reads a number for which JSON, which has no "not a number", may hold null. A run that diverged must still get its
/// report.
pub fn number_or_nan<'de, D: Deserializer<'de>>(from: D) -> Result<f64, D::Error> {
    Ok(Option::<f64>::deserialize(from)?.unwrap_or(f64::NAN))
}

impl Window {
    /// Mean loss a tick without what exploration noise alone costs.
    pub fn loss_without_noise(&self) -> f64 {
        self.loss - self.noise_share
    }

    /// Square root of the mean squared error, in the unit of errors.
    pub fn rms_error(&self) -> Option<f64> {
        self.mean_squared_error.map(f64::sqrt)
    }

    /// Two windows as one.
    pub fn and(&self, other: &Self) -> Self {
        let (a, b) = (self, other);
        let mean = |x: f64, n: u64, y: f64, m: u64| (x * n as f64 + y * m as f64) / (n + m) as f64;
        Self {
            from: a.from.min(b.from),
            ticks: a.ticks + b.ticks,
            noise_share: mean(a.noise_share, a.ticks, b.noise_share, b.ticks),
            loss: mean(a.loss, a.ticks, b.loss, b.ticks),
            mean_squared_error: a
                .mean_squared_error
                .zip(b.mean_squared_error)
                .map(|(x, y)| mean(x, a.ticks, y, b.ticks)),
            end_error: match (a.end_error, b.end_error) {
                (Some(x), Some(y)) => Some(mean(x, a.ends, y, b.ends)),
                (x, y) => x.or(y),
            },
            ends: a.ends + b.ends,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn windows_without_an_end_do_not_dilute_those_with_one() {
        let without = Window { from: 0, ticks: 10, loss: 1.0, ..Window::default() };
        let with = Window { from: 10, ticks: 10, loss: 3.0, end_error: Some(0.5), ends: 1, ..Window::default() };
        let both = without.and(&with);
        assert_eq!((both.loss, both.end_error, both.ends), (2.0, Some(0.5), 1));
    }
}
