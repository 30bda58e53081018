//! Learning rules: from what was done and what came of it to new weights.
//!
//! A rule sees what the agent sees: inputs and their features, the exploration and the command that were applied, the
//! reward. It is told when a tick is not to be learned from; why is the runtime's business. Each rule stands in its own
//! file with its source, behind one small face, [`LearningRule`]; [`Learner`] is the one that a scenario names.
//!
//! | rule | file | source |
//! |---|---|---|
//! | `paper` | `paper.rs` | Daucé & Dutech 2010, section 3.2 |
//! | `baseline` | `baseline.rs` | Williams 1992: the same, reward less its running mean |
//! | `actor-critic` | `actor_critic.rs`, `pairs.rs` | Degris, Pilarski & Sutton 2012; bounded steps: Elsayed et al. 2024 |
//! | `natural-actor-critic` | `actor_critic.rs`, `metric.rs` | Kakade 2001; Bhatnagar et al. 2009 |
//! | `learned-reward` | `learned_reward/` | model-based value gradients: Heess et al. 2015, Deisenroth & Rasmussen 2011 |

mod actor_critic;
mod baseline;
mod config;
mod critic_kernel;
mod learned_reward;
pub mod naive;
mod natural_metric;
mod pair_features;
mod paper;

pub use actor_critic::{ActorCritic, CriticConstants};
pub use baseline::BaselineRule;
pub use config::{BaselineConfig, CriticConfig, CriticFeatures, LearnerConfig, ModelBasis, ModelConfig, Rule};
pub use learned_reward::LearnedReward;
pub use natural_metric::NaturalMetric;
pub use pair_features::PairFeatures;
pub use paper::PaperRule;

use tectum_encoder::{Encoder, Map};

use crate::SignalConfig;
use crate::policy::{LinearPolicy, Outputs};
use crate::state::{Persist, StateVisitor};

/// What a learner is built for: the signals that it sees and sets, the policy's features, and its own settings. All numbers
/// are taken as validated.
#[derive(Debug, Clone, PartialEq)]
pub struct LearnerSpec {
    /// The inputs, in order; at most [`MAX_INPUTS`](crate::MAX_INPUTS).
    pub inputs: Vec<SignalConfig>,
    /// The number of outputs; at most [`MAX_OUTPUTS`](crate::MAX_OUTPUTS).
    pub outputs: usize,
    /// The maps of the policy's encoder.
    pub maps: Vec<Map>,
    /// Whether the encoder scales features to unit norm.
    pub normalise: bool,
    /// Standard deviation of the exploration noise, in units of the command.
    pub sigma: f64,
    /// Seed of the run's random streams.
    pub seed: u64,
    /// The rule and its settings.
    pub learner: LearnerConfig,
}

/// One tick that may be learned from, with the inputs that followed it.
#[derive(Debug, Clone, Copy)]
pub struct Transition<'a> {
    /// The features that the policy answered, in the encoder's padded layout.
    pub features: &'a [f32],
    /// The inputs behind them.
    pub inputs: &'a [f32],
    /// What the applied command differed from the policy's mean by, or what stands for it where the noise is not Gaussian:
    /// `sigma^2` times its score ([`Exploration::score`](crate::policy::Exploration::score)).
    pub noise: &'a Outputs,
    /// The command that was applied.
    pub applied: &'a Outputs,
    /// What came of it.
    pub reward: f32,
    /// The features of the tick after.
    pub next_features: &'a [f32],
    /// The inputs of the tick after.
    pub next_inputs: &'a [f32],
}

/// What every learning rule can do. Nothing in it allocates, and what it does is a function of the ticks it was given and
/// of the run's seed alone.
pub trait LearningRule {
    /// Learns from one tick, before the next command goes out: the cheap part. Returns the factor with which the trace
    /// was added to the weights, or for a rule without a trace the size of its last step.
    fn learn(&mut self, policy: &mut LinearPolicy, tick: &Transition) -> f32;

    /// [`learn`](Self::learn), and then into `mean` the policy's mean output for the features of the tick after: the same
    /// numbers, to the bit, where a rule knows how to come by both in one pass.
    fn learn_and_answer(&mut self, policy: &mut LinearPolicy, tick: &Transition, mean: &mut Outputs) -> f32 {
        let step = self.learn(policy, tick);
        *mean = policy.mean(tick.next_features);
        step
    }

    /// Uses the time after the command has gone out: the dear part. Called once a tick, learned from or not.
    fn improve(&mut self, _policy: &mut LinearPolicy) {}

    /// Forgets what was done: after a tick in which something else happened than the policy asked for, no credit
    /// crosses over.
    fn cut_trace(&mut self);

    /// Euclidean norm of the trace; for a rule without one, of what stands in its place in the log.
    fn trace_norm(&self) -> f32;

    /// Whether the rule met a number that is not finite, or is about to be none. It has then stopped learning, for good,
    /// and what it has learned stands.
    fn halted(&self) -> bool;
}

