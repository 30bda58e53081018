//! Actor-critic with eligibility traces (Degris, Pilarski & Sutton 2012, *Model-Free Reinforcement Learning with
//! Continuous Action in Practice*, ACC; algorithm "AC" with constant spread), and its natural gradient.
//!
//! A linear critic `V(k) = v . phi_k` stands on the actor's own features and one more, the reward of the tick before, and
//! its temporal-difference error takes the reward's place in the paper's rule:
//!
//! ```text
//! delta_k = r_k + gamma V(k+1) - V(k)
//! e_k     = gamma lambda e_{k-1} + h(phi_k)          v_{k+1} = v_k + alpha_v delta_k e_k
//! z_k     = beta z_{k-1} + n_k h(g_k)^T              W_{k+1} = W_k + (alpha / sigma^2) delta_k z_k
//! ```
//!
//! `h` is the identity for the plain rule. For the natural one (Kakade 2001; Bhatnagar et al. 2009) it is the inverse of
//! the features' second-moment matrix over the input box, worked out when the learner is built ([`Metric`]): the step then
//! is as long in the space of commands whatever features overlap.
//!
//! Steps are bounded in the spirit of Elsayed et al. 2024: an error counts for no more than some multiple of the running
//! mean of its size, so that no single surprise (a joint that blocks, a reward far off) can throw the weights away.

use glam::Vec4;

use super::{LearningRule, Metric, Tick, dot};
use crate::policy::{Linear, Outputs, norm};
use crate::scenario::CriticTable;

/// Constants of the critic.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Critic {
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
}

impl Critic {
    /// The constants of a table.
    pub fn of(table: &CriticTable) -> Self {
        Self {
            step: table.step as f32,
            discount: table.discount as f32,
            decay: table.decay as f32,
            reward_feature: table.reward_feature as f32,
            bound: table.bound as f32,
            half_life: table.half_life as f32,
            floor: table.floor as f32,
        }
    }
}

/// Share of the newest error in the running mean of its size.
const NEWEST: f32 = 1e-3;

/// The rule, its critic and both traces.
#[derive(Debug, Clone)]
pub struct ActorCritic {
    beta: f32,
    rate: f32,
    critic: Critic,
    metric: Option<Metric>,
    /// In the layout of the policy's weights.
    trace: Vec<Vec<Vec4>>,
    values: Vec<f32>,
    value_trace: Vec<f32>,
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
    pub fn new(len: usize, outputs: usize, beta: f32, rate: f32, critic: Critic, metric: Option<Metric>) -> Self {
        Self {
            beta,
            rate,
            critic,
            metric,
            trace: vec![vec![Vec4::ZERO; len]; outputs.div_ceil(4)],
            values: vec![0.0; len],
            value_trace: vec![0.0; len],
            last: [0.0; 3],
            size: 0.0,
            learned: 0.0,
            halted: false,
        }
    }

    /// The value of `features` after `reward`.
    fn value(&self, features: &[f32], reward: f32) -> f32 {
        dot(&self.values, features) + self.last[0] * self.critic.reward_feature * reward
    }

    /// The error as far as it may count.
    fn bounded(&mut self, error: f32) -> f32 {
        // The first error sets the scale.
        let size = if self.learned == 0.0 { error.abs() } else { self.size };
        let bounded = error.clamp(-self.critic.bound * size, self.critic.bound * size);
        self.size = size + NEWEST * (bounded.abs() - size);
        bounded
    }

    fn apply(&mut self, policy: &mut Linear, direction: Option<&[f32]>, noise: &Outputs, error: f32) -> f32 {
        let Critic { step, discount, decay, reward_feature, half_life, floor, .. } = self.critic;
        let fade = (1.0 / (1.0 + self.learned / half_life)).max(floor);
        let direction = direction.or(self.metric.as_ref().map(Metric::result)).unwrap_or_default();
        let (kept, gain) = (discount * decay, step * fade * error);
        for ((v, e), &h) in self.values.iter_mut().zip(&mut self.value_trace).zip(direction) {
            *e = *e * kept + h;
            *v += gain * *e;
        }
        self.last[1] = self.last[1] * kept + reward_feature * self.last[2];
        self.last[0] += gain * self.last[1];
        let rate = self.rate * fade * error;
        let lanes = noise.chunks_exact(4).map(Vec4::from_slice);
        for ((weights, trace), noise) in policy.groups_mut().zip(&mut self.trace).zip(lanes) {
            for ((w, z), &h) in weights.iter_mut().zip(trace).zip(direction) {
                *z = *z * self.beta + noise * h;
                *w += *z * rate;
            }
        }
        rate
    }
}

