//! The planar arm of the paper's closed-loop task (section 4.2): segments in a chain, joints that turn freely or between
//! stops, a target that jumps, a reward of distance, speed and posture, and changes of the body on the way.
//!
//! In an open loop a tick is a trial: it begins with all angles 0, the command turns the joints for one period, and what
//! is left between end-effector and target decides the reward. All else is the same.
//!
//! Single precision throughout, with the pure-Rust `libm` for sine and cosine: the same bits on every machine, whatever
//! its C library.

mod config;
mod kinematics;
mod targets;

#[cfg(test)]
mod tests;

pub use config::{Angles, ArmConfig, ArmRewardConfig, BlockConfig, MirrorAxis, MirrorConfig, ShortenConfig};
pub use kinematics::posture;

use std::f32::consts::PI;

use super::{JointState, Outcome, Plant};
use crate::state::{Persist, StateVisitor};
use crate::{MAX_MEASURES, MAX_OUTPUTS};
use kinematics::KinematicChain;
use targets::Targets;

/// The arm and its task.
#[derive(Debug, Clone)]
pub struct Arm {
    table: ArmConfig,
    /// The lengths in the tick lived last.
    lengths: [f32; MAX_OUTPUTS],
    joints: usize,
    base: [f32; 2],
    /// rad/s for a command of 1.
    gain: f32,
    /// s.
    period: f32,
    scale: f32,
    speed: f32,
    angle: f32,
    collision: f32,
    /// Square of the distance within which the error counts, if it does not count everywhere.
    near: Option<f32>,
    /// Stops of each joint, rad; none for joints that come round.
    limits: Option<[[f32; 2]; MAX_OUTPUTS]>,
    targets: Targets,
    /// Angles, rad: without stops in [-pi, pi).
    theta: [f32; MAX_OUTPUTS],
    target: [f32; 2],
    /// Targets shown so far, and the tick at which the next one is due.
    shown: u64,
    due: u64,
}

fn square(x: f32) -> f32 {
    x * x
}

/// To [-pi, pi), as far as single precision can tell.
fn wrap(theta: f32) -> f32 {
    let turned = theta + PI;
    // As nearly always: nothing would be taken off, and neither the division nor the floor is needed to know it.
    if (0.0..2.0 * PI).contains(&turned) { theta } else { theta - 2.0 * PI * libm::floorf(turned / (2.0 * PI)) }
}

impl Arm {
    /// The arm of a validated table, all angles 0. `period_s` is the tick's period in s; targets come from the run's
    /// stream `targets`.
    pub fn new(table: &ArmConfig, period_s: f64, seed: u64) -> Self {
        let mut limits = [[0.0; 2]; MAX_OUTPUTS];
        for (to, [low, high]) in limits.iter_mut().zip(&table.limits) {
            *to = [*low as f32, *high as f32];
        }
        Self {
            lengths: lengths(table, 0),
            joints: table.lengths.len(),
            base: table.base.map(|x| x as f32),
            gain: table.gain as f32,
            period: period_s as f32,
            scale: table.reward.scale as f32,
            speed: table.reward.speed as f32,
            angle: table.reward.angle as f32,
            collision: table.reward.collision as f32,
            near: table.reward.near.map(|near| square(near as f32)),
            limits: (!table.limits.is_empty()).then_some(limits),
            targets: Targets::of(table, seed),
            theta: [0.0; MAX_OUTPUTS],
            target: [0.0; 2],
            shown: 0,
            due: 0,
            table: table.clone(),
        }
    }

    /// The joint angles, rad.
    pub fn angles(&self) -> &[f32] {
        &self.theta[..self.joints]
    }

    /// The end-effector's position, m.
    pub fn end(&self) -> [f32; 2] {
        kinematics::end(self.base, &self.lengths[..self.joints], self.angles(), self.table.angles)
    }

    /// Where the target is, m, whatever is reported of it.
    pub fn target(&self) -> [f32; 2] {
        self.target
    }

    fn chain(&self) -> KinematicChain {
        KinematicChain::new(self.base, &self.lengths[..self.joints], self.angles(), self.table.angles)
    }

    /// Where a joint that stands at `from` comes to in a tick at `rate`, and the rate that was possible.
    fn turn(&self, joint: usize, from: f32, rate: f32) -> (f32, f32) {
        let there = from + self.period * rate;
        let Some(limits) = &self.limits else { return (wrap(there), rate) };
        let [low, high] = limits[joint];
        let stop = there.clamp(low, high);
        (stop, if stop == there { rate } else { (stop - from) / self.period })
    }

    /// A body that is somebody else's: `theta` was measured of it (rad, as this arm's angles), and its `rates` (rad/s).
    /// What comes of it is reckoned as for the arm itself, by its model: lengths, base and the way that angles are counted. Where
    /// somebody has `seen` the end-effector, error, reward and measures are of that; the model says what nobody sees, which segments
    /// cross.
    pub fn measured(&mut self, tick: u64, theta: &[f32], rates: &[f32], seen: Option<[f32; 2]>) -> Outcome {
        if !self.table.shorten.is_empty() {
            self.lengths = lengths(&self.table, tick);
        }
        self.stands(theta);
        let sum = |values: &[f32]| values[..self.joints].iter().map(|&x| square(x)).sum();
        let (rates, angles) = (sum(rates), sum(theta));
        self.judged(rates, angles, seen.unwrap_or_else(|| self.end()))
    }

