//! Learning rules: update the weights of a policy from commands and rewards.
//!
//! A rule receives what the agent observes: inputs and their features, the applied noise and command, and the
//! reward. The runtime decides which ticks are learned from, and cuts the trace after the others. Each rule has
//! its own file and implements the trait [`LearningRule`]; [`Learner`] is the rule that a scenario names.
//!
//! | rule | file | source |
//! |---|---|---|
//! | `paper` | `paper.rs` | Daucé & Dutech 2010, section 3.2 |
//! | `baseline` | `baseline.rs` | Williams 1992: the paper's rule with the reward less its running mean |
//! | `actor-critic` | `actor_critic.rs`, `pair_features.rs` | Degris et al. 2012; bounded steps: Elsayed et al. 2024 |
//! | `natural-actor-critic` | `actor_critic.rs`, `natural_metric.rs` | Kakade 2001; Bhatnagar et al. 2009 |
//! | `learned-reward` | `learned_reward/` | value gradients: Heess et al. 2015, Deisenroth & Rasmussen 2011 |
//!
//! The learner `model-predictive`, in `model_predictive/`, has no such policy: it plans. Its agent is
//! [`ModelPredictiveAgent`](crate::agent::ModelPredictiveAgent).

mod actor_critic;
mod baseline;
mod config;
mod critic_kernel;
mod learned_reward;
pub mod model_predictive;
#[doc(hidden)]
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
use crate::plant::EpisodeEnd;
use crate::policy::{LinearPolicy, Outputs};
use crate::state::{Persist, StateVisitor};

/// Everything that a learner is built from: its inputs and outputs, the policy's features, and the rule's
/// configuration. All numbers must be valid; this is not checked.
#[derive(Debug, Clone, PartialEq)]
pub struct LearnerSpec {
    /// The inputs, in order; at most [`MAX_INPUTS`](crate::MAX_INPUTS).
    pub inputs: Vec<SignalConfig>,
    /// Names of the inputs that the commands move, as far as the plant says it.
    pub moved: Vec<String>,
    /// The number of outputs; at most [`MAX_OUTPUTS`](crate::MAX_OUTPUTS).
    pub outputs: usize,
    /// The maps of the policy's encoder.
    pub maps: Vec<Map>,
    /// Whether the encoder scales features to unit norm.
    pub normalise: bool,
    /// Standard deviation of the exploration noise, in units of the command.
    pub sigma: f64,
    /// Largest command that the gate lets through, by output; infinite where there is no limit.
    pub max_command: Outputs,
    /// Largest change of a command from a tick to the next that it lets through, by output; infinite without a limit.
    pub max_step: Outputs,
    /// Seed of the run's random streams.
    pub seed: u64,
    /// The rule and its settings.
    pub learner: LearnerConfig,
}

/// One tick that is learned from, with the inputs of the next tick.
#[derive(Debug, Clone, Copy)]
pub struct Transition<'a> {
    /// The features from which the command was computed, in the encoder's padded layout.
    pub features: &'a [f32],
    /// The inputs of these features.
    pub inputs: &'a [f32],
    /// The applied command less the policy's mean, or, if the noise is not Gaussian, `sigma^2` times its score
    /// ([`Exploration::score`](crate::policy::Exploration::score)).
    pub noise: &'a Outputs,
    /// The command that was applied.
    pub applied: &'a Outputs,
    /// The reward of the tick.
    pub reward: f32,
    /// The features of the next tick.
    pub next_features: &'a [f32],
    /// The inputs of the next tick.
    pub next_inputs: &'a [f32],
    /// Whether a new target (or trial) begins with the next tick. Then the inputs may have changed by more than
    /// what the command did.
    pub new_target: bool,
}

/// A learning rule. Its methods do not allocate, and its results depend only on the ticks that it received and
/// on the run's seed.
pub trait LearningRule {
    /// Learns from one tick, before the next command is sent, so it has to be fast. Returns the factor with
    /// which the trace was added to the weights, or, for a rule without a trace, the size of its last step.
    fn learn(&mut self, policy: &mut LinearPolicy, tick: &Transition) -> f32;

    /// [`learn`](Self::learn), and then writes the policy's mean output for the features of the next tick to
    /// `mean`. A rule may do both in one pass; the results are the same, bit for bit.
    fn learn_and_answer(&mut self, policy: &mut LinearPolicy, tick: &Transition, mean: &mut Outputs) -> f32 {
        let step = self.learn(policy, tick);
        *mean = policy.mean(tick.next_features);
        step
    }

