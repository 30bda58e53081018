//! The cart-pole of dm_control's `cartpole swingup`: a cart on a rail swings a pole up and balances it.
//!
//! The model is that of `dm_control/suite/cartpole.xml` as MuJoCo simulates it: Runge-Kutta steps of 10 ms, soft
//! stops of the rail, and a capsule for a pole. The reward is the smooth one of `cartpole.py`, with the state after
//! the tick (Tassa et al. 2018, arXiv 1801.00690). A tick may hold several steps; dm_control calls its length
//! `control_timestep`.

use serde::{Deserialize, Serialize};

use super::pendulum::{Start, normal};
use super::soft_limit::SoftLimit;
use super::state_space::{SimulatedModel, StateSpace, StateSpacePlant, runge_kutta, substeps, swing_up_reward};
use crate::MAX_MEASURES;
use crate::angle::wrap_f64;
use crate::seed::Rng;

/// Force of a command of 1, N.
const FORCE: f64 = 10.0;
/// Gravity, m/s^2.
const GRAVITY: f64 = 9.81;
/// Masses of cart and pole, kg.
const CART: f64 = 1.0;
const POLE: f64 = 0.1;
/// Distance of the pole's centre from its hinge, m.
const CENTRE: f64 = 0.5;
/// Length and radius of the pole's capsule, m; the length is without its round ends.
const LENGTH: f64 = 1.0;
const RADIUS: f64 = 0.045;
/// Damping of cart, N s/m, and hinge, N m s/rad.
const DAMPING: [f64; 2] = [5e-4, 2e-6];
/// Ends of the rail, m.
pub(super) const RAIL: f64 = 1.8;
/// Length of an integration step, s.
const STEP_S: f64 = 0.01;

/// `[plant.cart-pole]`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct CartPoleConfig {
    /// Ticks of an episode, after which the cart-pole has a new start; 0 for no end.
    pub episode_ticks: u64,
    /// Where episodes start: `hanging`, as published, or `random`, any angle.
    pub start: Start,
}

impl Default for CartPoleConfig {
    fn default() -> Self {
        Self { episode_ticks: 200, start: Start::Hanging }
    }
}

/// The cart-pole's model. State: position of the cart, m, angle from upright, rad, in [-pi, pi), and their rates.
/// Command: force in units of 10 N.
#[derive(Debug, Clone)]
pub struct CartPoleModel {
    config: CartPoleConfig,
    substeps: (usize, f64),
    /// Inertia of the pole about its hinge, kg m^2.
    inertia: f64,
    rail: SoftLimit,
}

/// The simulated cart-pole.
pub type CartPole = StateSpacePlant<CartPoleModel>;

impl CartPoleModel {
    /// The model for ticks of `period_s`, s.
    pub fn new(config: &CartPoleConfig, period_s: f64) -> Self {
        let inertia = capsule_inertia(POLE, RADIUS, LENGTH) + POLE * CENTRE * CENTRE;
        let coupling = POLE * CENTRE;
        let inverse_weight = inertia / ((CART + POLE) * inertia - coupling * coupling);
        let rail = SoftLimit { range: [-RAIL, RAIL], time_constant: 0.08, inverse_weight };
        Self { config: config.clone(), substeps: substeps(period_s, STEP_S), inertia, rail }
    }

    /// Accelerations of cart and hinge.
    fn accelerations(&self, q: &[f64; 2], v: &[f64; 2], force: f64) -> [f64; 2] {
        let (sin, cos) = libm::sincos(q[1]);
        let (mass, coupling) = (CART + POLE, POLE * CENTRE * cos);
        let determinant = mass * self.inertia - coupling * coupling;
        let push = force - DAMPING[0] * v[0] + POLE * CENTRE * sin * v[1] * v[1];
        let turn = POLE * GRAVITY * CENTRE * sin - DAMPING[1] * v[1];
        let free = (self.inertia * push - coupling * turn) / determinant;
        let push = push + self.rail.force(q[0], v[0], free, self.inertia / determinant);
        [(self.inertia * push - coupling * turn) / determinant, (mass * turn - coupling * push) / determinant]
    }
}

/// Inertia of a capsule about a line through its centre, across its length: a cylinder and two half spheres.
pub(super) fn capsule_inertia(mass: f64, radius: f64, length: f64) -> f64 {
    let sphere = mass * 4.0 * radius / (4.0 * radius + 3.0 * length);
    let cylinder = (mass - sphere) * (3.0 * radius * radius + length * length) / 12.0;
    cylinder + 0.4 * sphere * radius * radius + sphere * length * (3.0 * radius + 2.0 * length) / 8.0
}

impl CartPole {
    /// The cart-pole of a validated configuration, for ticks of `period_s`, s.
    pub fn new(config: &CartPoleConfig, period_s: f64, seed: u64) -> Self {
        Self::with_model(CartPoleModel::new(config, period_s), seed)
    }
}

impl StateSpace for CartPoleModel {
    fn states(&self) -> usize {
        4
    }

    fn dynamic_states(&self) -> usize {
        4
    }

    fn wraps(&self, i: usize) -> bool {
        i == 1
    }

    fn commands(&self) -> usize {
        1
    }

    fn step(&self, state: &mut [f64], command: &[f64]) -> f64 {
        let (mut q, mut v) = ([state[0], state[1]], [state[2], state[3]]);
        let command = command[0].clamp(-1.0, 1.0);
        let (count, dt) = self.substeps;
        for _ in 0..count {
            runge_kutta(&mut q, &mut v, dt, |q, v| self.accelerations(q, v, FORCE * command));
        }
        state.copy_from_slice(&[q[0], wrap_f64(q[1]), v[0], v[1]]);
        swing_up_reward(q[1], [v[1], 5.0], q[0], command)
    }
}

impl SimulatedModel for CartPoleModel {
    const STREAM: &'static str = "starts";
    const INPUTS: &'static [usize] = &[0, 1, 2, 3];
    const RESETS: bool = true;

    fn trial_ticks(&self) -> u64 {
        self.config.episode_ticks
    }

    fn begin(&self, rng: &mut Rng, state: &mut [f64], _first: bool) {
        let angle = self.config.start.angle(rng);
        let position = 0.01 * normal(rng);
        state.copy_from_slice(&[position, wrap_f64(angle), 0.01 * normal(rng), 0.01 * normal(rng)]);
    }

    fn measures(&self, state: &[f64]) -> [f64; MAX_MEASURES] {
        [state[1].abs(), state[0], 0.0, 0.0, 0.0, 0.0]
    }
}
