//! `[plant]`: the keys of the table, and their checks: which tables belong to which program, the arm's geometry, and
//! the lists of signals.

use std::f64::consts::PI;

use serde::{Deserialize, Serialize};

use super::check::{number, program, range_end, range_ends, show, signal_name, ticks, unique_names};
use super::{
    ArmConfig, CartPoleConfig, EmulatorConfig, EyeConfig, FurutaConfig, LeaderConfig, MeasureConfig, MeasureRole,
    PendulumConfig, PointMassConfig, ReacherConfig, ServosConfig, SignalConfig, So101Config, TimingConfig, bodies,
    error::Violation, error::quoted, limits,
};
use crate::limits::MAX_MEASURES;
use crate::programs::is_simulator;

/// `[plant]`: the plant's program, its signals and its settings.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PlantConfig {
    /// The program. A name is looked up beside `tectum` and then in `PATH`; a path is used unchanged.
    #[serde(default = "default_program")]
    pub program: String,
    /// Arguments for the program, before those that the launcher adds.
    #[serde(default)]
    pub args: Vec<String>,
    /// The inputs of an observation. Optional with a body such as `arm`, which defines its own.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub inputs: Vec<SignalConfig>,
    /// The outputs of a command. Optional with a body such as `arm`, which defines its own.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub outputs: Vec<SignalConfig>,
    /// The measures, at most 6. The summary reports the one with the role `error` at the end of each target.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub measures: Vec<MeasureConfig>,
    /// The simulator's arm.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub arm: Option<ArmConfig>,
    /// The simulator's eye.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub eye: Option<EyeConfig>,
    /// The simulator's pendulum.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub pendulum: Option<PendulumConfig>,
    /// The simulator's cart-pole.
    #[serde(default, rename = "cart-pole", skip_serializing_if = "Option::is_none")]
    pub cart_pole: Option<CartPoleConfig>,
    /// The simulator's two-joint arm with inertia.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reacher: Option<ReacherConfig>,
    /// The simulator's Furuta pendulum.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub furuta: Option<FurutaConfig>,
    /// The simulator's point mass.
    #[serde(default, rename = "point-mass", skip_serializing_if = "Option::is_none")]
    pub point_mass: Option<PointMassConfig>,
    /// The simulator's SO-101.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub so101: Option<So101Config>,
    /// How late the simulator's plant is.
    #[serde(default, skip_serializing_if = "TimingConfig::is_nothing")]
    pub timing: TimingConfig,
    /// The servos of `tectum-bridge`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub servos: Option<ServosConfig>,
    /// The arm that the servos of `tectum-bridge` follow.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub leader: Option<LeaderConfig>,
    /// An emulated chain of servos.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub emulator: Option<EmulatorConfig>,
}

fn default_program() -> String {
    crate::programs::SIMULATOR.to_owned()
}

/// Checks the table without its lists of signals, which are checked after they are resolved.
pub(super) fn check(plant: &PlantConfig) -> Result<(), Violation> {
    program("plant", &plant.program, &plant.args)?;
    check_kind(plant)?;
    plant.arm.as_ref().map_or(Ok(()), check_arm)?;
    bodies::check(plant)?;
    plant.emulator.as_ref().map_or(Ok(()), super::emulator::check)
}

/// Checks that the simulator has exactly one body, and no lists of signals, because the body defines them. Any other
/// program may have an arm, but nothing else that is simulated.
fn check_kind(plant: &PlantConfig) -> Result<(), Violation> {
    if !is_simulator(&plant.program) {
        return bodies::check_other_program(plant);
    }
    bodies::check_one(plant)?;
    let signal_lists = [
        ("plant.inputs", plant.inputs.is_empty()),
        ("plant.outputs", plant.outputs.is_empty()),
        ("plant.measures", plant.measures.is_empty()),
    ];
    match signal_lists.iter().find(|(_, empty)| !empty) {
        Some((key, _)) => Err(Violation::new(key, "is given, but tectum-simulator knows its own; take it out")),
        None => Ok(()),
    }
}

