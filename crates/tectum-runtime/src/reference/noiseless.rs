//! The noiseless test: a plant that is driven without exploration noise, through the scenario's gate.
//!
//! The test set and all studies that test what was learned use these parts. [`MeanPolicy`] turns inputs into a
//! policy's mean command. [`FrozenAgent`] answers as an agent would, which need not have a policy. [`Rollout`] applies
//! commands to a plant through a fresh gate, as the plant's process does in a run. Faults of the channels do not act
//! here: a test measures what was learned.

use crate::agent::{Agent as _, Answer, Boundary, Experience, ModelPredictiveAgent, Percept, ShippedAgent};
use crate::encoder::{Encoder, Features};
use crate::plant::{EpisodeEnd, Outcome, Plant};
use crate::policy::{LinearPolicy, Outputs};
use crate::runtime::Gate;
use crate::scenario::Plan;
use crate::wire::{MAX_INPUTS, MAX_OUTPUTS, flag};

/// Computes the mean command of a policy: what a controller would send without exploration noise.
#[derive(Debug, Clone)]
pub struct MeanPolicy {
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

/// What a controller sees in a tick of a test.
#[derive(Debug, Clone, Copy)]
pub struct TestPercept<'a> {
    /// The tick of the test, from 0.
    pub tick: u64,
    /// The inputs.
    pub inputs: &'a [f32],
    /// The command that was applied in the tick before.
    pub applied: &'a [f32],
    /// Flags of the observation: whether a target or an episode begins.
    pub flags: u32,
}

/// What an agent knew at some instant: it answers without exploration noise, and learns nothing from the test.
#[derive(Debug, Clone)]
pub enum FrozenAgent {
    /// A policy answers with its mean.
    Mean(Box<(MeanPolicy, LinearPolicy)>),
    /// A planner plans on.
    Planner(Box<ModelPredictiveAgent>),
}

impl FrozenAgent {
    /// The agent of a run of `plan`, as it is now.
    pub fn of(agent: &ShippedAgent, plan: &Plan) -> Self {
        match agent {
            ShippedAgent::Linear(agent) => Self::Mean(Box::new((MeanPolicy::new(plan), agent.linear_policy().clone()))),
            ShippedAgent::ModelPredictive(agent) => Self::Planner(Box::new(agent.frozen())),
        }
    }

    /// The command for what it sees in the next tick.
    pub fn command(&mut self, seen: &TestPercept) -> Outputs {
        let (tick, agent) = match self {
            Self::Mean(of) => return of.0.command(&of.1, seen.inputs),
            Self::Planner(agent) => (seen.tick, agent),
        };
        if tick > 0 {
            agent.learn(&Experience {
                tick: tick - 1,
                inputs: seen.inputs,
                asked: seen.applied,
                applied: seen.applied,
                limited: false,
                reward: 0.0,
                next_inputs: seen.inputs,
                boundary: Boundary::of(seen.flags),
                withheld: None,
            });
        }
        let (mut command, mut mean) = (Outputs::default(), Outputs::default());
        let outputs = seen.applied.len();
        let percept = Percept { tick, inputs: seen.inputs, age: 0, flags: seen.flags };
        agent.act(&percept, &mut Answer { command: &mut command[..outputs], mean: &mut mean[..outputs] });
        agent.improve(1);
        command
    }
}

/// A plant behind its gate, driven tick by tick in one process.
#[derive(Debug, Clone)]
pub struct Rollout<P> {
    plant: P,
    gate: Gate,
    inputs: [f32; MAX_INPUTS],
    /// The command applied last.
    applied: [f32; MAX_OUTPUTS],
    /// Flags of the inputs.
    flags: u32,
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
        let gate = Gate::new(&plan.scenario.gate, used.1);
        Self { plant, gate, inputs, applied: [0.0; MAX_OUTPUTS], flags: flag::NEW_TARGET, used }
    }

    /// The plant.
    pub fn plant(&self) -> &P {
        &self.plant
    }

    /// Senses the plant at the beginning of `tick`. True if a new target (or trial) begins.
    pub fn sense(&mut self, tick: u64) -> bool {
        let new_target = self.plant.sense(tick, &mut self.inputs[..self.used.0]);
        self.flags = if new_target { flag::NEW_TARGET } else { 0 };
        self.flags |= self.plant.episode_end().map_or(0, EpisodeEnd::flag) | self.plant.sensing_flags();
        new_target
    }

    /// Answers the inputs that were sensed last with `control`, and applies its command in `tick`.
    pub fn advance(&mut self, tick: u64, mut control: impl FnMut(&TestPercept) -> Outputs) -> Outcome {
        let (inputs, outputs) = self.used;
        let mut command = [0.0; MAX_OUTPUTS];
        let (sensed, applied) = (&self.inputs[..inputs], &self.applied[..outputs]);
        let seen = TestPercept { tick, inputs: sensed, applied, flags: self.flags };
        command[..outputs].copy_from_slice(&control(&seen)[..outputs]);
        let ranges = self.gate.command_ranges(|| self.plant.joints());
        self.applied = self.gate.pass(Some(&command), ranges.as_ref()).command;
        self.plant.advance(tick, &self.applied[..outputs])
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::policy::Exploration;
    use crate::runtime::PlantSide;
    use crate::scenario::{FaultsConfig, Scenario};
    use crate::wire::{Command, Observation};

    /// A pendulum begins anew every 200 ticks, which is stated with the new start.
    #[test]
    fn a_rollout_states_where_episodes_begin_as_a_run_does() {
        let plan = Scenario::find("pendulum").unwrap().plan().unwrap();
        let mut rollout = Rollout::new(plan.simulated_plant().unwrap(), &plan);
        let mut side = PlantSide::new(plan.simulated_plant().unwrap(), &plan);
        let (mut observation, mut begun) = (Observation::default(), 0);
        let boundaries = flag::NEW_TARGET | flag::TRUNCATED | flag::TERMINATED;
        for tick in 0..450 {
            side.observe(tick, 0, 0, &mut observation);
            side.step(tick, Some(&Command::default()));
            rollout.sense(tick);
            rollout.advance(tick, |seen| {
                assert_eq!(seen.flags, observation.header.flags & boundaries, "tick {tick}");
                begun += u32::from(seen.flags & flag::TRUNCATED != 0);
                Outputs::default()
            });
        }
        assert_eq!(begun, 2);
    }

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
            let outcome = rollout.advance(tick, |seen| {
                assert_eq!(seen.inputs, &observation.inputs[..plan.inputs.len()]);
                std::array::from_fn(|i| command.drawn[i])
            });
            side.observe(tick + 1, 0, 0, &mut observation);
            assert_eq!((outcome.reward, outcome.measures), (observation.reward, observation.measures), "tick {tick}");
        }
        assert!(side.report().clamped > 0 && side.report().step_limited > 0 && side.report().non_finite == 1);
    }
}
