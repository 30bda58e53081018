//! Scenario files: reads TOML and returns a validated [`Plan`].
//!
//! A scenario describes a run: the plant, the encoder, the policy, the learner, and the number of ticks. It is
//! read in two steps:
//!
//! 1. [`Scenario::load`], [`Scenario::parse`] and [`Scenario::find`] turn text into tables. They refuse unknown
//!    keys and wrong types.
//! 2. [`Scenario::plan`] checks every number and every reference between tables, and fills in the keys that the
//!    file leaves out.
//!
//! Between the two steps the caller may change the keys that the command line overrides (seed, ticks). After
//! them nothing is checked again: a [`Plan`] keeps the bounds in [`limits`]. No input makes these functions
//! panic.
//!
//! ```
//! use tectum_scenario::Scenario;
//!
//! let scenario = Scenario::find("arm")?;
//! let plan = Scenario { ticks: 400, ..scenario }.plan()?;
//! assert_eq!(plan.period_ns, 50_000_000);
//! assert_eq!(plan.inputs.len(), 6);
//!
//! let error = Scenario::parse("name = \"mine\"\nsead = 3", "mine.toml").unwrap_err();
//! assert!(error.to_string().starts_with("mine.toml:2"), "{error}");
//! # Ok::<(), tectum_scenario::ScenarioError>(())
//! ```

#![warn(missing_docs)]

mod bodies;
mod channel_names;
mod check;
mod controller;
mod emulator;
mod encoder;
mod error;
mod exploration_loss;
mod faults;
mod file;
mod gate;
mod leader;
mod learner;
pub mod limits;
mod link;
mod measure;
mod per_axis;
mod plant;
mod plant_signals;
mod presets;
#[doc(hidden)]
pub mod programs;
mod realtime;
mod restart;
mod role;
mod rotation;
mod run_length;
mod servos;
mod source;
mod steps;
mod validate;

#[cfg(test)]
mod tests;

pub use channel_names::ChannelNames;
pub use controller::{ControllerConfig, LearnerTable};
pub use encoder::{EncoderConfig, MapConfig};
pub use error::{FilePosition, ScenarioError};
#[doc(hidden)]
pub use error::{nearest_name, word_list};
pub use faults::{
    ChannelFault, FaultChannel, FaultKind, FaultProcess, FaultValue, FaultsConfig, ProcessFault, ProcessFaultKind,
};
pub use file::{LogConfig, PolicyConfig, Scenario};
pub use gate::{GateConfig, OverrunConfig, PerOutput};
pub use leader::{JointMapping, LeaderConfig};
pub use link::LinkConfig;
pub use measure::{MeasureConfig, MeasureRole, MeasureTable};
pub use per_axis::PerAxis;
pub use plant::PlantConfig;
pub use presets::{Preset, presets};
pub use realtime::{RealtimeConfig, RealtimeProcess};
pub use restart::{RestartConfig, RestartPolicy};
pub use role::Role;
pub use rotation::LogRotation;
pub use servos::{JointConfig, PoseSource, Rearm, ServoGoal, ServosConfig, check_joints};
pub use source::ScenarioSource;
pub use tectum_core::SignalConfig;
pub use tectum_core::learner::{
    BaselineConfig, CriticConfig, CriticFeatures, LearnerConfig, ModelBasis, ModelConfig, Rule,
    model_predictive::ModelPredictiveConfig,
};
pub use tectum_core::plant::{
    Angles, ArmConfig, ArmRewardConfig, BlockConfig, CartPoleConfig, EyeConfig, FurutaConfig, MirrorAxis, MirrorConfig,
    PayloadConfig, PendulumConfig, PointMassConfig, ReacherConfig, Retina, ShortenConfig, So101Config, Start,
    TimingConfig,
};
pub use tectum_core::policy::Noise;
pub use tectum_servo::emulator::{EmulatorConfig, ServoFault, ServoFaultKind};

use std::{fs::File, io::Read, path::Path};

use xxhash_rust::xxh3::xxh3_64;

use error::{Violation, tables};
use plant_signals::signals;
use tectum_core::agent::ShippedAgent;
use tectum_core::learner::LearnerSpec;
use tectum_core::plant::SimulatedPlant;
use tectum_encoder::{Axis, Encoder, Map};

/// Largest scenario file, bytes.
pub const MAX_FILE_BYTES: u64 = 1 << 20;

