//! Eight lanes in one AVX2 register, which is also half of what AVX-512 has.
//!
//! Plain arrays would need no `unsafe`, but the compiler does not reliably vectorise them: it compiled the
//! encoder's loop over groups of units to scalar code. Each intrinsic is a single operation that is rounded on
//! its own.

use std::arch::x86_64::{
    __m256, _mm256_add_ps, _mm256_castps_si256, _mm256_castps256_ps128, _mm256_castsi256_ps, _mm256_extractf128_ps,
    _mm256_hadd_ps, _mm256_max_ps, _mm256_min_ps, _mm256_mul_ps, _mm256_permute2f128_ps, _mm256_set1_ps,
    _mm256_shuffle_ps, _mm256_slli_epi32, _mm256_sub_epi32, _mm256_sub_ps, _mm256_unpackhi_ps, _mm256_unpacklo_ps,
};
use std::ops::{Add, Mul, Sub};

use glam::Vec4;

use super::avx512::Avx512F32x16;
use super::wide::Pair;
use super::{F32x8, Kernel, LANES};

/// Eight lanes, in a kernel for AVX2 or (`AVX512`) in one for AVX-512. Only [`run`], its twin for AVX-512 and the
/// kernels that they call make values of this type.
#[derive(Clone, Copy)]
pub(super) struct Ymm<const AVX512: bool>(pub(super) __m256);

/// Runs `kernel`, compiled for AVX2. Calling this on a machine without AVX2 is undefined behaviour.
#[target_feature(enable = "avx2")]
pub(super) fn run<K: Kernel>(kernel: K) -> K::Output {
    kernel.run::<Ymm<false>>()
}

// SAFETY (of every block below): operations on `Ymm` are reached only through `run` and its twin for AVX-512,
// whose callers have detected these instructions on this machine. None of them accesses memory.

impl<const AVX512: bool> Add for Ymm<AVX512> {
    type Output = Self;
    #[inline(always)]
    fn add(self, other: Self) -> Self {
        // SAFETY: see above.
        Self(unsafe { _mm256_add_ps(self.0, other.0) })
    }
}

impl<const AVX512: bool> Sub for Ymm<AVX512> {
    type Output = Self;
    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        // SAFETY: see above.
        Self(unsafe { _mm256_sub_ps(self.0, other.0) })
    }
}

impl<const AVX512: bool> Mul for Ymm<AVX512> {
    type Output = Self;
    #[inline(always)]
    fn mul(self, other: Self) -> Self {
        // SAFETY: see above.
        Self(unsafe { _mm256_mul_ps(self.0, other.0) })
    }
}

/// Implements [`F32x8`] for a kind of [`Ymm`], with the type of its pairs. (As one generic implementation, the two
/// traits' bounds would have to be proved in a circle.)
macro_rules! eight_lanes {
    ($avx512:literal, $wide:ty) => {
        impl F32x8 for Ymm<$avx512> {
            type Wide = $wide;

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
            fn max(self, other: Self) -> Self {
                // SAFETY: see above.
                Self(unsafe { _mm256_max_ps(self.0, other.0) })
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
            #[inline(always)]
            fn transposed([a, b, c, d, e, f, g, h]: [Self; LANES]) -> [Self; LANES] {
                // Within each half register: pairs of neighbouring rows, then fours, then the halves are exchanged.
                // SAFETY: see above.
                unsafe {
                    let (ab, cd) = (interleaved(a.0, b.0), interleaved(c.0, d.0));
                    let (ef, gh) = (interleaved(e.0, f.0), interleaved(g.0, h.0));
                    let (low, high) = (fours(ab, cd), fours(ef, gh));
                    let (a, b, c, d) = (
                        _mm256_permute2f128_ps::<0x20>(low[0], high[0]),
                        _mm256_permute2f128_ps::<0x20>(low[1], high[1]),
                        _mm256_permute2f128_ps::<0x20>(low[2], high[2]),
                        _mm256_permute2f128_ps::<0x20>(low[3], high[3]),
                    );
                    let (e, f, g, h) = (
                        _mm256_permute2f128_ps::<0x31>(low[0], high[0]),
                        _mm256_permute2f128_ps::<0x31>(low[1], high[1]),
                        _mm256_permute2f128_ps::<0x31>(low[2], high[2]),
                        _mm256_permute2f128_ps::<0x31>(low[3], high[3]),
                    );
                    [Self(a), Self(b), Self(c), Self(d), Self(e), Self(f), Self(g), Self(h)]
                }
            }
        }
    };
}

eight_lanes!(false, Pair<Self>);
eight_lanes!(true, Avx512F32x16);

/// The lanes of two rows in turns: of the lower and of the upper two lanes of each half.
#[inline(always)]
fn interleaved(a: __m256, b: __m256) -> [__m256; 2] {
    // SAFETY: see above.
    unsafe { [_mm256_unpacklo_ps(a, b), _mm256_unpackhi_ps(a, b)] }
}

/// Four rows of transposed blocks of four, from two times two interleaved rows.
#[inline(always)]
fn fours([ab, ab_upper]: [__m256; 2], [cd, cd_upper]: [__m256; 2]) -> [__m256; 4] {
    // SAFETY: see above.
    unsafe {
        [
            _mm256_shuffle_ps::<0x44>(ab, cd),
            _mm256_shuffle_ps::<0xee>(ab, cd),
            _mm256_shuffle_ps::<0x44>(ab_upper, cd_upper),
            _mm256_shuffle_ps::<0xee>(ab_upper, cd_upper),
        ]
    }
}
