//! Reference controller: damped least squares for every kinematic arm of the tasks.
//!
//! It has the method and the constants of [`super::damped_least_squares`], which serves the paper's arm alone and is
//! tuned there. The Jacobian comes from finite differences, the rest posture is a bent one within the stops, and
//! lengths scale with the arm's reach.

use super::damped_least_squares::TUNED;
use super::small_matrix::Matrix;
use crate::plant::task::Task;
use crate::plant::{ArmModel, BodyConfig, So101Model};
use crate::policy::Outputs;
use tectum_core::MAX_OUTPUTS;

/// Step of the finite differences, rad.
const STEP: f64 = 1e-6;
/// Reach of the paper's arm, for which the constants are tuned, m.
const TUNED_REACH: f64 = 2.0;

/// The arm's kinematics.
enum Chain {
    Planar(Box<ArmModel>),
    So101(Box<So101Model>),
}

/// The controller.
pub struct ResolvedRates {
    chain: Chain,
    joints: usize,
    /// Turn of a joint in a tick for a command of 1, rad.
    travel: f64,
    reach: f64,
    rest: Vec<f64>,
    limit: f64,
}

impl ResolvedRates {
    /// For the arm of `task` as it is in `tick`; `None` if the task has no kinematic arm.
    pub fn new(task: &Task, tick: u64) -> Option<Self> {
        let period_s = task.period_ms / 1000.0;
        let (chain, joints, gain, reach) = match &task.body {
            BodyConfig::Arm(config) => {
                let chain = Chain::Planar(Box::new(ArmModel::new(config, period_s, tick)));
                (chain, config.lengths.len(), config.gain, config.at(tick).lengths.iter().sum())
            }
            BodyConfig::So101(config) => {
                (Chain::So101(Box::new(So101Model::new(config, period_s))), 5, config.gain, 0.45)
            }
            _ => return None,
        };
        let last = (joints - 1).max(1) as f64;
        let rest = (0..joints).map(|joint| TUNED.bend * (1.0 - 2.0 * joint as f64 / last)).collect();
        Some(Self { chain, joints, travel: gain * period_s, reach, rest, limit: task.max_command })
    }

    fn end(&self, theta: &[f64]) -> Vec<f64> {
        match &self.chain {
            Chain::Planar(model) => model.end(theta).to_vec(),
            Chain::So101(model) => model.end(theta).to_vec(),
        }
    }

    fn moves(&self, joint: usize) -> bool {
        match &self.chain {
            Chain::Planar(model) => !model.is_blocked(joint),
            Chain::So101(model) => model.moving().contains(&joint),
        }
    }

    /// The output that moves this joint.
    fn output(&self, joint: usize) -> usize {
        match &self.chain {
            Chain::Planar(_) => joint,
            Chain::So101(model) => model.moving().iter().position(|&moving| moving == joint).unwrap_or(joint),
        }
    }

    /// The command for the true state: the joints' angles, then the target.
    pub fn command(&self, state: &[f64]) -> Outputs {
        let (theta, target) = (&state[..self.joints], &state[self.joints..]);
        let end = self.end(theta);
        let free: Vec<usize> = (0..self.joints).filter(|&joint| self.moves(joint)).collect();
        let mut jacobian = Matrix::zero(end.len(), free.len());
        for (column, &joint) in free.iter().enumerate() {
            let mut turned = theta.to_vec();
            turned[joint] += STEP;
            for (row, (there, here)) in self.end(&turned).iter().zip(&end).enumerate() {
                jacobian[(row, column)] = (there - here) / STEP;
            }
        }
        let turns = self.turns(&jacobian, &end, target, |column| self.rest[free[column]] - theta[free[column]]);
        let largest = turns.iter().fold(0.0, |most: f64, turn| most.max(turn.abs()));
        let share = if largest > TUNED.turn { TUNED.turn / largest } else { 1.0 };
        let mut command = [0.0; MAX_OUTPUTS];
        for (&joint, turn) in free.iter().zip(turns) {
            command[self.output(joint)] = (share * turn / self.travel).clamp(-self.limit, self.limit) as f32;
        }
        command
    }

    /// The turn of each free joint, rad: towards the target, and along the null space towards the rest posture.
    fn turns(&self, jacobian: &Matrix, end: &[f64], target: &[f64], to_rest: impl Fn(usize) -> f64) -> Vec<f64> {
        let damping = TUNED.damping * self.reach / TUNED_REACH;
        let (rows, columns) = (end.len(), jacobian.columns());
        let mut square = Matrix::zero(rows, rows);
        for i in 0..rows {
            for j in 0..rows {
                square[(i, j)] = (0..columns).map(|k| jacobian[(i, k)] * jacobian[(j, k)]).sum();
            }
            square[(i, i)] += damping * damping;
        }
        let rest: Vec<f64> = (0..columns).map(|column| TUNED.posture * to_rest(column)).collect();
        let drift = jacobian.apply(&rest);
        let wanted: Vec<f64> = (0..rows).map(|row| TUNED.approach * (target[row] - end[row]) - drift[row]).collect();
        let pull = square.solve(&wanted).unwrap_or_else(|| vec![0.0; rows]);
        jacobian.apply_transposed(&pull).iter().zip(rest).map(|(turn, rest)| turn + rest).collect()
    }
}
