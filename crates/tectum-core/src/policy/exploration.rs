//! Exploration noise: its distributions, and their scores.
//!
//! A policy-gradient rule needs only the score of the noise `n`, the negative slope of its log-density. For the
//! normal distribution the score is `n / sigma^2`, which is why the paper's rules multiply noise by features.
//! For the Laplace distribution, with density `exp(-|n| / b) / 2b` and standard deviation `sigma = b sqrt 2`,
//! it is `sign(n) / b`: a large deviation counts no more than a small one, which corresponds to the L1 norm
//! instead of the L2 norm (paper section 5). Rules receive `sigma^2` times the score, `n` or `sigma sqrt 2
//! sign(n)`, so that `alpha / sigma^2` keeps its meaning: both have the mean square `sigma^2` and give the
//! gradient of the expected reward times `sigma^2`.

use std::f32::consts::SQRT_2;

use rand::Rng as _;
use rand_distr::{Distribution, StandardNormal};

use super::Outputs;
use crate::MAX_OUTPUTS;
use crate::policy::Noise;
use crate::seed::{Rng, stream};
use crate::state::{Persist, StateVisitor};

/// A source of noise with the same standard deviation on every output, from the run's stream `exploration`.
#[derive(Debug, Clone)]
pub struct Exploration {
    sigma: f32,
    noise: Noise,
    outputs: usize,
    rng: Rng,
}

impl Exploration {
    /// Gaussian noise of standard deviation `sigma` on `outputs` outputs.
    pub fn new(seed: u64, sigma: f32, outputs: usize) -> Self {
        Self { sigma, noise: Noise::Gaussian, outputs, rng: stream(seed, "exploration") }
    }

    /// The same source with another distribution of the same standard deviation.
    pub fn distributed(self, noise: Noise) -> Self {
        Self { noise, ..self }
    }

    /// Draws the noise of one tick.
    #[inline]
    pub fn draw(&mut self) -> Outputs {
        // A local copy stays in registers.
        let mut rng = self.rng.clone();
        let mut noise = [0.0; MAX_OUTPUTS];
        for n in &mut noise[..self.outputs] {
            let standard: f64 = match self.noise {
                Noise::Gaussian => StandardNormal.sample(&mut rng),
                Noise::Laplace => laplace(&mut rng),
            };
            *n = self.sigma * standard as f32;
        }
        self.rng = rng;
        noise
    }

    /// `sigma^2` times the score of `noise`, which the learning rules multiply by the features. The score of 0
    /// is 0.
    #[inline]
    pub fn score(&self, noise: &Outputs) -> Outputs {
        match self.noise {
            Noise::Gaussian => *noise,
            Noise::Laplace => noise.map(|n| if n == 0.0 { 0.0 } else { (self.sigma * SQRT_2).copysign(n) }),
        }
    }
}

impl Persist for Exploration {
    fn visit_state(&mut self, visitor: &mut dyn StateVisitor) {
        visitor.nested("rng", &mut self.rng);
    }
}

/// A draw from the Laplace distribution of standard deviation 1, by inversion: an exponential deviate with a
/// random sign. 53 bits give a number in (0, 1), whose logarithm is finite; another bit gives the sign.
fn laplace(rng: &mut Rng) -> f64 {
    let bits = rng.next_u64();
    let uniform = ((bits >> 11) as f64 + 0.5) / (1_u64 << 53) as f64;
    let size = -libm::log(uniform) * std::f64::consts::FRAC_1_SQRT_2;
    if bits & 1 == 0 { size } else { -size }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Both distributions, with the mean of the fourth power in units of `sigma^4`: 3 and 6.
    const SHAPES: [(Noise, f64); 2] = [(Noise::Gaussian, 3.0), (Noise::Laplace, 6.0)];

    #[test]
    fn the_noise_has_the_given_moments_on_the_outputs_in_use() {
        for (noise, fourth) in SHAPES {
            let mut exploration = Exploration::new(3, 0.5, 3).distributed(noise);
            let n = 200_000;
            let mut powers = [[0.0_f64; 4]; MAX_OUTPUTS];
            for _ in 0..n {
                for (sums, x) in powers.iter_mut().zip(exploration.draw()) {
                    let x = f64::from(x) / 0.5;
                    (0..4).for_each(|k| sums[k] += x.powi(k as i32 + 1) / f64::from(n));
                }
            }
            for (i, [mean, square, cube, fourth_power]) in powers.into_iter().enumerate() {
                let used = if i < 3 { 1.0 } else { 0.0 };
                // Five standard errors of the wider distribution.
                assert!(mean.abs() < 0.012 && (square - used).abs() < 0.03, "{noise:?} {i}: {mean} {square}");
                assert!(
                    cube.abs() < 0.35 && (fourth_power - used * fourth).abs() < 0.6,
                    "{noise:?} {i}: {fourth_power}"
                );
            }
        }
    }

    #[test]
    fn a_score_is_the_negative_slope_of_the_log_density() {
        let sigma = 0.5_f32;
        let density = |noise: Noise, n: f64| match noise {
            Noise::Gaussian => -n * n / (2.0 * 0.25),
            Noise::Laplace => -n.abs() / (0.5 / 2.0_f64.sqrt()),
        };
        for (noise, _) in SHAPES {
            let exploration = Exploration::new(3, sigma, 3).distributed(noise);
            let points = [0.3, -0.7, 1e-3, 0.0, 0.0, 0.0, 0.0, 0.0];
            let score = exploration.score(&points);
            for (n, score) in points.iter().zip(score).take(3) {
                let n = f64::from(*n);
                let slope = (density(noise, n + 1e-6) - density(noise, n - 1e-6)) / 2e-6;
                assert!((f64::from(score) + 0.25 * slope).abs() < 1e-5, "{noise:?} at {n}: {score}");
            }
            assert_eq!(score[3..], [0.0; 5], "unused outputs");
        }
    }

    /// The defining property of a score: the mean of score times reward is the slope of the mean reward, times
    /// `sigma^2`.
    #[test]
    fn scores_estimate_the_slope_of_the_mean_reward() {
        for (noise, _) in SHAPES {
            let mut exploration = Exploration::new(5, 0.5, 1).distributed(noise);
            let (n, mut slope) = (400_000, 0.0_f64);
            for _ in 0..n {
                let noise = exploration.draw();
                // The mean of -(u - 1)^2 at u = 0.4 has the slope 1.2.
                let reward = -(0.4 + noise[0] - 1.0).powi(2);
                slope += f64::from(exploration.score(&noise)[0] * reward) / f64::from(n) / 0.25;
            }
            assert!((slope - 1.2).abs() < 0.03, "{noise:?}: {slope}");
        }
    }
}
