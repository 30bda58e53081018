//! Exponential, sine and cosine of many numbers: polynomials without branches, so that the compiler makes vectors of
//! them, with the same bits on every machine. Errors are below 1e-11, which is less than a model knows.

use tectum_encoder::simd::{F32x8, Kernel, SimdPath};

use super::linalg::wide;

/// `1.5 * 2^52`: adding and subtracting it rounds a number to the nearest integer.
const ROUND: f64 = 6_755_399_441_055_744.0;
/// `2 pi` in two parts, the first of which has zeros at its end.
const TAU_HIGH: f64 = f64::from_bits(0x4019_21fb_5444_0000);
const TAU_LOW: f64 = std::f64::consts::TAU - TAU_HIGH;

/// Sine and cosine of `x`, for magnitudes up to 1e5.
#[inline(always)]
pub fn sin_cos(x: f64) -> (f64, f64) {
    let turns = (x * std::f64::consts::FRAC_1_PI * 0.5 + ROUND) - ROUND;
    // Half of the angle, in [-pi / 2, pi / 2].
    let h = 0.5 * ((x - turns * TAU_HIGH) - turns * TAU_LOW);
    let q = h * h;
    let s = h
        * (1.0
            + q * (-1.0 / 6.0
                + q * (1.0 / 120.0
                    + q * (-1.0 / 5040.0
                        + q * (1.0 / 362_880.0
                            + q * (-1.0 / 39_916_800.0
                                + q * (1.0 / 6_227_020_800.0 + q * (-1.0 / 1_307_674_368_000.0))))))));
    let c = 1.0
        + q * (-0.5
            + q * (1.0 / 24.0
                + q * (-1.0 / 720.0
                    + q * (1.0 / 40_320.0
                        + q * (-1.0 / 3_628_800.0
                            + q * (1.0 / 479_001_600.0
                                + q * (-1.0 / 87_178_291_200.0 + q * (1.0 / 20_922_789_888_000.0))))))));
    (2.0 * s * c, c * c - s * s)
}

wide! {
    /// Sines and cosines of `x`.
    sines_and_cosines, sines_and_cosines_on, SinesAndCosines,
    plain_sines_and_cosines(x: &'a [f64], sines: &'a mut [f64], cosines: &'a mut [f64]) -> ()
}

#[inline(always)]
fn plain_sines_and_cosines(x: &[f64], sines: &mut [f64], cosines: &mut [f64]) {
    for ((x, s), c) in x.iter().zip(sines).zip(cosines) {
        (*s, *c) = sin_cos(*x);
    }
}

/// The exponential of `x`; below -700 it is that of -700, above 700 that of 700.
#[inline(always)]
pub fn exp(x: f64) -> f64 {
    const LN_2_HIGH: f64 = 0.693_147_180_369_123_8;
    const LN_2_LOW: f64 = 1.908_214_929_270_587_7e-10;
    let x = x.clamp(-700.0, 700.0);
    let shifted = x * std::f64::consts::LOG2_E + ROUND;
    let n = shifted - ROUND;
    let r = (x - n * LN_2_HIGH) - n * LN_2_LOW;
    let p = 1.0
        + r * (1.0
            + r * (0.5
                + r * (1.0 / 6.0
                    + r * (1.0 / 24.0
                        + r * (1.0 / 120.0
                            + r * (1.0 / 720.0
                                + r * (1.0 / 5040.0 + r * (1.0 / 40_320.0 + r * (1.0 / 362_880.0)))))))));
    // The lowest bits of `shifted` are the integer `n`; it becomes the exponent of 2^n.
    let power = f64::from_bits(shifted.to_bits().wrapping_add(1023) << 52);
    p * power
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn polynomials_agree_with_libm() {
        for i in -2000..=2000 {
            let x = f64::from(i) * 0.0371;
            let (s, c) = sin_cos(x);
            assert!((s - libm::sin(x)).abs() < 2e-11 && (c - libm::cos(x)).abs() < 2e-11, "{x}: {s} {c}");
            let e = exp(x);
            assert!((e / libm::exp(x) - 1.0).abs() < 1e-10, "exp {x}: {e}");
        }
    }
}
