//! Rollouts (imagined movements), and the slope of their cost along the policy's weights.
//!
//! From a start state the mean policy is rolled out with the movement model, and the reward model gives the
//! cost of each tick. The chain rule is applied backwards through reward, movement and policy (a value gradient
//! in the sense of Heess et al. 2015, with both models learned; `backward.rs`). The last tick may have a larger weight,
//! in place of the ticks that would follow. Commands are limited as the gate limits them.
//!
//! The rollouts of a step do not depend on each other, so sixteen of them are computed side by side, one in each lane.
//! Every sum of a rollout keeps its order, and what rollouts add up to is added in the order of rollouts: the bits are
//! those of one rollout after the other. Both candidates have rollouts to the same targets, and what depends on a
//! target alone is computed once for both.

use tectum_encoder::simd::{F32x8, F32x16, Kernel, SimdPath};

use super::backward::Slopes;
use super::candidate::CandidatePolicy;
use super::lanes::{self, Lanes, ROLLOUTS};
use super::map_features::MapFeatures;
use super::movement_model::MovementModel;
use super::reward_model::RewardModel;
use super::rollout_cost::RolloutCost;
use crate::policy::Outputs;
use crate::{MAX_INPUTS, MAX_OUTPUTS};

/// A state, in the model's order of inputs.
pub(super) type State = [f32; MAX_INPUTS];

/// One tick of sixteen rollouts.
#[derive(Debug, Clone)]
pub(super) struct RolloutTick {
    /// The inputs at its begin.
    pub inputs: [Lanes; MAX_INPUTS],
    pub lines: Vec<Lanes>,
    pub features: Vec<Lanes>,
    /// Factor that normalises the features.
    pub scale: Lanes,
    /// The policy's mean. The gate's limit is not applied yet.
    pub mean: [Lanes; MAX_OUTPUTS],
    pub changes: [Lanes; MAX_INPUTS],
    /// The cost, and its slopes along the moved inputs.
    pub cost: Lanes,
    pub cost_slopes: [Lanes; MAX_INPUTS],
    /// Slopes of all later cost along each output, times the features' scale.
    pub output_slopes: [Lanes; MAX_OUTPUTS],
}

/// What depends on the targets of sixteen rollouts alone.
#[derive(Debug, Clone)]
pub(super) struct RolloutTargets {
    pub inputs: [Lanes; MAX_INPUTS],
    pub lines: Vec<Lanes>,
    pub features: Vec<Lanes>,
    /// The sum of the features' squares.
    pub squares: Lanes,
    pub constant_cost: Lanes,
    /// Coefficients of the cost for the moved inputs' functions.
    pub linear: Vec<Lanes>,
}

/// What rollouts need that is not learned.
#[derive(Debug, Clone)]
pub(super) struct RolloutConstants {
    /// Number of inputs that commands do not move.
    pub fixed: usize,
    pub outputs: usize,
    pub normalise: bool,
    pub last_counts: f32,
    /// Which of the moved inputs wrap.
    pub wraps: Vec<bool>,
    /// Largest command that the gate lets through.
    pub max_command: Outputs,
}

/// Scratch memory for rollouts.
#[derive(Debug, Clone)]
pub(super) struct Rollouts {
    pub constants: RolloutConstants,
    /// Features of the fixed inputs alone, and features that depend on moved inputs.
    pub feature_groups: [MapFeatures; 2],
    pub cost: RolloutCost,
    targets: Vec<RolloutTargets>,
    pub ticks: Vec<RolloutTick>,
    /// The state of sixteen rollouts, and the cost of their last tick.
    state: [Lanes; MAX_INPUTS],
    last_cost: Lanes,
    slopes: Slopes,
}

