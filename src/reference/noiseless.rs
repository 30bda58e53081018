//! The noiseless test: a plant that is driven without exploration noise, through the scenario's gate.
//!
//! The test set and all studies that test a policy use these two parts. [`MeanPolicy`] turns inputs into the
//! policy's mean command. [`Rollout`] applies commands to a plant through a fresh gate, as the plant's
//! process does in a run. Faults of the channels do not act here: a test measures what was learned.

use crate::encoder::{Encoder, Features};
use crate::plant::{Outcome, Plant};
use crate::policy::{LinearPolicy, Outputs};
use crate::runtime::Gate;
use crate::scenario::Plan;
use crate::wire::{MAX_INPUTS, MAX_OUTPUTS};

/// Computes the mean command of a policy: what a controller would send without exploration noise.
#[derive(Debug, Clone)]
pub(crate) struct MeanPolicy {
    encoder: Encoder,
    features: Features,
}

impl MeanPolicy {
    /// For policies that use the encoder of `plan`.
    pub fn new(plan: &Plan) -> Self {
        let encoder = plan.encoder();
        Self { features: encoder.features(), encoder }
    }

    /// The mean command of `policy` for `inputs`.
    pub fn command(&mut self, policy: &LinearPolicy, inputs: &[f32]) -> Outputs {
        self.encoder.encode(inputs, &mut self.features);
        policy.mean(self.features.as_slice())
    }
}

/// A plant behind its gate, driven tick by tick in one process.
#[derive(Debug, Clone)]
pub(crate) struct Rollout<P> {
    plant: P,
    gate: Gate,
    inputs: [f32; MAX_INPUTS],
    /// Number of inputs and outputs that the scenario uses.
    used: (usize, usize),
}

impl<P: Plant> Rollout<P> {
    /// `plant` behind a fresh gate of `plan`.
    pub fn new(plant: P, plan: &Plan) -> Self {
        Self::sensed(plant, plan, [0.0; MAX_INPUTS])
    }

    /// The same for a plant that has already been sensed in the tick that comes first, with the result
    /// `inputs`.
    pub fn sensed(plant: P, plan: &Plan, inputs: [f32; MAX_INPUTS]) -> Self {
        let used = (plan.inputs.len(), plan.outputs.len());
        Self { plant, gate: Gate::new(&plan.scenario.gate, used.1), inputs, used }
    }

    /// The plant.
    pub fn plant(&self) -> &P {
        &self.plant
    }

    /// Senses the plant at the beginning of `tick`. True if a new target (or trial) begins.
    pub fn sense(&mut self, tick: u64) -> bool {
        self.plant.sense(tick, &mut self.inputs[..self.used.0])
    }

    /// Answers the inputs that were sensed last with `control`, and applies its command in `tick`.
    pub fn advance(&mut self, tick: u64, mut control: impl FnMut(&[f32]) -> Outputs) -> Outcome {
        let (inputs, outputs) = self.used;
        let mut command = [0.0; MAX_OUTPUTS];
        command[..outputs].copy_from_slice(&control(&self.inputs[..inputs])[..outputs]);
        let ranges = self.gate.command_ranges(|| self.plant.joints());
        let applied = self.gate.pass(Some(&command), ranges.as_ref()).command;
        self.plant.advance(tick, &applied[..outputs])
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::policy::Exploration;
    use crate::runtime::PlantSide;
    use crate::scenario::{FaultsConfig, Scenario};
    use crate::wire::{Command, Observation};

    /// With all limits of the gate, and one command that is not a number.
    #[test]
    fn a_rollout_equals_the_plant_of_a_run() {
        let mut scenario = Scenario::find("office").unwrap();
        scenario.faults = FaultsConfig::default();
        let plan = scenario.plan().unwrap();
        let mut rollout = Rollout::new(plan.simulated_plant().unwrap(), &plan);
        let mut side = PlantSide::new(plan.simulated_plant().unwrap(), &plan);
        let mut noise = Exploration::new(1, 0.05, plan.outputs.len());
        let (mut observation, mut command) = (Observation::default(), Command::default());
        for tick in 0..400 {
            side.observe(tick, 0, 0, &mut observation);
            let drawn = noise.draw();
            command.drawn[..drawn.len()].copy_from_slice(&drawn);
            if tick == 200 {
                command.drawn[1] = f32::NAN;
            }
            side.step(tick, Some(&command));
            rollout.sense(tick);
            let outcome = rollout.advance(tick, |inputs| {
                assert_eq!(inputs, &observation.inputs[..plan.inputs.len()]);
                std::array::from_fn(|i| command.drawn[i])
            });
            side.observe(tick + 1, 0, 0, &mut observation);
            assert_eq!((outcome.reward, outcome.measures), (observation.reward, observation.measures), "tick {tick}");
        }
        assert!(side.report.clamped > 0 && side.report.step_limited > 0 && side.report.non_finite == 1);
    }
}
