//! `[plant.leader]`: a second chain of servos, which a user moves by hand and the servos of `[plant.servos]` follow.

use serde::{Deserialize, Serialize};
use tectum_servo::model::Protocol;

use super::error::{Violation, quoted};
use super::servos::check_joint_table;
use super::{JointConfig, PlantConfig, ServoGoal, SignalConfig};

/// `[plant.leader]`: the bus of the leader, its joints, and how their angles become those of the follower.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LeaderConfig {
    /// The serial port.
    pub port: String,
    /// The servos' protocol.
    pub protocol: Protocol,
    /// Baud rate, bit/s.
    #[serde(default = "default_baud")]
    pub baud: u32,
    /// How an angle of the leader becomes an angle of the follower.
    #[serde(default)]
    pub mapping: JointMapping,
    /// The leader's joints, in the order of the joints that follow them.
    pub joints: Vec<JointConfig>,
}

/// How an angle of the leader becomes an angle of the follower.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum JointMapping {
    /// The leader's range is stretched to the follower's: both reach the ends of their ranges together. Joints that
    /// turn freely have equal angles.
    #[default]
    Scale,
    /// Equal angles, limited to the follower's range.
    Clip,
}

fn default_baud() -> u32 {
    1_000_000
}

impl JointMapping {
    /// The angle of the joint `follower` for the angle `at`, rad, of the joint `leader`. It is within the follower's
    /// range.
    pub fn map(self, leader: &JointConfig, follower: &JointConfig, at: f64) -> f64 {
        let [low, high] = follower.range;
        let [from, to] = leader.range;
        let mapped = match self {
            Self::Scale if !leader.is_free() && !follower.is_free() => low + (at - from) * (high - low) / (to - from),
            _ => at,
        };
        mapped.clamp(low, high)
    }
}

/// The inputs of a follower: the leader's angles, as the follower is to have them, then its own.
pub(super) fn inputs(plant: &PlantConfig) -> Vec<SignalConfig> {
    let joints = following(plant);
    let signal = |prefix: &str, (i, joint): (usize, &JointConfig)| SignalConfig {
        name: format!("{prefix}{}", joint.name_at(i)),
        unit: "rad".to_owned(),
        min: joint.range[0],
        max: joint.range[1],
        wraps: None,
    };
    let of = |prefix: &'static str| joints.iter().enumerate().map(move |joint| signal(prefix, joint));
    of("leader_").chain(of("")).collect()
}

/// Names of the joints that follow.
pub(super) fn outputs(plant: &PlantConfig) -> Vec<String> {
    following(plant).iter().enumerate().map(|(i, joint)| joint.name_at(i)).collect()
}

/// The follower's joints that are not held.
fn following(plant: &PlantConfig) -> Vec<JointConfig> {
    let Some(servos) = &plant.servos else { return Vec::new() };
    servos.joints.iter().filter(|joint| !servos.held.contains(&joint.id)).cloned().collect()
}

/// Checks the plant's `[plant.leader]`, if it has one.
pub(super) fn check(plant: &PlantConfig) -> Result<(), Violation> {
    let Some(leader) = &plant.leader else { return Ok(()) };
    let Some(servos) = &plant.servos else {
        let text = "needs [plant.servos], the servos that follow it; add them, or take it out";
        return Err(Violation::new("plant.leader", text));
    };
    if servos.joints.is_empty() {
        let text = "names joints by their place, so plant.servos needs its joints in the same file: put \
                    [[plant.servos.joints]] in the place of calibration, as `tectum-bridge teleop` does";
        return Err(Violation::new("plant.leader", text));
    }
    if leader.port.trim().is_empty() || leader.port.contains('\0') || leader.port == servos.port {
        let remedy = "give the leader's own device";
        return Err(Violation::value("plant.leader.port", quoted(&leader.port), remedy));
    }
    if let Err(known) = leader.protocol.series().check_baud(leader.baud) {
        return Err(Violation::value("plant.leader.baud", leader.baud, format!("this series knows {known}")));
    }
    if leader.joints.is_empty() {
        return Err(Violation::new("plant.leader.joints", "is empty; give one for each joint that follows"));
    }
    // It is only read, so it may turn freely.
    check_joint_table("plant.leader", &leader.joints, leader.protocol, ServoGoal::Speed)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn joint(range: [f64; 2]) -> JointConfig {
        let text = format!("id = 1\nrange = [{}, {}]", range[0], range[1]);
        toml::from_str(&text).unwrap()
    }

    #[test]
    fn ranges_are_stretched_or_clipped() {
        let (leader, follower) = (joint([-1.0, 1.0]), joint([-0.5, 1.5]));
        for (mapping, at, expected) in [
            (JointMapping::Scale, -1.0, -0.5),
            (JointMapping::Scale, 0.0, 0.5),
            (JointMapping::Scale, 1.0, 1.5),
            (JointMapping::Scale, 1.2, 1.5),
            (JointMapping::Clip, 0.25, 0.25),
            (JointMapping::Clip, -0.75, -0.5),
        ] {
            let mapped = mapping.map(&leader, &follower, at);
            assert!((mapped - expected).abs() < 1e-12, "{mapping:?} {at}: {mapped}");
        }
        // A joint that turns freely has no ends to stretch.
        let free = joint([-3.15, 3.15]);
        assert_eq!(JointMapping::Scale.map(&free, &follower, 0.25), 0.25);
        assert_eq!(JointMapping::Scale.map(&free, &follower, -2.0), -0.5);
    }
}
