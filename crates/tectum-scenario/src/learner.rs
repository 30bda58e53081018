//! Checks of `[learner]`: constants in range, and no table that the rule does not use.

use std::ops::RangeInclusive;

use tectum_core::{MAX_INPUTS as RULE_INPUTS, MAX_OUTPUTS as RULE_OUTPUTS};

use super::{
    BaselineConfig, CriticConfig, LearnerConfig, ModelConfig, ModelPredictiveConfig, Rule,
    check::{known_input, number, show},
    error::Violation,
    limits,
    plant_signals::PlantSignals,
};

pub(super) fn check(learner: &LearnerConfig, signals: &PlantSignals) -> Result<(), Violation> {
    check_size(learner.rule, signals)?;
    below_one("learner.beta", learner.beta)?;
    number("learner.alpha_over_variance", learner.alpha_over_variance, limits::STEP, "give 0 to 1000")?;
    let rule = learner.rule;
    for (key, given, used) in [
        ("learner.baseline", learner.baseline.is_some(), rule == Rule::Baseline),
        ("learner.critic", learner.critic.is_some(), matches!(rule, Rule::ActorCritic | Rule::NaturalActorCritic)),
        ("learner.model", learner.model.is_some(), rule == Rule::LearnedReward),
        ("learner.budget_ms", learner.budget_ms.is_some(), rule == Rule::ModelPredictive),
        ("learner.plan", learner.plan.is_some(), rule == Rule::ModelPredictive),
    ] {
        if given && !used {
            let what = if key == "learner.budget_ms" { "key" } else { "table" };
            let text = format!("is a {what} that the rule does not read; take it out, or give another rule");
            return Err(Violation::new(key, text));
        }
    }
    if let Some(BaselineConfig { ticks }) = learner.baseline {
        number("learner.baseline.ticks", ticks, limits::LEARNER_TICKS, "give 1 to 1e12 ticks")?;
    }
    if let Some(table) = &learner.critic {
        check_critic(table)?;
    }
    match rule {
        Rule::LearnedReward => check_model(&learner.model.clone().unwrap_or_default(), signals),
        Rule::ModelPredictive => check_plan(learner),
        _ => Ok(()),
    }
}

/// The name of a rule, as files have it.
pub(super) fn name(rule: Rule) -> String {
    toml::Value::try_from(rule).ok().and_then(|name| name.as_str().map(str::to_owned)).unwrap_or_default()
}

/// Checks that the rule has room for the plant's signals: a sample carries more than the rules of this package take.
fn check_size(rule: Rule, signals: &PlantSignals) -> Result<(), Violation> {
    let sizes = [("inputs", signals.inputs.len(), RULE_INPUTS), ("outputs", signals.outputs.len(), RULE_OUTPUTS)];
    for (what, count, most) in sizes {
        if count > most {
            let name = name(rule);
            let text = format!(
                "is {name}, for which {count} {what} are too many; it supports at most {most}, \
                 and a controller of your own ([controller] program) as many as a plant may have"
            );
            return Err(Violation::new("learner.rule", text));
        }
    }
    Ok(())
}

fn below_one(key: &str, value: f64) -> Result<(), Violation> {
    if (0.0..1.0).contains(&value) {
        return Ok(());
    }
    Err(Violation::value(key, show(value), "give at least 0 and less than 1"))
}

fn check_critic(table: &CriticConfig) -> Result<(), Violation> {
    let key = |name: &str| format!("learner.critic.{name}");
    number(key("step"), table.step, limits::STEP, "give 0 to 1000")?;
    below_one(&key("discount"), table.discount)?;
    number(key("decay"), table.decay, 0.0..=1.0, "give 0 to 1")?;
    number(key("reward_feature"), table.reward_feature, limits::REWARD_FEATURE, "give 0 to 1000")?;
    number(key("bound"), table.bound, limits::ERROR_BOUND, "give 1 to 1e9")?;
    number(key("half_life"), table.half_life, limits::LEARNER_TICKS, "give 1 to 1e12 ticks")?;
    number(key("floor"), table.floor, 0.0..=1.0, "give 0 to 1")?;
    number(key("warm_up"), table.warm_up, 0.0..=1e12, "give 0 to 1e12 ticks")?;
    number(key("noise_step"), table.noise_step, limits::NOISE_STEP, "give 0 to 0.1")?;
    number(key("regularisation"), table.regularisation, limits::REGULARISATION, "give 1e-6 to 1e6")
}

