//! Actor-critic with eligibility traces (Degris, Pilarski & Sutton 2012, *Model-Free Reinforcement Learning with
//! Continuous Action in Practice*, ACC; algorithm "AC" with constant spread), and its natural gradient.
//!
//! A linear critic `V(k) = v . phi_k` stands on maps over pairs of inputs ([`PairFeatures`]) or on the actor's own features, and
//! on the reward of the tick before, if asked to. Its temporal-difference error takes the reward's place in the paper's rule:
//!
//! ```text
//! delta_k = r_k - c . q_k + gamma V(k+1) - V(k)
//! e_k     = gamma lambda e_{k-1} + h(phi_k)          v_{k+1} = v_k + alpha_v delta_k e_k
//! z_k     = beta z_{k-1} + n_k h(g_k)^T              W_{k+1} = W_k + (alpha / sigma^2) delta_k z_k
//! ```
//!
//! `c . q`, with `q = n^2 / sigma^2 - 1` for each output, is what the exploration itself costs or earns: the agent knows
//! its noise, and learns by least mean squares, `c += alpha_c delta q`, how the reward depends on its square. On the arm
//! that is half of the variance of the temporal-difference error. Since Gaussian noise has no third moment, `E[n q] = 0`: the gradient is the same,
//! with less noise (a control variate; Greensmith, Bartlett & Baxter 2004).
//!
//! `h` is the identity for the plain rule. For the natural one (Kakade 2001; Bhatnagar et al. 2009) it is the inverse of
//! the features' second-moment matrix over the input box, worked out when the learner is built ([`NaturalMetric`]): the step then
//! is as long in the space of commands whatever features overlap.
//!
//! Steps are bounded in the spirit of Elsayed et al. 2024 (*Streaming Deep Reinforcement Learning Finally Works*): an update
//! must not overshoot what it corrects. `V` at the features in hand moves by no more than the error, and the mean command
//! at them by no more than half a standard deviation of the noise ([`STRIDE`]), whatever the steps that were asked for. What a
//! trace answers to features is at most the sum of its parts' lengths times theirs, by Cauchy and Schwarz; that is a
//! number for each output, which decays as the trace does, and no pass over the features. Features are of one sign and change
//! slowly, so that it is not much more than what it bounds. An error, besides, counts for no more than some multiple of
//! the running mean of its size: no single surprise (a joint that blocks, a reward far off) can throw the weights away.

use super::CriticConfig;
use super::critic_kernel::CriticKernel;
use super::{LearningRule, NaturalMetric, PairFeatures, Transition, dot, sound};
use crate::MAX_OUTPUTS;
use crate::policy::{LinearPolicy, Outputs, Tiles, TraceStep};
use crate::state::{Persist, StateVisitor};
use tectum_encoder::Features;
use tectum_encoder::simd::SimdPath;

/// Constants of the critic.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CriticConstants {
    /// Its step `alpha_v`.
    pub step: f32,
    /// The discount `gamma` a tick.
    pub discount: f32,
    /// Decay of its trace, `lambda`.
    pub decay: f32,
    /// Factor with which the last reward enters as a feature.
    pub reward_feature: f32,
    /// Largest error, in running means of its size.
    pub bound: f32,
    /// Ticks after which the steps of actor and critic are half of what they were at first; infinite for constant steps.
    pub half_life: f32,
    /// Share of the first steps that they never fall below.
    pub floor: f32,
    /// Ticks over which the actor's step grows to its full size, while the critic learns its first values.
    pub warm_up: f32,
    /// Step `alpha_c` of what squared noise costs; 0 for never.
    pub noise_step: f32,
    /// Standard deviation of the noise.
    pub sigma: f32,
}

impl CriticConstants {
    /// The constants of a table, for noise of standard deviation `sigma`.
    pub fn of(table: &CriticConfig, sigma: f32) -> Self {
        Self {
            step: table.step as f32,
            discount: table.discount as f32,
            decay: table.decay as f32,
            reward_feature: table.reward_feature as f32,
            bound: table.bound as f32,
            half_life: table.half_life as f32,
            floor: table.floor as f32,
            warm_up: table.warm_up as f32,
            noise_step: table.noise_step as f32,
            sigma,
        }
    }
}

