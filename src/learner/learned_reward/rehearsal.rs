//! Imagined movements, and the slope of their cost along the policy's weights.
//!
//! From a state the mean policy is rolled out through the movement model, the reward model says what each tick costs, and
//! the chain rule runs back through reward, movement and policy (a value gradient in the sense of Heess et al. 2015, with
//! both models learned). The last tick may count several times: it stands for those that would follow.

use super::{movement::Movement, reward::Reward, sight::Sight};
use crate::policy::{Linear, Outputs};
use crate::wire::{MAX_INPUTS, MAX_OUTPUTS};

/// One imagined tick.
#[derive(Debug, Clone)]
struct Moment {
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

/// Memory for imagined movements, and the slope that they add up to.
#[derive(Debug, Clone)]
pub(super) struct Rehearsal {
    still: usize,
    normalise: bool,
    last_counts: f32,
    /// Which of the moved inputs come round.
    wraps: Vec<bool>,
    /// Maps of the still and of the moved inputs.
    sights: [Sight; 2],
    /// By sight: the policy's weights, output by output, and the slope along them.
    weights: [Vec<f32>; 2],
    pub slope: [Vec<f32>; 2],
    moments: Vec<Moment>,
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

impl Rehearsal {
    /// Memory for movements of `horizon` ticks.
    pub fn new(
        sights: [Sight; 2],
        reward: &Reward,
        outputs: usize,
        wraps: Vec<bool>,
        normalise: bool,
        horizon: usize,
        last_counts: f32,
    ) -> Self {
        let zeros = |sight: &Sight| vec![0.0; sight.len() * outputs];
        let moment = Moment {
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
            weights: [zeros(&sights[0]), zeros(&sights[1])],
            slope: [zeros(&sights[0]), zeros(&sights[1])],
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

    /// Takes over the weights of `policy` and starts a new sum of slopes.
    pub fn begin(&mut self, policy: &mut Linear) {
        for (sight, weights) in self.sights.iter().zip(&mut self.weights) {
            for (output, row) in weights.chunks_exact_mut(sight.len().max(1)).enumerate() {
                let from = policy.groups_mut().nth(output / 4).unwrap_or_default();
                for (to, &at) in row.iter_mut().zip(&sight.positions) {
                    *to = from[at][output % 4];
                }
            }
        }
        self.slope.iter_mut().for_each(|slope| slope.fill(0.0));
    }

    /// Gives the weights back to `policy`.
    pub fn end(&self, policy: &mut Linear) {
        for (sight, weights) in self.sights.iter().zip(&self.weights) {
            for (output, row) in weights.chunks_exact(sight.len().max(1)).enumerate() {
                let to = policy.groups_mut().nth(output / 4).unwrap_or_default();
                for (from, &at) in row.iter().zip(&sight.positions) {
                    to[at][output % 4] = *from;
                }
            }
        }
    }

    /// By sight: where the features stand in the policy.
    #[cfg(test)]
    pub fn positions(&self) -> [&[usize]; 2] {
        [&self.sights[0].positions, &self.sights[1].positions]
    }

    /// The weights and the slope that has been summed up along them.
    pub fn both(&mut self) -> impl Iterator<Item = (&mut Vec<f32>, &mut Vec<f32>)> {
        self.weights.iter_mut().zip(&mut self.slope)
    }

    /// Imagines a movement that starts from `inputs` (in the model's order) and adds the slope of its cost. Returns the
    /// cost's gradient only; what it costs is nowhere needed.
    pub fn imagine(&mut self, reward: &mut Reward, movement: &Movement, inputs: &[f32]) {
        let still = self.still;
        reward.given(inputs, &mut self.linear);
        let squares = self.sights[0].look(inputs, &mut self.values, &mut self.slopes, &mut self.features);
        let mut given = [0.0; MAX_OUTPUTS];
        for (given, row) in given.iter_mut().zip(self.weights[0].chunks_exact(self.features.len().max(1))) {
            *given = dot(row, &self.features);
        }

        let mut state = [0.0; MAX_INPUTS];
        state[..inputs.len()].copy_from_slice(inputs);
        for moment in &mut self.moments {
            let more = self.sights[1].look(&state, &mut moment.values, &mut moment.slopes, &mut moment.features);
            moment.scale = if self.normalise { 1.0 / (squares + more).sqrt() } else { 1.0 };
            let rows = self.weights[1].chunks_exact(moment.features.len().max(1));
            for ((mean, given), row) in moment.mean.iter_mut().zip(given).zip(rows) {
                *mean = (given + dot(row, &moment.features)) * moment.scale;
            }
            for (i, &wraps) in self.wraps.iter().enumerate() {
                let change = movement.gains[i].iter().zip(&moment.mean).map(|(b, u)| b * u).sum();
                moment.changes[i] = change;
                let there = state[still + i] + change;
                state[still + i] = if wraps { wrap(there) } else { there };
            }
            reward.slopes(&state[still..], &self.linear, &mut self.scratch, &mut moment.cost[..self.wraps.len()]);
        }
        self.back(reward, movement);
    }

    /// Runs back through the moments.
    fn back(&mut self, reward: &Reward, movement: &Movement) {
        let (moved, normalise) = (self.wraps.len(), self.normalise);
        // Slopes of all later cost along the moved inputs.
        let mut later = [0.0; MAX_INPUTS];
        let mut given = [0.0; MAX_OUTPUTS];
        let mut times = self.last_counts;
        for moment in self.moments.iter().rev() {
            let mut output = [0.0; MAX_OUTPUTS];
            for i in 0..moved {
                later[i] += times * moment.cost[i];
                let change = later[i] + 2.0 * reward.effort(i) * moment.changes[i];
                for (o, b) in output.iter_mut().zip(&movement.gains[i]) {
                    *o += change * b;
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
            let rows = self.weights[1].chunks_exact(n).zip(self.slope[1].chunks_exact_mut(n));
            for ((weights, slope), output) in rows.zip(output) {
                add(slope, &moment.features, output * scale);
                add(&mut self.along, weights, output * scale);
            }
            self.sights[1].back(&moment.values, &moment.slopes, &self.along, self.still, &mut later);
        }
        for (slope, given) in self.slope[0].chunks_exact_mut(self.features.len().max(1)).zip(given) {
            add(slope, &self.features, given);
        }
    }
}

/// `to += factor * from`.
fn add(to: &mut [f32], from: &[f32], factor: f32) {
    for (t, f) in to.iter_mut().zip(from) {
        *t += factor * f;
    }
}

/// The sum of products, in a fixed order.
fn dot(a: &[f32], b: &[f32]) -> f32 {
    let (a, b) = (a.as_chunks::<16>(), b.as_chunks::<16>());
    let mut sums = [0.0; 16];
    for (a, b) in a.0.iter().zip(b.0) {
        for i in 0..16 {
            sums[i] += a[i] * b[i];
        }
    }
    let rest: f32 = a.1.iter().zip(b.1).map(|(a, b)| a * b).sum();
    let [mut four, more @ ..]: [[f32; 4]; 4] = bytemuck::cast(sums);
    for more in more {
        for i in 0..4 {
            four[i] += more[i];
        }
    }
    (four[0] + four[2]) + (four[1] + four[3]) + rest
}
