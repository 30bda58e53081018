//! The learned-reward rule: model-based learning. It learns a model of the reward and improves the policy with it.
//!
//! The agent observes only inputs, reward and its own commands. From these it learns, tick by tick, a model of
//! the reward (`reward_model.rs`) and a model of the effect of commands on inputs (`movement_model.rs`). After
//! each command was sent, it simulates movements (rollouts) from states it has been in to targets anywhere in
//! the input box, and descends the cost of the rollouts along the weights of the policy (`rollouts.rs`). The
//! policy is the paper's `u = W g + noise`. Sources: value gradients (Heess et al. 2015, *Learning Continuous
//! Control Policies by Stochastic Value Gradients*), model-based policy search (Deisenroth & Rasmussen 2011,
//! *PILCO*), Dyna's use of the time between actions (Sutton 1990), Adam (Kingma & Ba 2015).
//!
//! Descent may end in a local minimum, since an arm can reach a target in more than one way. The policy in use,
//! the *champion*, therefore has a *challenger*: a second candidate that restarts regularly from small random
//! weights, and is improved with rollouts to the same targets. When its cost is lower, it replaces the
//! champion. After a change of the plant, usually a challenger finds the new solution. Each candidate starts
//! most rollouts where its own last ones ended. If all rollouts started from the postures that the champion
//! reaches, the champion's solution would be the best for every candidate, and every challenger would become
//! its copy.
//!
//! Inputs that no command moves (the target) are constant within a rollout. Rollouts to targets that never
//! appeared are what makes this rule fast: at the second target the model has data from two targets, and the
//! policy has been improved on hundreds.

mod backward;
mod basis;
mod candidate;
mod lanes;
mod map_features;
mod movement_model;
mod outliers;
mod reward_model;
mod rollout_cost;
mod rollouts;
mod starts;
mod whiten;

use super::{LearnerSpec, ModelConfig};
use super::{LearningRule, Transition};
use crate::angle::wrap;
use crate::plant::EpisodeEnd;
use crate::policy::{LinearPolicy, Outputs};
use crate::seed::{Rng, stream};
use crate::state::{Persist, StateVisitor};
use crate::{MAX_INPUTS, SignalConfig};
use candidate::CandidatePolicy;
use map_features::MapFeatures;
use movement_model::{MovementModel, MovementVerdict};
use reward_model::RewardModel;
use rollouts::{RolloutConstants, Rollouts, State};
use tectum_encoder::Encoder;
use tectum_encoder::simd::SimdPath;

/// A challenger replaces the champion when it is better than it by this fraction of the champion's cost, or of
/// [`SPREADS`] times the spread of its costs, whichever is less: a constant in all rewards adds to every cost and
/// says nothing about the candidates.
const REPLACEMENT_MARGIN: f32 = 0.005;
const SPREADS: f32 = 4.0;
/// Not before this age, ticks.
const MIN_CHALLENGER_AGE: u64 = 200;
/// Ticks after which the models are good enough for a challenger.
const CHALLENGER_START: u64 = 100;
/// Longest interval between ticks in which the rule works, while the world does not change.
const MAX_WORK_INTERVAL: u64 = 256;

/// A tick that is learned from after the command was sent.
#[derive(Debug, Clone, Default)]
struct PendingTransition {
    /// Fixed inputs of the tick, moved inputs after it.
    inputs: [f32; MAX_INPUTS],
    /// All inputs of the tick.
    before: [f32; MAX_INPUTS],
    /// Changes of the moved inputs.
    changes: [f32; MAX_INPUTS],
    applied: Outputs,
    reward: f32,
    /// Whether a new target began after it.
    new_target: bool,
}

