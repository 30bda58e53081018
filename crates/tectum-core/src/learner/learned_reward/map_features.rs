//! The policy's features and their slopes along the inputs: a differentiable version of the encoder, for sixteen
//! rollouts side by side.
//!
//! Maps over inputs that commands do not move are computed once per rollout, the others in every tick of it.

use super::basis::KernelRow;
use super::lanes::Lanes;
use super::whiten::Whitening;
use tectum_encoder::simd::F32x16;
use tectum_encoder::{Axis, Encoder, Map};

/// One axis of a map.
#[derive(Debug, Clone)]
pub(super) struct AxisKernels {
    pub row: KernelRow,
    /// Index of the input in the model's order.
    pub input: usize,
    whitening: Whitening,
}

/// A map: one line, or the outer product of a slow and a fast one.
#[derive(Debug, Clone)]
pub(super) struct MapKernels {
    pub slow: Option<AxisKernels>,
    pub fast: AxisKernels,
}

/// A group of the encoder's maps.
#[derive(Debug, Clone, Default)]
pub(super) struct MapFeatures {
    pub maps: Vec<MapKernels>,
    /// Number of units of all lines of planes together. (The values of any other line are features.)
    pub plane_lines: usize,
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
                let mut slopes = vec![0.0; axis.units];
                let eval = |x: f32, values: &mut [f32]| row.eval(x, values, &mut slopes);
                let whitening = Whitening::of(axis.units, axis.min as f32, axis.max as f32, ridge, eval);
                AxisKernels { row, input: rank[axis.input], whitening }
            };
            let kernels = MapKernels { slow: slow.map(&mut line), fast: line(fast) };
            group.plane_lines += slow.map_or(0, |slow| slow.units + fast.units);
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
    #[inline(always)]
    pub fn whiten<W: F32x16>(&mut self, mut values: &mut [f32]) {
        for map in &self.maps {
            let units = map.units();
            let here = values.split_off_mut(..units).unwrap_or_default();
            let scratch = &mut self.scratch[..units];
            map.fast.whitening.whiten_rows::<W>(here, scratch);
            match &map.slow {
                Some(slow) => slow.whitening.whiten_columns::<W>(scratch, here),
                None => here.copy_from_slice(scratch),
            }
        }
    }

    /// Transforms steps along uncorrelated coordinates to steps of the weights.
    #[inline(always)]
    pub fn unwhiten<W: F32x16>(&mut self, mut values: &mut [f32]) {
        for map in &self.maps {
            let units = map.units();
            let here = values.split_off_mut(..units).unwrap_or_default();
            let scratch = &mut self.scratch[..units];
            map.fast.whitening.unwhiten_rows::<W>(here, scratch);
            match &map.slow {
                Some(slow) => slow.whitening.unwhiten_columns::<W>(scratch, here),
                None => here.copy_from_slice(scratch),
            }
        }
    }

    /// Computes the features of `inputs`, for sixteen rollouts, and the values of the lines of planes. Returns the sum
    /// of squares of the features.
    #[inline(always)]
    pub fn encode_lanes<W: F32x16>(&self, inputs: &[Lanes], lines: &mut [Lanes], features: &mut [Lanes]) -> W {
        let mut total = W::splat(-0.0);
        let (mut rest, mut lines) = (features, lines);
        for map in &self.maps {
            let here = rest.split_off_mut(..map.units()).unwrap_or_default();
            let x = W::load(&inputs[map.fast.input].0);
            let Some(slow) = &map.slow else {
                total = total + map.fast.row.eval_lanes(x, here);
                continue;
            };
            let slow_values = lines.split_off_mut(..slow.row.units).unwrap_or_default();
            let fast_values = lines.split_off_mut(..map.fast.row.units).unwrap_or_default();
            let squares = slow.row.eval_lanes(W::load(&inputs[slow.input].0), slow_values);
            // Squares are summed by lines: the sum of a map is the product of those of its lines.
            total = total + map.fast.row.eval_lanes(x, fast_values) * squares;
            for (out, s) in here.chunks_exact_mut(map.fast.row.units).zip(slow_values) {
                let s = W::load(&s.0);
                for (out, f) in out.iter_mut().zip(&*fast_values) {
                    out.0 = (s * W::load(&f.0)).store();
                }
            }
        }
        total
    }

    /// Back-propagation: given the slopes `along` of some quantity along the features, adds its slopes along the moved
    /// inputs, from number `fixed` on, to `slopes`. `inputs`, `lines` and `features` are those of
    /// [`encode_lanes`](Self::encode_lanes).
    #[inline(always)]
    pub fn backpropagate_lanes<W: F32x16>(
        &self,
        [inputs, lines, features, along]: [&[Lanes]; 4],
        fixed: usize,
        slopes: &mut [Lanes],
    ) {
        let (mut features, mut along, mut lines) = (features, along, lines);
        for map in &self.maps {
            let values = features.split_off(..map.units()).unwrap_or_default();
            let along = along.split_off(..map.units()).unwrap_or_default();
            let fast = &map.fast;
            let x = W::load(&inputs[fast.input].0);
            let Some(slow) = &map.slow else {
                let slope = &mut slopes[fast.input - fixed];
                let here = row_slope(&fast.row, x, values, along);
                slope.0 = (W::load(&slope.0) + here).store();
                continue;
            };
            let slow_values = lines.split_off(..slow.row.units).unwrap_or_default();
            let fast_values = lines.split_off(..fast.row.units).unwrap_or_default();
            let slow_x = W::load(&inputs[slow.input].0);
            for (i, (row, value)) in along.chunks_exact(fast.row.units).zip(slow_values).enumerate() {
                let value = W::load(&value.0);
                if fast.input >= fixed {
                    let slope = &mut slopes[fast.input - fixed];
                    let here = value * row_slope(&fast.row, x, fast_values, row);
                    slope.0 = (W::load(&slope.0) + here).store();
                }
                if slow.input >= fixed {
                    let slope = &mut slopes[slow.input - fixed];
                    let mut sum = W::splat(-0.0);
                    for (a, v) in row.iter().zip(fast_values) {
                        sum = sum + W::load(&a.0) * W::load(&v.0);
                    }
                    let here = slow.row.slope_lanes(i, slow_x, value) * sum;
                    slope.0 = (W::load(&slope.0) + here).store();
                }
            }
        }
    }

    /// Number of features.
    pub fn len(&self) -> usize {
        self.positions.len()
    }
}

/// The slope along the input `x` of a line with these values, given the slopes along its kernels.
#[inline(always)]
fn row_slope<W: F32x16>(row: &KernelRow, x: W, values: &[Lanes], along: &[Lanes]) -> W {
    let mut sum = W::splat(-0.0);
    for (unit, (value, along)) in values.iter().zip(along).enumerate() {
        sum = sum + W::load(&along.0) * row.slope_lanes(unit, x, W::load(&value.0));
    }
    sum
}

impl MapKernels {
    pub fn units(&self) -> usize {
        self.fast.row.units * self.slow.as_ref().map_or(1, |s| s.row.units)
    }
}
