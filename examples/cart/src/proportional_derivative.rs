//! The controller: a spring towards the target, and a damper.

use tectum::agent::{Agent, Answer, Percept};
use tectum::state::{Persist, StateVisitor};

/// Stiffness of the spring, commands a metre.
const PROPORTIONAL: f32 = 2.0;
/// Strength of the damper, commands a metre a second.
const DERIVATIVE: f32 = 1.2;

/// A PD controller. It is not told the cart's speed, and computes it from two positions.
#[derive(Debug)]
pub struct ProportionalDerivative {
    /// One tick, s.
    period: f32,
    /// Position at the last tick that was seen, m.
    position: f32,
    /// That tick, from 1; 0 before the first.
    seen: u64,
}

impl ProportionalDerivative {
    /// A controller for ticks of `period` seconds.
    pub fn new(period: f32) -> Self {
        Self { period, position: 0.0, seen: 0 }
    }
}

/// All that the controller needs to go on where it was when its process was killed.
impl Persist for ProportionalDerivative {
    fn visit_state(&mut self, visitor: &mut dyn StateVisitor) {
        visitor.number("position", &mut self.position);
        visitor.number("seen", &mut self.seen);
    }
}

impl Agent for ProportionalDerivative {
    fn act(&mut self, percept: &Percept, answer: &mut Answer) {
        let [position, target] = [percept.inputs[0], percept.inputs[1]];
        let now = percept.tick + 1;
        // Ticks may be missing in between.
        let speed = match self.seen {
            0 => 0.0,
            seen => (position - self.position) / (self.period * (now - seen) as f32),
        };
        (self.position, self.seen) = (position, now);
        answer.command[0] = PROPORTIONAL * (target - position) - DERIVATIVE * speed;
        answer.mean[0] = answer.command[0];
    }
}
