//! Sixteen lanes as two times eight, for instruction sets that have no wider register.

use std::ops::{Add, Mul, Sub};

use glam::Vec4;

use super::{F32x8, F32x16, LANES, WIDE_LANES};

/// The lower and the upper eight lanes.
#[derive(Clone, Copy)]
pub(super) struct Pair<L>(L, L);

impl<L: F32x8> Add for Pair<L> {
    type Output = Self;
    #[inline(always)]
    fn add(self, other: Self) -> Self {
        Self(self.0 + other.0, self.1 + other.1)
    }
}

impl<L: F32x8> Sub for Pair<L> {
    type Output = Self;
    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        Self(self.0 - other.0, self.1 - other.1)
    }
}

impl<L: F32x8> Mul for Pair<L> {
    type Output = Self;
    #[inline(always)]
    fn mul(self, other: Self) -> Self {
        Self(self.0 * other.0, self.1 * other.1)
    }
}

impl<L: F32x8> F32x16 for Pair<L> {
    type Half = L;

    #[inline(always)]
    fn splat(x: f32) -> Self {
        Self(L::splat(x), L::splat(x))
    }

    #[inline(always)]
    fn load(from: &[f32; WIDE_LANES]) -> Self {
        let [low, high]: &[[f32; LANES]; 2] = bytemuck::cast_ref(from);
        Self(L::load(low), L::load(high))
    }

    #[inline(always)]
    fn store(self) -> [f32; WIDE_LANES] {
        bytemuck::cast([self.0.store(), self.1.store()])
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
        Self(self.0.less_exponent::<BITS>(shifted.0), self.1.less_exponent::<BITS>(shifted.1))
    }

    #[inline(always)]
    fn halves(self) -> [L; 2] {
        [self.0, self.1]
    }

    #[inline(always)]
    fn joined([low, high]: [L; 2]) -> Self {
        Self(low, high)
    }

    #[inline(always)]
    fn quarters_total(self) -> Vec4 {
        let ([a, b], [c, d]) = (self.0.halves(), self.1.halves());
        (a + b) + (c + d)
    }
}
