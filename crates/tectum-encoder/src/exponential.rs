//! The exponential and its constants, shared by the SIMD kernel and the scalar implementation, which must agree
//! to the last bit.
//!
//! A unit's activation is `2^-y` with `y` the square of the scaled distance. It is computed as `2^-n * 2^g`,
//! where `n` is `y` rounded to an integer and `g = n - y` lies in [-1/2, 1/2]: `2^g` is a polynomial, `2^-n`
//! goes straight into the exponent bits.

use crate::simd::F32x16;

/// Upper limit of `y` for a unit: just under `30 log2(e) = 43.2808..`, so that no activation of a line is below
/// exp(-30).
///
/// Without the limit, a unit far from the input would be subnormal, and subnormal numbers make the learner's
/// loop take up to twice as long. In a plane the smallest product is exp(-60), still far above the smallest
/// normal number.
pub(super) const FLOOR: f32 = 43.28;

/// The `y` of a padding unit: the exponent field of `2^-127` is 0, so the result is exactly 0 (given that the
/// polynomial is exactly 1 at 0). Padding therefore needs no mask and no branch.
pub(super) const VANISH: f32 = 127.0;

/// `1.5 * 2^23`: adding it rounds to the nearest integer and leaves that integer in the lowest bits of the sum.
const MAGIC: f32 = 12_582_912.0;

/// Number of mantissa bits: the position of the exponent in an `f32`.
const MANTISSA_BITS: i32 = 23;

/// `2^g` on [-1/2, 1/2], from the constant term up: relative error at most 9.5e-8.
///
/// Found by Remez exchange, then by a random search over neighbouring `f32` with the constant fixed at 1. With that
/// constant, a unit whose centre equals the input has an activation of exactly 1, and padding is exactly 0.
const POLYNOMIAL: [f32; 6] = [1.0, 0.693_146_94, 0.240_222_35, 0.055_508_06, 0.009_671_954, 0.001_323_709_6];

/// `2^96`, the scale factor of sums of squares.
///
/// A plane whose inputs are far outside its range has features near exp(-60), whose squares an `f32` cannot
/// hold: the sum of squares of a plane lies between `2^-172` and `2^24`. With this factor, products, totals and
/// reciprocals are all normal numbers. It is a power of two, so it adds no rounding error.
pub(super) const SUM_SCALE: f32 = (1u128 << 96) as f32;

/// The square root of [`SUM_SCALE`].
const NORM_SCALE: f32 = (1u64 << 48) as f32;

/// Largest magnitude of a scaled input. It is far outside any map, but finite, so that the distance to the
/// centre of a padding unit, which is infinity, is never NaN.
const LIMIT: f32 = 1e30;

/// An input in a line's unit of length, limited to [`LIMIT`]. NaN, which callers should not pass, gives the limit.
#[inline(always)]
pub(super) fn scaled(input: f32, scale: f32) -> f32 {
    let x = input * scale;
    // Not `clamp`: these two comparisons are one instruction each, and replace NaN.
    let x = if x > -LIMIT { x } else { -LIMIT };
    if x < LIMIT { x } else { LIMIT }
}

/// `2^-min(y, floor)` for `y >= 0` and `floor <= 127`, with a relative error of at most 1e-7; NaN gives `2^-floor`.
///
/// Uses no library function, so the bits are the same on every machine. The SIMD kernel does the same operations on
/// eight lanes.
#[doc(hidden)]
#[inline(always)]
pub fn exp2_negative(y: f32, floor: f32) -> f32 {
    let y = if y < floor { y } else { floor };
    let n = y + MAGIC;
    let g = (n - MAGIC) - y;
    let [c0, c1, c2, c3, c4, c5] = POLYNOMIAL;
    let g2 = g * g;
    let p = ((c5 * g + c4) * g2 + (c3 * g + c2)) * g2 + (c1 * g + c0);
    f32::from_bits(p.to_bits().wrapping_sub(n.to_bits() << MANTISSA_BITS))
}

/// [`exp2_negative`] of sixteen numbers that are limited already: `2^-y` for `0 <= y <= 127`.
#[doc(hidden)]
#[inline(always)]
pub fn exp2_negative_lanes<W: F32x16>(y: W) -> W {
    let magic = W::splat(MAGIC);
    let n = y + magic;
    let g = (n - magic) - y;
    // Estrin's scheme: one multiplication more than Horner's, with half the length of the dependent chain.
    let [c0, c1, c2, c3, c4, c5] = POLYNOMIAL;
    let g2 = g * g;
    let p = (W::splat(c5) * g + W::splat(c4)) * g2 + (W::splat(c3) * g + W::splat(c2));
    let p = p * g2 + (W::splat(c1) * g + W::splat(c0));
    // `p / 2^n`; `n` is in the lowest bits of the sum with `MAGIC`.
    p.less_exponent::<MANTISSA_BITS>(n)
}

/// The factor that scales features to norm 1, from their sum of squares times [`SUM_SCALE`].
///
/// Square root and reciprocal are independent of each other, so the processor computes them at the same time.
#[inline(always)]
pub(super) fn inverse_norm(sum: f32) -> f32 {
    sum.sqrt() * (NORM_SCALE / sum)
}
