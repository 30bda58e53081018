//! The scalar implementation: the kernel's computation, one lane at a time in plain `f32`.
//!
//! It is the kernel's test oracle. It does the same operations in the same order with the same roundings, so
//! both must agree bit for bit; a property test checks this for random maps and inputs. If they differ, either
//! the vector code is wrong, or the compiler fused or reordered `f32` arithmetic, which it must not do.

use super::exponential::{SUM_SCALE, exp2_negative, inverse_norm, scaled};
use super::features::{BLOCK, Features, GROUP};
use super::tables::EncoderTables;

/// The sum of squares of some groups, in the kernel's order: the blocks of a group, then the groups, then the
/// lanes.
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

/// Encodes `inputs` into `out`; `lines` is scratch memory for the activations of the lines.
pub(super) fn encode(tables: &EncoderTables, inputs: &[f32], lines: &mut Features, out: &mut Features) {
    let (lines, out) = (lines.as_mut_slice(), out.as_mut_slice());
    let (centres, floors) = (tables.centres.as_slice(), tables.floors.as_slice());
    for (at, line) in lines.iter_mut().enumerate() {
        let group = &tables.groups[at / GROUP];
        let distance = centres[at] - scaled(inputs[group.input], group.scale);
        *line = exp2_negative(distance * distance, floors[at]);
    }

    let mut total = 0.0;
    for plane in &tables.planes {
        let slow = sum_of_squares(&lines[plane.slow * GROUP..plane.fast * GROUP]) * SUM_SCALE;
        total += slow * sum_of_squares(&lines[plane.fast * GROUP..plane.end * GROUP]);
    }
    total += sum_of_squares(&lines[tables.lines * GROUP..]) * SUM_SCALE;
    let scale = if tables.normalise { inverse_norm(total) } else { 1.0 };

    for range in &tables.line_ranges {
        for i in 0..range.len {
            out[range.to + i] = lines[range.from + i] * scale;
        }
    }
    for plane in &tables.planes {
        for i in 0..plane.rows {
            let slow = lines[plane.slow * GROUP + i] * scale;
            for j in 0..plane.stride {
                out[plane.start + i * plane.stride + j] = lines[plane.fast * GROUP + j] * slow;
            }
        }
    }
}
