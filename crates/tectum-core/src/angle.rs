//! Angles on the circle: the one place where an angle is brought into the range [-pi, pi).

use std::f32::consts::PI;

/// `angle`, rad, less whole turns: in [-pi, pi), within the rounding of single precision.
#[inline]
pub fn wrap(angle: f32) -> f32 {
    let turned = angle + PI;
    // In the common case nothing is subtracted, so that division and floor can be skipped without changing a bit.
    if (0.0..2.0 * PI).contains(&turned) { angle } else { angle - 2.0 * PI * libm::floorf(turned / (2.0 * PI)) }
}

/// `angle`, rad, less whole turns: in [-pi, pi), within the rounding of double precision.
pub fn wrap_f64(angle: f64) -> f64 {
    use std::f64::consts::{PI, TAU};
    angle - TAU * libm::floor((angle + PI) / TAU)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_shortcut_gives_the_bits_of_the_formula() {
        let formula = |theta: f32| theta - 2.0 * PI * libm::floorf((theta + PI) / (2.0 * PI));
        let mut edges = vec![0.0, -0.0, PI, -PI, 2.0 * PI, 1e-30, -1e-30];
        for step in 1..2000 {
            for edge in [PI, -PI, 3.0 * PI, -3.0 * PI] {
                edges.extend([step, -step].map(|step| f32::from_bits((edge.to_bits() as i32 + step) as u32)));
            }
            edges.extend([1e-3, 7e-3, 0.5].map(|by| (step as f32 - 1000.0) * by));
        }
        for theta in edges {
            assert_eq!(wrap(theta).to_bits(), formula(theta).to_bits(), "{theta:e}");
        }
    }

    #[test]
    fn both_precisions_keep_the_direction_and_come_within_half_a_turn() {
        for turns in -3..=3 {
            for angle in [-3.0, -1.0, 0.0, 0.5, 3.0] {
                let shifted = angle + f64::from(turns) * std::f64::consts::TAU;
                assert!((wrap_f64(shifted) - angle).abs() < 1e-12, "{shifted}");
                assert!((f64::from(wrap(shifted as f32)) - angle).abs() < 1e-5, "{shifted}");
            }
        }
    }
}
