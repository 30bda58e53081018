//! Postures at rest: where the learned reward is largest if nothing moves.
//!
//! From a posture, those inputs that move climb by a Newton method within their ranges (Bertsekas 1982, "Projected
//! Newton methods for optimization problems with simple constraints"); all others, as a target, stay as they are:
//!
//! ```text
//! dz = (mu I - H)⁻¹ g,   z <- z + dz within the ranges
//! ```
//!
//! with gradient `g` and concave Hessian `H` of the reward by the inputs that move and are not held at an end of their
//! range. A step that does not raise the reward is left out, and `mu` grows.

use super::linalg::{cholesky, packed, solve_lower, solve_lower_transposed};
use super::world::LearnedWorld;
use crate::{MAX_INPUTS, MAX_OUTPUTS};

/// Largest step of an input, which has the range [-1, 1].
const STEP: f64 = 0.5;

impl LearnedWorld<'_> {
    /// Changes those inputs of the resting point `q` that are among the bits of `moving`, so that its reward rises, in
    /// `steps` steps.
    pub fn climb(&mut self, q: &mut [f64], moving: u32, steps: usize) {
        let mut value = self.reward_of(q);
        let mut mu = 1e-3;
        let mut next = [0.0; 2 * MAX_INPUTS + 3 * MAX_OUTPUTS];
        let next = &mut next[..q.len()];
        for _ in 0..steps {
            next.copy_from_slice(q);
            if !self.step_up(next, moving, mu) {
                return;
            }
            let reward = self.reward_of(next);
            if reward > value {
                value = reward;
                q.copy_from_slice(next);
                mu = (0.3 * mu).max(1e-6);
            } else {
                mu *= 10.0;
            }
        }
    }

    /// One step of the climb. Returns whether there was one.
    fn step_up(&mut self, q: &mut [f64], moving: u32, mu: f64) -> bool {
        self.scratch.after.copy_from_slice(q);
        if !self.curve_reward() {
            return false;
        }
        let (gradient, small, active) = (&self.scratch.gradient, &self.scratch.small, &self.scratch.active);
        let mut free = [(0, 0); MAX_INPUTS];
        let mut order = 0;
        for (row, &i) in active.iter().enumerate().filter(|(_, i)| **i < self.places.inputs && moving >> **i & 1 == 1) {
            let held = if gradient[i] > 0.0 { q[i] >= self.ranges.high[i] } else { q[i] <= self.ranges.low[i] };
            if self.ranges.wraps[i] || !held {
                free[order] = (row, i);
                order += 1;
            }
        }
        let mut normal = [0.0; MAX_INPUTS * (MAX_INPUTS + 1) / 2];
        let mut step = [0.0; MAX_INPUTS];
        for (r, &(row, i)) in free[..order].iter().enumerate() {
            for (c, &(column, _)) in free[..=r].iter().enumerate() {
                normal[packed(r) + c] = -small[row * active.len() + column];
            }
            normal[packed(r) + r] += mu;
            step[r] = gradient[i];
        }
        if order == 0 || !cholesky(&mut normal, order) {
            return false;
        }
        solve_lower(&normal, &mut step[..order]);
        solve_lower_transposed(&normal, &mut step[..order]);
        for (&(_, i), step) in free[..order].iter().zip(step) {
            q[i] = self.ranges.bring_in(i, q[i] + step.clamp(-STEP, STEP));
        }
        true
    }
}

#[cfg(test)]
mod tests {
    use rand::RngExt as _;

    use super::super::agent::models;
    use super::super::config::{InputRange, ModelPredictiveConfig, ModelPredictiveSpec};
    use super::super::layout::Places;
    use super::super::memory::Lesson;
    use super::super::world::{Ranges, WorldScratch};
    use super::*;
    use crate::seed::stream;

    /// The first input is a target, which the second has to meet; the third is best beyond its range.
    #[test]
    fn a_posture_climbs_to_the_largest_reward_within_its_range() {
        let config = ModelPredictiveConfig { reward_features: 120, ..ModelPredictiveConfig::default() };
        let inputs = vec![InputRange { min: -1.0, max: 1.0, wraps: false, radians: Some(0.0) }; 3];
        let spec = ModelPredictiveSpec { limits: vec![1.0; 2], sigma: vec![0.1; 2], seed: 1, inputs, config };
        let places = Places { inputs: 3, commands: 2 };
        let mut rng = stream(8, "test");
        let (mut dynamics, [_, mut reward]) = models(&spec, places, &mut rng);
        let mut q = vec![0.0; places.len()];
        for _ in 0..300 {
            q[..3].iter_mut().for_each(|z| *z = rng.random_range(-1.0..1.0));
            reward.observe(&q);
            let y = -(q[1] - 0.5 * q[0]).powi(2) - 0.5 * (q[2] - 1.3).powi(2);
            reward.learn(&[y], Lesson::default(), &mut rng);
        }
        reward.take(0.0);
        let (ranges, mut scratch) = (Ranges::of(&spec.inputs), WorldScratch::new(places));
        scratch.active.extend([1, 2]);
        let mut world = LearnedWorld {
            places,
            dynamics: &mut dynamics,
            reward: &mut reward,
            after: true,
            best: 10.0,
            caution: 0.0,
            ranges: &ranges,
            scratch: &mut scratch,
        };
        let mut q = vec![0.0; places.len()];
        q[..3].copy_from_slice(&[0.8, -0.9, -0.7]);
        world.climb(&mut q, 0b110, 8);
        assert_eq!([q[0], q[2]], [0.8, 1.0]);
        assert!((q[1] - 0.4).abs() < 0.02, "{q:?}");
    }
}
