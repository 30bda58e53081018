//! The scalar twin: what the kernel does, one lane at a time in plain `f32`.
//!
//! It exists to be compared with. Every operation of the kernel stands here in the same order with the same roundings,
//! so the two must agree bit for bit; the property test below holds them to it, for any maps and any inputs. Where they
//! part, the vector code is wrong, or the compiler broke the promise that it never fuses or reorders `f32` arithmetic.

use super::exponential::{MAGIC, MANTISSA_BITS, NORM_SCALE, POLYNOMIAL, SUM_SCALE};
use super::features::{Features, LANES};
use super::plan::{GROUP, GROUP_UNITS, Line, Plan};

/// `2^-min(y, floor)` for `y >= 0`; NaN gives the floor.
fn exp2_negative(y: f32, floor: f32) -> f32 {
    let y = if y < floor { y } else { floor };
    let n = y + MAGIC;
    let g = y - (n - MAGIC);
    let [c0, c1, c2, c3, c4, c5] = POLYNOMIAL;
    let g2 = g * g;
    let p = ((c5 * g + c4) * g2 + (c3 * g + c2)) * g2 + (c1 * g + c0);
    f32::from_bits(p.to_bits().wrapping_sub(n.to_bits() << MANTISSA_BITS))
}

/// The line's sum of squares, in the kernel's order: four neighbouring blocks, then groups, and the lanes last.
fn sum_of_squares(line: &Line, lines: &[f32]) -> f32 {
    let mut sums = [0.0f32; LANES];
    for group in lines[line.start * GROUP_UNITS..][..line.groups * GROUP_UNITS].chunks_exact(GROUP_UNITS) {
        for (lane, sum) in sums.iter_mut().enumerate() {
            let [a, b, c, d]: [f32; GROUP] = std::array::from_fn(|block| group[block * LANES + lane].powi(2));
            *sum += (a + b) + (c + d);
        }
    }
    let [a, b, c, d] = sums;
    (a + c) + (b + d)
}

/// Encodes `inputs` into `out`, by way of `lines`.
pub(super) fn encode(plan: &Plan, inputs: &[f32], lines: &mut Features, out: &mut Features) {
    let (lines, out) = (lines.as_mut_slice(), out.as_mut_slice());
    let (centres, floors) = (plan.centres.as_slice(), plan.floors.as_slice());
    for (at, line) in lines.iter_mut().enumerate() {
        let group = &plan.groups[at / GROUP_UNITS];
        let root = (centres[at] - inputs[group.input]) * group.sharpness;
        *line = exp2_negative(root * root, floors[at]);
    }

    let mut total = 0.0;
    for shape in &plan.shapes {
        let mut squares = sum_of_squares(&shape.fast, lines) * SUM_SCALE;
        if let Some(slow) = &shape.slow {
            squares *= sum_of_squares(slow, lines);
        }
        total += squares;
    }
    let scale = if plan.normalise { NORM_SCALE / total.sqrt() } else { 1.0 };

    for shape in &plan.shapes {
        for i in 0..shape.rows() {
            let scale = shape.slow.as_ref().map_or(scale, |slow| lines[slow.start * GROUP_UNITS + i] * scale);
            for j in 0..shape.stride() {
                out[shape.start + i * shape.stride() + j] = lines[shape.fast.start * GROUP_UNITS + j] * scale;
            }
        }
    }
}
