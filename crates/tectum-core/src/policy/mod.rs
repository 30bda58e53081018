//! The linear-Gaussian policy `u = W g + noise`, `noise ~ N(0, sigma^2 I)` (paper section 3.2, equations 3 to
//! 6). The noise may have another distribution with the same standard deviation ([`Exploration`]).
//!
//! Weights are stored in [`Tiles`] of four outputs by eight features, so that one pass over the features serves all
//! outputs.

mod exploration;
mod noise;
mod tiles;

pub use exploration::Exploration;
pub use noise::Noise;
pub use tiles::{Tiles, TraceStep};

use xxhash_rust::xxh3::Xxh3;

use crate::MAX_OUTPUTS;
use crate::state::{Persist, StateVisitor};
use tectum_encoder::simd::SimdPath;
use tiles::{MeanKernel, ROWS, StepKernel};

/// One value for each output that a command can carry; values beyond the plant's outputs stay 0.
pub type Outputs = [f32; MAX_OUTPUTS];

/// The weights of a linear policy over encoded features.
#[derive(Debug, Clone)]
pub struct LinearPolicy {
    /// By output and by feature, in the encoder's padded layout.
    weights: Tiles,
    /// Positions of the true features in the padded layout.
    order: Vec<usize>,
    outputs: usize,
    path: SimdPath,
}

impl LinearPolicy {
    /// All-zero weights from `len` features, including padding, to `outputs` outputs. The true features are at the
    /// positions `order`.
    pub fn new(len: usize, order: Vec<usize>, outputs: usize) -> Self {
        debug_assert!((1..=MAX_OUTPUTS).contains(&outputs));
        Self { weights: Tiles::zeroed(len, outputs), order, outputs, path: SimdPath::best() }
    }

    /// The same policy with another SIMD path than the machine's fastest: the same numbers, bit for bit.
    pub fn on(self, path: SimdPath) -> Self {
        Self { path, ..self }
    }

    /// Number of outputs.
    pub fn outputs(&self) -> usize {
        self.outputs
    }

    /// The mean output `W g` for features `g` in the encoder's layout.
    pub fn mean(&self, features: &[f32]) -> Outputs {
        let mut mean = [0.0; MAX_OUTPUTS];
        for (weights, mean) in self.weights.groups.iter().zip(mean.as_chunks_mut::<ROWS>().0) {
            self.path.run(MeanKernel { weights, features, mean });
        }
        mean
    }

    /// Updates `trace`, which has the size of this policy, and adds it to the weights.
    pub fn step(&mut self, trace: &mut Tiles, step: TraceStep) {
        self.advance::<false>(trace, step, &[], &mut [0.0; MAX_OUTPUTS]);
    }

    /// [`step`](Self::step), and in the same pass the mean output for the features `next` with the new weights:
    /// the bits of [`mean`](Self::mean).
    #[inline]
    pub fn step_and_answer(&mut self, trace: &mut Tiles, step: TraceStep, next: &[f32], mean: &mut Outputs) {
        self.advance::<true>(trace, step, next, mean);
    }

    #[inline(always)]
    fn advance<const WITH_MEAN: bool>(&mut self, trace: &mut Tiles, step: TraceStep, next: &[f32], mean: &mut Outputs) {
        let groups = self.weights.groups.iter_mut().zip(&mut trace.groups).zip(step.gain.chunks(ROWS));
        for (((weights, trace), gain), mean) in groups.zip(mean.as_chunks_mut::<ROWS>().0) {
            let step = TraceStep { gain, ..step };
            self.path.run(StepKernel::<WITH_MEAN> { weights, trace, step, next, mean });
        }
    }

    /// The weights, by output and by position of the feature in the encoder's layout.
    pub fn weights(&self) -> &Tiles {
        &self.weights
    }

    /// The weights, mutable.
    pub fn weights_mut(&mut self) -> &mut Tiles {
        &mut self.weights
    }

    /// The SIMD path of the policy's computations.
    pub fn path(&self) -> SimdPath {
        self.path
    }

    /// The weight from true feature `feature` to output `output`.
    pub fn weight(&self, output: usize, feature: usize) -> f32 {
        self.weights.get(output, self.order[feature])
    }

    /// Number of true features.
    pub fn features(&self) -> usize {
        self.order.len()
    }

    /// Euclidean norm of the weights.
    pub fn norm(&self) -> f32 {
        self.weights.norm_on(self.path)
    }

    /// XXH3-64 of the weights as little-endian f32, row by row: all features of the first output, then of the
    /// second, without padding. Two runs with equal hashes have learned the same, bit for bit.
    pub fn hash(&self) -> u64 {
        let mut hash = Xxh3::new();
        for output in 0..self.outputs {
            for feature in 0..self.features() {
                hash.update(&self.weight(output, feature).to_le_bytes());
            }
        }
        hash.digest()
    }
}

impl Persist for LinearPolicy {
    fn visit_state(&mut self, visitor: &mut dyn StateVisitor) {
        visitor.nested("weights", &mut self.weights);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn policy(len: usize, outputs: usize, values: &[f32]) -> LinearPolicy {
        let mut policy = LinearPolicy::new(len, (0..len).collect(), outputs);
        for (k, &v) in values.iter().enumerate().take(len * outputs) {
            *policy.weights.get_mut(k / len, k % len) = v;
        }
        policy
    }

    proptest! {
        #[test]
        fn the_mean_is_the_plain_sum(
            len in 1_usize..40,
            outputs in 1_usize..=8,
            values in proptest::collection::vec(-1.0_f32..1.0, 320),
            features in proptest::collection::vec(0.0_f32..1.0, 40),
        ) {
            let features = &features[..len];
            let policy = policy(len, outputs, &values);
            let mean = policy.mean(features);
            for (output, &mean) in mean.iter().enumerate() {
                let expected: f64 = if output < outputs {
                    (0..len).map(|i| f64::from(policy.weight(output, i)) * f64::from(features[i])).sum()
                } else {
                    0.0
                };
                prop_assert!((f64::from(mean) - expected).abs() < 1e-5);
            }
        }
    }

    #[test]
    fn one_bit_changes_the_hash_and_padding_does_not() {
        let values: Vec<f32> = (0..20).map(|i| i as f32).collect();
        let a = policy(5, 4, &values);
        let mut b = a.clone();
        assert_eq!(a.hash(), b.hash());
        let weight = b.weights.get_mut(2, 3);
        *weight = f32::from_bits(weight.to_bits() ^ 1);
        assert_ne!(a.hash(), b.hash());
        // The same weights in a layout with three pads.
        let mut padded = LinearPolicy::new(8, (0..5).collect(), 4);
        for (output, i) in (0..4).flat_map(|output| (0..5).map(move |i| (output, i))) {
            *padded.weights.get_mut(output, i) = a.weights.get(output, i);
        }
        assert_eq!(a.hash(), padded.hash());
    }
}
