//! `[learner]` as it stands in its file: the rules, their constants, and the preset of each.

use serde::{Deserialize, Serialize};

/// `[learner]`: the rule and its constants. What a file leaves out is as in the rule's [preset](LearnerConfig::preset).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LearnerConfig {
    /// The learning rule.
    pub rule: Rule,
    /// Decay of the eligibility trace a tick, in [0, 1).
    pub beta: f64,
    /// The step `alpha / sigma^2`.
    pub alpha_over_variance: f64,
    /// Rule `baseline`: the running mean.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub baseline: Option<BaselineConfig>,
    /// Rules `actor-critic` and `natural-actor-critic`: the critic.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub critic: Option<CriticConfig>,
    /// Rule `learned-reward`: the model, and how the policy is improved through it. `beta` and `alpha_over_variance` are
    /// of no use to this rule.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub model: Option<ModelConfig>,
}

/// The learning rules.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Rule {
    /// Daucé & Dutech 2010, section 3.2.
    Paper,
    /// The same with the reward less its running mean.
    Baseline,
    /// Actor-critic with eligibility traces.
    ActorCritic,
    /// Its natural gradient.
    NaturalActorCritic,
    /// The policy is improved through a learned model of the reward.
    LearnedReward,
}

/// `[learner.baseline]`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct BaselineConfig {
    /// Time constant of the running mean, ticks.
    pub ticks: f64,
}

/// What a critic's features are.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum CriticFeatures {
    /// 8 x 8 topographic maps over all pairs of inputs.
    Pairs,
    /// The policy's features.
    Policy,
}

/// `[learner.critic]`: the linear critic and the size of steps.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct CriticConfig {
    /// What the critic sees.
    pub sees: CriticFeatures,
    /// Step of the critic's weights; where it would overshoot the error, less is taken.
    pub step: f64,
    /// Discount of later rewards a tick, in [0, 1).
    pub discount: f64,
    /// Decay of the critic's eligibility trace, in [0, 1].
    pub decay: f64,
    /// Factor with which the last reward is a feature of the critic.
    pub reward_feature: f64,
    /// Largest temporal-difference error, in running means of its size.
    pub bound: f64,
    /// Ticks after which the steps of critic and actor are half of the first ones.
    pub half_life: f64,
    /// Share of the first steps that they never fall below; 1 for constant steps.
    pub floor: f64,
    /// Ticks over which the actor's step grows to its full size.
    pub warm_up: f64,
    /// Step with which it is learned what the square of the exploration noise costs; 0 for not at all.
    pub noise_step: f64,
    /// Natural gradient: what is added to the diagonal of the features' second-moment matrix, in its mean eigenvalues.
    pub regularisation: f64,
}

/// `[learner.model]`: the learned-reward rule.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ModelConfig {
    /// What the model of the reward is made of.
    pub basis: ModelBasis,
    /// Prior standard deviation of the model's weights of first order.
    pub spread: f64,
    /// Factor on it for every order above the first (basis `smooth`).
    pub smoothness: f64,
    /// Standard deviation of the reward about the model.
    pub reward_noise: f64,
    /// Names of the inputs that the commands move; left out, the last ones, as many as there are outputs.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub moved: Vec<String>,
    /// First tick after which the policy is improved.
    pub start: u64,
    /// Imagined movements for one step.
    pub movements: usize,
    /// Ticks of each.
    pub horizon: usize,
    /// How many times its last tick counts.
    pub last_counts: f64,
    /// Share of the movements towards a place that is drawn anew; the others go on towards where they went.
    pub imagined: f64,
    /// Share of the movements that start from anywhere in the box of inputs,
    pub anywhere: f64,
    /// and of those that go on from where the policy's last imagined one ended; the others start from where the body was.
    pub onward: f64,
    /// Ticks of the past that are remembered to start from.
    pub memory: usize,
    /// Steps a tick.
    pub steps: usize,
    /// Size of the first steps, in units of a weight (Adam).
    pub step: f64,
    /// What is added to the variance of the directions in which a line of kernels varies, in units of the mean one, before
    /// they are scaled to be stepped along alike.
    pub ridge: f64,
    /// Ticks after which it is half of that.
    pub half_life: f64,
    /// Share of the first size that it never falls below.
    pub floor: f64,
    /// Ticks after which a policy that starts from nothing is tried beside the one in use, and again; 0 for never.
    pub challenge: u64,
    /// Once the world has stayed the same for `n` times so many ticks, only every `n`-th tick is worked in, at last every
    /// 256th. A reward or a movement that was not expected ends the rest at once.
    pub rest: u64,
}