/// Share of the newest error in the running mean of its size.
const NEWEST: f32 = 1e-3;

/// Largest squared noise that counts as such, in variances, less 1: what is beyond was the gate's doing.
const LARGEST_SQUARE: f32 = 8.0;

/// Farthest that one tick may move the mean command at the features in hand, in standard deviations of the noise.
const STRIDE: f32 = 0.5;

/// The rule, its critic and both traces.
#[derive(Debug, Clone)]
pub struct ActorCritic {
    beta: f32,
    rate: f32,
    critic: CriticConstants,
    pairs: Option<PairFeatures>,
    sees_pairs: bool,
    metric: Option<NaturalMetric>,
    /// What squared noise on each output costs, `c`.
    noise_costs: Outputs,
    outputs: usize,
    /// In the layout of the policy's weights.
    trace: Tiles,
    values: Features,
    value_trace: Features,
    /// What the value weights are still to be moved by along their trace: the step of the tick before is taken in the pass
    /// over the features that the next one needs anyway.
    due: f32,
    /// Bounds of what the traces answer to features of length 1: the actor's by output, and the critic's.
    reach: Outputs,
    value_reach: f32,
    /// Weight and trace of the last reward as a feature, and that reward.
    last: [f32; 3],
    /// Running mean of the error's size.
    size: f32,
    learned: f32,
    halted: bool,
}

impl ActorCritic {
    /// The rule for a policy of `len` (padded) features and `outputs` outputs, with the actor's trace decay `beta` and
    /// `rate` = `alpha / sigma^2`.
    pub fn new(len: usize, outputs: usize, beta: f32, rate: f32, critic: CriticConstants) -> Self {
        Self {
            beta,
            rate,
            critic,
            pairs: None,
            sees_pairs: false,
            metric: None,
            noise_costs: [0.0; MAX_OUTPUTS],
            outputs,
            trace: Tiles::zeroed(len, outputs),
            values: Features::zeroed(len),
            value_trace: Features::zeroed(len),
            due: 0.0,
            reach: [0.0; MAX_OUTPUTS],
            value_reach: 0.0,
            last: [0.0; 3],
            size: 0.0,
            learned: 0.0,
            halted: false,
        }
    }

    /// The same with a critic that sees `pairs`, and with steps along the natural gradient of `metric`. The metric is one
    /// of the actor's features, and is the critic's too where it sees those.
    #[must_use]
    pub fn with(mut self, pairs: Option<PairFeatures>, metric: Option<NaturalMetric>) -> Self {
        if let Some(pairs) = &pairs {
            self.values = Features::zeroed(pairs.units());
            self.value_trace = self.values.clone();
        }
        Self { sees_pairs: pairs.is_some(), pairs, metric, ..self }
    }

    /// The error as far as it may count.
    fn bounded(&mut self, error: f32) -> f32 {
        // The first error sets the scale.
        let size = if self.learned == 0.0 { error.abs() } else { self.size };
        let bounded = error.clamp(-self.critic.bound * size, self.critic.bound * size);
        self.size = size + NEWEST * (bounded.abs() - size);
        bounded
    }

    /// How far the squares of `noise` are from their mean, in variances.
    fn squares(&self, noise: &Outputs) -> Outputs {
        let mut squares = [0.0; MAX_OUTPUTS];
        if self.critic.noise_step > 0.0 {
            for (square, n) in squares[..self.outputs].iter_mut().zip(noise) {
                let standard = n / self.critic.sigma;
                *square = (standard * standard - 1.0).min(LARGEST_SQUARE);
            }
        }
        squares
    }

    /// Takes the critic's step of the tick before, adds `direction` to its trace, and says what `here` and, after `reward`,
    /// `next` are worth: all in one pass, for there are many features.
    fn judge(&mut self, path: SimdPath, [here, next]: [&[f32]; 2], direction: &[f32], reward: f32) -> [f32; 2] {
        let (kept, due) = (self.critic.discount * self.critic.decay, std::mem::take(&mut self.due));
        let (values, trace) = (self.values.as_mut_slice(), self.value_trace.as_mut_slice());
        let seen = path.run(CriticKernel { values, trace, here, next, direction, kept, due });
        let factor = self.critic.reward_feature;
        let [weight, trace, last] = &mut self.last;
        *weight += due * *trace;
        *trace = *trace * kept + factor * *last;
        let rewards = [*last, reward];
        *last = reward;
        [0, 1].map(|i| seen[i] + *weight * factor * rewards[i])
    }

