//! The paper's rule with a baseline: the reward less its running mean (Williams 1992, *Simple Statistical
//! Gradient-Following Algorithms for Connectionist Reinforcement Learning*, section 3).
//!
//! ```text
//! W_{k+1} = W_k + (alpha / sigma^2) (r_k - b_k) z_k
//! b_{k+1} = b_k + (r_k - b_k) / min(k + 1, N)
//! ```
//!
//! `b_k` does not yet contain the reward of tick k, so that the gradient stays unbiased. `b` is the plain mean
//! of the first N rewards and then an exponential mean with the time constant N.

use super::{LearningRule, PaperRule, Transition};
use crate::policy::{LinearPolicy, Outputs};
use crate::state::{Persist, StateVisitor};

/// The paper's rule with a running mean of the reward.
#[derive(Debug, Clone)]
pub struct BaselineRule {
    rule: PaperRule,
    /// Time constant N.
    ticks: f32,
    /// Number of rewards in the mean, at most N.
    seen: f32,
    mean: f32,
}

impl BaselineRule {
    /// `rule` with a running mean over `ticks` ticks.
    pub fn new(rule: PaperRule, ticks: f32) -> Self {
        Self { rule, ticks: ticks.max(1.0), seen: 0.0, mean: 0.0 }
    }

    /// The reward less the mean of the earlier ones; then adds the reward to the mean.
    fn advantage(&mut self, reward: f32) -> f32 {
        // The first reward has no mean to be compared with.
        let advantage = if self.seen == 0.0 { 0.0 } else { reward - self.mean };
        self.seen = (self.seen + 1.0).min(self.ticks);
        self.mean += (reward - self.mean) / self.seen;
        advantage
    }
}

impl LearningRule for BaselineRule {
    fn learn(&mut self, policy: &mut LinearPolicy, tick: &Transition) -> f32 {
        let advantage = self.advantage(tick.reward);
        self.rule.step(policy, tick.features, tick.noise, advantage)
    }

    fn learn_and_answer(&mut self, policy: &mut LinearPolicy, tick: &Transition, mean: &mut Outputs) -> f32 {
        let advantage = self.advantage(tick.reward);
        self.rule.step_and_answer(policy, [tick.features, tick.next_features], tick.noise, advantage, mean)
    }

    fn cut_trace(&mut self) {
        self.rule.cut_trace();
    }

    fn trace_norm(&self) -> f32 {
        self.rule.trace_norm()
    }

    fn halted(&self) -> bool {
        self.rule.halted()
    }
}

impl Persist for BaselineRule {
    fn visit_state(&mut self, visitor: &mut dyn StateVisitor) {
        self.rule.visit_state(visitor);
        visitor.number("seen", &mut self.seen);
        visitor.number("mean", &mut self.mean);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_mean_is_plain_at_first_and_then_exponential() {
        let mut rule = BaselineRule::new(PaperRule::new(4, 4, 0.0, 1.0), 2.0);
        let advantages = [-1.0, -2.0, -4.0, -4.0].map(|r| rule.advantage(r));
        // Means before each reward: none, -1, -1.5, -2.75.
        assert_eq!(advantages, [0.0, -1.0, -2.5, -1.25]);
    }
}
