//! The policy's features and their slopes along the inputs: a differentiable version of the encoder.
//!
//! Maps over inputs that commands do not move are computed once per rollout, the others in every tick of it.

use super::{basis::KernelRow, whiten::Whitening};
use tectum_encoder::{Axis, Encoder, Map};

/// One axis of a map.
#[derive(Debug, Clone)]
struct AxisKernels {
    row: KernelRow,
    /// Index of the input in the model's order.
    input: usize,
    /// Position of its values among those of all lines.
    start: usize,
    whitening: Whitening,
}

/// A map: one line, or the outer product of a slow and a fast one.
#[derive(Debug, Clone)]
struct MapKernels {
    slow: Option<AxisKernels>,
    fast: AxisKernels,
}

/// A group of the encoder's maps.
#[derive(Debug, Clone, Default)]
pub(super) struct MapFeatures {
    maps: Vec<MapKernels>,
    /// Number of values of all lines together.
    pub lines: usize,
    /// Position of each feature in the policy.
    pub positions: Vec<usize>,
    scratch: Vec<f32>,
}

impl MapFeatures {
    /// Two groups: the maps that depend only on the first `fixed` inputs in the model's order, and the maps
    /// that depend on moved inputs. `rank` is the position of each input in that order.
    pub fn of(maps: &[Map], encoder: &Encoder, rank: &[usize], fixed: usize, ridge: f64) -> [Self; 2] {
        let order: Vec<_> = encoder.positions().collect();
        let mut groups = [Self::default(), Self::default()];
        let mut next = 0;
        for map in maps {
            let (slow, fast) = match map {
                Map::Line(axis) => (None, axis),
                Map::Plane(slow, fast) => (Some(slow), fast),
            };
            let moves = |axis: &Axis| rank[axis.input] >= fixed;
            let group = &mut groups[usize::from(moves(fast) || slow.is_some_and(moves))];
            let mut line = |axis: &Axis| {
                let row = KernelRow::new(axis.units, axis.min, axis.max, axis.radius);
                group.lines += axis.units;
                let mut slopes = vec![0.0; axis.units];
                let eval = |x: f32, values: &mut [f32]| row.eval(x, values, &mut slopes);
                let whitening = Whitening::of(axis.units, axis.min as f32, axis.max as f32, ridge, eval);
                AxisKernels { row, input: rank[axis.input], start: group.lines - axis.units, whitening }
            };
            let kernels = MapKernels { slow: slow.map(&mut line), fast: line(fast) };
            let units = kernels.units();
            group.maps.push(kernels);
            group.positions.extend_from_slice(&order[next..next + units]);
            next += units;
        }
        for group in &mut groups {
            group.scratch = vec![0.0; group.maps.iter().map(MapKernels::units).max().unwrap_or(0)];
        }
        groups
    }

    /// Transforms slopes along the weights of one output to slopes along uncorrelated coordinates.
    pub fn whiten(&mut self, mut values: &mut [f32]) {
        for map in &self.maps {
            let units = map.units();
            let here = values.split_off_mut(..units).unwrap_or_default();
            let scratch = &mut self.scratch[..units];
            map.fast.whitening.whiten_rows(here, scratch);
            match &map.slow {
                Some(slow) => slow.whitening.whiten_columns(scratch, here),
                None => here.copy_from_slice(scratch),
            }
        }
    }

    /// Transforms steps along uncorrelated coordinates to steps of the weights.
    pub fn unwhiten(&mut self, mut values: &mut [f32]) {
        for map in &self.maps {
            let units = map.units();
            let here = values.split_off_mut(..units).unwrap_or_default();
            let scratch = &mut self.scratch[..units];
            map.fast.whitening.unwhiten_rows(here, scratch);
            match &map.slow {
                Some(slow) => slow.whitening.unwhiten_columns(scratch, here),
                None => here.copy_from_slice(scratch),
            }
        }
    }

