//! The natural gradient's metric for a linear-Gaussian policy (Kakade 2001, *A Natural Policy Gradient*).
//!
//! The Fisher information of `u = W g + noise` is the features' second-moment matrix, for each output alike: `F
//! = E[g g^T] / sigma^2`. The expectation is over inputs drawn uniformly from the input box, and is computed
//! once, when the learner is built: the states that a policy will visit are not known, and a constant metric
//! cannot become singular. A fraction of the mean eigenvalue is added to the diagonal. The inverse is scaled so
//! that a step along a direction without variance is as long as that of the plain rule.

use rand::RngExt as _;

use super::LearnerSpec;
use super::dot;
use crate::seed::stream;
use tectum_encoder::Encoder;

/// Number of inputs drawn from the input box.
const DRAWS: usize = 4000;

/// Multiplies features by the inverse of their regularised second-moment matrix.
#[derive(Debug, Clone)]
pub struct NaturalMetric {
    /// The matrix, row by row, in the padded layout.
    inverse: Vec<f32>,
    result: Vec<f32>,
}

impl NaturalMetric {
    /// The metric over the input box of `spec`, for features of `encoder`.
    pub fn of(spec: &LearnerSpec, encoder: &Encoder) -> Self {
        let mut encoder = encoder.clone();
        let (len, units) = (encoder.len(), encoder.units());
        let mut features = encoder.features();
        let mut rng = stream(spec.seed, "metric");
        let mut inputs = vec![0.0; spec.inputs.len()];
        let mut moments = vec![0.0; len * len];
        for _ in 0..DRAWS {
            for (x, signal) in inputs.iter_mut().zip(&spec.inputs) {
                *x = (signal.min + (signal.max - signal.min) * rng.random::<f64>()) as f32;
            }
            encoder.encode(&inputs, &mut features);
            let g = features.as_slice();
            for (row, &a) in moments.chunks_exact_mut(len).zip(g) {
                for (m, &b) in row.iter_mut().zip(g) {
                    *m += f64::from(a * b);
                }
            }
        }
        moments.iter_mut().for_each(|m| *m /= DRAWS as f64);
        Self::from_moments(moments, len, units, spec.learner.critic.clone().unwrap_or_default().regularisation)
    }

    /// The metric of a second-moment matrix, row by row, with `units` true features among `len`.
    pub fn from_moments(mut moments: Vec<f64>, len: usize, units: usize, share: f64) -> Self {
        let trace: f64 = moments.iter().step_by(len + 1).sum();
        let ridge = share * trace / units as f64;
        moments.iter_mut().step_by(len + 1).for_each(|m| *m += ridge);
        let mut inverse = inverse(moments, len);
        inverse.iter_mut().for_each(|m| *m *= ridge);
        Self { inverse: inverse.iter().map(|&m| m as f32).collect(), result: vec![0.0; len] }
    }

    /// Computes the product with `features`; [`result`](Self::result) returns it.
    pub fn apply(&mut self, features: &[f32]) {
        for (result, row) in self.result.iter_mut().zip(self.inverse.chunks_exact(features.len())) {
            *result = dot(row, features);
        }
    }

    /// The latest product.
    pub fn result(&self) -> &[f32] {
        &self.result
    }
}

/// The inverse of a symmetric positive definite matrix, by Gauss-Jordan elimination, which needs no pivoting here.
fn inverse(mut a: Vec<f64>, n: usize) -> Vec<f64> {
    let mut inverse = vec![0.0; n * n];
    inverse.iter_mut().step_by(n + 1).for_each(|d| *d = 1.0);
    let mut row = vec![0.0; 2 * n];
    for i in 0..n {
        let pivot = a[i * n + i];
        for j in 0..n {
            a[i * n + j] /= pivot;
            inverse[i * n + j] /= pivot;
        }
        row[..n].copy_from_slice(&a[i * n..][..n]);
        row[n..].copy_from_slice(&inverse[i * n..][..n]);
        for k in (0..n).filter(|&k| k != i) {
            let factor = a[k * n + i];
            for j in 0..n {
                a[k * n + j] -= factor * row[j];
                inverse[k * n + j] -= factor * row[n + j];
            }
        }
    }
    inverse
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_metric_inverts_the_moments() {
        // Two features that overlap, and a pad.
        let moments = vec![2.0, 1.0, 0.0, 1.0, 2.0, 0.0, 0.0, 0.0, 0.0];
        let mut metric = NaturalMetric::from_moments(moments, 3, 2, 0.5);
        // Ridge 1: (M + I)^-1 (3, 1)^T = (1, 0)^T.
        metric.apply(&[3.0, 1.0, 0.0]);
        for (got, expected) in metric.result().iter().zip([1.0, 0.0, 0.0]) {
            assert!((got - expected).abs() < 1e-6);
        }
    }
}
