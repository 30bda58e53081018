//! The scalar twin: what the kernel does, one lane at a time in plain `f32`.
//!
//! It exists to be compared with. Every operation of the kernel stands here in the same order with the same
//! roundings, so the two must agree bit for bit; the property test of this room holds them to it, for any maps and
//! any inputs. Where they part, the vector code is wrong, or the compiler broke the promise that it never fuses or
//! reorders `f32` arithmetic.

use super::exponential::{MAGIC, MANTISSA_BITS, POLYNOMIAL, SUM_SCALE, inverse_norm, scaled};
use super::features::{BLOCK, Features, GROUP};
use super::tables::EncoderTables;

/// `2^-min(y, floor)` for `y >= 0`; NaN gives the floor.
fn exp2_negative(y: f32, floor: f32) -> f32 {
    let y = if y < floor { y } else { floor };
    let n = y + MAGIC;
    let g = (n - MAGIC) - y;
    let [c0, c1, c2, c3, c4, c5] = POLYNOMIAL;
    let g2 = g * g;
    let p = ((c5 * g + c4) * g2 + (c3 * g + c2)) * g2 + (c1 * g + c0);
    f32::from_bits(p.to_bits().wrapping_sub(n.to_bits() << MANTISSA_BITS))
}

/// The sum of squares of some groups, in the kernel's order: four neighbouring blocks, then groups, and the lanes
/// last.
fn sum_of_squares(lines: &[f32]) -> f32 {
    let mut sums = [0.0f32; BLOCK];
    for group in lines.chunks_exact(GROUP) {
        for (lane, sum) in sums.iter_mut().enumerate() {
            let [a, b, c, d]: [f32; GROUP / BLOCK] = std::array::from_fn(|block| {
                let g = group[block * BLOCK + lane];
                g * g
            });
            *sum += (a + b) + (c + d);
        }
    }
    let [a, b, c, d] = sums;
    (a + c) + (b + d)
}

/// Encodes `inputs` into `out`, by way of `lines`.
pub(super) fn encode(plan: &EncoderTables, inputs: &[f32], lines: &mut Features, out: &mut Features) {
    let (lines, out) = (lines.as_mut_slice(), out.as_mut_slice());
    let (centres, floors) = (plan.centres.as_slice(), plan.floors.as_slice());
    for (at, line) in lines.iter_mut().enumerate() {
        let group = &plan.groups[at / GROUP];
        let distance = centres[at] - scaled(inputs[group.input], group.scale);
        *line = exp2_negative(distance * distance, floors[at]);
    }

    let mut total = 0.0;
    for plane in &plan.planes {
        let slow = sum_of_squares(&lines[plane.slow * GROUP..plane.fast * GROUP]) * SUM_SCALE;
        total += slow * sum_of_squares(&lines[plane.fast * GROUP..plane.end * GROUP]);
    }
    total += sum_of_squares(&lines[plan.lines * GROUP..]) * SUM_SCALE;
    let scale = if plan.normalise { inverse_norm(total) } else { 1.0 };

    for run in &plan.runs {
        for i in 0..run.len {
            out[run.to + i] = lines[run.from + i] * scale;
        }
    }
    for plane in &plan.planes {
        for i in 0..plane.rows {
            let slow = lines[plane.slow * GROUP + i] * scale;
            for j in 0..plane.stride {
                out[plane.start + i * plane.stride + j] = lines[plane.fast * GROUP + j] * slow;
            }
        }
    }
}
