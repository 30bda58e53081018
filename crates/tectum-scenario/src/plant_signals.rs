//! The inputs, outputs and measures of a scenario's plant: those that the file lists, or else those of its body.

use super::{MeasureConfig, Scenario, SignalConfig, leader};
use crate::limits::MAX_MEASURES;

/// The signals of a plant, in the order in which samples carry them.
pub(super) struct PlantSignals {
    pub(super) inputs: Vec<SignalConfig>,
    pub(super) outputs: Vec<SignalConfig>,
    pub(super) measures: Vec<MeasureConfig>,
    /// Names of the inputs that the commands move, where the plant says so.
    pub(super) moved: Vec<String>,
}

/// The signals that the scenario lists. For a list that it leaves out, those of its body; without one the list is
/// empty.
pub(super) fn signals(scenario: &Scenario) -> PlantSignals {
    let plant = &scenario.plant;
    let limit = |output| scenario.gate.max_command.of(output);
    let mut defaults = match plant.body() {
        Some(body) => {
            let signals = body.signals();
            let outputs = (0..).zip(&signals.outputs).map(|(i, name)| output_signal(name, limit(i))).collect();
            let unmoved = signals.inputs.len() - signals.moved;
            PlantSignals {
                moved: signals.inputs[unmoved..].iter().map(|input| input.name.clone()).collect(),
                inputs: signals.inputs,
                outputs,
                measures: signals.measures.into_iter().map(MeasureConfig::from).collect(),
            }
        }
        None if plant.leader.is_some() => {
            let names = leader::outputs(plant);
            PlantSignals {
                inputs: leader::inputs(plant),
                outputs: names.iter().enumerate().map(|(i, name)| output_signal(name, limit(i))).collect(),
                measures: vec!["error".into()],
                moved: names,
            }
        }
        None => PlantSignals { inputs: Vec::new(), outputs: Vec::new(), measures: Vec::new(), moved: Vec::new() },
    };
    if plant.servos.is_some() {
        defaults.measures.extend(["bus_read_us", "bus_write_us"].map(MeasureConfig::from));
    }
    if plant.leader.is_some() {
        defaults.measures.push("leader_read_us".into());
    }
    if plant.servos.as_ref().is_some_and(|servos| !servos.sight.is_model()) && defaults.measures.len() < MAX_MEASURES {
        defaults.measures.push("vision_age_ms".into());
    }
    let inputs = if plant.inputs.is_empty() { defaults.inputs } else { plant.inputs.clone() };
    // A list of other inputs says nothing about them.
    defaults.moved.retain(|name| inputs.iter().any(|input| input.name == *name));
    PlantSignals {
        inputs,
        moved: defaults.moved,
        outputs: if plant.outputs.is_empty() { defaults.outputs } else { plant.outputs.clone() },
        measures: if plant.measures.is_empty() { defaults.measures } else { plant.measures.clone() },
    }
}

/// An output. Its range is the gate's limit.
fn output_signal(name: &str, limit: f64) -> SignalConfig {
    SignalConfig { name: name.to_owned(), unit: "1".to_owned(), min: -limit, max: limit, wraps: None }
}
