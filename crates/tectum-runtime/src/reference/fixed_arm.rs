//! The arm in one condition: after the changes up to some tick of a run, and with no change to come.

use crate::plant::{Arm, Plant as _};
use crate::scenario::ArmConfig;
use crate::wire::MAX_INPUTS;

/// An arm that no longer changes: all changes up to some tick of a run apply to it from the beginning.
///
/// The reference controllers know the arm of the paper: absolute angles, joints that turn freely or stand
/// still, and a reward for error, speed and posture. They ignore the other settings of the arm.
#[derive(Debug, Clone, PartialEq)]
pub struct FixedArm {
    config: ArmConfig,
    period_s: f64,
    /// The angle at which a joint stands still, rad; `None` for a joint that moves.
    fixed: Vec<Option<f64>>,
    /// Whether the target's x and y are reported with the other sign.
    mirrored: [bool; 2],
}

impl FixedArm {
    /// The arm of `config` in `tick` of a run whose period is `period_s`, s. Changes that begin in this tick
    /// apply.
    pub fn at(config: &ArmConfig, period_s: f64, tick: u64) -> Self {
        let mut config = config.at(tick);
        config.block.retain(|block| block.tick <= tick);
        config.block.sort_by_key(|block| block.tick);
        let fixed = (1..=config.lengths.len())
            .map(|joint| config.block.iter().rev().find(|b| b.joint == joint).map(|b| b.angle))
            .collect();
        config.block.iter_mut().for_each(|block| block.tick = 0);
        // A second mirror for an axis undoes the first one.
        let mirrored = config.mirrored(tick);
        config.mirror.retain(|mirror| mirror.tick <= tick);
        config.mirror.iter_mut().for_each(|mirror| mirror.tick = 0);
        // Of several loads the last one counts.
        config.payload.retain(|load| load.tick <= tick);
        config.payload.sort_by_key(|load| std::cmp::Reverse(load.tick));
        config.payload.truncate(1);
        config.payload.iter_mut().for_each(|load| load.tick = 0);
        Self { config, period_s, fixed, mirrored }
    }

    /// The arm's settings; no change of them is left to come.
    pub fn config(&self) -> &ArmConfig {
        &self.config
    }

    /// Period of a tick, s.
    pub fn period_s(&self) -> f64 {
        self.period_s
    }

    /// For each joint from the base on, the angle at which it stands still, rad; `None` for a joint that
    /// moves.
    pub fn fixed(&self) -> &[Option<f64>] {
        &self.fixed
    }

    /// The joints that move, counted from 0.
    pub fn free(&self) -> Vec<usize> {
        (0..self.fixed.len()).filter(|&joint| self.fixed[joint].is_none()).collect()
    }

    /// The target's true position for these inputs, m. The inputs differ from it where the camera is
    /// mirrored.
    pub fn target(&self, inputs: &[f32]) -> [f64; 2] {
        std::array::from_fn(|axis| f64::from(if self.mirrored[axis] { -inputs[axis] } else { inputs[axis] }))
    }

    /// The first `count` targets that a run with this seed would draw for the arm, m. The arm can reach all
    /// of them.
    pub fn draw_targets(&self, count: usize, seed: u64) -> Vec<[f64; 2]> {
        let mut arm = Arm::new(&self.config, self.period_s, seed);
        let mut inputs = [0.0; MAX_INPUTS];
        (0..count as u64)
            .map(|i| {
                arm.sense(i * self.config.target_every, &mut inputs);
                self.target(&inputs)
            })
            .collect()
    }

    /// The arm's settings with given targets, m.
    pub fn with_targets(&self, targets: &[[f64; 2]]) -> ArmConfig {
        ArmConfig { targets: targets.to_vec(), ..self.config.clone() }
    }
}
