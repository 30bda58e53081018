//! The slopes of rollouts: from the last tick to the first, through reward, movement and policy.

use tectum_encoder::simd::{F32x8, F32x16};

use super::lanes::{self, Lanes, ROLLOUTS};
use super::map_features::MapFeatures;
use super::movement_model::MovementModel;
use super::rollout_cost::RolloutCost;
use super::rollouts::{RolloutConstants, RolloutTick};
use crate::{MAX_INPUTS, MAX_OUTPUTS};

/// Outputs whose slopes are summed at the same time.
const OUTPUTS: usize = 4;

/// Features whose slopes are summed at the same time.
const FEATURES: usize = 4;

/// Scratch memory for slopes.
#[derive(Debug, Clone)]
pub(super) struct Slopes {
    /// Slopes along the features of a tick.
    along_features: Vec<Lanes>,
    /// By output: the slope along the features of the target.
    of_target: [Lanes; MAX_OUTPUTS],
    /// By tick: sixteen features of each rollout, side by side.
    rows: Vec<[Lanes; ROLLOUTS]>,
}

impl Slopes {
    /// Memory for rollouts of `horizon` ticks with `features` features.
    pub fn new(features: usize, horizon: usize) -> Self {
        Self {
            along_features: vec![Lanes::ZERO; features],
            of_target: [Lanes::ZERO; MAX_OUTPUTS],
            rows: vec![[Lanes::ZERO; ROLLOUTS]; horizon.max(1)],
        }
    }

    /// Back-propagation through all ticks: computes their output slopes and those of the target.
    #[inline(always)]
    pub fn backpropagate<W: F32x16>(
        &mut self,
        constants: &RolloutConstants,
        features: &MapFeatures,
        cost: &RolloutCost,
        movement: &MovementModel,
        weights: &[f32],
        ticks: &mut [RolloutTick],
    ) {
        // Slopes of all later cost along the moved inputs.
        let mut later = [Lanes::ZERO; MAX_INPUTS];
        self.of_target = [Lanes::ZERO; MAX_OUTPUTS];
        let mut weight = constants.last_counts;
        for tick in ticks.iter_mut().rev() {
            let mut slopes = [Lanes::ZERO; MAX_OUTPUTS];
            for (i, later) in later.iter_mut().enumerate().take(constants.wraps.len()) {
                let all = W::load(&later.0) + W::splat(weight) * W::load(&tick.cost_slopes[i].0);
                later.0 = all.store();
                let along = all + W::splat(2.0 * cost.effort(i)) * W::load(&tick.changes[i].0);
                for (slope, gain) in slopes.iter_mut().zip(&movement.gains[i]).take(constants.outputs) {
                    slope.0 = (W::load(&slope.0) + along * W::splat(*gain)).store();
                }
            }
            weight = 1.0;
            let minus_norm_slope = output_slopes::<W>(constants, tick, &mut slopes);
            for (sum, slope) in self.of_target.iter_mut().zip(&tick.output_slopes).take(constants.outputs) {
                sum.0 = (W::load(&sum.0) + W::load(&slope.0)).store();
            }
            slopes_of_features::<W>(minus_norm_slope, weights, tick, &mut self.along_features);
            let inputs = [&tick.inputs[..], &tick.lines, &tick.features, &self.along_features];
            features.backpropagate_lanes::<W>(inputs, constants.fixed, &mut later);
        }
    }

    /// Adds the slopes of `count` rollouts along the weights to `slope`, by feature group: rollout after rollout, and
    /// in each from the last tick to the first.
    #[inline(always)]
    pub fn add_to<L: F32x8>(
        &mut self,
        slope: &mut [Vec<f32>; 2],
        count: usize,
        outputs: usize,
        target: &[Lanes],
        ticks: &[RolloutTick],
    ) {
        let [of_target, of_ticks] = slope;
        let once = std::iter::once((target, &self.of_target));
        add_slopes::<L>(once, count, outputs, &mut self.rows, of_target);
        let each = ticks.iter().rev().map(|tick| (&tick.features[..], &tick.output_slopes));
        add_slopes::<L>(each, count, outputs, &mut self.rows, of_ticks);
    }
}

/// Turns the slopes along the applied commands into the output slopes of `tick`. Returns the slope along the norm of
/// the features, with its sign turned.
#[inline(always)]
fn output_slopes<W: F32x16>(
    constants: &RolloutConstants,
    tick: &mut RolloutTick,
    slopes: &mut [Lanes; MAX_OUTPUTS],
) -> W {
    let scale = W::load(&tick.scale.0);
    let mut norm_slope = W::splat(-0.0);
    for (output, slope) in slopes.iter_mut().enumerate().take(constants.outputs) {
        // A command beyond the gate's limit has no effect by how far it is beyond. Its slope counts only where
        // the descent, which goes against the slope, leads back.
        let limit = constants.max_command[output];
        for (slope, mean) in slope.0.iter_mut().zip(&tick.mean[output].0) {
            let leads_out = (mean.abs() > limit) & (*slope * mean < 0.0);
            *slope = if leads_out { 0.0 } else { *slope };
        }
        let slope = W::load(&slope.0);
        norm_slope = norm_slope + W::load(&tick.mean[output].0) * slope;
        tick.output_slopes[output].0 = (slope * scale).store();
    }
    // As in the forward pass.
    if constants.outputs < MAX_OUTPUTS {
        norm_slope = norm_slope + W::splat(0.0);
    }
    let norm_slope = if constants.normalise { norm_slope * scale * scale } else { W::splat(0.0) };
    norm_slope * W::splat(-1.0)
}

