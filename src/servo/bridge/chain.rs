//! Motors and segments: raw positions to angles, directions to motors' rates and back.

use std::f64::consts::{PI, TAU};

use crate::scenario::{Angles, JointConfig};
use crate::servo::model::{STEP, STEPS_PER_TURN};
use crate::wire::MAX_OUTPUTS;

/// To [-pi, pi).
pub(super) fn wrap(angle: f64) -> f64 {
    angle - TAU * libm::floor((angle + PI) / TAU)
}

/// A motor's angle at a raw position, rad: within half a turn of the middle of its range, since a position says
/// nothing of whole turns that power or a wire has lost.
pub fn angle(joint: &JointConfig, raw: i32) -> f64 {
    let steps = (raw - joint.zero).rem_euclid(STEPS_PER_TURN);
    let angle = f64::from(joint.direction) * f64::from(steps) * STEP;
    let middle = if joint.is_free() { 0.0 } else { (joint.range[0] + joint.range[1]) / 2.0 };
    middle + wrap(angle - middle)
}

/// The raw position of a motor at an angle, rad.
#[cfg(test)]
pub fn raw(joint: &JointConfig, angle: f64) -> i32 {
    joint.zero + libm::round(f64::from(joint.direction) * angle / STEP) as i32
}

/// What motors' angles or rates are as outputs: sums along the chain where those are directions.
pub fn along(angles: Angles, motors: &[f64]) -> impl Iterator<Item = f64> {
    motors.iter().scan(0.0, move |sum, motor| {
        *sum = if angles == Angles::Absolute { *sum + motor } else { *motor };
        Some(*sum)
    })
}

/// The outputs' angles of motors' angles; directions come round.
pub fn outputs(angles: Angles, motors: &[f64], outputs: &mut [f32]) {
    for (to, angle) in outputs.iter_mut().zip(along(angles, motors)) {
        *to = if angles == Angles::Absolute { wrap(angle) } else { angle } as f32;
    }
}

/// The motors' rates of the outputs' rates: differences along the chain where those are of directions.
pub fn motors(angles: Angles, rates: &[f64], motors: &mut [f64; MAX_OUTPUTS]) {
    let mut before = 0.0;
    for (to, &rate) in motors.iter_mut().zip(rates) {
        *to = rate - before;
        if angles == Angles::Absolute {
            before = rate;
        }
    }
}

/// Brings motors' rates within what they can and may do in `period` s. Speed first, all by the same share, so
/// that the end keeps its direction; then each by itself, so that it does not go over its range. A motor that
/// is outside may come back. Whether speed, and whether a range limited them.
pub fn limit(joints: &[JointConfig], at: &[f64], period: f64, rates: &mut [f64; MAX_OUTPUTS]) -> (bool, bool) {
    let share = joints.iter().zip(rates.iter()).fold(1.0_f64, |share, (joint, rate)| {
        if rate.abs() * share > joint.max_speed { joint.max_speed / rate.abs() } else { share }
    });
    let mut stopped = false;
    for ((joint, &at), rate) in joints.iter().zip(at).zip(rates.iter_mut()) {
        *rate *= share;
        if !joint.is_free() {
            let [low, high] = joint.range;
            let span = [(low - at).min(0.0) / period, (high - at).max(0.0) / period];
            let within = rate.clamp(span[0], span[1]);
            stopped |= within != *rate;
            *rate = within;
        }
    }
    (share < 1.0, stopped)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn joint(direction: i32, zero: i32, range: [f64; 2]) -> JointConfig {
        JointConfig { id: 1, direction, zero, range, max_speed: 6.0 }
    }

    #[test]
    fn angles_come_from_positions_as_one_works_out_by_hand() {
        let free = joint(-1, 1024, [-PI, PI]);
        assert!((angle(&free, 2048) + PI / 2.0).abs() < 1e-12);
        assert!((angle(&free, 2048 + 3 * 4096) + PI / 2.0).abs() < 1e-12, "whole turns do not count");
        // A range beyond half a turn: 4 rad is 4 rad, not 4 less a turn.
        let wide = joint(1, 0, [0.0, 5.0]);
        assert!((angle(&wide, raw(&wide, 4.0)) - 4.0).abs() < STEP);
    }

    proptest! {
        #[test]
        fn motors_and_outputs_are_each_others_inverse(
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
        fn what_is_left_is_within_speed_and_range(
            rates in proptest::array::uniform8(-100.0_f64..100.0), at in proptest::array::uniform4(-4.0_f64..4.0),
        ) {
            let joints: Vec<_> = (0..4).map(|_| joint(1, 2048, [-2.0, 2.5])).collect();
            let mut left = rates;
            limit(&joints, &at, 0.05, &mut left);
            for (rate, at) in left.iter().zip(at) {
                prop_assert!(rate.abs() <= 6.0 + 1e-9);
                let there = at + 0.05 * rate;
                prop_assert!((at.min(-2.0) - 1e-9..=at.max(2.5) + 1e-9).contains(&there));
            }
        }
    }
}
