//! The numbers behind the exponential: what the kernel and its scalar twin must agree on to the last bit.
//!
//! A unit's activation is `2^-y` with `y = (distance * sharpness)^2`. It is computed as `2^-n * 2^-g`, where `n` is `y`
//! rounded to an integer and `g = y - n` lies in [-1/2, 1/2]: `2^-g` is a polynomial, `2^-n` goes straight into the
//! exponent bits.

/// Largest `y`: just under `30 log2(e) = 43.2808..`, so that no unit of a line falls below exp(-30).
///
/// Without it a unit far from the input would be a subnormal, and a subnormal costs the learner's loop up to twice its
/// time. In a plane the smallest product is exp(-60), still far from the smallest normal number.
pub(super) const FLOOR: f32 = 43.28;

/// The `y` of a pad: `2^-127` loses its last exponent bit, which leaves exactly 0 (given that the polynomial is exactly 1
/// at 0). A pad so costs nothing: no mask, no branch.
pub(super) const VANISH: f32 = 127.0;

/// `1.5 * 2^23`: adding it rounds to the nearest integer, and leaves that integer in the lowest bits of the sum.
pub(super) const MAGIC: f32 = 12_582_912.0;

/// Places between the lowest bit of a float and its exponent.
pub(super) const MANTISSA_BITS: u32 = 23;

/// `2^-g` on [-1/2, 1/2], from the constant term up: least relative error, 9.5e-8, among polynomials of degree 5 with
/// these rounded coefficients.
///
/// Found by Remez exchange, and then by a search over neighbouring `f32` with the constant held at 1, so that a unit that
/// is hit exactly answers with exactly 1.
pub(super) const POLYNOMIAL: [f32; 6] =
    [1.0, -0.693_146_94, 0.240_222_35, -0.055_508_06, 0.009_671_954, -0.001_323_709_6];

/// `2^60`, the unit in which sums of squares are kept.
///
/// A plane far outside its range has features near exp(-60), whose squares a plain `f32` cannot hold. A line's sum lies
/// between `2^-87` and `2^12`: scaled once per map by this power of two, products and totals stay normal numbers.
pub(super) const SUM_SCALE: f32 = (1u64 << 60) as f32;

/// `2^30`, the root of [`SUM_SCALE`].
pub(super) const NORM_SCALE: f32 = (1u64 << 30) as f32;
