//! The checks that the types of the tables cannot make: ranges, names, and references between tables.
//!
//! Checks run from the top of the file to the bottom and stop at the first problem, since one mistake often brings others
//! with it. Every bound comes from [`limits`].

use std::{collections::HashSet, fmt::Display, ops::RangeInclusive};

use super::{
    EncoderConfig, LogConfig, MapConfig, Rule, Scenario, SignalConfig, error::Violation, error::either, error::quoted,
    faults, find, gate, limits, plant_signals::signals, realtime, restart, servos, validate_learner, validate_plant,
};
use crate::wire::{MAX_INPUTS, MAX_MEASURES, MAX_OUTPUTS};

/// Checks a whole scenario.
pub(super) fn check(scenario: &Scenario) -> Result<(), Violation> {
    top(scenario)?;
    gate::check(&scenario.gate, &scenario.overrun)?;
    validate_plant::check(&scenario.plant)?;
    servos::check(&scenario.plant, scenario.period_ms)?;

    let signals = signals(scenario);
    gate::check_outputs(&scenario.gate, &scenario.plant, &signals.outputs)?;
    signal_list("plant.inputs", &signals.inputs, MAX_INPUTS)?;
    signal_list("plant.outputs", &signals.outputs, MAX_OUTPUTS)?;
    measures(&signals.measures)?;

    let features = encoder(&scenario.encoder, &signals.inputs)?;
    policy(scenario.policy.sigma, scenario.gate.max_command.least())?;
    let still = match &scenario.plant {
        plant if plant.eye.is_some() => Some("the eye"),
        plant if plant.arm.as_ref().is_some_and(|arm| arm.open_loop) => Some("an arm in an open loop"),
        _ => None,
    };
    if let (Rule::LearnedReward, Some(plant)) = (scenario.learner.rule, still) {
        let text =
            format!("is learned-reward, which needs inputs that the commands move; {plant} has none, so give it paper");
        return Err(Violation::new("learner.rule", text));
    }
    within_reach(scenario.learner.rule, &scenario.encoder, features)?;
    validate_learner::check(&scenario.learner, &signals)?;
    log(&scenario.log)?;
    channels(scenario)?;
    restart::check(&scenario.restart)?;
    realtime::check(&scenario.realtime)?;
    faults::check(&scenario.faults)
}

fn top(scenario: &Scenario) -> Result<(), Violation> {
    let allowed = |c: char| c.is_ascii_alphanumeric() || "-_".contains(c);
    named("name", &scenario.name, limits::NAME_CHARS, allowed, "letters, digits, - and _")?;
    if scenario.seed > limits::MAX_SEED {
        return Err(Violation::value(
            "seed",
            scenario.seed,
            "give 0 to 9223372036854775807, the largest integer of TOML",
        ));
    }
    let period = scenario.period_ms;
    number("period_ms", period, limits::PERIOD_MS, "give 1 to 1000 ms")?;
    // Division rounds to the nearest double, so that every decimal with up to six places comes back as it was written.
    if (period * 1e6).round() / 1e6 != period {
        let remedy = "give at most six decimals, so that it is a whole number of ns";
        return Err(Violation::value("period_ms", show(period), remedy));
    }
    ticks("ticks", scenario.ticks, *limits::TICKS.start())
}

fn signal_list(key: &str, signals: &[SignalConfig], most: usize) -> Result<(), Violation> {
    if signals.is_empty() {
        let text = "is empty; a program other than tectum-simulator lists its inputs and outputs";
        return Err(Violation::new(key, text));
    }
    if signals.len() > most {
        return Err(Violation::new(key, format_args!("has {} entries; give at most {most}", signals.len())));
    }
    for (i, signal) in signals.iter().enumerate() {
        signal_name(&format!("{key}[{i}].name"), &signal.name)?;
        let unit = &signal.unit;
        if unit.chars().count() > limits::NAME_CHARS || unit.chars().any(char::is_control) {
            let remedy = "give at most 32 characters, none of them a control character";
            return Err(Violation::value(format_args!("{key}[{i}].unit"), quoted(unit), remedy));
        }
        let (min, max) = (signal.min, signal.max);
        let ends = [("min", min), ("max", max)];
        for (end, value) in ends {
            range_end(format_args!("{key}[{i}].{end}"), value)?;
        }
        if min >= max {
            let remedy = format!("give more than min, which is {}", show(min));
            return Err(Violation::value(format_args!("{key}[{i}].max"), show(max), remedy));
        }
    }
    let names: Vec<_> = signals.iter().map(|signal| signal.name.as_str()).collect();
    different(key, ".name", &names)
}