impl LearningRule for ActorCritic {
    fn learn(&mut self, policy: &mut Linear, tick: &Tick) -> f32 {
        if self.halted {
            return 0.0;
        }
        let here = self.value(tick.features, self.last[2]);
        let next = self.value(tick.next_features, tick.reward);
        let error = tick.reward + self.critic.discount * next - here;
        if !error.is_finite() {
            self.halted = true;
            return 0.0;
        }
        let error = self.bounded(error);
        let step = if let Some(metric) = &mut self.metric {
            metric.apply(tick.features);
            self.apply(policy, None, tick.noise, error)
        } else {
            self.apply(policy, Some(tick.features), tick.noise, error)
        };
        self.last[2] = tick.reward;
        self.learned += 1.0;
        step
    }

    fn cut_trace(&mut self) {
        for group in &mut self.trace {
            group.fill(Vec4::ZERO);
        }
        self.value_trace.fill(0.0);
        self.last[1] = 0.0;
    }

    fn trace_norm(&self) -> f32 {
        norm(&self.trace)
    }

    fn halted(&self) -> bool {
        self.halted
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const CRITIC: Critic = Critic {
        step: 0.5,
        discount: 0.9,
        decay: 0.5,
        reward_feature: 0.25,
        bound: 3.0,
        half_life: f32::INFINITY,
        floor: 0.0,
    };

    fn tick<'a>(features: &'a [f32], noise: &'a Outputs, reward: f32, next_features: &'a [f32]) -> Tick<'a> {
        Tick { features, inputs: &[], noise, applied: noise, reward, next_features, next_inputs: &[] }
    }

    #[test]
    fn two_ticks_are_the_equations() {
        let mut policy = Linear::new(4, (0..4).collect(), 4);
        let mut rule = ActorCritic::new(4, 4, 0.8, 0.1, CRITIC, None);
        let mut noise = [0.0; 8];
        noise[..2].copy_from_slice(&[0.5, -1.0]);
        let (a, b, c) = ([1.0, 0.0, 0.5, 0.0], [0.0, 1.0, 0.5, 0.0], [0.0, 0.0, 1.0, 0.0]);
        rule.learn(&mut policy, &tick(&a, &noise, -2.0, &b));
        // No value yet: delta = r. v = 0.5 * -2 * a; the last reward was 0, so its weight stays.
        assert_eq!(rule.values, [-1.0, 0.0, -0.5, 0.0]);
        assert!((policy.weight(1, 0) - 0.2).abs() < 1e-6);
        // delta = -1 + 0.9 * -0.5 - -0.25.
        rule.learn(&mut policy, &tick(&b, &noise, -1.0, &c));
        let delta = -1.0 + 0.9 * -0.5 + 0.25_f32;
        let trace = [0.45, 1.0, 0.45 * 0.5 + 0.5, 0.0];
        for (i, before) in [-1.0, 0.0, -0.5, 0.0].iter().enumerate() {
            assert!((rule.values[i] - (before + 0.5 * delta * trace[i])).abs() < 1e-6);
        }
        assert!((rule.last[0] - 0.5 * delta * 0.25 * -2.0).abs() < 1e-6);
        let expected = -0.1 + 0.1 * delta * (0.8 * 0.5 * 1.0);
        assert!((policy.weight(0, 0) - expected).abs() < 1e-6);
    }

    #[test]
    fn a_surprise_counts_for_no_more_than_the_bound() {
        let mut rule = ActorCritic::new(4, 4, 0.8, 0.1, CRITIC, None);
        assert_eq!(rule.bounded(-0.5), -0.5);
        rule.learned = 1.0;
        assert_eq!(rule.bounded(-100.0), -1.5);
    }

    #[test]
    fn a_number_that_is_not_finite_stops_learning() {
        let mut policy = Linear::new(4, (0..4).collect(), 4);
        let mut rule = ActorCritic::new(4, 4, 0.8, 0.1, CRITIC, None);
        rule.values[0] = f32::INFINITY;
        let noise = [1.0; 8];
        rule.learn(&mut policy, &tick(&[1.0; 4], &noise, -1.0, &[1.0; 4]));
        assert!(rule.halted());
        rule.values[0] = 0.0;
        rule.learn(&mut policy, &tick(&[1.0; 4], &noise, -1.0, &[1.0; 4]));
        assert_eq!(policy.norm(), 0.0);
    }
}
