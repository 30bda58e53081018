//! The learned-reward rule: learn what the reward depends on, and improve the policy through that.
//!
//! The agent sees only inputs, reward and its own commands. From these it learns, one tick at a time, a model of the reward
//! (`reward.rs`) and one of how its commands move its inputs (`movement.rs`). After each command has gone out it imagines
//! movements from states it has been in to places anywhere in the box of inputs, and descends the imagined cost along the
//! weights of the policy (`rehearsal.rs`), which is the paper's `u = W g + noise` still. Sources: value gradients (Heess et
//! al. 2015, *Learning Continuous Control Policies by Stochastic Value Gradients*), model-based policy search (Deisenroth &
//! Rasmussen 2011, *PILCO*), Dyna's use of the time between actions (Sutton 1990), Adam (Kingma & Ba 2015).
//!
//! Descent may end in a minimum that is not the best: an arm can reach in more than one way. So the policy, the champion,
//! has a challenger, which starts from nothing every so often and is rehearsed on the same movements; when it costs less it
//! takes over. After a change of the body it is usually a challenger that finds the new way. Each starts its imagined
//! movements mostly from where its own last ones ended: from the postures in which the champion left the body, the champion's
//! way is the best for anybody, and every challenger would end as its copy.
//!
//! Inputs that no command moves (the target) hold within an imagined movement. That places are imagined which were never
//! shown is what makes it fast: at the second target the model has seen two, the policy has rehearsed hundreds.

mod basis;
mod candidate;
mod map_features;
mod movement_model;
mod reward_model;
mod rollouts;
mod whiten;

use rand::RngExt as _;

use super::{LearnerSpec, ModelConfig};
use super::{LearningRule, Transition, add};
use crate::MAX_INPUTS;
use crate::policy::{LinearPolicy, Outputs};
use crate::seed::{Rng, stream};
use crate::state::{Persist, StateVisitor};
use candidate::CandidatePolicy;
use map_features::MapFeatures;
use movement_model::MovementModel;
use reward_model::RewardModel;
use rollouts::{Rollouts, wrap};
use tectum_encoder::Encoder;

/// Ticks since a change of the world that are enough to start imagined movements from: these lead on to more.
const FEW: u64 = 20;
/// A challenger takes over when its mean cost is below this share of the champion's,
const BETTER: f32 = 0.995;
/// and not before this age, in ticks.
const GROWN: u64 = 200;
/// Ticks after which the models are good enough to send one.
const SURE: u64 = 100;
/// Of a world that stays the same, one tick in so many is enough.
const SELDOM: u64 = 256;

/// A tick to be learned from when there is time.
#[derive(Debug, Clone, Default)]
struct PendingTransition {
    /// Still inputs of the tick, moved ones after it.
    inputs: [f32; MAX_INPUTS],
    /// All inputs of the tick.
    before: [f32; MAX_INPUTS],
    /// How the moved ones changed.
    changes: [f32; MAX_INPUTS],
    applied: Outputs,
    reward: f32,
}

/// The rule, its models and its memory.
#[derive(Debug, Clone)]
pub struct LearnedReward {
    table: ModelConfig,
    /// The inputs in the model's order: still ones first, then the moved ones.
    inputs: Vec<usize>,
    /// Their ranges.
    box_: Vec<[f32; 2]>,
    wraps: Vec<bool>,
    reward: RewardModel,
    movement: MovementModel,
    rehearsal: Rollouts,
    /// The policy, and one that starts from nothing every so often and may do better.
    champion: CandidatePolicy,
    challenger: CandidatePolicy,
    /// States in the model's order, a ring.
    memory: Vec<[f32; MAX_INPUTS]>,
    remembered: u64,
    /// Ticks since the world seemed to change.
    unchanged: u64,
    rng: Rng,
    waiting: Option<PendingTransition>,
    slope_norm: f32,
    halted: bool,
}

