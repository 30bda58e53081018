//! The planar arm of the paper's closed-loop task (section 4.2): a chain of segments, joints that turn freely
//! or between stops, a target that jumps, a reward for distance, speed and posture, and changes of the arm
//! during the run.
//!
//! In an open loop a tick is a trial: it begins with all angles 0, the command turns the joints for one period,
//! and the remaining distance between end-effector and target decides the reward. Everything else is the same.
//!
//! All computation is in single precision, with the pure-Rust `libm` for sine and cosine, so that the bits are
//! the same on every machine, whatever its C library.

mod config;
mod kinematics;
mod model;
mod targets;

#[cfg(test)]
mod tests;

pub use config::{
    Angles, ArmConfig, ArmRewardConfig, BlockConfig, MirrorAxis, MirrorConfig, PayloadConfig, ShortenConfig,
};
pub use kinematics::posture;
pub use model::ArmModel;

use super::{JointState, MAX_JOINTS, Outcome, Plant};
use crate::angle::wrap;
use crate::state::{Persist, StateVisitor};
use crate::{MAX_MEASURES, MAX_OUTPUTS};
use kinematics::KinematicChain;
use targets::Targets;

/// The arm and its task.
#[derive(Debug, Clone)]
pub struct Arm {
    config: ArmConfig,
    /// The lengths in the last tick, m.
    lengths: [f32; MAX_OUTPUTS],
    joints: usize,
    base: [f32; 2],
    /// rad/s for a command of 1.
    gain: f32,
    /// Length of a tick, s.
    period: f32,
    scale: f32,
    speed: f32,
    angle: f32,
    collision: f32,
    /// Square of the distance within which the error counts; `None` if it counts everywhere.
    near: Option<f32>,
    /// Stops of each joint, rad; `None` if joints turn freely.
    limits: Option<[[f32; 2]; MAX_OUTPUTS]>,
    targets: Targets,
    /// Angles, rad; in [-pi, pi) without stops.
    theta: [f32; MAX_OUTPUTS],
    target: [f32; 2],
    /// Number of targets so far.
    targets_shown: u64,
    /// Tick at which the next target appears.
    next_target_tick: u64,
}

fn square(x: f32) -> f32 {
    x * x
}

impl Arm {
    /// The arm of a validated configuration, with all angles 0. `period_s` is the length of a tick, s; targets
    /// come from the run's stream `targets`.
    pub fn new(config: &ArmConfig, period_s: f64, seed: u64) -> Self {
        let mut limits = [[0.0; 2]; MAX_OUTPUTS];
        for (to, [low, high]) in limits.iter_mut().zip(&config.limits) {
            *to = [*low as f32, *high as f32];
        }
        Self {
            lengths: lengths(config, 0),
            joints: config.lengths.len(),
            base: config.base.map(|x| x as f32),
            gain: config.gain as f32,
            period: period_s as f32,
            scale: config.reward.scale as f32,
            speed: config.reward.speed as f32,
            angle: config.reward.angle as f32,
            collision: config.reward.collision as f32,
            near: config.reward.near.map(|near| square(near as f32)),
            limits: (!config.limits.is_empty()).then_some(limits),
            targets: Targets::of(config, seed),
            theta: [0.0; MAX_OUTPUTS],
            target: [0.0; 2],
            targets_shown: 0,
            next_target_tick: 0,
            config: config.clone(),
        }
    }

    /// The joint angles, rad.
    pub fn angles(&self) -> &[f32] {
        &self.theta[..self.joints]
    }

    /// The end-effector's position, m.
    pub fn end(&self) -> [f32; 2] {
        kinematics::end_effector(self.base, &self.lengths[..self.joints], self.angles(), self.config.angles)
    }

    /// The true position of the target, m, which may differ from the reported one.
    pub fn target(&self) -> [f32; 2] {
        self.target
    }

    fn chain(&self) -> KinematicChain {
        KinematicChain::new(self.base, &self.lengths[..self.joints], self.angles(), self.config.angles)
    }

