//! The planar arm of the paper's closed-loop task (section 4.2): segments in a chain, absolute joint angles, a target
//! that jumps, a reward of distance, speed and posture.
//!
//! Single precision throughout, with the pure-Rust `libm` for sine and cosine: the same bits on every machine, whatever
//! its C library.

use std::f32::consts::PI;

use rand::RngExt as _;

use super::{Outcome, Plant};
use crate::scenario::{ArmTable, BlockTable};
use crate::seed::{Rng, stream};
use crate::wire::{MAX_MEASURES, MAX_OUTPUTS};

/// The arm and its task.
#[derive(Debug, Clone)]
pub struct Arm {
    lengths: Vec<f32>,
    base: [f32; 2],
    /// rad/s for a command of 1.
    gain: f32,
    /// s.
    period: f32,
    scale: f32,
    speed: f32,
    angle: f32,
    blocks: Vec<BlockTable>,
    targets: Targets,
    /// Absolute directions of the segments, rad, in [-pi, pi).
    theta: [f32; MAX_OUTPUTS],
    target: [f32; 2],
    target_every: u64,
    /// Targets shown so far.
    shown: u64,
}

/// Where targets come from.
#[derive(Debug, Clone)]
enum Targets {
    /// Uniform in the square `arena`, as near to and far from the base as the arm reaches.
    Drawn { rng: Rng, arena: [f32; 2], near: f32, far: f32 },
    /// A list, from the start again when it ends.
    Given(Vec<[f32; 2]>),
}

impl Targets {
    fn take(&mut self, number: u64, base: [f32; 2]) -> [f32; 2] {
        match self {
            Self::Given(list) => list[(number % list.len() as u64) as usize],
            Self::Drawn { rng, arena, near, far } => loop {
                let mut draw = || arena[0] + (arena[1] - arena[0]) * rng.random::<f32>();
                let target = [draw(), draw()];
                let distance = square(target[0] - base[0]) + square(target[1] - base[1]);
                if (square(*near)..=square(*far)).contains(&distance) {
                    return target;
                }
            },
        }
    }
}

fn square(x: f32) -> f32 {
    x * x
}

/// To [-pi, pi), as far as single precision can tell.
fn wrap(theta: f32) -> f32 {
    theta - 2.0 * PI * libm::floorf((theta + PI) / (2.0 * PI))
}

impl Arm {
    /// The arm of a validated table, all angles 0. `period_s` is the tick's period in s; targets come from the run's
    /// stream `targets`.
    pub fn new(table: &ArmTable, period_s: f64, seed: u64) -> Self {
        let lengths: Vec<f32> = table.lengths.iter().map(|&l| l as f32).collect();
        let pair = |[a, b]: [f64; 2]| [a as f32, b as f32];
        let targets = if table.targets.is_empty() {
            let far: f32 = lengths.iter().sum();
            // What the longest segment leaves when all others fold back on it.
            let near = lengths.iter().map(|l| 2.0 * l - far).fold(0.0, f32::max);
            Targets::Drawn { rng: stream(seed, "targets"), arena: pair(table.arena), near, far }
        } else {
            Targets::Given(table.targets.iter().copied().map(pair).collect())
        };
        Self {
            lengths,
            base: pair(table.base),
            gain: table.gain as f32,
            period: period_s as f32,
            scale: table.reward.scale as f32,
            speed: table.reward.speed as f32,
            angle: table.reward.angle as f32,
            blocks: table.block.clone(),
            targets,
            theta: [0.0; MAX_OUTPUTS],
            target: [0.0; 2],
            target_every: table.target_every,
            shown: 0,
        }
    }

    /// The joint angles, rad.
    pub fn angles(&self) -> &[f32] {
        &self.theta[..self.lengths.len()]
    }

    /// The end-effector's position, m.
    pub fn end(&self) -> [f32; 2] {
        let mut end = self.base;
        for (length, theta) in self.lengths.iter().zip(self.theta) {
            let (sin, cos) = libm::sincosf(theta);
            end[0] += length * cos;
            end[1] += length * sin;
        }
        end
    }

    /// The angle at which `joint` (from 0) stands blocked in `tick`, if it does.
    fn blocked(&self, joint: usize, tick: u64) -> Option<f32> {
        blocked(&self.blocks, joint, tick)
    }
}

fn blocked(blocks: &[BlockTable], joint: usize, tick: u64) -> Option<f32> {
    blocks.iter().rev().find(|b| b.joint == joint + 1 && tick >= b.tick).map(|b| b.angle as f32)
}

/// What Gaussian exploration of standard deviation `sigma` alone costs in `tick`, through the squared rates: the part of
/// the loss that no policy can avoid. A blocked joint does not move and costs nothing.
pub fn noise_share(table: &ArmTable, sigma: f64, tick: u64) -> f64 {
    let moving = (0..table.lengths.len()).filter(|&j| blocked(&table.block, j, tick).is_none()).count();
    table.reward.scale * table.reward.speed * (table.gain * sigma).powi(2) * moving as f64
}