impl LearnedReward {
    /// The rule of `plan`, for a policy on features of `encoder`.
    pub fn of(spec: &LearnerSpec, encoder: &Encoder) -> Self {
        let table = spec.learner.model.clone().unwrap_or_default();
        let (count, outputs) = (spec.inputs.len(), spec.outputs);
        let moves = |i: usize| {
            if table.moved.is_empty() { i + outputs >= count } else { table.moved.contains(&spec.inputs[i].name) }
        };
        let mut inputs: Vec<_> = (0..count).filter(|&i| !moves(i)).collect();
        let still = inputs.len();
        inputs.extend((0..count).filter(|&i| moves(i)));
        let mut rank = vec![0; count];
        inputs.iter().enumerate().for_each(|(place, &input)| rank[input] = place);

        let signals: Vec<_> = inputs.iter().map(|&i| spec.inputs[i].clone()).collect();
        let reward = RewardModel::new(&table, &signals, still);
        let wraps: Vec<_> = signals[still..].iter().map(basis::wraps).collect();
        let sights = MapFeatures::of(&spec.maps, encoder, &rank, still, table.ridge);
        let rehearsal =
            Rollouts::new(sights, &reward, wraps.clone(), spec.normalise, table.horizon, table.last_counts as f32);
        Self {
            inputs,
            box_: signals.iter().map(|s| [s.min as f32, s.max as f32]).collect(),
            movement: MovementModel::new(outputs, wraps.len(), spec.sigma),
            wraps,
            reward,
            champion: CandidatePolicy::new(&rehearsal.sights, outputs, table.movements),
            challenger: CandidatePolicy::new(&rehearsal.sights, outputs, table.movements),
            rehearsal,
            memory: vec![[0.0; MAX_INPUTS]; table.memory],
            remembered: 0,
            unchanged: 0,
            rng: stream(spec.seed, "rehearsal"),
            waiting: None,
            slope_norm: 0.0,
            halted: false,
            table,
        }
    }

    /// Number of features of the reward model.
    pub fn model_size(&self) -> usize {
        self.reward.len()
    }

    /// A state that was, with the place to go to there.
    fn recall(&mut self) -> [f32; MAX_INPUTS] {
        // What was before a change of the world is no place to start from, once there is enough since.
        let window = self.unchanged.max(FEW).min(self.remembered).min(self.memory.len() as u64);
        let tick = self.remembered - 1 - self.rng.random_range(0..window);
        self.memory[(tick % self.memory.len() as u64) as usize]
    }

    /// The size of a step at an age.
    fn step(&self, age: u64) -> f32 {
        let fade = 1.0 / (1.0 + age as f64 / self.table.half_life);
        (self.table.step * fade.max(self.table.floor)) as f32
    }

    /// A state anywhere in the box of inputs.
    fn anywhere(&mut self) -> [f32; MAX_INPUTS] {
        let mut state = [0.0; MAX_INPUTS];
        for (x, [low, high]) in state.iter_mut().zip(&self.box_) {
            *x = low + (high - low) * self.rng.random::<f32>();
        }
        state
    }

    /// Rehearses both candidates towards the same places, one step each.
    fn rehearse(&mut self, rivals: bool) {
        let (count, still) = (self.inputs.len(), self.inputs.len() - self.wraps.len());
        for movement in 0..self.table.movements {
            let (recalled, mut drawn) = (self.recall(), self.anywhere());
            // What no command moves any more stands where it stands.
            for i in (0..self.wraps.len()).filter(|&i| !self.movement.moves(i)) {
                drawn[still + i] = recalled[still + i];
            }
            let [imagined, from] = [(); 2].map(|()| self.rng.random::<f64>());
            let place = if imagined < self.table.imagined { &drawn } else { &recalled };
            for candidate in [&mut self.champion, &mut self.challenger].into_iter().take(1 + usize::from(rivals)) {
                // Where it came to itself, where the body has been, or anywhere.
                let mut state = if from < self.table.anywhere {
                    drawn
                } else if from < self.table.anywhere + self.table.onward && candidate.age > 0 {
                    candidate.ends[movement]
                } else {
                    recalled
                };
                state[..still].copy_from_slice(&place[..still]);
                let inputs = &state[..count];
                let end = self.rehearsal.imagine(candidate, &mut self.reward, &self.movement, inputs);
                // Where a movement went beyond all numbers nobody goes on.
                candidate.ends[movement] = if end.iter().all(|x| x.is_finite()) { end } else { recalled };
            }
        }
        let ticks = self.table.movements * self.table.horizon;
        let steps = [&self.champion, &self.challenger].map(|c| self.step(c.age));
        let sights = &mut self.rehearsal.sights;
        // A model that is wrong for some ticks, of a body that has just surprised, can imagine movements without bound. Such a step is
        // dropped: the model will be better soon.
        let norm = self.champion.descend(sights, ticks, steps[0]);
        if norm.is_finite() {
            self.slope_norm = norm;
        }
        if rivals && !self.challenger.descend(sights, ticks, steps[1]).is_finite() {
            self.renew();
        }
    }

