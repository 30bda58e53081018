//! What another learner learns from the experience in a log: off-policy learning.
//!
//! The other learner starts with fresh weights. It receives the inputs, applied commands and rewards of the
//! log, at the ticks at which the log's own learner received them. It did not choose the commands. Let `a` be
//! the applied command, `m` the mean of the log's policy, and `m'` the mean of the other policy. A
//! policy-gradient rule credits the score of its own policy at the applied command, `(a - m') / sigma^2`. So
//! it gets `a - m'` as its noise: the exploration of the log, `a - m`, plus the distance between the two
//! policies, `m - m'`. The controller credits a command that the gate has limited in the same way, with the
//! same code. There are no importance weights `pi'(a) / pi(a)`: over a trace of ticks they would be nearly 0
//! or huge. So the gradient belongs to the commands of the log, not to those that the other policy would have
//! sent, and means less the further the policies are apart. Learned models of reward and movement
//! (`learned-reward`) do not depend on who chose the commands.

use serde::Serialize;

use crate::reference::Score;
use crate::runtime::Controller;
use crate::scenario::{Plan, Rule};
use crate::wire::{Command, Learning, Observation, flag};

/// The other learner during the replay.
#[derive(Debug)]
pub(super) struct OffPolicyLearner {
    rule: Rule,
    controller: Controller,
    outputs: usize,
    /// Sum over ticks and outputs of the squared distance between the two policies' means.
    squares: f64,
    ticks: u64,
    norm: f32,
}

/// The result of off-policy learning.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct OffPolicy {
    /// Its rule.
    pub rule: Rule,
    /// Always true: the learner did not choose the commands that it learned from.
    pub off_policy: bool,
    /// Number of ticks that it learned from.
    pub learned: u64,
    /// How often its trace was cut.
    pub cuts: u64,
    /// Euclidean norm of its weights.
    pub weights_norm: f32,
    /// Their hash, hexadecimal.
    pub weights_hash: String,
    /// Root mean square, over ticks and outputs, of the distance between its mean command and that of the
    /// log.
    pub distance: f64,
    /// Its score on the [test set](crate::reference), without exploration noise; null if the plant is not the
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

    /// Learns from `observation`; `command` is the answer of the log's own policy.
    pub fn learn(&mut self, observation: &Observation, command: &Command) {
        let (mut received, mut own, mut learning) = (*observation, Command::default(), Learning::default());
        // The applied command is not its own, so the credit must be that of a limited command.
        received.header.flags |= flag::CLAMPED;
        self.controller.respond(&received, &mut own);
        self.controller.after_command(&received);
        self.controller.record(&received, &mut learning);
        self.norm = learning.weights_norm;
        let means = own.mean.iter().zip(&command.mean).take(self.outputs);
        self.squares += means.map(|(own, log)| f64::from(own - log).powi(2)).sum::<f64>();
        self.ticks += 1;
    }

    /// The learner.
    pub fn controller(&self) -> &Controller {
        &self.controller
    }

    /// The result; `noiseless` is its score without noise.
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
