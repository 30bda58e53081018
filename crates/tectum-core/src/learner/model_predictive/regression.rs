//! Bayesian linear regression by recursive least squares.
//!
//! For features `phi` (F) and outputs `y_j = w_jᵀ phi + noise` with `w_j ~ N(0, s_j I)` and noise of variance `lambda
//! s_j`, the posterior after some data is `N(w_j, s_j P)` with one `P` (F x F, packed) for all outputs (Bishop 2006,
//! 3.3; recursion: Ljung 1999, 11.2):
//!
//! ```text
//! nu = lambda + phiᵀ P phi,   g = P phi / nu,   w_j += g (y_j - w_jᵀ phi),   P -= nu g gᵀ
//! s_j = (sum of (y_j - w_jᵀ phi)^2 / nu, each before its update) / (number of data)
//! ```
//!
//! Besides the mean, samples of the posterior are carried along with the same gain, one for exploration, and others to
//! tell how certain a prediction is: they see the outputs with noise drawn for them (Matheron's rule). What is kept is
//! the deviation of each from the mean over `sqrt s_j`, `delta_j -= g (phiᵀ delta_j + sqrt lambda epsilon)`.

use super::linalg::{add_outer, add_scaled, dot, multiply_symmetric, packed};
use crate::state::{Persist, StateVisitor};

/// The posterior of the weights of all outputs of a model.
#[derive(Debug, Clone)]
pub struct Regression {
    /// Number of features.
    pub len: usize,
    /// Number of outputs.
    pub outputs: usize,
    /// Noise as a part of the prior's scale.
    pub lambda: f64,
    /// `P`, packed.
    pub covariance: Vec<f64>,
    /// Mean weights, by output, then feature.
    pub weights: Vec<f64>,
    /// The mean weights before the last doubt, if there was one since these features are in use.
    before_doubt: Vec<f64>,
    doubted: bool,
    /// Number of samples of each output.
    pub samples: usize,
    /// Deviations of the samples of the weights, over the root of the output's scale; by sample, output, feature.
    pub deviation: Vec<f64>,
    /// Sum of the normalised squared errors of each output, and their number.
    pub squares: Vec<f64>,
    /// Number of data behind `squares`.
    pub count: f64,
    /// `P phi` of the last point.
    gain: Vec<f64>,
    nu: f64,
    /// Noise of the last point.
    noise: f64,
}

impl Regression {
    /// The prior.
    pub fn new(len: usize, outputs: usize, samples: usize, lambda: f64) -> Self {
        let mut regression = Self {
            len,
            outputs,
            lambda,
            covariance: vec![0.0; packed(len)],
            weights: vec![0.0; len * outputs],
            before_doubt: vec![0.0; len * outputs],
            doubted: false,
            samples,
            deviation: vec![0.0; len * outputs * samples],
            squares: vec![0.0; outputs],
            count: 0.0,
            gain: vec![0.0; len],
            nu: 1.0,
            noise: lambda,
        };
        for r in 0..len {
            regression.covariance[packed(r) + r] = 1.0;
        }
        regression
    }

    /// Back to the prior; `normal` draws the sample.
    pub fn forget(&mut self, mut normal: impl FnMut() -> f64) {
        self.covariance.fill(0.0);
        for r in 0..self.len {
            self.covariance[packed(r) + r] = 1.0;
        }
        self.weights.fill(0.0);
        self.doubted = false;
        self.deviation.iter_mut().for_each(|w| *w = normal());
        self.squares.fill(0.0);
        self.count = 0.0;
    }

    /// The predictions of all outputs.
    pub fn predict(&self, phi: &[f64], out: &mut [f64]) {
        for (y, w) in out.iter_mut().zip(self.weights.chunks_exact(self.len)) {
            *y = dot(w, phi);
        }
    }

    /// What the weights from before the last doubt predict of the first output; `None` without a doubt.
    pub fn predict_undoubted(&self, phi: &[f64]) -> Option<f64> {
        self.doubted.then(|| dot(&self.before_doubt[..self.len], phi))
    }

    /// Begins with features that are not doubted.
    pub fn trust(&mut self) {
        self.doubted = false;
    }

    /// The scale `s_j` of an output.
    pub fn scale(&self, output: usize) -> f64 {
        ((self.squares[output] + 1e-12) / (self.count + 1.0)).max(1e-14)
    }

    /// Whether an output has ever differed from 0 by more than rounding.
    pub fn moves(&self, output: usize) -> bool {
        self.scale(output) > 1e-9
    }

