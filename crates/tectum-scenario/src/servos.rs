//! `[plant.servos]`: a chain of serial-bus servos in place of the simulated arm, and the checks of the table.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use tectum_servo::model::{Protocol, STEP, STEPS_PER_TURN};

use super::check::{number, show};
use super::error::{Violation, quoted};
use super::{PlantConfig, limits};

/// `[plant.servos]`: the bus, the joints on it, and the limits at which torque is switched off.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ServosConfig {
    /// The serial port, such as `/dev/ttyUSB0`. With `emulator` the bridge starts an emulated chain itself,
    /// with the settings of `[plant.emulator]`.
    pub port: String,
    /// The servos' protocol.
    pub protocol: Protocol,
    /// Baud rate, bit/s.
    #[serde(default = "default_baud")]
    pub baud: u32,
    /// The kind of goal that a rate command is converted to. Default: speeds if the servos have a watchdog,
    /// which stops them when nobody speaks to them any more, positions otherwise.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub goal: Option<ServoGoal>,
    /// Whether torque may be switched on without a request of the user (`--arm`).
    #[serde(default)]
    pub armed: bool,
    /// The file with the joints that `tectum-bridge calibrate` writes. Replaces `joints`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub calibration: Option<String>,
    /// How long after the start of a tick the bridge waits for its command, ms. Default: half a period.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub command_within_ms: Option<f64>,
    /// Ticks in a row without a response after which the bus counts as lost.
    #[serde(default = "default_lost_after")]
    pub lost_after: u32,
    /// How torque returns after the bus was lost, the cable was out, or the machine or the bridge stood still.
    #[serde(default, skip_serializing_if = "Rearm::is_automatic")]
    pub rearm: Rearm,
    /// Time for which a port that is gone is looked for before the bridge ends, s. Default: 10.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reopen_within_s: Option<f64>,
    /// Highest allowed temperature, degrees Celsius.
    #[serde(default = "default_max_temperature")]
    pub max_temperature: f64,
    /// Lowest allowed voltage, V; 0: no limit.
    #[serde(default)]
    pub min_voltage: f64,
    /// The source of target and end-effector positions.
    #[serde(default, skip_serializing_if = "PoseSource::is_model")]
    pub sight: PoseSource,
    /// With `sight = "vision"`: maximum age of the newest sample when a tick begins, ms. Default: 100.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub vision_age_ms: Option<f64>,
    /// With `sight = "vision"`: a target that is further than this, m, from the last new target counts as a new
    /// one. Default: 0.05.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub vision_jump: Option<f64>,
    /// Ids of joints that no command moves: they are held where they stand when torque comes on, as a gripper is.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub held: Vec<u8>,
    /// The joints, from the base on: one per joint of the model, or of the leader, and those that are held.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub joints: Vec<JointConfig>,
}

/// `[[plant.servos.joints]]`: one motor, which turns a segment relative to the one before it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct JointConfig {
    /// The servo's id on the bus.
    pub id: u8,
    /// The joint's name. A leader's joint moves the follower's joint of the same name.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub name: Option<String>,
    /// 1 if positions increase with the angle, -1 if they decrease.
    #[serde(default = "default_direction")]
    pub direction: i32,
    /// Position at angle 0, steps.
    #[serde(default = "default_zero")]
    pub zero: i32,
    /// Least and greatest angle, rad.
    #[serde(default = "default_range")]
    pub range: [f64; 2],
    /// Highest speed, rad/s.
    #[serde(default = "default_max_speed")]
    pub max_speed: f64,
    /// The servo's registers that change what positions mean or how goals are followed, by name, as they were
    /// when it was calibrated. One that is not named must have the value that changes nothing.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub registers: BTreeMap<String, i32>,
}

/// The kind of goal that a rate command is converted to.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ServoGoal {
    /// A goal speed. The servo keeps it until it receives another goal, or until its watchdog stops it.
    Speed,
    /// A goal position, one tick's travel ahead. The servo stops there by itself.
    Position,
}

/// How torque returns after the connection was lost and is there again.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Rearm {
    /// By itself, after all checks.
    #[default]
    Automatic,
    /// When the user arms it again.
    ByHand,
}

impl Rearm {
    /// Whether torque returns by itself.
    pub fn is_automatic(&self) -> bool {
        *self == Self::Automatic
    }
}

