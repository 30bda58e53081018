//! The reward model: `r = w . psi(inputs, changes)`, learned by recursive least squares.
//!
//! psi consists of a constant, the bases of the single inputs (smooth family), the products of the bases of
//! every two inputs, and the squared changes of the moved inputs. The least squares are those of a Kalman
//! filter: weights have a prior and the reward has noise, so that the estimate is well defined from the first
//! tick on.
//!
//! As long as the model fits, almost nothing is forgotten: in each tick a tiny fraction of the covariance is
//! replaced by the prior (stabilised forgetting, Milek & Kraus 1995), which bounds its condition number. When
//! rewards deviate from the prediction by many standard deviations in several ticks in a row, the world has
//! changed, and a large fraction is replaced. The weights keep their values, and change only where new rewards
//! contradict them. Rewards far outside the range of all others are left out (`outliers.rs`). If no others come any
//! more, the model begins anew, with a prior for rewards of their size.
//!
//! The variance of the noise is learned: it is the running mean of `z^2 R`, where `z^2` is the squared error in
//! units of its expected variance and `R` the variance of the noise so far, and at least the configured one. What
//! the basis cannot represent counts as noise. Otherwise it would raise the alarm for ever, and the model would
//! forget in every tick.

use tectum_encoder::simd::{F32x8, Kernel, SimdPath};

use super::basis::Basis;
use super::outliers::{OutlierFilter, RewardVerdict};
use crate::SignalConfig;
use crate::learner::ModelConfig;
use crate::state::{Persist, StateVisitor};

/// Fraction of the covariance that is replaced by the prior in each tick.
const LEAK: f64 = 1e-7;
/// The same fraction when the world has changed.
const CHANGE_LEAK: f64 = 0.2;
/// Weight of the newest tick in the running mean of normalised squared errors.
const ALARM_RATE: f64 = 0.2;
/// Limit of a tick's contribution to that mean, so that an alarm takes three large errors in a row.
const MAX_SURPRISE: f64 = 25.0;
/// The world counts as changed when that mean exceeds this value; 1 is normal.
const ALARM_THRESHOLD: f64 = 12.0;
/// Normalised squared error below which a reward counts as expected.
const EXPECTED_SURPRISE: f64 = 4.0;
/// Weight of the newest tick in the estimate of the noise's variance. An alarm is over long before it has grown
/// much.
const NOISE_RATE: f64 = 2e-3;

/// The terms of the reward model, in the order of psi. Inputs are in the model's order: first the fixed ones, which
/// commands do not move, then the moved ones.
#[derive(Debug, Clone)]
pub(super) struct RewardTerms {
    pub bases: Vec<Basis>,
    /// Start of each input's functions in `values`.
    pub starts: Vec<usize>,
    /// Number of inputs that commands do not move.
    pub fixed: usize,
    /// Start of the functions of single inputs in psi, if there are any.
    pub singles: Option<usize>,
    /// Pairs of inputs, and the start of their products in psi.
    pub pairs: Vec<(usize, usize, usize)>,
    /// Start of the squared changes in psi.
    pub squares: usize,
}

/// The reward model.
#[derive(Debug, Clone)]
pub(super) struct RewardModel {
    pub terms: RewardTerms,
    weights: Vec<f64>,
    /// Upper triangle, row by row.
    covariance: Vec<f64>,
    prior: Vec<f64>,
    /// Configured variance of the noise, the least one that is assumed, and the learned one.
    least_noise: f64,
    noise: f64,
    outliers: OutlierFilter,
    /// Factor of the prior variances, for rewards of another size than the configured one.
    prior_scale: f64,
    psi: Vec<f64>,
    gain: Vec<f64>,
    values: Vec<f32>,
    slopes: Vec<f32>,
    /// Running mean of normalised squared errors.
    alarm: f64,
}

impl RewardModel {
    /// A model with all weights 0 over `signals`, of which the first `fixed` are not moved.
    pub fn new(config: &ModelConfig, signals: &[SignalConfig], fixed: usize) -> Self {
        let bases: Vec<_> = signals.iter().map(|s| Basis::of(config.basis, config.basis.size(), s)).collect();
        let mut total = 0;
        let starts: Vec<_> = bases
            .iter()
            .map(|b| {
                total += b.len();
                total - b.len()
            })
            .collect();
        let ModelFeatures { singles, pairs, squares, prior } = ModelFeatures::of(config, &bases, fixed);
        let n = prior.len();
        let mut model = Self {
            terms: RewardTerms { bases, starts, fixed, singles, pairs, squares },
            weights: vec![0.0; n],
            covariance: vec![0.0; n * (n + 1) / 2],
            prior,
            least_noise: config.reward_noise * config.reward_noise,
            noise: 0.0,
            outliers: OutlierFilter::new(config.spread),
            prior_scale: 1.0,
            psi: vec![0.0; n],
            gain: vec![0.0; n],
            values: vec![0.0; total],
            slopes: vec![0.0; total],
            alarm: 0.0,
        };
        model.reset_covariance();
        model
    }

