//! Conversions between raw positions, angles of motors, and directions of segments.

use tectum_core::angle::wrap_f64;

use crate::scenario::{Angles, JointConfig};
use crate::servo::model::{STEP, STEPS_PER_TURN};
use crate::wire::MAX_OUTPUTS;

/// A motor's angle at a raw position, rad: within half a turn of the middle of its range, because the number of
/// whole turns is lost with power or signal.
pub fn angle(joint: &JointConfig, raw: i32) -> f64 {
    let steps = (raw - joint.zero).rem_euclid(STEPS_PER_TURN);
    let angle = f64::from(joint.direction) * f64::from(steps) * STEP;
    let middle = if joint.is_free() { 0.0 } else { (joint.range[0] + joint.range[1]) / 2.0 };
    middle + wrap_f64(angle - middle)
}

/// The raw position of a motor at an angle, rad. It may lie outside 0 to 4095.
pub fn raw(joint: &JointConfig, angle: f64) -> i32 {
    joint.zero + libm::round(f64::from(joint.direction) * angle / STEP) as i32
}

/// Converts angles or rates of motors to those of outputs: running sums along the chain if outputs are directions.
pub fn along(angles: Angles, motors: &[f64]) -> impl Iterator<Item = f64> {
    motors.iter().scan(0.0, move |sum, motor| {
        *sum = if angles == Angles::Absolute { *sum + motor } else { *motor };
        Some(*sum)
    })
}

/// Converts angles of motors to angles of outputs; directions are wrapped.
pub fn outputs(angles: Angles, motors: &[f64], outputs: &mut [f32]) {
    for (to, angle) in outputs.iter_mut().zip(along(angles, motors)) {
        *to = if angles == Angles::Absolute { wrap_f64(angle) } else { angle } as f32;
    }
}

/// Converts rates of outputs to rates of motors: differences along the chain if outputs are directions.
pub fn motors(angles: Angles, rates: &[f64], motors: &mut [f64; MAX_OUTPUTS]) {
    let mut before = 0.0;
    for (to, &rate) in motors.iter_mut().zip(rates) {
        *to = rate - before;
        if angles == Angles::Absolute {
            before = rate;
        }
    }
}

/// Limits the motors' rates for a tick of `period` s. First all rates are scaled by the same factor to keep the
/// maximum speeds, so that the end-effector keeps its direction; then each rate is limited so that the motor
/// stays in its range. A motor outside its range may return. Returns whether a speed and whether a range
/// limited the rates.
pub fn limit(joints: &[JointConfig], at: &[f64], period: f64, rates: &mut [f64; MAX_OUTPUTS]) -> (bool, bool) {
    let scale = joints.iter().zip(rates.iter()).fold(1.0_f64, |scale, (joint, rate)| {
        if rate.abs() * scale > joint.max_speed { joint.max_speed / rate.abs() } else { scale }
    });
    let mut stopped = false;
    for ((joint, &at), rate) in joints.iter().zip(at).zip(rates.iter_mut()) {
        *rate *= scale;
        if !joint.is_free() {
            let [low, high] = joint.range;
            let limits = [(low - at).min(0.0) / period, (high - at).max(0.0) / period];
            let within = rate.clamp(limits[0], limits[1]);
            stopped |= within != *rate;
            *rate = within;
        }
    }
    (scale < 1.0, stopped)
}

#[cfg(test)]
mod tests {
    use std::f64::consts::PI;

    use super::*;
    use proptest::prelude::*;

    fn joint(direction: i32, zero: i32, range: [f64; 2]) -> JointConfig {
        JointConfig { id: 1, name: None, direction, zero, range, max_speed: 6.0, registers: Default::default() }
    }

    #[test]
    fn angles_of_known_positions() {
        let free = joint(-1, 1024, [-PI, PI]);
        assert!((angle(&free, 2048) + PI / 2.0).abs() < 1e-12);
        assert!((angle(&free, 2048 + 3 * 4096) + PI / 2.0).abs() < 1e-12, "whole turns do not count");
        // A range of more than half a turn: 4 rad is not wrapped.
        let wide = joint(1, 0, [0.0, 5.0]);
        assert!((angle(&wide, raw(&wide, 4.0)) - 4.0).abs() < STEP);
    }

    proptest! {
        #[test]
        fn motors_and_outputs_are_inverse_to_each_other(
            rates in proptest::array::uniform4(-6.0_f64..6.0), relative in any::<bool>(),
        ) {
            let kind = if relative { Angles::Relative } else { Angles::Absolute };
            let mut motor = [0.0; MAX_OUTPUTS];
            motors(kind, &rates, &mut motor);
            for (rate, back) in rates.iter().zip(along(kind, &motor)) {
                prop_assert!((back - rate).abs() < 1e-9);
            }
        }

        #[test]
        fn limited_rates_keep_speed_and_range(
            rates in proptest::array::uniform8(-100.0_f64..100.0), at in proptest::array::uniform4(-4.0_f64..4.0),
        ) {
            let joints: Vec<_> = (0..4).map(|_| joint(1, 2048, [-2.0, 2.5])).collect();
            let mut limited = [0.0; MAX_OUTPUTS];
            limited[..8].copy_from_slice(&rates);
            limit(&joints, &at, 0.05, &mut limited);
            for (rate, at) in limited.iter().zip(at) {
                prop_assert!(rate.abs() <= 6.0 + 1e-9);
                let reached = at + 0.05 * rate;
                prop_assert!((at.min(-2.0) - 1e-9..=at.max(2.5) + 1e-9).contains(&reached));
            }
        }
    }
}