    /// As much of `step` as moves the value of either end of the tick by no more than the error: lengths of what is added
    /// to the trace and of the features, and the last reward and this one as features.
    fn critic_step(&mut self, step: f32, [added, length]: [f32; 2], [last, this]: [f32; 2]) -> f32 {
        self.value_reach = self.value_reach * self.critic.discount * self.critic.decay + whole(added, last);
        step.min(1.0 / (self.value_reach * whole(length, last.abs().max(this.abs()))))
    }

    /// As much of `rate` as moves the mean command at the features in hand by no more than [`STRIDE`].
    fn actor_step(&mut self, rate: f32, [added, length]: [f32; 2], noise: &Outputs) -> f32 {
        let mut most = 0.0_f32;
        for (reach, n) in self.reach.iter_mut().zip(noise) {
            *reach = *reach * self.beta + n.abs() * added;
            most = most.max(*reach);
        }
        let (stride, largest) = (rate.abs() * most * length, STRIDE * self.critic.sigma);
        if stride > largest { rate * (largest / stride) } else { rate }
    }

    fn learn_from(
        &mut self,
        policy: &mut LinearPolicy,
        tick: &Transition,
        [here, next]: [&[f32]; 2],
        metric: Option<&[f32]>,
        mean: &mut Outputs,
    ) -> f32 {
        let squares = self.squares(tick.noise);
        let cost: f32 = self.noise_costs.iter().zip(squares).map(|(c, q)| c * q).sum();
        let (direction, features) = (metric.unwrap_or(tick.features), tick.features);
        let side = length(features);
        let sides = [metric.map_or(side, length), side];
        let rewards = [self.last[2], tick.reward].map(|r| r * self.critic.reward_feature);
        let critics = if self.sees_pairs { here } else { direction };
        let [here_value, next_value] = self.judge(policy.path(), [here, next], critics, tick.reward);
        let error = tick.reward - cost + self.critic.discount * next_value - here_value;
        if !sound(error * self.rate, tick.noise) || !sound(error * self.critic.step, tick.noise) {
            self.halted = true;
            *mean = policy.mean(tick.next_features);
            return 0.0;
        }
        let error = self.bounded(error);
        for (cost, square) in self.noise_costs.iter_mut().zip(squares) {
            *cost += self.critic.noise_step * error * square;
        }
        let fade = (1.0 / (1.0 + self.learned / self.critic.half_life)).max(self.critic.floor);
        let lengths = if self.sees_pairs { [1.0; 2] } else { sides };
        self.due = self.critic_step(self.critic.step * fade, lengths, rewards) * error;
        let warm = ((self.learned + 1.0) / self.critic.warm_up.max(1.0)).min(1.0);
        let rate = self.actor_step(self.rate * warm * fade * error, sides, tick.noise);
        let step = TraceStep { features: direction, gain: tick.noise, decay: self.beta, rate };
        self.learned += 1.0;
        policy.step_and_answer(&mut self.trace, step, tick.next_features, mean);
        rate
    }
}

impl LearningRule for ActorCritic {
    fn learn(&mut self, policy: &mut LinearPolicy, tick: &Transition) -> f32 {
        self.learn_and_answer(policy, tick, &mut [0.0; MAX_OUTPUTS])
    }

    fn learn_and_answer(&mut self, policy: &mut LinearPolicy, tick: &Transition, mean: &mut Outputs) -> f32 {
        if self.halted {
            *mean = policy.mean(tick.next_features);
            return 0.0;
        }
        // Taken out for as long as their features are lent to the rest.
        let (mut pairs, mut metric) = (self.pairs.take(), self.metric.take());
        if let Some(metric) = &mut metric {
            metric.apply(tick.features);
        }
        let seen = match &mut pairs {
            Some(pairs) => pairs.see(tick.inputs, tick.next_inputs),
            None => [tick.features, tick.next_features],
        };
        let learned = self.learn_from(policy, tick, seen, metric.as_ref().map(NaturalMetric::result), mean);
        (self.pairs, self.metric) = (pairs, metric);
        learned
    }