impl Rollouts {
    /// Memory for `rollouts` rollouts of `horizon` ticks.
    pub fn new(
        feature_groups: [MapFeatures; 2],
        reward: &RewardModel,
        constants: RolloutConstants,
        horizon: usize,
        rollouts: usize,
    ) -> Self {
        let zeros = |len: usize| vec![Lanes::ZERO; len];
        let cost = RolloutCost::of(reward);
        let [of_target, of_tick] = &feature_groups;
        let tick = RolloutTick {
            inputs: [Lanes::ZERO; MAX_INPUTS],
            lines: zeros(of_tick.plane_lines),
            features: zeros(of_tick.len()),
            scale: Lanes::ZERO,
            mean: [Lanes::ZERO; MAX_OUTPUTS],
            changes: [Lanes::ZERO; MAX_INPUTS],
            cost: Lanes::ZERO,
            cost_slopes: [Lanes::ZERO; MAX_INPUTS],
            output_slopes: [Lanes::ZERO; MAX_OUTPUTS],
        };
        let targets = RolloutTargets {
            inputs: [Lanes::ZERO; MAX_INPUTS],
            lines: zeros(of_target.plane_lines),
            features: zeros(of_target.len()),
            squares: Lanes::ZERO,
            constant_cost: Lanes::ZERO,
            linear: zeros(cost.moved_functions()),
        };
        Self {
            constants,
            targets: vec![targets; rollouts.div_ceil(ROLLOUTS)],
            ticks: vec![tick; horizon],
            state: [Lanes::ZERO; MAX_INPUTS],
            last_cost: Lanes::ZERO,
            slopes: Slopes::new(of_tick.len(), horizon),
            cost,
            feature_groups,
        }
    }

    /// Takes over the targets of rollouts, given as states of which the fixed inputs count.
    pub fn set_targets(&mut self, path: SimdPath, starts: &[State]) {
        for (batch, starts) in starts.chunks(ROLLOUTS).enumerate() {
            side_by_side(starts, &mut self.targets[batch].inputs);
            path.run(SetTargets { rollouts: self, batch });
        }
    }

    /// Simulates how `candidate` moves from each of `states` to the target that was set for it, and adds the costs and
    /// their slopes to those of the candidate. The states become those at the end.
    pub fn simulate(
        &mut self,
        path: SimdPath,
        candidate: &mut CandidatePolicy,
        movement: &MovementModel,
        states: &mut [State],
    ) {
        for (batch, states) in states.chunks_mut(ROLLOUTS).enumerate() {
            side_by_side(states, &mut self.state);
            path.run(Simulate { rollouts: self, batch, count: states.len(), candidate, movement });
            for (lane, state) in states.iter_mut().enumerate() {
                for (x, lanes) in state.iter_mut().zip(&self.state) {
                    *x = lanes.0[lane];
                }
                let before = candidate.cost;
                for tick in &self.ticks {
                    candidate.cost += tick.cost.0[lane];
                }
                candidate.cost += (self.constants.last_counts - 1.0) * self.last_cost.0[lane];
                candidate.add_deviation(candidate.cost - before);
            }
        }
    }
}

/// States of at most sixteen rollouts, side by side. Lanes without a rollout repeat the first one.
fn side_by_side(states: &[State], lanes: &mut [Lanes; MAX_INPUTS]) {
    for (i, lanes) in lanes.iter_mut().enumerate() {
        for (lane, x) in lanes.0.iter_mut().enumerate() {
            *x = states.get(lane).unwrap_or(&states[0])[i];
        }
    }
}

/// [`Rollouts::set_targets`] for one batch, whose inputs are set.
struct SetTargets<'a> {
    rollouts: &'a mut Rollouts,
    batch: usize,
}

impl Kernel for SetTargets<'_> {
    type Output = ();
    const IS_WIDE: bool = true;

    #[inline(always)]
    fn run<L: F32x8>(self) {
        let Rollouts { cost, targets, feature_groups, .. } = self.rollouts;
        let target = &mut targets[self.batch];
        target.constant_cost.0 = cost.of_target::<L::Wide>(&target.inputs, &mut target.linear).store();
        let squares: L::Wide = feature_groups[0].encode_lanes(&target.inputs, &mut target.lines, &mut target.features);
        target.squares.0 = squares.store();
    }
}

/// [`Rollouts::simulate`] for one batch, whose state is set.
struct Simulate<'a> {
    rollouts: &'a mut Rollouts,
    batch: usize,
    count: usize,
    candidate: &'a mut CandidatePolicy,
    movement: &'a MovementModel,
}