    /// The angle of a joint after a tick that begins at `from` with `rate`, and the rate that was possible.
    fn turn(&self, joint: usize, from: f32, rate: f32) -> (f32, f32) {
        let reached = from + self.period * rate;
        let Some(limits) = &self.limits else { return (wrap(reached), rate) };
        let [low, high] = limits[joint];
        let stop = reached.clamp(low, high);
        (stop, if stop == reached { rate } else { (stop - from) / self.period })
    }

    /// How much slower each joint turns in `tick` under the load, rad/s: in proportion to the load's lever, which is
    /// how much the end-effector rises for a turn of the joint.
    fn droop(&self, tick: u64) -> [f32; MAX_OUTPUTS] {
        let per_metre = self.config.droop(tick) as f32;
        let chain = self.chain();
        let mut levers = [0.0; MAX_OUTPUTS];
        for (joint, lever) in levers[..self.joints].iter_mut().enumerate() {
            let until = match self.config.angles {
                Angles::Absolute => joint + 1,
                Angles::Relative => self.joints,
            };
            *lever = per_metre * (chain.point(until)[0] - chain.point(joint)[0]);
        }
        levers
    }

    /// The outcome of a tick for a real arm, of which this arm is the model: `theta` are its measured angles
    /// (rad, as configured for this arm) and `rates` its measured rates (rad/s). The model gives the
    /// end-effector from lengths, base and angles. If the end-effector was `seen` by a tracker, m, then error,
    /// reward and measures are computed from that position, and the model is used only for the segments that
    /// cross.
    pub fn measured(&mut self, tick: u64, theta: &[f32], rates: &[f32], seen: Option<[f32; 2]>) -> Outcome {
        if !self.config.shorten.is_empty() {
            self.lengths = lengths(&self.config, tick);
        }
        self.stands(theta);
        let sum = |values: &[f32]| values[..self.joints].iter().map(|&x| square(x)).sum();
        let (rates, angles) = (sum(rates), sum(theta));
        self.outcome(rates, angles, seen.unwrap_or_else(|| self.end()))
    }

    /// Writes inputs as [`Plant::sense`] does, with a target that a tracker reports, m, in place of a drawn one.
    pub fn sense_seen(&mut self, tick: u64, target: [f32; 2], inputs: &mut [f32]) {
        self.target = target;
        self.write_inputs(tick, inputs);
    }

    /// Writes the inputs: the reported target, and the angles.
    fn write_inputs(&self, tick: u64, inputs: &mut [f32]) {
        inputs[..2].copy_from_slice(&self.config.reported_target(tick, self.target));
        if !self.config.open_loop {
            inputs[2..2 + self.joints].copy_from_slice(self.angles());
        }
    }

    /// Sets the measured angles `theta`, rad, without an outcome.
    pub fn stands(&mut self, theta: &[f32]) {
        let joints = self.joints;
        self.theta[..joints].copy_from_slice(&theta[..joints]);
    }

    /// Reward and measures, from the sums of the squared rates and angles and from the end-effector's position.
    fn outcome(&self, rates: f32, angles: f32, end: [f32; 2]) -> Outcome {
        let error = square(end[0] - self.target[0]) + square(end[1] - self.target[1]);
        let mut measures = [0.0; MAX_MEASURES];
        measures[..3].copy_from_slice(&[error.sqrt(), end[0], end[1]]);
        let mut cost = -self.error_reward(error) + self.speed * rates + self.angle * angles;
        if self.collision > 0.0 {
            let crossings = self.chain().crossings() as f32;
            cost += self.collision * crossings;
            measures[3] = crossings;
        }
        Outcome { reward: -self.scale * cost, measures }
    }

    /// The reward for the squared error.
    fn error_reward(&self, error: f32) -> f32 {
        self.near.map_or(-error, |near| (near - error).max(0.0))
    }
}

/// The segments' lengths in `tick`, m.
fn lengths(config: &ArmConfig, tick: u64) -> [f32; MAX_OUTPUTS] {
    let mut lengths = [0.0; MAX_OUTPUTS];
    for (segment, length) in lengths[..config.lengths.len()].iter_mut().enumerate() {
        *length = config.length(segment, tick) as f32;
    }
    lengths
}

