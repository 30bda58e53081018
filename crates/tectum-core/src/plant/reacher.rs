//! The arm of Gymnasium's `Reacher-v5`: two joints with inertia that are driven by torques.
//!
//! The model is that of `gymnasium/envs/mujoco/assets/reacher.xml` as MuJoCo simulates it: Runge-Kutta steps of 10 ms,
//! two in a tick of 20 ms, and a soft stop of the second joint. The reward is `-|fingertip - target| - |u|^2`, as
//! published. Gymnasium reads the fingertip where the last stage of the Runge-Kutta method left it, up to 0.02 mm from
//! the joint angles' own; so does this plant.

use serde::{Deserialize, Serialize};
use std::f64::consts::PI;

use super::cart_pole::capsule_inertia;
use super::pendulum::uniform;
use super::soft_limit::SoftLimit;
use super::state_space::{SimulatedModel, StateSpace, StateSpacePlant, runge_kutta, substeps};
use crate::MAX_MEASURES;
use crate::angle::wrap_f64;
use crate::seed::Rng;

/// Torque of a command of 1, N m.
const TORQUE: f64 = 200.0;
/// Length of a link, m, and where on the second link the fingertip is.
const LINK: f64 = 0.1;
const TIP: f64 = 0.11;
/// Radius of links and fingertip, m; density, kg/m^3.
const RADIUS: f64 = 0.01;
const DENSITY: f64 = 1000.0;
/// Inertia of each motor, kg m^2, and damping of each joint, N m s/rad.
const ARMATURE: f64 = 1.0;
const DAMPING: f64 = 1.0;
/// Stops of the second joint, rad.
pub(super) const STOP: f64 = 3.0;
/// Targets lie in a circle of this radius, m.
pub(super) const REACH: f64 = 0.2;
/// Length of an integration step, s.
const STEP_S: f64 = 0.01;

/// `[plant.reacher]`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ReacherConfig {
    /// Ticks of an episode, after which there are a new start and a new target; 0 for no end.
    pub episode_ticks: u64,
}

impl Default for ReacherConfig {
    fn default() -> Self {
        Self { episode_ticks: 50 }
    }
}

/// The model. State: the joints' angles, rad, and rates, rad/s; target x and y, m; fingertip x and y as reported, m.
/// Commands: torques in units of 200 N m.
#[derive(Debug, Clone)]
pub struct ReacherModel {
    config: ReacherConfig,
    substeps: (usize, f64),
    /// Inertia of the first link about the first joint, and of all that is beyond the second joint about that,
    /// kg m^2.
    inertia: [f64; 2],
    /// Mass beyond the second joint, kg, and its first moment about that, kg m.
    mass: f64,
    moment: f64,
    stop: SoftLimit,
}

/// The simulated arm.
pub type Reacher = StateSpacePlant<ReacherModel>;

impl ReacherModel {
    /// The model for ticks of `period_s`, s.
    pub fn new(config: &ReacherConfig, period_s: f64) -> Self {
        let sphere = DENSITY * 4.0 / 3.0 * PI * RADIUS * RADIUS * RADIUS;
        let link = sphere + DENSITY * PI * RADIUS * RADIUS * LINK;
        let about_end = capsule_inertia(link, RADIUS, LINK) + link * (LINK / 2.0) * (LINK / 2.0);
        let tip = 0.4 * sphere * RADIUS * RADIUS + sphere * TIP * TIP;
        let mut model = Self {
            config: config.clone(),
            substeps: substeps(period_s, STEP_S),
            inertia: [about_end, about_end + tip],
            mass: link + sphere,
            moment: link * LINK / 2.0 + sphere * TIP,
            stop: SoftLimit { range: [-STOP, STOP], time_constant: 0.02, inverse_weight: 0.0 },
        };
        let [[a, b], [_, d]] = model.inertia_matrix(1.0);
        model.stop.inverse_weight = a / (a * d - b * b);
        model
    }

