//! What another learner would have learned of the same experience: off-policy.
//!
//! The other learner sees the inputs, applied commands and rewards of the log, at the ticks at which the log's own learner
//! saw them, and starts from nothing. It did not choose the commands. Let `a` be the applied command, `m` the mean that the
//! log's policy had, and `m'` that of the other. A policy-gradient rule credits the score of its own policy at what was
//! done, `(a - m') / sigma^2`, so `a - m'` is handed to it as its noise: the exploration of the log, `a - m`, and the
//! distance between the two policies, `m - m'`. That is the credit that the controller gives to a command that the gate has
//! limited, and the same code. There are no importance weights `pi'(a) / pi(a)`: over a trace of ticks they would be
//! nearly 0 or huge. So the gradient is that of the commands of the log, not of those that the other policy would have
//! given, and the further the policies are apart the less it says. Learned models of reward and movement (`learned-reward`)
//! do not mind who chose the commands.

use serde::Serialize;

use crate::reference::Score;
use crate::runtime::Controller;
use crate::scenario::{Plan, Rule};
use crate::wire::{Command, Learning, Observation, flag};

/// Another learner, being taught.
#[derive(Debug)]
pub struct OffPolicyLearner {
    rule: Rule,
    controller: Controller,
    outputs: usize,
    /// Sum over ticks and outputs of the squared distance between the two policies' means.
    squares: f64,
    ticks: u64,
    norm: f32,
}

/// What another learner has learned.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct OffPolicy {
    /// Its rule.
    pub rule: Rule,
    /// Always true: it did not choose the commands that it learned from.
    pub off_policy: bool,
    /// Ticks learned from.
    pub learned: u64,
    /// Times that its trace was cut.
    pub cuts: u64,
    /// Euclidean norm of its weights.
    pub weights_norm: f32,
    /// Their hash, hexadecimal.
    pub weights_hash: String,
    /// Root mean square, over ticks and outputs, of the distance between its mean command and that of the log.
    pub distance: f64,
    /// How it does on the [yardstick](crate::reference), without exploration noise; null if the plant is not the
    /// simulator's arm.
    pub noiseless: Option<Score>,
    /// The tick at which its weights were no longer numbers.
    pub diverged_at: Option<u64>,
}

impl OffPolicyLearner {
    /// A fresh learner; `plan` names its rule.
    pub fn new(plan: &Plan) -> Self {
        Self {
            rule: plan.scenario.learner.rule,
            controller: Controller::new(plan).off_policy(),
            outputs: plan.outputs.len(),
            squares: 0.0,
            ticks: 0,
            norm: 0.0,
        }
    }

    /// Learns from what `observation` tells; `command` is what the log's own policy answered.
    pub fn take(&mut self, observation: &Observation, command: &Command) {
        let (mut told, mut own, mut learning) = (*observation, Command::default(), Learning::default());
        // Whatever it would have asked for, something else was applied.
        told.header.flags |= flag::CLAMPED;
        self.controller.respond(&told, &mut own);
        self.controller.after_command(&told);
        self.controller.record(&told, &mut learning);
        self.norm = learning.weights_norm;
        let means = own.mean.iter().zip(&command.mean).take(self.outputs);
        self.squares += means.map(|(own, log)| f64::from(own - log).powi(2)).sum::<f64>();
        self.ticks += 1;
    }

    /// The learner.
    pub fn controller(&self) -> &Controller {
        &self.controller
    }

    /// What came of it; `noiseless` is its score without noise.
    pub fn finish(self, noiseless: Option<Score>) -> OffPolicy {
        let n = (self.ticks * self.outputs as u64).max(1);
        let report = self.controller.finish();
        OffPolicy {
            rule: self.rule,
            off_policy: true,
            learned: report.learned,
            cuts: report.cuts,
            weights_norm: self.norm,
            weights_hash: report.weights_hash,
            distance: (self.squares / n as f64).sqrt(),
            noiseless,
            diverged_at: report.diverged_at,
        }
    }
}
