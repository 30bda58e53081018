//! Steps that are too long for their features: what only bounds would hold is refused, what is likely to fail is warned of.
//!
//! How far one update changes the answer to the inputs that it came of is the step times the squared length of the
//! features, so it is their product that counts: 1 for features of unit norm, a mean of 44 over the input box for the arm's maps as they are.
//! The limits were measured on the arm, over some 100,000 ticks; where rewards are much smaller, longer steps will do.

use crate::encoder::Encoder;
use crate::seed::stream;

use super::check::show;
use super::error::Violation;
use super::{CriticFeatures, Plan, Rule};
use rand::RngExt as _;

/// Draws from the input box for the mean squared length of the features.
const DRAWS: usize = 64;
/// Largest step without a trace (a run of single decisions): with features of unit norm and rewards of the order of 1, the
/// answer overshoots from there on, as [`STEP`](super::limits::STEP) has it. Not measured.
const OPEN_LOOP: f64 = 2.0;
/// Largest step of the paper's rule with a trace: on the arm 0.03 learns and 0.1 does not.
const PAPER: f64 = 0.05;
/// The same with a baseline: 0.2 learns, 0.5 does not.
const BASELINE: f64 = 0.3;
/// The same of an actor with a critic. Its updates are bounded, so that it does not diverge: 10 learns (0.026 to 0.036 a
/// tick after 100,000 ticks, three seeds), 1000 moves by the whole bound in every tick and is left with 0.036 to 0.093.
const ACTOR: f64 = 10.0;
/// Largest step of a critic that makes a difference. Its updates are bounded too, at `1 - gamma lambda` of the error once the
/// trace has grown, with the preset's constants 0.28; steps of 1 and 5.5 learn alike.
const CRITIC: f64 = 1.0;

/// Checks the steps of a plan's learner. Returns warnings, one sentence each: key, value, why, remedy.
pub(super) fn check(plan: &Plan) -> Result<Vec<String>, Violation> {
    let learner = &plan.scenario.learner;
    let mut warnings = Vec::new();
    let actor = learner.alpha_over_variance;
    let most = match learner.rule {
        // Natural steps are measured by the metric, and a learned reward has no such step.
        Rule::NaturalActorCritic | Rule::LearnedReward => f64::INFINITY,
        _ if learner.beta == 0.0 => OPEN_LOOP,
        Rule::Paper => PAPER,
        Rule::Baseline => BASELINE,
        Rule::ActorCritic => ACTOR,
    };
    let critic = learner.critic.as_ref().filter(|_| learner.rule == Rule::ActorCritic);
    let dear = critic.is_some_and(|c| c.sees == CriticFeatures::Policy);
    // Most plans are far from all limits, whatever their features.
    let units = (plan.encoder().units() as f64).max(1.0);
    let largest = if plan.scenario.encoder.normalise && plan.scalars.is_empty() { 1.0 } else { units };
    let length = if actor * largest > most || dear { squared_length(plan) } else { 1.0 };
    if actor * length > most {
        warnings.push(likely("learner.alpha_over_variance", actor, length, most));
    }
    if let Some(critic) = critic {
        let length = if dear { length } else { 1.0 };
        // While inputs stand still the trace settles at 1 / (1 - gamma lambda) features, and an update changes the
        // temporal-difference error by this share of it: above 2, every update would make the error larger than it was, and
        // it is only ever the bound that is taken in place of the step.
        let (gamma, lambda) = (critic.discount, critic.decay);
        let share = critic.step * length * (1.0 - gamma) / (1.0 - gamma * lambda);
        if share > 2.0 {
            let most = 2.0 * critic.step / share;
            let remedy = format!(
                "with features of a mean squared length of {} the critic would diverge if its steps were not bounded; give less than {}",
                short(length),
                short(most)
            );
            return Err(Violation::value("learner.critic.step", show(critic.step), remedy));
        }
        if critic.step * length > CRITIC {
            warnings.push(likely("learner.critic.step", critic.step, length, CRITIC));
        }
    }
    Ok(warnings)
}

fn likely(key: &str, value: f64, length: f64, most: f64) -> String {
    format!(
        "{key} is {}, and with features of a mean squared length of {} learning is likely to fail; give at most {}{}",
        show(value),
        short(length),
        short(most / length),
        if length > 2.0 { ", or set encoder.normalise" } else { "" }
    )
}

/// Two significant digits, for numbers that nobody wrote.
fn short(value: f64) -> String {
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

    /// What is said of the built-in arm with this `[learner]`: warnings, or the refusal.
    fn said(learner: &str, normalise: bool) -> Result<Vec<String>, String> {
        let mut scenario = Scenario::find("arm").unwrap();
        scenario.learner = toml::from_str(learner).unwrap();
        scenario.encoder.normalise = normalise;
        scenario.plan().map(|plan| plan.warnings).map_err(|error| error.to_string())
    }

    #[test]
    fn what_is_built_in_is_not_warned_of() {
        for preset in presets() {
            assert_eq!(preset.scenario().unwrap().plan().unwrap().warnings, [""; 0], "{}", preset.name);
        }
        for rule in [Rule::Paper, Rule::Baseline, Rule::ActorCritic, Rule::NaturalActorCritic, Rule::LearnedReward] {
            let mut scenario = Scenario::find("arm").unwrap();
            scenario.learner = LearnerConfig::preset(rule);
            assert_eq!(scenario.plan().unwrap().warnings, [""; 0], "{rule:?}");
        }
    }

    #[test]
    fn long_steps_are_warned_of_by_name() {
        // What the prototypes met: raw kernels with 0.01 diverge, with 0.0009 they do not.
        assert_eq!(said("alpha_over_variance = 0.0009", false).unwrap(), [""; 0]);
        let raw = said("alpha_over_variance = 0.01", false).unwrap();
        assert!(
            raw[0].starts_with("learner.alpha_over_variance is 0.01, and with features of a mean squared length of 44"),
            "{raw:?}"
        );
        assert!(raw[0].ends_with(", or set encoder.normalise"), "{raw:?}");
        for (learner, key) in [
            ("alpha_over_variance = 0.1", "learner.alpha_over_variance is 0.1"),
            ("rule = \"baseline\"\nalpha_over_variance = 0.5", "learner.alpha_over_variance is 0.5"),
            ("rule = \"actor-critic\"\nalpha_over_variance = 11.0", "learner.alpha_over_variance is 11,"),
            ("rule = \"actor-critic\"\n[critic]\nstep = 1.5", "learner.critic.step is 1.5"),
        ] {
            let warnings = said(learner, true).unwrap();
            assert!(warnings.len() == 1 && warnings[0].starts_with(key), "{warnings:?}");
        }
        assert_eq!(said("beta = 0\nalpha_over_variance = 0.5", true).unwrap(), [""; 0]);
    }

    #[test]
    fn a_critic_that_only_its_bound_would_hold_is_refused() {
        let refusal = said("rule = \"actor-critic\"\n[critic]\nstep = 6", true).unwrap_err();
        assert!(refusal.contains("learner.critic.step is 6") && refusal.contains("give less than 5.6"), "{refusal}");
        // The same step that is fine for unit norm.
        let refusal = said("rule = \"actor-critic\"\nalpha_over_variance = 0.001\n[critic]\nsees = \"policy\"", false)
            .unwrap_err();
        assert!(refusal.contains("learner.critic.step is 0.3"), "{refusal}");
    }
}
