//! Vectors of eight `f32` for the inner loops of encoder, policy and learning rules, and the choice of
//! instruction set.
//!
//! A program built for plain x86-64 may use only SSE2, with four lanes, although nearly every machine has AVX2,
//! with eight. A loop is therefore written once, as a [`Kernel`] over any [`F32x8`], and compiled twice: with
//! two of glam's `Vec4` for every machine (SSE2, NEON, scalar code), and with AVX2 registers. A [`SimdPath`]
//! selects one of them when an encoder or a policy is built.
//!
//! All paths give the same bits. Every operation is lane by lane and rounded on its own. None is fused: AVX2
//! does not imply FMA, and FMA is not enabled. Sums over features keep eight partial sums, one per lane, for
//! any register width, and are added in a fixed order at the end.
//!
//! Users need [`SimdPath`] alone. [`Kernel`], [`F32x8`] and [`filled`] are public because the policy and the
//! learning rules, in another crate, are written with them.

#[cfg(target_arch = "x86_64")]
mod avx2;

use std::array::from_fn;
use std::fmt;
use std::ops::{Add, Mul, Sub};

use glam::Vec4;

/// Number of lanes.
pub const LANES: usize = 8;

/// Eight `f32` lanes. Every operation is lane by lane.
pub trait F32x8: Copy + Add<Output = Self> + Sub<Output = Self> + Mul<Output = Self> {
    /// The same number in all lanes.
    fn splat(x: f32) -> Self;
    /// Loads eight numbers.
    fn load(from: &[f32; LANES]) -> Self;
    /// Stores eight numbers.
    fn store(self) -> [f32; LANES];
    /// The smaller of each two lanes; if the left one is NaN, the right one.
    fn min(self, other: Self) -> Self;
    /// Subtracts, as integers, the bits of `shifted` moved left by `BITS` from the bits of each lane: divides
    /// by a power of two whose exponent is in the lowest bits of `shifted`.
    fn less_exponent<const BITS: i32>(self, shifted: Self) -> Self;
    /// The lower and the upper four lanes.
    fn halves(self) -> [Vec4; 2];
    /// The sum over the lanes of each of four vectors, neighbours first: `((a + b) + (c + d)) + ((e + f) + (g +
    /// h))`.
    fn totals(of: [Self; 4]) -> [f32; 4];
}

/// The implementation for every machine: two of glam's vectors of four lanes.
#[derive(Clone, Copy)]
struct GlamF32x8(Vec4, Vec4);

impl Add for GlamF32x8 {
    type Output = Self;
    #[inline(always)]
    fn add(self, other: Self) -> Self {
        Self(self.0 + other.0, self.1 + other.1)
    }
}

impl Sub for GlamF32x8 {
    type Output = Self;
    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        Self(self.0 - other.0, self.1 - other.1)
    }
}

impl Mul for GlamF32x8 {
    type Output = Self;
    #[inline(always)]
    fn mul(self, other: Self) -> Self {
        Self(self.0 * other.0, self.1 * other.1)
    }
}

impl F32x8 for GlamF32x8 {
    #[inline(always)]
    fn splat(x: f32) -> Self {
        Self(Vec4::splat(x), Vec4::splat(x))
    }

    #[inline(always)]
    fn load(from: &[f32; LANES]) -> Self {
        let [a, b, c, d, e, f, g, h] = *from;
        Self(Vec4::from_array([a, b, c, d]), Vec4::from_array([e, f, g, h]))
    }

    #[inline(always)]
    fn store(self) -> [f32; LANES] {
        let ([a, b, c, d], [e, f, g, h]) = (self.0.to_array(), self.1.to_array());
        [a, b, c, d, e, f, g, h]
    }

    #[inline(always)]
    fn min(self, other: Self) -> Self {
        Self(self.0.min(other.0), self.1.min(other.1))
    }

    #[inline(always)]
    fn less_exponent<const BITS: i32>(self, shifted: Self) -> Self {
        // On arrays, because glam has no integer lanes; the compiler turns it into one shift and one subtraction.
        let less = |p: Vec4, n: Vec4| {
            let (p, n) = (p.to_array(), n.to_array());
            Vec4::from_array(from_fn(|i| f32::from_bits(p[i].to_bits().wrapping_sub(n[i].to_bits() << BITS))))
        };
        Self(less(self.0, shifted.0), less(self.1, shifted.1))
    }

    #[inline(always)]
    fn halves(self) -> [Vec4; 2] {
        [self.0, self.1]
    }

    #[inline(always)]
    fn totals(of: [Self; 4]) -> [f32; 4] {
        let mut totals = [0.0; 4];
        for (total, lanes) in totals.iter_mut().zip(of) {
            let [a, b, c, d, e, f, g, h] = lanes.store();
            *total = ((a + b) + (c + d)) + ((e + f) + (g + h));
        }
        totals
    }
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
}

impl SimdPath {
    /// The path of every machine: the instruction set of the build, with four lanes at a time.
    pub const BASELINE: Self = Self(Kind::Baseline);

    /// The AVX2 path, if this machine has AVX2.
    pub fn avx2() -> Option<Self> {
        #[cfg(target_arch = "x86_64")]
        if std::arch::is_x86_feature_detected!("avx2") {
            return Some(Self(Kind::Avx2));
        }
        None
    }

    /// The fastest path of this machine.
    pub fn best() -> Self {
        Self::avx2().unwrap_or(Self::BASELINE)
    }

    /// All paths of this machine, the slowest first.
    pub fn all() -> impl Iterator<Item = Self> {
        std::iter::once(Self::BASELINE).chain(Self::avx2())
    }

    /// Runs a kernel with these instructions.
    #[inline]
    pub fn run<K: Kernel>(self, kernel: K) -> K::Output {
        match self.0 {
            Kind::Baseline => kernel.run::<GlamF32x8>(),
            // SAFETY: only `SimdPath::avx2` makes this kind, after it has detected AVX2.
            #[cfg(target_arch = "x86_64")]
            Kind::Avx2 => unsafe { avx2::run(kernel) },
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
