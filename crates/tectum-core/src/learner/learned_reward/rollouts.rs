//! Rollouts (imagined movements), and the slope of their cost along the policy's weights.
//!
//! From a start state the mean policy is rolled out with the movement model, and the reward model gives the
//! cost of each tick. The chain rule is applied backwards through reward, movement and policy (a value gradient
//! in the sense of Heess et al. 2015, with both models learned). The last tick may have a larger weight, in
//! place of the ticks that would follow. Commands are limited as the gate limits them.

use super::{
    candidate::CandidatePolicy, map_features::MapFeatures, movement_model::MovementModel, reward_model::RewardModel,
};
use crate::angle::wrap;
use crate::learner::{add, dot};
use crate::policy::Outputs;
use crate::{MAX_INPUTS, MAX_OUTPUTS};

/// One tick of a rollout.
#[derive(Debug, Clone)]
struct RolloutTick {
    values: Vec<f32>,
    slopes: Vec<f32>,
    features: Vec<f32>,
    /// Factor that normalises the features.
    scale: f32,
    /// The policy's mean. The gate's limit is not applied yet.
    mean: Outputs,
    changes: [f32; MAX_INPUTS],
    /// Slopes of the tick's cost along the moved inputs.
    cost_slopes: [f32; MAX_INPUTS],
}

/// Scratch memory for rollouts.
#[derive(Debug, Clone)]
pub(super) struct Rollouts {
    /// Number of inputs that commands do not move.
    fixed: usize,
    normalise: bool,
    last_counts: f32,
    /// Which of the moved inputs wrap.
    wraps: Vec<bool>,
    /// Largest command that the gate lets through.
    max_command: Outputs,
    /// Features of the fixed inputs alone, and features that depend on moved inputs.
    pub feature_groups: [MapFeatures; 2],
    ticks: Vec<RolloutTick>,
    values: Vec<f32>,
    slopes: Vec<f32>,
    features: Vec<f32>,
    feature_slopes: Vec<f32>,
    linear: Vec<f32>,
    scratch: Vec<f32>,
}

impl Rollouts {
    /// Memory for rollouts of `horizon` ticks.
    pub fn new(
        feature_groups: [MapFeatures; 2],
        reward: &RewardModel,
        wraps: Vec<bool>,
        max_command: Outputs,
        normalise: bool,
        horizon: usize,
        last_counts: f32,
    ) -> Self {
        let tick = RolloutTick {
            values: vec![0.0; feature_groups[1].lines],
            slopes: vec![0.0; feature_groups[1].lines],
            features: vec![0.0; feature_groups[1].len()],
            scale: 1.0,
            mean: [0.0; MAX_OUTPUTS],
            changes: [0.0; MAX_INPUTS],
            cost_slopes: [0.0; MAX_INPUTS],
        };
        Self {
            fixed: reward.fixed,
            normalise,
            last_counts,
            wraps,
            max_command,
            ticks: vec![tick; horizon],
            values: vec![0.0; feature_groups[0].lines],
            slopes: vec![0.0; feature_groups[0].lines],
            features: vec![0.0; feature_groups[0].len()],
            feature_slopes: vec![0.0; feature_groups[1].len()],
            linear: vec![0.0; reward.moved_functions()],
            scratch: vec![0.0; reward.moved_functions()],
            feature_groups,
        }
    }