/// The learned-reward rule: models, candidate policies and remembered states.
#[derive(Debug, Clone)]
pub struct LearnedReward {
    config: ModelConfig,
    /// The inputs in the model's order: first the fixed ones, then the moved ones.
    inputs: Vec<usize>,
    /// Ranges of the inputs, in the model's order.
    ranges: Vec<[f32; 2]>,
    /// Which of the moved inputs wrap.
    wraps: Vec<bool>,
    reward: RewardModel,
    movement: MovementModel,
    rollouts: Rollouts,
    /// The policy in use, and one that restarts regularly from small random weights and may become better.
    champion: CandidatePolicy,
    challenger: CandidatePolicy,
    /// By candidate: the states from which the rollouts of a step start, and at which they end.
    starts: [Vec<State>; 2],
    /// The states that were recalled for the rollouts of a step.
    recalled: Vec<State>,
    /// Ring of past states, in the model's order.
    memory: Vec<State>,
    /// Number of states that were ever put into the ring.
    remembered: u64,
    /// Ticks since the last detected change of the world.
    unchanged_ticks: u64,
    rng: Rng,
    pending: Option<PendingTransition>,
    slope_norm: f32,
    halted: bool,
}

impl LearnedReward {
    /// The rule that `spec` configures, for a policy over features of `encoder`.
    pub fn of(spec: &LearnerSpec, encoder: &Encoder) -> Self {
        let config = spec.learner.model.clone().unwrap_or_default();
        let (count, outputs) = (spec.inputs.len(), spec.outputs);
        let moved = if config.moved.is_empty() { &spec.moved } else { &config.moved };
        let moves = |i: usize| moved.contains(&spec.inputs[i].name);
        let mut inputs: Vec<_> = (0..count).filter(|&i| !moves(i)).collect();
        let fixed = inputs.len();
        inputs.extend((0..count).filter(|&i| moves(i)));
        let mut rank = vec![0; count];
        inputs.iter().enumerate().for_each(|(at, &input)| rank[input] = at);

        let signals: Vec<_> = inputs.iter().map(|&i| spec.inputs[i].clone()).collect();
        let reward = RewardModel::new(&config, &signals, fixed);
        let wraps: Vec<_> = signals[fixed..].iter().map(SignalConfig::wraps).collect();
        let groups = MapFeatures::of(&spec.maps, encoder, &rank, fixed, config.ridge);
        let constants = RolloutConstants {
            fixed,
            outputs,
            normalise: spec.normalise,
            last_counts: config.last_counts as f32,
            wraps: wraps.clone(),
            max_command: spec.max_command,
        };
        let rollouts = Rollouts::new(groups, &reward, constants, config.horizon, config.movements);
        Self {
            inputs,
            ranges: signals.iter().map(|s| [s.min as f32, s.max as f32]).collect(),
            movement: MovementModel::new(outputs, wraps.len(), spec.sigma),
            wraps,
            reward,
            champion: CandidatePolicy::new(&rollouts.feature_groups, outputs, config.movements),
            challenger: CandidatePolicy::new(&rollouts.feature_groups, outputs, config.movements),
            rollouts,
            starts: [(); 2].map(|()| vec![[0.0; MAX_INPUTS]; config.movements]),
            recalled: vec![[0.0; MAX_INPUTS]; config.movements],
            memory: vec![[0.0; MAX_INPUTS]; config.memory],
            remembered: 0,
            unchanged_ticks: 0,
            rng: stream(spec.seed, "rehearsal"),
            pending: None,
            slope_norm: 0.0,
            halted: false,
            config,
        }
    }

    /// Number of features of the reward model.
    #[cfg(test)]
    fn model_size(&self) -> usize {
        self.reward.len()
    }

    /// The step size of a candidate of this age.
    fn step_size(&self, age: u64) -> f32 {
        let fade = 1.0 / (1.0 + age as f64 / self.config.half_life);
        (self.config.step * fade.max(self.config.floor)) as f32
    }