/// The source of target and end-effector positions.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum PoseSource {
    /// Targets are drawn as in the simulator. The end-effector is computed by the model of the arm.
    #[default]
    Model,
    /// Trackers, which publish both on the channel `vision`.
    Vision,
}

impl PoseSource {
    /// Whether the source is the model.
    pub fn is_model(&self) -> bool {
        *self == Self::Model
    }
}

impl ServosConfig {
    /// The kind of goal that a rate command is converted to.
    pub fn goal(&self) -> ServoGoal {
        let watched = self.protocol.series().bus_watchdog.is_some();
        self.goal.unwrap_or(if watched { ServoGoal::Speed } else { ServoGoal::Position })
    }

    /// Time for which a port that is gone is looked for, ns.
    pub fn reopen_within_ns(&self) -> u64 {
        (self.reopen_within_s.unwrap_or(10.0) * 1e9) as u64
    }

    /// Maximum age of a tracker's newest sample when a tick begins, ns.
    pub fn vision_age_ns(&self) -> u64 {
        (self.vision_age_ms.unwrap_or(100.0) * 1e6) as u64
    }

    /// The joints that commands move, in their order, and behind them those that are held.
    pub fn moving_first(&self, joints: &[JointConfig]) -> Vec<JointConfig> {
        let (held, moving): (Vec<_>, Vec<_>) = joints.iter().cloned().partition(|joint| self.held.contains(&joint.id));
        [moving, held].concat()
    }

    /// Distance from the last new target, m, beyond which a target counts as a new one.
    pub fn vision_jump(&self) -> f32 {
        self.vision_jump.unwrap_or(0.05) as f32
    }
}

fn default_baud() -> u32 {
    1_000_000
}

fn default_lost_after() -> u32 {
    3
}

fn default_max_temperature() -> f64 {
    65.0
}

fn default_direction() -> i32 {
    1
}

fn default_zero() -> i32 {
    2048
}

fn default_range() -> [f64; 2] {
    [-std::f64::consts::PI, std::f64::consts::PI]
}

fn default_max_speed() -> f64 {
    6.0
}

impl JointConfig {
    /// Its name; joint `place` (counted from 0) of an arm without names is `joint_1`, `joint_2` and so on.
    pub fn name_at(&self, place: usize) -> String {
        self.name.clone().unwrap_or_else(|| format!("joint_{}", place + 1))
    }

    /// Whether the joint turns freely: its range is a full turn or more.
    pub fn is_free(&self) -> bool {
        self.range[1] - self.range[0] >= std::f64::consts::TAU - 1e-9
    }

    /// The ends of the range as positions of the servo, steps, the lower one first; `None` for a joint that
    /// turns freely. A valid joint has both within 0 to 4095: the encoder begins again at its 0, so a servo
    /// that is sent across it turns the long way round, through the ends of the joint.
    pub fn raw_ends(&self) -> Option<[i32; 2]> {
        // The part of a step that rounding has lost is no step.
        let steps = |angle: f64| (angle / STEP + 1e-6_f64.copysign(angle)) as i32;
        let [a, b] = self.range.map(|end| self.zero + steps(f64::from(self.direction) * end));
        (!self.is_free()).then_some([a.min(b), a.max(b)])
    }

    /// Checks that the range does not lie across the encoder's 0.
    ///
    /// # Errors
    /// The raw ends and the remedy, for a message.
    pub fn check_seam(&self) -> Result<(), String> {
        match self.raw_ends() {
            Some([low, high]) if low < 0 || high >= STEPS_PER_TURN => Err(format!(
                "the servo would go from {low} to {high} steps, across the 0 of its encoder (0 to 4095), and it \
                 would turn the long way round; calibrate the joint again: `tectum-bridge calibrate` offers to write \
                 a homing offset that puts the 0 outside the range"
            )),
            _ => Ok(()),
        }
    }
}

impl PlantConfig {
    /// Whether its servos can be emulated in virtual time: nothing else of the plant is outside the run.
    pub fn has_virtual_servos(&self) -> bool {
        let emulated = |servos: &ServosConfig| servos.port == "emulator" && servos.sight.is_model();
        self.servos.as_ref().is_some_and(emulated) && self.leader.is_none()
    }
}

