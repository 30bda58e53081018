//! The learned models as a world in which the planner moves.
//!
//! ```text
//! x = [z, d, u before, u before that],  q = [x, u]
//! d' = dynamics(q),   z' = clamp(z + CHANGE d'),   x' = [z', d', u, u before]
//! r = reward(q), or reward([z', d', u])
//! ```
//!
//! Where a prediction is clamped, derivatives are those without the clamp, so that a plan can leave a stop.

use super::config::InputRange;
use super::dynamics::Dynamics;
use super::ends::SLACK;
use super::layout::Places;
use super::linalg::{add_congruence, add_scaled, clip_to_concave};
use super::model::{MAX_MODEL_OUTPUTS, Model};
use super::weighted::ProductCurves;
use crate::MAX_INPUTS;

/// Changes are in units of this part of half of the range.
pub const CHANGE: f64 = 0.3;

/// How near to a declared end an input is at it: rounding.
const EXACT: f64 = 1e-6;

/// The part of a predicted reward beyond the best one that counts where the model is not certain.
const PROMISED: f64 = 0.05;
/// Standard deviations by which what is certain is less than what is predicted.
const DEVIATIONS: f64 = 3.0;
/// Rewards beyond the best by so many standard deviations count no more than this.
const BEYOND: f64 = 5.0;

/// A command whose effect is less than this part of the largest one is idle.
const IDLE: f64 = 0.05;
/// What an idle command of 1 costs, in standard deviations of the reward: nothing that was seen tells what it is good
/// for, and a motor that is blocked should not be driven at its limit.
const IDLE_PRICE: f64 = 0.01;

/// A world with expansions of second order.
pub trait World {
    /// The state after `q`, and the reward.
    fn step(&mut self, q: &[f64], next: &mut [f64]) -> f64;
    /// Writes the Jacobian of the next state (rows of `D`), and gradient and Hessian (rows of `D`) of the reward, all
    /// by `q`. The Hessian is concave in all that commands can change.
    fn expand(&mut self, q: &[f64], jacobian: &mut [f64], gradient: &mut [f64], hessian: &mut [f64]);
    /// Writes `a - b` for states, the short way round for inputs that come round.
    fn difference(&self, a: &[f64], b: &[f64], out: &mut [f64]);
}

/// What is known of the inputs.
#[derive(Debug, Clone)]
pub struct Ranges {
    /// Whether each input comes round.
    pub wraps: Vec<bool>,
    /// Least and greatest value that each input can have; infinite where it comes round and no end was learned.
    ends: Vec<[f64; 2]>,
    /// How near to them an input is at an end.
    slack: Vec<[f64; 2]>,
}

impl Ranges {
    /// Those of inputs that are scaled to [-1, 1].
    pub fn of(inputs: &[InputRange]) -> Self {
        let wraps: Vec<_> = inputs.iter().map(|range| range.wraps).collect();
        let ends = wraps.iter().map(|wraps| declared(*wraps)).collect();
        Self { wraps, ends, slack: vec![[EXACT; 2]; inputs.len()] }
    }

    /// `z` of input `i` within its range.
    pub fn bring_in(&self, i: usize, z: f64) -> f64 {
        let z = self.clamp(i, z);
        if self.wraps[i] { wrap(z) } else { z }
    }

    /// `z` of input `i`, not beyond an end.
    fn clamp(&self, i: usize, z: f64) -> f64 {
        z.clamp(self.ends[i][0], self.ends[i][1])
    }

    /// Whether `z` of input `i` is at the lower and at the upper end.
    pub fn at_ends(&self, i: usize, z: f64) -> [bool; 2] {
        let ([low, high], [below, above]) = (self.ends[i], self.slack[i]);
        [z <= low + below, z >= high - above]
    }

    /// The ends of input `i` that were learned; the others are those that were declared.
    pub fn set_learned(&mut self, i: usize, learned: [Option<f64>; 2]) {
        let declared = declared(self.wraps[i]);
        for side in 0..2 {
            self.ends[i][side] = learned[side].unwrap_or(declared[side]);
            self.slack[i][side] = if learned[side].is_some() { SLACK } else { EXACT };
        }
    }

