//! The checks that types cannot express: ranges, names, and references between tables.
//!
//! Checks run from the top of the file to the bottom and stop at the first problem, because one mistake often
//! causes several. Every bound comes from [`limits`].

use super::check::{checked_name, number, show, ticks};
use super::{
    LogConfig, Noise, Rule, Scenario, controller, encoder, error::Violation, error::quoted, faults, gate, leader,
    learner, limits, link, plant, plant_signals::PlantSignals, plant_signals::signals, realtime, restart, servos,
};
use crate::limits::{MAX_INPUTS, MAX_OUTPUTS};

/// Checks a whole scenario.
pub(super) fn check(scenario: &Scenario) -> Result<(), Violation> {
    check_top_level(scenario)?;
    gate::check(&scenario.gate, &scenario.overrun)?;
    plant::check(&scenario.plant)?;
    leader::check(&scenario.plant)?;
    servos::check(&scenario.plant, scenario.period_ms)?;

    let signals = signals(scenario);
    gate::check_outputs(&scenario.gate, &scenario.plant, &signals.outputs)?;
    plant::signal_list("plant.inputs", &signals.inputs, MAX_INPUTS)?;
    plant::signal_list("plant.outputs", &signals.outputs, MAX_OUTPUTS)?;
    plant::measures(&signals.measures)?;

    controller::check(&scenario.controller)?;
    check_learning(scenario, &signals)?;
    check_log(&scenario.log)?;
    check_channels(scenario)?;
    restart::check(&scenario.restart)?;
    realtime::check(&scenario.realtime)?;
    link::check(&scenario.link, &scenario.gate)?;
    faults::check(&scenario.faults)
}

/// Checks encoder, policy and learner. Another controller's program may do without an encoder, and reads the
/// other two by itself.
fn check_learning(scenario: &Scenario, signals: &PlantSignals) -> Result<(), Violation> {
    if !scenario.controller.is_shipped() {
        if !scenario.encoder.is_empty() {
            encoder::check(&scenario.encoder, &signals.inputs)?;
        }
        return Ok(());
    }
    let rule = scenario.learner.rule;
    // A learner without features may be given an encoder all the same, so that one line changes the learner.
    let features = match rule.is_linear() || !scenario.encoder.is_empty() {
        true => encoder::check(&scenario.encoder, &signals.inputs)?,
        false => 0,
    };
    check_policy(scenario.policy.sigma, scenario.gate.max_command.least())?;
    let unmoved = match &scenario.plant {
        plant if plant.eye.is_some() => Some("the eye"),
        plant if plant.arm.as_ref().is_some_and(|arm| arm.open_loop) => Some("an arm in an open loop"),
        _ => None,
    };
    if let (Rule::LearnedReward | Rule::ModelPredictive, Some(plant)) = (rule, unmoved) {
        let rule = learner::name(rule);
        let text = format!("is {rule}, which needs inputs that the commands move; {plant} has none, so give it paper");
        return Err(Violation::new("learner.rule", text));
    }
    if !rule.is_linear() && scenario.policy.noise != Noise::Gaussian {
        let text = "is laplace, and model-predictive explores with Gaussian noise; take it out, or give another rule";
        return Err(Violation::new("policy.noise", text));
    }
    encoder::check_rule(rule, &scenario.encoder, features)?;
    learner::check(&scenario.learner, signals)
}

fn check_top_level(scenario: &Scenario) -> Result<(), Violation> {
    let allowed = |c: char| c.is_ascii_alphanumeric() || "-_".contains(c);
    checked_name("name", &scenario.name, limits::NAME_CHARS, allowed, "letters, digits, - and _")?;
    if scenario.seed > limits::MAX_SEED {
        return Err(Violation::value(
            "seed",
            scenario.seed,
            "give 0 to 9223372036854775807, the largest integer of TOML",
        ));
    }
    let period = scenario.period_ms;
    number("period_ms", period, limits::PERIOD_MS, "give 1 to 1000 ms")?;
    // Division rounds to the nearest double. So every decimal with up to six places passes this comparison
    // exactly.
    if (period * 1e6).round() / 1e6 != period {
        let remedy = "give at most six decimals, so that it is a whole number of ns";
        return Err(Violation::value("period_ms", show(period), remedy));
    }
    ticks("ticks", scenario.ticks, *limits::TICKS.start())
}

fn check_policy(sigma: f64, max_command: f64) -> Result<(), Violation> {
    let remedy = format!("give more than 0 (1e-9 or more), up to gate.max_command, which is {}", show(max_command));
    number("policy.sigma", sigma, limits::MIN_SIGMA..=max_command, remedy)
}

fn check_log(log: &LogConfig) -> Result<(), Violation> {
    ticks("log.every", log.every, 1)?;
    ticks("log.hash_every", log.hash_every, 1)?;
    if let Some(limit) = log.limit_mb {
        number("log.limit_mb", limit, 1.0..=1e9, "give 1 to 1000000000 MB")?;
        if log.rotate.is_none() {
            let text = "limits a log of one segment, and only whole segments are removed; give log.rotate, too";
            return Err(Violation::new("log.limit_mb", text));
        }
    }
    match log.sync_s {
        Some(sync) => number("log.sync_s", sync, 0.1..=86400.0, "give 0.1 to 86400 s"),
        None => Ok(()),
    }
}

fn check_channels(scenario: &Scenario) -> Result<(), Violation> {
    let channels = &scenario.channels;
    let mut named_channels =
        vec![("observation", &channels.observation), ("command", &channels.command), ("learning", &channels.learning)];
    if scenario.vision().is_some() {
        named_channels.push(("vision", &channels.vision));
    } else if channels.vision != crate::ChannelNames::default().vision {
        let text = "names a channel that exists only with plant.servos.sight = \"vision\"; take it out, or give that";
        return Err(Violation::new("channels.vision", text));
    }
    let allowed = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || "_-/".contains(c);
    for (i, (key, name)) in named_channels.iter().enumerate() {
        let allowed_text = "lower-case letters, digits, _, - and /";
        checked_name(format_args!("channels.{key}"), name, limits::CHANNEL_CHARS, allowed, allowed_text)?;
        if let Some((other, _)) = named_channels[..i].iter().find(|(_, other)| other == name) {
            let text = format!("and channels.{other} are both {}; give each channel a name of its own", quoted(name));
            return Err(Violation::new(format_args!("channels.{key}"), text));
        }
    }
    Ok(())
}
