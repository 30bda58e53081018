//! The scenario as it stands in its TOML file: one struct a table, every key with its unit, every default named.
//!
//! Unknown keys are refused. What the types cannot say (ranges, references between tables) is checked by
//! [`Scenario::plan`](super::Scenario::plan).

use serde::{Deserialize, Serialize};

use super::{
    EncoderConfig, FaultsConfig, GateConfig, LearnerConfig, Noise, OverrunConfig, PlantConfig, RealtimeConfig,
    RestartConfig, ScenarioSource,
};
use crate::wire::ChannelNames;

/// A whole scenario file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Scenario {
    /// Short name, used for the run's folder: letters, digits, `-` and `_`.
    pub name: String,
    /// Seed of every random stream.
    #[serde(default = "one")]
    pub seed: u64,
    /// Period of the tick, ms; 1 to 1000.
    #[serde(default = "fifty")]
    pub period_ms: f64,
    /// Ticks of a run; at least 2.
    pub ticks: u64,
    /// What is controlled.
    pub plant: PlantConfig,
    /// How inputs become features.
    pub encoder: EncoderConfig,
    /// How features become commands.
    #[serde(default)]
    pub policy: PolicyConfig,
    /// How rewards become weights.
    #[serde(default)]
    pub learner: LearnerConfig,
    /// What the plant does with commands that are late, missing or out of range.
    #[serde(default)]
    pub gate: GateConfig,
    /// What is written down.
    #[serde(default)]
    pub log: LogConfig,
    /// The names of the channels.
    #[serde(default)]
    pub channels: ChannelNames,
    /// What happens when a process dies or hangs.
    #[serde(default, skip_serializing_if = "RestartConfig::is_usual")]
    pub restart: RestartConfig,
    /// What each process asks of the operating system in real time.
    #[serde(default, skip_serializing_if = "RealtimeConfig::is_nothing")]
    pub realtime: RealtimeConfig,
    /// What the plant does when it cannot keep its own deadlines.
    #[serde(default, skip_serializing_if = "OverrunConfig::is_nothing")]
    pub overrun: OverrunConfig,
    /// What is made to go wrong, on purpose.
    #[serde(default, skip_serializing_if = "FaultsConfig::is_nothing")]
    pub faults: FaultsConfig,
    /// Where the scenario came from, for messages; not a key of the file, not compared and not hashed.
    #[serde(skip)]
    pub source: ScenarioSource,
}

/// `[policy]`: `u = W g + noise` (section 3.2).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PolicyConfig {
    /// Standard deviation of the exploration noise, in units of the command.
    pub sigma: f64,
    /// How the noise is distributed.
    pub noise: Noise,
}

/// `[log]`: what is written down.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LogConfig {
    /// Write every N-th tick; 1 writes all.
    pub every: u64,
    /// Hash the weights every N-th tick.
    pub hash_every: u64,
}

impl Scenario {
    /// The name of the channel on which trackers say what they see, if this scenario has one.
    pub fn vision(&self) -> Option<&str> {
        let looked_at = self.plant.servos.as_ref().is_some_and(|servos| !servos.sight.is_model());
        looked_at.then_some(self.channels.vision.as_str())
    }
}

fn one() -> u64 {
    1
}

fn fifty() -> f64 {
    50.0
}

impl Default for PolicyConfig {
    fn default() -> Self {
        Self { sigma: 0.003, noise: Noise::Gaussian }
    }
}

impl Default for LogConfig {
    fn default() -> Self {
        Self { every: 1, hash_every: 1000 }
    }
}