fn measures(names: &[String]) -> Result<(), Violation> {
    if names.len() > MAX_MEASURES {
        let text = format!("has {} entries; give at most {MAX_MEASURES}", names.len());
        return Err(Violation::new("plant.measures", text));
    }
    for (i, name) in names.iter().enumerate() {
        signal_name(&format!("plant.measures[{i}]"), name)?;
    }
    different("plant.measures", "", names)
}

/// Checks the encoder and counts its features.
fn encoder(encoder: &EncoderConfig, inputs: &[SignalConfig]) -> Result<usize, Violation> {
    let maps = &encoder.maps;
    for (i, name) in encoder.scalars.iter().enumerate() {
        known_input(format_args!("encoder.scalars[{i}]"), name, inputs)?;
    }
    different("encoder.scalars", "", &encoder.scalars)?;
    if (maps.is_empty() && encoder.scalars.is_empty()) || maps.len() > limits::MAX_MAPS {
        return Err(Violation::new("encoder.maps", format_args!("has {} maps; give 1 to 64", maps.len())));
    }
    let mut total = 0;
    for (i, map) in maps.iter().enumerate() {
        // At most 64 maps of 4096 x 4096 units: far from overflow.
        total += check_map(&format!("encoder.maps[{i}]"), map, inputs)?;
    }
    if total > limits::MAX_FEATURES {
        let text = format!("has {total} units in all; give at most 65536");
        return Err(Violation::new("encoder.maps", text));
    }
    Ok(total + encoder.scalars.len())
}

/// What a rule can do with at most: some work out matrices of the encoder's before they begin.
fn within_reach(rule: Rule, encoder: &EncoderConfig, features: usize) -> Result<(), Violation> {
    if rule == Rule::NaturalActorCritic && features > limits::METRIC_FEATURES {
        let text = format!("is natural-actor-critic, for which {features} features are too many; it can do 1024");
        return Err(Violation::new("learner.rule", text));
    }
    if rule != Rule::LearnedReward {
        return Ok(());
    }
    if !encoder.scalars.is_empty() {
        let text = "is given, and the rule learned-reward can do with maps alone; take it out, or give another rule";
        return Err(Violation::new("encoder.scalars", text));
    }
    for (i, map) in encoder.maps.iter().enumerate() {
        if let Some(units) = map.units.iter().find(|&&units| units > limits::MODEL_UNITS) {
            let text = "the rule learned-reward can do with at most 256 units along an input";
            return Err(Violation::value(format_args!("encoder.maps[{i}].units"), units, text));
        }
    }
    Ok(())
}

/// The number of the input that has this name.
pub(super) fn known_input(key: impl Display, name: &str, inputs: &[SignalConfig]) -> Result<usize, Violation> {
    find(inputs, name).ok_or_else(|| {
        let names: Vec<_> = inputs.iter().map(|input| &input.name).collect();
        Violation::value(key, quoted(name), format!("the plant's inputs are {}", either(&names, "and")))
    })
}

/// Checks a map and counts its units.
fn check_map(key: &str, map: &MapConfig, inputs: &[SignalConfig]) -> Result<usize, Violation> {
    let n = map.inputs.len();
    if !(1..=2).contains(&n) {
        return Err(Violation::new(
            format_args!("{key}.inputs"),
            format_args!("has {n} entries; a map has 1 or 2 inputs"),
        ));
    }
    let mut known = Vec::with_capacity(n);
    for (i, name) in map.inputs.iter().enumerate() {
        known.push(&inputs[known_input(format_args!("{key}.inputs[{i}]"), name, inputs)?]);
    }
    different(&format!("{key}.inputs"), "", &map.inputs)?;

    for (list, length) in [("units", map.units.len()), ("ranges", map.ranges.len())] {
        if length != 0 && length != n {
            let text =
                format!("has length {length} and inputs has length {n}; give one for each input, or leave it out");
            return Err(Violation::new(format_args!("{key}.{list}"), text));
        }
    }
    number(format_args!("{key}.radius"), map.radius, limits::RADIUS, "give more than 0 (1e-9 or more), up to 1e9")?;
    let mut total = 1;
    for (i, input) in known.into_iter().enumerate() {
        let units = map.units.get(i).copied().unwrap_or(limits::DEFAULT_UNITS);
        if !limits::UNITS.contains(&units) {
            let remedy = "a map may have 2 to 4096 units along an input";
            return Err(Violation::value(format_args!("{key}.units[{i}]"), units, remedy));
        }
        total *= units;
        let [min, max] = map.ranges.get(i).copied().unwrap_or([input.min, input.max]);
        ordered(&format!("{key}.ranges[{i}]"), [min, max], limits::RANGE)?;
        let spacing = (max - min) / (units - 1) as f64;
        if spacing > limits::SPACING_PER_RADIUS * map.radius {
            let remedy = format!(
                "the units along {} are about {} apart, so that inputs between them would hardly activate any; give a radius of \
                 at least a tenth of that, or more units",
                input.name,
                show(rounded(spacing))
            );
            return Err(Violation::value(format_args!("{key}.radius"), show(map.radius), remedy));
        }
    }
    Ok(total)
}

