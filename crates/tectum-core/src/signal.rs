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
}
