//! Settings of the learner; the defaults are one preset for all tasks.

use serde::{Deserialize, Serialize};

use super::layout::Places;
use crate::{MAX_INPUTS, MAX_OUTPUTS};

/// `[learner.plan]`: the model-predictive learner.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ModelPredictiveConfig {
    /// Length of a plan, ticks; 0 for one that follows from the number of inputs and commands.
    pub horizon: usize,
    /// Iterations of the plan in every tick, where the budget allows them.
    pub iterations: usize,
    /// Iterations of a rival plan in every tick.
    pub rival_iterations: usize,
    /// By which part the gap to the best reward must be smaller for a rival to be adopted.
    pub rival_gain: f64,
    /// Ticks that are remembered.
    pub memory: usize,
    /// Points of the evidence.
    pub points: usize,
    /// Adam steps of a refit.
    pub steps: u64,
    /// Features of the reward model, about; 0 for 260 more than its products, or fewer where operations are few.
    pub reward_features: usize,
    /// Features of an input's model of movement, about.
    pub dynamics_features: usize,
    /// Most products of the reward model; 0 for 8 times the square of the number of inputs, or fewer where operations
    /// are few.
    pub reward_products: usize,
    /// Most products of an input's model of movement.
    pub dynamics_products: usize,
    /// How far planning follows a sample of the posterior in place of its mean: 1 is posterior sampling (Osband, Russo
    /// & Van Roy 2013).
    pub sampled: f64,
    /// Factor of the exploration noise in the first ticks.
    pub first_noise: f64,
    /// Millions of operations that refits may take in a tick.
    pub refit_operations: f64,
    /// Millions of operations that a tick may take in all; 0 for no limit. Learning from the tick, a slice of a refit
    /// and one iteration of the plan are always done; more of them, and rivals, share what is left.
    pub operations: f64,
    /// Least noise of a model, as a part of its prior's scale.
    pub noise_floor: f64,
}

impl Default for ModelPredictiveConfig {
    fn default() -> Self {
        Self {
            horizon: 0,
            iterations: 2,
            rival_iterations: 8,
            rival_gain: 0.03,
            memory: 4000,
            points: 160,
            steps: 15,
            reward_features: 0,
            dynamics_features: 200,
            reward_products: 0,
            dynamics_products: 60,
            sampled: 1.0,
            first_noise: 3.0,
            refit_operations: 40.0,
            operations: 0.0,
            noise_floor: 1e-7,
        }
    }
}

/// An input: its range, and whether its ends are the same.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct InputRange {
    /// Lower end.
    pub min: f64,
    /// Upper end.
    pub max: f64,
    /// Whether the input comes round, as an angle does.
    pub wraps: bool,
    /// Radians in one unit of the input, if it is known to be an angle: 1 for rad, pi / 180 for degrees; 0 if it is
    /// known to be none, as a length or a speed. Without it the learner finds out by itself whether the input acts
    /// through its sine and cosine, and with which period, and needs more ticks for it.
    pub radians: Option<f64>,
}

impl InputRange {
    /// Whether the input is known to be no angle.
    pub fn is_no_angle(&self) -> bool {
        !self.wraps && self.radians == Some(0.0)
    }
}

/// What the learner is built from.
#[derive(Debug, Clone, PartialEq)]
pub struct ModelPredictiveSpec {
    /// The inputs; at most [`MAX_INPUTS`](crate::MAX_INPUTS).
    pub inputs: Vec<InputRange>,
    /// Largest magnitude of each command; at most [`MAX_OUTPUTS`](crate::MAX_OUTPUTS).
    pub limits: Vec<f64>,
    /// Largest change of each command from a tick to the next; infinite where any is allowed.
    pub steps: Vec<f64>,
    /// Standard deviation of the exploration noise of each command.
    pub sigma: Vec<f64>,
    /// Seed of the run.
    pub seed: u64,
    /// Settings.
    pub config: ModelPredictiveConfig,
}

impl ModelPredictiveSpec {
    /// How many inputs and commands there are.
    pub(super) fn places(&self) -> Places {
        let places = Places { inputs: self.inputs.len(), commands: self.limits.len() };
        assert!(places.commands <= MAX_OUTPUTS && places.inputs <= MAX_INPUTS);
        places
    }
}