    /// What is observed counts less from now on, until the next point: its noise is larger by the factor `noisier`.
    pub fn discount(&mut self, noisier: f64) {
        self.nu += (noisier - 1.0) * self.lambda;
        self.noise = noisier * self.lambda;
    }

    /// Prepares an update with `phi`: the gain, and the returned `nu`, by which `scale` is the predictive variance.
    pub fn prepare(&mut self, phi: &[f64]) -> f64 {
        multiply_symmetric(&self.covariance, phi, &mut self.gain);
        self.noise = self.lambda;
        self.nu = self.lambda + dot(phi, &self.gain).max(0.0);
        self.nu
    }

    /// Updates with the point that was prepared; `errors` are the outputs less their predictions, 0 for an output
    /// that teaches nothing. `normal` draws for the sample.
    pub fn update(&mut self, phi: &[f64], errors: &[f64], mut normal: impl FnMut() -> f64) {
        let nu = self.nu;
        for (j, error) in errors.iter().enumerate() {
            let w = &mut self.weights[j * self.len..(j + 1) * self.len];
            add_scaled(w, error / nu, &self.gain);
            self.squares[j] += error * error / nu;
        }
        for deviation in self.deviation.chunks_exact_mut(self.len) {
            let apart = dot(deviation, phi) + self.noise.sqrt() * normal();
            add_scaled(deviation, -apart / nu, &self.gain);
        }
        self.count += 1.0;
        add_outer(&mut self.covariance, -1.0 / nu, &self.gain);
    }

    /// The noise that explains the residuals (MacKay 1992): with `gamma = F - tr P` weights that the data determine,
    /// `lambda = (sum of squared residuals / (N - gamma)) / (|w|^2 / gamma)`, as the geometric mean over
    /// the outputs that move.
    pub fn evident_noise(&self) -> Option<f64> {
        let mut determined = self.len as f64;
        for r in 0..self.len {
            determined -= self.covariance[packed(r) + r].min(1.0);
        }
        let free = (self.count - determined).max(0.05 * self.count);
        let (mut sum, mut counted) = (0.0, 0.0);
        for j in 0..self.outputs {
            let w = &self.weights[j * self.len..(j + 1) * self.len];
            let square = dot(w, w);
            if self.moves(j) && square > 0.0 {
                let residuals = self.lambda * (self.squares[j] - square).max(0.0);
                sum += libm::log(residuals / free / square * determined + 1e-12);
                counted += 1.0;
            }
        }
        (counted > 0.0).then(|| libm::exp(sum / counted))
    }

    /// Operations of a tick's update, whose matrix has to come from memory.
    pub fn cost(&self) -> u64 {
        (4 * self.len * self.len + 8 * self.len * self.outputs) as u64
    }

    /// Operations of one update of many in a row, which take half as long.
    pub fn cost_in_row(&self) -> u64 {
        self.cost() / 2
    }

    /// Makes the posterior less certain: covariance and noise grow by these factors, so that new data count more and
    /// surprise less. What the data never determined stays as uncertain as its prior.
    pub fn doubt(&mut self, covariance: f64, noise: f64) {
        if !std::mem::replace(&mut self.doubted, true) {
            self.before_doubt.copy_from_slice(&self.weights);
        }
        let root = covariance.sqrt();
        self.deviation.iter_mut().for_each(|w| *w *= root);
        self.covariance.iter_mut().for_each(|p| *p *= covariance);
        self.lambda *= noise;
        // No direction may become less certain than the prior: rows and columns are scaled back.
        for r in 0..self.len {
            let variance = self.covariance[packed(r) + r];
            if variance > 1.0 {
                let factor = 1.0 / variance.sqrt();
                self.covariance[packed(r)..packed(r + 1)].iter_mut().for_each(|p| *p *= factor);
                for below in r..self.len {
                    self.covariance[packed(below) + r] *= factor;
                }
                for deviation in self.deviation.chunks_exact_mut(self.len) {
                    deviation[r] *= factor;
                }
            }
        }
    }
}

impl Persist for Regression {
    fn visit_state(&mut self, visitor: &mut dyn StateVisitor) {
        visitor.number("lambda", &mut self.lambda);
        visitor.numbers("covariance", &mut self.covariance);
        visitor.numbers("weights", &mut self.weights);
        visitor.numbers("before_doubt", &mut self.before_doubt);
        visitor.boolean("doubted", &mut self.doubted);
        visitor.numbers("deviation", &mut self.deviation);
        visitor.numbers("squares", &mut self.squares);
        visitor.number("count", &mut self.count);
    }
}
