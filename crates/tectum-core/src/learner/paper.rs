//! The paper's rule: policy gradient with an eligibility trace (Daucé & Dutech 2010, section 3.2, step 3).
//!
//! With the noise `n_k = u_k - W g_k` that was applied in tick k and the reward `r_k` of that tick,
//!
//! ```text
//! z_k     = beta z_{k-1} + (1 - beta) n_k g_k^T
//! W_{k+1} = W_k + (alpha / sigma^2) r_k z_k
//! ```
//!
//! The trace is in units of noise: the paper's `Sigma^-1` is part of `alpha / sigma^2`, which is also how the
//! paper states its step. `beta = 0` is the open-loop rule.

use super::{LearningRule, Transition, is_safe};
use crate::policy::{LinearPolicy, Outputs, Tiles, TraceStep};
use crate::state::{Persist, StateVisitor};

/// The paper's rule: constants and trace.
#[derive(Debug, Clone)]
pub struct PaperRule {
    beta: f32,
    rate: f32,
    /// In the layout of the policy's weights.
    trace: Tiles,
    halted: bool,
}

impl PaperRule {
    /// The rule for a policy of `len` features, including padding, and `outputs` outputs, with trace decay
    /// `beta` in [0, 1) and `rate` = `alpha / sigma^2`.
    pub fn new(len: usize, outputs: usize, beta: f32, rate: f32) -> Self {
        Self { beta, rate, trace: Tiles::zeroed(len, outputs), halted: false }
    }

    /// Learns from one tick, with its features, noise and reward. Returns the factor with which the trace was
    /// added to the weights, `rate * reward`; 0 once a number was not finite or too large.
    pub fn step(&mut self, policy: &mut LinearPolicy, features: &[f32], noise: &Outputs, reward: f32) -> f32 {
        let (rate, gain) = self.prepare(noise, reward);
        if !self.halted {
            policy.step(&mut self.trace, TraceStep { features, gain: &gain, decay: self.beta, rate });
        }
        rate
    }

    /// [`step`](Self::step), and then writes the mean output for the features `next` to `mean`.
    #[inline]
    pub fn step_and_answer(
        &mut self,
        policy: &mut LinearPolicy,
        [features, next]: [&[f32]; 2],
        noise: &Outputs,
        reward: f32,
        mean: &mut Outputs,
    ) -> f32 {
        let (rate, gain) = self.prepare(noise, reward);
        if self.halted {
            *mean = policy.mean(next);
        } else {
            let step = TraceStep { features, gain: &gain, decay: self.beta, rate };
            policy.step_and_answer(&mut self.trace, step, next, mean);
        }
        rate
    }

    /// The factor of the trace in the weights, and the factor of the features in the trace for each output.
    fn prepare(&mut self, noise: &Outputs, reward: f32) -> (f32, Outputs) {
        let rate = self.rate * reward;
        self.halted = self.halted || !is_safe(rate, noise);
        (if self.halted { 0.0 } else { rate }, noise.map(|n| n * (1.0 - self.beta)))
    }
}

impl LearningRule for PaperRule {
    fn learn(&mut self, policy: &mut LinearPolicy, tick: &Transition) -> f32 {
        self.step(policy, tick.features, tick.noise, tick.reward)
    }

    fn learn_and_answer(&mut self, policy: &mut LinearPolicy, tick: &Transition, mean: &mut Outputs) -> f32 {
        self.step_and_answer(policy, [tick.features, tick.next_features], tick.noise, tick.reward, mean)
    }

    fn cut_trace(&mut self) {
        self.trace.clear();
    }

    fn trace_norm(&self) -> f32 {
        self.trace.norm()
    }

    fn halted(&self) -> bool {
        self.halted
    }
}

impl Persist for PaperRule {
    fn visit_state(&mut self, visitor: &mut dyn StateVisitor) {
        visitor.nested("trace", &mut self.trace);
        visitor.boolean("halted", &mut self.halted);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const NOISE: Outputs = [0.5, -0.25, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0];

    #[test]
    fn one_tick_follows_the_equation() {
        let mut policy = LinearPolicy::new(4, (0..4).collect(), 4);
        let mut rule = PaperRule::new(4, 4, 0.75, 0.1);
        let g = [1.0, 0.5, 0.0, 0.25];
        assert_eq!(rule.step(&mut policy, &g, &NOISE, -2.0), -0.2);
        for (output, noise) in NOISE[..4].iter().enumerate() {
            for (i, g) in g.iter().enumerate() {
                let expected = -0.2 * 0.25 * noise * g;
                assert!((policy.weight(output, i) - expected).abs() < 1e-7);
            }
        }
    }

    #[test]
    fn the_trace_decays_and_a_cut_clears_it() {
        let mut policy = LinearPolicy::new(4, (0..4).collect(), 4);
        let mut rule = PaperRule::new(4, 4, 0.5, 0.1);
        rule.step(&mut policy, &[1.0; 4], &NOISE, 0.0);
        let norm = rule.trace_norm();
        rule.step(&mut policy, &[1.0; 4], &[0.0; 8], 0.0);
        assert!((rule.trace_norm() - norm / 2.0).abs() < 1e-6);
        rule.cut_trace();
        assert_eq!(rule.trace_norm(), 0.0);
        assert_eq!(policy.norm(), 0.0, "a reward of zero changes nothing");
    }

    #[test]
    fn a_number_that_is_not_finite_or_too_large_stops_learning() {
        for (reward, noise) in [(f32::INFINITY, 0.1), (f32::NAN, 0.1), (-1.0, f32::INFINITY), (1e30, 0.1), (-1.0, 1e30)]
        {
            let mut policy = LinearPolicy::new(4, (0..4).collect(), 4);
            let mut rule = PaperRule::new(4, 4, 0.5, 0.1);
            rule.step(&mut policy, &[1.0; 4], &NOISE, -1.0);
            let hash = policy.hash();
            assert_eq!(rule.step(&mut policy, &[1.0; 4], &[noise; 8], reward), 0.0);
            assert!(rule.halted());
            rule.step(&mut policy, &[1.0; 4], &NOISE, -1.0);
            assert_eq!(policy.hash(), hash, "{reward} {noise}");
        }
    }

    #[test]
    fn eight_outputs_learn_as_four_do() {
        let (mut four, mut eight) =
            (LinearPolicy::new(4, (0..4).collect(), 4), LinearPolicy::new(4, (0..4).collect(), 8));
        let (mut a, mut b) = (PaperRule::new(4, 4, 0.9, 0.1), PaperRule::new(4, 8, 0.9, 0.1));
        let mut noise = NOISE;
        noise[4..].copy_from_slice(&NOISE[..4]);
        for k in 0..5 {
            a.step(&mut four, &[0.3; 4], &noise, k as f32);
            b.step(&mut eight, &[0.3; 4], &noise, k as f32);
        }
        for output in 0..8 {
            assert_eq!(eight.weight(output, 2), four.weight(output % 4, 2));
        }
    }
}
