//! Vectors of eight `f32` for the inner loops of encoder, policy and learning rules, and the choice of
//! instruction set.
//!
//! A program built for plain x86-64 may use only SSE2, with four lanes, although nearly every machine has AVX2,
//! with eight, and many have AVX-512, with sixteen. A loop is therefore written once, as a [`Kernel`] over any
//! [`F32x8`], and compiled three times: with two of glam's `Vec4` for every machine (SSE2, NEON, scalar code), with
//! AVX2 registers, and for AVX-512. A loop that works on sixteen lanes at a time uses [`F32x8::Wide`], which is one
//! register of AVX-512 and a pair of vectors elsewhere. A [`SimdPath`] selects one of them when an encoder or a
//! policy is built.
//!
//! All paths give the same bits. Every operation is lane by lane and rounded on its own. None is fused: AVX2
//! does not imply FMA, and the compiler does not fuse what is written as two operations. Sums over features keep
//! eight partial sums, one per lane, for any register width, and are added in a fixed order at the end.
//!
//! Users need [`SimdPath`] alone. [`Kernel`], [`F32x8`], [`F32x16`] and [`filled`] are public because the policy and
//! the learning rules, in another crate, are written with them.

#[cfg(target_arch = "x86_64")]
mod avx2;
#[cfg(target_arch = "x86_64")]
mod avx512;
mod baseline;
mod wide;

use std::fmt;
use std::ops::{Add, Mul, Sub};

use baseline::GlamF32x8;
use glam::Vec4;

/// Number of lanes.
pub const LANES: usize = 8;

/// Number of lanes of a pair of vectors.
pub const WIDE_LANES: usize = 2 * LANES;

/// Eight `f32` lanes. Every operation is lane by lane.
pub trait F32x8: Copy + Add<Output = Self> + Sub<Output = Self> + Mul<Output = Self> {
    /// Two of them, in one register where there is one so wide.
    type Wide: F32x16<Half = Self>;

    /// The same number in all lanes.
    fn splat(x: f32) -> Self;
    /// Loads eight numbers.
    fn load(from: &[f32; LANES]) -> Self;
    /// Stores eight numbers.
    fn store(self) -> [f32; LANES];
    /// The smaller of each two lanes; if the left one is NaN, the right one.
    fn min(self, other: Self) -> Self;
    /// The greater of each two lanes; if the left one is NaN, the right one.
    fn max(self, other: Self) -> Self;
    /// Subtracts, as integers, the bits of `shifted` moved left by `BITS` from the bits of each lane: divides
    /// by a power of two whose exponent is in the lowest bits of `shifted`.
    fn less_exponent<const BITS: i32>(self, shifted: Self) -> Self;
    /// The lower and the upper four lanes.
    fn halves(self) -> [Vec4; 2];
    /// The sum over the lanes of each of four vectors, neighbours first: `((a + b) + (c + d)) + ((e + f) + (g +
    /// h))`.
    fn totals(of: [Self; 4]) -> [f32; 4];
    /// The transposed matrix: lane `j` of vector `i` becomes lane `i` of vector `j`.
    fn transposed(of: [Self; LANES]) -> [Self; LANES];
}

/// Sixteen `f32` lanes. Every operation is lane by lane, and gives the bits of [`F32x8`]'s.
pub trait F32x16: Copy + Add<Output = Self> + Sub<Output = Self> + Mul<Output = Self> {
    /// Eight lanes of the same instruction set.
    type Half: F32x8;

    /// The same number in all lanes.
    fn splat(x: f32) -> Self;
    /// Loads sixteen numbers.
    fn load(from: &[f32; WIDE_LANES]) -> Self;
    /// Stores sixteen numbers.
    fn store(self) -> [f32; WIDE_LANES];
    /// As [`F32x8::min`].
    fn min(self, other: Self) -> Self;
    /// As [`F32x8::max`].
    fn max(self, other: Self) -> Self;
    /// As [`F32x8::less_exponent`].
    fn less_exponent<const BITS: i32>(self, shifted: Self) -> Self;
    /// The lower and the upper eight lanes.
    fn halves(self) -> [Self::Half; 2];
    /// Sixteen lanes from two times eight, the lower ones first.
    fn joined(halves: [Self::Half; 2]) -> Self;
    /// The sum of the four quarters of four lanes: `(a + b) + (c + d)`.
    fn quarters_total(self) -> Vec4;
}

/// A loop over lanes, together with its arguments; [`SimdPath::run`] runs it.
///
/// `run` and every function that it calls must be `#[inline(always)]`, and must not pass lanes to closures
/// (`map`, `from_fn`). Code that is not inlined into the function with the `target_feature` attribute is
/// compiled without these instructions and calls a function for every operation, which takes ten times longer.
/// It is still correct; the test `tests/instructions.rs` detects it.
pub trait Kernel {
    /// The result.
    type Output;
    /// Whether the loop gains from AVX-512: it works on [`F32x8::Wide`]. Others run with AVX2 there, and need not be
    /// compiled a third time.
    const IS_WIDE: bool = false;
    /// Runs the loop with vectors of type `L`.
    fn run<L: F32x8>(self) -> Self::Output;
}

