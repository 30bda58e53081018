//! `[encoder]`: the keys of the table, and their checks.

use serde::{Deserialize, Serialize};
use tectum_core::serde_pairs::pairs;

use super::check::{known_input, number, range_ends, rounded, show, unique_names};
use super::{PerAxis, Rule, SignalConfig, error::Violation, limits};

/// `[encoder]`: topographic maps, concatenated (section 3.3).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EncoderConfig {
    /// Scale the concatenated features to unit Euclidean norm.
    #[serde(default = "enabled")]
    pub normalise: bool,
    /// Names of inputs that are features without a map. They follow the maps' features and are never
    /// normalised.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub scalars: Vec<String>,
    /// The maps: at most 64, with at most 65,536 units together. At least one, unless there are scalars, or the
    /// controller is another program.
    #[serde(default)]
    pub maps: Vec<MapConfig>,
}

/// `[[encoder.maps]]`: one map over one or two inputs.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MapConfig {
    /// One or two inputs by name.
    pub inputs: Vec<String>,
    /// Units along each input; 2 to 4096. Default 16 each.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub units: Vec<usize>,
    /// Radius of the Gaussian kernel, in the unit of the inputs: one number for all, or one for each.
    pub radius: PerAxis,
    /// Centre of the first and of the last unit along each input. Default: the input's range.
    #[serde(default, deserialize_with = "pairs", skip_serializing_if = "Vec::is_empty")]
    pub ranges: Vec<[f64; 2]>,
}

fn enabled() -> bool {
    true
}

impl Default for EncoderConfig {
    fn default() -> Self {
        Self { normalise: enabled(), scalars: Vec::new(), maps: Vec::new() }
    }
}

impl EncoderConfig {
    /// Whether it has neither maps nor scalars.
    pub fn is_empty(&self) -> bool {
        self.maps.is_empty() && self.scalars.is_empty()
    }
}

/// Checks the encoder and returns the number of its features.
pub(super) fn check(encoder: &EncoderConfig, inputs: &[SignalConfig]) -> Result<usize, Violation> {
    let maps = &encoder.maps;
    for (i, name) in encoder.scalars.iter().enumerate() {
        known_input(format_args!("encoder.scalars[{i}]"), name, inputs)?;
    }
    unique_names("encoder.scalars", "", &encoder.scalars)?;
    if (maps.is_empty() && encoder.scalars.is_empty()) || maps.len() > limits::MAX_MAPS {
        return Err(Violation::new("encoder.maps", format_args!("has {} maps; give 1 to 64", maps.len())));
    }
    let mut total = 0;
    for (i, map) in maps.iter().enumerate() {
        // Cannot overflow: at most 64 maps of 4096 x 4096 units.
        total += check_map(&format!("encoder.maps[{i}]"), map, inputs)?;
    }
    if total > limits::MAX_FEATURES {
        let text = format!("has {total} units in all; give at most 65536");
        return Err(Violation::new("encoder.maps", text));
    }
    Ok(total + encoder.scalars.len())
}

/// Checks that the learning rule supports an encoder of this size. Two rules compute matrices over the features
/// before the first tick, and the work grows with the cube of their size.
pub(super) fn check_rule(rule: Rule, encoder: &EncoderConfig, features: usize) -> Result<(), Violation> {
    if rule == Rule::NaturalActorCritic && features > limits::METRIC_FEATURES {
        let text =
            format!("is natural-actor-critic, for which {features} features are too many; it supports at most 1024");
        return Err(Violation::new("learner.rule", text));
    }
    if rule != Rule::LearnedReward {
        return Ok(());
    }
    if !encoder.scalars.is_empty() {
        let text = "is given, and the rule learned-reward supports only maps; take it out, or give another rule";
        return Err(Violation::new("encoder.scalars", text));
    }
    for (i, map) in encoder.maps.iter().enumerate() {
        if let Some(units) = map.units.iter().find(|&&units| units > limits::MODEL_UNITS) {
            let text = "the rule learned-reward supports at most 256 units along an input";
            return Err(Violation::value(format_args!("encoder.maps[{i}].units"), units, text));
        }
    }
    Ok(())
}

/// Checks a map and returns the number of its units.
fn check_map(key: &str, map: &MapConfig, inputs: &[SignalConfig]) -> Result<usize, Violation> {
    let n = map.inputs.len();
    if !(1..=2).contains(&n) {
        return Err(Violation::new(
            format_args!("{key}.inputs"),
            format_args!("has {n} entries; a map has 1 or 2 inputs"),
        ));
    }
    let mut map_inputs = Vec::with_capacity(n);
    for (i, name) in map.inputs.iter().enumerate() {
        map_inputs.push(&inputs[known_input(format_args!("{key}.inputs[{i}]"), name, inputs)?]);
    }
    unique_names(&format!("{key}.inputs"), "", &map.inputs)?;

    let radii = map.radius.list_len();
    if radii == Some(0) {
        return Err(Violation::new(
            format_args!("{key}.radius"),
            "is an empty list; give a number, or one for each input",
        ));
    }
    let lists = [("units", map.units.len()), ("ranges", map.ranges.len()), ("radius", radii.unwrap_or(0))];
    for (list, length) in lists {
        if length != 0 && length != n {
            let otherwise = if list == "radius" { "or one number for all" } else { "or leave it out" };
            let text = format!("has length {length} and inputs has length {n}; give one for each input, {otherwise}");
            return Err(Violation::new(format_args!("{key}.{list}"), text));
        }
    }
    let mut map_units = 1;
    for (i, input) in map_inputs.into_iter().enumerate() {
        let units = map.units.get(i).copied().unwrap_or(limits::DEFAULT_UNITS);
        if !limits::UNITS.contains(&units) {
            let remedy = "a map may have 2 to 4096 units along an input";
            return Err(Violation::value(format_args!("{key}.units[{i}]"), units, remedy));
        }
        map_units *= units;
        let [min, max] = map.ranges.get(i).copied().unwrap_or([input.min, input.max]);
        range_ends(&format!("{key}.ranges[{i}]"), [min, max], limits::RANGE)?;
        let (radius, radius_key) = (map.radius.of(i), map.radius.key(&format!("{key}.radius"), i));
        number(&radius_key, radius, limits::RADIUS, "give more than 0 (1e-9 or more), up to 1e9")?;
        let spacing = (max - min) / (units - 1) as f64;
        if spacing > limits::SPACING_PER_RADIUS * radius {
            let remedy = format!(
                "the units along {} are about {} apart, so that inputs between them would hardly activate any; \
                 give a radius of at least a tenth of that, or more units",
                input.name,
                show(rounded(spacing))
            );
            return Err(Violation::value(radius_key, show(radius), remedy));
        }
    }
    Ok(map_units)
}