/// A validated scenario, from which the processes of a run are built. All of its values are finite, in range
/// and consistent.
#[derive(Debug, Clone, PartialEq)]
pub struct Plan {
    /// The scenario with every default filled in.
    pub scenario: Scenario,
    /// Period of the tick, ns.
    pub period_ns: u64,
    /// The observation's inputs, in order; at most [`crate::limits::MAX_INPUTS`].
    pub inputs: Vec<SignalConfig>,
    /// The command's outputs, in order; at most [`crate::limits::MAX_OUTPUTS`].
    pub outputs: Vec<SignalConfig>,
    /// Names of the observation's measures, in order; at most [`crate::limits::MAX_MEASURES`].
    pub measures: Vec<String>,
    /// Index of the measure with the role `error`: the distance from the target.
    pub error: Option<usize>,
    /// The encoder's maps, in order, ranges and units resolved.
    pub maps: Vec<Map>,
    /// Indices of the inputs that are features without a map.
    pub scalars: Vec<usize>,
    /// 64-bit hash of the resolved scenario: XXH3 of [`Scenario::to_toml`]. The handshake compares it. It
    /// covers every setting, seed and ticks included, but neither comments and layout nor the file's name.
    pub hash: u64,
    /// Warnings about settings that are allowed but likely to fail. Each is one sentence with key, value,
    /// reason and remedy.
    pub warnings: Vec<String>,
}

impl Plan {
    /// The specification from which the scenario's learner is built.
    pub fn learner_spec(&self) -> LearnerSpec {
        LearnerSpec {
            moved: signals(&self.scenario).moved,
            inputs: self.inputs.clone(),
            outputs: self.outputs.len(),
            maps: self.maps.clone(),
            normalise: self.scenario.encoder.normalise,
            sigma: self.scenario.policy.sigma,
            max_command: std::array::from_fn(|output| self.scenario.gate.max_command.of(output) as f32),
            max_step: std::array::from_fn(|output| {
                self.scenario.gate.max_step.as_ref().map_or(f32::INFINITY, |step| step.of(output) as f32)
            }),
            seed: self.scenario.seed,
            learner: self.scenario.learner.clone(),
        }
    }

    /// The same plan, whose messages about `[learner]` name `file`, if that still has the same table: a process of a
    /// run reads a copy of the scenario, and its user wrote that file. Its paths begin at `folder`.
    pub fn with_origin(mut self, file: &str, folder: Option<&Path>) -> Self {
        self.scenario.source.set_folder(folder);
        // Only a regular file can be read a second time, and only the messages about `[learner]` come so late.
        let path = Path::new(file);
        if self.scenario.own_learner.is_none() || !path.is_file() {
            return self;
        }
        let original = Scenario::load(path).ok();
        if let Some(original) = original.filter(|original| original.own_learner == self.scenario.own_learner) {
            self.scenario.source = original.source;
        }
        self
    }

    /// `[learner]`, where the controller is a program of your own; an empty table where the file has none, or where the
    /// controller is this package's.
    pub fn learner_table(&self) -> LearnerTable<'_> {
        static EMPTY: std::sync::LazyLock<toml::Table> = std::sync::LazyLock::new(toml::Table::new);
        let scenario = &self.scenario;
        LearnerTable::new(scenario.own_learner.as_ref().unwrap_or(&EMPTY), &scenario.source)
    }

    /// The agent of the scenario's learner, which knows nothing yet.
    pub fn agent(&self) -> ShippedAgent {
        ShippedAgent::of(&self.learner_spec(), || self.encoder(), self.scenario.policy.noise)
    }

    /// The scenario's simulated plant, or `None` when the plant is another program, even one that the same table
    /// describes.
    pub fn simulated_plant(&self) -> Option<SimulatedPlant> {
        self.described_plant().filter(|_| crate::programs::is_simulator(&self.scenario.plant.program))
    }

    /// The plant that the scenario describes, whichever program is started for it: the simulator may be started by a
    /// script.
    pub fn described_plant(&self) -> Option<SimulatedPlant> {
        let (plant, period_s) = (&self.scenario.plant, self.scenario.period_ms / 1000.0);
        Some(SimulatedPlant::new(&plant.body()?, &plant.timing, period_s, self.scenario.seed))
    }

    /// The encoder that the scenario describes.
    pub fn encoder(&self) -> Encoder {
        Encoder::new(&self.maps, self.scenario.encoder.normalise).with_scalars(&self.scalars)
    }

    /// The arm, if its inputs tell its posture: the target's position, and then an angle for each joint.
    pub fn drawable_arm(&self) -> Option<&ArmConfig> {
        let arm = self.scenario.plant.arm.as_ref();
        arm.filter(|arm| !arm.open_loop && self.inputs.len() == 2 + arm.lengths.len())
    }

    /// The unit of the measure `error`; empty where it is not known.
    pub fn error_unit(&self) -> &'static str {
        if self.scenario.plant.arm.is_some() { "m" } else { "" }
    }

    /// The arm, if it is the simulator's: another program's arm is only known from its samples.
    pub fn simulated_arm(&self) -> Option<&ArmConfig> {
        let plant = &self.scenario.plant;
        plant.arm.as_ref().filter(|_| crate::programs::is_simulator(&plant.program))
    }
}

