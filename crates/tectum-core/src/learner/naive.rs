//! A plain baseline for benches and tests: the paper's rule as straightforward loops, against which the speed
//! and the results of [`PaperRule`](super::PaperRule) are measured. A run does not use it.

/// The rule and its policy as plain matrices, with one loop each for trace, weights and mean output.
#[derive(Debug, Clone)]
pub struct NaivePaperRule {
    beta: f32,
    rate: f32,
    weights: Vec<Vec<f32>>,
    trace: Vec<Vec<f32>>,
}

impl NaivePaperRule {
    /// The rule for `len` features and `outputs` outputs, with trace decay `beta` and `rate` = `alpha / sigma^2`.
    pub fn new(len: usize, outputs: usize, beta: f32, rate: f32) -> Self {
        let zeros = vec![vec![0.0; len]; outputs];
        Self { beta, rate, weights: zeros.clone(), trace: zeros }
    }

    /// Learns from one tick.
    pub fn step(&mut self, features: &[f32], noise: &[f32], reward: f32) {
        for (trace, n) in self.trace.iter_mut().zip(noise) {
            for (z, g) in trace.iter_mut().zip(features) {
                *z = self.beta * *z + (1.0 - self.beta) * n * g;
            }
        }
        for (weights, trace) in self.weights.iter_mut().zip(&self.trace) {
            for (w, z) in weights.iter_mut().zip(trace) {
                *w += self.rate * reward * z;
            }
        }
    }

    /// The mean output, for at most eight outputs.
    pub fn mean(&self, features: &[f32]) -> [f32; 8] {
        let mut mean = [0.0; 8];
        for (mean, weights) in mean.iter_mut().zip(&self.weights) {
            *mean = weights.iter().zip(features).map(|(w, g)| w * g).sum();
        }
        mean
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::learner::PaperRule;
    use crate::policy::LinearPolicy;

    #[test]
    fn the_baseline_learns_the_same_as_the_rule() {
        let (mut plain, mut rule) = (NaivePaperRule::new(20, 5, 0.9, 0.1), PaperRule::new(20, 5, 0.9, 0.1));
        let mut policy = LinearPolicy::new(20, (0..20).collect(), 5);
        for tick in 0..50 {
            let g: Vec<f32> = (0..20).map(|i| ((i * 7 + tick * 3) % 11) as f32 / 11.0).collect();
            let noise = std::array::from_fn(|i| ((i + tick) % 5) as f32 / 10.0 - 0.2);
            plain.step(&g, &noise, -0.5);
            rule.step(&mut policy, &g, &noise, -0.5);
            for (a, b) in plain.mean(&g).iter().zip(policy.mean(&g)).take(5) {
                assert!((a - b).abs() < 1e-5, "{a} {b}");
            }
        }
    }
}
