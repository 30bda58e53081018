//! A Furuta pendulum: a motor turns an arm in the horizontal plane, and at the arm's end a pendulum swings freely.
//!
//! Equations: Cazzolato & Prime 2011, "On the dynamics of the Furuta pendulum", for slender rods. Parameters: Quanser
//! QUBE-Servo 2, whose motor is driven by a voltage, with the viscous friction of the package quanser_robots. The
//! reward has the form of dm_control's cart-pole: a product of upright, centred, slow and a small command.

use serde::{Deserialize, Serialize};

use super::pendulum::{Start, normal};
use super::state_space::{SimulatedModel, StateSpace, StateSpacePlant, runge_kutta, substeps, swing_up_reward};
use crate::MAX_MEASURES;
use crate::angle::wrap_f64;
use crate::seed::Rng;

/// Voltage of a command of 1, V.
const VOLTAGE: f64 = 10.0;
/// Gravity, m/s^2.
const GRAVITY: f64 = 9.81;
/// Resistance of the motor, ohm, and its torque constant, N m/A.
const RESISTANCE: f64 = 8.4;
const TORQUE_CONSTANT: f64 = 0.042;
/// Mass, kg, length, m, and damping, N m s/rad, of the arm.
const ARM_MASS: f64 = 0.095;
const ARM_LENGTH: f64 = 0.085;
const ARM_DAMPING: f64 = 5e-6;
/// The same of the pendulum.
const ROD_MASS: f64 = 0.024;
const ROD_LENGTH: f64 = 0.129;
const ROD_DAMPING: f64 = 1e-6;
/// Length of an integration step, s.
const STEP_S: f64 = 0.002;

/// `[plant.furuta]`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct FurutaConfig {
    /// Ticks of an episode, after which there is a new start; 0 for no end.
    pub episode_ticks: u64,
    /// Where episodes start: `hanging`, or `random` with the pendulum at any angle.
    pub start: Start,
}

impl Default for FurutaConfig {
    fn default() -> Self {
        Self { episode_ticks: 500, start: Start::Hanging }
    }
}

/// The model. State: angle of the arm and of the pendulum from upright, rad, in [-pi, pi), and their rates, rad/s.
/// Command: the motor's voltage in units of 10 V.
#[derive(Debug, Clone)]
pub struct FurutaModel {
    config: FurutaConfig,
    substeps: (usize, f64),
}

/// The simulated Furuta pendulum.
pub type Furuta = StateSpacePlant<FurutaModel>;

impl FurutaModel {
    /// The model for ticks of `period_s`, s.
    pub fn new(config: &FurutaConfig, period_s: f64) -> Self {
        Self { config: config.clone(), substeps: substeps(period_s, STEP_S) }
    }
}

/// Accelerations of arm and pendulum for the motor's `voltage`.
fn accelerations(q: &[f64; 2], v: &[f64; 2], voltage: f64) -> [f64; 2] {
    let torque = TORQUE_CONSTANT * (voltage - TORQUE_CONSTANT * v[0]) / RESISTANCE;
    accelerations_by_torque(q, v, torque - ARM_DAMPING * v[0], -ROD_DAMPING * v[1])
}

/// The same for the torques at the arm's axis and at the pendulum's hinge, N m.
fn accelerations_by_torque(q: &[f64; 2], v: &[f64; 2], arm: f64, hinge: f64) -> [f64; 2] {
    let (sin, cos) = libm::sincos(q[1]);
    let half = ROD_LENGTH / 2.0;
    let about_hinge = ROD_MASS * ROD_LENGTH * ROD_LENGTH / 12.0 + ROD_MASS * half * half;
    let a = ROD_MASS * ARM_LENGTH * ARM_LENGTH + about_hinge * sin * sin + ARM_MASS * ARM_LENGTH * ARM_LENGTH / 12.0;
    let b = -ROD_MASS * half * ARM_LENGTH * cos;
    let centrifugal = about_hinge * sin * cos;
    let first = arm - 2.0 * centrifugal * v[0] * v[1] - ROD_MASS * half * ARM_LENGTH * sin * v[1] * v[1];
    let second = hinge + centrifugal * v[0] * v[0] + ROD_MASS * half * GRAVITY * sin;
    let determinant = a * about_hinge - b * b;
    [(about_hinge * first - b * second) / determinant, (a * second - b * first) / determinant]
}

