//! Exploration: noise on the commands, stronger and held for some ticks before there is a model.

use rand::RngExt as _;

use super::model::normal;
use crate::MAX_OUTPUTS;
use crate::seed::{Rng, stream};
use crate::state::{Persist, StateVisitor};

/// The source of noise.
#[derive(Debug, Clone)]
pub struct NoiseSource {
    rng: Rng,
    held: [f64; MAX_OUTPUTS],
    left: [u32; MAX_OUTPUTS],
}

impl NoiseSource {
    /// From the run's stream `exploration`.
    pub fn new(seed: u64) -> Self {
        Self { rng: stream(seed, "exploration"), held: [0.0; MAX_OUTPUTS], left: [0; MAX_OUTPUTS] }
    }

    /// Adds noise of a standard deviation each.
    pub fn add(&mut self, sigma: &[f64], to: &mut [f64]) {
        for (u, sigma) in to.iter_mut().zip(sigma) {
            *u += sigma * normal(&mut self.rng);
        }
    }

    /// Writes noise that each output holds for one to `longest` ticks.
    pub fn wander(&mut self, sigma: &[f64], factor: f64, longest: u32, to: &mut [f64]) {
        for (j, (u, sigma)) in to.iter_mut().zip(sigma).enumerate() {
            if self.left[j] == 0 {
                self.left[j] = self.rng.random_range(1..=longest);
                self.held[j] = factor * sigma * normal(&mut self.rng);
            }
            self.left[j] -= 1;
            *u = self.held[j];
        }
    }
}

impl Persist for NoiseSource {
    fn visit_state(&mut self, visitor: &mut dyn StateVisitor) {
        visitor.nested("rng", &mut self.rng);
        visitor.numbers("held", &mut self.held);
        visitor.numbers("left", &mut self.left);
    }
}
