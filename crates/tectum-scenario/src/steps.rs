//! Checks that a learner's steps are not too long for its features. A step at which only the bound on updates
//! would prevent divergence is refused. A step that is likely to fail gives a warning.
//!
//! One update changes the command (or value) for its own inputs by the step times the squared length of the
//! features. Therefore the limits apply to this product. The squared length is 1 for features of unit norm; for
//! the arm's maps without normalisation its mean over the input box is 44. The limits were measured on the arm,
//! over some 100,000 ticks. Where rewards are much smaller, longer steps work too.

use tectum_core::seed::stream;
use tectum_encoder::Encoder;

use super::check::show;
use super::error::Violation;
use super::{CriticFeatures, Plan, Rule};
use rand::RngExt as _;

/// Number of draws from the input box with which the mean squared length of the features is estimated.
const DRAWS: usize = 64;
/// Largest step without a trace, where each tick is a trial of its own. With features of unit norm and rewards
/// of the order of 1, an update overshoots above 2 (see [`STEP`](super::limits::STEP)). Not measured.
const MAX_OPEN_LOOP: f64 = 2.0;
/// Largest step of the paper's rule with a trace. On the arm, 0.03 learns and 0.1 does not.
const MAX_PAPER: f64 = 0.05;
/// Largest step with a baseline. On the arm, 0.2 learns and 0.5 does not.
const MAX_BASELINE: f64 = 0.3;
/// Largest step of an actor with a critic. Its updates are bounded, so that it does not diverge. On the arm, 10
/// learns (loss of 0.026 to 0.036 a tick after 100,000 ticks, three seeds). With 1000 every update is as large
/// as the bound, and the loss stays at 0.036 to 0.093.
const MAX_ACTOR: f64 = 10.0;
/// Largest useful step of a critic. Its updates are bounded too, at `1 - gamma lambda` of the error once the
/// trace has grown; with the preset's constants that is 0.28. Steps of 1 and 5.5 learn equally well.
const MAX_CRITIC: f64 = 1.0;

/// Checks the steps of a plan's learner. Returns warnings; each is one sentence with key, value, reason and
/// remedy.
pub(super) fn check(plan: &Plan) -> Result<Vec<String>, Violation> {
    let learner = &plan.scenario.learner;
    let mut warnings = Vec::new();
    if !learner.rule.is_linear() {
        return Ok(warnings);
    }
    let actor = learner.alpha_over_variance;
    let max_actor = match learner.rule {
        // A natural step is measured in the metric of the features; a learned reward and a plan have no such step.
        Rule::NaturalActorCritic | Rule::LearnedReward | Rule::ModelPredictive => f64::INFINITY,
        _ if learner.beta == 0.0 => MAX_OPEN_LOOP,
        Rule::Paper => MAX_PAPER,
        Rule::Baseline => MAX_BASELINE,
        Rule::ActorCritic => MAX_ACTOR,
    };
    let critic = learner.critic.as_ref().filter(|_| learner.rule == Rule::ActorCritic);
    let critic_uses_policy_features = critic.is_some_and(|c| c.sees == CriticFeatures::Policy);
    // The features have to be drawn only if the step could be too long for the longest possible features.
    let units = (plan.encoder().units() as f64).max(1.0);
    let longest = if plan.scenario.encoder.normalise && plan.scalars.is_empty() { 1.0 } else { units };
    let length = if actor * longest > max_actor || critic_uses_policy_features { squared_length(plan) } else { 1.0 };
    if actor * length > max_actor {
        warnings.push(warning("learner.alpha_over_variance", actor, length, max_actor));
    }
    if let Some(critic) = critic {
        let length = if critic_uses_policy_features { length } else { 1.0 };
        // While inputs do not change, the trace converges to the features times 1 / (1 - gamma lambda). An
        // update then changes the temporal-difference error by this share of it. Above 2, every update would
        // make the error larger than before, so that the bound would always replace the step.
        let (gamma, lambda) = (critic.discount, critic.decay);
        let share = critic.step * length * (1.0 - gamma) / (1.0 - gamma * lambda);
        if share > 2.0 {
            let max_step = 2.0 * critic.step / share;
            let remedy = format!(
                "with features of a mean squared length of {} the critic would diverge if its steps were not bounded; \
                 give less than {}",
                two_digits(length),
                two_digits(max_step)
            );
            return Err(Violation::value("learner.critic.step", show(critic.step), remedy));
        }
        if critic.step * length > MAX_CRITIC {
            warnings.push(warning("learner.critic.step", critic.step, length, MAX_CRITIC));
        }
    }
    Ok(warnings)
}