/// The bases of the reward model.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ModelBasis {
    /// Fourier series over angles, polynomials over other inputs: second order, all pairs.
    Smooth,
    /// 8 x 8 topographic maps over all pairs.
    Maps,
}

impl ModelBasis {
    /// The order of the series, or the units of a map along an input.
    pub fn size(self) -> usize {
        match self {
            Self::Smooth => 2,
            Self::Maps => 8,
        }
    }

    /// Whether the functions of a single input are in the model besides the pairs'; kernels sum to nearly one, so that
    /// pairs of them say what a single one could.
    pub fn has_singles(self) -> bool {
        self == Self::Smooth
    }
}

impl LearnerConfig {
    /// The rule as we would use it on the arm.
    pub fn preset(rule: Rule) -> Self {
        let table = Self { rule, ..Self::default() };
        match rule {
            Rule::Paper | Rule::Baseline => table,
            // Without bounds on updates this would be too long for some seeds. 2 learns faster at first, and ends with more loss.
            Rule::ActorCritic => Self { beta: 0.6, alpha_over_variance: 1.0, ..table },
            // Its metric makes the critic fast on the policy's own features, and its long steps have to fade.
            Rule::NaturalActorCritic => Self {
                beta: 0.72,
                alpha_over_variance: 3.0,
                critic: Some(CriticConfig {
                    sees: CriticFeatures::Policy,
                    reward_feature: 1.0,
                    half_life: 20_000.0,
                    floor: 0.1,
                    noise_step: 0.0,
                    ..CriticConfig::default()
                }),
                ..table
            },
            Rule::LearnedReward => table,
        }
        .resolved()
    }

    /// The same with the tables that its rule needs.
    pub fn resolved(mut self) -> Self {
        match self.rule {
            Rule::Paper => {}
            Rule::Baseline => drop(self.baseline.get_or_insert_default()),
            Rule::ActorCritic | Rule::NaturalActorCritic => drop(self.critic.get_or_insert_default()),
            Rule::LearnedReward => drop(self.model.get_or_insert_default()),
        }
        self
    }
}

impl Default for LearnerConfig {
    fn default() -> Self {
        Self { rule: Rule::Paper, beta: 0.9, alpha_over_variance: 0.01, baseline: None, critic: None, model: None }
    }
}

impl Default for BaselineConfig {
    fn default() -> Self {
        Self { ticks: 1000.0 }
    }
}

impl Default for CriticConfig {
    fn default() -> Self {
        Self {
            sees: CriticFeatures::Pairs,
            step: 0.3,
            discount: 0.9,
            decay: 0.8,
            reward_feature: 0.0,
            bound: 5.0,
            half_life: 20_000.0,
            floor: 1.0,
            warm_up: 0.0,
            noise_step: 1e-3,
            regularisation: 0.3,
        }
    }
}

impl Default for ModelConfig {
    fn default() -> Self {
        Self {
            basis: ModelBasis::Smooth,
            spread: 1.0,
            smoothness: 0.1,
            reward_noise: 0.001,
            moved: Vec::new(),
            start: 20,
            movements: 32,
            horizon: 15,
            last_counts: 10.0,
            imagined: 0.8,
            anywhere: 0.05,
            onward: 0.9,
            memory: 2048,
            steps: 3,
            step: 3e-4,
            ridge: 0.01,
            half_life: 500.0,
            floor: 0.1,
            challenge: 600,
            rest: 5000,
        }
    }
}
