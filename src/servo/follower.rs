//! The controller of a follower: commands the rate that takes each joint to the leader's angle within a tick.
//!
//! The gate, the bridge's ramp and the joints' highest speeds limit that rate. Until the follower has met the leader
//! for the first time, and whenever its torque was off since, it also stays below a low *approach speed*: the two arms
//! may stand anywhere when torque comes on.

use serde::Deserialize;

use crate::agent::{Agent, AgentRecord, Answer, Percept};
use crate::scenario::{Plan, ScenarioError};
use crate::state::{Persist, StateVisitor};
use crate::wire::flag;

/// Largest difference of a joint at which the follower has met the leader, rad.
const MEETING: f32 = 0.1;

/// The keys of `[learner]` beside `rule`.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct FollowerSettings {
    /// Highest speed of a joint until the follower has met the leader, rad/s.
    #[serde(default = "default_approach")]
    approach_speed: f64,
}

fn default_approach() -> f64 {
    0.5
}

/// The controller of a follower.
#[derive(Debug)]
pub struct FollowerAgent {
    joints: usize,
    /// Length of a tick, s.
    period: f32,
    /// Highest speed during the approach, rad/s.
    approach: f32,
    /// Whether the follower has met the leader since its torque came on.
    met: bool,
    /// The largest difference of a joint, rad.
    apart: f32,
}

impl FollowerAgent {
    /// The controller for a scenario with `[plant.leader]`.
    ///
    /// # Errors
    /// When the scenario has no leader, or a key of `[learner]` is invalid.
    pub fn new(plan: &Plan) -> Result<Self, ScenarioError> {
        let table = plan.learner_table();
        let settings: FollowerSettings = table.read()?;
        if plan.scenario.plant.leader.is_none() {
            return Err(plan.scenario.invalid("plant", "has no leader that could be followed; add [plant.leader]"));
        }
        let approach = settings.approach_speed;
        if !(0.01..=100.0).contains(&approach) {
            return Err(table.invalid("approach_speed", format_args!("is {approach}; give 0.01 to 100 rad/s")));
        }
        let period = plan.period_ns as f32 / 1e9;
        Ok(Self { joints: plan.outputs.len(), period, approach: approach as f32, met: false, apart: 0.0 })
    }
}

impl Agent for FollowerAgent {
    /// Inputs: the leader's angles, then the follower's, rad. Commands: rates, rad/s.
    fn act(&mut self, percept: &Percept, answer: &mut Answer) {
        let (goals, angles) = percept.inputs.split_at(self.joints.min(percept.inputs.len() / 2));
        let apart = |(goal, angle): (&f32, &f32)| goal - angle;
        self.apart = goals.iter().zip(angles).map(apart).map(f32::abs).fold(0.0, f32::max);
        let off = percept.flags & (flag::UNARMED | flag::TRIPPED) != 0;
        self.met = !off && (self.met || self.apart <= MEETING);
        let most = if self.met { f32::INFINITY } else { self.approach };
        for (command, pair) in answer.command.iter_mut().zip(goals.iter().zip(angles)) {
            *command = (apart(pair) / self.period).clamp(-most, most);
        }
    }

    fn columns(&self) -> &'static [&'static str] {
        &["met", "apart"]
    }

    fn record(&self, record: &mut AgentRecord) {
        record.columns[..2].copy_from_slice(&[f32::from(self.met), self.apart]);
    }
}

impl Persist for FollowerAgent {
    fn visit_state(&mut self, visitor: &mut dyn StateVisitor) {
        visitor.boolean("met", &mut self.met);
        visitor.number("apart", &mut self.apart);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_approaches_slowly_and_then_follows() {
        let mut agent = FollowerAgent { joints: 2, period: 0.02, approach: 0.5, met: false, apart: 0.0 };
        let mut command = |inputs: &[f32], flags: u32| {
            let (mut command, mut mean) = ([0.0; 2], [f32::NAN; 2]);
            agent.act(
                &Percept { tick: 0, inputs, age: 0, flags },
                &mut Answer { command: &mut command, mean: &mut mean },
            );
            command
        };
        assert_eq!(command(&[1.0, 0.0, 0.0, 0.0], 0), [0.5, 0.0]);
        let met = command(&[1.0, 0.0, 0.99, 0.005], 0)[0];
        assert!((met - 0.5).abs() < 1e-5, "met: (1 - 0.99) / 0.02 = {met}");
        assert_eq!(command(&[1.0, 0.0, 0.0, 0.0], 0), [50.0, 0.0], "the gate limits it now");
        assert_eq!(command(&[1.0, 0.0, 0.0, 0.0], flag::TRIPPED), [0.5, 0.0], "torque was off");
        assert_eq!(command(&[-1.0, 0.0, 0.0, 0.0], 0), [-0.5, 0.0]);
    }
}
