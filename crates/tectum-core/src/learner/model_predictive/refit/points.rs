//! What a refit is made from: ticks as they are read, which of them are the points of the evidence, and how much each
//! counts.

use rand::RngExt as _;

use super::super::features::BasisValues;
use super::super::layout::Layout;
use super::super::memory::{Data, Lesson};
use super::super::model::{MAX_MODEL_OUTPUTS, ModelFit};
use super::{Phase, Refit};
use crate::seed::Rng;

impl Refit {
    /// Reads a tick into `q` and `y`, with what it does not teach filled in by `fit`. Returns whether it teaches.
    pub(super) fn read(
        &mut self,
        layout: &Layout,
        fit: &mut ModelFit,
        data: &dyn Data,
        tick: u64,
        basis: &mut BasisValues,
        phi: &mut [f64],
    ) -> bool {
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

    pub(super) fn choose_points(
        &mut self,
        layout: &Layout,
        fit: &mut ModelFit,
        data: &dyn Data,
        basis: &mut BasisValues,
        phi: &mut [f64],
        rng: &mut Rng,
    ) -> u64 {
        let (first, end) = data.range();
        self.range = [first, end];
        self.next.features.scales.copy_from_slice(&fit.features.scales);
        self.evidence.restart(&fit.features.scales);
        self.standardise(fit, data);
        let wanted = self.settings.points.min((end - first) as usize);
        let newest = (wanted / 3) as u64;
        let outputs = fit.regression.outputs;
        self.strange.clear();
        // The newest third; of the others as many as are needed, each with equal chance.
        let (mut left, mut needed) = (end - first - newest, wanted as u64 - newest);
        for tick in first..end {
            let take = if tick >= end - newest {
                true
            } else {
                let take = rng.random_range(0..left) < needed;
                left -= 1;
                needed -= u64::from(take);
                take
            };
            if take && self.read(layout, fit, data, tick, basis, phi) {
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
        (wanted * fit.regression.len) as u64
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