impl Kernel for Simulate<'_> {
    type Output = ();
    const IS_WIDE: bool = true;

    #[inline(always)]
    fn run<L: F32x8>(self) {
        let Self { rollouts, batch, count, candidate, movement } = self;
        forward::<L::Wide>(rollouts, batch, &candidate.weights, movement);
        let Rollouts { constants, feature_groups, cost, targets, ticks, slopes, .. } = rollouts;
        slopes.backpropagate::<L::Wide>(constants, &feature_groups[1], cost, movement, &candidate.weights[1], ticks);
        slopes.add_to::<L>(&mut candidate.slope, count, constants.outputs, &targets[batch].features, ticks);
    }
}

/// The rollouts of a batch, from the first tick to the last.
#[inline(always)]
fn forward<W: F32x16>(rollouts: &mut Rollouts, batch: usize, weights: &[Vec<f32>; 2], movement: &MovementModel) {
    let Rollouts { constants, feature_groups, cost, targets, ticks, state, last_cost, .. } = rollouts;
    let (fixed, outputs, moved) = (constants.fixed, constants.outputs, constants.wraps.len());
    let target = &targets[batch];
    let mut of_target = [Lanes::ZERO; MAX_OUTPUTS];
    for (output, row) in of_target.iter_mut().zip(weights[0].chunks_exact(target.features.len().max(1))) {
        output.0 = dot::<W>(row, &target.features).store();
    }
    for tick in ticks {
        tick.inputs[..fixed + moved].copy_from_slice(&state[..fixed + moved]);
        let more: W = feature_groups[1].encode_lanes(state, &mut tick.lines, &mut tick.features);
        let scale =
            if constants.normalise { lanes::inverse_root(W::load(&target.squares.0) + more) } else { W::splat(1.0) };
        tick.scale.0 = scale.store();
        let mut applied = [Lanes::ZERO; MAX_OUTPUTS];
        let rows = weights[1].chunks_exact(tick.features.len().max(1));
        for (output, row) in rows.enumerate() {
            let mean = (W::load(&of_target[output].0) + dot::<W>(row, &tick.features)) * scale;
            tick.mean[output].0 = mean.store();
            let limit = constants.max_command[output];
            applied[output].0 = W::splat(limit).min(W::splat(-limit).max(mean)).store();
        }
        for (i, &wraps) in constants.wraps.iter().enumerate() {
            let mut change = W::splat(-0.0);
            for (gain, u) in movement.gains[i].iter().zip(&applied).take(outputs) {
                change = change + W::splat(*gain) * W::load(&u.0);
            }
            // The outputs that the plant does not have: zeros, which turn a sum of -0 into 0.
            if outputs < MAX_OUTPUTS {
                change = change + W::splat(0.0);
            }
            tick.changes[i].0 = change.store();
            let reached = W::load(&state[fixed + i].0) + change;
            state[fixed + i].0 = if wraps { lanes::wrap(reached) } else { reached }.store();
        }
        let (linear, slopes) = (&target.linear, &mut tick.cost_slopes[..moved]);
        let last = W::load(&target.constant_cost.0) + cost.of_tick(&state[fixed..fixed + moved], linear, slopes);
        last_cost.0 = last.store();
        let mut effort = W::splat(-0.0);
        for (i, change) in tick.changes.iter().enumerate().take(moved) {
            let change = W::load(&change.0);
            effort = effort + W::splat(cost.effort(i)) * change * change;
        }
        tick.cost.0 = (last + effort).store();
    }
}

/// The scalar product of a row of weights and the features of sixteen rollouts, in the order of
/// [`dot`](crate::learner::dot): sixteen partial sums, then four.
#[inline(always)]
fn dot<W: F32x16>(weights: &[f32], features: &[Lanes]) -> W {
    let (weights, features) = (weights.as_chunks::<16>(), features.as_chunks::<16>());
    let mut four = [W::splat(0.0); 4];
    for (i, four) in four.iter_mut().enumerate() {
        let mut sums = [W::splat(0.0); 4];
        for (w, f) in weights.0.iter().zip(features.0) {
            for k in 0..4 {
                sums[k] = sums[k] + W::splat(w[4 * k + i]) * W::load(&f[4 * k + i].0);
            }
        }
        *four = ((sums[0] + sums[1]) + sums[2]) + sums[3];
    }
    let mut rest = W::splat(-0.0);
    for (w, f) in weights.1.iter().zip(features.1) {
        rest = rest + W::splat(*w) * W::load(&f.0);
    }
    (four[0] + four[2]) + (four[1] + four[3]) + rest
}