    /// Learns from the last tick of an episode, and clears the trace. `tick`'s next features and inputs belong to
    /// another episode, and no value may be taken from them. Returns the step, or `None` when the rule cannot learn
    /// from such a tick. Without an implementation, the rule is one that reads neither.
    fn learn_last(&mut self, policy: &mut LinearPolicy, tick: &Transition, _end: EpisodeEnd) -> Option<f32> {
        let step = self.learn(policy, tick);
        self.cut_trace();
        Some(step)
    }

    /// Does expensive work after the command was sent. Called once per tick, whether or not the tick was
    /// learned from.
    fn improve(&mut self, _policy: &mut LinearPolicy) {}

    /// Clears the trace, so that no later reward is credited to earlier commands. Called after a tick whose
    /// applied command was not the policy's.
    fn cut_trace(&mut self);

    /// Euclidean norm of the trace; for a rule without a trace, the number that the log has in its place.
    fn trace_norm(&self) -> f32;

    /// Whether the rule has stopped learning for good, because a number was not finite or too large. The
    /// weights keep their last values.
    fn halted(&self) -> bool;

    /// Number of rewards that the rule did not learn from, because it took them for outliers.
    fn outliers(&self) -> u64 {
        0
    }
}

/// The learning rule that a scenario configures.
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
    /// The learner that `spec` configures, for features of `encoder`.
    ///
    /// # Panics
    /// For the rule `model-predictive`, which learns no linear policy: its agent is
    /// [`ModelPredictiveAgent`](crate::agent::ModelPredictiveAgent).
    pub fn of(spec: &LearnerSpec, encoder: &Encoder) -> Self {
        let (config, len, outputs) = (&spec.learner, encoder.len(), spec.outputs);
        let paper = || PaperRule::new(len, outputs, config.beta as f32, config.alpha_over_variance as f32);
        let actor_critic = |metric| {
            let critic = config.critic.clone().unwrap_or_default();
            let pairs = (critic.sees == CriticFeatures::Pairs).then(|| PairFeatures::of(&spec.inputs));
            let (beta, step, sigma) = (config.beta, config.alpha_over_variance, spec.sigma);
            Self::ActorCritic(Box::new(
                ActorCritic::new(len, outputs, beta as f32, step as f32, CriticConstants::of(&critic, sigma as f32))
                    .with(pairs, metric)
                    .limited_to(spec.max_command),
            ))
        };
        match config.rule {
            Rule::Paper => Self::Paper(paper()),
            Rule::Baseline => {
                Self::Baseline(BaselineRule::new(paper(), config.baseline.clone().unwrap_or_default().ticks as f32))
            }
            Rule::ActorCritic => actor_critic(None),
            Rule::NaturalActorCritic => actor_critic(Some(NaturalMetric::of(spec, encoder))),
            Rule::LearnedReward => Self::LearnedReward(Box::new(LearnedReward::of(spec, encoder))),
            Rule::ModelPredictive => unreachable!("model-predictive has an agent of its own"),
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
            // A direct call, so that it can be inlined: this is the fastest rule.
            Self::Paper(rule) => rule.learn_and_answer(policy, tick, mean),
            _ => self.rule_mut().learn_and_answer(policy, tick, mean),
        }
    }

    fn learn_last(&mut self, policy: &mut LinearPolicy, tick: &Transition, end: EpisodeEnd) -> Option<f32> {
        self.rule_mut().learn_last(policy, tick, end)
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

    fn outliers(&self) -> u64 {
        self.rule().outliers()
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

/// Numbers of this magnitude show divergence: no command, reward or step in normal use comes near it.
const DIVERGED: f32 = 1e15;

/// Whether `step` times a trace of `noise` can be added to the weights. Both must be finite and far from
/// overflow, so that no product of the two and no sum of such products is infinite. Weights that grow without
/// limit first enlarge the mean command, and so the noise, since the applied command is limited: they are
/// detected long before they overflow.
fn is_safe(step: f32, noise: &Outputs) -> bool {
    step.abs() < DIVERGED && noise.iter().all(|n| n.abs() < DIVERGED)
}

/// The scalar product, summed in a fixed order.
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
pub(crate) mod test_specs;