    /// Takes the ends of `other`, which has the same inputs.
    pub fn copy_ends(&mut self, other: &Self) {
        self.ends.copy_from_slice(&other.ends);
        self.slack.copy_from_slice(&other.slack);
    }
}

/// The ends of an input that is scaled to [-1, 1].
fn declared(wraps: bool) -> [f64; 2] {
    let end = if wraps { f64::INFINITY } else { 1.0 };
    [-end, end]
}

/// `z` less whole turns of 2, in [-1, 1).
pub fn wrap(z: f64) -> f64 {
    if (-1.0..1.0).contains(&z) { z } else { z - 2.0 * libm::floor(0.5 * (z + 1.0)) }
}

/// Scratch memory of a learned world.
#[derive(Debug, Clone)]
pub struct WorldScratch {
    after: Vec<f64>,
    /// Jacobian of the changes.
    pub dynamics: Vec<f64>,
    gradient: Vec<f64>,
    small: Vec<f64>,
    copy: Vec<f64>,
    vectors: Vec<f64>,
    block: Vec<f64>,
    chain: Vec<f64>,
    product: Vec<f64>,
    curves: ProductCurves,
    /// Places of the reward's Hessian: moving inputs, their changes, commands; then inputs that do not move.
    pub active: Vec<usize>,
    /// The first so many of them are those of moving inputs and commands.
    pub moving: usize,
}

impl WorldScratch {
    /// For worlds of these places and rewards.
    pub fn new(places: Places, rewards: &[Model]) -> Self {
        let (width, most) = (places.len(), 2 * places.inputs + places.commands);
        let most_nodes = rewards.iter().map(|model| model.fit.features.most_nodes).max().unwrap_or(0);
        let components = rewards.iter().map(|model| model.layout.components).max().unwrap_or(0);
        Self {
            curves: ProductCurves::new(most_nodes, components, most),
            after: vec![0.0; width],
            dynamics: vec![0.0; places.inputs * width],
            gradient: vec![0.0; width],
            small: vec![0.0; most * most],
            copy: vec![0.0; most * most],
            vectors: vec![0.0; most * most],
            block: vec![0.0; most * most],
            chain: vec![0.0; most * width],
            product: vec![0.0; most * width],
            active: Vec::with_capacity(most),
            moving: 0,
        }
    }
}

impl WorldScratch {
    /// Makes the reward's Hessian concave in what commands move, and in the commands. The rest only tells how their
    /// slopes depend on inputs that do not move.
    fn make_concave(&mut self) {
        let (order, moving) = (self.active.len(), self.moving);
        for (to, row) in self.block.chunks_exact_mut(moving).zip(self.small.chunks_exact(order)).take(moving) {
            to.copy_from_slice(&row[..moving]);
        }
        clip_to_concave(&mut self.block[..moving * moving], moving, &mut self.copy, &mut self.vectors);
        for (row, from) in self.small.chunks_exact_mut(order).zip(self.block.chunks_exact(moving)).take(moving) {
            row[..moving].copy_from_slice(from);
        }
    }
}

/// The world of the learned models.
#[derive(Debug)]
pub struct LearnedWorld<'a> {
    /// The parts of `q`.
    pub places: Places,
    /// Changes of inputs.
    pub dynamics: &'a mut Dynamics,
    /// Rewards.
    pub reward: &'a mut Model,
    /// Whether rewards depend on what comes after the tick.
    pub after: bool,
    /// The largest reward that was seen, in the model's units. What is predicted beyond it counts for a part only, and
    /// up to an end: it may be a promise of a model that knows nothing there.
    pub best: f64,
    /// Standard deviations by which a reward counts less where the model is not certain.
    pub caution: f64,
    /// The commands (bits) that move nothing now, as that of a blocked joint.
    pub idle: u32,
    /// What is known of the inputs.
    pub ranges: &'a Ranges,
    /// Scratch memory.
    pub scratch: &'a mut WorldScratch,
}

/// A reward as it counts, and its slope, if the model predicts `reward` at the last point of its planner's function.
/// Beyond the `best` reward that was seen, what is certain counts, less three standard deviations, and else a small
/// part: it may be the promise of a model that knows nothing there.
fn believed(model: &Model, reward: f64, best: f64, caution: f64) -> (f64, f64) {
    let doubt = if caution > 0.0 { caution * model.variance().sqrt() } else { 0.0 };
    let (value, slope) = promised(model, reward, best);
    (value - doubt, slope)
}