/// Checks the plant's `[plant.servos]`, if it has one.
pub(super) fn check(plant: &PlantConfig, period_ms: f64) -> Result<(), Violation> {
    let Some(servos) = &plant.servos else { return Ok(()) };
    if crate::programs::is_simulator(&plant.program) {
        let text = "belongs to tectum-bridge and plant.program is the simulator; take it out, or give tectum-bridge";
        return Err(Violation::new("plant.servos", text));
    }
    driven_joints(plant)?;
    if let Some(arm) = &plant.arm
        && (arm.open_loop || !arm.block.is_empty())
    {
        let key = if arm.open_loop { "plant.arm.open_loop" } else { "plant.arm.block" };
        return Err(Violation::new(key, "is the simulator's, and servos cannot do it; take it out"));
    }
    if servos.port.trim().is_empty() || servos.port.contains('\0') {
        return Err(Violation::value("plant.servos.port", quoted(&servos.port), "give a device, or \"emulator\""));
    }
    if let Err(known) = servos.protocol.series().check_baud(servos.baud) {
        return Err(Violation::value("plant.servos.baud", servos.baud, format!("this series knows {known}")));
    }
    if let Some(within) = servos.command_within_ms {
        let remedy = "give more than 0 ms and at most 0.8 of the period, so that there is time for the bus";
        number("plant.servos.command_within_ms", within, 0.1..=0.8 * period_ms, remedy)?;
    }
    if !(1..=1000).contains(&servos.lost_after) {
        return Err(Violation::value("plant.servos.lost_after", servos.lost_after, "give 1 to 1000 ticks"));
    }
    if let Some(within) = servos.reopen_within_s {
        number("plant.servos.reopen_within_s", within, 0.0..=3600.0, "give 0 to 3600 s")?;
    }
    number("plant.servos.max_temperature", servos.max_temperature, 20.0..=100.0, "give 20 to 100 degrees")?;
    number("plant.servos.min_voltage", servos.min_voltage, 0.0..=50.0, "give 0 to 50 V")?;
    check_sight(servos, plant)?;
    match (&servos.calibration, servos.joints.is_empty()) {
        (None, true) => {
            let text = "has neither joints nor a calibration; add [[plant.servos.joints]], \
                        or the file that `tectum-bridge calibrate` writes";
            Err(Violation::new("plant.servos", text))
        }
        (Some(_), false) => {
            Err(Violation::new("plant.servos.calibration", "stands beside plant.servos.joints; keep one of the two"))
        }
        (Some(_), true) => Ok(()),
        (None, false) => check_chain(&servos.joints, plant, servos),
    }
}

/// The number of joints that commands move: those of the model of the arm, or of the leader.
pub(super) fn driven_joints(plant: &PlantConfig) -> Result<usize, Violation> {
    let given = [
        ("plant.arm", plant.arm.as_ref().map(|arm| arm.lengths.len())),
        ("plant.so101", plant.body().filter(|_| plant.so101.is_some()).map(|body| body.signals().outputs.len())),
        ("plant.leader", plant.leader.as_ref().map(|leader| leader.joints.len())),
    ];
    let mut given = given.into_iter().filter_map(|(key, joints)| Some((key, joints?)));
    match (given.next(), given.next()) {
        (Some((_, joints)), None) => Ok(joints),
        (Some((first, _)), Some((second, _))) => {
            Err(Violation::new(second, format_args!("stands beside {first}; keep one of the two")))
        }
        (None, _) => {
            let text = "needs [plant.arm] or [plant.so101], the model of the arm that its servos move, or \
                        [plant.leader], the arm that they follow; add one of them";
            Err(Violation::new("plant.servos", text))
        }
    }
}

