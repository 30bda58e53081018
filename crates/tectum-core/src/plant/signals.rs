//! The inputs, outputs and measures of each simulated plant, in the order in which samples carry them.

use std::f64::consts::PI;

use super::{
    ArmConfig, BodyConfig, EyeConfig, MirrorAxis, Retina, So101Config, cart_pole, pendulum, point_mass, reacher, so101,
};
use crate::SignalConfig;

/// The signals of a plant.
#[derive(Debug, Clone, PartialEq)]
pub struct BodySignals {
    /// The inputs.
    pub inputs: Vec<SignalConfig>,
    /// So many of them, the first ones, come from a camera.
    pub seen: usize,
    /// So many of them, the last ones, are what the commands move: the joint angles. 0 where the plant does not say.
    pub moved: usize,
    /// Names of the outputs. A command of 1 is the unit of each.
    pub outputs: Vec<String>,
    /// Names of the measures.
    pub measures: Vec<String>,
}

impl BodyConfig {
    /// The plant's signals.
    pub fn signals(&self) -> BodySignals {
        match self {
            Self::Arm(arm) => of_arm(arm),
            Self::Eye(eye) => of_eye(eye),
            Self::Pendulum(_) => signals(
                0,
                vec![
                    signal("theta", "rad", [-PI, PI]),
                    signal("omega", "rad/s", [-pendulum::MAX_SPEED, pendulum::MAX_SPEED]),
                ],
                &["torque"],
                &["error"],
            ),
            Self::CartPole(_) => signals(
                0,
                vec![
                    signal("x", "m", [-cart_pole::RAIL, cart_pole::RAIL]),
                    signal("theta", "rad", [-PI, PI]),
                    signal("v", "m/s", [-10.0, 10.0]),
                    signal("omega", "rad/s", [-15.0, 15.0]),
                ],
                &["force"],
                &["error", "x"],
            ),
            Self::Reacher(_) => of_reacher(),
            Self::Furuta(_) => signals(
                0,
                vec![
                    signal("theta", "rad", [-PI, PI]),
                    signal("alpha", "rad", [-PI, PI]),
                    signal("theta_rate", "rad/s", [-30.0, 30.0]),
                    signal("alpha_rate", "rad/s", [-30.0, 30.0]),
                ],
                &["voltage"],
                &["error", "theta"],
            ),
            Self::PointMass(_) => of_point_mass(),
            Self::So101(so101) => of_so101(so101),
        }
    }
}

fn of_arm(arm: &ArmConfig) -> BodySignals {
    let joints = 1..=arm.lengths.len();
    let [low, high] = arm.arena;
    // A mirrored coordinate lies in the arena's mirror image.
    let range = |axis| {
        let mirrored = arm.mirror.iter().any(|m| m.axis == axis);
        if mirrored { [low.min(-high), high.max(-low)] } else { arm.arena }
    };
    let mut inputs = vec![signal("target_x", "m", range(MirrorAxis::X)), signal("target_y", "m", range(MirrorAxis::Y))];
    if !arm.open_loop {
        let known = if arm.hidden_limits { &[][..] } else { &arm.limits };
        let range = |joint: usize| known.get(joint - 1).copied().unwrap_or([-PI, PI]);
        inputs.extend(joints.clone().map(|joint| signal(&format!("theta_{joint}"), "rad", range(joint))));
    }
    let quantity = if arm.open_loop { "angle" } else { "rate" };
    let moved = if arm.open_loop { 0 } else { arm.lengths.len() };
    let outputs: Vec<_> = joints.map(|joint| format!("{quantity}_{joint}")).collect();
    let mut measures = ["error", "end_x", "end_y"].map(String::from).to_vec();
    if arm.reward.collision > 0.0 {
        measures.push("crossings".to_owned());
    }
    BodySignals { inputs, seen: 2, moved, outputs, measures }
}

/// Standard deviations beyond which a target of the eye does not appear in any run.
const FARTHEST: f64 = 8.0;

/// Targets are drawn from a normal distribution, and are seen beyond the retina's edge, which is at 1.
fn of_eye(eye: &EyeConfig) -> BodySignals {
    let far = FARTHEST * eye.spread;
    let eccentric = libm::log1p(eye.distortion * far) / libm::log1p(eye.distortion);
    let inputs = match eye.retina {
        Retina::Linear => vec![
            signal("position_x", "1", [-far, far]),
            signal("position_y", "1", [-far, far]),
            signal("velocity_x", "1/s", [-far, far]),
            signal("velocity_y", "1/s", [-far, far]),
        ],
        // The radius of a velocity is a logarithm and therefore has no unit.
        Retina::LogPolar => vec![
            signal("position_rho", "1", [0.0, eccentric]),
            signal("position_phi", "rad", [-PI, PI]),
            signal("velocity_rho", "1", [0.0, eccentric]),
            signal("velocity_phi", "rad", [-PI, PI]),
        ],
    };
    signals(4, inputs, &["up", "down", "left", "right"], &["error"])
}

fn of_reacher() -> BodySignals {
    let (reach, stop) = (reacher::REACH, reacher::STOP);
    let inputs = vec![
        signal("target_x", "m", [-reach, reach]),
        signal("target_y", "m", [-reach, reach]),
        signal("theta_1", "rad", [-PI, PI]),
        signal("theta_2", "rad", [-stop, stop]),
        signal("omega_1", "rad/s", [-50.0, 50.0]),
        signal("omega_2", "rad/s", [-50.0, 50.0]),
        signal("from_target_x", "m", [-0.4, 0.4]),
        signal("from_target_y", "m", [-0.4, 0.4]),
    ];
    signals(2, inputs, &["torque_1", "torque_2"], &["error", "end_x", "end_y"])
}

fn of_point_mass() -> BodySignals {
    let (arena, wall) = (point_mass::ARENA, point_mass::WALL);
    let inputs = vec![
        signal("target_x", "m", [-arena, arena]),
        signal("target_y", "m", [-arena, arena]),
        signal("x", "m", [-wall, wall]),
        signal("y", "m", [-wall, wall]),
        signal("v_x", "m/s", [-5.0, 5.0]),
        signal("v_y", "m/s", [-5.0, 5.0]),
    ];
    signals(2, inputs, &["force_x", "force_y"], &["error", "x", "y"])
}

fn of_so101(so101: &So101Config) -> BodySignals {
    let reach = [-so101::REACH, so101::REACH];
    let target: &[&str] = if so101.planar { &["target_x", "target_z"] } else { &["target_x", "target_y", "target_z"] };
    let mut inputs: Vec<_> = target.iter().map(|name| signal(name, "m", reach)).collect();
    let moving = so101.moving();
    inputs.extend(moving.iter().map(|&joint| signal(so101::NAMES[joint], "rad", so101::LIMITS[joint])));
    let names = so101.names();
    BodySignals { moved: moving.len(), ..signals(target.len(), inputs, &names, &["error", "end_x", "end_y", "end_z"]) }
}

fn signals(seen: usize, inputs: Vec<SignalConfig>, outputs: &[&str], measures: &[&str]) -> BodySignals {
    let owned = |names: &[&str]| names.iter().map(|&name| name.to_owned()).collect();
    BodySignals { inputs, seen, moved: 0, outputs: owned(outputs), measures: owned(measures) }
}

fn signal(name: &str, unit: &str, [min, max]: [f64; 2]) -> SignalConfig {
    SignalConfig { name: name.to_owned(), unit: unit.to_owned(), min, max, wraps: None }
}
