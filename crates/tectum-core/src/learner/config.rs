//! `[learner]`: the configuration of the learning rules, and the preset of each rule.

use serde::{Deserialize, Serialize};

use super::model_predictive::{ModelPredictiveConfig, OPERATIONS_PER_MS};

/// `[learner]`: the rule and its constants. Omitted keys have the values of the rule's
/// [preset](LearnerConfig::preset).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LearnerConfig {
    /// The learning rule.
    pub rule: Rule,
    /// Decay of the eligibility trace per tick, in [0, 1).
    pub beta: f64,
    /// The step `alpha / sigma^2`.
    pub alpha_over_variance: f64,
    /// Rule `baseline`: the running mean.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub baseline: Option<BaselineConfig>,
    /// Rules `actor-critic` and `natural-actor-critic`: the critic.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub critic: Option<CriticConfig>,
    /// Rule `learned-reward`: the model, and how the policy is improved with it. This rule does not use `beta` and
    /// `alpha_over_variance`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub model: Option<ModelConfig>,
    /// Rule `model-predictive`: how long its work after a command may take, ms, on a machine that makes
    /// [`OPERATIONS_PER_MS`](super::model_predictive::OPERATIONS_PER_MS); half of the period if omitted. What counts is
    /// the number of operations that follows, [`ModelPredictiveConfig::operations`].
    #[serde(skip_serializing_if = "Option::is_none")]
    pub budget_ms: Option<f64>,
    /// Rule `model-predictive`: models and plans. This rule does not use `beta` and `alpha_over_variance`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub plan: Option<ModelPredictiveConfig>,
}

/// The learning rules.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Rule {
    /// Daucé & Dutech 2010, section 3.2.
    Paper,
    /// The paper's rule with the reward less its running mean.
    Baseline,
    /// Actor-critic with eligibility traces.
    ActorCritic,
    /// Actor-critic along the natural gradient.
    NaturalActorCritic,
    /// Policy improvement through a learned model of the reward.
    LearnedReward,
    /// Planning through learned models of movement and reward.
    ModelPredictive,
}

impl Rule {
    /// All of them, in the order in which they are shown.
    pub const ALL: [Self; 6] = [
        Self::Paper,
        Self::Baseline,
        Self::ActorCritic,
        Self::NaturalActorCritic,
        Self::LearnedReward,
        Self::ModelPredictive,
    ];

    /// Whether it learns the weights of a linear policy over the encoder's features.
    pub fn is_linear(self) -> bool {
        self != Self::ModelPredictive
    }
}

/// `[learner.baseline]`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct BaselineConfig {
    /// Time constant of the running mean, ticks.
    pub ticks: f64,
}

/// The features of a critic.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum CriticFeatures {
    /// 8 x 8 topographic maps over all pairs of inputs.
    Pairs,
    /// The policy's features.
    Policy,
}

/// `[learner.critic]`: the linear critic and the step sizes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct CriticConfig {
    /// The critic's features.
    pub sees: CriticFeatures,
    /// Step of the critic's weights; reduced where it would overshoot the error.
    pub step: f64,
    /// Discount of later rewards per tick, in [0, 1).
    pub discount: f64,
    /// Decay of the critic's eligibility trace, in [0, 1].
    pub decay: f64,
    /// Factor of the last reward as a feature of the critic; 0 for none.
    pub reward_feature: f64,
    /// Largest temporal-difference error, in multiples of the running mean of its size.
    pub bound: f64,
    /// Ticks after which the steps of critic and actor are half of the initial ones.
    pub half_life: f64,
    /// Lower limit of the steps, as a fraction of the initial ones; 1 for constant steps.
    pub floor: f64,
    /// Ticks over which the actor's step grows to its full size.
    pub warm_up: f64,
    /// Step with which the cost of squared exploration noise is learned; 0 to disable it.
    pub noise_step: f64,
    /// Natural gradient: value added to the diagonal of the features' second-moment matrix, in multiples of its
    /// mean eigenvalue.
    pub regularisation: f64,
}