fn check_model(table: &ModelConfig, signals: &PlantSignals) -> Result<(), Violation> {
    let key = |name: &str| format!("learner.model.{name}");
    let inputs = &signals.inputs;
    if inputs.len() > limits::MODEL_INPUTS {
        let text = format!("is learned-reward, for which {} inputs are too many; it supports at most 10", inputs.len());
        return Err(Violation::new("learner.rule", text));
    }
    if table.moved.is_empty() && signals.moved.is_empty() {
        let names: Vec<_> = inputs.iter().map(|input| format!("{:?}", input.name)).collect();
        let text = format!(
            "is missing, and the plant does not say it; name the inputs that the commands move, of {}",
            names.join(", ")
        );
        return Err(Violation::new(key("moved"), text));
    }
    for (i, name) in table.moved.iter().enumerate() {
        known_input(format_args!("{}[{i}]", key("moved")), name, inputs)?;
    }
    number(key("spread"), table.spread, limits::SPREADS, "give 1e-6 to 1e6")?;
    number(key("smoothness"), table.smoothness, 1e-3..=1.0, "give 0.001 to 1")?;
    number(key("reward_noise"), table.reward_noise, limits::SPREADS, "give 1e-6 to 1e6")?;
    whole_number(&key("movements"), table.movements, limits::IMAGINED)?;
    whole_number(&key("horizon"), table.horizon, limits::IMAGINED)?;
    whole_number(&key("steps"), table.steps, limits::IMAGINED)?;
    whole_number(&key("memory"), table.memory, limits::MEMORY)?;
    number(key("last_counts"), table.last_counts, limits::LAST_COUNTS, "give 1 to 1000")?;
    number(key("imagined"), table.imagined, 0.0..=1.0, "give 0 to 1")?;
    number(key("anywhere"), table.anywhere, 0.0..=1.0, "give 0 to 1")?;
    number(key("onward"), table.onward, 0.0..=1.0, "give 0 to 1")?;
    if table.anywhere + table.onward > 1.0 {
        let text = format!("is {}, which with learner.model.anywhere is more than 1; both are shares", table.onward);
        return Err(Violation::new(key("onward"), text));
    }
    number(key("ridge"), table.ridge, limits::REGULARISATION, "give 1e-6 to 1e6")?;
    if !(1..=limits::MAX_TICK).contains(&table.rest) {
        return Err(Violation::value(key("rest"), table.rest, "give 1 to 1e12 ticks"));
    }
    number(key("step"), table.step, limits::MODEL_STEP, "give 0 to 1")?;
    number(key("half_life"), table.half_life, limits::LEARNER_TICKS, "give 1 to 1e12 ticks")?;
    number(key("floor"), table.floor, 0.0..=1.0, "give 0 to 1")
}

fn check_plan(learner: &LearnerConfig) -> Result<(), Violation> {
    if let Some(budget_ms) = learner.budget_ms {
        number("learner.budget_ms", budget_ms, limits::BUDGET_MS, "give 0.1 to 1000 ms")?;
    }
    let key = |name: &str| format!("learner.plan.{name}");
    let ModelPredictiveConfig {
        horizon,
        iterations,
        rival_iterations,
        rival_gain,
        memory,
        points,
        steps,
        reward_features,
        dynamics_features,
        reward_products,
        dynamics_products,
        sampled,
        first_noise,
        refit_operations,
        operations,
        noise_floor,
    } = learner.plan.clone().unwrap_or_default();
    if horizon != 0 {
        whole_number(&key("horizon"), horizon, limits::PLAN_HORIZON)?;
    }
    whole_number(&key("iterations"), iterations, limits::PLAN_ITERATIONS)?;
    whole_number(&key("rival_iterations"), rival_iterations, limits::PLAN_ITERATIONS)?;
    number(key("rival_gain"), rival_gain, 0.0..=1.0, "give 0 to 1")?;
    whole_number(&key("memory"), memory, limits::PLAN_MEMORY)?;
    whole_number(&key("points"), points, limits::PLAN_POINTS)?;
    whole_number(&key("steps"), usize::try_from(steps).unwrap_or(usize::MAX), limits::PLAN_ITERATIONS)?;
    if reward_features != 0 {
        whole_number(&key("reward_features"), reward_features, limits::PLAN_FEATURES)?;
    }
    whole_number(&key("dynamics_features"), dynamics_features, limits::PLAN_FEATURES)?;
    whole_number(&key("reward_products"), reward_products, limits::PLAN_PRODUCTS)?;
    whole_number(&key("dynamics_products"), dynamics_products, limits::PLAN_PRODUCTS)?;
    number(key("sampled"), sampled, 0.0..=1.0, "give 0 to 1")?;
    number(key("first_noise"), first_noise, limits::FIRST_NOISE, "give 0 to 1000")?;
    number(key("refit_operations"), refit_operations, limits::OPERATIONS, "give 0.01 to 1e6, in millions")?;
    if operations != 0.0 {
        number(key("operations"), operations, limits::OPERATIONS, "give 0.01 to 1e6, in millions")?;
    }
    number(key("noise_floor"), noise_floor, limits::NOISE_FLOOR, "give 1e-12 to 0.1")
}

