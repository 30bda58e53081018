//! Inputs that follow from others, as the place of a hand follows from the angles of its joints:
//! `z_i' = h(z' of the others)`.
//!
//! A model of such an input's change has to learn how its slope depends on everything, and is wrong where nothing was
//! seen yet; `h` is smooth, knows no commands, and is often exact after few ticks. An input whose change is predicted
//! badly is tried as a function of those that are predicted well, or do not move, and follows from them once that
//! predicts better.

use super::config::ModelPredictiveSpec;
use super::layout::Places;
use super::layouts::dependent_layout;
use super::memory::{DependentData, Lesson, Memory};
use super::model::{Model, ModelSize};
use super::operations::RefitShare;
use super::refit::RefitSettings;
use super::world::CHANGE;
use crate::seed::{Rng, stream};
use crate::state::{Persist, StateVisitor};

/// A change is predicted badly if more than this part of its mean square is unexplained.
const POOR: f64 = 1e-4;
/// How much smaller the squared errors of one model must be than those of the other to take its place.
const BETTER: f64 = 0.25;
/// So many ticks are compared at least.
const COMPARED: f64 = 15.0;

/// What is compared of an input since the last refit: sums of squares.
#[derive(Debug, Clone, Copy, Default)]
struct Comparison {
    ticks: f64,
    /// Its changes.
    changes: f64,
    /// Errors of the model of its change.
    moved: f64,
    /// Errors of the model of what it follows from.
    followed: f64,
}

/// The models of inputs that may follow from others.
#[derive(Debug, Clone)]
pub struct Dependents {
    /// One for each input.
    models: Vec<Model>,
    /// The inputs (bits) that each is tried as a function of; 0 for one that is not tried.
    arguments: Vec<u32>,
    /// The inputs (bits) that follow from others.
    pub following: u32,
    comparisons: Vec<Comparison>,
    /// Inputs that come round: those that follow are numbers.
    wraps: u32,
    rng: Rng,
    slopes: Vec<f64>,
}

impl Dependents {
    /// Models that know nothing; no input is tried yet.
    pub fn new(spec: &ModelPredictiveSpec, places: Places, settings: RefitSettings) -> Self {
        let layout = dependent_layout(places, &spec.inputs);
        let rng = &mut stream(spec.seed, "dependents");
        let config = &spec.config;
        let size = ModelSize::within(&layout, 1, config.dynamics_products, config.dynamics_features);
        let settings = RefitSettings { standardise: true, spread: true, ..settings };
        let wraps = spec.inputs.iter().enumerate().filter(|(_, range)| range.wraps);
        Self {
            models: (0..places.inputs).map(|_| Model::new(layout.clone(), size, settings, rng)).collect(),
            arguments: vec![0; places.inputs],
            following: 0,
            comparisons: vec![Comparison::default(); places.inputs],
            wraps: wraps.fold(0, |bits, (i, _)| bits | 1 << i),
            rng: rng.clone(),
            slopes: vec![0.0; places.len()],
        }
    }

    /// Whether input `i` follows from others.
    pub fn follows(&self, i: usize) -> bool {
        self.following >> i & 1 == 1
    }

    /// The models that are tried or in use.
    pub fn tried(&self) -> impl Iterator<Item = &Model> {
        self.models.iter().zip(&self.arguments).filter(|(_, of)| **of != 0).map(|(model, _)| model)
    }

    /// The models in use.
    pub fn in_use(&self) -> impl Iterator<Item = &Model> {
        self.models.iter().enumerate().filter(|(i, _)| self.follows(*i)).map(|(_, model)| model)
    }

    fn tried_mut(&mut self) -> impl Iterator<Item = (usize, &mut Model)> {
        let tried = self.models.iter_mut().enumerate().zip(&self.arguments);
        tried.filter(|(_, of)| **of != 0).map(|(each, _)| each)
    }

    fn in_use_mut(&mut self) -> impl Iterator<Item = (usize, &mut Model)> {
        let following = self.following;
        self.models.iter_mut().enumerate().filter(move |(i, _)| following >> i & 1 == 1)
    }

    /// Predicts at the inputs of `q` and prepares to learn there.
    pub fn observe(&mut self, q: &[f64]) {
        self.tried_mut().for_each(|(_, model)| model.observe(q));
    }