impl Furuta {
    /// The pendulum of a validated configuration, for ticks of `period_s`, s.
    pub fn new(config: &FurutaConfig, period_s: f64, seed: u64) -> Self {
        Self::with_model(FurutaModel::new(config, period_s), seed)
    }
}

impl StateSpace for FurutaModel {
    fn states(&self) -> usize {
        4
    }

    fn dynamic_states(&self) -> usize {
        4
    }

    fn wraps(&self, i: usize) -> bool {
        i < 2
    }

    fn commands(&self) -> usize {
        1
    }

    fn step(&self, state: &mut [f64], command: &[f64]) -> f64 {
        let (mut q, mut v) = ([state[0], state[1]], [state[2], state[3]]);
        let command = command[0].clamp(-1.0, 1.0);
        let (count, dt) = self.substeps;
        for _ in 0..count {
            runge_kutta(&mut q, &mut v, dt, |q, v| accelerations(q, v, VOLTAGE * command));
        }
        state.copy_from_slice(&[wrap_f64(q[0]), wrap_f64(q[1]), v[0], v[1]]);
        swing_up_reward(q[1], [v[1], 10.0], state[0], command)
    }
}

impl SimulatedModel for FurutaModel {
    const STREAM: &'static str = "starts";
    const INPUTS: &'static [usize] = &[0, 1, 2, 3];
    const RESETS: bool = true;

    fn trial_ticks(&self) -> u64 {
        self.config.episode_ticks
    }

    fn begin(&self, rng: &mut Rng, state: &mut [f64], _first: bool) {
        let angle = self.config.start.angle(rng);
        state.copy_from_slice(&[0.01 * normal(rng), wrap_f64(angle), 0.0, 0.0]);
    }

    fn measures(&self, state: &[f64]) -> [f64; MAX_MEASURES] {
        [state[1].abs(), state[0], 0.0, 0.0, 0.0, 0.0]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Kinetic and potential energy, from the positions of the parts: an independent way to the same equations.
    fn energy(q: &[f64; 2], v: &[f64; 2]) -> f64 {
        let half = ROD_LENGTH / 2.0;
        // The rod's point at distance s from its hinge moves along (tangential, radial, vertical).
        let (sin, cos) = (q[1].sin(), q[1].cos());
        let steps = 20_000;
        let rod: f64 = (0..steps)
            .map(|i| {
                let s = ROD_LENGTH * (i as f64 + 0.5) / f64::from(steps);
                let tangential = ARM_LENGTH * v[0] - s * cos * v[1];
                let radial = s * sin * v[0];
                let vertical = s * sin * v[1];
                0.5 * ROD_MASS / f64::from(steps) * (tangential.powi(2) + radial.powi(2) + vertical.powi(2))
            })
            .sum();
        rod + 0.5 * ARM_MASS * ARM_LENGTH.powi(2) / 12.0 * v[0] * v[0] + ROD_MASS * GRAVITY * half * cos
    }

    #[test]
    fn without_torques_energy_stays() {
        let (mut q, mut v) = ([0.3, 2.0], [1.5, -4.0]);
        let before = energy(&q, &v);
        for _ in 0..2000 {
            runge_kutta(&mut q, &mut v, 0.0005, |q, v| accelerations_by_torque(q, v, 0.0, 0.0));
        }
        let after = energy(&q, &v);
        assert!((after - before).abs() < 1e-3 * before.abs().max(1e-3), "{before} {after}");
    }

    #[test]
    fn it_falls_from_upright_and_swings_about_hanging() {
        let model = FurutaModel::new(&FurutaConfig::default(), 0.02);
        let (mut hanging, mut upright) = ([0.0, 3.1, 0.0, 0.0], [0.0, 0.01, 0.0, 0.0]);
        let mut lowest = 0.0_f64;
        for _ in 0..500 {
            model.step(&mut hanging, &[0.0]);
            model.step(&mut upright, &[0.0]);
            assert!(hanging[1].abs() > 3.05, "{hanging:?}");
            lowest = lowest.max(upright[1].abs());
        }
        assert!(lowest > 3.0 && upright[0].abs() < 3.0, "{upright:?}");
    }
}
