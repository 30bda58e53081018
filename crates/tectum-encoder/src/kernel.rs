//! The kernel: features eight at a time, on whatever [`F32x8`] the machine has.
//!
//! Exponentials are computed for *lines* only (96 units for the arm's 320 features). Their sums of squares give the
//! norm of all features before any of them exists, so the scale is folded into the lines, and the features are written
//! once and never read again.
//!
//! Lines are worked on in passes with short chains of operations, through scratch memory that stays in the
//! first-level cache, rather than in one pass with a long chain. The processor looks about a hundred waiting
//! operations ahead; with the whole chain in one loop that is not enough to find independent work, and the arm's
//! features took a quarter longer. For the same reason a pass takes units in groups of sixteen and advances them side
//! by side.
//!
//! There is no fused multiply-add: without the `fma` target feature `mul_add` is a library call per lane, and with it the
//! bits would depend on the machine. Whatever the width of the lanes, the order in which [`squares`] adds up is the same;
//! everything else is lane by lane.

use glam::Vec4;

use super::exponential::{MAGIC, MANTISSA_BITS, POLYNOMIAL, SUM_SCALE, inverse_norm, scaled};
use super::features::{BLOCK, CacheLine, Features, GROUP};
use super::tables::{EncoderTables, UnitGroup};
use crate::simd::{F32x8, Kernel, LANES};

/// Encodes `inputs` into `out`, by way of `lines`.
pub(super) struct Encode<'a> {
    pub plan: &'a EncoderTables,
    pub inputs: &'a [f32],
    pub lines: &'a mut Features,
    pub out: &'a mut Features,
}

impl Kernel for Encode<'_> {
    type Output = ();

    #[inline(always)]
    fn run<L: F32x8>(self) {
        let Self { plan, inputs, lines, out } = self;
        let groups = lines.cache_lines_mut();
        exponents::<L>(inputs, &plan.groups, plan.centres.cache_lines(), plan.floors.cache_lines(), groups);
        activations::<L>(groups);
        let scale = if plan.normalise { inverse_norm(sum_of_squares::<L>(plan, groups)) } else { 1.0 };
        expand::<L>(plan, lines.as_slice(), scale, out.as_mut_slice());
    }
}

/// First pass: the (negative) binary exponents of all lines' units.
#[inline(always)]
fn exponents<L: F32x8>(
    inputs: &[f32],
    groups: &[UnitGroup],
    centres: &[CacheLine],
    floors: &[CacheLine],
    lines: &mut [CacheLine],
) {
    for (((group, centres), floors), line) in groups.iter().zip(centres).zip(floors).zip(lines) {
        let x = L::splat(scaled(inputs[group.input], group.scale));
        for i in 0..2 {
            let distance = L::load(&centres.0[i]) - x;
            line.0[i] = (distance * distance).min(L::load(&floors.0[i])).store();
        }
    }
}

/// Second pass: exponents become activations, `2^-y` for `0 <= y <= 127`.
#[inline(always)]
fn activations<L: F32x8>(lines: &mut [CacheLine]) {
    let magic = L::splat(MAGIC);
    for line in lines {
        // Two chains of operations side by side, or with narrow registers four.
        let y = [L::load(&line.0[0]), L::load(&line.0[1])];
        let n = [y[0] + magic, y[1] + magic];
        let p = [power((n[0] - magic) - y[0]), power((n[1] - magic) - y[1])];
        // `p / 2^n`, where `n` stands in the lowest bits of the sum with `MAGIC`.
        line.0[0] = p[0].less_exponent::<MANTISSA_BITS>(n[0]).store();
        line.0[1] = p[1].less_exponent::<MANTISSA_BITS>(n[1]).store();
    }
}

/// `2^g`, by Estrin's scheme: one multiplication more than Horner's, and half its chain.
#[inline(always)]
fn power<L: F32x8>(g: L) -> L {
    let [c0, c1, c2, c3, c4, c5] = POLYNOMIAL;
    let g2 = g * g;
    let p = (L::splat(c5) * g + L::splat(c4)) * g2 + (L::splat(c3) * g + L::splat(c2));
    p * g2 + (L::splat(c1) * g + L::splat(c0))
}