/// The angle at which `joint`, counted from 0, is blocked in `tick`, rad.
fn blocked_angle(blocks: &[BlockConfig], joint: usize, tick: u64) -> Option<f32> {
    blocks.iter().rev().find(|b| b.joint == joint + 1 && tick >= b.tick).map(|b| b.angle as f32)
}

/// The mean cost of exploration noise of standard deviation `sigma` in `tick`, through the squared rates: the
/// part of the loss that no policy can avoid. A blocked joint does not move and costs nothing, unless its command
/// [pays](ArmRewardConfig::blocked_pays). A joint at a stop costs less than this function assumes.
pub fn noise_share(config: &ArmConfig, sigma: f64, tick: u64) -> f64 {
    let pays = |joint: usize| config.reward.blocked_pays || blocked_angle(&config.block, joint, tick).is_none();
    let paying = (0..config.lengths.len()).filter(|&joint| pays(joint)).count();
    config.reward.scale * config.reward.speed * (config.gain * sigma).powi(2) * paying as f64
}

impl Plant for Arm {
    /// Inputs: target x and y (m), then, unless the loop is open, the angles (rad).
    fn sense(&mut self, tick: u64, inputs: &mut [f32]) -> bool {
        let new_target = tick >= self.next_target_tick;
        while tick >= self.next_target_tick {
            // With the lengths at the tick at which the target appears, even if that tick was skipped.
            let lengths = lengths(&self.config, self.next_target_tick);
            self.target = self.targets.take(self.targets_shown, &lengths[..self.joints]);
            self.targets_shown += 1;
            self.next_target_tick += self.config.target_every;
        }
        self.write_inputs(tick, inputs);
        new_target
    }

    /// Commands are angular rates in units of `gain`; in an open loop, angles in units of `gain` times the
    /// period. Measures: error (m), end-effector x and y (m), and, if the reward counts them, the pairs of
    /// segments that cross.
    fn advance(&mut self, tick: u64, applied: &[f32]) -> Outcome {
        if !self.config.shorten.is_empty() {
            self.lengths = lengths(&self.config, tick);
        }
        let droop = if self.config.payload.is_empty() { None } else { Some(self.droop(tick)) };
        let (mut rates, mut angles) = (0.0, 0.0);
        for (joint, &u) in applied[..self.joints].iter().enumerate() {
            let theta = if let Some(angle) = blocked_angle(&self.config.block, joint, tick) {
                if self.config.reward.blocked_pays {
                    rates += square(self.gain * u);
                }
                angle
            } else {
                let from = if self.config.open_loop { 0.0 } else { self.theta[joint] };
                // Without a load this is the bare product, bit for bit.
                let rate = droop.map_or(self.gain * u, |droop| self.gain * u - droop[joint]);
                let (theta, rate) = self.turn(joint, from, rate);
                rates += square(rate);
                theta
            };
            self.theta[joint] = theta;
            angles += square(theta);
        }
        self.outcome(rates, angles, self.end())
    }

    /// The angle of a joint that turns freely is in [-pi, pi). A position limit within this range stops the
    /// joint from both sides; a limit outside has no effect. In an open loop every tick starts from angle 0.
    fn joints(&self) -> Option<JointState> {
        let mut position = [0.0; MAX_JOINTS];
        if !self.config.open_loop {
            position[..MAX_OUTPUTS].copy_from_slice(&self.theta);
        }
        Some(JointState { position, travel: [self.period * self.gain; MAX_JOINTS] })
    }
}

impl Persist for Arm {
    fn visit_state(&mut self, visitor: &mut dyn StateVisitor) {
        visitor.numbers("lengths", &mut self.lengths);
        visitor.nested("targets", &mut self.targets);
        visitor.numbers("theta", &mut self.theta);
        visitor.numbers("target", &mut self.target);
        visitor.number("shown", &mut self.targets_shown);
        self.next_target_tick = self.targets_shown.saturating_mul(self.config.target_every);
    }
}