fn policy(sigma: f64, max_command: f64) -> Result<(), Violation> {
    let remedy = format!("give more than 0 (1e-9 or more), up to gate.max_command, which is {}", show(max_command));
    number("policy.sigma", sigma, limits::MIN_SIGMA..=max_command, remedy)
}

fn log(log: &LogConfig) -> Result<(), Violation> {
    ticks("log.every", log.every, 1)?;
    ticks("log.hash_every", log.hash_every, 1)
}

fn channels(scenario: &Scenario) -> Result<(), Violation> {
    let channels = &scenario.channels;
    let mut named_channels =
        vec![("observation", &channels.observation), ("command", &channels.command), ("learning", &channels.learning)];
    if scenario.vision().is_some() {
        named_channels.push(("vision", &channels.vision));
    } else if channels.vision != crate::wire::ChannelNames::default().vision {
        let text =
            "names a channel that there is with plant.servos.sight = \"vision\" alone; take it out, or give that";
        return Err(Violation::new("channels.vision", text));
    }
    let allowed = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || "_-/".contains(c);
    for (i, (key, name)) in named_channels.iter().enumerate() {
        let words = "lower-case letters, digits, _, - and /";
        named(format_args!("channels.{key}"), name, limits::CHANNEL_CHARS, allowed, words)?;
        if let Some((other, _)) = named_channels[..i].iter().find(|(_, other)| other == name) {
            let text = format!("and channels.{other} are both {}; give each channel a name of its own", quoted(name));
            return Err(Violation::new(format_args!("channels.{key}"), text));
        }
    }
    Ok(())
}

/// A number in a range; NaN is in none.
pub(super) fn number(
    key: impl Display,
    value: f64,
    range: RangeInclusive<f64>,
    remedy: impl Display,
) -> Result<(), Violation> {
    if range.contains(&value) { Ok(()) } else { Err(Violation::value(key, show(value), remedy)) }
}

/// A whole number of ticks.
pub(super) fn ticks(key: impl Display, value: u64, least: u64) -> Result<(), Violation> {
    if (least..=limits::MAX_TICK).contains(&value) {
        return Ok(());
    }
    Err(Violation::value(key, value, format_args!("give {least} to 1000000000000 ticks")))
}

/// Two ends of a range, `[low, high]`.
pub(super) fn ordered(key: &str, [low, high]: [f64; 2], most: f64) -> Result<(), Violation> {
    let ends = -most..=most;
    if ends.contains(&low) && ends.contains(&high) && low < high {
        return Ok(());
    }
    let value = format!("[{}, {}]", show(low), show(high));
    let remedy = format!("give the lower end and then the upper one, between {} and {}", show(-most), show(most));
    Err(Violation::value(key, value, remedy))
}

fn range_end(key: impl Display, value: f64) -> Result<(), Violation> {
    number(key, value, -limits::RANGE..=limits::RANGE, "give a number from -1e9 to 1e9")
}

fn signal_name(key: &str, name: &str) -> Result<(), Violation> {
    let allowed = |c: char| c.is_ascii_alphanumeric() || "_-./".contains(c);
    named(key, name, limits::NAME_CHARS, allowed, "letters, digits, _, -, . and /")
}

fn named(
    key: impl Display,
    name: &str,
    most: usize,
    allowed: impl Fn(char) -> bool,
    words: &str,
) -> Result<(), Violation> {
    if !name.is_empty() && name.chars().count() <= most && name.chars().all(allowed) {
        return Ok(());
    }
    Err(Violation::value(key, quoted(name), format_args!("give 1 to {most} characters out of {words}")))
}

/// Names in a list that must all differ.
fn different(list: &str, suffix: &str, names: &[impl AsRef<str>]) -> Result<(), Violation> {
    let mut seen = HashSet::new();
    for (i, name) in names.iter().enumerate() {
        let name = name.as_ref();
        if !seen.insert(name) {
            let key = format!("{list}[{i}]{suffix}");
            return Err(Violation::value(
                key,
                quoted(name),
                "this name is in the list already, and each may occur once",
            ));
        }
    }
    Ok(())
}

/// Three significant digits, for numbers that we worked out and nobody wrote.
fn rounded(value: f64) -> f64 {
    format!("{value:.2e}").parse().unwrap_or(value)
}

/// A number as TOML writes it, short even if it is huge.
pub(super) fn show(value: f64) -> String {
    let text = format!("{value:?}");
    // `inf` and `NaN` are Rust's words; TOML says `nan`.
    if value.is_nan() { "nan".to_owned() } else { text.strip_suffix(".0").map(str::to_owned).unwrap_or(text) }
}