    /// Inputs as for [`Plant::sense`], with a target that somebody has seen, m, in place of a drawn one.
    pub fn sense_seen(&mut self, tick: u64, target: [f32; 2], inputs: &mut [f32]) {
        self.target = target;
        self.tell(tick, inputs);
    }

    /// Writes the inputs: the target as it is reported, and the angles.
    fn tell(&self, tick: u64, inputs: &mut [f32]) {
        let mirrored = self.table.mirrored(tick);
        for (input, (x, mirrored)) in inputs.iter_mut().zip(self.target.into_iter().zip(mirrored)) {
            *input = if mirrored { -x } else { x };
        }
        if !self.table.open_loop {
            inputs[2..2 + self.joints].copy_from_slice(self.angles());
        }
    }

    /// The same before anything was applied: the arm stands at `theta`.
    pub fn stands(&mut self, theta: &[f32]) {
        let joints = self.joints;
        self.theta[..joints].copy_from_slice(&theta[..joints]);
    }

    /// What a posture is worth, with the sums of the squared rates and angles, and the end-effector there.
    fn judged(&self, rates: f32, angles: f32, end: [f32; 2]) -> Outcome {
        let error = square(end[0] - self.target[0]) + square(end[1] - self.target[1]);
        let mut measures = [0.0; MAX_MEASURES];
        measures[..3].copy_from_slice(&[error.sqrt(), end[0], end[1]]);
        let mut cost = -self.worth(error) + self.speed * rates + self.angle * angles;
        if self.collision > 0.0 {
            let crossings = self.chain().crossings() as f32;
            cost += self.collision * crossings;
            measures[3] = crossings;
        }
        Outcome { reward: -self.scale * cost, measures }
    }

    /// What the squared error is worth.
    fn worth(&self, error: f32) -> f32 {
        self.near.map_or(-error, |near| (near - error).max(0.0))
    }
}

/// The segments' lengths in `tick`, m.
fn lengths(table: &ArmConfig, tick: u64) -> [f32; MAX_OUTPUTS] {
    let mut lengths = [0.0; MAX_OUTPUTS];
    for (segment, length) in lengths[..table.lengths.len()].iter_mut().enumerate() {
        *length = table.length(segment, tick) as f32;
    }
    lengths
}

fn blocked(blocks: &[BlockConfig], joint: usize, tick: u64) -> Option<f32> {
    blocks.iter().rev().find(|b| b.joint == joint + 1 && tick >= b.tick).map(|b| b.angle as f32)
}

/// What exploration of standard deviation `sigma` alone costs in `tick`, through the squared rates: the part of the loss
/// that no policy can avoid. A blocked joint does not move and costs nothing; one that is held at a stop costs less than
/// is said here.
pub fn noise_share(table: &ArmConfig, sigma: f64, tick: u64) -> f64 {
    let moving = (0..table.lengths.len()).filter(|&j| blocked(&table.block, j, tick).is_none()).count();
    table.reward.scale * table.reward.speed * (table.gain * sigma).powi(2) * moving as f64
}

impl Plant for Arm {
    /// Inputs: target x and y (m), then, unless the loop is open, the angles (rad).
    fn sense(&mut self, tick: u64, inputs: &mut [f32]) -> bool {
        let fresh = tick >= self.due;
        while tick >= self.due {
            // As the arm is when the target appears, also when that was passed over.
            let lengths = lengths(&self.table, self.due);
            self.target = self.targets.take(self.shown, &lengths[..self.joints]);
            self.shown += 1;
            self.due += self.table.target_every;
        }
        self.tell(tick, inputs);
        fresh
    }

    /// Commands are angular rates in units of `gain`; in an open loop, angles in units of `gain` times the period.
    /// Measures: error (m), end-effector x and y (m), and if they cost something the pairs of segments that cross.
    fn advance(&mut self, tick: u64, applied: &[f32]) -> Outcome {
        if !self.table.shorten.is_empty() {
            self.lengths = lengths(&self.table, tick);
        }
        let (mut rates, mut angles) = (0.0, 0.0);
        for (joint, &u) in applied[..self.joints].iter().enumerate() {
            let theta = if let Some(angle) = blocked(&self.table.block, joint, tick) {
                angle
            } else {
                let from = if self.table.open_loop { 0.0 } else { self.theta[joint] };
                let (theta, rate) = self.turn(joint, from, self.gain * u);
                rates += square(rate);
                theta
            };
            self.theta[joint] = theta;
            angles += square(theta);
        }
        self.judged(rates, angles, self.end())
    }

    /// A joint that comes round is measured in [-pi, pi), so that a limit between is a wall that it crosses from neither side,
    /// and one beyond is none. In an open loop every tick starts from angle 0.
    fn joints(&self) -> Option<JointState> {
        let position = if self.table.open_loop { [0.0; MAX_OUTPUTS] } else { self.theta };
        Some(JointState { position, travel: [self.period * self.gain; MAX_OUTPUTS] })
    }
}

impl Persist for Arm {
    fn visit_state(&mut self, visitor: &mut dyn StateVisitor) {
        visitor.numbers("lengths", &mut self.lengths);
        visitor.nested("targets", &mut self.targets);
        visitor.numbers("theta", &mut self.theta);
        visitor.numbers("target", &mut self.target);
        visitor.number("shown", &mut self.shown);
        self.due = self.shown.saturating_mul(self.table.target_every);
    }
}
