//! A policy's weights while it is rehearsed: with the slope along them, and Adam (Kingma & Ba 2015) to descend it.

use rand::RngExt as _;

use super::map_features::MapFeatures;
use crate::MAX_INPUTS;
use crate::policy::LinearPolicy;
use crate::seed::Rng;
use crate::state::{Persist, StateVisitor};

/// Adam's decays, and what keeps its quotient finite.
const DECAYS: [f32; 2] = [0.9, 0.999];
const TINY: f32 = 1e-8;
/// Largest weight at birth: outputs that answer alike must not stay alike.
const UNEQUAL: f32 = 5e-3;

/// A policy in rehearsal.
#[derive(Debug, Clone)]
pub(super) struct CandidatePolicy {
    /// By sight: output by output, feature by feature.
    pub weights: [Vec<f32>; 2],
    /// The slope of the imagined cost along them, summed up since the last step, and that cost.
    pub slope: [Vec<f32>; 2],
    pub cost: f32,
    /// Where its last imagined movements ended.
    pub ends: Vec<[f32; MAX_INPUTS]>,
    /// Adam's moments, and what is left of their start at 0.
    means: [Vec<f32>; 2],
    squares: [Vec<f32>; 2],
    starts: [f32; 2],
    /// Ticks since it was born or the world changed.
    pub age: u64,
    /// Running mean of the cost of a movement.
    pub mean_cost: f32,
}

/// Share of the newest tick in the running mean of the cost.
const NEWEST: f32 = 0.02;

impl CandidatePolicy {
    /// All weights 0.
    pub fn new(sights: &[MapFeatures; 2], outputs: usize, movements: usize) -> Self {
        let zeros = || [vec![0.0; sights[0].len() * outputs], vec![0.0; sights[1].len() * outputs]];
        Self {
            weights: zeros(),
            slope: zeros(),
            cost: 0.0,
            ends: vec![[0.0; MAX_INPUTS]; movements],
            means: zeros(),
            squares: zeros(),
            starts: [1.0; 2],
            age: 0,
            mean_cost: 0.0,
        }
    }

    /// Starts again from small random weights.
    pub fn be_born(&mut self, rng: &mut Rng) {
        for w in self.weights.iter_mut().flatten() {
            *w = UNEQUAL * (2.0 * rng.random::<f32>() - 1.0);
        }
        for values in self.means.iter_mut().chain(&mut self.squares).chain(&mut self.slope) {
            values.fill(0.0);
        }
        (self.starts, self.age, self.cost, self.mean_cost) = ([1.0; 2], 0, 0.0, 0.0);
    }

    /// Becomes what `other` is, without allocating.
    pub fn become_like(&mut self, other: &Self) {
        for sight in 0..2 {
            self.weights[sight].copy_from_slice(&other.weights[sight]);
            self.means[sight].copy_from_slice(&other.means[sight]);
            self.squares[sight].copy_from_slice(&other.squares[sight]);
        }
        self.ends.copy_from_slice(&other.ends);
        (self.starts, self.age, self.mean_cost) = (other.starts, other.age, other.mean_cost);
    }

    /// Takes over the weights of `policy`.
    pub fn take(&mut self, policy: &LinearPolicy, sights: &[MapFeatures; 2]) {
        for (sight, weights) in sights.iter().zip(&mut self.weights) {
            for (output, row) in weights.chunks_exact_mut(sight.len().max(1)).enumerate() {
                for (to, &at) in row.iter_mut().zip(&sight.positions) {
                    *to = policy.weights().get(output, at);
                }
            }
        }
    }

    /// Gives the weights to `policy`.
    pub fn give(&self, policy: &mut LinearPolicy, sights: &[MapFeatures; 2]) {
        for (sight, weights) in sights.iter().zip(&self.weights) {
            for (output, row) in weights.chunks_exact(sight.len().max(1)).enumerate() {
                for (from, &at) in row.iter().zip(&sight.positions) {
                    *policy.weights_mut().get_mut(output, at) = *from;
                }
            }
        }
    }

    /// Takes the cost since the last call, of `movements` movements, into the running mean.
    pub fn settle(&mut self, movements: usize) {
        let cost = self.cost / movements as f32;
        if cost.is_finite() {
            self.mean_cost += if self.mean_cost == 0.0 { cost } else { NEWEST * (cost - self.mean_cost) };
        }
        self.cost = 0.0;
        self.age += 1;
    }

    /// One step of size `step` down the slope that was summed up over `ticks` imagined ticks. Returns the norm of the
    /// mean slope; one that is not finite is dropped and changes nothing.
    pub fn descend(&mut self, sights: &mut [MapFeatures; 2], ticks: usize, step: f32) -> f32 {
        let squares: f32 = self.slope.iter().flatten().map(|s| s * s).sum();
        let norm = squares.sqrt() / ticks as f32;
        if !norm.is_finite() {
            self.slope.iter_mut().flatten().for_each(|s| *s = 0.0);
            return norm;
        }
        let share = 1.0 / (ticks as f32 * norm.max(1.0));
        let [b1, b2] = DECAYS;
        self.starts[0] *= b1;
        self.starts[1] *= b2;
        let (c1, c2) = (1.0 / (1.0 - self.starts[0]), 1.0 / (1.0 - self.starts[1]));
        for (i, sight) in sights.iter_mut().enumerate() {
            let n = sight.len().max(1);
            let rows = self.weights[i].chunks_exact_mut(n).zip(self.slope[i].chunks_exact_mut(n));
            let moments = self.means[i].chunks_exact_mut(n).zip(self.squares[i].chunks_exact_mut(n));
            for ((weights, slopes), (means, squares)) in rows.zip(moments) {
                sight.whiten(slopes);
                for ((slope, mean), square) in slopes.iter_mut().zip(means).zip(squares) {
                    let s = *slope * share;
                    *mean = *mean * b1 + s * (1.0 - b1);
                    *square = *square * b2 + s * s * (1.0 - b2);
                    *slope = *mean * (step * c1) / ((*square * c2).sqrt() + TINY);
                }
                sight.unwhiten(slopes);
                for (w, step) in weights.iter_mut().zip(slopes) {
                    *w -= *step;
                    *step = 0.0;
                }
            }
        }
        norm
    }
}

impl Persist for CandidatePolicy {
    /// At the end of a tick the slope is used up.
    fn visit_state(&mut self, visitor: &mut dyn StateVisitor) {
        for sight in 0..2 {
            visitor.numbers("weights", &mut self.weights[sight]);
            visitor.numbers("means", &mut self.means[sight]);
            visitor.numbers("squares", &mut self.squares[sight]);
        }
        visitor.number("cost", &mut self.cost);
        visitor.numbers("ends", &mut self.ends);
        visitor.numbers("starts", &mut self.starts);
        visitor.number("age", &mut self.age);
        visitor.number("mean_cost", &mut self.mean_cost);
    }
}
