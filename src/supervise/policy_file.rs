//! A learned policy as a file that others can read: the weights, and everything that is needed to use them.
//!
//! The file is safetensors with one tensor, `weights`, of shape (outputs, features), `f32`. Its metadata have one
//! entry, `tectum_policy`, a JSON object: [`PolicyFacts`]. They say how features follow from inputs, so that a few
//! lines in any language compute the command `weights * features` (docs/launch.md has them in Python).

use std::io::Write as _;
use std::path::Path;

use safetensors::tensor::{Dtype, TensorView};
use serde::Serialize;

use super::learned_state::{LearnedState, rule};
use super::{LaunchError, learned_state};
use crate::agent::learned_hash;
use crate::checkpoint::CheckpointError;
use crate::encoder::{Axis, Map};
use crate::scenario::SignalConfig;

/// The metadata entry of an exported policy.
const ENTRY: &str = "tectum_policy";
/// Version of the format.
const FORMAT: u32 = 1;

/// One axis of a map: Gaussian units with centres evenly spaced from `min` to `max`.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PolicyAxis {
    /// Name of the input.
    pub input: String,
    /// Number of units.
    pub units: usize,
    /// Centre of the first unit, in the input's unit.
    pub min: f64,
    /// Centre of the last unit.
    pub max: f64,
    /// Standard deviation of the units, in the input's unit.
    pub radius: f64,
}

/// What a policy computes, and where it comes from.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PolicyFacts {
    /// Version of the format.
    pub format: u32,
    /// The checkpoint that it was taken from.
    pub checkpoint: String,
    /// Id of the run that learned it, hexadecimal.
    pub run: String,
    /// The tick until which it was learned.
    pub tick: u64,
    /// Build that learned it.
    pub build: String,
    /// Name of the scenario.
    pub scenario: String,
    /// The learning rule; of a program of one's own, the program.
    pub learner: String,
    /// Period of the tick, ms.
    pub period_ms: f64,
    /// The inputs, in order, with units and ranges.
    pub inputs: Vec<SignalConfig>,
    /// The outputs, in order, with units and ranges.
    pub outputs: Vec<SignalConfig>,
    /// Largest magnitude of each output that the gate let pass.
    pub max_command: Vec<f64>,
    /// Standard deviation of the exploration noise that the policy was learned with.
    pub sigma: f64,
    /// The encoder's maps, in the order of their features. A map of two axes is the outer product of both; the first is
    /// the slow one. Empty without a linear policy.
    pub maps: Vec<Vec<PolicyAxis>>,
    /// Whether the features of the maps are scaled to unit norm, all together.
    pub normalise: bool,
    /// Names of the inputs that are features as they are, after those of the maps.
    pub scalars: Vec<String>,
    /// Number of features; null where the learner has no linear policy.
    pub features: Option<usize>,
    /// Euclidean norm of the weights; null without any.
    pub weights_norm: Option<f64>,
    /// Hash of what was learned, as in a run's summary, hexadecimal; null for a program of one's own.
    pub weights_hash: Option<String>,
}

impl PolicyFacts {
    /// What is known of the policy of `learned`.
    ///
    /// # Errors
    /// When the checkpoint does not fit its scenario.
    pub fn of(learned: &LearnedState) -> Result<Self, LaunchError> {
        let (plan, facts) = (learned.plan(), &learned.checkpoint().facts);
        let scenario = &plan.scenario;
        let shipped = scenario.controller.is_shipped();
        let weights = learned.checkpoint().weights();
        let axis = |axis: &Axis| PolicyAxis {
            input: plan.inputs[axis.input].name.clone(),
            units: axis.units,
            min: axis.min,
            max: axis.max,
            radius: axis.radius,
        };
        let maps = plan.maps.iter().map(|map| match map {
            Map::Line(line) => vec![axis(line)],
            Map::Plane(slow, fast) => vec![axis(slow), axis(fast)],
        });
        let hash = if shipped { Some(learned_hash(&mut learned.agent(plan)?)) } else { None };
        let norm = |weights: &[f32]| weights.iter().map(|w| f64::from(*w).powi(2)).sum::<f64>().sqrt();
        Ok(Self {
            format: FORMAT,
            checkpoint: learned.file().display().to_string(),
            run: facts.run.clone(),
            tick: facts.tick,
            build: facts.build.clone(),
            scenario: scenario.name.clone(),
            learner: if shipped { learned_state::rule(scenario) } else { scenario.controller.program.clone() },
            period_ms: scenario.period_ms,
            inputs: plan.inputs.clone(),
            outputs: plan.outputs.clone(),
            max_command: (0..plan.outputs.len()).map(|output| scenario.gate.max_command.of(output)).collect(),
            sigma: scenario.policy.sigma,
            maps: if weights.is_some() { maps.collect() } else { Vec::new() },
            normalise: scenario.encoder.normalise,
            scalars: plan.scalars.iter().map(|&input| plan.inputs[input].name.clone()).collect(),
            features: weights.as_ref().map(|(_, features, _)| *features),
            weights_norm: weights.as_ref().map(|(_, _, weights)| norm(weights)),
            weights_hash: hash.map(|hash| format!("{hash:016x}")),
        })
    }