/// `[learner.model]`: the learned-reward rule.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ModelConfig {
    /// Basis functions of the reward model.
    pub basis: ModelBasis,
    /// Prior standard deviation of the model's first-order weights.
    pub spread: f64,
    /// Factor of the prior standard deviation for every order above the first (basis `smooth`).
    pub smoothness: f64,
    /// Least standard deviation of the difference between reward and model that is assumed. A greater one is
    /// learned.
    pub reward_noise: f64,
    /// Names of the inputs that the commands move. A plant with joint angles (arm, SO-101) says it by itself; of any
    /// other plant the scenario must say it.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub moved: Vec<String>,
    /// Number of ticks before the policy is first improved.
    pub start: u64,
    /// Number of rollouts (imagined movements) for one step.
    pub movements: usize,
    /// Length of a rollout, ticks.
    pub horizon: usize,
    /// Weight of the last tick of a rollout.
    pub last_counts: f64,
    /// Fraction of the rollouts with a newly drawn target; the others have the target of a remembered tick.
    pub imagined: f64,
    /// Fraction of the rollouts that start from a state drawn from the whole input box.
    pub anywhere: f64,
    /// Fraction of the rollouts that continue where the policy's previous rollout ended. The remaining ones
    /// start from a remembered state.
    pub onward: f64,
    /// Number of past ticks that are remembered as start states.
    pub memory: usize,
    /// Steps per tick.
    pub steps: usize,
    /// Initial step size, in units of a weight (Adam).
    pub step: f64,
    /// Whitening: value added to the variances of a line's kernels along their principal directions, in
    /// multiples of the mean variance.
    pub ridge: f64,
    /// Ticks after which the step size is half of the initial one.
    pub half_life: f64,
    /// Lower limit of the step size, as a fraction of the initial one.
    pub floor: f64,
    /// Ticks after which the challenger, a second policy that starts from small random weights, is restarted; 0
    /// for no challenger.
    pub challenge: u64,
    /// After `n` times this number of ticks without a change of the world, the rule works only in every `n`-th
    /// tick, down to every 256th. An unexpected reward or movement ends this at once.
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

    /// Whether the model has functions of single inputs besides those of pairs. Kernels sum to nearly one, so
    /// pairs of them can represent any function of a single input.
    pub fn has_singles(self) -> bool {
        self == Self::Smooth
    }
}

impl LearnerConfig {
    /// The recommended configuration of a rule, tuned on the arm.
    pub fn preset(rule: Rule) -> Self {
        let config = Self { rule, ..Self::default() };
        match rule {
            Rule::Paper | Rule::Baseline => config,
            // Without bounds on updates this step would be too large for some seeds. A step of 2 learns faster
            // at first, and ends with a higher loss.
            Rule::ActorCritic => Self { beta: 0.6, alpha_over_variance: 1.0, ..config },
            // With the metric the critic learns fast on the policy's own features, and the large steps have to
            // decay.
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
                ..config
            },
            Rule::LearnedReward | Rule::ModelPredictive => config,
        }
        .resolved()
    }

    /// The same configuration with the sections that its rule needs.
    pub fn resolved(mut self) -> Self {
        match self.rule {
            Rule::Paper => {}
            Rule::Baseline => drop(self.baseline.get_or_insert_default()),
            Rule::ActorCritic | Rule::NaturalActorCritic => drop(self.critic.get_or_insert_default()),
            Rule::LearnedReward => drop(self.model.get_or_insert_default()),
            Rule::ModelPredictive => drop(self.plan.get_or_insert_default()),
        }
        self
    }

    /// The same configuration with the operations of a tick of `period_ms`, where nothing else was given.
    pub fn within(mut self, period_ms: f64) -> Self {
        if let (Rule::ModelPredictive, Some(plan)) = (self.rule, &mut self.plan) {
            let budget_ms = *self.budget_ms.get_or_insert(0.5 * period_ms);
            if plan.operations == 0.0 {
                plan.operations = budget_ms * OPERATIONS_PER_MS / 1e6;
            }
        }
        self
    }
}

impl Default for LearnerConfig {
    fn default() -> Self {
        Self {
            rule: Rule::Paper,
            beta: 0.9,
            alpha_over_variance: 0.01,
            baseline: None,
            critic: None,
            model: None,
            budget_ms: None,
            plan: None,
        }
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