    /// Simulates how `candidate` moves from `inputs` (in the model's order), and adds the cost and its slope to
    /// those of the candidate. Returns the end state.
    pub fn simulate(
        &mut self,
        candidate: &mut CandidatePolicy,
        reward: &mut RewardModel,
        movement: &MovementModel,
        inputs: &[f32],
    ) -> [f32; MAX_INPUTS] {
        let fixed = self.fixed;
        let constant_cost = reward.linear_cost(inputs, &mut self.linear);
        let squares = self.feature_groups[0].encode(inputs, &mut self.values, &mut self.slopes, &mut self.features);
        let mut fixed_output = [0.0; MAX_OUTPUTS];
        for (output, row) in fixed_output.iter_mut().zip(candidate.weights[0].chunks_exact(self.features.len().max(1)))
        {
            *output = dot(row, &self.features);
        }

        let mut last = 0.0;
        let mut state = [0.0; MAX_INPUTS];
        state[..inputs.len()].copy_from_slice(inputs);
        for tick in &mut self.ticks {
            let more = self.feature_groups[1].encode(&state, &mut tick.values, &mut tick.slopes, &mut tick.features);
            tick.scale = if self.normalise { 1.0 / (squares + more).sqrt() } else { 1.0 };
            let rows = candidate.weights[1].chunks_exact(tick.features.len().max(1));
            for ((mean, fixed_output), row) in tick.mean.iter_mut().zip(fixed_output).zip(rows) {
                *mean = (fixed_output + dot(row, &tick.features)) * tick.scale;
            }
            let limits = tick.mean.iter().zip(&self.max_command);
            let mut applied = [0.0; MAX_OUTPUTS];
            applied.iter_mut().zip(limits).for_each(|(u, (mean, limit))| *u = mean.clamp(-limit, *limit));
            for (i, &wraps) in self.wraps.iter().enumerate() {
                let change = movement.gains[i].iter().zip(&applied).map(|(b, u)| b * u).sum();
                tick.changes[i] = change;
                let reached = state[fixed + i] + change;
                state[fixed + i] = if wraps { wrap(reached) } else { reached };
            }
            let cost_slopes = &mut tick.cost_slopes[..self.wraps.len()];
            last = constant_cost + reward.cost_slopes(&state[fixed..], &self.linear, &mut self.scratch, cost_slopes);
            let changes = tick.changes.iter().enumerate().take(self.wraps.len());
            candidate.cost += last + changes.map(|(i, c)| reward.effort(i) * c * c).sum::<f32>();
        }
        candidate.cost += (self.last_counts - 1.0) * last;
        self.backpropagate(candidate, reward, movement);
        state
    }

    /// Back-propagation through all ticks: adds the slope of the cost along the weights to that of `candidate`.
    fn backpropagate(&mut self, candidate: &mut CandidatePolicy, reward: &RewardModel, movement: &MovementModel) {
        let (moved, normalise) = (self.wraps.len(), self.normalise);
        // Slopes of all later cost along the moved inputs.
        let mut later = [0.0; MAX_INPUTS];
        let mut fixed_slopes = [0.0; MAX_OUTPUTS];
        let mut weight = self.last_counts;
        for tick in self.ticks.iter().rev() {
            let mut output_slopes = [0.0; MAX_OUTPUTS];
            let costs = later.iter_mut().zip(tick.cost_slopes).zip(tick.changes).take(moved);
            for (i, ((later, cost), change)) in costs.enumerate() {
                *later += weight * cost;
                let along = *later + 2.0 * reward.effort(i) * change;
                for (o, b) in output_slopes.iter_mut().zip(&movement.gains[i]) {
                    *o += along * b;
                }
            }
            weight = 1.0;
            // A command beyond the gate's limit has no effect by how far it is beyond. Its slope counts only where
            // the descent, which goes against the slope, leads back.
            for ((slope, &mean), limit) in output_slopes.iter_mut().zip(&tick.mean).zip(&self.max_command) {
                if mean.abs() > *limit && *slope * mean < 0.0 {
                    *slope = 0.0;
                }
            }
            let scale = tick.scale;
            // The slope through the norm of the features.
            let norm_slope: f32 = tick.mean.iter().zip(&output_slopes).map(|(u, o)| u * o).sum();
            let norm_slope = if normalise { norm_slope * scale * scale } else { 0.0 };
            for (along, f) in self.feature_slopes.iter_mut().zip(&tick.features) {
                *along = -norm_slope * f;
            }
            for (sum, slope) in fixed_slopes.iter_mut().zip(output_slopes) {
                *sum += slope * scale;
            }
            let n = tick.features.len().max(1);
            let rows = candidate.weights[1].chunks_exact(n).zip(candidate.slope[1].chunks_exact_mut(n));
            for ((weights, slope), output) in rows.zip(output_slopes) {
                add(slope, &tick.features, output * scale);
                add(&mut self.feature_slopes, weights, output * scale);
            }
            let slopes = &self.feature_slopes;
            self.feature_groups[1].backpropagate(&tick.values, &tick.slopes, slopes, self.fixed, &mut later);
        }
        for (slope, output) in candidate.slope[0].chunks_exact_mut(self.features.len().max(1)).zip(fixed_slopes) {
            add(slope, &self.features, output);
        }
    }
}
