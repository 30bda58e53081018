//! The pendulum of Gymnasium's `Pendulum-v1`: a rod that a weak motor swings up and balances.
//!
//! Dynamics, limits and reward are those of
//! <https://gymnasium.farama.org/environments/classic_control/pendulum/>: `r = -(theta^2 + 0.1 omega^2 + 0.001
//! tau^2)` with the state before the tick, semi-implicit Euler steps of 50 ms, speed limited to 8 rad/s. Inputs are
//! angle and speed in place of cosine, sine and speed.

use rand::RngExt as _;
use rand_distr::{Distribution as _, StandardNormal};
use serde::{Deserialize, Serialize};
use std::f64::consts::PI;

use super::state_space::{SimulatedModel, StateSpace, StateSpacePlant, substeps};
use crate::MAX_MEASURES;
use crate::angle::wrap_f64;
use crate::seed::Rng;

/// Torque of a command of 1, N m.
const TORQUE: f64 = 2.0;
/// Largest speed, rad/s.
pub(super) const MAX_SPEED: f64 = 8.0;
/// Gravity, m/s^2. Mass (kg) and length (m) are 1.
const GRAVITY: f64 = 10.0;
/// Length of an integration step, s.
const STEP_S: f64 = 0.05;

/// `[plant.pendulum]`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PendulumConfig {
    /// Ticks of an episode, after which the pendulum has a new start; 0 for no end.
    pub episode_ticks: u64,
    /// Where episodes start.
    pub start: Start,
}

/// Where the episodes of a pendulum start.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Start {
    /// Hanging at rest, but for a small random deviation.
    Hanging,
    /// As the published task draws it: for `Pendulum-v1`, any angle, and speeds up to 1 rad/s.
    Random,
}

impl Start {
    /// The angle from upright with which an episode starts, rad.
    pub(super) fn angle(self, rng: &mut Rng) -> f64 {
        match self {
            Self::Hanging => PI + 0.01 * normal(rng),
            Self::Random => uniform(rng, PI),
        }
    }
}

impl Default for PendulumConfig {
    fn default() -> Self {
        Self { episode_ticks: 200, start: Start::Random }
    }
}

/// The pendulum's model. State: angle from upright, rad, in [-pi, pi), and speed, rad/s. Command: torque in units of 2
/// N m.
#[derive(Debug, Clone)]
pub struct PendulumModel {
    config: PendulumConfig,
    substeps: (usize, f64),
}

/// The simulated pendulum.
pub type Pendulum = StateSpacePlant<PendulumModel>;

impl PendulumModel {
    /// The model for ticks of `period_s`, s.
    pub fn new(config: &PendulumConfig, period_s: f64) -> Self {
        Self { config: config.clone(), substeps: substeps(period_s, STEP_S) }
    }
}

impl Pendulum {
    /// The pendulum of a validated configuration, for ticks of `period_s`, s.
    pub fn new(config: &PendulumConfig, period_s: f64, seed: u64) -> Self {
        Self::with_model(PendulumModel::new(config, period_s), seed)
    }
}

impl StateSpace for PendulumModel {
    fn states(&self) -> usize {
        2
    }

    fn dynamic_states(&self) -> usize {
        2
    }

    fn wraps(&self, i: usize) -> bool {
        i == 0
    }

    fn commands(&self) -> usize {
        1
    }

    fn step(&self, state: &mut [f64], command: &[f64]) -> f64 {
        let (mut theta, mut omega) = (state[0], state[1]);
        let torque = TORQUE * command[0].clamp(-1.0, 1.0);
        let angle = wrap_f64(theta);
        let cost = angle * angle + 0.1 * omega * omega + 0.001 * torque * torque;
        let (count, dt) = self.substeps;
        for _ in 0..count {
            omega += (1.5 * GRAVITY * libm::sin(theta) + 3.0 * torque) * dt;
            omega = omega.clamp(-MAX_SPEED, MAX_SPEED);
            theta += omega * dt;
        }
        state.copy_from_slice(&[wrap_f64(theta), omega]);
        -cost
    }
}

impl SimulatedModel for PendulumModel {
    const STREAM: &'static str = "starts";
    const INPUTS: &'static [usize] = &[0, 1];
    const RESETS: bool = true;

    fn trial_ticks(&self) -> u64 {
        self.config.episode_ticks
    }

    fn begin(&self, rng: &mut Rng, state: &mut [f64], _first: bool) {
        let angle = wrap_f64(self.config.start.angle(rng));
        let speed = if self.config.start == Start::Random { uniform(rng, 1.0) } else { 0.0 };
        state.copy_from_slice(&[angle, speed]);
    }

    fn measures(&self, state: &[f64]) -> [f64; MAX_MEASURES] {
        [state[0].abs(), 0.0, 0.0, 0.0, 0.0, 0.0]
    }
}

/// A number between `-limit` and `limit`.
pub(super) fn uniform(rng: &mut Rng, limit: f64) -> f64 {
    limit * (2.0 * rng.random::<f64>() - 1.0)
}

/// A number of the standard normal distribution.
pub(super) fn normal(rng: &mut Rng) -> f64 {
    StandardNormal.sample(rng)
}
