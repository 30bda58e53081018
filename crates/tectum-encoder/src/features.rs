//! Memory layout of features: one contiguous array of `f32`, aligned so that no vector load or store crosses a
//! cache line.
//!
//! Policy and learner read all features once a tick and need a plain slice; the kernel needs groups of sixteen.
//! [`Features`] offers both views of memory that is aligned to cache lines.

use bytemuck::{Pod, Zeroable};

use crate::simd::WIDE_LANES;

/// Number of features in a block: rows of units are padded to a multiple of it.
pub(super) const BLOCK: usize = 4;

/// A cache line of neighbouring features, or of intermediate results for them: one vector of [`WIDE_LANES`].
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
#[repr(C, align(64))]
pub(super) struct CacheLine(pub [f32; GROUP]);

/// Number of features in a group: one cache line.
pub(super) const GROUP: usize = WIDE_LANES;

/// The features of one tick, in the encoder's padded order.
///
/// Made by [`Encoder::features`](super::Encoder::features), filled by
/// [`Encoder::encode`](super::Encoder::encode). The padding is exactly 0 whenever an encoder made or filled the
/// memory, so sums over the whole slice are sums over the true features.
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

    /// A copy of `values`, whose length is a multiple of [`BLOCK`].
    pub(super) fn from_slice(values: &[f32]) -> Self {
        let mut features = Self::zeroed(values.len());
        features.as_mut_slice().copy_from_slice(values);
        features
    }

    /// Number of features including padding; always a multiple of 4.
    pub fn len(&self) -> usize {
        self.len
    }

    /// Whether there are no features at all, as for an encoder without maps.
    pub fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// All features including padding. The slice starts on a 64-byte boundary.
    #[inline]
    pub fn as_slice(&self) -> &[f32] {
        &bytemuck::cast_slice(&self.lines)[..self.len]
    }

    /// All features including padding, mutable. Write only 0 to padding: sums over the whole slice rely on it.
    #[inline]
    pub fn as_mut_slice(&mut self) -> &mut [f32] {
        &mut bytemuck::cast_slice_mut(&mut self.lines)[..self.len]
    }

    /// All features in cache lines; the last line may extend beyond the features.
    #[inline]
    pub(super) fn cache_lines(&self) -> &[CacheLine] {
        &self.lines
    }

    /// All features in cache lines, mutable.
    #[inline]
    pub(super) fn cache_lines_mut(&mut self) -> &mut [CacheLine] {
        &mut self.lines
    }
}