    /// Improves the champion, and with `with_challenger` the challenger, by one step each.
    fn improve_candidates(&mut self, path: SimdPath, with_challenger: bool) {
        for rollout in 0..self.config.movements {
            self.draw_start(rollout);
        }
        // The rollouts of both candidates have the same targets.
        self.rollouts.set_targets(path, &self.starts[0]);
        let candidates = [&mut self.champion, &mut self.challenger].into_iter().zip(&mut self.starts);
        for (candidate, states) in candidates.take(1 + usize::from(with_challenger)) {
            self.rollouts.simulate(path, candidate, &self.movement, states);
            for ((to, end), recalled) in candidate.end_states.iter_mut().zip(states).zip(&self.recalled) {
                // A rollout that diverged is not continued.
                *to = if end.iter().all(|x| x.is_finite()) { *end } else { *recalled };
            }
        }
        self.descend(path, with_challenger);
    }

    /// One step of the candidates down the slopes of their rollouts.
    fn descend(&mut self, path: SimdPath, with_challenger: bool) {
        let ticks = self.config.movements * self.config.horizon;
        let steps = [&self.champion, &self.challenger].map(|c| self.step_size(c.age));
        let groups = &mut self.rollouts.feature_groups;
        // Just after a change of the plant the models can be wrong for some ticks, and rollouts can diverge.
        // Such a step is dropped, because the models improve soon.
        let norm = self.champion.descend(path, groups, ticks, steps[0]);
        if norm.is_finite() {
            self.slope_norm = norm;
        }
        if with_challenger && !self.challenger.descend(path, groups, ticks, steps[1]).is_finite() {
            self.restart_challenger();
        }
    }

    /// Whether the rule works in this tick: in every tick, unless the world has not changed for long.
    fn is_work_tick(&self) -> bool {
        let interval = (self.unchanged_ticks / self.config.rest).clamp(1, MAX_WORK_INTERVAL);
        self.remembered.is_multiple_of(interval)
    }

    /// The cost below which a challenger replaces the champion.
    fn cost_to_beat(&self) -> f32 {
        let (cost, spread) = (self.champion.mean_cost, SPREADS * self.champion.cost_spread);
        if 0.0 <= cost && cost <= spread {
            (1.0 - REPLACEMENT_MARGIN) * cost
        } else {
            cost - REPLACEMENT_MARGIN * cost.abs().min(spread)
        }
    }

    /// Starts a new challenger.
    fn restart_challenger(&mut self) {
        self.challenger.reset(&mut self.rng);
    }

    /// Learns from the pending tick.
    fn learn_pending(&mut self, path: SimdPath) {
        let Some(PendingTransition { inputs, before, changes, applied, reward, new_target }) = self.pending.take()
        else {
            return;
        };
        let (count, moved) = (self.inputs.len(), self.wraps.len());
        let movement = self.movement.learn(&applied, &changes[..moved], new_target);
        // If the movement was not the commanded one, the reward says nothing about the command.
        let changed = match movement {
            MovementVerdict::Usual => {
                self.reward.learn(path, &inputs[..count], &changes[..moved], reward, self.is_work_tick())
            }
            MovementVerdict::Changed | MovementVerdict::Unrelated => Some(false),
        };
        let at = self.remembered as usize % self.memory.len();
        self.memory[at] = before;
        self.remembered += 1;
        self.halted = changed.is_none();
        self.unchanged_ticks += 1;
        if changed == Some(true) || movement == MovementVerdict::Changed {
            self.unchanged_ticks = 0;
            self.champion.age = 0;
            self.champion.forget_costs();
            self.restart_challenger();
        }
    }
}