    fn cut_trace(&mut self) {
        self.trace.clear();
        let due = std::mem::take(&mut self.due);
        for (v, e) in self.values.as_mut_slice().iter_mut().zip(self.value_trace.as_mut_slice()) {
            *v += *e * due;
            *e = 0.0;
        }
        self.last[0] += due * self.last[1];
        self.last[1] = 0.0;
        self.reach = [0.0; MAX_OUTPUTS];
        self.value_reach = 0.0;
    }

    fn trace_norm(&self) -> f32 {
        self.trace.norm()
    }

    fn halted(&self) -> bool {
        self.halted
    }
}

impl Persist for ActorCritic {
    /// What the pairs have seen last is not in it: they look again.
    fn visit_state(&mut self, visitor: &mut dyn StateVisitor) {
        visitor.numbers("noise_costs", &mut self.noise_costs);
        visitor.nested("trace", &mut self.trace);
        visitor.numbers("values", self.values.as_mut_slice());
        visitor.numbers("value_trace", self.value_trace.as_mut_slice());
        visitor.number("due", &mut self.due);
        visitor.numbers("reach", &mut self.reach);
        visitor.number("value_reach", &mut self.value_reach);
        visitor.numbers("last", &mut self.last);
        visitor.number("size", &mut self.size);
        visitor.number("learned", &mut self.learned);
        visitor.boolean("halted", &mut self.halted);
    }
}

/// Length of features with one more.
fn whole(length: f32, more: f32) -> f32 {
    (length * length + more * more).sqrt()
}

