//! The numbers behind the exponential: what the kernel and its scalar twin must agree on to the last bit.
//!
//! A unit's activation is `2^-y` with `y` the square of the scaled distance. It is computed as `2^-n * 2^g`, where
//! `n` is `y` rounded to an integer and `g = n - y` lies in [-1/2, 1/2]: `2^g` is a polynomial, `2^-n` goes straight
//! into the exponent bits.

/// Largest `y`: just under `30 log2(e) = 43.2808..`, so that no unit of a line falls below exp(-30).
///
/// Without it a unit far from the input would be a subnormal, and a subnormal costs the learner's loop up to twice its
/// time. In a plane the smallest product is exp(-60), still far from the smallest normal number.
pub(super) const FLOOR: f32 = 43.28;

/// The `y` of a pad: `2^-127` loses its last exponent bit, which leaves exactly 0 (given that the polynomial is
/// exactly 1 at 0). A pad so costs nothing: no mask, no branch.
pub(super) const VANISH: f32 = 127.0;

/// `1.5 * 2^23`: adding it rounds to the nearest integer, and leaves that integer in the lowest bits of the sum.
pub(super) const MAGIC: f32 = 12_582_912.0;

/// Places between the lowest bit of a float and its exponent.
pub(super) const MANTISSA_BITS: i32 = 23;

/// `2^g` on [-1/2, 1/2], from the constant term up: relative error at most 9.5e-8.
///
/// Found by Remez exchange, then by a random search over neighbouring `f32` with the constant held at 1, so that a unit
/// that is hit exactly answers with exactly 1, and a pad with exactly 0.
pub(super) const POLYNOMIAL: [f32; 6] = [1.0, 0.693_146_94, 0.240_222_35, 0.055_508_06, 0.009_671_954, 0.001_323_709_6];

/// `2^96`, the unit in which sums of squares are kept.
///
/// A plane far outside its range has features near exp(-60), whose squares a plain `f32` cannot hold: a plane's sum
/// lies between `2^-172` and `2^24`. Scaled by this power of two, products, totals and reciprocals all stay normal
/// numbers, and nothing is rounded by it.
pub(super) const SUM_SCALE: f32 = (1u128 << 96) as f32;

/// The root of [`SUM_SCALE`].
const NORM_SCALE: f32 = (1u64 << 48) as f32;

/// Largest scaled input in magnitude: far outside any map, but finite, so that its distance to a pad's centre, which
/// is infinity, is never NaN.
const LIMIT: f32 = 1e30;

/// An input in a line's unit of length. NaN, which callers are to keep away, ends at the limit.
#[inline(always)]
pub(super) fn scaled(input: f32, scale: f32) -> f32 {
    let x = input * scale;
    // Not `clamp`: these two are one instruction each, and do not let NaN through.
    let x = if x > -LIMIT { x } else { -LIMIT };
    if x < LIMIT { x } else { LIMIT }
}

/// The factor that gives features the norm 1, from their sum of squares in units of [`SUM_SCALE`].
///
/// Root and reciprocal do not wait for each other; the next pass waits for both.
#[inline(always)]
pub(super) fn inverse_norm(sum: f32) -> f32 {
    sum.sqrt() * (NORM_SCALE / sum)
}