/// Checks the keys that belong to the source of positions.
fn check_sight(servos: &ServosConfig, plant: &PlantConfig) -> Result<(), Violation> {
    if servos.sight.is_model() {
        let vision_keys = [("vision_age_ms", servos.vision_age_ms), ("vision_jump", servos.vision_jump)];
        return match vision_keys.iter().find(|(_, value)| value.is_some()) {
            Some((key, _)) => {
                let text = "applies only to samples of a tracker, and plant.servos.sight is \"model\"; \
                            take it out, or give sight = \"vision\"";
                Err(Violation::new(format_args!("plant.servos.{key}"), text))
            }
            None => Ok(()),
        };
    }
    let Some(arm) = &plant.arm else {
        let text = "is \"vision\", and trackers report positions in a plane, which only [plant.arm] has; leave it out";
        return Err(Violation::new("plant.servos.sight", text));
    };
    if let Some(age) = servos.vision_age_ms {
        number("plant.servos.vision_age_ms", age, 1.0..=10_000.0, "give 1 to 10000 ms")?;
    }
    if let Some(jump) = servos.vision_jump {
        number("plant.servos.vision_jump", jump, limits::LENGTH, "give 0.001 to 100 m")?;
    }
    if !arm.targets.is_empty() {
        let text = "are given, and with plant.servos.sight = \"vision\" a tracker reports the target; \
                    take one of the two out";
        return Err(Violation::new("plant.arm.targets", text));
    }
    Ok(())
}

/// Checks the joints of the chain that is driven, from a scenario or from a calibration.
fn check_chain(joints: &[JointConfig], plant: &PlantConfig, servos: &ServosConfig) -> Result<(), Violation> {
    if let Some(id) = servos.held.iter().find(|&&id| !joints.iter().any(|joint| joint.id == id)) {
        return Err(Violation::value("plant.servos.held", id, "no joint has this id; give ids of joints"));
    }
    let (driven, moving) = (driven_joints(plant)?, joints.len() - held_joints(joints, servos));
    if moving != driven {
        let text = format!(
            "has {moving} entries that are not held, and {driven} joints are driven; give one for each, and name those \
             that only keep their position in plant.servos.held"
        );
        return Err(Violation::new("plant.servos.joints", text));
    }
    if joints.len() > limits::MAX_OUTPUTS {
        let text = format!("has {} entries; give at most {}", joints.len(), limits::MAX_OUTPUTS);
        return Err(Violation::new("plant.servos.joints", text));
    }
    check_joint_table("plant.servos", joints, servos.protocol, servos.goal())
}

/// The number of joints that are held.
fn held_joints(joints: &[JointConfig], servos: &ServosConfig) -> usize {
    joints.iter().filter(|joint| servos.held.contains(&joint.id)).count()
}

/// Checks a table of joints under `table`.
pub(super) fn check_joint_table(
    table: &str,
    joints: &[JointConfig],
    protocol: Protocol,
    goal: ServoGoal,
) -> Result<(), Violation> {
    for (i, joint) in joints.iter().enumerate() {
        let key = |name: &str| format!("{table}.joints[{i}].{name}");
        let max_id = protocol.series().max_id;
        if joint.id > max_id {
            return Err(Violation::value(key("id"), joint.id, format!("give 0 to {max_id}")));
        }
        if joints[..i].iter().any(|other| other.id == joint.id) {
            return Err(Violation::value(key("id"), joint.id, "another joint has it already; each servo has its own"));
        }
        if joint.direction.abs() != 1 {
            return Err(Violation::value(key("direction"), joint.direction, "give 1 or -1"));
        }
        if !(0..4096).contains(&joint.zero) {
            return Err(Violation::value(key("zero"), joint.zero, "give 0 to 4095 steps"));
        }
        let [low, high] = joint.range;
        let turn = -limits::LIMITED_TURN..=limits::LIMITED_TURN;
        if !(turn.contains(&low) && turn.contains(&high) && low < high && (low..=high).contains(&0.0)) {
            let value = format!("[{}, {}]", show(low), show(high));
            let remedy = "give the least and then the greatest angle, rad, with 0 between them";
            return Err(Violation::value(key("range"), value, remedy));
        }
        if goal == ServoGoal::Position && joint.is_free() {
            let value = format!("[{}, {}]", show(low), show(high));
            let remedy = "with goal = \"position\", the default of servos without a watchdog, a joint has less than a \
                          full turn; give its range";
            return Err(Violation::value(key("range"), value, remedy));
        }
        if let Err(text) = joint.check_seam() {
            return Err(Violation::value(key("range"), format!("[{}, {}]", show(low), show(high)), text));
        }
        let names = || protocol.series().kept.iter().map(|kept| kept.name);
        if let Some(unknown) = joint.registers.keys().find(|name| !names().any(|known| known == name.as_str())) {
            let remedy = format!("this series has {}", names().collect::<Vec<_>>().join(", "));
            return Err(Violation::value(key("registers"), quoted(unknown), remedy));
        }
        number(key("max_speed"), joint.max_speed, 0.01..=100.0, "give 0.01 to 100 rad/s")?;
    }
    Ok(())
}

