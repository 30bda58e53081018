//! The inputs, outputs and measures of a scenario's plant: those that the file lists, or else those of arm or
//! eye.

use std::f64::consts::PI;

use super::{ArmConfig, EyeConfig, MeasureConfig, MirrorAxis, PerOutput, Retina, Scenario, SignalConfig};
use crate::wire::MAX_MEASURES;

/// The signals of a plant, in the order in which samples carry them.
pub(super) struct PlantSignals {
    pub(super) inputs: Vec<SignalConfig>,
    pub(super) outputs: Vec<SignalConfig>,
    pub(super) measures: Vec<MeasureConfig>,
}

/// The signals that the scenario lists. For a list that it leaves out, those of its arm or eye; without arm and
/// eye the list is empty.
pub(super) fn signals(scenario: &Scenario) -> PlantSignals {
    let plant = &scenario.plant;
    let mut defaults = match (&plant.arm, &plant.eye) {
        (Some(arm), _) => of_arm(arm, &scenario.gate.max_command),
        (None, Some(eye)) => of_eye(eye, &scenario.gate.max_command),
        (None, None) => PlantSignals { inputs: Vec::new(), outputs: Vec::new(), measures: Vec::new() },
    };
    if plant.servos.is_some() {
        defaults.measures.extend(["bus_read_us", "bus_write_us"].map(MeasureConfig::from));
    }
    if plant.servos.as_ref().is_some_and(|servos| !servos.sight.is_model()) && defaults.measures.len() < MAX_MEASURES {
        defaults.measures.push("vision_age_ms".into());
    }
    PlantSignals {
        inputs: if plant.inputs.is_empty() { defaults.inputs } else { plant.inputs.clone() },
        outputs: if plant.outputs.is_empty() { defaults.outputs } else { plant.outputs.clone() },
        measures: if plant.measures.is_empty() { defaults.measures } else { plant.measures.clone() },
    }
}

fn of_arm(arm: &ArmConfig, max_command: &PerOutput) -> PlantSignals {
    let joints = 1..=arm.lengths.len();
    let [low, high] = arm.arena;
    // A mirrored coordinate lies in the arena's mirror image.
    let range = |axis| {
        let mirrored = arm.mirror.iter().any(|m| m.axis == axis);
        if mirrored { [low.min(-high), high.max(-low)] } else { arm.arena }
    };
    let mut inputs = vec![signal("target_x", "m", range(MirrorAxis::X)), signal("target_y", "m", range(MirrorAxis::Y))];
    if !arm.open_loop {
        let range = |joint: usize| arm.limits.get(joint - 1).copied().unwrap_or([-PI, PI]);
        inputs.extend(joints.clone().map(|joint| signal(&format!("theta_{joint}"), "rad", range(joint))));
    }
    let quantity = if arm.open_loop { "angle" } else { "rate" };
    let mut measures = ["error", "end_x", "end_y"].map(MeasureConfig::from).to_vec();
    if arm.reward.collision > 0.0 {
        measures.push("crossings".into());
    }
    PlantSignals {
        inputs,
        outputs: joints.map(|joint| output_signal(&format!("{quantity}_{joint}"), max_command.of(joint - 1))).collect(),
        measures,
    }
}

fn of_eye(eye: &EyeConfig, max_command: &PerOutput) -> PlantSignals {
    let inputs = match eye.retina {
        Retina::Linear => vec![
            signal("position_x", "1", [-1.0, 1.0]),
            signal("position_y", "1", [-1.0, 1.0]),
            signal("velocity_x", "1/s", [-1.0, 1.0]),
            signal("velocity_y", "1/s", [-1.0, 1.0]),
        ],
        // The radius of a velocity is a logarithm and therefore has no unit.
        Retina::LogPolar => vec![
            signal("position_rho", "1", [0.0, 1.0]),
            signal("position_phi", "rad", [-PI, PI]),
            signal("velocity_rho", "1", [0.0, 1.0]),
            signal("velocity_phi", "rad", [-PI, PI]),
        ],
    };
    PlantSignals {
        inputs,
        outputs: (0..)
            .zip(["up", "down", "left", "right"])
            .map(|(i, name)| output_signal(name, max_command.of(i)))
            .collect(),
        measures: vec!["error".into()],
    }
}

/// An output. Its range is the gate's limit.
fn output_signal(name: &str, limit: f64) -> SignalConfig {
    signal(name, "1", [-limit, limit])
}

fn signal(name: &str, unit: &str, [min, max]: [f64; 2]) -> SignalConfig {
    SignalConfig { name: name.to_owned(), unit: unit.to_owned(), min, max, wraps: None }
}
