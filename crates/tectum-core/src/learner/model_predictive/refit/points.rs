//! What a refit is made from: ticks as they are read, which of them are the points of the evidence, and how much each
//! counts.

use rand::RngExt as _;

use super::super::layout::Layout;
use super::super::memory::{Data, Lesson};
use super::super::model::{MAX_MODEL_OUTPUTS, ModelFit};
use super::super::spread::spread_out;
use super::{Phase, Refit, RefitSource};
use crate::seed::Rng;

/// The part of the points that are spread out.
const SPREAD: f64 = 0.7;

impl Refit {
    /// Reads a tick into `q` and `y`, with what it does not teach filled in by `fit`. Returns whether it teaches.
    pub(super) fn read(&mut self, source: &mut RefitSource, tick: u64) -> bool {
        let RefitSource { layout, fit, data, basis, phi } = source;
        let outputs = fit.regression.outputs;
        let Some(lesson) = data.get(tick, &mut self.q, &mut self.y[..outputs]) else { return false };
        self.contact = lesson.contact;
        if self.is_robust() {
            fit.features.evaluate(layout, &self.q, basis, phi);
            let mut predicted = [0.0];
            fit.regression.predict(phi, &mut predicted);
            let error = (self.y[0] - fit.center) / fit.scale - predicted[0];
            self.surprise = error * error / (fit.regression.prepare(phi) * fit.regression.scale(0));
        }
        if lesson.missing | lesson.upper_end | lesson.lower_end != 0 {
            fit.features.evaluate(layout, &self.q, basis, phi);
            let mut predicted = [0.0; MAX_MODEL_OUTPUTS];
            fit.regression.predict(phi, &mut predicted[..outputs]);
            for j in 0..outputs {
                let value = fit.center + fit.scale * predicted[j];
                self.y[j] = value + lesson.heed(j, self.y[j] - value);
            }
        }
        true
    }

    /// Operations of choosing the points: each that is spread out is compared with all ticks, and what the model in use
    /// finds strange takes its covariance.
    pub(super) fn cost_of_points(&self, source: &RefitSource) -> u64 {
        let (first, end) = source.data.range();
        let (ticks, len) = (end - first, source.fit.regression.len as u64);
        let wanted = ticks.min(self.settings.points as u64);
        let each = if self.is_robust() { len * (len + 1) } else { len };
        let compared = if self.settings.spread { 2 * wanted * source.layout.components as u64 } else { 0 };
        wanted * each + ticks * compared
    }

    pub(super) fn choose_points(&mut self, source: &mut RefitSource, rng: &mut Rng) -> u64 {
        let cost = self.cost_of_points(source);
        let RefitSource { layout, fit, data, .. } = &*source;
        let (first, end) = data.range();
        self.range = [first, end];
        self.next.features.scales.copy_from_slice(&fit.features.scales);
        self.evidence.restart(&fit.features.scales);
        self.standardise(fit, *data);
        let outputs = fit.regression.outputs;
        let wanted = self.settings.points.min((end - first) as usize);
        self.strange.clear();
        let spread = if self.settings.spread { self.spread_out(layout, fit, *data, wanted) } else { 0 };
        // Of what is not chosen yet the newest third, and of the others as many as are needed, each with equal chance.
        let newest = if self.settings.spread { 0 } else { (wanted / 3) as u64 };
        let mut needed = wanted as u64 - newest - spread.min(wanted as u64);
        let mut left = end - first - newest - spread;
        for tick in first..end {
            let is_chosen = self.settings.spread && self.least[(tick - first) as usize] < 0.0;
            let take = if is_chosen || tick >= end - newest {
                true
            } else {
                let take = rng.random_range(0..left) < needed;
                left -= 1;
                needed -= u64::from(take);
                take
            };
            if take && self.read(source, tick) {
                for y in &mut self.y[..outputs] {
                    *y = (*y - self.next.center) / self.next.scale;
                }
                self.evidence.push(&self.q, &self.y[..outputs], 1.0);
                let sign = if self.contact { -1.0 } else { 1.0 };
                self.evidence.set_noisier(self.evidence.len - 1, sign * self.surprise);
                if !self.contact {
                    self.strange.push(self.surprise);
                }
            }
        }
        self.weigh_points();
        self.enter(if self.evidence.len < 8 { Phase::Idle } else { Phase::Ascend });
        cost
    }

