//! A candidate policy: weights, the slope of the cost of rollouts along them, and Adam (Kingma & Ba 2015) to
//! descend it.

use rand::RngExt as _;
use tectum_encoder::simd::{F32x8, Kernel, SimdPath};

use super::map_features::MapFeatures;
use crate::MAX_INPUTS;
use crate::policy::LinearPolicy;
use crate::seed::Rng;
use crate::state::{Persist, StateVisitor};

/// Adam's decays of mean and square, and the constant that keeps its quotient finite.
const DECAYS: [f32; 2] = [0.9, 0.999];
const TINY: f32 = 1e-8;
/// Largest initial weight. Initial weights are random, because outputs with equal weights would stay equal.
const INITIAL_WEIGHT: f32 = 5e-3;

/// A candidate policy, improved by rollouts.
#[derive(Debug, Clone)]
pub(super) struct CandidatePolicy {
    /// By feature group, output by output, feature by feature.
    pub weights: [Vec<f32>; 2],
    /// Slope of the rollouts' cost along the weights, summed since the last step, and the cost, summed since
    /// the last tick.
    pub slope: [Vec<f32>; 2],
    pub cost: f32,
    /// The states in which its latest rollouts ended.
    pub end_states: Vec<[f32; MAX_INPUTS]>,
    /// Adam's moments, and the powers of its decays that correct their start at 0.
    means: [Vec<f32>; 2],
    squares: [Vec<f32>; 2],
    decay_powers: [f32; 2],
    /// Ticks since its weights were reset or the world changed.
    pub age: u64,
    /// Running mean of the cost of a rollout.
    pub mean_cost: f32,
    /// Running mean of how far the cost of a rollout is from that mean, and the sum over this tick.
    pub cost_spread: f32,
    deviation: f32,
}

/// Weight of the newest tick in the running mean of the cost.
const COST_RATE: f32 = 0.02;

impl CandidatePolicy {
    /// All weights 0.
    pub fn new(groups: &[MapFeatures; 2], outputs: usize, movements: usize) -> Self {
        let zeros = || [vec![0.0; groups[0].len() * outputs], vec![0.0; groups[1].len() * outputs]];
        Self {
            weights: zeros(),
            slope: zeros(),
            cost: 0.0,
            end_states: vec![[0.0; MAX_INPUTS]; movements],
            means: zeros(),
            squares: zeros(),
            decay_powers: [1.0; 2],
            age: 0,
            mean_cost: 0.0,
            cost_spread: 0.0,
            deviation: 0.0,
        }
    }

    /// Forgets what rollouts cost, but not the weights.
    pub fn forget_costs(&mut self) {
        (self.cost, self.mean_cost, self.cost_spread, self.deviation) = (0.0, 0.0, 0.0, 0.0);
    }

    /// Takes in that a rollout of this tick had `cost`.
    pub fn add_deviation(&mut self, cost: f32) {
        self.deviation += (cost - self.mean_cost).abs();
    }

    /// Restarts from small random weights.
    pub fn reset(&mut self, rng: &mut Rng) {
        for w in self.weights.iter_mut().flatten() {
            *w = INITIAL_WEIGHT * (2.0 * rng.random::<f32>() - 1.0);
        }
        for values in self.means.iter_mut().chain(&mut self.squares).chain(&mut self.slope) {
            values.fill(0.0);
        }
        (self.decay_powers, self.age) = ([1.0; 2], 0);
        self.forget_costs();
    }

    /// Copies `other`, without allocating.
    pub fn copy_from(&mut self, other: &Self) {
        for group in 0..2 {
            self.weights[group].copy_from_slice(&other.weights[group]);
            self.means[group].copy_from_slice(&other.means[group]);
            self.squares[group].copy_from_slice(&other.squares[group]);
        }
        self.end_states.copy_from_slice(&other.end_states);
        (self.decay_powers, self.age) = (other.decay_powers, other.age);
        (self.mean_cost, self.cost_spread) = (other.mean_cost, other.cost_spread);
    }

    /// Copies the weights of `policy`.
    pub fn load_policy(&mut self, policy: &LinearPolicy, groups: &[MapFeatures; 2]) {
        for (group, weights) in groups.iter().zip(&mut self.weights) {
            for (output, row) in weights.chunks_exact_mut(group.len().max(1)).enumerate() {
                for (to, &at) in row.iter_mut().zip(&group.positions) {
                    *to = policy.weights().get(output, at);
                }
            }
        }
    }

    /// Copies the weights to `policy`.
    pub fn store_policy(&self, policy: &mut LinearPolicy, groups: &[MapFeatures; 2]) {
        for (group, weights) in groups.iter().zip(&self.weights) {
            for (output, row) in weights.chunks_exact(group.len().max(1)).enumerate() {
                for (from, &at) in row.iter().zip(&group.positions) {
                    *policy.weights_mut().get_mut(output, at) = *from;
                }
            }
        }
    }