    /// Whether this tick is one to work in: every one, until the world has stayed the same for long.
    fn due(&self) -> bool {
        let seldom = (self.unchanged / self.table.rest).clamp(1, SELDOM);
        self.remembered.is_multiple_of(seldom)
    }

    /// Sends a new challenger.
    fn renew(&mut self) {
        self.challenger.be_born(&mut self.rng);
    }

    /// Takes in the tick that waits to be learned from.
    fn absorb(&mut self) {
        let Some(PendingTransition { inputs, before, changes, applied, reward }) = self.waiting.take() else { return };
        let (count, moved) = (self.inputs.len(), self.wraps.len());
        let other_body = self.movement.learn(&applied, &changes[..moved]);
        // A body that moves otherwise than it was asked to earns a reward that says nothing about asking.
        let changed = if other_body {
            Some(false)
        } else {
            self.reward.learn(&inputs[..count], &changes[..moved], reward, self.due())
        };
        let at = self.remembered as usize % self.memory.len();
        self.memory[at] = before;
        self.remembered += 1;
        self.halted = changed.is_none();
        self.unchanged += 1;
        if changed == Some(true) || other_body {
            self.unchanged = 0;
            self.champion.age = 0;
            self.champion.mean_cost = 0.0;
            self.renew();
        }
    }
}

impl LearningRule for LearnedReward {
    fn learn(&mut self, _policy: &mut LinearPolicy, tick: &Transition) -> f32 {
        if self.halted {
            return 0.0;
        }
        let still = self.inputs.len() - self.wraps.len();
        let (mut before, mut after) = ([0.0; MAX_INPUTS], [0.0; MAX_INPUTS]);
        let mut changes = [0.0; MAX_INPUTS];
        for (place, &input) in self.inputs.iter().enumerate() {
            before[place] = tick.inputs[input];
            // The reward was for the place shown then, and for where the movement led.
            after[place] = if place < still { tick.inputs[input] } else { tick.next_inputs[input] };
        }
        for (i, &wraps) in self.wraps.iter().enumerate() {
            let change = after[still + i] - before[still + i];
            changes[i] = if wraps { wrap(change) } else { change };
        }
        self.waiting =
            Some(PendingTransition { inputs: after, before, changes, applied: *tick.applied, reward: tick.reward });
        self.step(self.champion.age)
    }

    fn improve(&mut self, policy: &mut LinearPolicy) {
        self.absorb();
        if self.halted || self.remembered < self.table.start || !self.movement.ready() || !self.due() {
            return;
        }
        let rivals = self.table.challenge > 0 && self.remembered > SURE;
        if rivals && (self.challenger.age == 0 || self.challenger.age > self.table.challenge) {
            self.renew();
        }
        self.reward.freeze();
        self.champion.take(policy, &self.rehearsal.sights);
        for _ in 0..self.table.steps {
            if !self.halted {
                self.rehearse(rivals);
            }
        }
        let movements = self.table.steps * self.table.movements;
        self.champion.settle(movements);
        if rivals {
            self.challenger.settle(movements);
            if self.challenger.age > GROWN && self.challenger.mean_cost < BETTER * self.champion.mean_cost {
                self.champion.become_like(&self.challenger);
                self.renew();
            }
        }
        self.champion.give(policy, &self.rehearsal.sights);
    }

    /// There is no trace: what was learned of the world stays true.
    fn cut_trace(&mut self) {}

    /// The norm of the imagined cost's slope.
    fn trace_norm(&self) -> f32 {
        self.slope_norm
    }

    fn halted(&self) -> bool {
        self.halted
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
        visitor.number("unchanged", &mut self.unchanged);
        visitor.nested("rng", &mut self.rng);
        let mut waits = self.waiting.is_some();
        visitor.boolean("waits", &mut waits);
        let waiting = self.waiting.get_or_insert_default();
        visitor.numbers("waiting_inputs", &mut waiting.inputs);
        visitor.numbers("waiting_before", &mut waiting.before);
        visitor.numbers("waiting_changes", &mut waiting.changes);
        visitor.numbers("waiting_applied", &mut waiting.applied);
        visitor.number("waiting_reward", &mut waiting.reward);
        self.waiting.take_if(|_| !waits);
        visitor.number("slope_norm", &mut self.slope_norm);
        visitor.boolean("halted", &mut self.halted);
    }
}

#[cfg(test)]
mod tests;
