//! Eight lanes for every machine: two of glam's vectors of four.

use std::array::from_fn;
use std::ops::{Add, Mul, Sub};

use glam::{Mat4, Vec4};

use super::wide::Pair;
use super::{F32x8, LANES};

/// The implementation for every machine: two of glam's vectors of four lanes.
#[derive(Clone, Copy)]
pub(super) struct GlamF32x8(Vec4, Vec4);

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
    type Wide = Pair<Self>;

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
    fn max(self, other: Self) -> Self {
        Self(self.0.max(other.0), self.1.max(other.1))
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
    #[inline(always)]
    fn transposed(of: [Self; LANES]) -> [Self; LANES] {
        let [a, b, c, d, e, f, g, h] = of;
        let [top_left, bottom_left] = [[a.0, b.0, c.0, d.0], [e.0, f.0, g.0, h.0]].map(transposed_block);
        let [top_right, bottom_right] = [[a.1, b.1, c.1, d.1], [e.1, f.1, g.1, h.1]].map(transposed_block);
        let (mut rows, pairs) = ([Self::splat(0.0); LANES], top_left.into_iter().chain(top_right));
        for (row, (left, right)) in rows.iter_mut().zip(pairs.zip(bottom_left.into_iter().chain(bottom_right))) {
            *row = Self(left, right);
        }
        rows
    }
}

/// The transposed matrix of four rows of four.
#[inline(always)]
fn transposed_block([x, y, z, w]: [Vec4; 4]) -> [Vec4; 4] {
    let block = Mat4::from_cols(x, y, z, w).transpose();
    [block.x_axis, block.y_axis, block.z_axis, block.w_axis]
}