/// Euclidean length.
fn length(features: &[f32]) -> f32 {
    dot(features, features).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    const CRITIC: CriticConstants = CriticConstants {
        step: 0.5,
        discount: 0.9,
        decay: 0.5,
        reward_feature: 0.25,
        bound: 3.0,
        half_life: f32::INFINITY,
        floor: 0.0,
        warm_up: 0.0,
        noise_step: 0.0,
        sigma: 1.0,
    };

    fn tick<'a>(features: &'a [f32], noise: &'a Outputs, reward: f32, next_features: &'a [f32]) -> Transition<'a> {
        Transition { features, inputs: &[], noise, applied: noise, reward, next_features, next_inputs: &[] }
    }

    /// All value weights, once the step that is due has been taken.
    fn values(rule: &mut ActorCritic) -> Vec<f32> {
        let mut taken = rule.clone();
        taken.cut_trace();
        taken.values.as_slice().to_vec()
    }

    #[test]
    fn two_ticks_are_the_equations() {
        let mut policy = LinearPolicy::new(4, (0..4).collect(), 4);
        // Steps that no bound meets.
        let critic = CriticConstants { step: 0.25, sigma: 10.0, ..CRITIC };
        let mut rule = ActorCritic::new(4, 4, 0.8, 0.1, critic);
        let mut noise = [0.0; 8];
        noise[..2].copy_from_slice(&[0.5, -1.0]);
        let (a, b, c) = ([1.0, 0.0, 0.5, 0.0], [0.0, 1.0, 0.5, 0.0], [0.0, 0.0, 1.0, 0.0]);
        rule.learn(&mut policy, &tick(&a, &noise, -2.0, &b));
        // No value yet: delta = r. v = 0.25 * -2 * a; the last reward was 0, so its weight stays.
        assert_eq!(values(&mut rule), [-0.5, 0.0, -0.25, 0.0]);
        assert!((policy.weight(1, 0) - 0.2).abs() < 1e-6);
        // delta = -1 + 0.9 * -0.25 - -0.125.
        rule.learn(&mut policy, &tick(&b, &noise, -1.0, &c));
        let delta = -1.0 + 0.9 * -0.25 + 0.125_f32;
        let trace = [0.45, 1.0, 0.45 * 0.5 + 0.5, 0.0];
        let now = values(&mut rule);
        for (i, before) in [-0.5, 0.0, -0.25, 0.0].iter().enumerate() {
            assert!((now[i] - (before + 0.25 * delta * trace[i])).abs() < 1e-6);
        }
        rule.cut_trace();
        assert!((rule.last[0] - 0.25 * delta * 0.25 * -2.0).abs() < 1e-6);
        let expected = -0.1 + 0.1 * delta * (0.8 * 0.5 * 1.0);
        assert!((policy.weight(0, 0) - expected).abs() < 1e-6);
    }

    #[test]
    fn no_step_moves_a_mean_or_a_value_farther_than_the_bounds() {
        let (a, b) = ([0.8, 0.6, 0.0, 0.0], [0.0, 0.6, 0.8, 0.0]);
        for metric in [None, Some(NaturalMetric::from_moments(vec![0.25; 16], 4, 4, 0.3))] {
            let mut policy = LinearPolicy::new(4, (0..4).collect(), 3);
            let critic = CriticConstants { step: 100.0, sigma: 0.2, bound: 1e9, ..CRITIC };
            let mut rule = ActorCritic::new(4, 3, 0.9, 1000.0, critic).with(None, metric);
            let mut exploration = crate::policy::Exploration::new(3, 0.2, 3);
            let mut longest = 0.0_f32;
            for k in 0..500 {
                let (here, next) = if k % 7 < 3 { (&a, &b) } else { (&b, &a) };
                let (before, value) = (policy.mean(here), dot(&values(&mut rule), here));
                let reward = if k % 50 == 49 { -1e4 } else { -1.0 };
                let known = reward + 0.9 * dot(&values(&mut rule), next) - value;
                rule.learn(&mut policy, &tick(here, &exploration.draw(), reward, next));
                for (after, before) in policy.mean(here).iter().zip(before) {
                    longest = longest.max((after - before).abs());
                }
                // The last reward is a feature too, and may have its share of the error.
                let moved = dot(&values(&mut rule), here) - value;
                let weight = rule.last[0].abs() * 0.25 * 2e4;
                assert!(moved.abs() <= known.abs() + weight + 1e-3, "{k}: {moved} {known}");
            }
            // In single precision, about weights that are of the order of 1.
            assert!(longest <= STRIDE * 0.2 * 1.001 && longest > 0.5 * STRIDE * 0.2, "{longest}");
            assert!(!rule.halted());
        }
    }

    #[test]
    fn what_squared_noise_costs_is_learned_and_taken_out() {
        let mut policy = LinearPolicy::new(4, (0..4).collect(), 2);
        let critic = CriticConstants { noise_step: 0.05, sigma: 0.5, bound: 1e6, ..CRITIC };
        let mut rule = ActorCritic::new(4, 2, 0.0, 0.0, critic);
        let mut exploration = crate::policy::Exploration::new(3, 0.5, 2);
        for _ in 0..2000 {
            let noise = exploration.draw();
            let reward = -0.1 - 0.3 * noise[0] * noise[0];
            rule.learn(&mut policy, &tick(&[1.0, 0.0, 0.0, 0.0], &noise, reward, &[1.0, 0.0, 0.0, 0.0]));
        }
        // 0.3 sigma^2 on the first output, nothing on the second, nor on outputs that are not there.
        assert!((rule.noise_costs[0] + 0.075).abs() < 0.01, "{:?}", rule.noise_costs);
        assert!(rule.noise_costs[1].abs() < 0.01 && rule.noise_costs[2..] == [0.0; 6], "{:?}", rule.noise_costs);
        assert!(rule.size < 0.03, "{}", rule.size);
    }

    #[test]
    fn a_surprise_counts_for_no_more_than_the_bound() {
        let mut rule = ActorCritic::new(4, 4, 0.8, 0.1, CRITIC);
        assert_eq!(rule.bounded(-0.5), -0.5);
        rule.learned = 1.0;
        assert_eq!(rule.bounded(-100.0), -1.5);
    }

    #[test]
    fn a_number_that_is_not_finite_stops_learning() {
        let mut policy = LinearPolicy::new(4, (0..4).collect(), 4);
        let mut rule = ActorCritic::new(4, 4, 0.8, 0.1, CRITIC);
        rule.values.as_mut_slice()[0] = f32::INFINITY;
        let noise = [1.0; 8];
        rule.learn(&mut policy, &tick(&[1.0; 4], &noise, -1.0, &[1.0; 4]));
        assert!(rule.halted());
        rule.values.as_mut_slice()[0] = 0.0;
        rule.learn(&mut policy, &tick(&[1.0; 4], &noise, -1.0, &[1.0; 4]));
        assert_eq!(policy.norm(), 0.0);
    }
}