    /// The predicted value of input `i`.
    pub fn predicted(&self, i: usize) -> f64 {
        let model = &self.models[i];
        model.fit.center + model.fit.scale * model.predicted[0]
    }

    /// The squared error of a value of input `i`, in predictive variances.
    pub fn surprise(&self, i: usize, z: f64) -> f64 {
        self.models[i].surprise(0, z)
    }

    /// Learns the values `z` of the inputs that teach, and compares with the `errors` of their predicted changes.
    pub fn learn(&mut self, z: &[f64], changes: &[f64], errors: &[f64], lesson: Lesson) {
        for i in (0..z.len()).filter(|i| lesson.missing >> i & 1 == 0) {
            let tried = self.arguments[i] != 0;
            if !lesson.contact {
                let followed = if tried { (z[i] - self.predicted(i)) / CHANGE } else { 0.0 };
                let Comparison { ticks, changes: sum, moved, followed: other } = &mut self.comparisons[i];
                *ticks += 1.0;
                *sum += changes[i] * changes[i];
                *moved += errors[i] * errors[i];
                *other += followed * followed;
            }
            if tried && lesson.missing == 0 {
                self.models[i].learn(&z[i..=i], Lesson::default(), &mut self.rng);
            }
        }
    }

    /// Makes an input's model less certain.
    pub fn doubt(&mut self, i: usize) {
        self.models[i].fit.regression.doubt(1000.0, 30.0);
    }

    /// Decides which of the `moving` inputs follow from others, and which are tried, and begins refits of both.
    pub fn begin(&mut self, moving: u32) {
        let mut compared = true;
        for (i, Comparison { ticks, moved, followed, .. }) in self.comparisons.iter().enumerate() {
            compared &= *ticks >= COMPARED || moving >> i & 1 == 0;
            if *ticks < COMPARED || self.arguments[i] == 0 || self.models[i].refit.completed == 0 {
                continue;
            }
            if *followed < BETTER * moved {
                self.following |= 1 << i;
            } else if *moved < BETTER * followed {
                self.following &= !(1 << i);
            }
        }
        if compared {
            self.choose(moving);
        }
        self.comparisons.fill(Comparison::default());
        self.tried_mut().for_each(|(_, model)| model.refit.begin());
    }

    /// Chooses the inputs that are tried, and of which others. None that others follow from follows itself.
    fn choose(&mut self, moving: u32) {
        let poor = |(i, of): (usize, &Comparison)| u32::from(of.moved > POOR * of.changes) << i;
        let poor = self.comparisons.iter().enumerate().map(poor).fold(0, |bits, bit| bits | bit) & moving;
        let others = !(poor | self.following) & ((1 << self.models.len()) - 1);
        let used = (0..self.models.len()).filter(|i| self.follows(*i));
        let used = used.fold(0, |bits, i| bits | self.arguments[i]);
        for i in (0..self.models.len()).filter(|i| self.following >> i & 1 == 0) {
            let tried = (poor & !used & !self.wraps) >> i & 1 == 1;
            let of = if tried { others } else { 0 };
            if of != self.arguments[i] {
                self.arguments[i] = of;
                self.models[i].layout.show_only(of);
                self.models[i].forget(&mut self.rng);
            }
        }
    }

    /// Works on refits, as far as the tick's share goes.
    pub fn work(&mut self, memory: &Memory, share: &mut RefitShare) {
        for (i, of) in self.arguments.iter().enumerate() {
            if *of != 0 {
                self.models[i].work(&DependentData { memory, input: i }, share, &mut self.rng);
            }
        }
    }

    /// Whether a refit is under way.
    pub fn busy(&self) -> bool {
        self.tried().any(|model| model.refit.busy())
    }

    /// The planner's functions from now on.
    pub fn take(&mut self) {
        self.in_use_mut().for_each(|(_, model)| model.take(0.0));
    }

    /// Writes the changes of inputs that follow, from `z` to where those in `next` put them.
    pub fn value(&mut self, z: &[f64], next: &[f64], d: &mut [f64]) {
        for (i, Model { layout, fit, weighted, .. }) in self.in_use_mut() {
            let mut y = [0.0];
            weighted.value(layout, &fit.features, next, &mut y);
            d[i] = (fit.center + fit.scale * y[0] - z[i]) / CHANGE;
        }
    }

