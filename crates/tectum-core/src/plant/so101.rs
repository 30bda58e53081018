//! The arm SO-101 of The Robot Studio, as its joints move: five joints between stops that turn at commanded rates, and
//! targets in three dimensions.
//!
//! Joint origins, axes and limits are those of `Simulation/SO101/so101_new_calib.urdf` in the repository
//! TheRobotStudio/SO-ARM100 (Apache-2.0): all joints but the gripper's own, and `gripper_frame` as end-effector. The
//! model has no mass; `[plant.timing]` gives its motors a lag.
//!
//! With `planar = true` only the three joints move whose axes are parallel, and targets lie in their plane: pan and
//! roll stay at 0.

use rand::RngExt as _;
use serde::{Deserialize, Serialize};

use super::state_space::{SimulatedModel, StateSpace, StateSpacePlant};
use super::{JointState, MAX_JOINTS, Outcome, Plant};
use crate::MAX_MEASURES;
use crate::seed::Rng;

/// Number of joints.
pub(super) const JOINTS: usize = 5;
/// Names of the joints, from the base on.
pub(super) const NAMES: [&str; JOINTS] = ["shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll"];
/// Least and greatest angle of each joint, rad.
pub(super) const LIMITS: [[f64; 2]; JOINTS] =
    [[-1.91986, 1.91986], [-1.74533, 1.74533], [-1.69, 1.69], [-1.65806, 1.65806], [-2.74385, 2.84121]];
/// The joints that move, from the base on: all, and those that move in a plane.
const ALL: [usize; JOINTS] = [0, 1, 2, 3, 4];
const PLANE: [usize; 3] = [1, 2, 3];
/// Targets lie within this coordinate on every axis, m.
pub(super) const REACH: f64 = 0.6;
/// Least height of a target above the table, m.
const TABLE: f64 = 0.03;
/// Targets are drawn from this share of each joint's range.
const SHARE: f64 = 0.8;

/// Position, m, and roll, pitch and yaw, rad, of each joint in the frame before it. The digits are those of the file.
#[expect(clippy::approx_constant)]
const ORIGINS: [([f64; 3], [f64; 3]); JOINTS] = [
    ([0.0388353, -8.97657e-09, 0.0624], [3.14159, 4.18253e-17, -3.14159]),
    ([-0.0303992, -0.0182778, -0.0542], [-1.5708, -1.5708, 0.0]),
    ([-0.11257, -0.028, 1.73763e-16], [-3.63608e-16, 8.74301e-16, 1.5708]),
    ([-0.1349, 0.0052, 3.62355e-17], [4.02456e-15, 8.67362e-16, -1.5708]),
    ([5.55112e-17, -0.0611, 0.0181], [1.5708, 0.0486795, 3.14159]),
];
/// Position of the end-effector in the frame of the last joint, m.
const END: [f64; 3] = [-0.0079, -0.000218121, -0.0981274];

/// `[plant.so101]`: `r = -scale (|e|^2 + speed |theta_dot|^2 + angle |theta|^2)`, with the error `e`, m, rates, rad/s,
/// and angles, rad.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct So101Config {
    /// Ticks between new targets.
    pub target_every: u64,
    /// Angular rate for a command of 1, rad/s. The default is the no-load speed of the servo STS3215 at 7.4 V.
    pub gain: f64,
    /// Factor of the whole reward.
    pub scale: f64,
    /// Weight of the squared rates.
    pub speed: f64,
    /// Weight of the squared angles.
    pub angle: f64,
    /// Whether only shoulder_lift, elbow_flex and wrist_flex move, in the plane of x and z.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub planar: bool,
}

impl So101Config {
    /// The joints that move, from the base on.
    pub(super) fn moving(&self) -> &'static [usize] {
        if self.planar { &PLANE } else { &ALL }
    }

    /// Names of the joints that move.
    pub(super) fn names(&self) -> Vec<&'static str> {
        self.moving().iter().map(|&joint| NAMES[joint]).collect()
    }
}

