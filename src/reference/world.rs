//! The arm as it stands after what has happened to it so far.

use crate::plant::{Arm, Plant as _};
use crate::scenario::ArmConfig;
use crate::wire::MAX_INPUTS;

/// An arm that no longer changes: all that had happened to it by some tick has been so from the beginning.
///
/// What the references know is the arm of the paper: angles absolute, joints that turn freely or stand, the reward of error,
/// speed and posture. Other settings of the table are nobody's here.
#[derive(Debug, Clone, PartialEq)]
pub struct FixedArm {
    table: ArmConfig,
    period_s: f64,
    /// The angle at which a joint stands, rad; `None` for one that moves.
    fixed: Vec<Option<f64>>,
    /// Whether the targets' x and y are reported with the other sign.
    mirrored: [bool; 2],
}

impl FixedArm {
    /// The arm of `table` in a run's `tick`, with a period of `period_s`, s. Changes of that very tick have happened.
    pub fn at(table: &ArmConfig, period_s: f64, tick: u64) -> Self {
        let mut table = table.at(tick);
        table.block.retain(|block| block.tick <= tick);
        table.block.sort_by_key(|block| block.tick);
        let fixed = (1..=table.lengths.len())
            .map(|joint| table.block.iter().rev().find(|b| b.joint == joint).map(|b| b.angle))
            .collect();
        table.block.iter_mut().for_each(|block| block.tick = 0);
        // A second mirror for an axis turns the first one back.
        let mirrored = table.mirrored(tick);
        table.mirror.retain(|mirror| mirror.tick <= tick);
        table.mirror.iter_mut().for_each(|mirror| mirror.tick = 0);
        Self { table, period_s, fixed, mirrored }
    }

    /// The arm's table, with nothing left to happen.
    pub fn table(&self) -> &ArmConfig {
        &self.table
    }

    /// Period of a tick, s.
    pub fn period_s(&self) -> f64 {
        self.period_s
    }

    /// The angles of joints that do not move, rad, from the base to the end.
    pub fn fixed(&self) -> &[Option<f64>] {
        &self.fixed
    }

    /// The joints that move, from 0.
    pub fn free(&self) -> Vec<usize> {
        (0..self.fixed.len()).filter(|&joint| self.fixed[joint].is_none()).collect()
    }

    /// Where the target is that the inputs show, m: a mirrored camera shows it elsewhere.
    pub fn target(&self, inputs: &[f32]) -> [f64; 2] {
        std::array::from_fn(|axis| f64::from(if self.mirrored[axis] { -inputs[axis] } else { inputs[axis] }))
    }

    /// So many targets that the arm can reach, drawn as a run of this seed would draw them, m.
    pub fn draw_targets(&self, count: usize, seed: u64) -> Vec<[f64; 2]> {
        let mut arm = Arm::new(&self.table, self.period_s, seed);
        let mut inputs = [0.0; MAX_INPUTS];
        (0..count as u64)
            .map(|i| {
                arm.sense(i * self.table.target_every, &mut inputs);
                self.target(&inputs)
            })
            .collect()
    }

    /// The arm's table with given targets.
    pub fn with_targets(&self, targets: &[[f64; 2]]) -> ArmConfig {
        ArmConfig { targets: targets.to_vec(), ..self.table.clone() }
    }
}
