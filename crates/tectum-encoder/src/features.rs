//! Where features lie in memory: one flat run of `f32`, aligned so that no vector load or store is ever split.
//!
//! The learner downstream walks over all features once a tick, so what it wants is a plain slice. The kernel wants groups
//! of sixteen. [`Features`] is both, over memory aligned to a cache line: eight lanes then never straddle two lines.

use bytemuck::{Pod, Zeroable};

use crate::simd::LANES;

/// Features of a block: what rows of units are padded to.
pub(super) const BLOCK: usize = 4;

/// A cache line of neighbouring features, or of what is computed for them: twice what is computed at once.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
#[repr(C, align(64))]
pub(super) struct CacheLine(pub [[f32; LANES]; 2]);

/// Features of a group.
pub(super) const GROUP: usize = 2 * LANES;

/// The features of one tick, in the encoder's padded order.
///
/// Made by [`Encoder::features`](super::Encoder::features), filled by [`Encoder::encode`](super::Encoder::encode).
/// Pads are exactly 0 in any that an encoder made or filled, so sums over the whole slice are sums over the true
/// features.
#[derive(Debug, Clone, PartialEq)]
pub struct Features {
    lines: Vec<CacheLine>,
    len: usize,
}

impl Features {
    /// `len` zeros; `len` is a multiple of `BLOCK`.
    pub fn zeroed(len: usize) -> Self {
        debug_assert!(len.is_multiple_of(BLOCK));
        Self { lines: vec![CacheLine::zeroed(); len.div_ceil(GROUP)], len }
    }

    /// A copy of `values`, whose number is a multiple of [`BLOCK`].
    pub(super) fn from_slice(values: &[f32]) -> Self {
        let mut features = Self::zeroed(values.len());
        features.as_mut_slice().copy_from_slice(values);
        features
    }

    /// Number of features with the pads; always a multiple of 4.
    pub fn len(&self) -> usize {
        self.len
    }

    /// Whether there are no features at all, as for an encoder without maps.
    pub fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// All features, pads included. The slice starts on a 64-byte boundary.
    #[inline]
    pub fn as_slice(&self) -> &[f32] {
        &bytemuck::cast_slice(&self.lines)[..self.len]
    }

    /// All features, to be written. Whoever writes anything else than 0 into a pad undoes the promise made above.
    #[inline]
    pub fn as_mut_slice(&mut self) -> &mut [f32] {
        &mut bytemuck::cast_slice_mut(&mut self.lines)[..self.len]
    }

    /// All features in cache lines; the last may be longer than there are features.
    #[inline]
    pub(super) fn cache_lines(&self) -> &[CacheLine] {
        &self.lines
    }

    /// All features in cache lines, to be written.
    #[inline]
    pub(super) fn cache_lines_mut(&mut self) -> &mut [CacheLine] {
        &mut self.lines
    }
}
