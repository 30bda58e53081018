//! Sixteen lanes in one AVX-512 register.

use std::arch::is_x86_feature_detected;
use std::arch::x86_64::{
    __m512, _mm512_add_ps, _mm512_castps_si512, _mm512_castps256_ps512, _mm512_castps512_ps128, _mm512_castps512_ps256,
    _mm512_castsi512_ps, _mm512_extractf32x4_ps, _mm512_extractf32x8_ps, _mm512_insertf32x8, _mm512_max_ps,
    _mm512_min_ps, _mm512_mul_ps, _mm512_set1_epi32, _mm512_set1_ps, _mm512_shuffle_f32x4, _mm512_sllv_epi32,
    _mm512_sub_epi32, _mm512_sub_ps,
};
use std::ops::{Add, Mul, Sub};

use glam::Vec4;

use super::avx2::Ymm;
use super::{F32x16, Kernel, WIDE_LANES};

/// Sixteen lanes. Only [`run`] and the kernels that it calls make values of this type.
#[derive(Clone, Copy)]
pub(super) struct Avx512F32x16(__m512);

/// Whether this machine has what [`run`] is compiled for.
#[inline]
pub(super) fn detected() -> bool {
    is_x86_feature_detected!("avx2")
        && is_x86_feature_detected!("avx512f")
        && is_x86_feature_detected!("avx512dq")
        && is_x86_feature_detected!("avx512vl")
}

/// Runs `kernel`, compiled for AVX-512. Calling this on a machine where it is not [`detected`] is undefined behaviour.
#[target_feature(enable = "avx2,avx512f,avx512dq,avx512vl")]
pub(super) fn run<K: Kernel>(kernel: K) -> K::Output {
    kernel.run::<Ymm<true>>()
}

// SAFETY (of every block below): operations on `Avx512F32x16` are reached only through `run`, whose callers have
// detected AVX-512 on this machine. None of them accesses memory.

impl Add for Avx512F32x16 {
    type Output = Self;
    #[inline(always)]
    fn add(self, other: Self) -> Self {
        // SAFETY: see above.
        Self(unsafe { _mm512_add_ps(self.0, other.0) })
    }
}

impl Sub for Avx512F32x16 {
    type Output = Self;
    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        // SAFETY: see above.
        Self(unsafe { _mm512_sub_ps(self.0, other.0) })
    }
}

impl Mul for Avx512F32x16 {
    type Output = Self;
    #[inline(always)]
    fn mul(self, other: Self) -> Self {
        // SAFETY: see above.
        Self(unsafe { _mm512_mul_ps(self.0, other.0) })
    }
}

impl F32x16 for Avx512F32x16 {
    type Half = Ymm<true>;

    #[inline(always)]
    fn splat(x: f32) -> Self {
        // SAFETY: see above.
        Self(unsafe { _mm512_set1_ps(x) })
    }

    #[inline(always)]
    fn load(from: &[f32; WIDE_LANES]) -> Self {
        Self(bytemuck::cast(*from))
    }

    #[inline(always)]
    fn store(self) -> [f32; WIDE_LANES] {
        bytemuck::cast(self.0)
    }

    #[inline(always)]
    fn min(self, other: Self) -> Self {
        // SAFETY: see above.
        Self(unsafe { _mm512_min_ps(self.0, other.0) })
    }

    #[inline(always)]
    fn max(self, other: Self) -> Self {
        // SAFETY: see above.
        Self(unsafe { _mm512_max_ps(self.0, other.0) })
    }

    #[inline(always)]
    fn less_exponent<const BITS: i32>(self, shifted: Self) -> Self {
        // SAFETY: see above.
        Self(unsafe {
            let exponent = _mm512_sllv_epi32(_mm512_castps_si512(shifted.0), _mm512_set1_epi32(BITS));
            _mm512_castsi512_ps(_mm512_sub_epi32(_mm512_castps_si512(self.0), exponent))
        })
    }

    #[inline(always)]
    fn halves(self) -> [Ymm<true>; 2] {
        // SAFETY: see above.
        unsafe { [Ymm(_mm512_castps512_ps256(self.0)), Ymm(_mm512_extractf32x8_ps::<1>(self.0))] }
    }

    #[inline(always)]
    fn joined([low, high]: [Ymm<true>; 2]) -> Self {
        // SAFETY: see above.
        Self(unsafe { _mm512_insertf32x8::<1>(_mm512_castps256_ps512(low.0), high.0) })
    }

    #[inline(always)]
    fn quarters_total(self) -> Vec4 {
        // SAFETY: see above.
        unsafe {
            let neighbours = _mm512_shuffle_f32x4::<0b10_11_00_01>(self.0, self.0);
            let pairs = _mm512_add_ps(self.0, neighbours);
            Vec4::from(_mm512_castps512_ps128(pairs)) + Vec4::from(_mm512_extractf32x4_ps::<2>(pairs))
        }
    }
}
