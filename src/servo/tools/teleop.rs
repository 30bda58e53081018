//! The scenario of a teleoperation: an arm that follows another one, joint by joint of the same name.

use serde::Serialize;

use super::Calibration;
use crate::scenario::{JointConfig, JointMapping, Rearm};
use crate::servo::model::Protocol;

/// One of the two arms of a teleoperation.
#[derive(Debug, Clone)]
pub struct TeleopArm {
    /// Its serial port.
    pub port: String,
    /// Baud rate, bit/s.
    pub baud: u32,
    /// Its joints.
    pub calibration: Calibration,
}

/// What a teleoperation does.
#[derive(Debug, Clone)]
pub struct Teleop {
    /// The arm that a user moves.
    pub leader: TeleopArm,
    /// The arm that follows.
    pub follower: TeleopArm,
    /// How angles are mapped.
    pub mapping: JointMapping,
    /// Ids of the follower's joints that are held.
    pub held: Vec<u8>,
    /// Highest speed of a joint, rad/s; that of the calibration counts if it is lower.
    pub max_speed: f64,
    /// Highest speed until the follower has met the leader, rad/s.
    pub approach_speed: f64,
    /// Length of a tick, ms.
    pub period_ms: f64,
    /// Number of ticks.
    pub ticks: u64,
    /// How torque returns after a loss.
    pub rearm: Rearm,
    /// Whether torque may come on.
    pub armed: bool,
}

/// The tables of the scenario, in the order in which they are written.
#[derive(Serialize)]
struct TeleopScenario<'a> {
    name: &'static str,
    period_ms: f64,
    ticks: u64,
    plant: TeleopPlant<'a>,
    controller: Program,
    learner: TeleopLearner,
    gate: TeleopGate,
}

#[derive(Serialize)]
struct Program {
    program: &'static str,
}

#[derive(Serialize)]
struct TeleopLearner {
    rule: &'static str,
    approach_speed: f64,
}

#[derive(Serialize)]
struct TeleopGate {
    max_command: f64,
    hold_ticks: u32,
    decay_ticks: u32,
    ramp_ticks: u32,
}

#[derive(Serialize)]
struct TeleopPlant<'a> {
    program: &'static str,
    servos: FollowerChain<'a>,
    leader: LeaderChain<'a>,
}

#[derive(Serialize)]
struct FollowerChain<'a> {
    port: &'a str,
    protocol: Protocol,
    baud: u32,
    goal: &'static str,
    armed: bool,
    rearm: Rearm,
    held: &'a [u8],
    joints: Vec<JointConfig>,
}

#[derive(Serialize)]
struct LeaderChain<'a> {
    port: &'a str,
    protocol: Protocol,
    baud: u32,
    mapping: JointMapping,
    joints: Vec<JointConfig>,
}

/// Finds the leader's joint for each of the follower's that is not held, by its name. Returns the leader's joints in
/// the order of the follower's, and the names of those that move nothing.
///
/// # Errors
/// When a joint has no leader, or two joints of an arm have one name.
pub fn pair_joints(
    leader: &Calibration,
    follower: &Calibration,
    held: &[u8],
) -> Result<(Vec<JointConfig>, Vec<String>), String> {
    let names = |arm: &Calibration| -> Vec<String> {
        arm.joints.iter().enumerate().map(|(place, joint)| joint.name_at(place)).collect()
    };
    let (leaders, followers) = (names(leader), names(follower));
    for (what, names) in [("leader", &leaders), ("follower", &followers)] {
        if let Some((_, twice)) = names.iter().enumerate().find(|(i, name)| names[..*i].contains(name)) {
            return Err(format!("the {what} has two joints called {twice}; give each a name of its own"));
        }
    }
    if let Some(id) = held.iter().find(|&&id| !follower.joints.iter().any(|joint| joint.id == id)) {
        return Err(format!("--hold {id}: the follower has no servo {id}"));
    }
    let mut paired = Vec::new();
    for (joint, name) in follower.joints.iter().zip(&followers).filter(|(joint, _)| !held.contains(&joint.id)) {
        let Some(place) = leaders.iter().position(|leader| leader == name) else {
            return Err(format!(
                "the follower's joint {name} has no joint of that name at the leader, which has {}; give both the same \
                 name in their calibrations (`name = \"...\"`), or hold it with --hold {}",
                leaders.join(", "),
                joint.id
            ));
        };
        paired.push(leader.joints[place].clone());
    }
    let used: Vec<u8> = paired.iter().map(|joint: &JointConfig| joint.id).collect();
    let idle = leader.joints.iter().zip(leaders).filter(|(joint, _)| !used.contains(&joint.id));
    let idle = idle.map(|(_, name)| name).collect();
    Ok((paired, idle))
}

