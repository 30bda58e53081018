//! The controller's side of the tick: learn, encode, draw, answer.

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
/// A tick has two parts. [`respond`](Self::respond) is what a command waits for; [`settle`](Self::settle) and
/// [`record`](Self::record) come after it has gone out.
///
/// # Credit for a limited command
///
/// The policy draws `u = m + n`, with the mean `m` and the noise `n` of standard deviation `sigma`; the gate applies
/// `a = c(u)`, limited in size, step or position. Credit goes to what was applied: the rules are handed `a - m` in the place
/// of `n`, for whatever reason the gate limited the command, and nothing at all where the hold policy chose it, or where no
/// gate could have made `a` of `u`: then the command was corrupted on its way, and it was that which was limited.
///
/// That is biased. To the policy the gate is a part of the world, so that `n` itself, limited or not, would give the true
/// gradient of the expected reward, at a greater variance; the best that can be said given that `u` went beyond a limit `l`
/// is `n`'s mean there, `sigma phi(z) / (1 - Phi(z))` with `z = (l - m) / sigma` (Fujita & Maeda 2018; Chou et al. 2017 on
/// what clipping does to Gaussian policies). `l - m = sigma z` is always less than that: commands near a limit are credited
/// with too little, by `0.8 sigma` where the mean stands right at it, and as limited noise no longer has mean 0, a constant
/// in the reward does not cancel: where the mean is beyond a limit, punishment drives it further out and reward brings it
/// back. Rules with a baseline or a critic hardly feel it; the paper's own rule, whose rewards are all negative, does.
/// What speaks for it all the same: it is what happened, it is bounded by the limits and not by the tails of the noise, and
/// it is the same number that a model of movement and reward has to learn from.
#[derive(Debug, Clone)]
pub struct Controller {
    /// The observations' way to here.
    line: FaultyChannel<Observation>,
    encoder: Encoder,
    policy: LinearPolicy,
    exploration: Exploration,
    rule: Learner,
    inputs: usize,
    ticks: u64,
    hash_every: u64,
    /// The tick answered last, unless its answer was not the policy's.
    answered: Option<u64>,
    /// Inputs, features, mean and noise of that answer.
    shown: [f32; MAX_INPUTS],
    features: Features,
    mean: Outputs,
    noise: Outputs,
    /// What was applied in the tick before that answer.
    before: Outputs,
    /// Whatever was applied is credited, whoever chose it.
    off_policy: bool,
    /// Features of the observation in hand.
    next: Features,
    /// What the learner did in this tick.
    flags: u32,
    step: f32,
    statistics: RunStatistics,
    pub(super) report: ControllerReport,
}

/// Whether all are numbers: without a branch for each, since they nearly always are.
fn finite(values: &[f32]) -> bool {
    values.iter().fold(true, |all, x| all & x.is_finite())
}

/// What makes an observation's reward another tick's than the one that the policy answered and the gate let through.
const NOT_OURS: u32 = flag::FIRST | flag::MISSED | flag::SKIPPED | flag::UNARMED | flag::TRIPPED | flag::BLIND;

impl Controller {
    /// The controller of `plan`, with weights 0.
    pub fn new(plan: &Plan) -> Self {
        let scenario = &plan.scenario;
        let outputs = plan.outputs.len();
        let encoder = plan.encoder();
        let (len, order) = (encoder.len(), encoder.positions().collect());
        Self {
            line: FaultyChannel::of(plan),
            policy: LinearPolicy::new(len, order, outputs),
            exploration: Exploration::new(scenario.seed, scenario.policy.sigma as f32, outputs)
                .distributed(scenario.policy.noise),
            rule: Learner::of(plan, &encoder),
            inputs: plan.inputs.len(),
            ticks: scenario.ticks,
            hash_every: scenario.log.hash_every,
            answered: None,
            shown: [0.0; MAX_INPUTS],
            features: encoder.features(),
            next: encoder.features(),
            encoder,
            mean: [0.0; MAX_OUTPUTS],
            noise: [0.0; MAX_OUTPUTS],
            before: [0.0; MAX_OUTPUTS],
            off_policy: false,
            flags: 0,
            step: 0.0,
            statistics: RunStatistics::new(plan),
            report: ControllerReport::default(),
        }
    }

    /// The same for commands that another policy chose: whatever was applied is credited.
    pub fn off_policy(self) -> Self {
        Self { off_policy: true, ..self }
    }

    /// The same controller with its inner loops on another path than the machine's best: the same numbers, bit for bit.
    pub fn on(self, path: SimdPath) -> Self {
        Self { encoder: self.encoder.on(path), policy: self.policy.on(path), ..self }
    }

    /// Learns from the observation's reward and answers its inputs. Fills mean, drawn output, tick and flags.
    ///
    /// Credit goes to what was applied: when the gate limited the command, the noise is what the applied command differs
    /// from the mean by; the rules are handed its score. When the command was not applied at all, or observations are missing in between, nothing is
    /// learned and the trace is cut. An observation with a value that is not a number, or beyond any range that a scenario may
    /// name, is answered with zero. What the scenario's faults make of the observation is between here and that; when they
    /// leave nothing of this tick, the answer stands for silence ([`flag::UNHEARD`]).
    pub fn respond(&mut self, observation: &Observation, command: &mut Command) {
        if self.line.is_clean() {
            return self.answer(observation, command);
        }
        let tick = observation.header.tick;
        let mut heard = None;
        let stale = &mut self.report.stale;
        self.line.pass(tick, Some(observation), |o| match o.header.tick == tick {
            true => heard = Some(*o),
            false => *stale += 1,
        });
        match heard {
            Some(heard) => self.answer(&heard, command),
            None => self.say_nothing(tick, command),
        }
    }