impl Default for So101Config {
    fn default() -> Self {
        Self { target_every: 80, gain: 5.3, scale: 10.0, speed: 0.0005, angle: 0.0001, planar: false }
    }
}

/// The model. State: the angles of all joints, rad, then the target, m. Commands: rates of those that move, in units of
/// `gain`.
#[derive(Debug, Clone)]
pub struct So101Model {
    config: So101Config,
    period: f64,
    /// Rotation of each joint's origin.
    turns: [Rotation; JOINTS],
}

/// The simulated arm.
pub type So101 = StateSpacePlant<So101Model>;

type Rotation = [[f64; 3]; 3];

impl So101Model {
    /// The model for ticks of `period_s`, s.
    pub fn new(config: &So101Config, period_s: f64) -> Self {
        Self { config: config.clone(), period: period_s, turns: ORIGINS.map(|(_, angles)| by_angles(angles)) }
    }

    /// The joints that commands move, from the base on: places in the state.
    pub fn moving(&self) -> &'static [usize] {
        self.config.moving()
    }

    /// The end-effector for these angles, m: x ahead of the base, y to its left, z up.
    pub fn end(&self, theta: &[f64]) -> [f64; 3] {
        let mut point = END;
        for joint in (0..JOINTS).rev() {
            let (sin, cos) = libm::sincos(theta[joint]);
            let turned = [cos * point[0] - sin * point[1], sin * point[0] + cos * point[1], point[2]];
            let (origin, turn) = (&ORIGINS[joint].0, &self.turns[joint]);
            point = std::array::from_fn(|i| {
                origin[i] + turn[i][0] * turned[0] + turn[i][1] * turned[1] + turn[i][2] * turned[2]
            });
        }
        point
    }

    fn error(&self, state: &[f64]) -> ([f64; 3], f64) {
        let end = self.end(state);
        let square = (0..3).map(|i| (end[i] - state[JOINTS + i]) * (end[i] - state[JOINTS + i])).sum();
        (end, square)
    }

    /// The reward, from the sums of the squared errors, rates and angles.
    fn reward(&self, error: f64, rates: f64, angles: f64) -> f64 {
        -self.config.scale * (error + self.config.speed * rates + self.config.angle * angles)
    }
}