fn whole_number(key: &str, value: usize, range: RangeInclusive<usize>) -> Result<(), Violation> {
    if range.contains(&value) {
        return Ok(());
    }
    Err(Violation::value(key, value, format_args!("give {} to {}", range.start(), range.end())))
}

#[cfg(test)]
mod tests {
    use super::super::Scenario;
    use super::*;

    /// The message for the built-in arm with this `[learner]`; `fine` if it is valid.
    fn message(learner: &str) -> String {
        let mut scenario = Scenario::find("paper").unwrap();
        scenario.learner = toml::from_str(learner).unwrap();
        scenario.plan().err().map_or("fine".into(), |e| e.to_string())
    }

    #[test]
    fn presets_are_valid_and_parse_back_unchanged() {
        for rule in Rule::ALL {
            let mut scenario = Scenario::find("paper").unwrap();
            scenario.learner = LearnerConfig::preset(rule);
            let plan = scenario.plan().unwrap();
            let again = Scenario::parse(&plan.scenario.to_toml(), "again").unwrap().plan().unwrap();
            assert_eq!((plan.hash, plan.scenario.learner), (again.hash, again.scenario.learner));
        }
    }

    #[test]
    fn the_eye_is_refused_for_a_learned_reward() {
        let mut scenario = Scenario::find("eye").unwrap();
        scenario.learner = LearnerConfig::preset(Rule::LearnedReward);
        let message = scenario.plan().unwrap_err().to_string();
        assert!(
            message.contains("learner.rule is learned-reward, which needs inputs that the commands move"),
            "{message}"
        );
    }

    #[test]
    fn invalid_settings_are_reported_with_their_key() {
        for (learner, expected) in [
            ("rule = \"learned-reward\"", "fine"),
            ("rule = \"actor-critic\"\n[critic]\ndiscount = 1", "learner.critic.discount is 1"),
            ("rule = \"actor-critic\"\n[critic]\nbound = 0.5", "learner.critic.bound is 0.5"),
            ("rule = \"paper\"\n[critic]\nstep = 0.1", "learner.critic"),
            ("rule = \"baseline\"\n[baseline]\nticks = 0", "learner.baseline.ticks is 0"),
            ("rule = \"learned-reward\"\n[model]\nhorizon = 0", "learner.model.horizon is 0"),
            ("rule = \"learned-reward\"\n[model]\nmoved = [\"elbow\"]", "learner.model.moved[0] is \"elbow\""),
            ("rule = \"learned-reward\"\n[model]\nanywhere = 1.5", "learner.model.anywhere is 1.5"),
            (
                "rule = \"learned-reward\"\n[model]\nanywhere = 0.6\nonward = 0.6",
                "learner.model.onward is 0.6, which with",
            ),
            ("rule = \"learned-reward\"\n[model]\nridge = 0", "learner.model.ridge is 0"),
            ("rule = \"paper\"\nbudget_ms = 5", "learner.budget_ms is a key that the rule does not read"),
            ("rule = \"model-predictive\"\nbudget_ms = 0", "learner.budget_ms is 0; give 0.1 to 1000 ms"),
            ("rule = \"model-predictive\"\n[plan]\nhorizon = 1", "learner.plan.horizon is 1; give 2 to 200"),
            ("rule = \"model-predictive\"\n[plan]\nsampled = 2", "learner.plan.sampled is 2; give 0 to 1"),
            ("rule = \"model-predictive\"\n[model]\nrest = 1", "learner.model is a table that the rule does not read"),
            ("rule = \"learned-reward\"\n[model]\nrest = 0", "learner.model.rest is 0"),
            ("rule = \"learned-reward\"\n[model]\nreward_noise = nan", "learner.model.reward_noise is nan"),
        ] {
            let message = message(learner);
            assert!(message.contains(expected), "{message}");
        }
    }
}