/// The slopes along the features of a tick: through their norm, and through the outputs with these weights.
#[inline(always)]
fn slopes_of_features<W: F32x16>(minus_norm_slope: W, weights: &[f32], tick: &RolloutTick, along: &mut [Lanes]) {
    let n = along.len();
    let (blocks, rest) = along.as_chunks_mut::<FEATURES>();
    for (block, at) in blocks.iter_mut().zip((0..).step_by(FEATURES)) {
        let mut sums = [minus_norm_slope; FEATURES];
        for (sum, feature) in sums.iter_mut().zip(&tick.features[at..]) {
            *sum = *sum * W::load(&feature.0);
        }
        for (row, slope) in weights.chunks_exact(n).zip(&tick.output_slopes) {
            let slope = W::load(&slope.0);
            for (sum, w) in sums.iter_mut().zip(&row[at..at + FEATURES]) {
                *sum = *sum + slope * W::splat(*w);
            }
        }
        for (along, sum) in block.iter_mut().zip(sums) {
            along.0 = sum.store();
        }
    }
    for (along, at) in rest.iter_mut().zip(n - n % FEATURES..) {
        let mut sum = minus_norm_slope * W::load(&tick.features[at].0);
        for (row, slope) in weights.chunks_exact(n).zip(&tick.output_slopes) {
            sum = sum + W::load(&slope.0) * W::splat(row[at]);
        }
        along.0 = sum.store();
    }
}

/// Adds features times output slopes to `slope`, output by output, for each of `count` rollouts and in each for all
/// `ticks`. Features come by lanes of rollouts and are needed rollout by rollout: they are transposed in blocks.
#[inline(always)]
fn add_slopes<'a, L: F32x8>(
    ticks: impl Iterator<Item = (&'a [Lanes], &'a [Lanes; MAX_OUTPUTS])> + Clone,
    count: usize,
    outputs: usize,
    rows: &mut [[Lanes; ROLLOUTS]],
    slope: &mut [f32],
) {
    let n = slope.len() / outputs;
    for start in (0..n).step_by(ROLLOUTS) {
        let width = (n - start).min(ROLLOUTS);
        for (rows, (features, _)) in rows.iter_mut().zip(ticks.clone()) {
            if let Some(block) = features[start..].first_chunk() {
                lanes::transpose::<L>(block, rows);
            } else {
                let mut block = [Lanes::ZERO; ROLLOUTS];
                block[..width].copy_from_slice(&features[start..]);
                lanes::transpose::<L>(&block, rows);
            }
        }
        let mut output = 0;
        while output < outputs {
            let step = if outputs - output >= OUTPUTS { OUTPUTS } else { 1 };
            let here = &mut slope[output * n..][..step * n];
            let slopes = ticks.clone().map(|(_, slopes)| slopes);
            let at = [start, width, count, output];
            if step == OUTPUTS {
                add_block::<L::Wide, OUTPUTS>(rows, slopes, at, here);
            } else {
                add_block::<L::Wide, 1>(rows, slopes, at, here);
            }
            output += step;
        }
    }
}

/// One block of features and `N` outputs, the first of which is `output`: the sums stay in registers.
#[inline(always)]
fn add_block<'a, W: F32x16, const N: usize>(
    rows: &[[Lanes; ROLLOUTS]],
    slopes: impl Iterator<Item = &'a [Lanes; MAX_OUTPUTS]> + Clone,
    [start, width, count, output]: [usize; 4],
    slope: &mut [f32],
) {
    let n = slope.len() / N;
    let mut sums = [W::splat(0.0); N];
    for k in 0..N {
        let mut block = [0.0; ROLLOUTS];
        block[..width].copy_from_slice(&slope[k * n + start..][..width]);
        sums[k] = W::load(&block);
    }
    for rollout in 0..count {
        for (rows, slopes) in rows.iter().zip(slopes.clone()) {
            let row = W::load(&rows[rollout].0);
            for k in 0..N {
                sums[k] = sums[k] + W::splat(slopes[output + k].0[rollout]) * row;
            }
        }
    }
    for k in 0..N {
        slope[k * n + start..][..width].copy_from_slice(&sums[k].store()[..width]);
    }
}
