//! A learned model: features, the posterior of their weights, and the refit that renews both.

use super::features::{BasisValues, ModelFeatures};
use super::layout::{Layout, NOISE};
use super::memory::{Data, Lesson};
use super::operations::RefitShare;
use super::refit::{Refit, RefitSettings, RefitSource};
use super::regression::Regression;
use super::weighted::Weighted;
use crate::seed::Rng;
use crate::state::{Persist, StateVisitor};

/// Most outputs of a model.
pub const MAX_MODEL_OUTPUTS: usize = crate::MAX_INPUTS;

/// What is fitted: exchanged as a whole when a refit is done.
#[derive(Debug, Clone)]
pub struct ModelFit {
    /// The features.
    pub features: ModelFeatures,
    /// The posterior.
    pub regression: Regression,
    /// Outputs are `(y - center) / scale`.
    pub center: f64,
    /// See `center`.
    pub scale: f64,
}

/// Most samples of a posterior.
const MAX_SAMPLES: usize = 8;

/// A model of some outputs.
#[derive(Debug, Clone)]
pub struct Model {
    /// What it looks at.
    pub layout: Layout,
    /// The fit that predicts.
    pub fit: ModelFit,
    /// The work on the next one.
    pub refit: Refit,
    /// The planner's function.
    pub weighted: Weighted,
    /// How samples of the posterior differ from its mean: as many outputs as there are samples for it.
    pub spread: Weighted,
    basis: BasisValues,
    phi: Vec<f64>,
    /// Predictions for the last point.
    pub predicted: [f64; MAX_MODEL_OUTPUTS],
    /// `nu` of the last point.
    pub nu: f64,
}

/// Sizes of a model.
#[derive(Debug, Clone, Copy)]
pub struct ModelSize {
    /// Outputs.
    pub outputs: usize,
    /// Fourier pairs.
    pub pairs: usize,
    /// Most products.
    pub products: usize,
    /// Samples of the posterior: one for exploration, the others for the certainty of predictions.
    pub samples: usize,
}

impl ModelSize {
    /// As many products of `layout` as there are, at most `products`, and Fourier pairs, from 30 to 200, so that there
    /// are about `features` features.
    pub fn within(layout: &Layout, outputs: usize, products: usize, features: usize) -> Self {
        let mut all = 1.0;
        for group in &layout.groups {
            let components = group.iter().map(|&u| if layout.units[u].circle { 2.0 } else { 1.0 }).sum::<f64>();
            all *= 1.0 + components;
        }
        let single = 1 + layout.components;
        let products = (f64::min(all, 1e6) as usize).saturating_sub(single).min(products);
        let left = features.saturating_sub(products + single + layout.units.len());
        Self { outputs, pairs: (left / 2).clamp(30, 200), products, samples: 1 }
    }
}

/// Ticks by which an accuracy is measured.
pub const SAMPLE: u64 = 100;

/// How well a fit predicts some ticks, in its units.
#[derive(Debug, Clone, Copy)]
pub struct Accuracy {
    /// Mean square of the output.
    pub square: f64,
    /// Variance of the output.
    pub variance: f64,
    /// Mean squared error.
    pub error: f64,
    /// The same of the weights from before an alarm, if there was one.
    pub undoubted: Option<f64>,
}

impl Accuracy {
    /// Variances below this one are rounding.
    const STILL: f64 = 1e-8;

    /// Whether a fit with this accuracy on new ticks, and another on `older` ones, has learned a world in which the
    /// older ones did not happen. A fit that has adapted to a few strange ticks leaves older ones unexplained as well:
    /// if the weights from before explain the new ticks, or a refit has replaced them, nothing is another. `alarmed` is
    /// whether this output's alarm began the new ticks.
    pub fn leaves_behind(&self, older: &Self, alarmed: bool) -> bool {
        if older.variance <= Self::STILL {
            return false;
        }
        // An output that no longer moves, as that of a blocked joint, teaches slowly: commands for it are small, and a
        // fit that has hardly adapted still explains the older ticks. That it should have moved is enough; where a
        // refit has replaced the weights from before, the alarm tells it.
        if self.square <= Self::STILL.max(1e-3 * older.variance) {
            return self.undoubted.map_or(alarmed, |error| error > 0.02 * older.variance);
        }
        let most = 0.1 * self.variance;
        let as_before = self.undoubted.is_none_or(|error| error < 3.0 * most);
        self.error < most && older.error > 0.3 * older.variance && !as_before
    }
}

