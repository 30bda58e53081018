//! A point mass on a plane, pushed by two forces towards a target that jumps: the simplest plant that has inertia.

use rand::RngExt as _;
use serde::{Deserialize, Serialize};

use super::state_space::{SimulatedModel, StateSpace, StateSpacePlant};
use crate::MAX_MEASURES;
use crate::seed::Rng;

/// Force of a command of 1, N.
const FORCE: f64 = 5.0;
/// Mass, kg, and drag, N s/m.
const MASS: f64 = 1.0;
const DRAG: f64 = 0.5;
/// Targets lie in a square up to this coordinate, m.
pub(super) const ARENA: f64 = 1.0;
/// Walls stop the mass at this coordinate, m.
pub(super) const WALL: f64 = 1.5;

/// `[plant.point-mass]`: `r = -(|e|^2 + speed |v|^2 + command |u|^2)`, with the error `e`, m, and the velocity `v`,
/// m/s.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PointMassConfig {
    /// Ticks between new targets.
    pub target_every: u64,
    /// Weight of the squared velocity.
    pub speed: f64,
    /// Weight of the squared command.
    pub command: f64,
}

impl Default for PointMassConfig {
    fn default() -> Self {
        Self { target_every: 80, speed: 0.05, command: 0.01 }
    }
}

/// The model. State: position, m, velocity, m/s, and target, m, each x and y. Commands: forces in units of 5 N.
#[derive(Debug, Clone)]
pub struct PointMassModel {
    config: PointMassConfig,
    period: f64,
}

/// The simulated point mass.
pub type PointMass = StateSpacePlant<PointMassModel>;

impl PointMassModel {
    /// The model for ticks of `period_s`, s.
    pub fn new(config: &PointMassConfig, period_s: f64) -> Self {
        Self { config: config.clone(), period: period_s }
    }
}

impl PointMass {
    /// The point mass of a validated configuration, for ticks of `period_s`, s.
    pub fn new(config: &PointMassConfig, period_s: f64, seed: u64) -> Self {
        Self::with_model(PointMassModel::new(config, period_s), seed)
    }
}

impl StateSpace for PointMassModel {
    fn states(&self) -> usize {
        6
    }

    fn dynamic_states(&self) -> usize {
        4
    }

    fn wraps(&self, _i: usize) -> bool {
        false
    }

    fn commands(&self) -> usize {
        2
    }

    /// The exact solution for a constant force.
    fn step(&self, state: &mut [f64], command: &[f64]) -> f64 {
        let kept = libm::exp(-DRAG / MASS * self.period);
        let coast = MASS / DRAG * (1.0 - kept);
        let mut cost = 0.0;
        for axis in 0..2 {
            let command = command[axis].clamp(-1.0, 1.0);
            let terminal = FORCE * command / DRAG;
            let (position, velocity) = (state[axis], state[2 + axis]);
            let mut reached = position + coast * velocity + terminal * (self.period - coast);
            let mut velocity = terminal + kept * (velocity - terminal);
            if reached.abs() > WALL {
                (reached, velocity) = (reached.clamp(-WALL, WALL), 0.0);
            }
            (state[axis], state[2 + axis]) = (reached, velocity);
            let error = reached - state[4 + axis];
            cost += error * error + self.config.speed * velocity * velocity + self.config.command * command * command;
        }
        -cost
    }
}

impl SimulatedModel for PointMassModel {
    const INPUTS: &'static [usize] = &[4, 5, 0, 1, 2, 3];
    const RESETS: bool = false;

    fn trial_ticks(&self) -> u64 {
        self.config.target_every
    }

    fn begin(&self, rng: &mut Rng, state: &mut [f64], first: bool) {
        if first {
            state.fill(0.0);
        }
        for axis in 0..2 {
            state[4 + axis] = ARENA * (2.0 * rng.random::<f64>() - 1.0);
        }
    }

    fn measures(&self, state: &[f64]) -> [f64; MAX_MEASURES] {
        [libm::hypot(state[0] - state[4], state[1] - state[5]), state[0], state[1], 0.0, 0.0, 0.0]
    }
}