fn check_arm(arm: &ArmConfig) -> Result<(), Violation> {
    let n = arm.lengths.len();
    if !limits::JOINTS.contains(&n) {
        return Err(Violation::new("plant.arm.lengths", format_args!("has {n} entries; give 1 to 8 lengths")));
    }
    for (i, &length) in arm.lengths.iter().enumerate() {
        number(format_args!("plant.arm.lengths[{i}]"), length, limits::LENGTH, "give 0.001 to 100 m")?;
    }
    let coordinate = -limits::COORDINATE..=limits::COORDINATE;
    for (i, &value) in arm.base.iter().enumerate() {
        number(format_args!("plant.arm.base[{i}]"), value, coordinate.clone(), "give -1000 to 1000 m")?;
    }
    if arm.gain == 0.0 || !(-limits::GAIN..=limits::GAIN).contains(&arm.gain) {
        let remedy = "give a rate other than 0, from -1e6 to 1e6 rad/s";
        return Err(Violation::value("plant.arm.gain", show(arm.gain), remedy));
    }
    check_limits(arm)?;
    range_ends("plant.arm.arena", arm.arena, limits::COORDINATE)?;
    ticks("plant.arm.target_every", arm.target_every, 1)?;
    if arm.open_loop && arm.target_every != 1 {
        let remedy = "an open loop has a new target every tick, so give 1";
        return Err(Violation::value("plant.arm.target_every", arm.target_every, remedy));
    }
    check_targets(arm)?;
    let reward = &arm.reward;
    let weights =
        [("scale", reward.scale), ("speed", reward.speed), ("angle", reward.angle), ("collision", reward.collision)];
    for (key, value) in weights {
        number(format_args!("plant.arm.reward.{key}"), value, limits::WEIGHT, "give 0 to 1e6")?;
    }
    if let Some(near) = reward.near {
        number("plant.arm.reward.near", near, limits::LENGTH, "give 0.001 to 100 m, or leave it out")?;
    }
    check_blocks(arm)?;
    check_shortened(arm)?;
    check_mirrors(arm)?;
    check_payloads(arm)
}

/// Either all joints are limited or none. Each range contains 0, because the arm starts with all angles 0.
fn check_limits(arm: &ArmConfig) -> Result<(), Violation> {
    let (limited, joints) = (arm.limits.len(), arm.lengths.len());
    if limited != 0 && limited != joints {
        let text = format!(
            "has {limited} entries and the arm has {joints} joints; give one for each, \
             or leave it out if they turn freely"
        );
        return Err(Violation::new("plant.arm.limits", text));
    }
    if arm.hidden_limits && limited == 0 {
        let text = "is true, and there are no limits to hide; give limits, or leave it out";
        return Err(Violation::new("plant.arm.hidden_limits", text));
    }
    for (i, &[low, high]) in arm.limits.iter().enumerate() {
        let turn = -PI..=PI;
        if !(turn.contains(&low) && turn.contains(&high) && low < high && (low..=high).contains(&0.0)) {
            let value = format!("[{}, {}]", show(low), show(high));
            let remedy = "give the least and then the greatest angle, from -pi to pi rad, \
                          with the starting angle 0 between them";
            return Err(Violation::value(format_args!("plant.arm.limits[{i}]"), value, remedy));
        }
        if high - low > limits::LIMITED_TURN {
            let value = format!("[{}, {}]", show(low), show(high));
            let remedy =
                "a limited joint has less than a full turn, at most 6.25 rad; leave limits out if joints turn freely";
            return Err(Violation::value(format_args!("plant.arm.limits[{i}]"), value, remedy));
        }
    }
    Ok(())
}

