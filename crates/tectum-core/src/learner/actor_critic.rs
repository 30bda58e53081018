//! Actor-critic with eligibility traces (Degris, Pilarski & Sutton 2012, *Model-Free Reinforcement Learning with
//! Continuous Action in Practice*, ACC; algorithm "AC" with constant spread), and its natural gradient.
//!
//! The critic is linear, `V(k) = v . phi_k`. Its features are maps over pairs of inputs ([`PairFeatures`]) or
//! the actor's own features, and optionally the reward of the previous tick. In the paper's rule, the
//! temporal-difference error replaces the reward:
//!
//! ```text
//! delta_k = r_k - c . q_k + gamma V(k+1) - V(k)
//! e_k     = gamma lambda e_{k-1} + h(phi_k)          v_{k+1} = v_k + alpha_v delta_k e_k
//! z_k     = beta z_{k-1} + n_k h(g_k)^T              W_{k+1} = W_k + (alpha / sigma^2) delta_k z_k
//! ```
//!
//! `c . q`, with `q = n^2 / sigma^2 - 1` for each output, is the effect of the exploration itself on the
//! reward. The agent knows its noise and learns by least mean squares, `c += alpha_c delta q`, how the reward
//! depends on the noise's square. On the arm this is half of the variance of the temporal-difference error.
//! Gaussian noise has no third moment, so `E[n q] = 0`: the gradient is the same, with less noise (a control
//! variate; Greensmith, Bartlett & Baxter 2004).
//!
//! `h` is the identity for the plain rule. For the natural gradient (Kakade 2001; Bhatnagar et al. 2009) it is
//! the inverse of the features' second-moment matrix over the input box, computed when the learner is built
//! ([`NaturalMetric`]). The length of a step in the space of commands then does not depend on how much features
//! overlap.
//!
//! Steps are bounded in the spirit of Elsayed et al. 2024 (*Streaming Deep Reinforcement Learning Finally
//! Works*): an update must not overshoot the error that it corrects. For any configured step, `V` at the
//! current features moves by no more than the error, and the mean command at the current features by no more
//! than half a standard deviation of the noise ([`MAX_MEAN_STEP`]). By Cauchy and Schwarz, the product of a
//! trace with features is at most the sum of the lengths of the trace's terms, times the length of the
//! features. This sum is one number per output, which decays like the trace, and needs no pass over the
//! features. Features have one sign and change slowly, so the bound is tight. In addition, an error is limited
//! to a multiple of the running mean of its size, so that no single outlier (a joint that blocks, an extreme
//! reward) can destroy the weights. Errors that go beyond the limit for [`NEW_SCALE_TICKS`] ticks in a row are no
//! outliers: rewards have another size now, and the running mean begins anew with them.
//!
//! A mean command beyond the gate's limit is moved back to it ([`MEAN_MARGIN`]). Where the gate limits the
//! command, the reward no longer depends on how far beyond the limit the mean is. The credited noise is then the
//! way from the mean back to the limit, so that each error of the critic moves the mean by more the farther out
//! it is: without a bound it drifts away and does not come back.

use super::CriticConfig;
use super::critic_kernel::CriticKernel;
use super::{LearningRule, NaturalMetric, PairFeatures, Transition, dot, is_safe};
use crate::MAX_OUTPUTS;
use crate::plant::EpisodeEnd;
use crate::policy::{LinearPolicy, Outputs, Tiles, TraceStep};
use crate::state::{Persist, StateVisitor};
use tectum_encoder::Features;
use tectum_encoder::simd::SimdPath;

/// Constants of the critic.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CriticConstants {
    /// Step of the critic, `alpha_v`.
    pub step: f32,
    /// Discount per tick, `gamma`.
    pub discount: f32,
    /// Decay of the critic's trace, `lambda`.
    pub decay: f32,
    /// Factor of the last reward as a feature of the critic; 0 for none.
    pub reward_feature: f32,
    /// Largest error, in multiples of the running mean of its size.
    pub bound: f32,
    /// Ticks after which the steps of actor and critic are half of the initial ones; infinite for constant steps.
    pub half_life: f32,
    /// Lower limit of the steps, as a fraction of the initial ones.
    pub floor: f32,
    /// Ticks over which the actor's step grows to its full size, while the critic learns initial values.
    pub warm_up: f32,
    /// Step of the cost of squared noise, `alpha_c`; 0 to disable it.
    pub noise_step: f32,
    /// Standard deviation of the noise.
    pub sigma: f32,
}

