//! The commands that the gate lets through.

use super::config::ModelPredictiveSpec;
use super::layout::Places;

/// Steps are shorter by this factor, so that they are not too long for the gate, which rounds.
const ROUNDING: f64 = 1.0 - 1e-6;

/// Limits of scaled commands: within 1, and no further than a step from the command that was applied before.
#[derive(Debug, Clone)]
pub struct CommandLimits {
    places: Places,
    /// Largest change of each command from a tick to the next; infinite where any is allowed.
    steps: Vec<f64>,
}

impl CommandLimits {
    /// Those of a learner's commands.
    pub fn of(spec: &ModelPredictiveSpec, places: Places) -> Self {
        let steps = spec.steps.iter().zip(&spec.limits).map(|(step, limit)| ROUNDING * step / limit);
        Self { places, steps: steps.collect() }
    }

    /// Limits with these steps.
    #[cfg(test)]
    pub fn new(places: Places, steps: Vec<f64>) -> Self {
        Self { places, steps }
    }

    /// The place in a state of the command before.
    pub fn before(&self, command: usize) -> usize {
        self.places.command(command, 1)
    }

    /// The least and the greatest value of a command in `state`.
    pub fn range(&self, state: &[f64], command: usize) -> [f64; 2] {
        let (before, step) = (state[self.before(command)], self.steps[command]);
        [before - step, before + step].map(|end| end.clamp(-1.0, 1.0))
    }

    /// The value of a command nearest to `u` in `state`.
    pub fn clamp(&self, state: &[f64], command: usize, u: f64) -> f64 {
        let [low, high] = self.range(state, command);
        u.clamp(low, high)
    }
}