    /// Resets the covariance to the prior.
    fn reset_covariance(&mut self) {
        self.covariance.fill(0.0);
        let (n, mut at) = (self.prior.len(), 0);
        for (i, prior) in self.prior.iter().enumerate() {
            self.covariance[at] = self.prior_scale * prior;
            at += n - i;
        }
    }

    /// Forgets everything, and expects rewards that are `size` times as large as the configured prior has them.
    fn restart(&mut self, size: f64) {
        self.prior_scale = (size * size).max(1.0);
        self.reset_covariance();
        self.weights.fill(0.0);
        (self.alarm, self.noise) = (0.0, 0.0);
    }

    /// Number of rewards left out as outliers.
    pub fn outliers(&self) -> u64 {
        self.outliers.left_out()
    }

    /// Computes psi.
    fn compute_features(&mut self, inputs: &[f32], changes: &[f32]) {
        for ((basis, &start), &x) in self.terms.bases.iter().zip(&self.terms.starts).zip(inputs) {
            basis.eval(x, &mut self.values[start..], &mut self.slopes[start..]);
        }
        let functions = |i: usize| &self.values[self.terms.starts[i]..][..self.terms.bases[i].len()];
        self.psi[0] = 1.0;
        if let Some(singles) = self.terms.singles {
            for (psi, &v) in self.psi[singles..].iter_mut().zip(&self.values) {
                *psi = v.into();
            }
        }
        for &(i, j, start) in &self.terms.pairs {
            let columns = functions(j);
            for (psi, &a) in self.psi[start..].chunks_exact_mut(columns.len()).zip(functions(i)) {
                for (psi, &b) in psi.iter_mut().zip(columns) {
                    *psi = (a * b).into();
                }
            }
        }
        for (psi, &c) in self.psi[self.terms.squares..].iter_mut().zip(changes) {
            *psi = f64::from(c * c);
        }
    }

    /// Learns that `inputs`, reached by `changes` of the moved ones, had `reward`. Returns whether the world
    /// seems to have changed; `None` if a number was not finite, in which case nothing is learned. Unless
    /// `update` is set, an expected reward updates only the alarm.
    pub fn learn(
        &mut self,
        path: SimdPath,
        inputs: &[f32],
        changes: &[f32],
        reward: f32,
        update: bool,
    ) -> Option<bool> {
        self.compute_features(inputs, changes);
        let error = f64::from(reward) - dot(&self.weights, &self.psi);
        let noise = self.noise.max(self.least_noise);
        let surprise = error * error / noise;
        if !update && surprise < EXPECTED_SURPRISE {
            self.alarm += ALARM_RATE * (surprise - self.alarm);
            self.outliers.believe(reward.into());
            return Some(false);
        }
        path.run(Gain { covariance: &self.covariance, psi: &self.psi, gain: &mut self.gain });
        let variance = dot(&self.gain, &self.psi);
        if !(variance.is_finite() && error.is_finite()) {
            return None;
        }
        if variance < 0.0 {
            // Rounding errors have made the covariance indefinite.
            self.reset_covariance();
            return Some(false);
        }
        let scale = variance + noise;
        let step = error / scale;
        let surprise = (error * step).min(MAX_SURPRISE);
        match self.outliers.judge(reward.into(), error, surprise) {
            RewardVerdict::Believe => {}
            RewardVerdict::LeaveOut => return Some(false),
            RewardVerdict::NewSize(size) => {
                self.restart(size);
                return Some(true);
            }
        }
        add(&mut self.weights, &self.gain, step);
        self.noise += NOISE_RATE * (surprise * noise - self.noise);
        self.alarm += ALARM_RATE * (surprise - self.alarm);
        let changed = self.alarm > ALARM_THRESHOLD;
        let leak = if changed { CHANGE_LEAK } else { LEAK };
        let (prior, gain) = (&self.prior, &self.gain);
        let leaks = [leak, leak * self.prior_scale];
        path.run(Update { covariance: &mut self.covariance, prior, gain, scale, leaks });
        Some(changed)
    }

    /// The weights of psi.
    pub fn weights(&self) -> &[f64] {
        &self.weights
    }

    /// Number of features.
    #[cfg(test)]
    pub fn len(&self) -> usize {
        self.psi.len()
    }