impl CriticConstants {
    /// The constants of a configuration, for noise of standard deviation `sigma`.
    pub fn of(config: &CriticConfig, sigma: f32) -> Self {
        Self {
            step: config.step as f32,
            discount: config.discount as f32,
            decay: config.decay as f32,
            reward_feature: config.reward_feature as f32,
            bound: config.bound as f32,
            half_life: config.half_life as f32,
            floor: config.floor as f32,
            warm_up: config.warm_up as f32,
            noise_step: config.noise_step as f32,
            sigma,
        }
    }
}

/// Weight of the newest error in the running mean of its size.
const ERROR_SIZE_RATE: f32 = 1e-3;

/// Largest value of `q`: larger squared noise is the effect of the gate, not of exploration.
const MAX_NOISE_SQUARE: f32 = 8.0;

/// Largest change of the mean command at the current features in one tick, in standard deviations of the noise.
const MAX_MEAN_STEP: f32 = 0.5;

/// How far the mean command may go beyond the gate's limit, in standard deviations of the noise: far enough for
/// nearly every command to have full size where that is best.
const MEAN_MARGIN: f32 = 1.0;

/// Limited errors in a row after which the running mean of their size begins anew.
const NEW_SCALE_TICKS: u32 = 20;

/// The actor-critic rule: constants, critic and both traces.
#[derive(Debug, Clone)]
pub struct ActorCritic {
    beta: f32,
    rate: f32,
    critic: CriticConstants,
    pairs: Option<PairFeatures>,
    /// Whether the critic's features are those of pairs. `pairs` itself is empty during an update.
    uses_pairs: bool,
    metric: Option<NaturalMetric>,
    /// The cost of squared noise on each output, `c`.
    noise_costs: Outputs,
    outputs: usize,
    /// The actor's trace, in the layout of the policy's weights.
    trace: Tiles,
    values: Features,
    value_trace: Features,
    /// The step of the value weights along their trace that is not applied yet: it is applied in the next tick,
    /// in the pass over the features that that tick needs anyway.
    pending_step: f32,
    /// Upper bounds of the product of the traces with features of length 1: the actor's by output, and the
    /// critic's.
    trace_bound: Outputs,
    value_trace_bound: f32,
    /// The last reward as a feature of the critic: its weight, its trace, and the reward.
    reward_input: [f32; 3],
    /// Largest mean command of each output.
    max_mean: Outputs,
    /// Running mean of the error's size; 0 until there was an error.
    error_size: f32,
    /// Number of limited errors in a row.
    limited_errors: u32,
    /// Number of ticks learned from.
    ticks_learned: f32,
    /// Whether the tick that is being learned from ends its episode with the value zero.
    terminated: bool,
    halted: bool,
}

impl ActorCritic {
    /// The rule for a policy of `len` features, including padding, and `outputs` outputs, with the actor's
    /// trace decay `beta` and `rate` = `alpha / sigma^2`.
    pub fn new(len: usize, outputs: usize, beta: f32, rate: f32, critic: CriticConstants) -> Self {
        Self {
            beta,
            rate,
            critic,
            pairs: None,
            uses_pairs: false,
            metric: None,
            noise_costs: [0.0; MAX_OUTPUTS],
            outputs,
            trace: Tiles::zeroed(len, outputs),
            values: Features::zeroed(len),
            value_trace: Features::zeroed(len),
            pending_step: 0.0,
            trace_bound: [0.0; MAX_OUTPUTS],
            value_trace_bound: 0.0,
            reward_input: [0.0; 3],
            max_mean: [f32::INFINITY; MAX_OUTPUTS],
            error_size: 0.0,
            limited_errors: 0,
            ticks_learned: 0.0,
            terminated: false,
            halted: false,
        }
    }

    /// The same rule with a critic over `pairs`, and with steps along the natural gradient of `metric`. The
    /// metric is that of the actor's features, and also applies to the critic if it has the same features.
    #[must_use]
    pub fn with(mut self, pairs: Option<PairFeatures>, metric: Option<NaturalMetric>) -> Self {
        if let Some(pairs) = &pairs {
            self.values = Features::zeroed(pairs.units());
            self.value_trace = self.values.clone();
        }
        Self { uses_pairs: pairs.is_some(), pairs, metric, ..self }
    }

    /// The same rule for commands that a gate limits to `max_command`.
    #[must_use]
    pub fn limited_to(self, max_command: Outputs) -> Self {
        let margin = MEAN_MARGIN * self.critic.sigma;
        Self { max_mean: max_command.map(|limit| limit + margin), ..self }
    }

