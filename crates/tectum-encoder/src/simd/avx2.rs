//! Eight lanes in one AVX2 register.
//!
//! Plain arrays would need no `unsafe`, but the compiler does not reliably vectorise them: it compiled the
//! encoder's loop over groups of units to scalar code. Each intrinsic is a single operation that is rounded on
//! its own.

use std::arch::x86_64::{
    __m256, _mm256_add_ps, _mm256_castps_si256, _mm256_castps256_ps128, _mm256_castsi256_ps, _mm256_extractf128_ps,
    _mm256_hadd_ps, _mm256_min_ps, _mm256_mul_ps, _mm256_set1_ps, _mm256_slli_epi32, _mm256_sub_epi32, _mm256_sub_ps,
};
use std::ops::{Add, Mul, Sub};

use glam::Vec4;

use super::{F32x8, Kernel, LANES};

/// Eight lanes. Only [`run`] and the kernels that it calls make values of this type.
#[derive(Clone, Copy)]
struct Avx2F32x8(__m256);

/// Runs `kernel`, compiled for AVX2. Calling this on a machine without AVX2 is undefined behaviour.
#[target_feature(enable = "avx2")]
pub(super) fn run<K: Kernel>(kernel: K) -> K::Output {
    kernel.run::<Avx2F32x8>()
}

// SAFETY (of every block below): operations on `Avx2F32x8` are reached only through `run`, whose callers have
// detected AVX2 on this machine. None of them accesses memory.

impl Add for Avx2F32x8 {
    type Output = Self;
    #[inline(always)]
    fn add(self, other: Self) -> Self {
        // SAFETY: see above.
        Self(unsafe { _mm256_add_ps(self.0, other.0) })
    }
}

impl Sub for Avx2F32x8 {
    type Output = Self;
    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        // SAFETY: see above.
        Self(unsafe { _mm256_sub_ps(self.0, other.0) })
    }
}

impl Mul for Avx2F32x8 {
    type Output = Self;
    #[inline(always)]
    fn mul(self, other: Self) -> Self {
        // SAFETY: see above.
        Self(unsafe { _mm256_mul_ps(self.0, other.0) })
    }
}

impl F32x8 for Avx2F32x8 {
    #[inline(always)]
    fn splat(x: f32) -> Self {
        // SAFETY: see above.
        Self(unsafe { _mm256_set1_ps(x) })
    }

    #[inline(always)]
    fn load(from: &[f32; LANES]) -> Self {
        Self(bytemuck::cast(*from))
    }

    #[inline(always)]
    fn store(self) -> [f32; LANES] {
        bytemuck::cast(self.0)
    }

    #[inline(always)]
    fn min(self, other: Self) -> Self {
        // SAFETY: see above.
        Self(unsafe { _mm256_min_ps(self.0, other.0) })
    }

    #[inline(always)]
    fn less_exponent<const BITS: i32>(self, shifted: Self) -> Self {
        // SAFETY: see above.
        Self(unsafe {
            let exponent = _mm256_slli_epi32::<BITS>(_mm256_castps_si256(shifted.0));
            _mm256_castsi256_ps(_mm256_sub_epi32(_mm256_castps_si256(self.0), exponent))
        })
    }

    #[inline(always)]
    fn halves(self) -> [Vec4; 2] {
        // SAFETY: see above.
        unsafe { [_mm256_castps256_ps128(self.0), _mm256_extractf128_ps::<1>(self.0)] }.map(Vec4::from)
    }

    #[inline(always)]
    fn totals([a, b, c, d]: [Self; 4]) -> [f32; 4] {
        // Adds neighbours, then pairs of neighbours, then the two halves.
        // SAFETY: see above.
        let [low, high] = Self(unsafe {
            let (ab, cd) = (_mm256_hadd_ps(a.0, b.0), _mm256_hadd_ps(c.0, d.0));
            _mm256_hadd_ps(ab, cd)
        })
        .halves();
        (low + high).to_array()
    }
}
