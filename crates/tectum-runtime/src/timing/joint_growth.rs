//! What a tick of each learner costs on bodies with more and more joints.

use super::{TimingError, check_signals};
use crate::clock::{TerminationSignals, monotonic_ns};
use crate::runtime::Simulation;
use crate::scenario::{LearnerConfig, Plan, Rule, Scenario};
use crate::stats::{Percentiles, histogram};

/// The built-in body whose target has three coordinates.
const SPATIAL: &str = "so101";
/// Ticks between two looks at the signals.
const LOOK: u64 = 16;

/// What a controller's tick costs on one body.
#[derive(Debug, Clone)]
pub struct BodyCost {
    /// The learner.
    pub rule: Rule,
    /// Whether the target has three coordinates instead of two.
    pub spatial: bool,
    /// Numbers of joints, inputs and features.
    pub joints: usize,
    /// Inputs.
    pub inputs: usize,
    /// Features; 0 for a learner without an encoder.
    pub features: usize,
    /// The controller's whole tick, us: answer, learning and record, in the second half of the ticks.
    pub tick: Percentiles,
}

/// A planar arm of 2 m with so many joints, seen on the maps of the scenario `arm`: a plane for the target, a line for
/// each joint.
fn planar(rule: Rule, joints: usize) -> Result<Plan, TimingError> {
    let mut scenario = Scenario::built_in("arm")?;
    if let Some(arm) = &mut scenario.plant.arm {
        arm.lengths = vec![2.0 / joints as f64; joints];
        arm.block.clear();
    }
    let line = scenario.encoder.maps[1].clone();
    scenario.encoder.maps.truncate(1);
    for joint in 1..=joints {
        let mut map = line.clone();
        map.inputs = vec![format!("theta_{joint}")];
        scenario.encoder.maps.push(map);
    }
    scenario.learner = LearnerConfig::preset(rule);
    Ok(scenario.plan()?)
}

/// The SO-101, whose target has three coordinates.
fn spatial(rule: Rule) -> Result<Plan, TimingError> {
    let mut scenario = Scenario::built_in(SPATIAL)?;
    scenario.learner = LearnerConfig::preset(rule);
    Ok(scenario.plan()?)
}

/// What a tick of `rule` costs with `joints` joints, or on the body with a target in space; over `ticks` ticks of a run
/// that begins anew.
///
/// # Errors
/// [`TimingError::Signal`] when a signal comes.
pub fn body_cost(
    rule: Rule,
    joints: Option<usize>,
    ticks: u64,
    signals: &TerminationSignals,
) -> Result<BodyCost, TimingError> {
    let plan = joints.map_or_else(|| spatial(rule), |joints| planar(rule, joints))?;
    let mut simulation = Simulation::new(&plan, plan.simulated_plant().ok_or(TimingError::NotSimulated)?);
    let mut costs = histogram();
    for tick in 0..ticks.max(2) {
        if tick.is_multiple_of(LOOK) {
            check_signals(signals)?;
        }
        simulation.sense();
        let began = monotonic_ns();
        simulation.answer();
        simulation.improve();
        simulation.record();
        let took = monotonic_ns() - began;
        if 2 * tick >= ticks {
            costs.saturating_record(took);
        }
        simulation.advance();
    }
    let features = simulation.controller().policy().map_or(0, |policy| policy.features());
    let tick = Percentiles::of(&costs).ok_or(TimingError::NotSimulated)?;
    Ok(BodyCost {
        rule,
        spatial: joints.is_none(),
        joints: plan.outputs.len(),
        inputs: plan.inputs.len(),
        features,
        tick,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_rule_runs_on_every_body() {
        let signals = TerminationSignals::default();
        for rule in Rule::ALL {
            for joints in [Some(2), Some(8), None] {
                let cost = body_cost(rule, joints, 4, &signals).unwrap();
                assert_eq!(cost.tick.count, 2);
                let expected = joints.map_or(5, |joints| joints);
                assert_eq!((cost.joints, cost.inputs), (expected, expected + if joints.is_some() { 2 } else { 3 }));
                assert!(cost.features > 0 || !rule.is_linear(), "{rule:?}");
            }
        }
    }
}
