//! The reward model: `r = w . psi(inputs, changes)`, learned by recursive least squares.
//!
//! psi holds a constant, the bases of the single inputs (smooth family), the products of the bases of every two inputs,
//! and the squared changes of the moved inputs. Least squares are the Kalman filter's: weights have a prior, the reward a
//! noise, so that the first tick is as well defined as the millionth.
//!
//! Nothing is forgotten as long as the model holds. Each tick a tiny share of the covariance is put back to the prior
//! (stabilised forgetting, Milek & Kraus 1995), which bounds its condition for good. When rewards come out many standard
//! deviations from what was expected, tick after tick, the world has changed, and a large share is put back: weights
//! stay where they are, and move only where the new rewards contradict them.

use super::basis::Basis;
use crate::SignalConfig;
use crate::learner::ModelConfig;
use crate::state::{Persist, StateVisitor};

/// Share of the covariance that is put back to the prior a tick.
const LEAK: f64 = 1e-7;
/// The same when the world has changed.
const DOUBT: f64 = 0.2;
/// Share of the newest tick in the mean of normalised squared errors.
const NEWEST: f64 = 0.2;
/// No tick counts for more than this in it, so that it takes three in a row to raise the alarm.
const MOST: f64 = 25.0;
/// That mean above which the world has changed; 1 is to be expected.
const ALARM: f64 = 12.0;
/// Normalised squared error up to which a reward was expected.
const EXPECTED: f64 = 4.0;

/// The reward model. Inputs are in its own order: first those that commands do not move, then the moved ones.
#[derive(Debug, Clone)]
pub(super) struct RewardModel {
    pub bases: Vec<Basis>,
    /// Where each input's functions begin in `values`.
    pub starts: Vec<usize>,
    /// Number of inputs that commands do not move.
    pub still: usize,
    /// Where the single functions begin in psi, if they are in it.
    singles: Option<usize>,
    /// Two inputs and where their products begin in psi.
    pairs: Vec<(usize, usize, usize)>,
    /// Where the squared changes begin in psi.
    squares: usize,
    weights: Vec<f64>,
    /// The same in single precision, for rehearsal.
    single: Vec<f32>,
    /// The cost's coefficients of the products of two moved inputs' functions: a symmetric matrix, row by row.
    products: Vec<f32>,
    /// Upper triangle, row after row.
    covariance: Vec<f64>,
    prior: Vec<f64>,
    noise: f64,
    psi: Vec<f64>,
    gain: Vec<f64>,
    values: Vec<f32>,
    slopes: Vec<f32>,
    alarm: f64,
}

impl RewardModel {
    /// Knows nothing of the reward of `signals`, of which the first `still` are not moved.
    pub fn new(table: &ModelConfig, signals: &[SignalConfig], still: usize) -> Self {
        let bases: Vec<_> = signals.iter().map(|s| Basis::of(table.basis, table.basis.size(), s)).collect();
        let mut total = 0;
        let starts: Vec<_> = bases
            .iter()
            .map(|b| {
                total += b.len();
                total - b.len()
            })
            .collect();
        let spreads: Vec<Vec<f64>> =
            bases.iter().map(|b| (0..b.len()).map(|i| b.spread(i, table.smoothness)).collect()).collect();

        let mut prior = vec![1.0];
        let singles = (table.basis.has_singles()).then_some(1);
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
        prior.resize(squares + bases.len() - still, 1.0);
        prior.iter_mut().for_each(|p| *p *= table.spread * table.spread);

        let n = prior.len();
        let of_moved = total - starts[still];
        let mut model = Self {
            bases,
            starts,
            still,
            singles,
            pairs,
            squares,
            weights: vec![0.0; n],
            single: vec![0.0; n],
            products: vec![0.0; of_moved * of_moved],
            covariance: vec![0.0; n * (n + 1) / 2],
            prior,
            noise: table.reward_noise * table.reward_noise,
            psi: vec![0.0; n],
            gain: vec![0.0; n],
            values: vec![0.0; total],
            slopes: vec![0.0; total],
            alarm: 0.0,
        };
        model.restart();
        model
    }