/// The same without caution.
fn promised(model: &Model, reward: f64, best: f64) -> (f64, f64) {
    if reward <= best {
        return (reward, 1.0);
    }
    let beyond = (reward - best).min(BEYOND);
    let certain = beyond - DEVIATIONS * model.variance().sqrt();
    match certain {
        ..0.0 => (best + PROMISED * beyond, PROMISED),
        _ => (best + PROMISED * beyond + (1.0 - PROMISED) * certain, 1.0),
    }
}

/// Writes the state after `q` for the changes `d` of the inputs.
pub(super) fn advance(places: Places, ranges: &Ranges, q: &[f64], d: &[f64], next: &mut [f64]) {
    let (n, m) = (places.inputs, places.commands);
    for i in 0..n {
        let free = q[i] + CHANGE * d[i];
        let z = ranges.clamp(i, free);
        next[n + i] = if ranges.wraps[i] && z == free { d[i] } else { (z - q[i]) / CHANGE };
        next[i] = if ranges.wraps[i] { wrap(z) } else { z };
    }
    next[2 * n..2 * n + m].copy_from_slice(&q[places.state()..]);
    next[2 * n + m..].copy_from_slice(&q[2 * n..2 * n + m]);
}

impl LearnedWorld<'_> {
    /// What the idle commands of `q` cost.
    fn idle_price(&self, q: &[f64]) -> f64 {
        if self.idle == 0 {
            return 0.0;
        }
        let (nx, idle) = (self.places.state(), |j: &usize| self.idle >> j & 1 == 1);
        IDLE_PRICE * (0..self.places.commands).filter(idle).map(|j| q[nx + j] * q[nx + j]).sum::<f64>()
    }

    /// Finds the commands that move nothing from `q`.
    pub fn find_idle(&mut self, q: &[f64]) {
        self.idle = 0;
        self.dynamics_jacobian(q);
        let (n, m, width) = (self.places.inputs, self.places.commands, self.places.len());
        let mut effects = [0.0; crate::MAX_OUTPUTS];
        for (j, effect) in effects.iter_mut().enumerate().take(m) {
            let of = |i: usize, ago: usize| self.scratch.dynamics[i * width + self.places.command(j, ago)].abs();
            *effect = (0..n).map(|i| of(i, 0) + of(i, 1) + of(i, 2)).sum();
        }
        let least = IDLE * effects.iter().fold(0.0, |a: f64, b| a.max(*b));
        self.idle = (0..m).filter(|j| effects[*j] < least).fold(0, |bits, j| bits | 1 << j);
    }

    /// The Jacobian of the changes at `q`, into the scratch memory.
    pub fn dynamics_jacobian(&mut self, q: &[f64]) {
        let mut d = [0.0; MAX_MODEL_OUTPUTS];
        self.dynamics.jacobian(q, &mut d[..self.places.inputs], &mut self.scratch.dynamics);
    }

    /// The reward of a point, as if it were before or after the tick, whichever the model looks at.
    pub fn reward_of(&mut self, q: &[f64]) -> f64 {
        let Model { layout, fit, weighted, .. } = &mut *self.reward;
        let mut reward = [0.0];
        weighted.value(layout, &fit.features, q, &mut reward);
        believed(self.reward, reward[0], self.best, self.caution).0
    }

    /// The point at which the reward model looks.
    fn look(&mut self, q: &[f64], next: &[f64]) {
        let after = &mut self.scratch.after;
        after.copy_from_slice(q);
        if self.after {
            after[..2 * self.places.inputs].copy_from_slice(&next[..2 * self.places.inputs]);
        }
    }
}

