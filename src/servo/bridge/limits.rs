//! What the bridge limits itself, after the gate: the first commands after torque came on, and the speeds and ranges of
//! the motors.

use super::{Bridge, chain};
use crate::wire::{MAX_OUTPUTS, OutputValues, flag};

impl Bridge {
    /// Limits the first commands after torque came on to a growing fraction of the largest command. The gate's
    /// own ramp begins with the first command, which may be long before arming. Returns the flags of what was
    /// limited.
    pub(super) fn limit_to_ramp(&self, applied: &mut [f32]) -> u32 {
        if self.torque_ticks >= self.ramp {
            return 0;
        }
        let mut flags = 0;
        for (u, max) in applied.iter_mut().zip(self.largest_commands()) {
            let limited = u.clamp(-max, max);
            if limited != *u {
                (*u, flags) = (limited, flag::CLAMPED | flag::RAMPED);
            }
        }
        flags
    }

    /// The largest command of each output in this tick.
    fn largest_commands(&self) -> OutputValues {
        if self.torque_ticks >= self.ramp {
            return self.max_command;
        }
        let fraction = (self.torque_ticks + 1) as f32 / (self.ramp + 1) as f32;
        self.max_command.map(|max| max * fraction)
    }

    /// Limits `applied` to the motors' speeds and ranges. Returns the motors' rates, rad/s, and the flags of
    /// what was limited.
    pub(super) fn limit_to_motors(&self, applied: &mut [f32]) -> ([f64; MAX_OUTPUTS], u32) {
        let n = self.moving;
        let (mut requested, mut rates) = ([0.0; MAX_OUTPUTS], [0.0; MAX_OUTPUTS]);
        for (rate, u) in requested.iter_mut().zip(applied.iter()) {
            *rate = f64::from(self.gain * u);
        }
        chain::motors(self.angles, &requested[..n], &mut rates);
        let (fast, far) = chain::limit(&self.joints, &self.motors[..n], f64::from(self.period), &mut rates);
        if fast || far {
            for (u, rate) in applied.iter_mut().zip(chain::along(self.angles, &rates)) {
                *u = rate as f32 / self.gain;
            }
            self.keep_commands_small(applied, &mut rates);
        }
        let flags = if fast { flag::CLAMPED } else { 0 } | if far { flag::CLAMPED | flag::POSITION_LIMITED } else { 0 };
        (rates, flags)
    }

    /// A motor that stops at its end no longer makes up for the motors before it, so that a direction behind it may
    /// turn faster than any command may ask for. Then all motors turn slower.
    fn keep_commands_small(&self, applied: &mut [f32], rates: &mut [f64; MAX_OUTPUTS]) {
        let largest = self.largest_commands();
        let excess = applied.iter().zip(largest).map(|(u, max)| u.abs() / max).fold(1.0, f32::max);
        if excess > 1.0 {
            rates.iter_mut().for_each(|rate| *rate /= f64::from(excess));
            for (u, max) in applied.iter_mut().zip(largest) {
                *u = (*u / excess).clamp(-max, max);
            }
        }
    }
}
