//! The agent of this package's learning rules: encoder, linear policy, exploration noise and a rule.

use tectum_encoder::simd::SimdPath;
use tectum_encoder::{Encoder, Features};

use super::{Agent, AgentRecord, Answer, Boundary, Experience, Percept};
use crate::MAX_OUTPUTS;
use crate::learner::{Learner, LearnerSpec, LearningRule, Transition};
use crate::plant::EpisodeEnd;
use crate::policy::{Exploration, LinearPolicy, Noise, Outputs};
use crate::state::{Persist, StateVisitor};

/// Encoder, linear policy, exploration noise and a learning rule: `u = W g(x) + noise`.
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
///
/// # Targets and episodes
///
/// A new target cuts no trace, as in the paper: later rewards still depend on where earlier commands have brought the
/// plant. At the end of an episode the rule learns from the last reward as far as its mathematics allow
/// ([`LearningRule::learn_last`]), and the trace is cut: no reward of the next episode follows from earlier commands.
#[derive(Debug, Clone)]
pub struct LinearAgent {
    encoder: Encoder,
    policy: LinearPolicy,
    exploration: Exploration,
    rule: Learner,
    outputs: usize,
    /// Features, mean and noise of the command answered last.
    features: Features,
    mean: Outputs,
    noise: Outputs,
    /// Features of the inputs that come next.
    next: Features,
    step: f32,
    /// The noise of the next command, if [`Agent::learn`] has prepared it together with `next`.
    prepared: Option<Outputs>,
    /// Whether `mean` is already that of `next`.
    has_mean: bool,
}

impl LinearAgent {
    /// The agent that `spec` configures, over the features of `encoder`, with weights 0 and noise of the distribution
    /// `noise`.
    pub fn new(spec: &LearnerSpec, encoder: Encoder, noise: Noise) -> Self {
        let (len, order) = (encoder.len(), encoder.positions().collect());
        Self {
            policy: LinearPolicy::new(len, order, spec.outputs),
            exploration: Exploration::new(spec.seed, spec.sigma as f32, spec.outputs).distributed(noise),
            rule: Learner::of(spec, &encoder),
            outputs: spec.outputs,
            features: encoder.features(),
            next: encoder.features(),
            encoder,
            mean: [0.0; MAX_OUTPUTS],
            noise: [0.0; MAX_OUTPUTS],
            step: 0.0,
            prepared: None,
            has_mean: false,
        }
    }

    /// The same agent with its inner loops on `path` instead of the machine's best path. The numbers are the same, bit
    /// for bit.
    pub fn on(self, path: SimdPath) -> Self {
        Self { encoder: self.encoder.on(path), policy: self.policy.on(path), ..self }
    }

    /// The policy.
    pub fn linear_policy(&self) -> &LinearPolicy {
        &self.policy
    }

    /// Euclidean norm of the rule's trace.
    pub fn trace_norm(&self) -> f32 {
        self.rule.trace_norm()
    }

    /// Draws the noise of the next command and encodes its inputs. The noise is drawn first, because it is a long
    /// chain of dependent operations that the others need not wait for.
    #[inline]
    fn prepare(&mut self, inputs: &[f32]) -> Outputs {
        let noise = self.exploration.draw();
        self.encoder.encode(inputs, &mut self.next);
        noise
    }
}

/// A slice of at most [`MAX_OUTPUTS`] numbers as [`Outputs`].
fn outputs(values: &[f32]) -> Outputs {
    let mut all = [0.0; MAX_OUTPUTS];
    all[..values.len()].copy_from_slice(values);
    all
}

impl Agent for LinearAgent {
    fn act(&mut self, percept: &Percept, answer: &mut Answer) {
        let drawn = match self.prepared.take() {
            Some(drawn) => drawn,
            None => self.prepare(percept.inputs),
        };
        std::mem::swap(&mut self.features, &mut self.next);
        if !std::mem::take(&mut self.has_mean) {
            self.mean = self.policy.mean(self.features.as_slice());
        }
        self.noise = drawn;
        // Over all outputs, a fixed number: vector operations, and no read of what was just written piece by piece.
        let mut command = self.mean;
        for (command, noise) in command.iter_mut().zip(self.noise) {
            *command += noise;
        }
        answer.mean.copy_from_slice(&self.mean[..self.outputs]);
        answer.command.copy_from_slice(&command[..self.outputs]);
    }

    fn learn(&mut self, experience: &Experience) -> bool {
        (self.step, self.has_mean, self.prepared) = (0.0, false, None);
        if experience.withheld.is_some() {
            self.rule.cut_trace();
            return false;
        }
        self.prepared = Some(self.prepare(experience.next_inputs));
        let applied = outputs(if experience.limited { experience.applied } else { experience.asked });
        if experience.limited {
            for (noise, (applied, mean)) in self.noise.iter_mut().zip(applied.iter().zip(self.mean)) {
                *noise = applied - mean;
            }
        }
        let tick = Transition {
            features: self.features.as_slice(),
            inputs: experience.inputs,
            noise: &self.exploration.score(&self.noise),
            applied: &applied,
            reward: experience.reward,
            next_features: self.next.as_slice(),
            next_inputs: experience.next_inputs,
            new_target: experience.boundary == Boundary::NewTarget,
        };
        let end = match experience.boundary {
            Boundary::Terminated => EpisodeEnd::Terminated,
            Boundary::Truncated => EpisodeEnd::Truncated,
            Boundary::None | Boundary::NewTarget => {
                self.step = self.rule.learn_and_answer(&mut self.policy, &tick, &mut self.mean);
                self.has_mean = true;
                return true;
            }
        };
        let step = self.rule.learn_last(&mut self.policy, &tick, end);
        self.step = step.unwrap_or(0.0);
        step.is_some()
    }

    fn improve(&mut self, updates: u32) {
        for _ in 0..updates {
            self.rule.improve(&mut self.policy);
        }
    }

    fn record(&self, record: &mut AgentRecord) {
        record.noise.copy_from_slice(&self.noise[..self.outputs]);
        record.step = self.step;
        record.weights_norm = self.policy.norm();
        record.trace_norm = self.rule.trace_norm();
    }

    fn halted(&self) -> bool {
        self.rule.halted()
    }

    fn outliers(&self) -> u64 {
        self.rule.outliers()
    }

    fn policy(&self) -> Option<&LinearPolicy> {
        Some(&self.policy)
    }
}

impl Persist for LinearAgent {
    fn visit_state(&mut self, visitor: &mut dyn StateVisitor) {
        visitor.nested("policy", &mut self.policy);
        visitor.nested("exploration", &mut self.exploration);
        visitor.nested("learner", &mut self.rule);
        visitor.numbers("features", self.features.as_mut_slice());
        visitor.numbers("mean", &mut self.mean);
        visitor.numbers("noise", &mut self.noise);
        visitor.number("step", &mut self.step);
    }
}