    /// The answer to an observation that was not heard. What the policy answered last stays what it was: when the next
    /// observation is heard, one is missing in between.
    fn say_nothing(&mut self, tick: u64, command: &mut Command) {
        self.report.unheard += 1;
        (self.flags, self.step) = (0, 0.0);
        (self.mean, self.noise) = ([0.0; MAX_OUTPUTS], [0.0; MAX_OUTPUTS]);
        (command.header.tick, command.header.flags) = (tick, flag::UNHEARD);
        (command.mean, command.drawn) = (self.mean, self.noise);
    }

    fn answer(&mut self, observation: &Observation, command: &mut Command) {
        let tick = observation.header.tick;
        let inputs = &observation.inputs[..self.inputs];
        // False for what is not a number, too; without a branch for each, since they nearly always are.
        let blind = !inputs.iter().fold(true, |all, x| all & (f64::from(x.abs()) <= RANGE));
        let mut drawn = [0.0; MAX_OUTPUTS];
        if !blind {
            // First of all, because it is a long chain of dependent operations that others need not wait for.
            drawn = self.exploration.draw();
            self.encoder.encode(inputs, &mut self.next);
        }
        let answered = self.learn(observation, blind);
        self.before = observation.applied;

        command.header.tick = tick;
        command.header.flags = 0;
        if blind {
            self.answer_zero();
            command.header.flags = flag::INVALID;
            self.report.invalid += 1;
        } else {
            std::mem::swap(&mut self.features, &mut self.next);
            self.shown = observation.inputs;
            if !answered {
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

    /// An answer that is not the policy's.
    fn answer_zero(&mut self) {
        self.answered = None;
        self.mean = [0.0; MAX_OUTPUTS];
        self.noise = [0.0; MAX_OUTPUTS];
    }

    /// Whether `applied` can be what a gate made of the policy's command. Size, ramp and position bring a command nearer to
    /// zero, a step nearer to what was applied before: so it lies within these. Else it was another's command that was limited.
    fn explains(&self, applied: &Outputs) -> bool {
        let asked = self.mean.iter().zip(&self.noise).map(|(mean, noise)| mean + noise);
        asked.zip(&self.before).zip(applied).all(|((asked, &before), &applied)| {
            let (low, high) = (asked.min(before).min(0.0), asked.max(before).max(0.0));
            low <= applied && applied <= high
        })
    }

    /// Learns. True if the mean is that of the next features by now: the rule has worked it out on its way.
    fn learn(&mut self, observation: &Observation, blind: bool) -> bool {
        let flags = observation.header.flags;
        self.flags = 0;
        self.step = 0.0;
        let Some(answered) = self.answered else { return false };
        let clamped = flags & flag::CLAMPED != 0;
        let ours = flags & NOT_OURS == 0
            && observation.header.tick == answered + 1
            && (!clamped || self.off_policy || self.explains(&observation.applied));
        if ours && !blind && observation.reward.is_finite() {
            let mut applied: Outputs = std::array::from_fn(|i| self.mean[i] + self.noise[i]);
            if clamped {
                applied = observation.applied;
                for (noise, (applied, mean)) in self.noise.iter_mut().zip(applied.iter().zip(self.mean)) {
                    *noise = applied - mean;
                }
            }
            let tick = Transition {
                features: self.features.as_slice(),
                inputs: &self.shown[..self.inputs],
                noise: &self.exploration.score(&self.noise),
                applied: &applied,
                reward: observation.reward,
                next_features: self.next.as_slice(),
                next_inputs: &observation.inputs[..self.inputs],
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

    /// What nobody waits for: lets the learner use the time, and brings the account up to date with the observation.
    pub fn after_command(&mut self, observation: &Observation) {
        self.rule.improve(&mut self.policy);
        if self.rule.halted() {
            self.report.diverged_at.get_or_insert(observation.header.tick);
        }
        self.statistics.observe(observation);
        self.report.ticks += 1;
    }

    /// Fills the learning record of the tick that was answered last.
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

    /// The policy as it is now.
    pub fn policy(&self) -> &LinearPolicy {
        &self.policy
    }

    /// Whether the learner met a number that is not finite and has stopped learning.
    pub fn halted(&self) -> bool {
        self.rule.halted()
    }

    /// The account as it is now.
    pub fn statistics(&self) -> &RunStatistics {
        &self.statistics
    }

    /// Ends the run: the account, with the hash of the final weights.
    pub fn finish(self) -> ControllerReport {
        let FinishedStatistics { windows, first_switch, last_switch, targets } =
            self.statistics.finish(self.report.ticks + self.report.unseen);
        let weights_hash = format!("{:016x}", self.policy.hash());
        ControllerReport { weights_hash, windows, first_switch, last_switch, targets, ..self.report }
    }
}

impl Persist for Controller {
    fn visit_state(&mut self, visitor: &mut dyn StateVisitor) {
        visitor.nested("line", &mut self.line);
        visitor.nested("policy", &mut self.policy);
        visitor.nested("exploration", &mut self.exploration);
        visitor.nested("learner", &mut self.rule);
        visitor.optional("answered", &mut self.answered);
        visitor.numbers("shown", &mut self.shown);
        visitor.numbers("features", self.features.as_mut_slice());
        visitor.numbers("mean", &mut self.mean);
        visitor.numbers("noise", &mut self.noise);
        visitor.numbers("before", &mut self.before);
        visitor.number("flags", &mut self.flags);
        visitor.number("step", &mut self.step);
        visitor.nested("tally", &mut self.statistics);
        visitor.nested("report", &mut self.report);
    }
}

#[cfg(test)]
mod tests;