fn check_targets(arm: &ArmConfig) -> Result<(), Violation> {
    let [low, high] = arm.arena;
    for (i, target) in arm.targets.iter().enumerate() {
        if !target.iter().all(|value| (low..=high).contains(value)) {
            let value = format!("[{}, {}]", show(target[0]), show(target[1]));
            let remedy = format!("targets lie in plant.arm.arena, from {} to {} m on both axes", show(low), show(high));
            return Err(Violation::value(format_args!("plant.arm.targets[{i}]"), value, remedy));
        }
    }
    if arm.targets.is_empty() && reachable_share(arm) < limits::REACHABLE_SHARE {
        let value = format!("[{}, {}]", show(low), show(high));
        let remedy = "the arm can reach less than 1 % of it, so that no targets can be drawn; \
                      change arena, base or lengths, or give targets";
        return Err(Violation::value("plant.arm.arena", value, remedy));
    }
    Ok(())
}

/// The share of the arena that the end-effector can reach, counted on a grid.
///
/// Assumes joints that turn freely. The reachable points then form a ring around the base. Its outer radius is
/// the sum of the lengths. Its inner radius is the length of the longest segment minus all others, or 0.
fn reachable_share(arm: &ArmConfig) -> f64 {
    const STEPS: usize = 200;
    let longest = arm.lengths.iter().copied().fold(0.0, f64::max);
    let outer: f64 = arm.lengths.iter().sum();
    let inner = (2.0 * longest - outer).max(0.0);
    let [low, high] = arm.arena;
    let at = |i: usize| low + (high - low) * (i as f64 + 0.5) / STEPS as f64;
    let mut reached = 0;
    for i in 0..STEPS {
        for j in 0..STEPS {
            let distance = (at(i) - arm.base[0]).hypot(at(j) - arm.base[1]);
            reached += usize::from((inner..=outer).contains(&distance));
        }
    }
    reached as f64 / (STEPS * STEPS) as f64
}

fn check_blocks(arm: &ArmConfig) -> Result<(), Violation> {
    let joints = arm.lengths.len();
    for (i, block) in arm.block.iter().enumerate() {
        if !(1..=joints).contains(&block.joint) {
            let remedy = format!("the arm's joints are 1 to {joints}, counted from the base");
            return Err(Violation::value(format_args!("plant.arm.block[{i}].joint"), block.joint, remedy));
        }
        ticks(format_args!("plant.arm.block[{i}].tick"), block.tick, 0)?;
        number(format_args!("plant.arm.block[{i}].angle"), block.angle, -PI..=PI, "give -pi to pi rad")?;
        if let Some(&[low, high]) = arm.limits.get(block.joint - 1)
            && !(low..=high).contains(&block.angle)
        {
            let remedy = format!("the joint's limits are {} and {} rad", show(low), show(high));
            return Err(Violation::value(format_args!("plant.arm.block[{i}].angle"), show(block.angle), remedy));
        }
        let same = |other: &&super::BlockConfig| (other.joint, other.tick) == (block.joint, block.tick);
        if arm.block[..i].iter().any(|other| same(&other)) {
            let text = format!("blocks joint {} at tick {} once more; keep one of the two", block.joint, block.tick);
            return Err(Violation::new(format_args!("plant.arm.block[{i}]"), text));
        }
    }
    Ok(())
}

fn check_shortened(arm: &ArmConfig) -> Result<(), Violation> {
    let segments = arm.lengths.len();
    check_count("plant.arm.shorten", arm.shorten.len())?;
    for (i, change) in arm.shorten.iter().enumerate() {
        let key = |name: &str| format!("plant.arm.shorten[{i}]{name}");
        if !(1..=segments).contains(&change.segment) {
            let remedy = format!("the arm's segments are 1 to {segments}, counted from the base");
            return Err(Violation::value(key(".segment"), change.segment, remedy));
        }
        ticks(key(".tick"), change.tick, 0)?;
        number(key(".length"), change.length, limits::LENGTH, "give 0.001 to 100 m")?;
        let same = |other: &super::ShortenConfig| (other.segment, other.tick) == (change.segment, change.tick);
        if arm.shorten[..i].iter().any(same) {
            let text =
                format!("changes segment {} at tick {} once more; keep one of the two", change.segment, change.tick);
            return Err(Violation::new(key(""), text));
        }
    }
    for (i, change) in arm.shorten.iter().enumerate() {
        if arm.targets.is_empty() && reachable_share(&arm.at(change.tick)) < limits::REACHABLE_SHARE {
            let remedy = "from then on the arm can reach less than 1 % of plant.arm.arena, \
                          so that no targets can be drawn; give another length, or targets";
            return Err(Violation::value(format_args!("plant.arm.shorten[{i}].length"), show(change.length), remedy));
        }
    }
    Ok(())
}

