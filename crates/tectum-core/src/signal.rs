//! Description of inputs and outputs: name, unit and range.

use serde::{Deserialize, Serialize};

/// One input or output: its name, unit and range.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SignalConfig {
    /// Name by which maps refer to it.
    pub name: String,
    /// Unit, for display and logs.
    #[serde(default)]
    pub unit: String,
    /// Lower end of the range, in the unit.
    pub min: f64,
    /// Upper end of the range, in the unit.
    pub max: f64,
    /// Whether the input goes on at the lower end of its range when it passes the upper end, as a direction does.
    /// Left out: it does if its unit is `rad` and its range a full turn.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub wraps: Option<bool>,
}

impl SignalConfig {
    /// Whether the input wraps around at the ends of its range.
    pub fn wraps(&self) -> bool {
        let full_turn = || ((self.max - self.min) / std::f64::consts::TAU - 1.0).abs() < 1e-6;
        self.wraps.unwrap_or_else(|| self.unit == "rad" && full_turn())
    }
}