    /// The inertia matrix for the cosine of the second joint's angle.
    fn inertia_matrix(&self, cos: f64) -> [[f64; 2]; 2] {
        let [first, second] = self.inertia;
        let coupling = second + LINK * self.moment * cos;
        let whole = first + second + self.mass * LINK * LINK + 2.0 * LINK * self.moment * cos;
        [[ARMATURE + whole, coupling], [coupling, ARMATURE + second]]
    }

    fn accelerations(&self, q: &[f64; 2], v: &[f64; 2], torque: [f64; 2]) -> [f64; 2] {
        let (sin, cos) = libm::sincos(q[1]);
        let [[a, b], [_, d]] = self.inertia_matrix(cos);
        let determinant = a * d - b * b;
        let coriolis = LINK * self.moment * sin;
        let first = torque[0] - DAMPING * v[0] + coriolis * (2.0 * v[0] + v[1]) * v[1];
        let second = torque[1] - DAMPING * v[1] - coriolis * v[0] * v[0];
        let free = (a * second - b * first) / determinant;
        let second = second + self.stop.force(q[1], v[1], free, a / determinant);
        [(d * first - b * second) / determinant, (a * second - b * first) / determinant]
    }
}

/// The fingertip for these angles, m.
fn fingertip(q: &[f64]) -> [f64; 2] {
    let ((sin, cos), (sin_both, cos_both)) = (libm::sincos(q[0]), libm::sincos(q[0] + q[1]));
    [LINK * cos + TIP * cos_both, LINK * sin + TIP * sin_both]
}

impl Reacher {
    /// The arm of a validated configuration, for ticks of `period_s`, s.
    pub fn new(config: &ReacherConfig, period_s: f64, seed: u64) -> Self {
        Self::with_model(ReacherModel::new(config, period_s), seed)
    }
}

impl StateSpace for ReacherModel {
    fn states(&self) -> usize {
        8
    }

    fn dynamic_states(&self) -> usize {
        4
    }

    fn wraps(&self, i: usize) -> bool {
        i == 0
    }

    fn commands(&self) -> usize {
        2
    }

    fn step(&self, state: &mut [f64], command: &[f64]) -> f64 {
        let (mut q, mut v) = ([state[0], state[1]], [state[2], state[3]]);
        let command = [0, 1].map(|i: usize| command[i].clamp(-1.0, 1.0));
        let (count, dt) = self.substeps;
        let mut reported = q;
        for _ in 0..count {
            reported = runge_kutta(&mut q, &mut v, dt, |q, v| self.accelerations(q, v, command.map(|u| TORQUE * u)));
        }
        state[..4].copy_from_slice(&[wrap_f64(q[0]), q[1], v[0], v[1]]);
        state[6..8].copy_from_slice(&fingertip(&reported));
        -libm::hypot(state[6] - state[4], state[7] - state[5]) - command[0] * command[0] - command[1] * command[1]
    }
}

impl SimulatedModel for ReacherModel {
    const INPUTS: &'static [usize] = &[4, 5, 0, 1, 2, 3];
    const RESETS: bool = true;

    fn trial_ticks(&self) -> u64 {
        self.config.episode_ticks
    }

    fn begin(&self, rng: &mut Rng, state: &mut [f64], _first: bool) {
        for (i, limit) in [0.1, 0.1, 0.005, 0.005].into_iter().enumerate() {
            state[i] = uniform(rng, limit);
        }
        loop {
            let target = [uniform(rng, REACH), uniform(rng, REACH)];
            if libm::hypot(target[0], target[1]) < REACH {
                state[4..6].copy_from_slice(&target);
                break;
            }
        }
        let end = fingertip(&state[..2]);
        state[6..8].copy_from_slice(&end);
    }

    fn sense(&self, state: &[f64], inputs: &mut [f32]) {
        let from_target = [state[6] - state[4], state[7] - state[5]];
        for (input, value) in inputs.iter_mut().zip(Self::INPUTS.iter().map(|&i| &state[i]).chain(&from_target)) {
            *input = *value as f32;
        }
    }

    fn measures(&self, state: &[f64]) -> [f64; MAX_MEASURES] {
        [libm::hypot(state[6] - state[4], state[7] - state[5]), state[6], state[7], 0.0, 0.0, 0.0]
    }
}