    /// Moves mean commands that are beyond the gate's limit back to it, by the smallest change of the weights.
    /// `mean` is the policy's mean for `features`.
    fn limit_mean(&self, policy: &mut LinearPolicy, features: &[f32], mean: &mut Outputs) {
        if mean.iter().zip(self.max_mean).all(|(mean, limit)| mean.abs() <= limit) {
            return;
        }
        let square = dot(features, features);
        for (output, (mean, limit)) in mean.iter().zip(self.max_mean).take(self.outputs).enumerate() {
            let share = (mean.clamp(-limit, limit) - mean) / square;
            for (position, feature) in features.iter().enumerate().filter(|_| share.is_finite() && share != 0.0) {
                *policy.weights_mut().get_mut(output, position) += share * feature;
            }
        }
        *mean = policy.mean(features);
    }

    /// Limits the error and updates the running mean of its size.
    fn bound_error(&mut self, error: f32) -> f32 {
        // The first error that is not 0 sets the scale, and so does one after many that were beyond it.
        let limited = error.abs() > self.critic.bound * self.error_size;
        self.limited_errors = if limited { self.limited_errors + 1 } else { 0 };
        let begins = self.error_size == 0.0 || self.limited_errors > NEW_SCALE_TICKS;
        let size = if begins { error.abs() } else { self.error_size };
        let bounded = error.clamp(-self.critic.bound * size, self.critic.bound * size);
        self.error_size = size + ERROR_SIZE_RATE * (bounded.abs() - size);
        bounded
    }

    /// `q` for each output: the squares of `noise` in variances, less their mean of 1.
    fn noise_squares(&self, noise: &Outputs) -> Outputs {
        let mut squares = [0.0; MAX_OUTPUTS];
        if self.critic.noise_step > 0.0 {
            for (square, n) in squares[..self.outputs].iter_mut().zip(noise) {
                let standard = n / self.critic.sigma;
                *square = (standard * standard - 1.0).min(MAX_NOISE_SQUARE);
            }
        }
        squares
    }

    /// Applies the critic's step of the previous tick, adds `direction` to its trace, and returns the values of
    /// `here` and, after `reward`, of `next`: all in one pass, because there are many features.
    fn evaluate(&mut self, path: SimdPath, [here, next]: [&[f32]; 2], direction: &[f32], reward: f32) -> [f32; 2] {
        let (decay, step) = (self.critic.discount * self.critic.decay, std::mem::take(&mut self.pending_step));
        let (values, trace) = (self.values.as_mut_slice(), self.value_trace.as_mut_slice());
        let products = path.run(CriticKernel { values, trace, here, next, direction, decay, step });
        let factor = self.critic.reward_feature;
        let [weight, trace, last] = &mut self.reward_input;
        *weight += step * *trace;
        *trace = *trace * decay + factor * *last;
        let rewards = [*last, reward];
        *last = reward;
        [0, 1].map(|i| products[i] + *weight * factor * rewards[i])
    }

    /// Limits `step` so that the value at either end of the tick moves by no more than the error. `added` is
    /// the length of what is added to the trace, `length` that of the features; `last` and `this` are the
    /// rewards as features.
    fn critic_step(&mut self, step: f32, [added, length]: [f32; 2], [last, this]: [f32; 2]) -> f32 {
        self.value_trace_bound =
            self.value_trace_bound * self.critic.discount * self.critic.decay + extended_length(added, last);
        step.min(1.0 / (self.value_trace_bound * extended_length(length, last.abs().max(this.abs()))))
    }

    /// Limits `rate` so that the mean command at the current features moves by no more than [`MAX_MEAN_STEP`].
    /// `added` is the length of what is added to the trace, `length` that of the features.
    fn actor_step(&mut self, rate: f32, [added, length]: [f32; 2], noise: &Outputs) -> f32 {
        let mut largest_bound = 0.0_f32;
        for (bound, n) in self.trace_bound.iter_mut().zip(noise) {
            *bound = *bound * self.beta + n.abs() * added;
            largest_bound = largest_bound.max(*bound);
        }
        let (change, limit) = (rate.abs() * largest_bound * length, MAX_MEAN_STEP * self.critic.sigma);
        if change > limit { rate * (limit / change) } else { rate }
    }

