//! The models of movement: one for each input, with its own scales, noise and covariance, so that an input that is hard
//! to predict, or stands at a stop, leaves the others as they are.
//!
//! An input that has not moved yet, as a target between two jumps, has no work: it is predicted to stay.

use super::config::ModelPredictiveSpec;
use super::dependents::Dependents;
use super::layout::Places;
use super::layouts::dynamics_layout;
use super::memory::{ChangeData, Lesson, Memory};
use super::model::{Model, ModelSize};
use super::operations::RefitShare;
use super::refit::RefitSettings;
use super::world::{CHANGE, Ranges};
use crate::MAX_INPUTS;
use crate::seed::Rng;
use crate::state::{Persist, StateVisitor};

/// Changes up to this size of an input that never moved are rounding.
const STILL: f64 = 1e-6;

/// The models of movement.
#[derive(Debug, Clone)]
pub struct Dynamics {
    /// One for each input.
    pub models: Vec<Model>,
    /// The inputs (bits) that have moved.
    pub moving: u32,
    /// The inputs that follow from others.
    pub dependents: Dependents,
    ranges: Ranges,
    /// `q` of the last tick, and what is to come of another.
    seen: Vec<f64>,
    next: Vec<f64>,
}

impl Dynamics {
    /// Models that know nothing.
    pub fn new(spec: &ModelPredictiveSpec, places: Places, settings: RefitSettings, rng: &mut Rng) -> Self {
        let layout = dynamics_layout(places, &spec.inputs);
        let config = &spec.config;
        let size = ModelSize::within(&layout, 1, config.dynamics_products, config.dynamics_features);
        let models = (0..places.inputs).map(|_| Model::new(layout.clone(), size, settings, rng)).collect();
        Self {
            models,
            moving: 0,
            dependents: Dependents::new(spec, places, settings),
            ranges: Ranges::of(&spec.inputs),
            seen: vec![0.0; places.len()],
            next: vec![0.0; places.len()],
        }
    }

    /// Whether input `i` has moved.
    pub fn moves(&self, i: usize) -> bool {
        self.moving & (1 << i) != 0
    }

    /// The models of the inputs that have moved.
    fn movers(&mut self) -> impl Iterator<Item = (usize, &mut Model)> {
        let moving = self.moving;
        self.models.iter_mut().enumerate().filter(move |(i, _)| moving & (1 << i) != 0)
    }

    /// Whether an input that moves by itself has a model that was fitted.
    pub fn is_fitted(&self, i: usize) -> bool {
        self.moves(i) && !self.dependents.follows(i) && self.models[i].refit.completed > 0
    }

    /// Predicts at `q` and prepares to learn there.
    pub fn observe(&mut self, q: &[f64]) {
        self.seen.copy_from_slice(q);
        self.movers().for_each(|(_, model)| model.observe(q));
    }

    /// Predicts the inputs that follow from others, by what these are after the tick.
    pub fn follow(&mut self, after: &[f64]) {
        self.dependents.observe(after);
    }

    /// The predicted change of an input.
    pub fn predicted(&self, i: usize) -> f64 {
        match self.moves(i) {
            true if self.dependents.follows(i) => (self.dependents.predicted(i) - self.seen[i]) / CHANGE,
            true => self.models[i].predicted[0],
            false => 0.0,
        }
    }

    /// An observed change less its prediction.
    pub fn error(&self, i: usize, change: f64) -> f64 {
        change - self.predicted(i)
    }

    /// The squared error in predictive variances.
    pub fn surprise(&self, i: usize, change: f64) -> f64 {
        match self.moves(i) {
            true if self.dependents.follows(i) => self.dependents.surprise(i, self.seen[i] + CHANGE * change),
            true => self.models[i].surprise(0, change),
            false if change.abs() <= STILL => 0.0,
            false => 1e6,
        }
    }

    /// Learns the changes at the point that was observed, and which inputs were `after` it.
    pub fn learn(&mut self, changes: &[f64], after: &[f64], lesson: Lesson, rng: &mut Rng) {
        let mut errors = [0.0; MAX_INPUTS];
        for (i, error) in errors.iter_mut().enumerate().take(changes.len()) {
            *error = changes[i] - if self.moves(i) { self.models[i].predicted[0] } else { 0.0 };
        }
        self.dependents.learn(&after[..changes.len()], changes, &errors[..changes.len()], lesson);
        let teaches = |i: usize| (lesson.missing | lesson.upper_end | lesson.lower_end) & (1 << i) == 0;
        for (i, model) in self.movers().filter(|(i, _)| teaches(*i)) {
            model.learn(&changes[i..=i], Lesson { contact: lesson.contact, ..Lesson::default() }, rng);
        }
    }

