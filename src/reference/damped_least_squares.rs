//! What classical control does with the true arm: damped least squares.
//!
//! Every tick the end-effector is sent a share of the way to the target, and the joints follow through the damped inverse
//! of the Jacobian, `J+ = J^T (J J^T + damping^2 I)^-1` (Nakamura & Hanafusa 1986; Wampler 1986). What is left of the
//! joints' freedom goes towards a posture near the one that the reward asks for, through the null space of the Jacobian
//! (Liégeois 1977): not to all angles 0 itself, because an arm that is stretched out straight has one direction in which it
//! cannot move, and would stay stretched out for ever. The rates are limited together, so that the direction stays.
//!
//! The five constants were found by a search along one after the other for the least loss on the undamaged arm, over
//! targets of the seeds 1 to 4; a test holds them to it. What remains above the trajectory optimum is the price of
//! looking one tick ahead.

use super::FixedArm;
use crate::policy::Outputs;

/// The constants.
#[derive(Debug, Clone, Copy)]
pub(super) struct DampingSettings {
    /// Share of the way to the target a tick.
    pub approach: f64,
    /// Damping of the inverse, m.
    pub damping: f64,
    /// Share of the way to the posture a tick, in the null space.
    pub posture: f64,
    /// The posture's angle at the first joint, rad; at the last it is the opposite, and in between they go evenly over.
    pub bend: f64,
    /// Largest turn of a joint in a tick, rad.
    pub turn: f64,
}

pub(super) const TUNED: DampingSettings =
    DampingSettings { approach: 0.26, damping: 0.4, posture: 0.015, bend: 0.26, turn: 0.55 };

/// The controller.
#[derive(Debug, Clone)]
pub struct DampedLeastSquares {
    world: FixedArm,
    free: Vec<usize>,
    settings: DampingSettings,
}

impl DampedLeastSquares {
    /// The controller of the arm in `world`.
    pub fn new(world: &FixedArm) -> Self {
        Self::with(world, TUNED)
    }

    pub(super) fn with(world: &FixedArm, settings: DampingSettings) -> Self {
        Self { world: world.clone(), free: world.free(), settings }
    }

    /// The command for inputs: target x and y (m), then the angles (rad).
    pub fn command(&self, inputs: &[f32]) -> Outputs {
        let DampingSettings { approach, damping, posture, bend, turn } = self.settings;
        let table = self.world.table();
        let target = self.world.target(inputs);
        let angle = |joint: usize| self.world.fixed()[joint].unwrap_or(f64::from(inputs[2 + joint]));
        let mut way = [target[0] - table.base[0], target[1] - table.base[1]];
        for (joint, length) in table.lengths.iter().enumerate() {
            let (sin, cos) = libm::sincos(angle(joint));
            way = [way[0] - length * cos, way[1] - length * sin];
        }
        // One column of the Jacobian a free joint: angles are absolute, so each turns its own segment only.
        let columns: Vec<[f64; 2]> = self
            .free
            .iter()
            .map(|&joint| {
                let (sin, cos) = libm::sincos(angle(joint));
                [-table.lengths[joint] * sin, table.lengths[joint] * cos]
            })
            .collect();
        // J J^T + damping^2 I, symmetric 2 x 2.
        let (mut a, mut b, mut d) = (damping * damping, 0.0, damping * damping);
        for [x, y] in &columns {
            (a, b, d) = (a + x * x, b + x * y, d + y * y);
        }
        let determinant = a * d - b * b;
        let solve = |v: [f64; 2]| [(d * v[0] - b * v[1]) / determinant, (a * v[1] - b * v[0]) / determinant];

        let reach = solve(way.map(|w| approach * w));
        let last = table.lengths.len().saturating_sub(1).max(1) as f64;
        let home = |joint: usize| bend * (1.0 - 2.0 * joint as f64 / last);
        let home: Vec<f64> = self.free.iter().map(|&joint| posture * (home(joint) - angle(joint))).collect();
        // What going home would move the end-effector by is taken out again.
        let mut drift = [0.0; 2];
        for ([x, y], h) in columns.iter().zip(&home) {
            drift = [drift[0] + x * h, drift[1] + y * h];
        }
        let drift = solve(drift);
        let turns: Vec<f64> = columns
            .iter()
            .zip(&home)
            .map(|([x, y], h)| h + x * (reach[0] - drift[0]) + y * (reach[1] - drift[1]))
            .collect();
        let largest = turns.iter().fold(0.0, |most: f64, t| most.max(t.abs()));
        let share = if largest > turn { turn / largest } else { 1.0 };
        let mut command = Outputs::default();
        for (&joint, t) in self.free.iter().zip(&turns) {
            command[joint] = (share * t / (table.gain * self.world.period_s())) as f32;
        }
        command
    }
}