    /// Ends a tick: adds the cost of its `rollouts` rollouts to the running mean.
    pub fn finish_tick(&mut self, rollouts: usize) {
        let cost = self.cost / rollouts as f32;
        if cost.is_finite() {
            // In the first tick there is no mean to deviate from.
            if self.mean_cost != 0.0 {
                let spread = self.deviation / rollouts as f32;
                let rate = if self.cost_spread == 0.0 { 1.0 } else { COST_RATE };
                self.cost_spread += rate * (spread - self.cost_spread);
            }
            self.mean_cost += if self.mean_cost == 0.0 { cost } else { COST_RATE * (cost - self.mean_cost) };
        }
        (self.cost, self.deviation) = (0.0, 0.0);
        self.age += 1;
    }

    /// One step of size `step` down the slope that was summed over `ticks` ticks of rollouts. Returns the norm
    /// of the mean slope. If it is not finite, the slope is dropped and the weights do not change.
    pub fn descend(&mut self, path: SimdPath, groups: &mut [MapFeatures; 2], ticks: usize, step: f32) -> f32 {
        let squares: f32 = self.slope.iter().flatten().map(|s| s * s).sum();
        let norm = squares.sqrt() / ticks as f32;
        if !norm.is_finite() {
            self.slope.iter_mut().flatten().for_each(|s| *s = 0.0);
            return norm;
        }
        let share = 1.0 / (ticks as f32 * norm.max(1.0));
        let [b1, b2] = DECAYS;
        self.decay_powers[0] *= b1;
        self.decay_powers[1] *= b2;
        let (c1, c2) = (1.0 / (1.0 - self.decay_powers[0]), 1.0 / (1.0 - self.decay_powers[1]));
        let constants = AdamConstants { share, step: step * c1, c2 };
        for (i, group) in groups.iter_mut().enumerate() {
            let [weights, slope] = [&mut self.weights[i], &mut self.slope[i]];
            let [means, squares] = [&mut self.means[i], &mut self.squares[i]];
            path.run(Descend { group, constants, weights, slope, means, squares });
        }
        norm
    }
}

/// The factors of a step of Adam.
#[derive(Clone, Copy)]
struct AdamConstants {
    /// Of a slope.
    share: f32,
    /// Of the mean, and of the mean square.
    step: f32,
    c2: f32,
}

/// [`CandidatePolicy::descend`] for one group of features.
struct Descend<'a> {
    group: &'a mut MapFeatures,
    constants: AdamConstants,
    weights: &'a mut [f32],
    slope: &'a mut [f32],
    means: &'a mut [f32],
    squares: &'a mut [f32],
}

impl Kernel for Descend<'_> {
    type Output = ();
    const IS_WIDE: bool = true;

    #[inline(always)]
    fn run<L: F32x8>(self) {
        let Self { group, constants: AdamConstants { share, step, c2 }, weights, slope, means, squares } = self;
        let ([b1, b2], n) = (DECAYS, group.len().max(1));
        let rows = weights.chunks_exact_mut(n).zip(slope.chunks_exact_mut(n));
        let moments = means.chunks_exact_mut(n).zip(squares.chunks_exact_mut(n));
        for ((weights, slopes), (means, squares)) in rows.zip(moments) {
            group.whiten::<L::Wide>(slopes);
            for ((slope, mean), square) in slopes.iter_mut().zip(means).zip(squares) {
                let s = *slope * share;
                *mean = *mean * b1 + s * (1.0 - b1);
                *square = *square * b2 + s * s * (1.0 - b2);
                *slope = *mean * step / ((*square * c2).sqrt() + TINY);
            }
            group.unwhiten::<L::Wide>(slopes);
            for (w, step) in weights.iter_mut().zip(slopes) {
                *w -= *step;
                *step = 0.0;
            }
        }
    }
}

impl Persist for CandidatePolicy {
    /// The slope is not part of the state: at the end of a tick it is 0.
    fn visit_state(&mut self, visitor: &mut dyn StateVisitor) {
        for group in 0..2 {
            visitor.numbers("weights", &mut self.weights[group]);
            visitor.numbers("means", &mut self.means[group]);
            visitor.numbers("squares", &mut self.squares[group]);
        }
        visitor.number("cost", &mut self.cost);
        visitor.numbers("ends", &mut self.end_states);
        visitor.numbers("starts", &mut self.decay_powers);
        visitor.number("age", &mut self.age);
        visitor.number("mean_cost", &mut self.mean_cost);
        visitor.number("cost_spread", &mut self.cost_spread);
    }
}