    #[cfg(test)]
    pub(super) fn predict(&mut self, inputs: &[f32], changes: &[f32]) -> f64 {
        self.compute_features(inputs, changes);
        self.weights.iter().zip(&self.psi).map(|(w, p)| w * p).sum()
    }
}

impl Persist for RewardModel {
    /// The tables for rollouts are not part of the state: they are computed from the weights.
    fn visit_state(&mut self, visitor: &mut dyn StateVisitor) {
        visitor.numbers("weights", &mut self.weights);
        visitor.numbers("covariance", &mut self.covariance);
        visitor.number("alarm", &mut self.alarm);
        visitor.number("prior_scale", &mut self.prior_scale);
        visitor.number("noise", &mut self.noise);
        visitor.nested("outliers", &mut self.outliers);
    }
}

/// The layout of psi, and the prior variances of its weights.
struct ModelFeatures {
    singles: Option<usize>,
    pairs: Vec<(usize, usize, usize)>,
    squares: usize,
    prior: Vec<f64>,
}

impl ModelFeatures {
    /// The features for inputs with `bases`, of which the first `fixed` are not moved.
    fn of(config: &ModelConfig, bases: &[Basis], fixed: usize) -> Self {
        let spreads: Vec<Vec<f64>> =
            bases.iter().map(|b| (0..b.len()).map(|i| b.spread(i, config.smoothness)).collect()).collect();
        let mut prior = vec![1.0];
        let singles = (config.basis.has_singles()).then_some(1);
        if singles.is_some() {
            prior.extend(spreads.iter().flatten().map(|s| s * s));
        }
        let mut pairs = Vec::new();
        for j in 0..bases.len() {
            for i in 0..j {
                pairs.push((i, j, prior.len()));
                for a in &spreads[i] {
                    prior.extend(spreads[j].iter().map(|b| a * a * b * b));
                }
            }
        }
        let squares = prior.len();
        prior.resize(squares + bases.len() - fixed, 1.0);
        prior.iter_mut().for_each(|p| *p *= config.spread * config.spread);
        Self { singles, pairs, squares, prior }
    }
}

/// The covariance times psi.
struct Gain<'a> {
    covariance: &'a [f64],
    psi: &'a [f64],
    gain: &'a mut [f64],
}

impl Kernel for Gain<'_> {
    type Output = ();

    #[inline(always)]
    fn run<L: F32x8>(self) {
        let Self { covariance, psi, gain } = self;
        let n = psi.len();
        gain.fill(0.0);
        let mut rest = covariance;
        for i in 0..n {
            let (row, after) = rest.split_at(n - i);
            rest = after;
            let (row, after_row) = (&row[1..], row[0] * psi[i]);
            add(&mut gain[i + 1..], row, psi[i]);
            gain[i] += after_row + dot(row, &psi[i + 1..]);
        }
    }
}

/// Takes what a tick told out of the covariance, and leaks a fraction towards the prior.
struct Update<'a> {
    covariance: &'a mut [f64],
    prior: &'a [f64],
    gain: &'a [f64],
    /// Variance of the error.
    scale: f64,
    /// The fraction, and the fraction times the prior's scale.
    leaks: [f64; 2],
}

impl Kernel for Update<'_> {
    type Output = ();

    #[inline(always)]
    fn run<L: F32x8>(self) {
        let Self { covariance, prior, gain, scale, leaks: [leak, prior_leak] } = self;
        let n = gain.len();
        let mut rest = covariance;
        for i in 0..n {
            let (row, after) = rest.split_at_mut(n - i);
            rest = after;
            let factor = gain[i] / scale;
            for (p, g) in row.iter_mut().zip(&gain[i..]) {
                *p = (*p - factor * g) * (1.0 - leak);
            }
            row[0] += prior_leak * prior[i];
        }
    }
}

/// `to += factor * from`.
#[inline(always)]
fn add(to: &mut [f64], from: &[f64], factor: f64) {
    for (t, f) in to.iter_mut().zip(from) {
        *t += factor * f;
    }
}

/// The scalar product, summed in a fixed order.
#[inline(always)]
fn dot(a: &[f64], b: &[f64]) -> f64 {
    let (a, b) = (a.as_chunks::<8>(), b.as_chunks::<8>());
    let mut sums = [0.0; 8];
    for (a, b) in a.0.iter().zip(b.0) {
        for i in 0..8 {
            sums[i] += a[i] * b[i];
        }
    }
    let rest: f64 = a.1.iter().zip(b.1).map(|(a, b)| a * b).sum();
    sums.iter().sum::<f64>() + rest
}
