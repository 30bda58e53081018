//! What the critic sees of the inputs: a topographic map over each pair of them.
//!
//! A reward that depends on a distance depends on inputs together: on where the target is *and* how a joint stands. The
//! policy's own maps show each joint alone, and a value that is linear in them must take the rest for noise, which then
//! reaches the policy through every temporal-difference error. Small maps over all pairs (as in the learned-reward rule)
//! show most of it: on the arm the error shrinks to a third.

use crate::encoder::{Axis, Encoder, Features, Map};
use crate::scenario::Plan;
use crate::wire::MAX_INPUTS;

/// Units of a map along an input; the radius is their spacing.
const UNITS: usize = 8;

/// The maps, and the features of the last two ticks.
#[derive(Debug, Clone)]
pub struct Pairs {
    encoder: Encoder,
    inputs: usize,
    /// Features of the tick that is learned from, and of the tick after.
    here: Features,
    next: Features,
    /// The inputs that `next` was made of.
    seen: [f32; MAX_INPUTS],
}

impl Pairs {
    /// The maps over the input box of `plan`; over the only input, where there is one.
    pub fn of(plan: &Plan) -> Self {
        let axis = |input: usize| {
            let (min, max) = (plan.inputs[input].min, plan.inputs[input].max);
            Axis { input, units: UNITS, min, max, radius: (max - min) / (UNITS - 1) as f64 }
        };
        let inputs = plan.inputs.len();
        let mut maps: Vec<Map> = (0..inputs).flat_map(|i| (0..i).map(move |j| Map::Plane(axis(i), axis(j)))).collect();
        if inputs == 1 {
            maps.push(Map::Line(axis(0)));
        }
        let encoder = Encoder::new(&maps, true);
        Self { inputs, here: encoder.features(), next: encoder.features(), seen: [f32::NAN; MAX_INPUTS], encoder }
    }

    /// Length of the features with pads.
    pub(crate) fn len(&self) -> usize {
        self.here.len()
    }

    /// Features of both ends of a tick. The tick after is the next one to be learned from, as a rule, and then is not
    /// encoded twice.
    pub fn see(&mut self, inputs: &[f32], next_inputs: &[f32]) -> [&[f32]; 2] {
        if self.seen[..self.inputs] == *inputs {
            std::mem::swap(&mut self.here, &mut self.next);
        } else {
            self.encoder.encode(inputs, &mut self.here);
        }
        self.encoder.encode(next_inputs, &mut self.next);
        self.seen[..self.inputs].copy_from_slice(next_inputs);
        [self.here.as_slice(), self.next.as_slice()]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scenario::Scenario;

    #[test]
    fn ticks_in_a_row_and_ticks_apart_look_the_same() {
        let plan = Scenario::find("arm").unwrap().plan().unwrap();
        let (mut row, mut apart) = (Pairs::of(&plan), Pairs::of(&plan));
        let (a, b, c) = ([0.1; 6], [0.2; 6], [-0.3; 6]);
        row.see(&a, &b);
        apart.see(&c, &a);
        assert_eq!(row.see(&b, &c), apart.see(&b, &c));
        assert_eq!(row.len(), 15 * 64);
    }
}