/// The joints' positions, m, from the base to the end-effector, for absolute angles `theta`, rad.
pub fn posture(table: &ArmTable, theta: &[f32]) -> Vec<[f64; 2]> {
    let mut points = vec![table.base];
    for (length, &theta) in table.lengths.iter().zip(theta) {
        let [x, y] = points[points.len() - 1];
        points.push([x + length * f64::from(theta).cos(), y + length * f64::from(theta).sin()]);
    }
    points
}

impl Plant for Arm {
    /// Inputs: target x and y (m), then the angles (rad).
    fn sense(&mut self, tick: u64, inputs: &mut [f32]) -> bool {
        let due = tick / self.target_every + 1;
        let fresh = due > self.shown;
        while self.shown < due {
            self.target = self.targets.take(self.shown, self.base);
            self.shown += 1;
        }
        inputs[..2].copy_from_slice(&self.target);
        inputs[2..2 + self.lengths.len()].copy_from_slice(self.angles());
        fresh
    }

    /// Commands are angular rates in units of `gain`. Measures: error (m), end-effector x and y (m).
    fn advance(&mut self, tick: u64, applied: &[f32]) -> Outcome {
        let (mut rates, mut angles) = (0.0, 0.0);
        for (joint, &u) in applied[..self.lengths.len()].iter().enumerate() {
            let theta = if let Some(angle) = self.blocked(joint, tick) {
                angle
            } else {
                let rate = self.gain * u;
                rates += square(rate);
                wrap(self.theta[joint] + self.period * rate)
            };
            self.theta[joint] = theta;
            angles += square(theta);
        }
        let end = self.end();
        let error = square(end[0] - self.target[0]) + square(end[1] - self.target[1]);
        let mut measures = [0.0; MAX_MEASURES];
        measures[..3].copy_from_slice(&[error.sqrt(), end[0], end[1]]);
        Outcome { reward: -self.scale * (error + self.speed * rates + self.angle * angles), measures }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn a_straight_arm_reaches_as_far_as_its_segments() {
        let arm = Arm::new(&ArmTable::default(), 0.05, 1);
        assert_eq!(arm.end(), [2.0, -1.0]);
    }

    #[test]
    fn targets_keep_as_far_from_the_base_as_a_long_segment_keeps_the_end() {
        let table = ArmTable { lengths: vec![1.5, 0.3], ..Default::default() };
        let mut arm = Arm::new(&table, 0.05, 1);
        let mut inputs = [0.0; 4];
        for tick in (0..8000).step_by(80) {
            arm.sense(tick, &mut inputs);
            let distance = inputs[0].hypot(inputs[1] + 1.0);
            assert!((1.2..=1.8).contains(&distance), "{distance}");
        }
    }

    #[test]
    fn targets_jump_on_time_and_lie_within_reach() {
        let mut arm = Arm::new(&ArmTable::default(), 0.05, 1);
        let mut inputs = [0.0; 6];
        let mut seen = Vec::new();
        for tick in 0..800 {
            assert_eq!(arm.sense(tick, &mut inputs), tick % 80 == 0, "tick {tick}");
            if tick % 80 == 0 {
                seen.push([inputs[0], inputs[1]]);
                assert!(inputs[0].hypot(inputs[1] + 1.0) <= 2.0);
            }
        }
        seen.dedup();
        assert_eq!(seen.len(), 10);
        // The sequence is a function of the tick: a plant that was late shows the same target.
        let mut late = Arm::new(&ArmTable::default(), 0.05, 1);
        assert!(late.sense(790, &mut inputs));
        assert_eq!([inputs[0], inputs[1]], seen[9]);
    }

    #[test]
    fn a_blocked_joint_stands_and_costs_no_speed() {
        let table = ArmTable { block: vec![BlockTable { joint: 3, tick: 2, angle: 0.25 }], ..Default::default() };
        let mut arm = Arm::new(&table, 0.05, 1);
        let command = [0.01; 4];
        for tick in 0..4 {
            arm.advance(tick, &command);
            let expected = if tick < 2 { 0.1 * PI * (tick + 1) as f32 } else { 0.25 };
            assert!((arm.angles()[2] - expected).abs() < 1e-6, "tick {tick}");
        }
        assert!((noise_share(&table, 0.003, 0) - 0.0355).abs() < 1e-4);
        assert!((noise_share(&table, 0.003, 2) / noise_share(&table, 0.003, 0) - 0.75).abs() < 1e-12);
    }

    proptest! {
        #[test]
        fn angles_stay_wrapped(commands in proptest::collection::vec(-0.05_f32..0.05, 4..400)) {
            let mut arm = Arm::new(&ArmTable::default(), 0.05, 1);
            for (tick, command) in commands.chunks_exact(4).enumerate() {
                let outcome = arm.advance(tick as u64, command);
                prop_assert!(outcome.reward <= 0.0);
                // In single precision the upper end can be met, not passed.
                prop_assert!(arm.angles().iter().all(|t| (-PI..=PI).contains(t)));
            }
        }
    }
}