    /// One update with the critic's features `here` and `next`, and the natural direction of the actor's
    /// features, if any. Returns the factor of the actor's trace, and writes the mean output for the next
    /// features to `mean`.
    fn learn_from(
        &mut self,
        policy: &mut LinearPolicy,
        tick: &Transition,
        [here, next]: [&[f32]; 2],
        natural: Option<&[f32]>,
        mean: &mut Outputs,
    ) -> f32 {
        let squares = self.noise_squares(tick.noise);
        let cost: f32 = self.noise_costs.iter().zip(squares).map(|(c, q)| c * q).sum();
        let (direction, features) = (natural.unwrap_or(tick.features), tick.features);
        let actor_length = length(features);
        let actor_lengths = [natural.map_or(actor_length, length), actor_length];
        let rewards = [self.reward_input[2], tick.reward].map(|r| r * self.critic.reward_feature);
        let critic_direction = if self.uses_pairs { here } else { direction };
        let [here_value, next_value] = self.evaluate(policy.path(), [here, next], critic_direction, tick.reward);
        let next_value = if self.terminated { 0.0 } else { next_value };
        let error = tick.reward - cost + self.critic.discount * next_value - here_value;
        if !is_safe(error * self.rate, tick.noise) || !is_safe(error * self.critic.step, tick.noise) {
            self.halted = true;
            *mean = policy.mean(tick.next_features);
            return 0.0;
        }
        let error = self.bound_error(error);
        for (cost, square) in self.noise_costs.iter_mut().zip(squares) {
            *cost += self.critic.noise_step * error * square;
        }
        let fade = (1.0 / (1.0 + self.ticks_learned / self.critic.half_life)).max(self.critic.floor);
        let critic_lengths = if self.uses_pairs { [1.0; 2] } else { actor_lengths };
        self.pending_step = self.critic_step(self.critic.step * fade, critic_lengths, rewards) * error;
        let warm = ((self.ticks_learned + 1.0) / self.critic.warm_up.max(1.0)).min(1.0);
        let rate = self.actor_step(self.rate * warm * fade * error, actor_lengths, tick.noise);
        let step = TraceStep { features: direction, gain: tick.noise, decay: self.beta, rate };
        self.ticks_learned += 1.0;
        policy.step_and_answer(&mut self.trace, step, tick.next_features, mean);
        self.limit_mean(policy, tick.next_features, mean);
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
        // Moved out of `self` while their features are borrowed.
        let (mut pairs, mut metric) = (self.pairs.take(), self.metric.take());
        if let Some(metric) = &mut metric {
            metric.apply(tick.features);
        }
        let critic_features = match &mut pairs {
            Some(pairs) => pairs.encode_pair(tick.inputs, tick.next_inputs),
            None => [tick.features, tick.next_features],
        };
        let rate = self.learn_from(policy, tick, critic_features, metric.as_ref().map(NaturalMetric::result), mean);
        (self.pairs, self.metric) = (pairs, metric);
        rate
    }

    /// The value after a terminated episode is zero. After a truncated one it is unknown, and so is the error.
    fn learn_last(&mut self, policy: &mut LinearPolicy, tick: &Transition, end: EpisodeEnd) -> Option<f32> {
        self.terminated = end == EpisodeEnd::Terminated;
        let step = self.terminated.then(|| self.learn(policy, tick));
        self.terminated = false;
        self.cut_trace();
        step
    }

    fn cut_trace(&mut self) {
        self.trace.clear();
        let step = std::mem::take(&mut self.pending_step);
        for (v, e) in self.values.as_mut_slice().iter_mut().zip(self.value_trace.as_mut_slice()) {
            *v += *e * step;
            *e = 0.0;
        }
        self.reward_input[0] += step * self.reward_input[1];
        self.reward_input[1] = 0.0;
        self.trace_bound = [0.0; MAX_OUTPUTS];
        self.value_trace_bound = 0.0;
    }

    fn trace_norm(&self) -> f32 {
        self.trace.norm()
    }

    fn halted(&self) -> bool {
        self.halted
    }
}

impl Persist for ActorCritic {
    /// The features of pairs are not part of the state: they are encoded again.
    fn visit_state(&mut self, visitor: &mut dyn StateVisitor) {
        visitor.numbers("noise_costs", &mut self.noise_costs);
        visitor.nested("trace", &mut self.trace);
        visitor.numbers("values", self.values.as_mut_slice());
        visitor.numbers("value_trace", self.value_trace.as_mut_slice());
        visitor.number("due", &mut self.pending_step);
        visitor.numbers("reach", &mut self.trace_bound);
        visitor.number("value_reach", &mut self.value_trace_bound);
        visitor.numbers("last", &mut self.reward_input);
        visitor.number("size", &mut self.error_size);
        visitor.number("limited_errors", &mut self.limited_errors);
        visitor.number("learned", &mut self.ticks_learned);
        visitor.boolean("halted", &mut self.halted);
    }
}

/// Euclidean length of features of length `length` with one more feature `more`.
fn extended_length(length: f32, more: f32) -> f32 {
    (length * length + more * more).sqrt()
}

/// Euclidean length.
fn length(features: &[f32]) -> f32 {
    dot(features, features).sqrt()
}

#[cfg(test)]
mod tests;