impl Scenario {
    /// Reads a scenario file.
    ///
    /// # Errors
    ///
    /// If the file is missing, a folder, unreadable, larger than [`MAX_FILE_BYTES`] or not UTF-8; otherwise as
    /// [`parse`](Self::parse).
    pub fn load(path: &Path) -> Result<Self, ScenarioError> {
        let file = path.display().to_string();
        if path.is_dir() {
            return Err(ScenarioError::Folder { file });
        }
        let mut bytes = Vec::new();
        // Limits the bytes read instead of checking the metadata, because a device or a pipe has no length.
        let read = File::open(path).and_then(|open| open.take(MAX_FILE_BYTES + 1).read_to_end(&mut bytes));
        match read {
            Ok(_) if bytes.len() as u64 > MAX_FILE_BYTES => return Err(ScenarioError::TooLarge { file }),
            Ok(_) => {}
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => {
                return Err(ScenarioError::Missing { file });
            }
            Err(source) => return Err(ScenarioError::Read { file, source }),
        }
        match str::from_utf8(&bytes) {
            Ok(text) => {
                let mut scenario = Self::parse(text, &file)?;
                scenario.source.set_folder(std::path::absolute(path).ok().as_deref().and_then(Path::parent));
                Ok(scenario)
            }
            Err(error) => {
                let line = 1 + bytes[..error.valid_up_to()].iter().filter(|&&byte| byte == b'\n').count();
                Err(ScenarioError::NotUtf8 { place: FilePosition { file, line: Some(line) } })
            }
        }
    }

    /// Turns the text of a scenario into its tables; `source_name` is the file's name in messages.
    ///
    /// # Errors
    ///
    /// If the text is not TOML, has an unknown key, lacks one that has no default, or has a value of the wrong
    /// type.
    pub fn parse(text: &str, source_name: &str) -> Result<Self, ScenarioError> {
        let source = ScenarioSource::new(source_name, text);
        let mut scenario = tables(&source)?;
        // Keys that the file leaves out of `[learner]` get the defaults of the file's rule. serde filled in
        // those of the paper's rule.
        let own = scenario.own_learner.is_some();
        let learner = text.parse::<toml::Table>().ok().and_then(|mut file| file.remove("learner")).filter(|_| !own);
        if let Some(toml::Value::Table(learner)) = learner {
            scenario.learner = with_preset_defaults(scenario.learner, learner);
        }
        Ok(Self { source, ..scenario })
    }

    /// Checks the scenario and fills in the keys that it leaves out.
    ///
    /// # Errors
    ///
    /// [`ScenarioError::Invalid`] for the first value that is out of range or does not fit the others.
    pub fn plan(self) -> Result<Plan, ScenarioError> {
        let invalid = |Violation { key, text }| {
            let place = FilePosition { file: self.source.name().to_owned(), line: self.line_of(&key) };
            ScenarioError::Invalid { place, key, problem: text }
        };
        validate::check(&self).map_err(invalid)?;
        let scenario = self.resolved();
        let signals = signals(&scenario);
        let maps = scenario.encoder.maps.iter().filter_map(|map| build_map(map, &signals.inputs)).collect();
        let mut plan = Plan {
            // Exact: `validate::check` accepts only a period that is a whole number of ns.
            period_ns: (scenario.period_ms * 1e6).round() as u64,
            scalars: scenario.encoder.scalars.iter().filter_map(|name| input_index(&signals.inputs, name)).collect(),
            inputs: signals.inputs,
            outputs: signals.outputs,
            error: measure::error_index(&signals.measures),
            measures: signals.measures.iter().map(|measure| measure.name().to_owned()).collect(),
            maps,
            hash: xxh3_64(scenario.to_toml().as_bytes()),
            scenario,
            warnings: Vec::new(),
        };
        if plan.scenario.controller.is_shipped() {
            plan.warnings = steps::check(&plan).map_err(invalid)?;
        }
        Ok(plan)
    }

    /// The scenario as a TOML file with every default written out. Parsed again, it gives the same plan and
    /// hash.
    pub fn to_toml(&self) -> String {
        // The writer cannot fail: the tables have finite depth and contain strings, numbers, lists and tables
        // with string keys only. If it fails all the same, the text is a comment, which does not parse as a
        // scenario.
        self.resolved().text().unwrap_or_else(|error| format!("# This scenario cannot be written: {error}\n"))
    }