impl Model {
    /// A model that knows nothing.
    pub fn new(layout: Layout, size: ModelSize, settings: RefitSettings, rng: &mut Rng) -> Self {
        let features = ModelFeatures::new(&layout, size.pairs, size.products, || normal(rng));
        let lambda = super::functions::exp(layout.prior[NOISE]);
        let regression = Regression::new(features.len, size.outputs, size.samples, lambda);
        let mut fit = ModelFit { features, regression, center: 0.0, scale: 1.0 };
        fit.regression.forget(|| normal(rng));
        let weighted = Weighted::new(&layout, &fit.features, size.outputs);
        let spread = Weighted::new(&layout, &fit.features, size.samples - 1);
        let basis = BasisValues::new(&layout, &fit.features);
        let phi = vec![0.0; fit.features.len];
        let refit = Refit::new(&layout, &fit, settings);
        Self { layout, fit, refit, weighted, spread, basis, phi, predicted: [0.0; MAX_MODEL_OUTPUTS], nu: 1.0 }
    }

    /// Back to the prior.
    pub fn forget(&mut self, rng: &mut Rng) {
        let Self { layout, fit, .. } = self;
        fit.features.scales.copy_from_slice(&layout.prior);
        fit.features.build(layout);
        fit.regression.forget(|| normal(rng));
    }

    /// Number of outputs.
    pub fn outputs(&self) -> usize {
        self.fit.regression.outputs
    }

    /// Predicts at `q` and prepares to learn there.
    pub fn observe(&mut self, q: &[f64]) {
        let outputs = self.outputs();
        self.fit.features.evaluate(&self.layout, q, &mut self.basis, &mut self.phi);
        self.fit.regression.predict(&self.phi, &mut self.predicted[..outputs]);
        self.nu = self.fit.regression.prepare(&self.phi);
    }

    /// The observed `y` of an output less its prediction, in the fit's units.
    pub fn error(&self, output: usize, y: f64) -> f64 {
        (y - self.fit.center) / self.fit.scale - self.predicted[output]
    }

    /// The squared error of an output, divided by its predictive variance.
    pub fn surprise(&self, output: usize, y: f64) -> f64 {
        let error = self.error(output, y);
        error * error / (self.nu * self.fit.regression.scale(output))
    }

    /// Learns the outputs at the point that was observed.
    pub fn learn(&mut self, y: &[f64], lesson: Lesson, rng: &mut Rng) {
        let mut errors = [0.0; MAX_MODEL_OUTPUTS];
        for (j, error) in errors.iter_mut().enumerate().take(self.outputs()) {
            *error = lesson.heed(j, self.error(j, y[j]));
        }
        let outputs = self.outputs();
        if self.refit.is_robust() && outputs == 1 {
            self.fit.regression.discount(lesson.noisier(self.surprise(0, y[0])));
        }
        self.fit.regression.update(&self.phi, &errors[..outputs], || normal(rng));
    }

    /// How well the fit of a single output predicts the ticks from `first` to `end`, by about [`SAMPLE`] of them.
    /// `None` where fewer than 20 teach.
    pub fn accuracy(&mut self, data: &dyn Data, first: u64, end: u64, q: &mut [f64]) -> Option<Accuracy> {
        let step = (end.saturating_sub(first) / SAMPLE).max(1) as usize;
        let (mut y, mut sums, mut undoubted) = ([0.0], [0.0; 4], Some(0.0));
        for tick in (first..end).step_by(step) {
            let Some(lesson) = data.get(tick, q, &mut y) else { continue };
            if lesson.missing & 1 == 0 {
                self.fit.features.evaluate(&self.layout, q, &mut self.basis, &mut self.phi);
                self.fit.regression.predict(&self.phi, &mut self.predicted[..1]);
                let error = lesson.heed(0, self.error(0, y[0]));
                let value = (y[0] - self.fit.center) / self.fit.scale;
                let before = self.fit.regression.predict_undoubted(&self.phi);
                undoubted = undoubted.zip(before).map(|(sum, y)| sum + lesson.heed(0, value - y).powi(2));
                for (sum, x) in sums.iter_mut().zip([1.0, value, value * value, error * error]) {
                    *sum += x;
                }
            }
        }
        let [count, sum, squares, errors] = sums;
        (count >= 20.0).then(|| Accuracy {
            square: squares / count,
            variance: (squares - sum * sum / count) / count,
            error: errors / count,
            undoubted: undoubted.map(|sum| sum / count),
        })
    }

    /// The planner's function from now on: the mean and a part of what the sample differs.
    pub fn take(&mut self, part: f64) {
        let ModelFit { features, regression, .. } = &self.fit;
        self.weighted.take(&self.layout, features, regression, part);
        if regression.samples > 1 {
            self.spread.take_spread(&self.layout, features, regression);
        }
    }