    /// The same with their slopes by all places of `q`, in rows of its length, where those of the others are.
    pub fn jacobian(&mut self, z: &[f64], next: &[f64], d: &mut [f64], jacobian: &mut [f64]) {
        let Self { models, following, slopes, arguments, .. } = self;
        let width = slopes.len();
        for (i, Model { layout, fit, weighted, .. }) in models.iter_mut().enumerate() {
            if *following >> i & 1 == 0 {
                continue;
            }
            let mut y = [0.0];
            weighted.jacobian(layout, &fit.features, next, &mut y, slopes);
            d[i] = (fit.center + fit.scale * y[0] - z[i]) / CHANGE;
            let (before, rest) = jacobian.split_at_mut(i * width);
            let (row, after) = rest.split_at_mut(width);
            row.fill(0.0);
            for k in (0..z.len()).filter(|k| arguments[i] >> k & 1 == 1) {
                // z_k' = z_k + CHANGE d_k.
                let slope = fit.scale * slopes[k];
                row[k] += slope / CHANGE;
                let of = if k < i { &before[k * width..] } else { &after[(k - i - 1) * width..] };
                super::linalg::add_scaled(row, slope, &of[..width]);
            }
            row[i] -= 1.0 / CHANGE;
        }
    }
}

impl Persist for Dependents {
    fn visit_state(&mut self, visitor: &mut dyn StateVisitor) {
        visitor.numbers("arguments", &mut self.arguments);
        visitor.number("following", &mut self.following);
        for of in &mut self.comparisons {
            let mut numbers = [of.ticks, of.changes, of.moved, of.followed];
            visitor.numbers("compared", &mut numbers);
            [of.ticks, of.changes, of.moved, of.followed] = numbers;
        }
        visitor.nested("rng", &mut self.rng);
        for (model, of) in self.models.iter_mut().zip(&self.arguments) {
            model.layout.show_only(*of);
            visitor.nested("dependent", model);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::config::{InputRange, ModelPredictiveConfig};
    use super::super::dynamics::Dynamics;
    use super::super::memory::Entry;
    use super::*;
    use rand::RngExt as _;

    const PLACES: Places = Places { inputs: 4, commands: 2 };

    fn spec() -> ModelPredictiveSpec {
        let range = InputRange { min: -1.0, max: 1.0, wraps: false, radians: None };
        ModelPredictiveSpec {
            inputs: vec![range; 4],
            limits: vec![1.0; 2],
            steps: vec![f64::INFINITY; 2],
            sigma: vec![0.1; 2],
            seed: 3,
            config: ModelPredictiveConfig { memory: 300, ..Default::default() },
        }
    }

    /// Two inputs that commands move, and `follow` of both in the places before and after them.
    fn inputs(a: f64, b: f64, follow: fn(f64, f64) -> [f64; 2]) -> [f64; 4] {
        let [first, last] = follow(a, b);
        [first, a, b, last]
    }

    /// The models of movement after some ticks of two inputs that are driven by noise.
    fn learned(follow: fn(f64, f64) -> [f64; 2], ticks: u64) -> Dynamics {
        let (spec, mut rng) = (spec(), stream(1, "test"));
        let settings = RefitSettings {
            points: 80,
            steps: 15,
            extra_steps: 50_000_000,
            step: 0.25,
            width: 2.5,
            noise_floor: 1e-7,
            standardise: false,
            robust: true,
            spread: false,
            memory: 300,
        };
        let mut dynamics = Dynamics::new(&spec, PLACES, settings, &mut rng);
        let mut memory = Memory::new(PLACES, 300);
        let (mut a, mut b) = (0.1, -0.2);
        let (mut q, mut after) = (vec![0.0; PLACES.len()], vec![0.0; PLACES.len()]);
        for tick in 0..ticks {
            q[..4].copy_from_slice(&inputs(a, b, follow));
            for j in 0..2 {
                q[PLACES.command(j, 0)] = rng.random_range(-1.0..1.0);
            }
            a = f64::clamp(a + 0.2 * q[PLACES.command(0, 0)], -0.9, 0.9);
            b = f64::clamp(b + 0.2 * q[PLACES.command(1, 0)], -0.9, 0.9);
            after.copy_from_slice(&q);
            after[..4].copy_from_slice(&inputs(a, b, follow));
            let changes: Vec<f64> = (0..4).map(|i| (after[i] - q[i]) / CHANGE).collect();
            dynamics.moving = 0b1111;
            dynamics.observe(&q);
            dynamics.follow(&after);
            let at_end = |x: f64, bit: u32| if x.abs() == 0.9 { bit } else { 0 };
            let upper_end = at_end(a, 0b0010) | at_end(b, 0b0100);
            let contact = [a, b, q[1], q[2]].iter().any(|x| x.abs() == 0.9);
            let lesson = Lesson { upper_end, contact, ..Lesson::default() };
            dynamics.learn(&changes, &after, lesson, &mut rng);
            let (reward, boundary) = (0.0, false);
            memory.push(&Entry { before: &q, after: &after, changes: &changes, reward, lesson, tick, boundary });
            if tick % 40 == 39 {
                dynamics.begin();
                dynamics.work(&memory, &mut RefitShare { most: u64::MAX, done: 0 }, &mut rng);
            }
        }
        dynamics
    }

    fn hills(a: f64, b: f64) -> [f64; 2] {
        [0.5 * libm::sin(9.0 * a) * b, 0.4 * libm::cos(8.0 * b) + 0.3 * a * a]
    }

    #[test]
    fn inputs_that_follow_from_others_are_found_and_predicted_better() {
        let mut dynamics = learned(hills, 280);
        assert_eq!(dynamics.dependents.following, 0b1001);
        // Not of each other.
        assert_eq!(dynamics.dependents.arguments, [0b0110, 0, 0, 0b0110]);
        dynamics.take(0.0);
        let mut largest = [0.0_f64; 2];
        let mut rng = stream(2, "test");
        for _ in 0..100 {
            let mut draw = || rng.random_range(-0.6..0.6);
            let (a, b, u) = (draw(), draw(), [draw(), draw()]);
            let (mut q, mut d) = (vec![0.0; PLACES.len()], [0.0; 4]);
            q[..4].copy_from_slice(&inputs(a, b, hills));
            q[PLACES.command(0, 0)] = u[0];
            q[PLACES.command(1, 0)] = u[1];
            dynamics.value(&q, &mut d);
            let expected = inputs(a + 0.2 * u[0], b + 0.2 * u[1], hills);
            for (largest, i) in largest.iter_mut().zip([0, 3]) {
                *largest = largest.max((q[i] + CHANGE * d[i] - expected[i]).abs());
            }
        }
        assert!(largest[0] < 0.05 && largest[1] < 0.05, "{largest:?}");
    }

    #[test]
    fn slopes_of_inputs_that_follow_are_those_of_their_values() {
        let mut dynamics = learned(hills, 200);
        assert_eq!(dynamics.dependents.following, 0b1001);
        dynamics.take(0.0);
        let mut q: Vec<f64> = (0..PLACES.len()).map(|k| 0.3 * libm::sin(3.0 * k as f64)).collect();
        let (mut d, mut jacobian) = ([0.0; 4], vec![0.0; 4 * PLACES.len()]);
        dynamics.jacobian(&q, &mut d, &mut jacobian);
        for at in 0..PLACES.len() {
            let (mut up, mut down) = ([0.0; 4], [0.0; 4]);
            q[at] += 1e-5;
            dynamics.value(&q, &mut up);
            q[at] -= 2e-5;
            dynamics.value(&q, &mut down);
            q[at] += 1e-5;
            for i in 0..4 {
                let (slope, expected) = (jacobian[i * PLACES.len() + at], (up[i] - down[i]) / 2e-5);
                assert!((slope - expected).abs() < 1e-5 * (1.0 + expected.abs()), "{i} {at}: {slope} {expected}");
            }
        }
    }

    #[test]
    fn an_input_whose_change_is_known_follows_from_no_other() {
        let dynamics = learned(|a, b| [0.5 * a - 0.2 * b, 0.0], 200);
        assert_eq!((dynamics.dependents.following, dynamics.dependents.tried().count()), (0, 0));
    }
}
