//! Numbers of sixteen rollouts side by side, and functions of them that need more than the operations of lanes.
//!
//! The functions are plain loops over arrays, from which the compiler makes vectors. They give the bits of the
//! functions of one number that they are named after.

use bytemuck::{Pod, Zeroable};
use tectum_encoder::simd::{F32x8, F32x16, LANES, WIDE_LANES};

use crate::angle;

/// Number of rollouts side by side.
pub(super) const ROLLOUTS: usize = WIDE_LANES;

/// One number of each of sixteen rollouts.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
#[repr(C, align(64))]
pub(super) struct Lanes(pub [f32; ROLLOUTS]);

impl Lanes {
    /// All 0.
    pub const ZERO: Self = Self([0.0; ROLLOUTS]);
}

/// `a / by`.
#[inline(always)]
pub(super) fn divided<W: F32x16>(a: W, by: f32) -> W {
    let mut lanes = a.store();
    for x in &mut lanes {
        *x /= by;
    }
    W::load(&lanes)
}

/// `1 / sqrt(a)`, rounded twice.
#[inline(always)]
pub(super) fn inverse_root<W: F32x16>(a: W) -> W {
    let mut lanes = a.store();
    for x in &mut lanes {
        *x = 1.0 / x.sqrt();
    }
    W::load(&lanes)
}

/// [`angle::wrap`].
#[inline(always)]
pub(super) fn wrap<W: F32x16>(angle: W) -> W {
    use std::f32::consts::PI;
    let mut lanes = angle.store();
    let mut is_inside = true;
    for x in &lanes {
        let turned = x + PI;
        is_inside &= (0.0..2.0 * PI).contains(&turned);
    }
    if !is_inside {
        wrap_each(&mut lanes);
    }
    W::load(&lanes)
}

/// Rarely needed.
#[cold]
#[inline(never)]
fn wrap_each(lanes: &mut [f32; ROLLOUTS]) {
    for x in lanes {
        *x = angle::wrap(*x);
    }
}

/// Where [`libm::sincosf`] goes from one quarter of a turn to the next: rounded multiples of `pi / 4`.
const QUARTERS: [f32; 3] = [f32::from_bits(0x3f49_0fda), f32::from_bits(0x4016_cbe3), f32::from_bits(0x407b_53d1)];

/// libm's polynomials on `[-pi / 4, pi / 4]`, without their first terms.
const SINE: [f64; 4] = [
    f64::from_bits(0xbfc5_5555_54cb_ac77),
    f64::from_bits(0x3f81_1110_896e_fbb2),
    f64::from_bits(0xbf2a_00f9_e2ca_e774),
    f64::from_bits(0x3ec6_cd87_8c3b_46a7),
];
const COSINE: [f64; 4] = [
    f64::from_bits(0xbfdf_ffff_fd0c_5e81),
    f64::from_bits(0x3fa5_5553_e105_3a42),
    f64::from_bits(0xbf56_c087_e80f_1e27),
    f64::from_bits(0x3ef9_9342_e0ee_5069),
];

/// Sine and cosine, with the bits of [`libm::sincosf`].
#[inline(always)]
pub(super) fn sine_and_cosine<W: F32x16>(x: W) -> [W; 2] {
    let lanes = x.store();
    let (mut sines, mut cosines) = ([0.0; ROLLOUTS], [0.0; ROLLOUTS]);
    let mut is_near = true;
    for ((&x, sine), cosine) in lanes.iter().zip(&mut sines).zip(&mut cosines) {
        (*sine, *cosine) = near_sine_and_cosine(x);
        is_near &= x.abs() <= QUARTERS[2];
    }
    if !is_near {
        far_sines_and_cosines(&lanes, &mut sines, &mut cosines);
    }
    [W::load(&sines), W::load(&cosines)]
}

/// Not needed for angles that are wrapped.
#[cold]
#[inline(never)]
fn far_sines_and_cosines(x: &[f32; ROLLOUTS], sines: &mut [f32; ROLLOUTS], cosines: &mut [f32; ROLLOUTS]) {
    for ((x, sine), cosine) in x.iter().zip(sines).zip(cosines) {
        (*sine, *cosine) = libm::sincosf(*x);
    }
}

