//! The SIMD kernel: encodes sixteen features at a time, with any implementation of [`F32x8`] and its pairs.
//!
//! Exponentials are computed for *lines* only (96 units for the arm's 320 features). Their sums of squares give
//! the norm of all features before the features are computed. The scale is therefore folded into the lines, and
//! each feature is written once and never read again.
//!
//! The lines are processed in several passes with short chains of dependent operations, through scratch memory
//! that stays in the first-level cache. A single pass has one long chain. The processor looks about a hundred
//! operations ahead, which is too few to find independent work in a long chain: a single pass took a quarter
//! longer for the arm's features. For the same reason a pass works on groups of sixteen units at once,
//! even where a register has four.
//!
//! Fused multiply-add is not used: without the `fma` target feature `mul_add` is a library call per lane, and
//! with it the bits would depend on the machine. [`squares`] adds in the same order for every register width;
//! all other operations are lane by lane.

use glam::Vec4;

use super::exponential::{SUM_SCALE, exp2_negative_lanes, inverse_norm, scaled};
use super::features::{BLOCK, CacheLine, Features, GROUP};
use super::held::HeldPlanes;
use super::tables::{EncoderTables, UnitGroup};
use crate::simd::{F32x8, F32x16, Kernel};

/// Encodes `inputs` into `out`; `lines` has the activations of the lines, those of `held` from the call before.
pub(super) struct Encode<'a> {
    pub tables: &'a EncoderTables,
    pub inputs: &'a [f32],
    pub lines: &'a mut Features,
    pub held: &'a mut HeldPlanes,
    pub out: &'a mut Features,
}

impl Kernel for Encode<'_> {
    type Output = ();
    const IS_WIDE: bool = true;

    #[inline(always)]
    fn run<L: F32x8>(self) {
        let Self { tables, inputs, lines, held, out } = self;
        let groups = lines.cache_lines_mut();
        let from = if held.take(tables, inputs) { tables.lines } else { 0 };
        let (centres, floors) = (&tables.centres.cache_lines()[from..], &tables.floors.cache_lines()[from..]);
        exponents::<L>(inputs, &tables.groups[from..], centres, floors, &mut groups[from..]);
        activations::<L>(&mut groups[from..]);
        if from == 0 {
            held.keep(sum_of_squares::<L>(tables, groups));
        }
        let scale = if tables.normalise {
            inverse_norm(held.squares + squares::<L>(&groups[tables.lines..]) * SUM_SCALE)
        } else {
            1.0
        };
        expand::<L>(tables, lines.as_slice(), scale, out.as_mut_slice());
    }
}

/// First pass: the negated binary exponents of the units of all lines.
#[inline(always)]
fn exponents<L: F32x8>(
    inputs: &[f32],
    groups: &[UnitGroup],
    centres: &[CacheLine],
    floors: &[CacheLine],
    lines: &mut [CacheLine],
) {
    for (((group, centres), floors), line) in groups.iter().zip(centres).zip(floors).zip(lines) {
        let x = L::Wide::splat(scaled(inputs[group.input], group.scale));
        let distance = L::Wide::load(&centres.0) - x;
        line.0 = (distance * distance).min(L::Wide::load(&floors.0)).store();
    }
}

/// Second pass: exponents become activations, `2^-y` for `0 <= y <= 127`.
#[inline(always)]
fn activations<L: F32x8>(lines: &mut [CacheLine]) {
    // One chain of operations in a whole register; two independent ones with pairs, four with narrow registers.
    for line in lines {
        line.0 = exp2_negative_lanes(L::Wide::load(&line.0)).store();
    }
}

/// Third pass: the sum of squares of the features of all planes, times [`SUM_SCALE`]. For a plane it is the product of
/// the sums of its two lines.
#[inline(always)]
fn sum_of_squares<L: F32x8>(tables: &EncoderTables, lines: &[CacheLine]) -> f32 {
    let mut total = 0.0;
    for plane in &tables.planes {
        let slow = squares::<L>(&lines[plane.slow..plane.fast]) * SUM_SCALE;
        total += slow * squares::<L>(&lines[plane.fast..plane.end]);
    }
    total
}

/// The sum of squares of some groups. The order is fixed: the four blocks of a group, then the groups, then the
/// lanes.
#[inline(always)]
fn squares<L: F32x8>(groups: &[CacheLine]) -> f32 {
    let mut sum = Vec4::ZERO;
    for group in groups {
        let activations = L::Wide::load(&group.0);
        sum += (activations * activations).quarters_total();
    }
    let [a, b, c, d] = sum.to_array();
    (a + c) + (b + d)
}

/// Last pass: multiplies the lines out to features.
#[inline(always)]
fn expand<L: F32x8>(tables: &EncoderTables, lines: &[f32], scale: f32, out: &mut [f32]) {
    for plane in &tables.planes {
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
    for range in &tables.line_ranges {
        multiply::<L>(&lines[range.from..][..range.len], scale, &mut out[range.to..][..range.len]);
    }
}

/// `out = line * factor`, in whole blocks.
#[inline(always)]
fn multiply<L: F32x8>(line: &[f32], factor: f32, out: &mut [f32]) {
    let ((line, line_rest), (out, out_rest)) = (line.as_chunks(), out.as_chunks_mut());
    for (out, line) in out.iter_mut().zip(line) {
        *out = (L::Wide::load(line) * L::Wide::splat(factor)).store();
    }
    let ((line, line_rest), (out, out_rest)) = (line_rest.as_chunks(), out_rest.as_chunks_mut());
    for (out, line) in out.iter_mut().zip(line) {
        *out = (L::load(line) * L::splat(factor)).store();
    }
    let (line, out) = (line_rest.as_chunks::<BLOCK>().0, out_rest.as_chunks_mut::<BLOCK>().0);
    for (out, line) in out.iter_mut().zip(line) {
        *out = (Vec4::from_array(*line) * Vec4::splat(factor)).to_array();
    }
}

/// A plane whose rows are one group each, as with the paper's 16 units: the fast line stays in registers.
#[inline(always)]
fn expand_rows<L: F32x8>(slow: &[f32], fast: &[f32; GROUP], scale: f32, out: &mut [[f32; GROUP]]) {
    let (fast, scale) = (L::Wide::load(fast), L::Wide::splat(scale));
    // Four rows per iteration, so that the loop's own instructions cost less. The factors are not computed sixteen at a
    // time: all rows would wait for them to be stored and loaded again, a fifth of the whole time with AVX2.
    let (slow, out) = (slow.as_chunks::<4>(), out.as_chunks_mut::<4>());
    for (slow, out) in slow.0.iter().zip(out.0) {
        for i in 0..4 {
            out[i] = (fast * (L::Wide::splat(slow[i]) * scale)).store();
        }
    }
    for (slow, out) in slow.1.iter().zip(out.1) {
        *out = (fast * (L::Wide::splat(*slow) * scale)).store();
    }
}
