//! Exploration noise.

use rand_distr::{Distribution, StandardNormal};

use super::Outputs;
use crate::seed::{Rng, stream};
use crate::wire::MAX_OUTPUTS;

/// Gaussian noise of one standard deviation on every output, from the run's stream `exploration`.
#[derive(Debug, Clone)]
pub struct Exploration {
    sigma: f32,
    outputs: usize,
    rng: Rng,
}

impl Exploration {
    /// Noise of standard deviation `sigma` on `outputs` outputs.
    pub fn new(seed: u64, sigma: f32, outputs: usize) -> Self {
        Self { sigma, outputs, rng: stream(seed, "exploration") }
    }

    /// Draws the noise of one tick.
    pub fn draw(&mut self) -> Outputs {
        let mut noise = [0.0; MAX_OUTPUTS];
        for n in &mut noise[..self.outputs] {
            let standard: f64 = StandardNormal.sample(&mut self.rng);
            *n = self.sigma * standard as f32;
        }
        noise
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_noise_has_the_asked_for_spread_on_the_outputs_in_use() {
        let mut exploration = Exploration::new(3, 0.5, 3);
        let n = 20_000;
        let mut squares = [0.0_f64; MAX_OUTPUTS];
        for _ in 0..n {
            for (sum, x) in squares.iter_mut().zip(exploration.draw()) {
                *sum += f64::from(x * x);
            }
        }
        for (i, sum) in squares.iter().enumerate() {
            let expected = if i < 3 { 0.25 } else { 0.0 };
            assert!((sum / f64::from(n) - expected).abs() < 0.01, "output {i}: {}", sum / f64::from(n));
        }
    }
}
