//! The kernel: features four at a time on glam's `Vec4`.
//!
//! Exponentials are computed for *lines* only (24 blocks for the arm's 320 features). Their sums of squares give the
//! norm of all features before any of them exists, so the scale is folded into the lines, and the features are written
//! once and never read again.
//!
//! Lines are worked on in passes with short chains of operations, through scratch memory that stays in the
//! first-level cache, rather than in one pass with a long chain. The processor looks about a hundred waiting
//! operations ahead; with the whole chain in one loop that is not enough to find independent work, and the arm's
//! features took a quarter longer. For the same reason a pass takes blocks in groups of four and advances them side
//! by side.
//!
//! There is no `unsafe` here, and no fused multiply-add: without the `fma` target feature `mul_add` is a library call
//! per lane, and with it the bits would depend on the machine. A kernel with wider lanes has to keep to the order in
//! which [`squares`] adds up; everything else is lane by lane.

use std::array::from_fn;

use glam::Vec4;

use super::exponential::{MAGIC, MANTISSA_BITS, POLYNOMIAL, SUM_SCALE, inverse_norm, scaled};
use super::features::{Block, Features};
use super::plan::{GROUP, Group, Plan};

/// The blocks of a group.
type Blocks = [Block; GROUP];

#[inline(always)]
fn load(block: &Block) -> Vec4 {
    Vec4::from_array(block.0)
}

#[inline(always)]
fn store(v: Vec4) -> Block {
    Block(v.to_array())
}

/// Encodes `inputs` into `out`, by way of `lines`.
pub(super) fn encode(plan: &Plan, inputs: &[f32], lines: &mut Features, out: &mut Features) {
    let scale = {
        let lines = lines.blocks_mut().as_chunks_mut::<GROUP>().0;
        let centres = plan.centres.blocks().as_chunks::<GROUP>().0;
        let floors = plan.floors.blocks().as_chunks::<GROUP>().0;
        exponents(inputs, &plan.groups, centres, floors, lines);
        activations(lines);
        if plan.normalise { inverse_norm(sum_of_squares(plan, lines)) } else { 1.0 }
    };
    expand(plan, lines.blocks(), scale, out.blocks_mut());
}

/// First pass: the (negative) binary exponents of all lines' units.
#[inline(always)]
fn exponents(inputs: &[f32], groups: &[Group], centres: &[Blocks], floors: &[Blocks], lines: &mut [Blocks]) {
    for (((group, centres), floors), line) in groups.iter().zip(centres).zip(floors).zip(lines) {
        let x = Vec4::splat(scaled(inputs[group.input], group.scale));
        *line = from_fn(|i| {
            let distance = load(&centres[i]) - x;
            store((distance * distance).min(load(&floors[i])))
        });
    }
}

/// Second pass: exponents become activations, `2^-y` for `0 <= y <= 127`.
#[inline(always)]
fn activations(lines: &mut [Blocks]) {
    let magic = Vec4::splat(MAGIC);
    let [c0, c1, c2, c3, c4, c5] = POLYNOMIAL.map(Vec4::splat);
    for line in lines {
        let y = line.each_ref().map(load);
        let n = y.map(|y| y + magic);
        let g: [Vec4; GROUP] = from_fn(|i| (n[i] - magic) - y[i]);
        // Estrin's scheme: one multiplication more than Horner's, and half its chain.
        let g2 = g.map(|g| g * g);
        let p: [Vec4; GROUP] = from_fn(|i| (c5 * g[i] + c4) * g2[i] + (c3 * g[i] + c2));
        let p: [Vec4; GROUP] = from_fn(|i| p[i] * g2[i] + (c1 * g[i] + c0));
        *line = from_fn(|i| divide_by_power(p[i], n[i]));
    }
}

/// `p / 2^n`, where `n` stands in the lowest bits of `shifted`.
///
/// On arrays, because glam has no integer lanes: the compiler makes one shift and one subtraction of four lanes of it.
#[inline(always)]
fn divide_by_power(p: Vec4, shifted: Vec4) -> Block {
    let (p, n) = (p.to_array(), shifted.to_array());
    Block(from_fn(|i| f32::from_bits(p[i].to_bits().wrapping_sub(n[i].to_bits() << MANTISSA_BITS))))
}

/// Third pass: the sum of squares of all features, in units of [`SUM_SCALE`]. A plane's is the product of its lines'.
#[inline(always)]
fn sum_of_squares(plan: &Plan, lines: &[Blocks]) -> f32 {
    let mut total = 0.0;
    for plane in &plan.planes {
        let slow = squares(&lines[plane.slow..plane.fast]) * SUM_SCALE;
        total += slow * squares(&lines[plane.fast..plane.end]);
    }
    total + squares(&lines[plan.lines..]) * SUM_SCALE
}

/// The sum of squares of some groups: four neighbouring blocks, then groups, and the lanes last.
#[inline(always)]
fn squares(groups: &[Blocks]) -> f32 {
    let mut sum = Vec4::ZERO;
    for group in groups {
        let [a, b, c, d] = group.each_ref().map(load).map(|g| g * g);
        sum += (a + b) + (c + d);
    }
    let [a, b, c, d] = sum.to_array();
    (a + c) + (b + d)
}

/// Last pass: lines become features.
#[inline(always)]
fn expand(plan: &Plan, lines: &[Block], scale: f32, out: &mut [Block]) {
    let scale = Vec4::splat(scale);
    for run in &plan.runs {
        multiply(&lines[run.from..][..run.blocks], scale, &mut out[run.to..][..run.blocks]);
    }
    for plane in &plan.planes {
        let slow = &lines[plane.slow * GROUP..plane.fast * GROUP];
        let fast = &lines[plane.fast * GROUP..][..plane.stride];
        let out = &mut out[plane.start..][..plane.rows * plane.stride];
        match <&Blocks>::try_from(fast) {
            Ok(fast) => expand_rows(slow, fast, scale, out.as_chunks_mut().0),
            Err(_) => {
                let slow = slow.iter().flat_map(|slow| (load(slow) * scale).to_array());
                for (slow, row) in slow.zip(out.chunks_exact_mut(plane.stride)) {
                    multiply(fast, Vec4::splat(slow), row);
                }
            }
        }
    }
}

/// `out = line * factor`.
#[inline(always)]
fn multiply(line: &[Block], factor: Vec4, out: &mut [Block]) {
    for (out, g) in out.iter_mut().zip(line) {
        *out = store(load(g) * factor);
    }
}

/// A plane whose rows are one group, as with the paper's 16 units: the fast line stays in registers, and the slow one
/// comes in four rows at a time.
#[inline(always)]
fn expand_rows(slow: &[Block], fast: &Blocks, scale: Vec4, out: &mut [Blocks]) {
    let fast = fast.each_ref().map(load);
    let row = |slow: f32| fast.map(|fast| store(fast * Vec4::splat(slow)));
    let (quads, rest) = out.as_chunks_mut::<4>();
    let mut slow = slow.iter().map(|slow| (load(slow) * scale).to_array());
    for (quad, slow) in quads.iter_mut().zip(&mut slow) {
        *quad = slow.map(row);
    }
    for (out, slow) in rest.iter_mut().zip(slow.next().unwrap_or_default()) {
        *out = row(slow);
    }
}