/// The rule of a scenario.
#[derive(Debug, Clone)]
pub enum Learner {
    /// The paper's rule.
    Paper(PaperRule),
    /// The paper's rule with a baseline.
    Baseline(BaselineRule),
    /// Actor-critic, plain or natural.
    ActorCritic(Box<ActorCritic>),
    /// Policy improvement through a learned model of the reward.
    LearnedReward(Box<LearnedReward>),
}

impl Learner {
    /// The learner that `spec` names, for features of `encoder`.
    pub fn of(spec: &LearnerSpec, encoder: &Encoder) -> Self {
        let (table, len, outputs) = (&spec.learner, encoder.len(), spec.outputs);
        let paper = || PaperRule::new(len, outputs, table.beta as f32, table.alpha_over_variance as f32);
        let actor_critic = |metric| {
            let critic = table.critic.clone().unwrap_or_default();
            let pairs = (critic.sees == CriticFeatures::Pairs).then(|| PairFeatures::of(&spec.inputs));
            let (beta, step, sigma) = (table.beta, table.alpha_over_variance, spec.sigma);
            Self::ActorCritic(Box::new(
                ActorCritic::new(len, outputs, beta as f32, step as f32, CriticConstants::of(&critic, sigma as f32))
                    .with(pairs, metric),
            ))
        };
        match table.rule {
            Rule::Paper => Self::Paper(paper()),
            Rule::Baseline => {
                Self::Baseline(BaselineRule::new(paper(), table.baseline.clone().unwrap_or_default().ticks as f32))
            }
            Rule::ActorCritic => actor_critic(None),
            Rule::NaturalActorCritic => actor_critic(Some(NaturalMetric::of(spec, encoder))),
            Rule::LearnedReward => Self::LearnedReward(Box::new(LearnedReward::of(spec, encoder))),
        }
    }

    fn rule(&self) -> &dyn LearningRule {
        match self {
            Self::Paper(rule) => rule,
            Self::Baseline(rule) => rule,
            Self::ActorCritic(rule) => &**rule,
            Self::LearnedReward(rule) => &**rule,
        }
    }

    fn rule_mut(&mut self) -> &mut dyn LearningRule {
        match self {
            Self::Paper(rule) => rule,
            Self::Baseline(rule) => rule,
            Self::ActorCritic(rule) => &mut **rule,
            Self::LearnedReward(rule) => &mut **rule,
        }
    }
}

impl LearningRule for Learner {
    fn learn(&mut self, policy: &mut LinearPolicy, tick: &Transition) -> f32 {
        self.rule_mut().learn(policy, tick)
    }

    fn learn_and_answer(&mut self, policy: &mut LinearPolicy, tick: &Transition, mean: &mut Outputs) -> f32 {
        match self {
            // By name, so that what is called in every tick of the fastest rule can be inlined.
            Self::Paper(rule) => rule.learn_and_answer(policy, tick, mean),
            _ => self.rule_mut().learn_and_answer(policy, tick, mean),
        }
    }

    fn improve(&mut self, policy: &mut LinearPolicy) {
        self.rule_mut().improve(policy);
    }

    fn cut_trace(&mut self) {
        self.rule_mut().cut_trace();
    }

    fn trace_norm(&self) -> f32 {
        self.rule().trace_norm()
    }

    fn halted(&self) -> bool {
        self.rule().halted()
    }
}

impl Persist for Learner {
    fn visit_state(&mut self, visitor: &mut dyn StateVisitor) {
        match self {
            Self::Paper(rule) => rule.visit_state(visitor),
            Self::Baseline(rule) => rule.visit_state(visitor),
            Self::ActorCritic(rule) => rule.visit_state(visitor),
            Self::LearnedReward(rule) => rule.visit_state(visitor),
        }
    }
}

/// Beyond this a number is on its way to infinity: no command, reward or step in use comes near it.
const HUGE: f32 = 1e15;

/// Whether the weights may be changed by `step` times a trace of `noise`: both are numbers and far from overflow, so that
/// no product of the two, nor a sum of such, can be infinite. Weights that grow without limit show in the mean command,
/// and thereby in the noise (what was applied is within limits), long before they are no numbers.
fn sound(step: f32, noise: &Outputs) -> bool {
    step.abs() < HUGE && noise.iter().all(|n| n.abs() < HUGE)
}

/// `to += factor * from`.
fn add(to: &mut [f32], from: &[f32], factor: f32) {
    for (t, f) in to.iter_mut().zip(from) {
        *t += factor * f;
    }
}

/// The sum of products, in a fixed order.
fn dot(a: &[f32], b: &[f32]) -> f32 {
    let (a, b) = (a.as_chunks::<16>(), b.as_chunks::<16>());
    let mut sums = [0.0; 16];
    for (a, b) in a.0.iter().zip(b.0) {
        for i in 0..16 {
            sums[i] += a[i] * b[i];
        }
    }
    let rest: f32 = a.1.iter().zip(b.1).map(|(a, b)| a * b).sum();
    let [mut four, more @ ..]: [[f32; 4]; 4] = bytemuck::cast(sums);
    for more in more {
        for i in 0..4 {
            four[i] += more[i];
        }
    }
    (four[0] + four[2]) + (four[1] + four[3]) + rest
}

#[cfg(test)]
mod gradient_tests;
#[cfg(test)]
mod test_specs;