    /// Chooses most of the `wanted` points, far from each other over the components of all units. Marks them by a
    /// negative distance in `least`, and returns their number.
    fn spread_out(&mut self, layout: &Layout, fit: &ModelFit, data: &dyn Data, wanted: usize) -> u64 {
        let [first, end] = self.range;
        let (ticks, width, outputs) = ((end - first) as usize, layout.components, fit.regression.outputs);
        for k in 0..ticks {
            // What teaches nothing is as near as can be.
            self.least[k] = 0.0;
            if data.get(first + k as u64, &mut self.q, &mut self.y[..outputs]).is_some() {
                self.least[k] = f64::INFINITY;
                let e = &mut self.looks[k * width..(k + 1) * width];
                layout.components(&fit.features.frequencies, &self.q, e, None);
            }
        }
        spread_out(&self.looks, width, &mut self.least[..ticks], (SPREAD * wanted as f64) as u64)
    }

    /// How strange the points are, compared with half of them.
    fn weigh_points(&mut self) {
        self.strange.sort_unstable_by(f64::total_cmp);
        // Half of the squares of normal numbers are below 0.45.
        self.usual = self.strange.get(self.strange.len() / 2).map_or(1.0, |median| (median / 0.45).max(1e-3));
        for point in 0..self.evidence.len {
            let surprise = self.evidence.noisier(point);
            (self.contact, self.surprise) = (surprise.is_sign_negative(), surprise.abs());
            self.evidence.set_noisier(point, self.noisier());
        }
    }

    /// By which factor the noise of the tick that was read is larger.
    pub(super) fn noisier(&self) -> f64 {
        let lesson = Lesson { contact: self.contact, ..Lesson::default() };
        match self.settings.robust {
            false => 1.0,
            true if self.is_robust() => lesson.noisier(self.surprise / self.usual),
            true => lesson.noisier(1.0),
        }
    }

    /// Centre and scale of the outputs from now on.
    fn standardise(&mut self, fit: &ModelFit, data: &dyn Data) {
        (self.next.center, self.next.scale) = (0.0, 1.0);
        if !self.settings.standardise {
            return;
        }
        let (mut count, mut sum, mut squares) = (0.0, 0.0, 0.0);
        let outputs = fit.regression.outputs;
        for tick in self.range[0]..self.range[1] {
            if data.get(tick, &mut self.q, &mut self.y[..outputs]).is_some() {
                count += 1.0;
                let y = self.y[0] - fit.center;
                sum += y;
                squares += y * y;
            }
        }
        let mean = sum / f64::max(count, 1.0);
        let variance = squares / f64::max(count, 1.0) - mean * mean;
        self.next.center = fit.center + mean;
        self.next.scale = if variance > 0.0 { variance.sqrt() } else { fit.scale };
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::learner::model_predictive::layout::Priors;
    use crate::learner::model_predictive::model::{Model, ModelSize};
    use crate::learner::model_predictive::operations::RefitShare;
    use crate::learner::model_predictive::refit::RefitSettings;
    use crate::seed::stream;

    /// An input that stands at 0.5 in nine of ten ticks, as an arm mostly stands at its target.
    struct MostlyStill;

    impl Data for MostlyStill {
        fn range(&self) -> (u64, u64) {
            (0, 200)
        }

        fn get(&self, tick: u64, q: &mut [f64], y: &mut [f64]) -> Option<Lesson> {
            q[0] = if tick.is_multiple_of(10) { tick as f64 / 200.0 - 0.7 } else { 0.5 };
            y[0] = q[0] * q[0];
            Some(Lesson::default())
        }
    }

    #[test]
    fn points_that_are_spread_out_have_what_is_rare() {
        let rare = |spread: bool| {
            let mut layout = Layout::new(1, [1.0, 0.3, 0.3, 0.3, 0.3, 1e-4]);
            layout.number(0, Some(0), Priors { linear: 0.3, square: 0.3, product: 0.3, smooth: 0.3 });
            let settings = RefitSettings {
                points: 20,
                steps: 2,
                extra_steps: 0,
                step: 0.25,
                width: 2.5,
                noise_floor: 1e-7,
                standardise: true,
                robust: false,
                spread,
                memory: 200,
            };
            let rng = &mut stream(1, "test");
            let mut model =
                Model::new(layout, ModelSize { outputs: 1, pairs: 4, products: 0, samples: 1 }, settings, rng);
            model.refit.begin();
            model.work(&MostlyStill, &mut RefitShare::default(), rng);
            let mut q = [0.0];
            let of = |point: usize| {
                model.refit.evidence.point(point, &mut q);
                u32::from(q[0] != 0.5)
            };
            assert_eq!(model.refit.evidence.len, 20);
            (0..20).map(of).sum::<u32>()
        };
        assert!(rare(true) >= 13 && rare(false) <= 6, "{} {}", rare(true), rare(false));
    }
}