impl LearningRule for LearnedReward {
    fn learn(&mut self, _policy: &mut LinearPolicy, tick: &Transition) -> f32 {
        if self.halted {
            return 0.0;
        }
        let fixed = self.inputs.len() - self.wraps.len();
        let (mut before, mut after) = ([0.0; MAX_INPUTS], [0.0; MAX_INPUTS]);
        let mut changes = [0.0; MAX_INPUTS];
        for (at, &input) in self.inputs.iter().enumerate() {
            before[at] = tick.inputs[input];
            // The reward depends on the fixed inputs (the target) of this tick and on the moved inputs after it.
            after[at] = if at < fixed { tick.inputs[input] } else { tick.next_inputs[input] };
        }
        for (i, &wraps) in self.wraps.iter().enumerate() {
            let change = after[fixed + i] - before[fixed + i];
            changes[i] = if wraps { wrap(change) } else { change };
        }
        let (applied, reward, new_target) = (*tick.applied, tick.reward, tick.new_target);
        self.pending = Some(PendingTransition { inputs: after, before, changes, applied, reward, new_target });
        self.step_size(self.champion.age)
    }

    fn improve(&mut self, policy: &mut LinearPolicy) {
        let path = policy.path();
        self.learn_pending(path);
        if self.halted || self.remembered < self.config.start || !self.movement.ready() || !self.is_work_tick() {
            return;
        }
        let with_challenger = self.config.challenge > 0 && self.remembered > CHALLENGER_START;
        if with_challenger && (self.challenger.age == 0 || self.challenger.age > self.config.challenge) {
            self.restart_challenger();
        }
        self.rollouts.cost.load(self.reward.weights());
        self.champion.load_policy(policy, &self.rollouts.feature_groups);
        for _ in 0..self.config.steps {
            if !self.halted {
                self.improve_candidates(path, with_challenger);
            }
        }
        let rollouts = self.config.steps * self.config.movements;
        self.champion.finish_tick(rollouts);
        if with_challenger {
            self.challenger.finish_tick(rollouts);
            if self.challenger.age > MIN_CHALLENGER_AGE && self.challenger.mean_cost < self.cost_to_beat() {
                self.champion.copy_from(&self.challenger);
                self.restart_challenger();
            }
        }
        self.champion.store_policy(policy, &self.rollouts.feature_groups);
    }

    /// Learns nothing: where the plant was at the end of the tick is not among the inputs of another episode.
    fn learn_last(&mut self, _policy: &mut LinearPolicy, _tick: &Transition, _end: EpisodeEnd) -> Option<f32> {
        None
    }

    /// Does nothing: there is no trace, and the models stay valid.
    fn cut_trace(&mut self) {}

    /// The norm of the slope of the rollouts' cost.
    fn trace_norm(&self) -> f32 {
        self.slope_norm
    }

    fn halted(&self) -> bool {
        self.halted
    }

    fn outliers(&self) -> u64 {
        self.reward.outliers()
    }
}

impl Persist for LearnedReward {
    fn visit_state(&mut self, visitor: &mut dyn StateVisitor) {
        visitor.nested("reward", &mut self.reward);
        visitor.nested("movement", &mut self.movement);
        visitor.nested("champion", &mut self.champion);
        visitor.nested("challenger", &mut self.challenger);
        visitor.numbers("memory", &mut self.memory);
        visitor.number("remembered", &mut self.remembered);
        visitor.number("unchanged", &mut self.unchanged_ticks);
        visitor.nested("rng", &mut self.rng);
        let mut is_pending = self.pending.is_some();
        visitor.boolean("waits", &mut is_pending);
        let pending = self.pending.get_or_insert_default();
        visitor.numbers("waiting_inputs", &mut pending.inputs);
        visitor.numbers("waiting_before", &mut pending.before);
        visitor.numbers("waiting_changes", &mut pending.changes);
        visitor.numbers("waiting_applied", &mut pending.applied);
        visitor.number("waiting_reward", &mut pending.reward);
        visitor.boolean("waiting_new_target", &mut pending.new_target);
        self.pending.take_if(|_| !is_pending);
        visitor.number("slope_norm", &mut self.slope_norm);
        visitor.boolean("halted", &mut self.halted);
    }
}

#[cfg(test)]
mod robustness_tests;
#[cfg(test)]
mod scalar;
#[cfg(test)]
mod tests;
