//! The controller's side of the tick: learn, encode, draw, answer.

use super::run_counts::RunCounter;
use super::statistics::FinishedStatistics;
use super::{ControllerReport, FaultyChannel, RunStatistics};
use crate::encoder::{Encoder, Features};
use crate::learner::{Learner, LearningRule, Transition};
use crate::policy::{Exploration, LinearPolicy, Outputs};
use crate::scenario::{Plan, limits::RANGE};
use crate::simd::SimdPath;
use crate::state::{Persist, StateVisitor};
use crate::wire::{Command, Learning, MAX_INPUTS, MAX_OUTPUTS, Observation, flag};

/// Encoder, policy and learner: the controller's half of every tick, without clock and transport.
///
/// A tick has two parts. [`respond`](Self::respond) computes the command.
/// [`after_command`](Self::after_command) and [`record`](Self::record) follow after the command has been sent.
///
/// # Credit for a limited command
///
/// The policy draws `u = m + n`, with the mean `m` and the noise `n` of standard deviation `sigma`. The gate
/// applies `a = c(u)`, limited in size, step or position. Credit goes to the applied command: the rules get
/// `a - m` in place of `n`, for whatever reason the gate limited the command. They get nothing where the hold
/// policy chose the command, or where no gate could have made `a` from `u`: then the command was corrupted on
/// its way, and the corrupted one was limited.
///
/// This credit is biased. To the policy the gate is a part of the world, so `n` itself, limited or not, would
/// give the true gradient of the expected reward, at a greater variance. The best estimate given that `u`
/// exceeded a limit `l` is the mean of `n` there, `sigma phi(z) / (1 - Phi(z))` with `z = (l - m) / sigma`
/// (Fujita & Maeda 2018; Chou et al. 2017 on the effect of clipping on Gaussian policies). `l - m = sigma z` is
/// always less than that. So commands near a limit get too little credit, by `0.8 sigma` where the mean is
/// right at the limit. As limited noise no longer has mean 0, a constant in the reward does not cancel: where
/// the mean is beyond a limit, punishment drives it further out and reward brings it back. Rules with a
/// baseline or a critic are hardly affected. The paper's own rule is, because its rewards are all negative. The
/// reasons for this credit are: the applied command is what happened, the credit is bounded by the limits and
/// not by the tails of the noise, and a model of movement and reward must learn from the same number.
#[derive(Debug, Clone)]
pub struct Controller {
    /// The receiving end of the observation channel, with the scenario's faults.
    observations: FaultyChannel<Observation>,
    encoder: Encoder,
    policy: LinearPolicy,
    exploration: Exploration,
    rule: Learner,
    inputs: usize,
    ticks: u64,
    hash_every: u64,
    /// The tick answered last; `None` when its command was not the policy's.
    answered: Option<u64>,
    /// Inputs, features, mean and noise of that command.
    answered_inputs: [f32; MAX_INPUTS],
    features: Features,
    mean: Outputs,
    noise: Outputs,
    /// The command applied in the tick before that command.
    applied_before: Outputs,
    /// Whether every applied command is credited, also those of another policy.
    off_policy: bool,
    /// Features of the current observation.
    next: Features,
    /// Flags and step size of the learner in this tick.
    flags: u32,
    step: f32,
    statistics: RunStatistics,
    counter: RunCounter,
    pub(super) report: ControllerReport,
}

/// Whether all values are finite. There is no branch per value, because they nearly always are.
fn finite(values: &[f32]) -> bool {
    values.iter().fold(true, |all, x| all & x.is_finite())
}

/// Flags of observations whose reward does not belong to a command that the policy chose and the gate applied.
const NOT_THE_POLICYS: u32 = flag::FIRST | flag::MISSED | flag::SKIPPED | flag::UNARMED | flag::TRIPPED | flag::BLIND;

impl Controller {
    /// The controller of `plan`, with weights 0.
    pub fn new(plan: &Plan) -> Self {
        let scenario = &plan.scenario;
        let outputs = plan.outputs.len();
        let encoder = plan.encoder();
        let (len, order) = (encoder.len(), encoder.positions().collect());
        Self {
            observations: FaultyChannel::of(plan),
            policy: LinearPolicy::new(len, order, outputs),
            exploration: Exploration::new(scenario.seed, scenario.policy.sigma as f32, outputs)
                .distributed(scenario.policy.noise),
            rule: Learner::of(&plan.learner_spec(), &encoder),
            inputs: plan.inputs.len(),
            ticks: scenario.ticks,
            hash_every: scenario.log.hash_every,
            answered: None,
            answered_inputs: [0.0; MAX_INPUTS],
            features: encoder.features(),
            next: encoder.features(),
            encoder,
            mean: [0.0; MAX_OUTPUTS],
            noise: [0.0; MAX_OUTPUTS],
            applied_before: [0.0; MAX_OUTPUTS],
            off_policy: false,
            flags: 0,
            step: 0.0,
            statistics: RunStatistics::new(plan),
            counter: RunCounter::new(plan),
            report: ControllerReport::default(),
        }
    }