    /// One JSON object.
    pub fn to_json(&self) -> String {
        serde_json::to_string(self).unwrap_or_default()
    }

    /// The same for people.
    pub fn to_text(&self) -> String {
        use std::fmt::Write as _;
        let mut text = format!(
            "{}, learned by {} until tick {} (run {}, build {})\n",
            self.scenario,
            self.learner,
            crate::text::thousands(self.tick),
            self.run,
            self.build
        );
        for (what, signals) in [("input", &self.inputs), ("output", &self.outputs)] {
            for signal in signals {
                let SignalConfig { name, unit, min, max, .. } = signal;
                let _ = writeln!(text, "{what:<8} {name:<16} {unit:<6} {min} to {max}");
            }
        }
        for axes in &self.maps {
            let axis = |axis: &PolicyAxis| {
                let PolicyAxis { input, units, min, max, radius } = axis;
                format!("{input}: {units} units from {min} to {max}, radius {radius}")
            };
            let _ = writeln!(text, "map      {}", axes.iter().map(axis).collect::<Vec<_>>().join("; "));
        }
        if !self.scalars.is_empty() {
            let _ = writeln!(text, "scalars  {}", self.scalars.join(", "));
        }
        match (self.features, self.weights_norm) {
            (Some(features), Some(norm)) => {
                let scaled = if self.normalise { ", features scaled to unit norm" } else { "" };
                let _ = writeln!(text, "weights  {} x {features}, norm {norm:.6}{scaled}", self.outputs.len());
            }
            _ => text += "weights  none: this learner has no linear policy\n",
        }
        if let Some(hash) = &self.weights_hash {
            let _ = writeln!(text, "hash     {hash}");
        }
        text
    }
}

/// Writes the policy of `learned` to the file `out`, which must not exist. Returns what the file says of it.
///
/// # Errors
/// When the learner has no linear policy, or the file exists or cannot be written.
pub fn export_policy(learned: &LearnedState, out: &Path) -> Result<PolicyFacts, LaunchError> {
    let facts = PolicyFacts::of(learned)?;
    let Some((outputs, features, weights)) = learned.checkpoint().weights() else {
        let name = rule(&learned.plan().scenario);
        let learner = if learned.plan().scenario.controller.is_shipped() { &name } else { &facts.learner };
        let what =
            format!("{learner} has no linear policy to export; `tectum run --from` goes on with what it learned");
        return Err(LaunchError::Checkpoint(CheckpointError::None { folder: learned.file().to_owned(), what }));
    };
    let bytes: Vec<u8> = weights.iter().flat_map(|weight| weight.to_le_bytes()).collect();
    let failed = |cause: String| LaunchError::Export { path: out.display().to_string(), cause };
    let view = TensorView::new(Dtype::F32, vec![outputs, features], &bytes).map_err(|e| failed(e.to_string()))?;
    let metadata = Some([(ENTRY.to_owned(), facts.to_json())].into_iter().collect());
    let file = safetensors::serialize([("weights", view)], metadata).map_err(|e| failed(e.to_string()))?;
    write_new(out, &file).map_err(|cause| failed(cause.to_string()))?;
    Ok(facts)
}

/// Writes a file that does not exist yet, as a whole or not at all.
fn write_new(path: &Path, bytes: &[u8]) -> std::io::Result<()> {
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let mut draft = tempfile::Builder::new().suffix(".part").tempfile_in(folder)?;
    draft.write_all(bytes)?;
    draft.as_file().sync_all()?;
    draft.persist_noclobber(path).map(drop).map_err(|error| error.error)
}
