//! Reference controller: damped least squares, classical control with the true arm.
//!
//! Every tick, the end-effector is to move a share of the way to the target. The joints follow by the damped
//! inverse of the Jacobian, `J+ = J^T (J J^T + damping^2 I)^-1` (Nakamura & Hanafusa 1986; Wampler 1986). The
//! null space of the Jacobian moves the joints towards a rest posture (Liégeois 1977). This posture is near
//! all angles 0, which the reward asks for, but not equal to it: an arm that is stretched out straight cannot
//! move along its length, and would stay stretched out for ever. All joint rates are limited by one factor,
//! so that the direction of the movement stays.
//!
//! A search over one constant after the other found the five constants. It minimised the loss on the
//! undamaged arm, over targets of the seeds 1 to 4; a test checks that halving or doubling any of them is
//! worse. What remains above the trajectory optimum is the cost of planning only one tick ahead.

use super::FixedArm;
use crate::policy::Outputs;

/// The controller's constants.
#[derive(Debug, Clone, Copy)]
pub(super) struct DampingSettings {
    /// Share of the way to the target in one tick.
    pub approach: f64,
    /// Damping of the inverse, m.
    pub damping: f64,
    /// Share of the way to the rest posture in one tick, in the null space.
    pub posture: f64,
    /// The rest posture's angle at the first joint, rad. The last joint has the opposite angle, those between
    /// are spaced evenly.
    pub bend: f64,
    /// Largest turn of a joint in one tick, rad.
    pub turn: f64,
}

pub(super) const TUNED: DampingSettings =
    DampingSettings { approach: 0.26, damping: 0.4, posture: 0.015, bend: 0.26, turn: 0.55 };

/// The controller.
#[derive(Debug, Clone)]
pub(super) struct DampedLeastSquares {
    arm: FixedArm,
    free: Vec<usize>,
    settings: DampingSettings,
}

/// How far the end-effector moves for a turn of one joint, m/rad. Angles are absolute, so a joint turns only
/// its own segment.
type JacobianColumn = [f64; 2];

impl DampedLeastSquares {
    /// The controller for `arm`.
    pub fn new(arm: &FixedArm) -> Self {
        Self::with(arm, TUNED)
    }

    pub fn with(arm: &FixedArm, settings: DampingSettings) -> Self {
        Self { arm: arm.clone(), free: arm.free(), settings }
    }

    /// The command for these inputs: target x and y (m), then the angles (rad).
    pub fn command(&self, inputs: &[f32]) -> Outputs {
        let settings = &self.settings;
        let config = self.arm.config();
        let target = self.arm.target(inputs);
        let angle = |joint: usize| self.arm.fixed()[joint].unwrap_or(f64::from(inputs[2 + joint]));
        let mut error = [target[0] - config.base[0], target[1] - config.base[1]];
        for (joint, length) in config.lengths.iter().enumerate() {
            let (sin, cos) = libm::sincos(angle(joint));
            error = [error[0] - length * cos, error[1] - length * sin];
        }
        let columns: Vec<JacobianColumn> = self
            .free
            .iter()
            .map(|&joint| {
                let (sin, cos) = libm::sincos(angle(joint));
                [-config.lengths[joint] * sin, config.lengths[joint] * cos]
            })
            .collect();
        let last = config.lengths.len().saturating_sub(1).max(1) as f64;
        let rest = |joint: usize| settings.bend * (1.0 - 2.0 * joint as f64 / last);
        let to_rest: Vec<f64> =
            self.free.iter().map(|&joint| settings.posture * (rest(joint) - angle(joint))).collect();
        let turns = turns(&columns, error.map(|e| settings.approach * e), &to_rest, settings.damping);
        let largest = turns.iter().fold(0.0, |most: f64, t| most.max(t.abs()));
        let share = if largest > settings.turn { settings.turn / largest } else { 1.0 };
        let mut command = Outputs::default();
        for (&joint, t) in self.free.iter().zip(&turns) {
            command[joint] = (share * t / (config.gain * self.arm.period_s())) as f32;
        }
        command
    }
}

/// The turn of each free joint, rad, that moves the end-effector by `step` (m) and the joints along `to_rest`
/// (rad) as far as that leaves the end-effector where it is.
fn turns(columns: &[JacobianColumn], step: [f64; 2], to_rest: &[f64], damping: f64) -> Vec<f64> {
    // J J^T + damping^2 I, symmetric 2 x 2.
    let (mut a, mut b, mut d) = (damping * damping, 0.0, damping * damping);
    for [x, y] in columns {
        (a, b, d) = (a + x * x, b + x * y, d + y * y);
    }
    let determinant = a * d - b * b;
    let solve = |v: [f64; 2]| [(d * v[0] - b * v[1]) / determinant, (a * v[1] - b * v[0]) / determinant];

    let reach = solve(step);
    let mut drift = [0.0; 2];
    for ([x, y], turn) in columns.iter().zip(to_rest) {
        drift = [drift[0] + x * turn, drift[1] + y * turn];
    }
    let drift = solve(drift);
    columns
        .iter()
        .zip(to_rest)
        .map(|([x, y], turn)| turn + x * (reach[0] - drift[0]) + y * (reach[1] - drift[1]))
        .collect()
}