    /// Puts the covariance back to the prior.
    fn restart(&mut self) {
        self.covariance.fill(0.0);
        let (n, mut at) = (self.prior.len(), 0);
        for (i, prior) in self.prior.iter().enumerate() {
            self.covariance[at] = *prior;
            at += n - i;
        }
    }

    fn features(&mut self, inputs: &[f32], changes: &[f32]) {
        for ((basis, &start), &x) in self.bases.iter().zip(&self.starts).zip(inputs) {
            basis.eval(x, &mut self.values[start..], &mut self.slopes[start..]);
        }
        let functions = |i: usize| &self.values[self.starts[i]..][..self.bases[i].len()];
        self.psi[0] = 1.0;
        if let Some(singles) = self.singles {
            for (psi, &v) in self.psi[singles..].iter_mut().zip(&self.values) {
                *psi = v.into();
            }
        }
        for &(i, j, start) in &self.pairs {
            let columns = functions(j);
            for (psi, &a) in self.psi[start..].chunks_exact_mut(columns.len()).zip(functions(i)) {
                for (psi, &b) in psi.iter_mut().zip(columns) {
                    *psi = (a * b).into();
                }
            }
        }
        for (psi, &c) in self.psi[self.squares..].iter_mut().zip(changes) {
            *psi = f64::from(c * c);
        }
    }

    /// Learns that `inputs`, reached by `changes` of the moved ones, earned `reward`. Returns whether the world seems to
    /// have changed; `None` if a number was not finite, in which case nothing is learned. Unless the tick is `due`, a
    /// reward that was expected is only taken note of.
    pub fn learn(&mut self, inputs: &[f32], changes: &[f32], reward: f32, due: bool) -> Option<bool> {
        self.features(inputs, changes);
        let error = f64::from(reward) - dot(&self.weights, &self.psi);
        let surprise = error * error / self.noise;
        if !due && surprise < EXPECTED {
            self.alarm += NEWEST * (surprise - self.alarm);
            return Some(false);
        }
        let n = self.psi.len();
        self.gain.fill(0.0);
        let mut rest = self.covariance.as_slice();
        for i in 0..n {
            let (row, after) = rest.split_at(n - i);
            rest = after;
            let (row, after_row) = (&row[1..], row[0] * self.psi[i]);
            add(&mut self.gain[i + 1..], row, self.psi[i]);
            self.gain[i] += after_row + dot(row, &self.psi[i + 1..]);
        }
        let variance = dot(&self.gain, &self.psi);
        if !(variance.is_finite() && error.is_finite()) {
            return None;
        }
        if variance < 0.0 {
            // Rounding has eaten the covariance.
            self.restart();
            return Some(false);
        }
        let scale = variance + self.noise;
        let step = error / scale;
        add(&mut self.weights, &self.gain, step);
        self.alarm += NEWEST * ((error * step).min(MOST) - self.alarm);
        let changed = self.alarm > ALARM;
        let leak = if changed { DOUBT } else { LEAK };
        let mut rest = self.covariance.as_mut_slice();
        for i in 0..n {
            let (row, after) = rest.split_at_mut(n - i);
            rest = after;
            let gain = self.gain[i] / scale;
            for (p, g) in row.iter_mut().zip(&self.gain[i..]) {
                *p = (*p - gain * g) * (1.0 - leak);
            }
            row[0] += leak * self.prior[i];
        }
        Some(changed)
    }

    /// Takes the weights over for rehearsal.
    pub fn freeze(&mut self) {
        let (first, size) = (self.starts[self.still], self.moved_functions());
        for (single, w) in self.single.iter_mut().zip(&self.weights) {
            *single = *w as f32;
        }
        for &(i, j, start) in self.pairs.iter().filter(|(i, _, _)| *i >= self.still) {
            let columns = self.bases[j].len();
            for (a, row) in self.single[start..].chunks_exact(columns).take(self.bases[i].len()).enumerate() {
                for (b, w) in row.iter().enumerate() {
                    let (a, b) = (self.starts[i] - first + a, self.starts[j] - first + b);
                    self.products[a * size + b] = -w;
                    self.products[b * size + a] = -w;
                }
            }
        }
    }

