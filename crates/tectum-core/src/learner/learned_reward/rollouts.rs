//! Imagined movements, and the slope of their cost along the policy's weights.
//!
//! From a state the mean policy is rolled out through the movement model, the reward model says what each tick costs, and
//! the chain rule runs back through reward, movement and policy (a value gradient in the sense of Heess et al. 2015, with
//! both models learned). The last tick may count several times: it stands for those that would follow.

use super::{
    candidate::CandidatePolicy, map_features::MapFeatures, movement_model::MovementModel, reward_model::RewardModel,
};
use crate::learner::{add, dot};
use crate::policy::Outputs;
use crate::{MAX_INPUTS, MAX_OUTPUTS};

/// One imagined tick.
#[derive(Debug, Clone)]
struct RolloutTick {
    values: Vec<f32>,
    slopes: Vec<f32>,
    features: Vec<f32>,
    /// What turns raw features into the policy's.
    scale: f32,
    mean: Outputs,
    changes: [f32; MAX_INPUTS],
    /// Slopes of the tick's cost along the moved inputs.
    cost: [f32; MAX_INPUTS],
}

/// Memory for imagined movements.
#[derive(Debug, Clone)]
pub(super) struct Rollouts {
    still: usize,
    normalise: bool,
    last_counts: f32,
    /// Which of the moved inputs come round.
    wraps: Vec<bool>,
    /// Maps of the still and of the moved inputs.
    pub sights: [MapFeatures; 2],
    moments: Vec<RolloutTick>,
    values: Vec<f32>,
    slopes: Vec<f32>,
    features: Vec<f32>,
    along: Vec<f32>,
    linear: Vec<f32>,
    scratch: Vec<f32>,
}

/// To [-pi, pi).
pub(super) fn wrap(x: f32) -> f32 {
    use std::f32::consts::{PI, TAU};
    x - TAU * ((x + PI) / TAU).floor()
}

impl Rollouts {
    /// Memory for movements of `horizon` ticks.
    pub fn new(
        sights: [MapFeatures; 2],
        reward: &RewardModel,
        wraps: Vec<bool>,
        normalise: bool,
        horizon: usize,
        last_counts: f32,
    ) -> Self {
        let moment = RolloutTick {
            values: vec![0.0; sights[1].lines],
            slopes: vec![0.0; sights[1].lines],
            features: vec![0.0; sights[1].len()],
            scale: 1.0,
            mean: [0.0; MAX_OUTPUTS],
            changes: [0.0; MAX_INPUTS],
            cost: [0.0; MAX_INPUTS],
        };
        Self {
            still: reward.still,
            normalise,
            last_counts,
            wraps,
            moments: vec![moment; horizon],
            values: vec![0.0; sights[0].lines],
            slopes: vec![0.0; sights[0].lines],
            features: vec![0.0; sights[0].len()],
            along: vec![0.0; sights[1].len()],
            linear: vec![0.0; reward.moved_functions()],
            scratch: vec![0.0; reward.moved_functions()],
            sights,
        }
    }

    /// Imagines how `candidate` would move from `inputs` (in the model's order), and adds what it costs and the slope of
    /// that to the candidate's account. Returns where it ended.
    pub fn imagine(
        &mut self,
        candidate: &mut CandidatePolicy,
        reward: &mut RewardModel,
        movement: &MovementModel,
        inputs: &[f32],
    ) -> [f32; MAX_INPUTS] {
        let still = self.still;
        let alone = reward.given(inputs, &mut self.linear);
        let squares = self.sights[0].look(inputs, &mut self.values, &mut self.slopes, &mut self.features);
        let mut given = [0.0; MAX_OUTPUTS];
        for (given, row) in given.iter_mut().zip(candidate.weights[0].chunks_exact(self.features.len().max(1))) {
            *given = dot(row, &self.features);
        }

        let mut last = 0.0;
        let mut state = [0.0; MAX_INPUTS];
        state[..inputs.len()].copy_from_slice(inputs);
        for moment in &mut self.moments {
            let more = self.sights[1].look(&state, &mut moment.values, &mut moment.slopes, &mut moment.features);
            moment.scale = if self.normalise { 1.0 / (squares + more).sqrt() } else { 1.0 };
            let rows = candidate.weights[1].chunks_exact(moment.features.len().max(1));
            for ((mean, given), row) in moment.mean.iter_mut().zip(given).zip(rows) {
                *mean = (given + dot(row, &moment.features)) * moment.scale;
            }
            for (i, &wraps) in self.wraps.iter().enumerate() {
                let change = movement.gains[i].iter().zip(&moment.mean).map(|(b, u)| b * u).sum();
                moment.changes[i] = change;
                let there = state[still + i] + change;
                state[still + i] = if wraps { wrap(there) } else { there };
            }
            let cost = &mut moment.cost[..self.wraps.len()];
            last = alone + reward.slopes(&state[still..], &self.linear, &mut self.scratch, cost);
            let changes = moment.changes.iter().enumerate().take(self.wraps.len());
            candidate.cost += last + changes.map(|(i, c)| reward.effort(i) * c * c).sum::<f32>();
        }
        candidate.cost += (self.last_counts - 1.0) * last;
        self.back(candidate, reward, movement);
        state
    }

    /// Runs back through the moments.
    fn back(&mut self, candidate: &mut CandidatePolicy, reward: &RewardModel, movement: &MovementModel) {
        let (moved, normalise) = (self.wraps.len(), self.normalise);
        // Slopes of all later cost along the moved inputs.
        let mut later = [0.0; MAX_INPUTS];
        let mut given = [0.0; MAX_OUTPUTS];
        let mut times = self.last_counts;
        for moment in self.moments.iter().rev() {
            let mut output = [0.0; MAX_OUTPUTS];
            let costs = later.iter_mut().zip(moment.cost).zip(moment.changes).take(moved);
            for (i, ((later, cost), change)) in costs.enumerate() {
                *later += times * cost;
                let along = *later + 2.0 * reward.effort(i) * change;
                for (o, b) in output.iter_mut().zip(&movement.gains[i]) {
                    *o += along * b;
                }
            }
            times = 1.0;
            let scale = moment.scale;
            let pull: f32 = moment.mean.iter().zip(&output).map(|(u, o)| u * o).sum();
            let pull = if normalise { pull * scale * scale } else { 0.0 };
            for (along, f) in self.along.iter_mut().zip(&moment.features) {
                *along = -pull * f;
            }
            for (g, given) in given.iter_mut().zip(output) {
                *g += given * scale;
            }
            let n = moment.features.len().max(1);
            let rows = candidate.weights[1].chunks_exact(n).zip(candidate.slope[1].chunks_exact_mut(n));
            for ((weights, slope), output) in rows.zip(output) {
                add(slope, &moment.features, output * scale);
                add(&mut self.along, weights, output * scale);
            }
            self.sights[1].back(&moment.values, &moment.slopes, &self.along, self.still, &mut later);
        }
        for (slope, given) in candidate.slope[0].chunks_exact_mut(self.features.len().max(1)).zip(given) {
            add(slope, &self.features, given);
        }
    }
}
