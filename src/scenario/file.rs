//! The scenario as it stands in its TOML file: one struct a table, every key with its unit, every default named.
//!
//! Unknown keys are refused. What the types cannot say (ranges, references between tables) is checked by
//! [`Scenario::plan`](super::Scenario::plan).

use std::fmt;

use serde::{
    Deserialize, Deserializer, Serialize,
    de::{Error, IgnoredAny, SeqAccess, Visitor},
};

use super::{
    ArmConfig, EmulatorConfig, FaultsConfig, GateConfig, LearnerConfig, OverrunConfig, RealtimeConfig, RestartConfig,
    ScenarioSource, ServosConfig,
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

/// `[plant]`: the program in the plant's place, and what it says and takes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PlantConfig {
    /// The program: a name is looked up beside `tectum` and then in `PATH`, a path is taken as it is.
    #[serde(default = "simulator")]
    pub program: String,
    /// Arguments for the program, before those that the launcher adds.
    #[serde(default)]
    pub args: Vec<String>,
    /// The inputs of an observation. Left out for `arm` and `eye`, which know theirs.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub inputs: Vec<SignalConfig>,
    /// The outputs of a command. Left out for `arm` and `eye`.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub outputs: Vec<SignalConfig>,
    /// Names of the measures, at most 6; one called `error` is reported as the error at the end of a target.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub measures: Vec<String>,
    /// The simulator's arm.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub arm: Option<ArmConfig>,
    /// The simulator's eye.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub eye: Option<EyeConfig>,
    /// The servos of `tectum-bridge`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub servos: Option<ServosConfig>,
    /// An emulated chain of servos.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub emulator: Option<EmulatorConfig>,
}

/// One input or output: its name, unit and range.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SignalConfig {
    /// Name, as maps refer to it.
    pub name: String,
    /// Unit, for people and logs.
    #[serde(default)]
    pub unit: String,
    /// Lower end of the range, in the unit.
    pub min: f64,
    /// Upper end of the range, in the unit.
    pub max: f64,
}

/// `[plant.eye]`: the saccades of section 4.1, one tick one saccade.
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

/// What the retina reports.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Retina {
    /// Cartesian x and y.
    Linear,
    /// `log(1 + B rho) / log(1 + B)` and the direction.
    LogPolar,
}

/// `[encoder]`: topographic maps, concatenated (section 3.3).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EncoderConfig {
    /// Scale the concatenated features to unit Euclidean norm.
    #[serde(default = "yes")]
    pub normalise: bool,
    /// Inputs, by name, that are features as they are, behind the maps' and never normalised.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub scalars: Vec<String>,
    /// The maps; at most 64, with at most 65,536 units together; none only beside scalars.
    pub maps: Vec<MapConfig>,
}

/// `[[encoder.maps]]`: one map over one or two inputs.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MapConfig {
    /// One or two inputs by name.
    pub inputs: Vec<String>,
    /// Units along each input; 2 to 4096. Default 16 each.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub units: Vec<usize>,
    /// Radius of the Gaussian kernel, in the unit of the inputs.
    pub radius: f64,
    /// Centre of the first and of the last unit along each input. Default: the input's range.
    #[serde(default, deserialize_with = "pairs", skip_serializing_if = "Vec::is_empty")]
    pub ranges: Vec<[f64; 2]>,
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

/// Distributions of the exploration noise, each of mean 0 and standard deviation `sigma` on every output by itself.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Noise {
    /// The paper's normal distribution.
    Gaussian,
    /// The double exponential one, of which the paper's section 5 speaks: many small deviations, a few large ones.
    Laplace,
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

/// Two numbers, and no third: serde's own reader of arrays passes over what follows them.
struct ExactPair([f64; 2]);

impl<'de> Deserialize<'de> for ExactPair {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct PairVisitor;
        impl<'de> Visitor<'de> for PairVisitor {
            type Value = ExactPair;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("an array of length 2")
            }

            fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<ExactPair, A::Error> {
                let mut pair = [0.0; 2];
                for (i, number) in pair.iter_mut().enumerate() {
                    *number = list.next_element()?.ok_or_else(|| A::Error::invalid_length(i, &self))?;
                }
                let mut length = 2;
                while list.next_element::<IgnoredAny>()?.is_some() {
                    length += 1;
                }
                if length == 2 { Ok(ExactPair(pair)) } else { Err(A::Error::invalid_length(length, &self)) }
            }
        }
        deserializer.deserialize_seq(PairVisitor)
    }
}

pub(super) fn pair<'de, D: Deserializer<'de>>(deserializer: D) -> Result<[f64; 2], D::Error> {
    ExactPair::deserialize(deserializer).map(|ExactPair(pair)| pair)
}

pub(super) fn pairs<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Vec<[f64; 2]>, D::Error> {
    Vec::<ExactPair>::deserialize(deserializer).map(|pairs| pairs.into_iter().map(|ExactPair(pair)| pair).collect())
}

fn one() -> u64 {
    1
}

fn fifty() -> f64 {
    50.0
}

fn yes() -> bool {
    true
}

fn simulator() -> String {
    "tectum-simulator".to_owned()
}

impl Default for EyeConfig {
    fn default() -> Self {
        Self { retina: Retina::LogPolar, distortion: 4.0, spread: 0.3, bonus: 0.5 }
    }
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
