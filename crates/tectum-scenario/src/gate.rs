//! `[gate]` and `[overrun]`: how the plant treats commands that are late, missing or out of range, when it ends
//! the run because it misses its own deadlines, and the checks of both tables.
//!
//! By default only the limit on the command and the hold policy are active.

use std::fmt;

use serde::de::{Error, SeqAccess, Visitor};
use serde::{Deserialize, Deserializer, Serialize};

use super::check::{number, show};
use super::error::Violation;
use super::{PlantConfig, SignalConfig, limits};
use crate::limits::MAX_OUTPUTS;
use tectum_core::serde_pairs::pairs;

/// `[gate]`: limits between a command and the actuators.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct GateConfig {
    /// Largest command in magnitude.
    pub max_command: PerOutput,
    /// Largest change of the applied command from tick to tick. Default: no limit.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub max_step: Option<PerOutput>,
    /// Least and greatest position of the joint that each output moves, rad. Empty: no position limits.
    #[serde(deserialize_with = "pairs", skip_serializing_if = "Vec::is_empty")]
    pub positions: Vec<[f64; 2]>,
    /// Ticks for which the last command is held when none arrives.
    pub hold_ticks: u32,
    /// Ticks over which the held command then decays to zero.
    pub decay_ticks: u32,
    /// Ticks over which the largest command grows to its full size when commands begin, or begin again.
    #[serde(skip_serializing_if = "is_zero")]
    pub ramp_ticks: u32,
}

/// `[overrun]`: what the plant does when it misses its own deadlines in real time.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct OverrunConfig {
    /// Largest number of ticks skipped in a row, with none begun in time between them. With more the plant ends
    /// the run. 0: no limit.
    pub max_consecutive: u64,
}

/// A number for all outputs, or one for each.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(untagged)]
pub enum PerOutput {
    /// The same number for all outputs.
    All(f64),
    /// One number per output, in the order of the outputs.
    Each(Vec<f64>),
}

impl PerOutput {
    /// The number of `output`, counted from 0.
    pub fn of(&self, output: usize) -> f64 {
        match self {
            Self::All(value) => *value,
            // A list of another length never gets into a plan: `check_outputs` refuses it.
            Self::Each(list) => list.get(output).or(list.last()).copied().unwrap_or(1.0),
        }
    }

    /// The numbers in single precision, for [`MAX_OUTPUTS`] outputs.
    pub fn outputs(&self) -> [f32; MAX_OUTPUTS] {
        std::array::from_fn(|output| self.of(output) as f32)
    }

    /// The smallest number.
    pub fn least(&self) -> f64 {
        (0..MAX_OUTPUTS).map(|output| self.of(output)).fold(f64::INFINITY, f64::min)
    }

    /// Each number with its key.
    fn entries(&self, key: &str) -> Vec<(String, f64)> {
        match self {
            Self::All(value) => vec![(key.to_owned(), *value)],
            Self::Each(list) => list.iter().enumerate().map(|(i, value)| (format!("{key}[{i}]"), *value)).collect(),
        }
    }
}

impl<'de> Deserialize<'de> for PerOutput {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct PerOutputVisitor;
        impl<'de> Visitor<'de> for PerOutputVisitor {
            type Value = PerOutput;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a number, or a list of numbers, one for each output")
            }

            fn visit_f64<E: Error>(self, value: f64) -> Result<PerOutput, E> {
                Ok(PerOutput::All(value))
            }

            fn visit_i64<E: Error>(self, value: i64) -> Result<PerOutput, E> {
                Ok(PerOutput::All(value as f64))
            }

            fn visit_u64<E: Error>(self, value: u64) -> Result<PerOutput, E> {
                Ok(PerOutput::All(value as f64))
            }

            fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<PerOutput, A::Error> {
                let mut numbers = Vec::new();
                while let Some(number) = list.next_element()? {
                    numbers.push(number);
                }
                Ok(PerOutput::Each(numbers))
            }
        }
        deserializer.deserialize_any(PerOutputVisitor)
    }
}

impl Default for GateConfig {
    fn default() -> Self {
        Self {
            max_command: PerOutput::All(0.05),
            max_step: None,
            positions: Vec::new(),
            hold_ticks: 2,
            decay_ticks: 4,
            ramp_ticks: 0,
        }
    }
}

impl OverrunConfig {
    pub(super) fn is_nothing(&self) -> bool {
        *self == Self::default()
    }
}

pub(super) fn is_zero(ticks: &u32) -> bool {
    *ticks == 0
}

/// Checks everything that does not depend on the plant's outputs.
pub(super) fn check(gate: &GateConfig, overrun: &OverrunConfig) -> Result<(), Violation> {
    let remedy = "give more than 0 (1e-9 or more), up to 1e6";
    let steps = gate.max_step.iter().flat_map(|step| step.entries("gate.max_step"));
    for (key, value) in gate.max_command.entries("gate.max_command").into_iter().chain(steps) {
        number(key, value, limits::COMMAND, remedy)?;
    }
    for (i, &[low, high]) in gate.positions.iter().enumerate() {
        let range = -limits::POSITION..=limits::POSITION;
        if !(range.contains(&low) && range.contains(&high) && high - low >= limits::MIN_POSITION_RANGE) {
            let value = format!("[{}, {}]", show(low), show(high));
            let remedy = "give the least and then the greatest angle, from -1000 to 1000 rad and at least 0.001 apart";
            return Err(Violation::value(format_args!("gate.positions[{i}]"), value, remedy));
        }
    }
    for (key, value) in [
        ("gate.hold_ticks", gate.hold_ticks),
        ("gate.decay_ticks", gate.decay_ticks),
        ("gate.ramp_ticks", gate.ramp_ticks),
    ] {
        if value > limits::MAX_HOLD {
            return Err(Violation::value(key, value, "give 0 to 1000000 ticks"));
        }
    }
    if overrun.max_consecutive > limits::MAX_TICK {
        let remedy = "give 0 to 1000000000000 ticks; 0 never ends a run";
        return Err(Violation::value("overrun.max_consecutive", overrun.max_consecutive, remedy));
    }
    Ok(())
}

/// Checks that the lists match the plant's outputs. Whether a plant of another program reports joint positions
/// is known only when that plant joins the run; it is checked then.
pub(super) fn check_outputs(gate: &GateConfig, plant: &PlantConfig, outputs: &[SignalConfig]) -> Result<(), Violation> {
    if plant.eye.is_some() && !gate.positions.is_empty() {
        let text = "is given, and the eye has no joints whose positions could be limited; take it out";
        return Err(Violation::new("gate.positions", text));
    }
    let length = |numbers: &PerOutput| match numbers {
        PerOutput::All(_) => outputs.len(),
        PerOutput::Each(list) => list.len(),
    };
    let positions = if gate.positions.is_empty() { outputs.len() } else { gate.positions.len() };
    for (key, length) in [
        ("gate.max_command", length(&gate.max_command)),
        ("gate.max_step", gate.max_step.as_ref().map_or(outputs.len(), length)),
        ("gate.positions", positions),
    ] {
        if length != outputs.len() {
            let names: Vec<_> = outputs.iter().map(|output| output.name.as_str()).collect();
            let text = format!("has {length} entries; give one for each output: {}", names.join(", "));
            return Err(Violation::new(key, text));
        }
    }
    Ok(())
}