    /// Mean square of what the samples differ from the mean, at the last point of the planner's function.
    pub fn variance(&self) -> f64 {
        let mut apart = [0.0; MAX_SAMPLES];
        let apart = &mut apart[..self.fit.regression.samples - 1];
        self.spread.value_beside(&self.weighted, &self.layout, &self.fit.features, apart);
        apart.iter().map(|x| x * x).sum::<f64>() / (apart.len() as f64).max(1.0)
    }

    /// Works on the refit as far as the tick's share goes. Returns whether a new fit is in use.
    pub fn work(&mut self, data: &dyn Data, share: &mut RefitShare, rng: &mut Rng) -> bool {
        let Self { layout, fit, refit, basis, phi, .. } = self;
        let mut source = RefitSource { layout, fit, data, basis, phi };
        while refit.busy() && share.takes(refit.next_cost(&source)) {
            let (cost, finished) = refit.step(&mut source, rng);
            share.done += cost;
            if finished {
                return true;
            }
        }
        false
    }
}

impl Lesson {
    /// By which factor the noise of the tick is larger, given its squared error in predictive variances.
    pub fn noisier(&self, surprise: f64) -> f64 {
        if self.contact { CONTACT * noisier(surprise / CONTACT) } else { noisier(surprise) }
    }

    /// The error that counts: 0 where the output teaches nothing, or where a prediction went beyond the end at which
    /// the input stopped.
    pub fn heed(&self, output: usize, error: f64) -> f64 {
        let bit = 1 << output;
        let ignored = self.missing & bit != 0
            || (self.upper_end & bit != 0 && error < 0.0)
            || (self.lower_end & bit != 0 && error > 0.0);
        if ignored { 0.0 } else { error }
    }
}

/// By which factor the noise is larger where an input is at an end of its range.
pub const CONTACT: f64 = 100.0;

/// By which factor the noise of a point is larger, given its squared error in predictive variances: noise is taken to
/// follow Student's t distribution with four degrees of freedom (Lange, Little & Taylor 1989).
pub fn noisier(surprise: f64) -> f64 {
    ((4.0 + surprise.min(1e6)) / 5.0).max(1.0)
}

/// A draw from the normal distribution.
pub fn normal(rng: &mut Rng) -> f64 {
    use rand_distr::{Distribution, StandardNormal};
    StandardNormal.sample(rng)
}

impl ModelFit {
    /// Passes on the state.
    pub fn visit(&mut self, layout: &Layout, visitor: &mut dyn StateVisitor) {
        self.features.visit_scales(layout, visitor);
        self.regression.visit_state(visitor);
        visitor.number("center", &mut self.center);
        visitor.number("scale", &mut self.scale);
    }
}

impl Persist for Model {
    fn visit_state(&mut self, visitor: &mut dyn StateVisitor) {
        self.fit.visit(&self.layout, visitor);
        self.refit.visit(&self.layout, visitor);
    }
}

#[cfg(test)]
mod tests {
    use super::Accuracy;

    const OLDER: Accuracy = Accuracy { square: 0.01, variance: 0.01, error: 2e-4, undoubted: Some(1e-6) };

    #[test]
    fn an_output_that_should_move_and_stands_still_is_in_another_world() {
        // The commands for it are small, so that the fit has hardly adapted.
        let blocked = Accuracy { square: 0.0, variance: 0.0, error: 1e-3, undoubted: Some(2e-3) };
        assert!(blocked.leaves_behind(&OLDER, true));
        let noisy = Accuracy { square: 5e-6, variance: 5e-6, ..blocked };
        assert!(noisy.leaves_behind(&OLDER, true), "a sensor's noise is no movement");
        let rests = Accuracy { undoubted: Some(1e-6), ..blocked };
        assert!(!rests.leaves_behind(&OLDER, true), "nothing was asked of it");
        let refitted = Accuracy { undoubted: None, ..blocked };
        assert!(refitted.leaves_behind(&OLDER, true) && !refitted.leaves_behind(&OLDER, false));
        let never_moved = Accuracy { square: 0.0, variance: 0.0, ..OLDER };
        assert!(!blocked.leaves_behind(&never_moved, true));
    }

    #[test]
    fn an_output_that_moves_otherwise_has_to_be_learned_first() {
        let learned = Accuracy { square: 0.01, variance: 0.01, error: 1e-4, undoubted: Some(0.02) };
        let unexplained = Accuracy { error: 0.02, ..OLDER };
        assert!(learned.leaves_behind(&unexplained, true));
        assert!(!learned.leaves_behind(&OLDER, true), "the new fit explains the older ticks as well");
        assert!(!Accuracy { error: 5e-3, ..learned }.leaves_behind(&unexplained, true));
        assert!(!Accuracy { undoubted: Some(1e-4), ..learned }.leaves_behind(&unexplained, true), "as before");
        assert!(!Accuracy { undoubted: None, ..learned }.leaves_behind(&unexplained, true), "a refit knows both");
    }
}