/// Sine and cosine of `x` up to `5 pi / 4`: libm's operations (of FreeBSD's msun), with choices instead of branches.
#[inline(always)]
fn near_sine_and_cosine(x: f32) -> (f32, f32) {
    use std::f64::consts::{FRAC_PI_2, PI};
    let size = x.abs();
    let (is_second, is_third) = (size > QUARTERS[0], size > QUARTERS[1]);
    let wide = f64::from(size);
    let turned = if is_second { FRAC_PI_2 - wide } else { wide };
    let y = if is_third { wide - PI } else { turned };
    let z = y * y;
    let w = z * z;
    let r = SINE[2] + z * SINE[3];
    let s = z * y;
    let sine = (y + s * (SINE[0] + z * SINE[1])) + s * w * r;
    let r = COSINE[2] + z * COSINE[3];
    let cosine = ((1.0 + z * COSINE[0]) + w * COSINE[1]) + (w * z) * r;
    let (sine, cosine) = (sine as f32, cosine as f32);
    // In the second quarter they change places, in the third their signs.
    let is_swapped = is_second & !is_third;
    let (a, b) = if is_swapped { (cosine, sine) } else { (sine, cosine) };
    let (a, b) = if is_third { (-a, -b) } else { (a, b) };
    let signed = f32::from_bits(a.to_bits() ^ (x.to_bits() & 0x8000_0000));
    // libm returns the smallest angles as they are, with the sign of a zero.
    let is_tiny = size < 2.0_f32.powi(-12);
    (if is_tiny { x } else { signed }, if is_tiny { 1.0 } else { b })
}

/// Writes the transposed matrix of sixteen rows to `to`.
#[inline(always)]
pub(super) fn transpose<L: F32x8>(of: &[Lanes; ROLLOUTS], to: &mut [Lanes; ROLLOUTS]) {
    for i in 0..2 {
        for j in 0..2 {
            let mut block = [L::splat(0.0); LANES];
            for k in 0..LANES {
                block[k] = L::load(&of[LANES * i + k].0.as_chunks().0[j]);
            }
            let block = L::transposed(block);
            for k in 0..LANES {
                to[LANES * j + k].0.as_chunks_mut().0[i] = block[k].store();
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tectum_encoder::simd::{Kernel, SimdPath};

    /// Functions of sixteen numbers: sine, cosine, wrapped angle.
    struct Functions([f32; ROLLOUTS]);

    impl Kernel for Functions {
        type Output = [[f32; ROLLOUTS]; 3];
        const IS_WIDE: bool = true;

        fn run<L: F32x8>(self) -> Self::Output {
            let x = L::Wide::load(&self.0);
            let [sine, cosine] = sine_and_cosine(x);
            [sine.store(), cosine.store(), wrap(x).store()]
        }
    }

    fn check(x: [f32; ROLLOUTS]) {
        for path in SimdPath::all() {
            let results = path.run(Functions(x));
            for (lane, x) in x.into_iter().enumerate() {
                let (sine, cosine) = libm::sincosf(x);
                let [a, b, c] = results.map(|result| result[lane]);
                let expected = [sine, cosine, angle::wrap(x)];
                let same = |a: f32, b: f32| a.to_bits() == b.to_bits() || a.is_nan() && b.is_nan();
                assert!(same(a, sine) && same(b, cosine) && same(c, expected[2]), "{path}: {x:e}: {a} {b} {c}");
            }
        }
    }

    #[test]
    fn functions_have_the_bits_of_those_of_one_number() {
        // Every sign and exponent with some thousand mantissas, in rows of neighbours.
        for high in 0..=u32::from(u16::MAX) {
            check(std::array::from_fn(|lane| f32::from_bits(high << 16 | (lane as u32 * 4099 + high * 13) & 0xffff)));
        }
        // All neighbours of the borders.
        let borders = QUARTERS.into_iter().chain([2.0_f32.powi(-12), std::f32::consts::PI, 0.0]);
        for border in borders.flat_map(|border| [border, -border]) {
            for step in -64..64 {
                check(std::array::from_fn(|lane| {
                    f32::from_bits(border.to_bits().wrapping_add_signed(step * ROLLOUTS as i32 + lane as i32))
                }));
            }
        }
    }
}
