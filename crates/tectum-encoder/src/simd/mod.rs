//! Eight lanes of `f32`, and the instructions that work on them: what the inner loops of encoder, policy and learning
//! rules are written in.
//!
//! A program built for plain x86-64 may use SSE2 only, four lanes at a time, although nearly every machine has AVX2 and
//! eight. So a loop is written once, as a `Kernel` over any `F32x8`, and compiled twice: with two of glam's `Vec4` for
//! every machine (SSE2, NEON, plain code), and with AVX2's registers. Which one runs is a [`SimdPath`], chosen when an encoder
//! or a policy is built.
//!
//! All paths give the same bits. Every operation is done lane by lane and rounded on its own, none is fused (AVX2 does not
//! entail FMA, and it is not enabled), and sums over features keep eight partial sums, one a lane, whatever the registers'
//! width; how these are added up at the end is written out.

#[cfg(target_arch = "x86_64")]
mod avx2;

use std::array::from_fn;
use std::fmt;
use std::ops::{Add, Mul, Sub};

use glam::Vec4;

/// Number of lanes.
pub const LANES: usize = 8;

/// Eight numbers that are worked on side by side.
pub trait F32x8: Copy + Add<Output = Self> + Sub<Output = Self> + Mul<Output = Self> {
    /// The same number in all lanes.
    fn splat(x: f32) -> Self;
    /// The numbers of an array.
    fn load(from: &[f32; LANES]) -> Self;
    /// The other way round.
    fn store(self) -> [f32; LANES];
    /// The smaller one of each two; of a NaN on the left side, the right one.
    fn min(self, other: Self) -> Self;
    /// The bits of each lane, less the lowest bits of `shifted`'s, which are moved up by `BITS` first.
    fn less_exponent<const BITS: i32>(self, shifted: Self) -> Self;
    /// The lower and the upper four.
    fn halves(self) -> [Vec4; 2];
    /// The sums of the lanes of four, neighbours first: `((a + b) + (c + d)) + ((e + f) + (g + h))`.
    fn totals(of: [Self; 4]) -> [f32; 4];
}

/// For every machine: glam's four lanes, twice.
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
        // On arrays, because glam has no integer lanes: the compiler makes a shift and a subtraction of four lanes of it.
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

/// A loop over lanes, with all that it works on. `run` and what it calls must be `#[inline(always)]`, and must not hand lanes
/// to closures (`map`, `from_fn`): what is not inlined into the function that names the instructions is compiled without
/// them, and calls one function for every operation, which takes ten times longer. `tests/instructions.rs` would show it.
pub trait Kernel {
    /// What comes of it.
    type Output;
    /// Runs it.
    fn run<L: F32x8>(self) -> Self::Output;
}

/// The instructions that a loop is run with. A path exists only on machines that have its instructions.
#[derive(Clone, Copy, PartialEq, Eq, Hash)]
pub struct SimdPath(Kind);

#[derive(Clone, Copy, PartialEq, Eq, Hash)]
enum Kind {
    Baseline,
    #[cfg(target_arch = "x86_64")]
    Avx2,
}

impl SimdPath {
    /// The path of every machine: what the program was compiled for, four lanes at a time.
    pub const BASELINE: Self = Self(Kind::Baseline);

    /// AVX2, if this machine has it.
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

    /// Runs a pass with these instructions.
    #[inline]
    pub fn run<P: Kernel>(self, pass: P) -> P::Output {
        match self.0 {
            Kind::Baseline => pass.run::<GlamF32x8>(),
            // SAFETY: this kind is made in `avx2` alone, after the processor was found to have AVX2.
            #[cfg(target_arch = "x86_64")]
            Kind::Avx2 => unsafe { avx2::run(pass) },
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

/// What does not fill the lanes any more, with zeros behind it.
#[inline(always)]
pub fn filled(rest: &[f32]) -> [f32; LANES] {
    let mut lanes = [0.0; LANES];
    lanes[..rest.len()].copy_from_slice(rest);
    lanes
}