/// An instruction set for [`Kernel`]s. A value exists only on machines that have these instructions.
#[derive(Clone, Copy, PartialEq, Eq, Hash)]
pub struct SimdPath(Kind);

#[derive(Clone, Copy, PartialEq, Eq, Hash)]
enum Kind {
    Baseline,
    #[cfg(target_arch = "x86_64")]
    Avx2,
    #[cfg(target_arch = "x86_64")]
    Avx512,
}

impl SimdPath {
    /// The path of every machine: the instruction set of the build, with four lanes at a time.
    pub const BASELINE: Self = Self(Kind::Baseline);

    /// The AVX2 path, if this machine has AVX2.
    #[inline]
    pub fn avx2() -> Option<Self> {
        #[cfg(target_arch = "x86_64")]
        if std::arch::is_x86_feature_detected!("avx2") {
            return Some(Self(Kind::Avx2));
        }
        None
    }

    /// The AVX-512 path, if this machine has AVX-512 with its F, DQ and VL parts.
    pub fn avx512() -> Option<Self> {
        #[cfg(target_arch = "x86_64")]
        if avx512::detected() {
            return Some(Self(Kind::Avx512));
        }
        None
    }

    /// The fastest path of this machine.
    pub fn best() -> Self {
        Self::avx512().or_else(Self::avx2).unwrap_or(Self::BASELINE)
    }

    /// The fastest path for kernels that are not wide, found out with one look instead of several.
    #[inline]
    pub fn best_narrow() -> Self {
        Self::avx2().unwrap_or(Self::BASELINE)
    }

    /// All paths of this machine, the slowest first.
    pub fn all() -> impl Iterator<Item = Self> {
        std::iter::once(Self::BASELINE).chain(Self::avx2()).chain(Self::avx512())
    }

    /// Runs a kernel with these instructions.
    #[inline]
    pub fn run<K: Kernel>(self, kernel: K) -> K::Output {
        match self.0 {
            Kind::Baseline => kernel.run::<GlamF32x8>(),
            // SAFETY: only `SimdPath::avx2` makes this kind, after it has detected AVX2.
            #[cfg(target_arch = "x86_64")]
            Kind::Avx2 => unsafe { avx2::run(kernel) },
            // SAFETY: only `SimdPath::avx512` makes this kind, after it has detected AVX-512 and AVX2.
            #[cfg(target_arch = "x86_64")]
            Kind::Avx512 => unsafe { if K::IS_WIDE { avx512::run(kernel) } else { avx2::run(kernel) } },
        }
    }
}

impl fmt::Display for SimdPath {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str(match self.0 {
            Kind::Baseline if cfg!(target_arch = "x86_64") => "sse2",
            Kind::Baseline => "baseline",
            #[cfg(target_arch = "x86_64")]
            Kind::Avx2 => "avx2",
            #[cfg(target_arch = "x86_64")]
            Kind::Avx512 => "avx512",
        })
    }
}

impl fmt::Debug for SimdPath {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        fmt::Display::fmt(self, f)
    }
}

/// Fewer than eight remaining numbers, followed by zeros.
#[inline(always)]
pub fn filled(rest: &[f32]) -> [f32; LANES] {
    let mut lanes = [0.0; LANES];
    lanes[..rest.len()].copy_from_slice(rest);
    lanes
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Every operation that no encoder uses, on numbers among which are NaN and both zeros.
    struct Operations([[f32; LANES]; LANES]);

    impl Kernel for Operations {
        type Output = [Vec<f32>; 4];
        const IS_WIDE: bool = true;

        fn run<L: F32x8>(self) -> [Vec<f32>; 4] {
            let rows = self.0.each_ref().map(L::load);
            let transposed = L::transposed(rows).map(L::store).concat();
            let [wide, other] = [[rows[0], rows[1]], [rows[2], rows[3]]].map(L::Wide::joined);
            let halves = (wide - other).halves().map(L::store).concat();
            let limited = [wide.min(other).store(), wide.max(other).store()].concat();
            let limited_halves = [rows[0].min(rows[2]).store(), rows[0].max(rows[2]).store()].concat();
            [transposed, halves, limited, limited_halves]
        }
    }

    #[test]
    fn operations_agree_bit_for_bit() {
        let mut rows: [[f32; LANES]; LANES] =
            std::array::from_fn(|i| std::array::from_fn(|j| ((i * 29 + j * 13) % 31) as f32 - 15.0));
        (rows[0][1], rows[2][3], rows[0][4], rows[2][4]) = (f32::NAN, f32::NAN, 0.0, -0.0);
        let bits =
            |results: [Vec<f32>; 4]| results.map(|result| result.iter().map(|x| x.to_bits()).collect::<Vec<_>>());
        let expected = bits(SimdPath::BASELINE.run(Operations(rows)));
        for (at, x) in expected[0].iter().enumerate() {
            assert_eq!(*x, rows[at % LANES][at / LANES].to_bits());
        }
        for path in SimdPath::all() {
            assert_eq!(bits(path.run(Operations(rows))), expected, "{path}");
        }
    }
}