    /// The same controller for commands that another policy chose: every applied command is credited.
    pub fn off_policy(self) -> Self {
        Self { off_policy: true, ..self }
    }

    /// The same controller with its inner loops on `path` instead of the machine's best path. The numbers are
    /// the same, bit for bit.
    pub fn on(self, path: SimdPath) -> Self {
        Self { encoder: self.encoder.on(path), policy: self.policy.on(path), ..self }
    }

    /// Learns from the observation's reward and computes the command for its inputs: mean, drawn output, tick
    /// and flags.
    ///
    /// Credit goes to the applied command. When the gate limited the command, the noise is the difference
    /// between the applied command and the mean, and the rules get its score. When the command was not applied
    /// at all, or observations are missing in between, nothing is learned and the trace is cut. An observation
    /// with a value that is not finite, or beyond any range that a scenario may have, is answered with zero.
    /// The scenario's faults act on the observation first. When they leave no observation of this tick, the
    /// command has the flag [`flag::UNHEARD`].
    pub fn respond(&mut self, observation: &Observation, command: &mut Command) {
        if self.observations.is_fault_free() {
            return self.answer(observation, command);
        }
        let tick = observation.header.tick;
        let mut received = None;
        let stale = &mut self.report.stale;
        self.observations.pass(tick, Some(observation), |o| match o.header.tick == tick {
            true => received = Some(*o),
            false => *stale += 1,
        });
        match received {
            Some(received) => self.answer(&received, command),
            None => self.answer_unheard(tick, command),
        }
    }

    /// The command for a tick without an observation. The last command of the policy stays recorded: when the
    /// next observation arrives, one is missing in between.
    fn answer_unheard(&mut self, tick: u64, command: &mut Command) {
        self.report.unheard += 1;
        (self.flags, self.step) = (0, 0.0);
        (self.mean, self.noise) = ([0.0; MAX_OUTPUTS], [0.0; MAX_OUTPUTS]);
        (command.header.tick, command.header.flags) = (tick, flag::UNHEARD);
        (command.mean, command.drawn) = (self.mean, self.noise);
    }

    /// Learns from an observation and computes the command for it.
    fn answer(&mut self, observation: &Observation, command: &mut Command) {
        let tick = observation.header.tick;
        let inputs = &observation.inputs[..self.inputs];
        // A NaN fails the comparison, too. There is no branch per value, because they are nearly always valid.
        let invalid = !inputs.iter().fold(true, |all, x| all & (f64::from(x.abs()) <= RANGE));
        let mut drawn = [0.0; MAX_OUTPUTS];
        if !invalid {
            // Drawn first, because it is a long chain of dependent operations that the others need not wait
            // for.
            drawn = self.exploration.draw();
            self.encoder.encode(inputs, &mut self.next);
        }
        let has_mean = self.learn(observation, invalid);
        self.applied_before = observation.applied;

        command.header.tick = tick;
        command.header.flags = 0;
        if invalid {
            self.answer_zero();
            command.header.flags = flag::INVALID;
            self.report.invalid += 1;
        } else {
            std::mem::swap(&mut self.features, &mut self.next);
            self.answered_inputs = observation.inputs;
            if !has_mean {
                self.mean = self.policy.mean(self.features.as_slice());
            }
            self.noise = drawn;
            self.answered = Some(tick);
            if !finite(&self.mean) {
                self.answer_zero();
                self.flags |= flag::DIVERGED;
                command.header.flags = flag::DIVERGED;
                self.report.diverged_at.get_or_insert(tick);
            }
        }
        command.mean = self.mean;
        for (drawn, (mean, noise)) in command.drawn.iter_mut().zip(self.mean.iter().zip(self.noise)) {
            *drawn = mean + noise;
        }
    }

    /// Sets the command to zero and marks it as not the policy's.
    fn answer_zero(&mut self) {
        self.answered = None;
        self.mean = [0.0; MAX_OUTPUTS];
        self.noise = [0.0; MAX_OUTPUTS];
    }

    /// Whether a gate could have made `applied` from the policy's command. The limits of size, ramp and
    /// position move a command towards zero, and the step limit moves it towards the previously applied one, so
    /// it must lie between these. Otherwise the gate limited a corrupted command.
    fn gate_could_apply(&self, applied: &Outputs) -> bool {
        let drawn = self.mean.iter().zip(&self.noise).map(|(mean, noise)| mean + noise);
        drawn.zip(&self.applied_before).zip(applied).all(|((drawn, &before), &applied)| {
            let (low, high) = (drawn.min(before).min(0.0), drawn.max(before).max(0.0));
            low <= applied && applied <= high
        })
    }