/// The rotation by roll, pitch and yaw about the fixed axes x, y and z, in this order.
fn by_angles([roll, pitch, yaw]: [f64; 3]) -> Rotation {
    let ((sr, cr), (sp, cp), (sy, cy)) = (libm::sincos(roll), libm::sincos(pitch), libm::sincos(yaw));
    [
        [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
        [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
        [-sp, cp * sr, cp * cr],
    ]
}

impl So101 {
    /// The arm of a validated configuration, for ticks of `period_s`, s.
    pub fn new(config: &So101Config, period_s: f64, seed: u64) -> Self {
        Self::with_model(So101Model::new(config, period_s), seed)
    }

    /// Sets the measured angles `theta`, rad, of the moving joints of a real arm, of which this arm is the model.
    pub fn stands(&mut self, theta: &[f32]) {
        let mut state = [0.0; JOINTS + 3];
        state.copy_from_slice(self.state());
        for (&joint, from) in self.model().moving().iter().zip(theta) {
            state[joint] = f64::from(*from);
        }
        self.set_state(&state);
    }

    /// The outcome of a tick of a real arm, from its measured angles, rad, and rates, rad/s.
    pub fn measured(&mut self, theta: &[f32], rates: &[f32]) -> Outcome {
        self.stands(theta);
        let joints = self.model().moving().len();
        let squares = |values: &[f32]| values[..joints].iter().map(|&x| f64::from(x) * f64::from(x)).sum();
        let (_, error) = self.model().error(self.state());
        let reward = self.model().reward(error, squares(rates), squares(theta));
        Outcome { reward: reward as f32, measures: self.model().measures(self.state()).map(|measure| measure as f32) }
    }

    /// Senses at the beginning of `tick` as [`Plant::sense`] does, with the measured angles.
    pub fn sense_measured(&mut self, tick: u64, inputs: &mut [f32]) -> bool {
        let theta = self.measured_joints().position;
        let fresh = self.sense(tick, inputs);
        // The first trial of a simulated arm begins with all angles 0.
        self.stands(&theta);
        self.model().sense(self.state(), inputs);
        fresh
    }

    /// The joints, for the gate: positions, and the travel of a command of 1.
    pub fn measured_joints(&self) -> JointState {
        let mut position = [0.0; MAX_JOINTS];
        let model = self.model();
        for (to, &joint) in position.iter_mut().zip(model.moving()) {
            *to = self.state()[joint] as f32;
        }
        JointState { position, travel: [(model.config.gain * model.period) as f32; MAX_JOINTS] }
    }
}

impl StateSpace for So101Model {
    fn states(&self) -> usize {
        JOINTS + 3
    }

    fn dynamic_states(&self) -> usize {
        JOINTS
    }

    fn wraps(&self, _i: usize) -> bool {
        false
    }

    fn commands(&self) -> usize {
        self.moving().len()
    }

    fn step(&self, state: &mut [f64], command: &[f64]) -> f64 {
        let (mut rates, mut angles) = (0.0, 0.0);
        for (&joint, command) in self.moving().iter().zip(command) {
            let [low, high] = LIMITS[joint];
            let reached = (state[joint] + self.config.gain * command * self.period).clamp(low, high);
            let rate = (reached - state[joint]) / self.period;
            state[joint] = reached;
            rates += rate * rate;
            angles += reached * reached;
        }
        let (_, error) = self.error(state);
        self.reward(error, rates, angles)
    }
}

impl SimulatedModel for So101Model {
    const INPUTS: &'static [usize] = &[5, 6, 7, 0, 1, 2, 3, 4];
    const RESETS: bool = false;

    fn trial_ticks(&self) -> u64 {
        self.config.target_every
    }

    /// In the plane the target's y is none of the inputs.
    fn sense(&self, state: &[f64], inputs: &mut [f32]) {
        let target: &[usize] =
            if self.config.planar { &[JOINTS, JOINTS + 2] } else { &[JOINTS, JOINTS + 1, JOINTS + 2] };
        for (input, &i) in inputs.iter_mut().zip(target.iter().chain(self.moving())) {
            *input = state[i] as f32;
        }
    }

    /// A target is where the end-effector is for random angles.
    fn begin(&self, rng: &mut Rng, state: &mut [f64], first: bool) {
        if first {
            state.fill(0.0);
        }
        loop {
            let mut theta = [0.0; JOINTS];
            for &joint in self.moving() {
                let [low, high] = LIMITS[joint];
                theta[joint] = SHARE * (low + (high - low) * rng.random::<f64>());
            }
            let target = self.end(&theta);
            if target[2] >= TABLE {
                state[JOINTS..].copy_from_slice(&target);
                return;
            }
        }
    }

    fn measures(&self, state: &[f64]) -> [f64; MAX_MEASURES] {
        let (end, error) = self.error(state);
        [libm::sqrt(error), end[0], end[1], end[2], 0.0, 0.0]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Computed by MuJoCo 3.17 from `so101_new_calib.xml`, the same arm with rotations as quaternions of six digits.
    #[test]
    fn the_end_effector_is_where_mujoco_computes_it() {
        let model = So101Model::new(&So101Config::default(), 0.05);
        for (theta, expected) in [
            ([0.0; 5], [0.3913619, -1.126e-05, 0.22646874]),
            ([0.5, -0.4, 0.7, 0.3, -1.0], [0.28055013, -0.12457336, 0.10297533]),
            ([-1.2, 1.1, -0.6, -0.9, 2.0], [0.19423393, 0.37919953, 0.14749154]),
        ] {
            let end = model.end(&theta);
            assert!(end.iter().zip(expected).all(|(a, b)| (a - b).abs() < 3e-6), "{end:?} {expected:?}");
        }
    }

    /// A real arm that moves as the simulated one has the same inputs, measures and rewards, within single precision.
    #[test]
    fn a_measured_arm_is_the_simulated_one() {
        let config = So101Config { target_every: 5, ..So101Config::default() };
        let (mut simulated, mut real) = (So101::new(&config, 0.05, 3), So101::new(&config, 0.05, 3));
        let mut inputs = [[0.0; 8]; 2];
        let mut theta = [0.0; JOINTS];
        real.stands(&theta);
        for tick in 0..40 {
            assert_eq!(simulated.sense(tick, &mut inputs[0]), real.sense_measured(tick, &mut inputs[1]));
            assert_eq!(inputs[0], inputs[1], "tick {tick}");
            let expected = simulated.advance(tick, &[0.1, -0.05, 0.08, 0.02, 0.2]);
            let before = theta;
            for (to, from) in theta.iter_mut().zip(simulated.state()) {
                *to = *from as f32;
            }
            let rates: Vec<f32> = theta.iter().zip(before).map(|(now, then)| (now - then) / 0.05).collect();
            let outcome = real.measured(&theta, &rates);
            assert!((outcome.reward - expected.reward).abs() < 1e-5, "tick {tick}: {outcome:?} {expected:?}");
            assert!(outcome.measures.iter().zip(expected.measures).all(|(a, b)| (a - b).abs() < 1e-6));
        }
        assert_eq!(real.measured_joints().position[..JOINTS], theta);
    }

    /// In the plane, the arm is the whole arm with pan and roll at 0, simulated and measured.
    #[test]
    fn the_planar_arm_is_the_whole_arm_with_two_joints_at_rest() {
        let config = So101Config { target_every: 7, ..So101Config::default() };
        let planar = So101Config { planar: true, ..config.clone() };
        let (mut whole, mut plane) = (So101::new(&config, 0.05, 3), So101::new(&planar, 0.05, 3));
        let mut real = So101::new(&planar, 0.05, 3);
        let (mut inputs, mut of_plane, mut of_real) = ([0.0; 8], [0.0; 5], [0.0; 5]);
        for tick in 0..60 {
            whole.sense(tick, &mut inputs);
            assert_eq!(plane.sense(tick, &mut of_plane), real.sense_measured(tick, &mut of_real));
            assert_eq!(of_plane, of_real, "tick {tick}");
            assert!(of_plane[..2].iter().all(|x| x.abs() < REACH as f32) && of_plane[1] >= TABLE as f32);
            let target: [f64; 3] = std::array::from_fn(|i| plane.state()[JOINTS + i]);
            assert!(target[1].abs() < 1e-3, "it lies in the plane: {target:?}");
            let state = [&whole.state()[..JOINTS], &target].concat();
            whole.set_state(&state);
            let expected = whole.advance(tick, &[0.0, 0.05, -0.08, 0.02, 0.0]);
            let outcome = plane.advance(tick, &[0.05, -0.08, 0.02]);
            assert_eq!(outcome, expected, "tick {tick}");
            let theta: Vec<f32> = plane.state()[1..4].iter().map(|&angle| angle as f32).collect();
            let rates: Vec<f32> = theta.iter().zip(&of_plane[2..]).map(|(now, then)| (now - then) / 0.05).collect();
            assert!((real.measured(&theta, &rates).reward - outcome.reward).abs() < 1e-5);
            assert_eq!(real.measured_joints().position[..3], theta);
        }
    }

    #[test]
    fn targets_are_within_reach_and_joints_stay_between_their_stops() {
        let config = So101Config { target_every: 1, ..So101Config::default() };
        let mut arm = So101::new(&config, 0.05, 1);
        let mut inputs = [0.0; 8];
        for tick in 0..2000 {
            assert!(arm.sense(tick, &mut inputs));
            assert!(inputs[..3].iter().all(|x| x.abs() < REACH as f32) && inputs[2] >= TABLE as f32, "{inputs:?}");
            let command = [0, 1, 2, 3, 4].map(|joint| libm::sinf(0.01 * tick as f32 * (joint as f32 + 1.0)));
            arm.advance(tick, &command);
            for (angle, [low, high]) in inputs[3..].iter().zip(LIMITS) {
                assert!((low as f32..=high as f32).contains(angle));
            }
        }
    }
}