/// Checks the joints of a calibration against the arm of `plant`.
///
/// # Errors
/// The first problem, as one sentence with the key, as for the joints of a scenario.
pub fn check_joints(table: &[JointConfig], plant: &PlantConfig) -> Result<(), String> {
    let Some(servos) = &plant.servos else { return Ok(()) };
    check_chain(table, plant, servos).map_err(|problem| format!("{} {}", problem.key, problem.text))
}

#[cfg(test)]
mod tests {
    use crate::{Scenario, ScenarioError};

    fn plan(change: impl FnOnce(String) -> String) -> Result<crate::Plan, ScenarioError> {
        Scenario::parse(&change(include_str!("../scenarios/servo-vision.toml").to_owned()), "vision.toml")?.plan()
    }

    #[test]
    fn vision_keys_are_refused_without_vision() {
        let valid = plan(|text| text).unwrap();
        assert_eq!(valid.scenario.vision(), Some("vision"));
        assert_eq!(valid.measures.last().map(String::as_str), Some("vision_age_ms"));
        let model = |text: String| text.replace("sight = \"vision\"", "sight = \"model\"");
        let without_vision = |text: String| model(text).replace("vision_age_ms =", "# ").replace("vision_jump =", "# ");
        let with_channel = |text: String| text + "\n[channels]\nvision = \"eye\"\n";
        assert_eq!(plan(with_channel).unwrap().scenario.vision(), Some("eye"));
        for (message, change) in [
            ("plant.servos.vision_age_ms applies only to samples of a tracker", &model as &dyn Fn(String) -> String),
            ("plant.servos.vision_jump applies only", &|text| model(text).replace("vision_age_ms =", "# ")),
            ("plant.servos.vision_age_ms is 0", &|text| text.replace("vision_age_ms = 100.0", "vision_age_ms = 0.0")),
            ("plant.servos.vision_jump is 0", &|text| text.replace("vision_jump = 0.05", "vision_jump = 0.0")),
            ("channels.vision names a channel that exists only with", &|text| with_channel(without_vision(text))),
            ("are both \"command\"", &|text| text + "\n[channels]\nvision = \"command\"\n"),
            ("plant.arm.targets are given", &|text| {
                text.replace("[plant.arm]  ", "[plant.arm]\ntargets = [[0.0, 0.0]]\n#")
            }),
        ] {
            let error = plan(change).unwrap_err().to_string();
            assert!(error.contains(message) && error.starts_with("vision.toml"), "{error}");
        }
    }

    /// A range across the encoder's 0 is refused, for each kind of goal, with the remedy.
    #[test]
    fn a_range_across_the_encoders_zero_is_refused() {
        let with = |joint: &str| {
            let text = include_str!("../scenarios/servo-emulated.toml").replace("max_speed = 12.0", joint);
            Scenario::parse(&text, "arm.toml")?.plan()
        };
        for (joint, fits) in [
            ("zero = 100\nrange = [-1.0, 1.0]", false),
            ("zero = 4000\nrange = [-1.0, 1.0]", false),
            ("zero = 4000\ndirection = -1\nrange = [-0.1, 1.0]", true),
            ("zero = 700\nrange = [-1.0, 1.0]", true),
            ("zero = 100", true),
        ] {
            let result = with(joint).map_err(|error| error.to_string());
            assert_eq!(result.is_ok(), fits, "{joint}: {result:?}");
            if let Err(error) = result {
                assert!(error.contains("across the 0 of its encoder") && error.contains("calibrate"), "{error}");
            }
        }
    }

    /// The keys of trackers are left out where they have their defaults, so that scenarios from before trackers
    /// existed keep their hash.
    #[test]
    fn scenarios_without_a_tracker_have_no_tracker_keys() {
        let emulated = Scenario::built_in("servo-emulated").unwrap().plan().unwrap();
        let text = emulated.scenario.to_toml();
        assert!(!text.contains("vision") && !text.contains("sight"), "{text}");
        assert_eq!(emulated.scenario.vision(), None);
    }
}