    /// Learns from the observation's reward, or cuts the trace. Returns true if `mean` is now the policy's mean
    /// for the next features, because the rule has computed it in the same pass.
    fn learn(&mut self, observation: &Observation, invalid: bool) -> bool {
        let flags = observation.header.flags;
        self.flags = 0;
        self.step = 0.0;
        let Some(answered) = self.answered else { return false };
        let clamped = flags & flag::CLAMPED != 0;
        let credited = flags & NOT_THE_POLICYS == 0
            && observation.header.tick == answered + 1
            && (!clamped || self.off_policy || self.gate_could_apply(&observation.applied));
        if credited && !invalid && observation.reward.is_finite() {
            let mut applied: Outputs = std::array::from_fn(|i| self.mean[i] + self.noise[i]);
            if clamped {
                applied = observation.applied;
                for (noise, (applied, mean)) in self.noise.iter_mut().zip(applied.iter().zip(self.mean)) {
                    *noise = applied - mean;
                }
            }
            let tick = Transition {
                features: self.features.as_slice(),
                inputs: &self.answered_inputs[..self.inputs],
                noise: &self.exploration.score(&self.noise),
                applied: &applied,
                reward: observation.reward,
                next_features: self.next.as_slice(),
                next_inputs: &observation.inputs[..self.inputs],
                new_target: flags & flag::NEW_TARGET != 0,
            };
            self.step = self.rule.learn_and_answer(&mut self.policy, &tick, &mut self.mean);
            self.flags = flag::LEARNED;
            self.report.learned += 1;
            true
        } else {
            self.rule.cut_trace();
            self.flags = flag::TRACE_CUT;
            self.report.cuts += 1;
            false
        }
    }

    /// The work after the command has been sent: improves the policy, and adds the observation to the
    /// statistics.
    pub fn after_command(&mut self, observation: &Observation) {
        self.rule.improve(&mut self.policy);
        if self.rule.halted() {
            self.report.diverged_at.get_or_insert(observation.header.tick);
        }
        self.statistics.observe(observation);
        self.counter.observe(observation, self.flags & flag::LEARNED != 0, [&self.mean, &self.noise]);
        self.report.ticks += 1;
    }

    /// Fills the learning record of the last answered tick.
    pub fn record(&self, observation: &Observation, learning: &mut Learning) {
        let tick = observation.header.tick;
        let hashed = tick.is_multiple_of(self.hash_every) || tick + 1 == self.ticks;
        learning.header.tick = tick;
        let halted = if self.rule.halted() { flag::DIVERGED } else { 0 };
        learning.header.flags = self.flags | halted | if hashed { flag::HASHED } else { 0 };
        learning.noise = self.noise;
        learning.reward = if self.flags & flag::LEARNED != 0 { observation.reward } else { 0.0 };
        learning.step = self.step;
        learning.weights_norm = self.policy.norm();
        learning.trace_norm = self.rule.trace_norm();
        learning.weights_hash = if hashed { self.policy.hash() } else { 0 };
    }

    /// The current policy.
    pub fn policy(&self) -> &LinearPolicy {
        &self.policy
    }

    /// Whether the learner has stopped because of a number that is not finite.
    pub fn halted(&self) -> bool {
        self.rule.halted()
    }

    /// The current statistics.
    pub fn statistics(&self) -> &RunStatistics {
        &self.statistics
    }

    /// Ends the run and returns the report, with the hash of the final weights.
    pub fn finish(self) -> ControllerReport {
        let FinishedStatistics { windows, first_switch, last_switch, targets } =
            self.statistics.finish(self.report.ticks + self.report.unseen);
        let weights_hash = format!("{:016x}", self.policy.hash());
        let counts = self.counter.finish(self.rule.outliers(), self.policy.norm() == 0.0);
        ControllerReport { weights_hash, windows, first_switch, last_switch, targets, counts, ..self.report }
    }
}

impl Persist for Controller {
    fn visit_state(&mut self, visitor: &mut dyn StateVisitor) {
        visitor.nested("line", &mut self.observations);
        visitor.nested("policy", &mut self.policy);
        visitor.nested("exploration", &mut self.exploration);
        visitor.nested("learner", &mut self.rule);
        visitor.optional("answered", &mut self.answered);
        visitor.numbers("shown", &mut self.answered_inputs);
        visitor.numbers("features", self.features.as_mut_slice());
        visitor.numbers("mean", &mut self.mean);
        visitor.numbers("noise", &mut self.noise);
        visitor.numbers("before", &mut self.applied_before);
        visitor.number("flags", &mut self.flags);
        visitor.number("step", &mut self.step);
        visitor.nested("tally", &mut self.statistics);
        visitor.nested("counter", &mut self.counter);
        visitor.nested("report", &mut self.report);
    }
}

#[cfg(test)]
mod learner_tests;
#[cfg(test)]
mod state_tests;
#[cfg(test)]
mod tests;
