//! The kernel: features four at a time on glam's `Vec4`.
//!
//! Two passes. The first computes every *line* (24 blocks for the arm's 320 features) and its sum of squares; these give
//! the norm of all features before any of them exists. The second expands lines into features, with the scale already
//! folded in, so that memory is written once and never read again.

use std::array::from_fn;

use glam::Vec4;

use super::exponential::{MAGIC, MANTISSA_BITS, NORM_SCALE, POLYNOMIAL, SUM_SCALE};
use super::features::{Block, Features};
use super::plan::{GROUP, Line, Plan};

/// `2^-min(y, floor)` for `y >= 0`.
#[inline(always)]
fn exp2_negative(y: [Vec4; GROUP], floors: &[Block; GROUP]) -> [Vec4; GROUP] {
    let magic = Vec4::splat(MAGIC);
    let [c0, c1, c2, c3, c4, c5] = POLYNOMIAL.map(Vec4::splat);
    let y: [Vec4; GROUP] = from_fn(|i| y[i].min(Vec4::from_array(floors[i].0)));
    let n = y.map(|y| y + magic);
    let g: [Vec4; GROUP] = from_fn(|i| y[i] - (n[i] - magic));
    let g2 = g.map(|g| g * g);
    let p: [Vec4; GROUP] = from_fn(|i| (c5 * g[i] + c4) * g2[i] + (c3 * g[i] + c2));
    let p: [Vec4; GROUP] = from_fn(|i| p[i] * g2[i] + (c1 * g[i] + c0));
    from_fn(|i| subtract_exponent(p[i], n[i]))
}

#[inline(always)]
fn subtract_exponent(p: Vec4, n: Vec4) -> Vec4 {
    // An array, because glam has no integer lanes: the compiler turns it into one shift and one subtraction.
    let (p, n) = (p.to_array(), n.to_array());
    Vec4::from_array(from_fn(|i| f32::from_bits(p[i].to_bits().wrapping_sub(n[i].to_bits() << MANTISSA_BITS))))
}

#[inline(always)]
fn lane_sum(v: Vec4) -> f32 {
    let [a, b, c, d] = v.to_array();
    (a + c) + (b + d)
}

/// Encodes `inputs` into `out`, by way of `lines`.
pub(super) fn encode(plan: &Plan, inputs: &[f32], lines: &mut Features, squares: &mut Features, out: &mut Features) {
    let (lines, squares) = (lines.blocks_mut(), squares.blocks_mut());
    let centres = plan.centres.blocks().as_chunks::<GROUP>().0;
    let floors = plan.floors.blocks().as_chunks::<GROUP>().0;
    let groups = plan.groups.iter().zip(centres).zip(floors);
    for (((group, centres), floors), (line, squares)) in
        groups.zip(lines.as_chunks_mut::<GROUP>().0.iter_mut().zip(&mut *squares))
    {
        let x = Vec4::splat(inputs[group.input]);
        let sharpness = Vec4::splat(group.sharpness);
        let roots: [Vec4; GROUP] = from_fn(|i| (Vec4::from_array(centres[i].0) - x) * sharpness);
        let g = exp2_negative(roots.map(|r| r * r), floors);
        *line = g.map(|g| Block(g.to_array()));
        let [a, b, c, d] = g.map(|g| g * g);
        *squares = Block(((a + b) + (c + d)).to_array());
    }
    let sum = |line: &Line| {
        let squares = &squares[line.start..][..line.groups];
        lane_sum(squares.iter().map(|s| Vec4::from_array(s.0)).fold(Vec4::ZERO, |a, b| a + b))
    };
    let mut total = 0.0;
    for shape in &plan.shapes {
        let mut squares = sum(&shape.fast) * SUM_SCALE;
        if let Some(slow) = &shape.slow {
            squares *= sum(slow);
        }
        total += squares;
    }
    let scale = if plan.normalise { NORM_SCALE / total.sqrt() } else { 1.0 };

    let mut out = out.blocks_mut();
    for shape in &plan.shapes {
        let fast = &lines[shape.fast.start * GROUP..][..shape.fast.blocks()];
        let (here, rest) = out.split_at_mut(shape.rows() * fast.len());
        out = rest;
        let one = [1.0];
        let slow: &[f32] = match &shape.slow {
            None => &one,
            Some(slow) => &bytemuck::cast_slice(&lines[slow.start * GROUP..])[..slow.units],
        };
        if let Ok(fast) = <&[Block; 4]>::try_from(fast) {
            let fast = fast.map(|f| Vec4::from_array(f.0));
            for (&s, row) in slow.iter().zip(here.as_chunks_mut::<4>().0) {
                let s = Vec4::splat(s * scale);
                *row = fast.map(|f| Block((f * s).to_array()));
            }
        } else {
            for (&s, row) in slow.iter().zip(here.chunks_exact_mut(fast.len())) {
                let s = Vec4::splat(s * scale);
                for (out, f) in row.iter_mut().zip(fast) {
                    *out = Block((Vec4::from_array(f.0) * s).to_array());
                }
            }
        }
    }
}