/// The warning for a step `value` times the squared `length` above `max_product`.
fn warning(key: &str, value: f64, length: f64, max_product: f64) -> String {
    format!(
        "{key} is {}, and with features of a mean squared length of {} learning is likely to fail; give at most {}{}",
        show(value),
        two_digits(length),
        two_digits(max_product / length),
        if length > 2.0 { ", or set encoder.normalise" } else { "" }
    )
}

/// Two significant digits, for computed numbers in a message.
fn two_digits(value: f64) -> String {
    show(format!("{value:.1e}").parse().unwrap_or(value))
}

/// The features' mean squared length over the input box.
fn squared_length(plan: &Plan) -> f64 {
    let mut encoder: Encoder = plan.encoder();
    let mut features = encoder.features();
    let mut rng = stream(0, "steps");
    let mut inputs = vec![0.0; plan.inputs.len()];
    let mut sum = 0.0;
    for _ in 0..DRAWS {
        for (x, signal) in inputs.iter_mut().zip(&plan.inputs) {
            *x = (signal.min + (signal.max - signal.min) * rng.random::<f64>()) as f32;
        }
        encoder.encode(&inputs, &mut features);
        sum += features.as_slice().iter().map(|&g| f64::from(g) * f64::from(g)).sum::<f64>();
    }
    sum / DRAWS as f64
}

#[cfg(test)]
mod tests {
    use super::super::{LearnerConfig, Scenario, presets};
    use super::*;

    /// The warnings for the built-in arm with this `[learner]`, or the error.
    fn warnings_for(learner: &str, normalise: bool) -> Result<Vec<String>, String> {
        let mut scenario = Scenario::find("arm").unwrap();
        scenario.learner = toml::from_str(learner).unwrap();
        scenario.encoder.normalise = normalise;
        scenario.plan().map(|plan| plan.warnings).map_err(|error| error.to_string())
    }

    #[test]
    fn presets_give_no_warnings() {
        for preset in presets() {
            assert_eq!(preset.scenario().unwrap().plan().unwrap().warnings, [""; 0], "{}", preset.name);
        }
        for rule in Rule::ALL {
            let mut scenario = Scenario::find("arm").unwrap();
            scenario.learner = LearnerConfig::preset(rule);
            assert_eq!(scenario.plan().unwrap().warnings, [""; 0], "{rule:?}");
        }
    }

    #[test]
    fn a_warning_names_the_step_that_is_too_long() {
        // Measured with prototypes: without normalisation a step of 0.01 diverges and 0.0009 does not.
        assert_eq!(warnings_for("alpha_over_variance = 0.0009", false).unwrap(), [""; 0]);
        let warnings = warnings_for("alpha_over_variance = 0.01", false).unwrap();
        assert!(
            warnings[0]
                .starts_with("learner.alpha_over_variance is 0.01, and with features of a mean squared length of 44"),
            "{warnings:?}"
        );
        assert!(warnings[0].ends_with(", or set encoder.normalise"), "{warnings:?}");
        for (learner, key) in [
            ("alpha_over_variance = 0.1", "learner.alpha_over_variance is 0.1"),
            ("rule = \"baseline\"\nalpha_over_variance = 0.5", "learner.alpha_over_variance is 0.5"),
            ("rule = \"actor-critic\"\nalpha_over_variance = 11.0", "learner.alpha_over_variance is 11,"),
            ("rule = \"actor-critic\"\n[critic]\nstep = 1.5", "learner.critic.step is 1.5"),
        ] {
            let warnings = warnings_for(learner, true).unwrap();
            assert!(warnings.len() == 1 && warnings[0].starts_with(key), "{warnings:?}");
        }
        assert_eq!(warnings_for("beta = 0\nalpha_over_variance = 0.5", true).unwrap(), [""; 0]);
    }

    #[test]
    fn a_critic_that_would_diverge_without_its_bound_is_refused() {
        let error = warnings_for("rule = \"actor-critic\"\n[critic]\nstep = 6", true).unwrap_err();
        assert!(error.contains("learner.critic.step is 6") && error.contains("give less than 5.6"), "{error}");
        // The preset's step, which is valid for features of unit norm.
        let error =
            warnings_for("rule = \"actor-critic\"\nalpha_over_variance = 0.001\n[critic]\nsees = \"policy\"", false)
                .unwrap_err();
        assert!(error.contains("learner.critic.step is 0.3"), "{error}");
    }
}
