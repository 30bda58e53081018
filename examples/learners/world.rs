//! The arm in a world that changes: a joint that blocks, a segment that becomes shorter, a camera that is mirrored.

use tectum::plant::{Arm, Outcome, Plant};
use tectum::scenario::{ArmTable, BlockTable};

use crate::optimum;

const PERIOD: f64 = 0.05;

/// What changes at a tick.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Change {
    pub tick: u64,
    pub what: What,
}

#[derive(Debug, Clone, Copy, PartialEq)]
pub enum What {
    /// A joint, from 0, stands still at 0.
    Block(usize),
    /// The target's x comes with the other sign.
    Mirror,
    /// The second segment is 0.3 m long.
    Short,
}

impl Change {
    pub fn parse(text: &str) -> Self {
        let (what, tick) = text.split_once('@').expect("--change wants WHAT@TICK");
        let what = match what {
            "block" => What::Block(2),
            "block1" => What::Block(0),
            "mirror" => What::Mirror,
            "short" => What::Short,
            _ => panic!("--change knows block, block1, mirror and short"),
        };
        Self { tick: tick.parse().expect("a tick"), what }
    }
}

/// The arm, and the changes to come.
#[derive(Debug)]
pub struct World {
    arm: Arm,
    table: ArmTable,
    seed: u64,
    changes: Vec<Change>,
    short: bool,
    mirror: Option<u64>,
    now: u64,
    inputs: [f32; 2],
}

impl World {
    /// The world of `seed`, with given targets unless there are none.
    pub fn new(seed: u64, targets: Vec<[f64; 2]>, changes: &[Change]) -> Self {
        let mut table = ArmTable { targets, ..ArmTable::default() };
        for change in changes {
            if let What::Block(joint) = change.what {
                table.block.push(BlockTable { joint: joint + 1, tick: change.tick, angle: 0.0 });
            }
        }
        let mirror = changes.iter().find(|c| c.what == What::Mirror).map(|c| c.tick);
        let arm = Arm::new(&table, PERIOD, seed);
        Self { arm, table, seed, changes: changes.to_vec(), short: false, mirror, now: 0, inputs: [0.0; 2] }
    }

    /// The target as it is, mirrored or not.
    pub fn true_target(&self) -> [f64; 2] {
        self.inputs.map(f64::from)
    }

    /// Makes a segment shorter. The arm has no such thing; another one takes its place, in the same posture.
    fn shorten(&mut self, tick: u64) {
        let angles: Vec<f32> = self.arm.angles().to_vec();
        self.table.lengths[1] = 0.3;
        let mut arm = Arm::new(&self.table, PERIOD, self.seed);
        let turn = (self.table.gain * PERIOD) as f32;
        let command: Vec<f32> = angles.iter().map(|a| a / turn).collect();
        arm.advance(tick, &command);
        self.arm = arm;
        self.short = true;
    }

    /// The best that can be done after `changes`.
    pub fn optimum(changes: &[Change], targets: &[[f64; 2]]) -> (f64, f64) {
        let mut table = ArmTable::default();
        let mut free: Vec<usize> = (0..table.lengths.len()).collect();
        for change in changes {
            match change.what {
                What::Block(joint) => free.retain(|&j| j != joint),
                What::Short => table.lengths[1] = 0.3,
                What::Mirror => {}
            }
        }
        optimum::Arm { table: &table, period: PERIOD, free }.optimum(targets, 80)
    }
}

impl Plant for World {
    fn sense(&mut self, tick: u64, inputs: &mut [f32]) -> bool {
        self.now = tick;
        if !self.short && self.changes.iter().any(|c| c.what == What::Short && tick >= c.tick) {
            self.shorten(tick);
        }
        let fresh = self.arm.sense(tick, inputs);
        self.inputs.copy_from_slice(&inputs[..2]);
        if self.mirror.is_some_and(|at| tick >= at) {
            inputs[0] = -inputs[0];
        }
        fresh
    }

    fn advance(&mut self, tick: u64, applied: &[f32]) -> Outcome {
        self.arm.advance(tick, applied)
    }
}