impl World for LearnedWorld<'_> {
    fn step(&mut self, q: &[f64], next: &mut [f64]) -> f64 {
        let n = self.places.inputs;
        let mut d = [0.0; MAX_MODEL_OUTPUTS];
        self.dynamics.value(q, &mut d[..n]);
        advance(self.places, self.ranges, q, &d[..n], next);
        self.look(q, next);
        let Model { layout, fit, weighted, .. } = &mut *self.reward;
        let mut reward = [0.0];
        weighted.value(layout, &fit.features, &self.scratch.after, &mut reward);
        believed(self.reward, reward[0], self.best, self.caution).0 - self.idle_price(q)
    }

    fn expand(&mut self, q: &[f64], jacobian: &mut [f64], gradient: &mut [f64], hessian: &mut [f64]) {
        let (n, m, width) = (self.places.inputs, self.places.commands, self.places.len());
        let mut d = [0.0; MAX_INPUTS];
        self.dynamics.jacobian(q, &mut d[..n], &mut self.scratch.dynamics);
        jacobian.fill(0.0);
        for i in 0..n {
            let row = &self.scratch.dynamics[i * width..(i + 1) * width];
            jacobian[(n + i) * width..][..width].copy_from_slice(row);
            add_scaled(&mut jacobian[i * width..][..width], CHANGE, row);
            jacobian[i * width + i] += 1.0;
        }
        for j in 0..m {
            jacobian[(2 * n + j) * width + self.places.state() + j] = 1.0;
            jacobian[(2 * n + m + j) * width + 2 * n + j] = 1.0;
        }
        let mut next = [0.0; 2 * MAX_INPUTS + 2 * crate::MAX_OUTPUTS];
        let next = &mut next[..self.places.state()];
        advance(self.places, self.ranges, q, &d[..n], next);
        self.look(q, next);
        self.expand_reward(jacobian, gradient, hessian);
        let nx = self.places.state();
        for at in (0..m).filter(|j| self.idle >> j & 1 == 1).map(|j| nx + j) {
            gradient[at] -= 2.0 * IDLE_PRICE * q[at];
            hessian[at * width + at] -= 2.0 * IDLE_PRICE;
        }
    }

    fn difference(&self, a: &[f64], b: &[f64], out: &mut [f64]) {
        for (i, ((a, b), out)) in a.iter().zip(b).zip(out).enumerate() {
            *out = a - b;
            if i < self.places.inputs && self.ranges.wraps[i] {
                *out = wrap(*out);
            }
        }
    }
}

impl LearnedWorld<'_> {
    /// Gradient and Hessian of the reward by `q`; the reward model's point is in `after`.
    fn expand_reward(&mut self, jacobian: &[f64], gradient: &mut [f64], hessian: &mut [f64]) {
        let (n, width) = (self.places.inputs, self.places.len());
        let WorldScratch { after, gradient: by_look, small, active, curves, .. } = &mut *self.scratch;
        let order = active.len();
        let small = &mut small[..order * order];
        let Model { layout, fit, weighted, .. } = &mut *self.reward;
        let value = weighted.hessian((layout, &fit.features), after, (active, curves), by_look, small);
        let slope = believed(self.reward, value, self.best, self.caution).1;
        gradient.fill(0.0);
        hessian.fill(0.0);
        if slope == 0.0 {
            return;
        }
        self.scratch.make_concave();
        let WorldScratch { gradient: by_look, small, chain, product, active, .. } = &mut *self.scratch;
        let small = &mut small[..order * order];
        small.iter_mut().chain(by_look.iter_mut()).for_each(|x| *x *= slope);
        if !self.after {
            gradient.copy_from_slice(by_look);
            for (r, &row) in active.iter().enumerate() {
                for (c, &column) in active.iter().enumerate() {
                    hessian[row * width + column] = small[r * order + c];
                }
            }
            return;
        }
        // By `q` through the next inputs and changes.
        for (at, slope) in by_look.iter().enumerate() {
            if at < 2 * n {
                add_scaled(gradient, *slope, &jacobian[at * width..(at + 1) * width]);
            } else {
                gradient[at] += slope;
            }
        }
        chain[..order * width].fill(0.0);
        for (r, &at) in active.iter().enumerate() {
            let row = &mut chain[r * width..(r + 1) * width];
            if at < 2 * n {
                row.copy_from_slice(&jacobian[at * width..(at + 1) * width]);
            } else {
                row[at] = 1.0;
            }
        }
        add_congruence(hessian, &chain[..order * width], small, &mut product[..order * width], width);
    }
}
