//! Features of the critic: a topographic map over each pair of inputs.
//!
//! A reward for a distance depends on several inputs together, such as the position of the target *and* the
//! angle of a joint. The policy's own maps encode each joint alone. A value that is linear in them treats the
//! rest as noise, which enters the policy through every temporal-difference error. Small maps over all pairs
//! (as in the learned-reward rule) represent most of the dependence: on the arm, without the last reward as a
//! feature, the error shrinks to a third.

use crate::MAX_INPUTS;
use crate::SignalConfig;
use tectum_encoder::{Axis, Encoder, Features, Map};

/// Number of units of a map along an input; the radius is their spacing.
const UNITS: usize = 8;

/// The maps over pairs of inputs, and the features of two consecutive ticks.
#[derive(Debug, Clone)]
pub struct PairFeatures {
    /// One line for each input. The maps are outer products of lines: the fifteen pairs of the arm's six inputs
    /// share six lines.
    encoder: Encoder,
    lines: Features,
    inputs: usize,
    /// Features of the tick that is learned from, and of the next tick; of unit norm.
    here: Vec<f32>,
    next: Vec<f32>,
    /// The inputs of `next`.
    next_inputs: [f32; MAX_INPUTS],
}

impl PairFeatures {
    /// The maps over all pairs of `signals`, or one line if there is only one input.
    pub fn of(signals: &[SignalConfig]) -> Self {
        let line = |input: usize| {
            let (min, max) = (signals[input].min, signals[input].max);
            Map::Line(Axis { input, units: UNITS, min, max, radius: (max - min) / (UNITS - 1) as f64 })
        };
        let inputs = signals.len();
        let encoder = Encoder::new(&(0..inputs).map(line).collect::<Vec<_>>(), false);
        let features = vec![0.0; if inputs == 1 { UNITS } else { inputs * (inputs - 1) / 2 * UNITS * UNITS }];
        let lines = encoder.features();
        Self { encoder, lines, inputs, here: features.clone(), next: features, next_inputs: [f32::NAN; MAX_INPUTS] }
    }

    /// Number of features.
    pub(super) fn units(&self) -> usize {
        self.here.len()
    }

    /// Fills `next` with the features of `inputs`.
    fn encode(&mut self, inputs: &[f32]) {
        self.encoder.encode(inputs, &mut self.lines);
        let lines = self.lines.as_slice().as_chunks::<UNITS>().0;
        let mut squares = [0.0; MAX_INPUTS];
        for (square, line) in squares.iter_mut().zip(lines) {
            *square = line.iter().map(|&a| f64::from(a) * f64::from(a)).sum();
        }
        if self.inputs == 1 {
            let scale = (1.0 / squares[0].sqrt()) as f32;
            self.next.iter_mut().zip(&lines[0]).for_each(|(out, a)| *out = a * scale);
            return;
        }
        // The sum of squares of a pair is the product of those of its lines. In double precision, for inputs
        // far outside the box.
        let (mut sum, mut earlier) = (0.0, 0.0);
        for square in &squares[..self.inputs] {
            sum += earlier * square;
            earlier += square;
        }
        let scale = (1.0 / sum.sqrt()) as f32;
        let mut rows = self.next.as_chunks_mut::<UNITS>().0.iter_mut();
        for (i, slow) in lines.iter().enumerate() {
            let slow = slow.map(|a| a * scale);
            for fast in &lines[..i] {
                for (a, row) in slow.iter().zip(&mut rows) {
                    *row = fast.map(|b| a * b);
                }
            }
        }
    }

    /// Features of a tick and of the next one. If the ticks of two calls are consecutive, the shared one is not
    /// encoded again.
    pub fn encode_pair(&mut self, inputs: &[f32], next_inputs: &[f32]) -> [&[f32]; 2] {
        if self.next_inputs[..self.inputs] != *inputs {
            self.encode(inputs);
        }
        std::mem::swap(&mut self.here, &mut self.next);
        self.encode(next_inputs);
        self.next_inputs[..self.inputs].copy_from_slice(next_inputs);
        [&self.here, &self.next]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::learner::test_specs::arm;

    #[test]
    fn consecutive_and_separate_ticks_have_the_same_features() {
        let signals = arm().inputs;
        let (mut consecutive, mut separate) = (PairFeatures::of(&signals), PairFeatures::of(&signals));
        let (a, b, c) = ([0.1; 6], [0.2; 6], [-0.3; 6]);
        consecutive.encode_pair(&a, &b);
        separate.encode_pair(&c, &a);
        assert_eq!(consecutive.encode_pair(&b, &c), separate.encode_pair(&b, &c));
        assert_eq!(consecutive.units(), 15 * 64);
    }

    #[test]
    fn products_of_lines_are_the_maps_over_planes() {
        let signals = arm().inputs;
        let axis = |input: usize| {
            let (min, max) = (signals[input].min, signals[input].max);
            Axis { input, units: UNITS, min, max, radius: (max - min) / 7.0 }
        };
        let maps: Vec<_> = (0..6).flat_map(|i| (0..i).map(move |j| Map::Plane(axis(i), axis(j)))).collect();
        let mut planes = Encoder::new(&maps, true);
        let mut expected = planes.features();
        let mut pairs = PairFeatures::of(&signals);
        // The last inputs are so far outside that all kernels have their smallest value.
        for inputs in [[0.1, -0.4, 0.3, 2.0, -1.0, 0.0], [0.9, 1.1, -3.0, 3.0, 1.0, -2.0], [1e6; 6]] {
            planes.encode(&inputs, &mut expected);
            for (got, expected) in pairs.encode_pair(&[0.0; 6], &inputs)[1].iter().zip(expected.as_slice()) {
                assert!((got - expected).abs() < 1e-6, "{got} {expected}");
            }
        }
    }
}
