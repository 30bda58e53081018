//! The policy's features as functions of the inputs, with their slopes: what the encoder does, done again in a way that
//! can be differentiated.
//!
//! Maps over inputs that commands do not move are worked out once for a whole imagined movement; the others every tick.

use super::{basis::KernelRow, whiten::Whitening};
use tectum_encoder::{Axis, Encoder, Map};

/// One axis of a map.
#[derive(Debug, Clone)]
struct AxisKernels {
    row: KernelRow,
    /// In the model's order of inputs.
    input: usize,
    /// Where its values stand among those of all lines.
    at: usize,
    whitening: Whitening,
}

/// A map: one line, or the outer product of a slow and a fast one.
#[derive(Debug, Clone)]
struct MapPatch {
    slow: Option<AxisKernels>,
    fast: AxisKernels,
}

/// Some maps of the encoder.
#[derive(Debug, Clone, Default)]
pub(super) struct MapFeatures {
    patches: Vec<MapPatch>,
    /// Values of all lines together.
    pub lines: usize,
    /// Where each feature stands in the policy.
    pub positions: Vec<usize>,
    scratch: Vec<f32>,
}

impl MapFeatures {
    /// The maps that do not, and those that do depend on an input from number `still` on, in the model's order of inputs:
    /// `rank` gives the place of each input in it.
    pub fn of(maps: &[Map], encoder: &Encoder, rank: &[usize], still: usize, ridge: f64) -> [Self; 2] {
        let order: Vec<_> = encoder.positions().collect();
        let mut sights = [Self::default(), Self::default()];
        let mut next = 0;
        for map in maps {
            let (slow, fast) = match map {
                Map::Line(axis) => (None, axis),
                Map::Plane(slow, fast) => (Some(slow), fast),
            };
            let moves = |axis: &Axis| rank[axis.input] >= still;
            let sight = &mut sights[usize::from(moves(fast) || slow.is_some_and(moves))];
            let mut line = |axis: &Axis| {
                let row = KernelRow::new(axis.units, axis.min, axis.max, axis.radius);
                sight.lines += axis.units;
                let mut slopes = vec![0.0; axis.units];
                let eval = |x: f32, values: &mut [f32]| row.eval(x, values, &mut slopes);
                let whitening = Whitening::of(axis.units, axis.min as f32, axis.max as f32, ridge, eval);
                AxisKernels { row, input: rank[axis.input], at: sight.lines - axis.units, whitening }
            };
            let patch = MapPatch { slow: slow.map(&mut line), fast: line(fast) };
            let units = patch.units();
            sight.patches.push(patch);
            sight.positions.extend_from_slice(&order[next..next + units]);
            next += units;
        }
        for sight in &mut sights {
            sight.scratch = vec![0.0; sight.patches.iter().map(MapPatch::units).max().unwrap_or(0)];
        }
        sights
    }

    /// Slopes along the weights of one output to slopes along uncorrelated coordinates.
    pub fn whiten(&mut self, mut values: &mut [f32]) {
        for patch in &self.patches {
            let units = patch.units();
            let here = values.split_off_mut(..units).unwrap_or_default();
            let scratch = &mut self.scratch[..units];
            patch.fast.whitening.rows_to(here, scratch);
            match &patch.slow {
                Some(slow) => slow.whitening.columns_to(scratch, here),
                None => here.copy_from_slice(scratch),
            }
        }
    }

    /// Steps along those coordinates to steps of the weights.
    pub fn unwhiten(&mut self, mut values: &mut [f32]) {
        for patch in &self.patches {
            let units = patch.units();
            let here = values.split_off_mut(..units).unwrap_or_default();
            let scratch = &mut self.scratch[..units];
            patch.fast.whitening.rows_back(here, scratch);
            match &patch.slow {
                Some(slow) => slow.whitening.columns_back(scratch, here),
                None => here.copy_from_slice(scratch),
            }
        }
    }

    /// Works out the features of `inputs`, their slopes' lines, and returns the sum of their squares.
    pub fn look(&self, inputs: &[f32], values: &mut [f32], slopes: &mut [f32], features: &mut [f32]) -> f32 {
        let mut rest = features;
        for patch in &self.patches {
            for line in patch.slow.iter().chain([&patch.fast]) {
                line.row.eval(inputs[line.input], &mut values[line.at..], &mut slopes[line.at..]);
            }
            let here = rest.split_off_mut(..patch.units()).unwrap_or_default();
            let fast = &values[patch.fast.at..][..patch.fast.row.units];
            if let Some(slow) = &patch.slow {
                let slow = &values[slow.at..][..slow.row.units];
                for (out, s) in here.chunks_exact_mut(fast.len()).zip(slow) {
                    for (out, f) in out.iter_mut().zip(fast) {
                        *out = s * f;
                    }
                }
            } else {
                here.copy_from_slice(fast);
            }
        }
        // Squares are summed by lines: a map's are the product of its lines'.
        let squares = |line: &AxisKernels| values[line.at..][..line.row.units].iter().map(|v| v * v).sum::<f32>();
        self.patches.iter().map(|p| squares(&p.fast) * p.slow.as_ref().map_or(1.0, squares)).sum()
    }

    /// Adds to `inputs` (the moved ones, from number `still` on) the slopes of something whose slopes along the features
    /// are `features`.
    pub fn back(&self, values: &[f32], slopes: &[f32], features: &[f32], still: usize, inputs: &mut [f32]) {
        let mut next = 0;
        let dot = |a: &[f32], b: &[f32]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f32>();
        for patch in &self.patches {
            let here = &features[next..][..patch.units()];
            next += patch.units();
            let units = patch.fast.row.units;
            let (v, d) = (&values[patch.fast.at..][..units], &slopes[patch.fast.at..][..units]);
            let Some(slow) = &patch.slow else {
                inputs[patch.fast.input - still] += dot(here, d);
                continue;
            };
            for (i, row) in here.chunks_exact(units).enumerate() {
                if patch.fast.input >= still {
                    inputs[patch.fast.input - still] += values[slow.at + i] * dot(row, d);
                }
                if slow.input >= still {
                    inputs[slow.input - still] += slopes[slow.at + i] * dot(row, v);
                }
            }
        }
    }

    /// Number of features.
    pub fn len(&self) -> usize {
        self.positions.len()
    }
}

impl MapPatch {
    fn units(&self) -> usize {
        self.fast.row.units * self.slow.as_ref().map_or(1, |s| s.row.units)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_sees_what_the_encoder_sees() {
        let axis = |input, units| Axis { input, units, min: -1.0, max: 1.0, radius: 0.4 };
        let maps = [Map::Plane(axis(0, 5), axis(1, 6)), Map::Line(axis(2, 7)), Map::Plane(axis(2, 3), axis(0, 4))];
        let mut encoder = Encoder::new(&maps, true);
        let inputs = [0.3, -0.8, 0.1];
        let mut features = encoder.features();
        encoder.encode(&inputs, &mut features);
        let sights = MapFeatures::of(&maps, &encoder, &[0, 1, 2], 2, 0.01);
        let mut squares = 0.0;
        let mut seen = vec![0.0; encoder.len()];
        for sight in &sights {
            let (mut v, mut d, mut out) = (vec![0.0; sight.lines], vec![0.0; sight.lines], vec![0.0; sight.len()]);
            squares += sight.look(&inputs, &mut v, &mut d, &mut out);
            for (&at, x) in sight.positions.iter().zip(out) {
                seen[at] = x;
            }
        }
        for (a, b) in features.as_slice().iter().zip(seen) {
            assert!((a - b / squares.sqrt()).abs() < 1e-6);
        }
    }
}
