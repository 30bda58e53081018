//! The names of a run's channels.

use serde::{Deserialize, Serialize};

/// `[channels]` of a scenario: names of the channels. They can be changed in case another program uses the same
/// names in the run's domain.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ChannelNames {
    /// Plant to controller and logger.
    pub observation: String,
    /// Controller to plant and logger.
    pub command: String,
    /// Controller to logger.
    pub learning: String,
    /// Trackers to the bridge, where `[plant.servos]` has `sight = "vision"`.
    #[serde(skip_serializing_if = "is_vision")]
    pub vision: String,
}

fn is_vision(name: &str) -> bool {
    name == "vision"
}

impl Default for ChannelNames {
    fn default() -> Self {
        Self {
            observation: "observation".into(),
            command: "command".into(),
            learning: "learning".into(),
            vision: "vision".into(),
        }
    }
}
