//! Where features lie in memory: one flat run of `f32`, aligned so that no vector load or store is ever split.
//!
//! The learner downstream walks over all features once or twice a tick and reads each as a splat, so what it wants is
//! a plain slice. The kernel wants blocks of four lanes. [`Features`] is both, over memory aligned to a cache line: a
//! block of 4 (or, one day, of 8 or 16) lanes then never straddles two lines.

use bytemuck::{Pod, Zeroable};

/// Lanes of a block: what the kernel computes at once, and what rows of units are padded to.
pub(super) const LANES: usize = 4;

/// Four neighbouring features, or what is computed for them; aligned, so that the kernel can use one as an operand.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
#[repr(C, align(16))]
pub(super) struct Block(pub [f32; LANES]);

/// A cache line of features; only here for its alignment.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
#[repr(C, align(64))]
struct CacheLine([f32; 16]);

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
    /// `len` zeros; `len` is a multiple of [`LANES`].
    pub(super) fn zeroed(len: usize) -> Self {
        debug_assert!(len.is_multiple_of(LANES));
        Self { lines: vec![CacheLine::zeroed(); len.div_ceil(16)], len }
    }

    /// A copy of `values`, whose number is a multiple of [`LANES`].
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

    /// All features in blocks of four lanes.
    #[inline]
    pub(super) fn blocks(&self) -> &[Block] {
        &bytemuck::cast_slice(&self.lines)[..self.len / LANES]
    }

    /// All features in blocks of four lanes, to be written.
    #[inline]
    pub(super) fn blocks_mut(&mut self) -> &mut [Block] {
        &mut bytemuck::cast_slice_mut(&mut self.lines)[..self.len / LANES]
    }
}
