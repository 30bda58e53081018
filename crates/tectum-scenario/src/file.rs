//! The scenario file: one struct per table, each key with its unit and default.
//!
//! Deserialising refuses unknown keys. [`Scenario::plan`](super::Scenario::plan) checks what types cannot
//! express: ranges, and references between tables.

use serde::{Deserialize, Serialize};

use super::{
    ControllerConfig, EncoderConfig, FaultsConfig, GateConfig, LearnerConfig, LinkConfig, Noise, OverrunConfig,
    PlantConfig, RealtimeConfig, RestartConfig, ScenarioSource,
};
use crate::ChannelNames;
use crate::rotation::LogRotation;

/// A whole scenario file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Scenario {
    /// Short name, used for the run's folder: letters, digits, `-` and `_`.
    pub name: String,
    /// Seed of every random stream.
    #[serde(default = "default_seed")]
    pub seed: u64,
    /// Period of the tick, ms; 1 to 1000.
    #[serde(default = "default_period_ms")]
    pub period_ms: f64,
    /// Ticks of a run; at least 2, or [`limits::ENDLESS`](crate::limits::ENDLESS), in the file `"endless"`.
    #[serde(with = "crate::run_length")]
    pub ticks: u64,
    /// The plant.
    pub plant: PlantConfig,
    /// The controller's program.
    #[serde(default, skip_serializing_if = "ControllerConfig::is_usual")]
    pub controller: ControllerConfig,
    /// The encoder, which turns inputs into features. A controller of another program may do without.
    #[serde(default, skip_serializing_if = "EncoderConfig::is_empty")]
    pub encoder: EncoderConfig,
    /// The policy, which turns features into commands.
    #[serde(default)]
    pub policy: PolicyConfig,
    /// The learner, which changes the policy's weights by rewards.
    #[serde(default)]
    pub learner: LearnerConfig,
    /// The gate: treatment of commands that are late, missing or out of range.
    #[serde(default)]
    pub gate: GateConfig,
    /// The log.
    #[serde(default)]
    pub log: LogConfig,
    /// Names of the channels.
    #[serde(default)]
    pub channels: ChannelNames,
    /// Restart policy for processes that die or hang.
    #[serde(default, skip_serializing_if = "RestartConfig::is_usual")]
    pub restart: RestartConfig,
    /// Real-time settings that each process requests from the operating system.
    #[serde(default, skip_serializing_if = "RealtimeConfig::is_nothing")]
    pub realtime: RealtimeConfig,
    /// Treatment of deadlines that the plant itself misses.
    #[serde(default, skip_serializing_if = "OverrunConfig::is_nothing")]
    pub overrun: OverrunConfig,
    /// A run on two machines.
    #[serde(default, skip_serializing_if = "LinkConfig::is_usual")]
    pub link: LinkConfig,
    /// Injected faults.
    #[serde(default, skip_serializing_if = "FaultsConfig::is_nothing")]
    pub faults: FaultsConfig,
    /// `[learner]` of a controller's program of your own, unread; [`learner`](Self::learner) then has no meaning. A
    /// field of its own, because its keys are the program's.
    #[serde(skip)]
    pub own_learner: Option<toml::Table>,
    /// The origin of the scenario, for messages. It is not a key of the file, and is neither compared nor
    /// hashed.
    #[serde(skip)]
    pub source: ScenarioSource,
}

/// `[policy]`: `u = W g + noise` (section 3.2).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PolicyConfig {
    /// Standard deviation of the exploration noise, in units of the command.
    pub sigma: f64,
    /// Distribution of the noise.
    pub noise: Noise,
}

/// `[log]`: which ticks the log contains, and in which layout.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LogConfig {
    /// The log contains every N-th tick; 1 for all.
    pub every: u64,
    /// The learning record of every N-th tick contains a hash of the weights.
    pub hash_every: u64,
    /// When the log goes on in another file, a segment: at a size or after a time, such as `64 MB` or `10 min`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rotate: Option<LogRotation>,
    /// Size of all segments, MB, beyond which the oldest one is removed.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub limit_mb: Option<f64>,
    /// After how many seconds what was written is synced to the disk; without it only when a segment ends.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sync_s: Option<f64>,
    /// Whether the log is put into compressed, indexed chunks when the run has ended in good order. Without it, small
    /// logs are.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub pack: Option<bool>,
    /// Whether a packed log repeats its samples on topics for viewers, with the scenario's names.
    #[serde(skip_serializing_if = "is_true")]
    pub views: bool,
}

/// Settings that are left out of a resolved scenario while they have their default leave its hash as it was before
/// they were introduced.
fn is_true(value: &bool) -> bool {
    *value
}

impl Scenario {
    /// Whether the run has no planned end.
    pub fn is_endless(&self) -> bool {
        self.ticks == crate::limits::ENDLESS
    }

    /// The name of the channel on which trackers publish, if this scenario has one.
    pub fn vision(&self) -> Option<&str> {
        let has_tracker = self.plant.servos.as_ref().is_some_and(|servos| !servos.sight.is_model());
        has_tracker.then_some(self.channels.vision.as_str())
    }
}

fn default_seed() -> u64 {
    1
}

fn default_period_ms() -> f64 {
    50.0
}

impl Default for PolicyConfig {
    fn default() -> Self {
        Self { sigma: 0.003, noise: Noise::Gaussian }
    }
}

impl Default for LogConfig {
    fn default() -> Self {
        Self { every: 1, hash_every: 1000, rotate: None, limit_mb: None, sync_s: None, pack: None, views: true }
    }
}