fn check_mirrors(arm: &ArmConfig) -> Result<(), Violation> {
    check_count("plant.arm.mirror", arm.mirror.len())?;
    for (i, mirror) in arm.mirror.iter().enumerate() {
        ticks(format_args!("plant.arm.mirror[{i}].tick"), mirror.tick, 0)?;
        if arm.mirror[..i].contains(mirror) {
            let text = format!("turns the same axis at tick {} once more; keep one of the two", mirror.tick);
            return Err(Violation::new(format_args!("plant.arm.mirror[{i}]"), text));
        }
    }
    Ok(())
}

fn check_payloads(arm: &ArmConfig) -> Result<(), Violation> {
    check_count("plant.arm.payload", arm.payload.len())?;
    for (i, load) in arm.payload.iter().enumerate() {
        let key = |name: &str| format!("plant.arm.payload[{i}]{name}");
        ticks(key(".tick"), load.tick, 0)?;
        number(key(".mass"), load.mass, 0.0..=1e3, "give 0 to 1000 kg")?;
        number(key(".droop"), load.droop, 0.0..=1e3, "give 0 to 1000 rad/s per N m")?;
        if arm.payload[..i].iter().any(|other| other.tick == load.tick) {
            let text = format!("is a second load at tick {}; keep one of the two", load.tick);
            return Err(Violation::new(key(""), text));
        }
    }
    Ok(())
}

fn check_count(key: &str, n: usize) -> Result<(), Violation> {
    if n <= limits::MAX_CHANGES {
        return Ok(());
    }
    Err(Violation::new(key, format_args!("has {n} entries; give at most 64")))
}

/// Checks the resolved inputs or outputs of a plant, at most `max_len` of them.
pub(super) fn signal_list(key: &str, signals: &[SignalConfig], max_len: usize) -> Result<(), Violation> {
    if signals.is_empty() {
        let text = "is empty; a program other than tectum-simulator lists its inputs and outputs";
        return Err(Violation::new(key, text));
    }
    if signals.len() > max_len {
        let (count, first) = (signals.len(), quoted(&signals[max_len].name));
        let text = format!("has {count} entries; give at most {max_len}: a sample has no room for {first}");
        return Err(Violation::new(key, text));
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
        if signal.wraps == Some(true) && ((min + PI).abs() > 1e-6 || (max - PI).abs() > 1e-6) {
            let text = format!(
                "is true, and the range is {} to {}; an input that wraps goes from -pi to pi",
                show(min),
                show(max)
            );
            return Err(Violation::new(format_args!("{key}[{i}].wraps"), text));
        }
    }
    let names: Vec<_> = signals.iter().map(|signal| signal.name.as_str()).collect();
    unique_names(key, ".name", &names)
}

/// Checks the names of a plant's measures, and that at most one of them is the error.
pub(super) fn measures(measures: &[MeasureConfig]) -> Result<(), Violation> {
    if measures.len() > MAX_MEASURES {
        let text = format!("has {} entries; give at most {MAX_MEASURES}", measures.len());
        return Err(Violation::new("plant.measures", text));
    }
    for (i, measure) in measures.iter().enumerate() {
        signal_name(&format!("plant.measures[{i}]"), measure.name())?;
    }
    let is_error = |measure: &&MeasureConfig| measure.role() == Some(MeasureRole::Error);
    if measures.iter().filter(is_error).count() > 1 {
        return Err(Violation::new("plant.measures", "has two entries with the role error; give it to one"));
    }
    let names: Vec<_> = measures.iter().map(MeasureConfig::name).collect();
    unique_names("plant.measures", "", &names)
}
