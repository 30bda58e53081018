//! The saccading eye of the paper's open-loop task (section 4.1). Each tick is one trial: a target appears with
//! a position and a velocity, four commands push the eye up, down, left and right, and the reward depends on
//! the remaining distance.

use rand_distr::{Distribution, StandardNormal};

use super::{Outcome, Plant};
use crate::MAX_MEASURES;
use crate::plant::{EyeConfig, Retina};
use crate::seed::{Rng, stream};
use crate::state::{Persist, StateVisitor};

/// Position and velocity of a target.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Stimulus {
    /// Position, x and y.
    pub position: [f32; 2],
    /// Velocity, x and y, per second.
    pub velocity: [f32; 2],
}

/// The eye and its task.
#[derive(Debug, Clone)]
pub struct Eye {
    retina: Retina,
    distortion: f32,
    spread: f32,
    bonus: f32,
    rng: Rng,
    stimulus: Stimulus,
}

/// Eccentricity `log(1 + B rho) / log(1 + B)` and direction (rad) of a point.
pub fn log_polar(point: [f32; 2], distortion: f32) -> [f32; 2] {
    let [x, y] = point;
    [eccentricity(libm::hypotf(x, y), distortion), libm::atan2f(y, x)]
}

fn eccentricity(rho: f32, distortion: f32) -> f32 {
    libm::log1pf(distortion * rho) / libm::log1pf(distortion)
}

impl Eye {
    /// The eye of a validated configuration; stimuli come from the run's stream `targets`.
    pub fn new(config: &EyeConfig, seed: u64) -> Self {
        Self {
            retina: config.retina,
            distortion: config.distortion as f32,
            spread: config.spread as f32,
            bonus: config.bonus as f32,
            rng: stream(seed, "targets"),
            stimulus: Stimulus::default(),
        }
    }

    /// What the retina reports of a stimulus: two coordinates of the position, two of the velocity.
    pub fn see(&self, stimulus: &Stimulus) -> [f32; 4] {
        let report = |v: [f32; 2]| match self.retina {
            Retina::Linear => v,
            Retina::LogPolar => log_polar(v, self.distortion),
        };
        let ([a, b], [c, d]) = (report(stimulus.position), report(stimulus.velocity));
        [a, b, c, d]
    }

    /// Replaces the current stimulus until the next one is drawn.
    pub fn show(&mut self, stimulus: Stimulus) {
        self.stimulus = stimulus;
    }

    fn normal(&mut self) -> f32 {
        let standard: f64 = StandardNormal.sample(&mut self.rng);
        self.spread * standard as f32
    }
}

impl Plant for Eye {
    /// Inputs: a new stimulus as the retina reports it.
    fn sense(&mut self, _tick: u64, inputs: &mut [f32]) -> bool {
        let position = [self.normal(), self.normal()];
        let velocity = [self.normal(), self.normal()];
        self.show(Stimulus { position, velocity });
        inputs[..4].copy_from_slice(&self.see(&self.stimulus));
        true
    }

    /// Commands push up, down, left and right. Measure: the distance from the target one second later.
    fn advance(&mut self, _tick: u64, applied: &[f32]) -> Outcome {
        let Stimulus { position: p, velocity: v } = self.stimulus;
        let movement = [applied[3] - applied[2], applied[0] - applied[1]];
        let miss = libm::hypotf(p[0] + v[0] - movement[0], p[1] + v[1] - movement[1]);
        let mut measures = [0.0; MAX_MEASURES];
        measures[0] = miss;
        Outcome { reward: self.bonus - eccentricity(miss, self.distortion), measures }
    }
}

impl Persist for Eye {
    fn visit_state(&mut self, visitor: &mut dyn StateVisitor) {
        visitor.nested("rng", &mut self.rng);
        visitor.numbers("position", &mut self.stimulus.position);
        visitor.numbers("velocity", &mut self.stimulus.velocity);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_perfect_saccade_earns_the_bonus() {
        let mut eye = Eye::new(&EyeConfig::default(), 1);
        let mut inputs = [0.0; 4];
        assert!(eye.sense(0, &mut inputs));
        let Stimulus { position: p, velocity: v } = eye.stimulus;
        let outcome = eye.advance(0, &[p[1] + v[1], 0.0, 0.0, p[0] + v[0]]);
        assert!((outcome.reward - 0.5).abs() < 1e-6);
        assert!(outcome.measures[0] < 1e-6);
    }

    #[test]
    fn eccentricity_runs_from_zero_to_one() {
        assert_eq!(log_polar([0.0, 0.0], 4.0), [0.0, 0.0]);
        let [rho, phi] = log_polar([0.0, -1.0], 4.0);
        assert!((rho - 1.0).abs() < 1e-6 && (phi + std::f32::consts::FRAC_PI_2).abs() < 1e-6);
    }
}