    /// The scenario as a TOML file, as it is. Where the controller is another program, its own `[learner]` stands in
    /// it, and `[policy]` only if it was changed.
    pub fn text(&self) -> Result<String, toml::ser::Error> {
        if self.controller.is_shipped() { toml::to_string(self) } else { toml::to_string(&self.with_own_learner()?) }
    }

    /// The tables of a scenario whose controller is another program.
    fn with_own_learner(&self) -> Result<toml::Table, toml::ser::Error> {
        let mut file = toml::Table::try_from(self)?;
        file.remove("learner");
        if self.policy == PolicyConfig::default() {
            file.remove("policy");
        }
        if let Some(own) = &self.own_learner {
            file.insert("learner".to_owned(), toml::Value::Table(own.clone()));
        }
        Ok(file)
    }

    /// The scenario as a JSON object, for programs in other languages.
    pub fn to_json(&self) -> serde_json::Value {
        let tables = if self.controller.is_shipped() { None } else { self.with_own_learner().ok() };
        let json = tables.map_or_else(|| serde_json::to_value(self), serde_json::to_value);
        let mut json = json.unwrap_or_default();
        // Other languages need no word for it.
        json["ticks"] = self.ticks.into();
        json
    }

    /// The same scenario with all defaults of the learner, and with the units and ranges of maps that the file
    /// leaves out. The default range of a map is that of its input.
    fn resolved(&self) -> Self {
        let mut scenario = self.clone();
        scenario.learner = scenario.learner.resolved().within(scenario.period_ms);
        let inputs = signals(self).inputs;
        for map in &mut scenario.encoder.maps {
            if map.units.is_empty() {
                map.units = vec![limits::DEFAULT_UNITS; map.inputs.len()];
            }
            if map.ranges.is_empty() {
                let ranges: Option<Vec<_>> = map
                    .inputs
                    .iter()
                    .map(|name| input_index(&inputs, name).map(|i| [inputs[i].min, inputs[i].max]))
                    .collect();
                map.ranges = ranges.unwrap_or_default();
            }
        }
        scenario
    }

    /// The error for the value of `key`; `problem` says what is wrong and what to do.
    pub fn invalid(&self, key: &str, problem: impl std::fmt::Display) -> ScenarioError {
        let place = FilePosition { file: self.source.name().to_owned(), line: self.line_of(key) };
        ScenarioError::Invalid { place, key: key.to_owned(), problem: problem.to_string() }
    }

    /// The line of a key, or `None` when the caller has changed its value since the file was read.
    fn line_of(&self, key: &str) -> Option<usize> {
        let overridden = match key {
            "seed" => self.source.whole_number(key) != Some(self.seed),
            "ticks" => self.source.whole_number(key) != Some(self.ticks),
            _ => false,
        };
        if overridden { None } else { self.source.line_of(key) }
    }
}

/// The preset of the rule, overridden by the keys that the file has. `parsed` is the file's `[learner]` as
/// serde reads it, `given` the same table with the file's keys only.
fn with_preset_defaults(parsed: LearnerConfig, given: toml::Table) -> LearnerConfig {
    let Ok(mut table) = toml::Table::try_from(LearnerConfig::preset(parsed.rule)) else { return parsed };
    merge(&mut table, given);
    table.try_into().unwrap_or(parsed)
}

/// Overrides the values of `into` with those of `over`. Tables inside them are merged in the same way.
pub fn merge(into: &mut toml::Table, over: toml::Table) {
    for (key, value) in over {
        match (into.get_mut(&key), value) {
            (Some(toml::Value::Table(into)), toml::Value::Table(over)) => merge(into, over),
            (_, value) => drop(into.insert(key, value)),
        }
    }
}

/// The index of the input with this name.
fn input_index(inputs: &[SignalConfig], name: &str) -> Option<usize> {
    inputs.iter().position(|input| input.name == name)
}

/// The encoder's map for a table with resolved units and ranges; `None` only for a table that `encoder::check`
/// refuses.
fn build_map(map: &MapConfig, inputs: &[SignalConfig]) -> Option<Map> {
    let axis = |i: usize| {
        let [min, max] = *map.ranges.get(i)?;
        Some(Axis {
            input: input_index(inputs, map.inputs.get(i)?)?,
            units: *map.units.get(i)?,
            min,
            max,
            radius: map.radius.of(i),
        })
    };
    match map.inputs.len() {
        1 => Some(Map::Line(axis(0)?)),
        2 => Some(Map::Plane(axis(0)?, axis(1)?)),
        _ => None,
    }
}
