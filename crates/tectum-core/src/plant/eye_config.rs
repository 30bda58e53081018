//! `[plant.eye]`: the configuration of the saccading eye.

use serde::{Deserialize, Serialize};

/// `[plant.eye]`: the saccades of section 4.1; each tick is one saccade.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct EyeConfig {
    /// How the retina reports position and velocity.
    pub retina: Retina,
    /// The log-polar distortion B.
    pub distortion: f64,
    /// Standard deviation of each component of position and velocity.
    pub spread: f64,
    /// The constant b in the reward.
    pub bonus: f64,
}

/// Coordinates in which the retina reports position and velocity.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Retina {
    /// Cartesian x and y.
    Linear,
    /// `log(1 + B rho) / log(1 + B)` and the direction.
    LogPolar,
}

impl Default for EyeConfig {
    fn default() -> Self {
        Self { retina: Retina::LogPolar, distortion: 4.0, spread: 0.3, bonus: 0.5 }
    }
}