    /// Computes the features of `inputs`, and values and slopes of the lines. Returns the sum of squares of the
    /// features.
    pub fn encode(&self, inputs: &[f32], values: &mut [f32], slopes: &mut [f32], features: &mut [f32]) -> f32 {
        let mut rest = features;
        for map in &self.maps {
            for line in map.slow.iter().chain([&map.fast]) {
                line.row.eval(inputs[line.input], &mut values[line.start..], &mut slopes[line.start..]);
            }
            let here = rest.split_off_mut(..map.units()).unwrap_or_default();
            let fast = &values[map.fast.start..][..map.fast.row.units];
            if let Some(slow) = &map.slow {
                let slow = &values[slow.start..][..slow.row.units];
                for (out, s) in here.chunks_exact_mut(fast.len()).zip(slow) {
                    for (out, f) in out.iter_mut().zip(fast) {
                        *out = s * f;
                    }
                }
            } else {
                here.copy_from_slice(fast);
            }
        }
        // Squares are summed by lines: the sum of a map is the product of those of its lines.
        let squares = |line: &AxisKernels| values[line.start..][..line.row.units].iter().map(|v| v * v).sum::<f32>();
        self.maps.iter().map(|p| squares(&p.fast) * p.slow.as_ref().map_or(1.0, squares)).sum()
    }

    /// Back-propagation: given the slopes `features` of some quantity along the features, adds its slopes along
    /// the moved inputs, from number `fixed` on, to `inputs`.
    pub fn backpropagate(&self, values: &[f32], slopes: &[f32], features: &[f32], fixed: usize, inputs: &mut [f32]) {
        let mut next = 0;
        let dot = |a: &[f32], b: &[f32]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f32>();
        for map in &self.maps {
            let here = &features[next..][..map.units()];
            next += map.units();
            let units = map.fast.row.units;
            let (v, d) = (&values[map.fast.start..][..units], &slopes[map.fast.start..][..units]);
            let Some(slow) = &map.slow else {
                inputs[map.fast.input - fixed] += dot(here, d);
                continue;
            };
            for (i, row) in here.chunks_exact(units).enumerate() {
                if map.fast.input >= fixed {
                    inputs[map.fast.input - fixed] += values[slow.start + i] * dot(row, d);
                }
                if slow.input >= fixed {
                    inputs[slow.input - fixed] += slopes[slow.start + i] * dot(row, v);
                }
            }
        }
    }

    /// Number of features.
    pub fn len(&self) -> usize {
        self.positions.len()
    }
}

impl MapKernels {
    fn units(&self) -> usize {
        self.fast.row.units * self.slow.as_ref().map_or(1, |s| s.row.units)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn features_match_the_encoder() {
        let axis = |input, units| Axis { input, units, min: -1.0, max: 1.0, radius: 0.4 };
        let maps = [Map::Plane(axis(0, 5), axis(1, 6)), Map::Line(axis(2, 7)), Map::Plane(axis(2, 3), axis(0, 4))];
        let mut encoder = Encoder::new(&maps, true);
        let inputs = [0.3, -0.8, 0.1];
        let mut features = encoder.features();
        encoder.encode(&inputs, &mut features);
        let groups = MapFeatures::of(&maps, &encoder, &[0, 1, 2], 2, 0.01);
        let mut squares = 0.0;
        let mut all = vec![0.0; encoder.len()];
        for group in &groups {
            let (mut v, mut d, mut out) = (vec![0.0; group.lines], vec![0.0; group.lines], vec![0.0; group.len()]);
            squares += group.encode(&inputs, &mut v, &mut d, &mut out);
            for (&at, x) in group.positions.iter().zip(out) {
                all[at] = x;
            }
        }
        for (a, b) in features.as_slice().iter().zip(all) {
            assert!((a - b / squares.sqrt()).abs() < 1e-6);
        }
    }
}