/// The scenario of a teleoperation, as TOML, and the names of the leader's joints that move nothing.
///
/// # Errors
/// When the joints of the two arms do not fit together.
pub fn teleop_scenario(teleop: &Teleop) -> Result<(String, Vec<String>), String> {
    let Teleop { leader, follower, held, max_speed, .. } = teleop;
    let (leaders, idle) = pair_joints(&leader.calibration, &follower.calibration, held)?;
    let mut joints = follower.calibration.joints.clone();
    for (place, joint) in joints.iter_mut().enumerate() {
        (joint.name, joint.max_speed) = (Some(joint.name_at(place)), joint.max_speed.min(*max_speed));
    }
    let ticks_of = |seconds: f64| (seconds * 1000.0 / teleop.period_ms).ceil().clamp(1.0, 1e6) as u32;
    let scenario = TeleopScenario {
        name: "teleop",
        period_ms: teleop.period_ms,
        ticks: teleop.ticks,
        plant: TeleopPlant {
            program: "tectum-bridge",
            servos: FollowerChain {
                port: &follower.port,
                protocol: follower.calibration.protocol,
                baud: follower.baud,
                // A servo then stops by itself, one tick's travel ahead.
                goal: "position",
                armed: teleop.armed,
                rearm: teleop.rearm,
                held,
                joints,
            },
            leader: LeaderChain {
                port: &leader.port,
                protocol: leader.calibration.protocol,
                baud: leader.baud,
                mapping: teleop.mapping,
                joints: leaders,
            },
        },
        controller: Program { program: "tectum-follower" },
        learner: TeleopLearner { rule: "follower", approach_speed: teleop.approach_speed },
        gate: TeleopGate {
            max_command: *max_speed,
            hold_ticks: 2,
            decay_ticks: ticks_of(0.2),
            ramp_ticks: ticks_of(0.5),
        },
    };
    let text = toml::to_string(&scenario).map_err(|error| error.to_string())?;
    Ok((text, idle))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scenario::Scenario;

    fn arm(names: &[&str], first_id: u8, range: [f64; 2]) -> Calibration {
        let joint = |(i, name): (usize, &&str)| JointConfig {
            id: first_id + i as u8,
            name: (!name.is_empty()).then(|| (*name).to_owned()),
            direction: 1,
            zero: 2048,
            range,
            max_speed: 6.0,
            registers: Default::default(),
        };
        Calibration { protocol: Protocol::Feetech, joints: names.iter().enumerate().map(joint).collect() }
    }

    #[test]
    fn joints_are_paired_by_name() {
        let leader = arm(&["pan", "lift", "trigger"], 1, [-1.0, 1.0]);
        let follower = arm(&["lift", "pan", "gripper"], 4, [-1.5, 1.5]);
        let error = pair_joints(&leader, &follower, &[]).unwrap_err();
        assert!(error.contains("gripper") && error.contains("pan, lift, trigger") && error.contains("--hold 6"));
        let (paired, idle) = pair_joints(&leader, &follower, &[6]).unwrap();
        assert_eq!(paired.iter().map(|joint| joint.id).collect::<Vec<_>>(), [2, 1]);
        assert_eq!(idle, ["trigger"]);
        // Without names, joints are called by their place.
        let (paired, idle) =
            pair_joints(&arm(&["", ""], 1, [-1.0, 1.0]), &arm(&["", ""], 1, [-1.0, 1.0]), &[]).unwrap();
        assert_eq!((paired[1].id, idle.len()), (2, 0));
        assert!(pair_joints(&arm(&["a", "a"], 1, [-1.0, 1.0]), &follower, &[]).unwrap_err().contains("two joints"));
        assert!(pair_joints(&leader, &follower, &[9]).unwrap_err().contains("no servo 9"));
    }

    #[test]
    fn the_scenario_is_valid() {
        let side = |port: &str, calibration| TeleopArm { port: port.to_owned(), baud: 1_000_000, calibration };
        let teleop = Teleop {
            leader: side("/dev/a", arm(&["pan", "lift"], 1, [-1.0, 1.0])),
            follower: side("/dev/b", arm(&["lift", "pan", "gripper"], 4, [-1.5, 1.5])),
            mapping: JointMapping::Scale,
            held: vec![6],
            max_speed: 3.0,
            approach_speed: 0.5,
            period_ms: 20.0,
            ticks: 100,
            rearm: Rearm::Automatic,
            armed: true,
        };
        let (text, _) = teleop_scenario(&teleop).unwrap();
        let plan = Scenario::parse(&text, "teleop.toml").unwrap().plan().unwrap();
        let names = |signals: &[crate::scenario::SignalConfig]| -> Vec<String> {
            signals.iter().map(|signal| signal.name.clone()).collect()
        };
        assert_eq!(names(&plan.inputs), ["leader_lift", "leader_pan", "lift", "pan"]);
        assert_eq!(names(&plan.outputs), ["lift", "pan"]);
        assert_eq!(plan.measures, ["error", "bus_read_us", "bus_write_us", "leader_read_us"]);
        let same = Teleop { follower: side("/dev/a", teleop.follower.calibration.clone()), ..teleop };
        let text = teleop_scenario(&same).unwrap().0;
        let error = Scenario::parse(&text, "teleop.toml").unwrap().plan().unwrap_err().to_string();
        assert!(error.contains("plant.leader.port"), "{error}");
    }
}
