//! The arm's true model in double precision, for controllers that plan with it.

use super::{Angles, ArmConfig, blocked_angle};
use crate::MAX_OUTPUTS;
use crate::angle::wrap_f64;
use crate::plant::StateSpace;

/// The model of a closed-loop arm as it is in one tick of a run. State: the joints' angles, rad, then the target, m.
/// Commands as the arm's. Pairs of segments that cross do not count: they have no derivative.
#[derive(Debug, Clone)]
pub struct ArmModel {
    config: ArmConfig,
    period: f64,
    fixed: [Option<f64>; MAX_OUTPUTS],
    droop: f64,
}

impl ArmModel {
    /// The model of the arm of `config` in `tick`, for ticks of `period_s`, s.
    pub fn new(config: &ArmConfig, period_s: f64, tick: u64) -> Self {
        let fixed = std::array::from_fn(|joint| blocked_angle(&config.block, joint, tick).map(f64::from));
        Self { config: config.at(tick), period: period_s, fixed, droop: config.droop(tick) }
    }

    /// The chain's points: the base, then the end of each segment, m.
    fn points(&self, theta: &[f64]) -> [[f64; 2]; MAX_OUTPUTS + 1] {
        let mut points = [self.config.base; MAX_OUTPUTS + 1];
        let mut direction = 0.0;
        for (joint, length) in self.config.lengths.iter().enumerate() {
            direction = match self.config.angles {
                Angles::Absolute => theta[joint],
                Angles::Relative => direction + theta[joint],
            };
            let (sin, cos) = libm::sincos(direction);
            points[joint + 1] = [points[joint][0] + length * cos, points[joint][1] + length * sin];
        }
        points
    }

    /// The end-effector for these angles, m.
    pub fn end(&self, theta: &[f64]) -> [f64; 2] {
        self.points(theta)[self.config.lengths.len()]
    }

    /// Whether `joint` stands still.
    pub fn is_blocked(&self, joint: usize) -> bool {
        self.fixed[joint].is_some()
    }

    /// How much slower `joint` turns under the load, rad/s.
    fn droop(&self, joint: usize, points: &[[f64; 2]]) -> f64 {
        let until = match self.config.angles {
            Angles::Absolute => joint + 1,
            Angles::Relative => self.config.lengths.len(),
        };
        self.droop * (points[until][0] - points[joint][0])
    }
}

impl StateSpace for ArmModel {
    fn states(&self) -> usize {
        self.config.lengths.len() + 2
    }

    fn dynamic_states(&self) -> usize {
        self.config.lengths.len()
    }

    fn wraps(&self, i: usize) -> bool {
        i < self.config.lengths.len() && self.config.limits.is_empty()
    }

    fn commands(&self) -> usize {
        self.config.lengths.len()
    }

    fn step(&self, state: &mut [f64], command: &[f64]) -> f64 {
        let joints = self.config.lengths.len();
        let before = self.points(state);
        let (mut rates, mut angles) = (0.0, 0.0);
        for joint in 0..joints {
            if let Some(angle) = self.fixed[joint] {
                if self.config.reward.blocked_pays {
                    rates += (self.config.gain * command[joint]) * (self.config.gain * command[joint]);
                }
                state[joint] = angle;
            } else {
                let wanted = self.config.gain * command[joint] - self.droop(joint, &before);
                let free = state[joint] + self.period * wanted;
                let (reached, rate) = match self.config.limits.get(joint) {
                    Some(&[low, high]) => {
                        let reached = free.clamp(low, high);
                        (reached, (reached - state[joint]) / self.period)
                    }
                    None => (wrap_f64(free), wanted),
                };
                state[joint] = reached;
                rates += rate * rate;
            }
            angles += state[joint] * state[joint];
        }
        let end = self.points(state)[joints];
        let error = (0..2).map(|i| (end[i] - state[joints + i]) * (end[i] - state[joints + i])).sum::<f64>();
        let reward = &self.config.reward;
        let gain = reward.near.map_or(-error, |near| (near * near - error).max(0.0));
        reward.scale * (gain - reward.speed * rates - reward.angle * angles)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plant::{Arm, BlockConfig, PayloadConfig, Plant as _, ShortenConfig};

    /// The arm itself computes in single precision.
    #[test]
    fn the_model_is_the_arm() {
        for (angles, stops) in [(Angles::Absolute, false), (Angles::Relative, false), (Angles::Relative, true)] {
            let config = ArmConfig {
                angles,
                limits: if stops { vec![[-2.0, 2.0]; 4] } else { Vec::new() },
                block: vec![BlockConfig { joint: 3, tick: 40, angle: 0.2 }],
                shorten: vec![ShortenConfig { segment: 2, tick: 50, length: 0.3 }],
                payload: vec![PayloadConfig { tick: 20, mass: 0.2, droop: 0.5 }],
                ..ArmConfig::default()
            };
            let mut arm = Arm::new(&config, 0.05, 3);
            let mut inputs = [0.0; 6];
            for tick in 0..100 {
                arm.sense(tick, &mut inputs);
                let model = ArmModel::new(&config, 0.05, tick);
                let mut state: Vec<f64> = inputs[2..].iter().chain(&inputs[..2]).map(|&x| f64::from(x)).collect();
                let command = [0, 1, 2, 3].map(|i| 0.02 * libm::sinf((tick as f32 + 3.0 * i as f32) * 0.7));
                let reward = model.step(&mut state, &command.map(f64::from));
                let outcome = arm.advance(tick, &command);
                assert!((reward - f64::from(outcome.reward)).abs() < 1e-5, "{tick}: {reward} {outcome:?}");
            }
            assert!(inputs[4] == 0.2);
        }
    }
}