    /// Operations of learning from a tick.
    pub fn cost(&self) -> u64 {
        self.moving_models().chain(self.dependents.tried()).map(|model| model.fit.regression.cost()).sum()
    }

    /// The models of the inputs that have moved.
    pub fn moving_models(&self) -> impl Iterator<Item = &Model> {
        self.models.iter().enumerate().filter(|(i, _)| self.moves(*i)).map(|(_, model)| model)
    }

    /// The planner's functions from now on.
    pub fn take(&mut self, part: f64) {
        self.movers().for_each(|(_, model)| model.take(part));
        self.dependents.take();
    }

    /// Writes the changes at `q`.
    pub fn value(&mut self, q: &[f64], d: &mut [f64]) {
        d.fill(0.0);
        let following = self.dependents.following;
        for (i, Model { layout, fit, weighted, .. }) in self.movers().filter(|(i, _)| following >> i & 1 == 0) {
            weighted.value(layout, &fit.features, q, &mut d[i..=i]);
        }
        if following != 0 {
            self.predict_inputs(q, d);
            self.dependents.value(&q[..d.len()], &self.next, d);
        }
    }

    /// Writes the changes and their Jacobian, in rows of `q`'s length.
    pub fn jacobian(&mut self, q: &[f64], d: &mut [f64], jacobian: &mut [f64]) {
        d.fill(0.0);
        jacobian.fill(0.0);
        let (width, following) = (self.next.len(), self.dependents.following);
        for (i, Model { layout, fit, weighted, .. }) in self.movers().filter(|(i, _)| following >> i & 1 == 0) {
            let row = &mut jacobian[i * width..(i + 1) * width];
            weighted.jacobian(layout, &fit.features, q, &mut d[i..=i], row);
        }
        if following != 0 {
            self.predict_inputs(q, d);
            self.dependents.jacobian(&q[..d.len()], &self.next, d, jacobian);
        }
    }

    /// The inputs after `q` and changes `d`.
    fn predict_inputs(&mut self, q: &[f64], d: &[f64]) {
        for (i, d) in d.iter().enumerate() {
            self.next[i] = self.ranges.bring_in(i, q[i] + CHANGE * d);
        }
    }

    /// The models that predict the inputs that move: those of changes, and of what follows from others.
    pub fn models_in_use(&self) -> impl Iterator<Item = &Model> {
        let of_changes = self.models.iter().enumerate();
        let of_changes = of_changes.filter(|(i, _)| self.moves(*i) && !self.dependents.follows(*i));
        of_changes.map(|(_, model)| model).chain(self.dependents.in_use())
    }

    /// Ends of inputs were found or given up.
    pub fn set_ends(&mut self, ranges: &Ranges) {
        self.ranges.copy_ends(ranges);
    }

    /// Whether a refit is under way.
    pub fn busy(&self) -> bool {
        self.models.iter().any(|model| model.refit.busy()) || self.dependents.busy()
    }

    /// Begins refits.
    pub fn begin(&mut self) {
        self.movers().for_each(|(_, model)| model.refit.begin());
        self.dependents.begin(self.moving);
    }

    /// Whether all models have been fitted at least once.
    pub fn fitted(&mut self) -> bool {
        self.moving != 0 && self.movers().all(|(_, model)| model.refit.completed > 0)
    }

    /// Works on refits, as far as the tick's share goes.
    pub fn work(&mut self, memory: &Memory, share: &mut RefitShare, rng: &mut Rng) {
        for (i, model) in self.movers() {
            model.work(&ChangeData { memory, input: i }, share, rng);
        }
        self.dependents.work(memory, share);
    }

    /// Makes an input's model less certain.
    pub fn doubt(&mut self, i: usize) {
        self.models[i].fit.regression.doubt(1000.0, 30.0);
        self.dependents.doubt(i);
    }
}

impl Persist for Dynamics {
    fn visit_state(&mut self, visitor: &mut dyn StateVisitor) {
        visitor.number("moving", &mut self.moving);
        for model in &mut self.models {
            visitor.nested("input", model);
        }
        visitor.nested("dependents", &mut self.dependents);
    }
}
