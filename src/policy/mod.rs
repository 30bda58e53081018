//! The linear-Gaussian policy `u = W g + noise`, `noise ~ N(0, sigma^2 I)` (paper section 3.2, equations 3 to 6); the noise
//! may have another distribution of the same spread ([`Exploration`]).
//!
//! The outputs are the lanes: four outputs of one feature lie together in a [`Vec4`], so that one pass over the features
//! serves them all. Up to four outputs take one group of lanes, up to eight take two; unused lanes stay zero.

mod exploration;

pub use exploration::Exploration;

use glam::Vec4;
use xxhash_rust::xxh3::Xxh3;

use crate::state::{Ledger, Remember};
use crate::wire::MAX_OUTPUTS;

/// One value for each output that a command can carry; those beyond the plant's stay 0.
pub type Outputs = [f32; MAX_OUTPUTS];

/// Features that are summed side by side, so that the additions do not wait for each other.
const SUMS: usize = 8;

/// The weights of a linear policy over encoded features.
#[derive(Debug, Clone)]
pub struct Linear {
    /// By group of four outputs, then by feature in the encoder's (padded) layout.
    groups: Vec<Vec<Vec4>>,
    /// Where the true features stand in the padded layout.
    order: Vec<usize>,
    outputs: usize,
}

impl Linear {
    /// All-zero weights from `len` (padded) features, of which the true ones stand at `order`, to `outputs` outputs.
    pub fn new(len: usize, order: Vec<usize>, outputs: usize) -> Self {
        debug_assert!((1..=MAX_OUTPUTS).contains(&outputs));
        Self { groups: vec![vec![Vec4::ZERO; len]; outputs.div_ceil(4)], order, outputs }
    }

    /// Number of outputs.
    pub fn outputs(&self) -> usize {
        self.outputs
    }

    /// The mean output `W g` for features `g` in the encoder's layout.
    pub fn mean(&self, features: &[f32]) -> Outputs {
        let mut out = [0.0; MAX_OUTPUTS];
        for (group, lanes) in self.groups.iter().zip(out.chunks_exact_mut(4)) {
            weighted_sum(group, features).write_to_slice(lanes);
        }
        out
    }

    /// The weights by group of four outputs, for a learner.
    pub fn groups_mut(&mut self) -> impl Iterator<Item = &mut [Vec4]> {
        self.groups.iter_mut().map(Vec::as_mut_slice)
    }

    /// The weight from true feature `feature` to output `output`.
    pub fn weight(&self, output: usize, feature: usize) -> f32 {
        self.groups[output / 4][self.order[feature]][output % 4]
    }

    /// Number of true features.
    pub fn features(&self) -> usize {
        self.order.len()
    }

    /// Euclidean norm of the weights.
    pub fn norm(&self) -> f32 {
        norm(&self.groups)
    }

    /// XXH3-64 of the weights as little-endian f32, row by row: all features of the first output, then of the second,
    /// without padding. Two runs with equal hashes have learned the same, bit for bit.
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

impl Remember for Linear {
    fn remember(&mut self, ledger: &mut dyn Ledger) {
        for group in &mut self.groups {
            ledger.numbers("groups", group);
        }
    }
}

/// `sum over i of weights[i] * features[i]`, in a fixed order of summation.
fn weighted_sum(weights: &[Vec4], features: &[f32]) -> Vec4 {
    let mut sums = [Vec4::ZERO; SUMS];
    let (w, g) = (weights.chunks_exact(SUMS), features.chunks_exact(SUMS));
    let rest = w.remainder().iter().zip(g.remainder());
    for (w, g) in w.zip(g) {
        for i in 0..SUMS {
            sums[i] += w[i] * g[i];
        }
    }
    for (i, (w, &g)) in rest.enumerate() {
        sums[i] += *w * g;
    }
    let [a, b, c, d, e, f, g, h] = sums;
    ((a + b) + (c + d)) + ((e + f) + (g + h))
}

/// Euclidean norm over all groups and lanes.
pub fn norm(groups: &[Vec<Vec4>]) -> f32 {
    let mut sums = [Vec4::ZERO; SUMS];
    for group in groups {
        for chunk in group.chunks(SUMS) {
            for (sum, v) in sums.iter_mut().zip(chunk) {
                *sum += *v * *v;
            }
        }
    }
    sums.iter().map(|s| s.element_sum()).sum::<f32>().sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn policy(len: usize, outputs: usize, values: &[f32]) -> Linear {
        let mut policy = Linear::new(len, (0..len).collect(), outputs);
        for (k, &v) in values.iter().enumerate().take(len * outputs) {
            policy.groups[k / len / 4][k % len][(k / len) % 4] = v;
        }
        policy
    }

    proptest! {
        #[test]
        fn the_mean_is_the_textbook_sum(
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
        b.groups[0][3].z = f32::from_bits(b.groups[0][3].z.to_bits() ^ 1);
        assert_ne!(a.hash(), b.hash());
        // The same weights in a layout with three pads.
        let mut padded = Linear::new(8, (0..5).collect(), 4);
        for i in 0..5 {
            padded.groups[0][i] = a.groups[0][i];
        }
        assert_eq!(a.hash(), padded.hash());
    }
}