    /// The cost's (negative reward's) coefficients of the moved inputs' functions, given the still inputs `inputs`.
    /// Returns the part of the cost that does not depend on the moved ones.
    pub fn given(&mut self, inputs: &[f32], linear: &mut [f32]) -> f32 {
        let first = self.starts[self.still];
        for (input, &x) in inputs.iter().enumerate().take(self.still) {
            let start = self.starts[input];
            self.bases[input].eval(x, &mut self.values[start..], &mut self.slopes[start..]);
        }
        match self.singles {
            Some(singles) => {
                for (l, w) in linear.iter_mut().zip(&self.single[singles + first..]) {
                    *l = -w;
                }
            }
            None => linear.fill(0.0),
        }
        let mut alone = -self.single[0];
        if let Some(singles) = self.singles {
            alone -= self.values[..first].iter().zip(&self.single[singles..]).map(|(v, w)| v * w).sum::<f32>();
        }
        for &(i, j, start) in self.pairs.iter().filter(|(i, _, _)| *i < self.still) {
            let columns = self.bases[j].len();
            let rows = self.single[start..].chunks_exact(columns).zip(&self.values[self.starts[i]..]);
            let rows = rows.take(self.bases[i].len());
            if j < self.still {
                let b = &self.values[self.starts[j]..];
                alone -= rows.map(|(row, a)| a * row.iter().zip(b).map(|(w, b)| w * b).sum::<f32>()).sum::<f32>();
                continue;
            }
            let linear = &mut linear[self.starts[j] - first..][..columns];
            for (row, v) in rows {
                for (l, w) in linear.iter_mut().zip(row) {
                    *l -= v * w;
                }
            }
        }
        alone
    }

    /// The slopes of the cost along the moved inputs, at `inputs` (the moved ones), with `linear` from
    /// [`given`](Self::given). `scratch` is as long as `linear`. Returns the part of the cost that depends on them.
    pub fn slopes(&mut self, inputs: &[f32], linear: &[f32], scratch: &mut [f32], slopes: &mut [f32]) -> f32 {
        let first = self.starts[self.still];
        for (input, &x) in (self.still..self.bases.len()).zip(inputs) {
            let start = self.starts[input];
            self.bases[input].eval(x, &mut self.values[start..], &mut self.slopes[start..]);
        }
        scratch.copy_from_slice(linear);
        for (row, v) in self.products.chunks_exact(scratch.len()).zip(&self.values[first..]) {
            for (out, w) in scratch.iter_mut().zip(row) {
                *out += v * w;
            }
        }
        for (input, slope) in (self.still..self.bases.len()).zip(slopes) {
            let (start, len) = (self.starts[input], self.bases[input].len());
            let pairs = scratch[start - first..][..len].iter().zip(&self.slopes[start..]);
            *slope = pairs.map(|(g, d)| g * d).sum();
        }
        // What depends on one input counts once, what depends on two was met from both sides.
        let twice = scratch.iter().zip(linear).zip(&self.values[first..]);
        0.5 * twice.map(|((s, l), v)| (s + l) * v).sum::<f32>()
    }

    /// What a squared change of moved input `moved` costs.
    pub fn effort(&self, moved: usize) -> f32 {
        -self.single[self.squares + moved]
    }

    /// Number of functions of the moved inputs.
    pub fn moved_functions(&self) -> usize {
        self.values.len() - self.starts[self.still]
    }

    /// Number of features.
    pub fn len(&self) -> usize {
        self.psi.len()
    }

    #[cfg(test)]
    pub(super) fn predict(&mut self, inputs: &[f32], changes: &[f32]) -> f64 {
        self.features(inputs, changes);
        self.weights.iter().zip(&self.psi).map(|(w, p)| w * p).sum()
    }
}

impl Persist for RewardModel {
    /// What rehearsal needs is worked out from the weights each time.
    fn visit_state(&mut self, visitor: &mut dyn StateVisitor) {
        visitor.numbers("weights", &mut self.weights);
        visitor.numbers("covariance", &mut self.covariance);
        visitor.number("alarm", &mut self.alarm);
    }
}

/// `to += factor * from`.
fn add(to: &mut [f64], from: &[f64], factor: f64) {
    for (t, f) in to.iter_mut().zip(from) {
        *t += factor * f;
    }
}

/// The sum of products, in a fixed order.
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