/// Third pass: the sum of squares of all features, in units of [`SUM_SCALE`]. A plane's is the product of its lines'.
#[inline(always)]
fn sum_of_squares<L: F32x8>(plan: &EncoderTables, lines: &[CacheLine]) -> f32 {
    let mut total = 0.0;
    for plane in &plan.planes {
        let slow = squares::<L>(&lines[plane.slow..plane.fast]) * SUM_SCALE;
        total += slow * squares::<L>(&lines[plane.fast..plane.end]);
    }
    total + squares::<L>(&lines[plan.lines..]) * SUM_SCALE
}

/// The sum of squares of some groups: four neighbouring blocks of four, then groups, and the lanes last.
#[inline(always)]
fn squares<L: F32x8>(groups: &[CacheLine]) -> f32 {
    let mut sum = Vec4::ZERO;
    for group in groups {
        let (low, high) = (L::load(&group.0[0]), L::load(&group.0[1]));
        let ([a, b], [c, d]) = ((low * low).halves(), (high * high).halves());
        sum += (a + b) + (c + d);
    }
    let [a, b, c, d] = sum.to_array();
    (a + c) + (b + d)
}

/// Last pass: lines become features.
#[inline(always)]
fn expand<L: F32x8>(plan: &EncoderTables, lines: &[f32], scale: f32, out: &mut [f32]) {
    for plane in &plan.planes {
        let slow = &lines[plane.slow * GROUP..][..plane.rows];
        let fast = &lines[plane.fast * GROUP..][..plane.stride];
        let out = &mut out[plane.start..][..plane.rows * plane.stride];
        match <&[f32; GROUP]>::try_from(fast) {
            Ok(fast) => expand_rows::<L>(slow, fast, scale, out.as_chunks_mut().0),
            Err(_) => {
                for (slow, row) in slow.iter().zip(out.chunks_exact_mut(plane.stride)) {
                    multiply::<L>(fast, slow * scale, row);
                }
            }
        }
    }
    for run in &plan.runs {
        multiply::<L>(&lines[run.from..][..run.len], scale, &mut out[run.to..][..run.len]);
    }
}

/// `out = line * factor`, whole blocks.
#[inline(always)]
fn multiply<L: F32x8>(line: &[f32], factor: f32, out: &mut [f32]) {
    let ((line, line_rest), (out, out_rest)) = (line.as_chunks(), out.as_chunks_mut());
    for (out, line) in out.iter_mut().zip(line) {
        *out = (L::load(line) * L::splat(factor)).store();
    }
    let (line, out) = (line_rest.as_chunks::<BLOCK>().0, out_rest.as_chunks_mut::<BLOCK>().0);
    for (out, line) in out.iter_mut().zip(line) {
        *out = (Vec4::from_array(*line) * Vec4::splat(factor)).to_array();
    }
}

/// A plane whose rows are one group, as with the paper's 16 units: the fast line stays in registers.
#[inline(always)]
fn expand_rows<L: F32x8>(slow: &[f32], fast: &[f32; GROUP], scale: f32, out: &mut [[f32; GROUP]]) {
    let [a, b]: [[f32; LANES]; 2] = bytemuck::cast(*fast);
    let (a, b, scale) = (L::load(&a), L::load(&b), L::splat(scale));
    // Four rows at a time: the next ones need not wait for the loop.
    let (slow, out) = (slow.as_chunks::<4>(), out.as_chunks_mut::<4>());
    for (slow, out) in slow.0.iter().zip(out.0) {
        for i in 0..4 {
            let slow = L::splat(slow[i]) * scale;
            out[i] = bytemuck::cast([(a * slow).store(), (b * slow).store()]);
        }
    }
    for (slow, out) in slow.1.iter().zip(out.1) {
        let slow = L::splat(*slow) * scale;
        *out = bytemuck::cast([(a * slow).store(), (b * slow).store()]);
    }
}
