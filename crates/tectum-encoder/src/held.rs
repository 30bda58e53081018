//! What stays valid from one call to the next.
//!
//! An input often keeps its value for many ticks, as a target does. While all inputs of the planes keep their bits, the
//! activations of the planes' lines, which are still in memory, need not be computed again, nor the sum of their
//! squares. The features themselves change with the norm, to which every input contributes.

use super::tables::EncoderTables;

/// What is known of the planes since they were encoded last.
#[derive(Debug, Clone)]
pub(super) struct HeldPlanes {
    /// By plane: the bits of its inputs, slow and fast.
    inputs: Vec<[u32; 2]>,
    /// Whether the planes were encoded with these inputs.
    known: bool,
    /// The sum of the features' squares, times [`SUM_SCALE`](super::exponential::SUM_SCALE).
    pub squares: f32,
}

impl HeldPlanes {
    /// Nothing is known yet.
    pub fn new(tables: &EncoderTables) -> Self {
        Self { inputs: vec![[0; 2]; tables.planes.len()], known: false, squares: 0.0 }
    }

    /// The activations in memory are no longer those of these inputs.
    pub fn forget(&mut self) {
        self.known = false;
    }

    /// The activations in memory are those of the inputs that [`take`](Self::take) was given.
    #[inline(always)]
    pub fn keep(&mut self, squares: f32) {
        (self.known, self.squares) = (true, squares);
    }

    /// Whether the planes were encoded with these inputs, bit for bit. If not, the caller encodes them, and then calls
    /// [`keep`](Self::keep).
    #[inline(always)]
    pub fn take(&mut self, tables: &EncoderTables, inputs: &[f32]) -> bool {
        let mut same = std::mem::take(&mut self.known);
        for (held, plane) in self.inputs.iter_mut().zip(&tables.planes) {
            let bits = [plane.slow, plane.fast].map(|line| inputs[tables.groups[line].input].to_bits());
            same &= *held == bits;
            *held = bits;
        }
        self.known = same;
        same
    }
}
