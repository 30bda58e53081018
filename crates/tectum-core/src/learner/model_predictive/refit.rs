//! The refit of a model: new scales by evidence on some ticks, then new weights from all ticks, in slices.
//!
//! ```text
//! points   160, most of them spread out, others at random; for movement 80, the newest third, others at random
//! ascend   15 Adam steps on the evidence
//! gather   A = sum phi phiᵀ, b_j = sum phi y_j over the memory
//! solve    L Lᵀ = A + lambda I, w_j = A⁻¹ b_j; the noise lambda from the residuals, then once more
//! invert   P = lambda (A + lambda I)⁻¹
//! catch up the ticks since the beginning, by recursion
//! ```
//!
//! The model in use goes on learning meanwhile. A slice is some rows or ticks; what it takes is counted in
//! operations, so that the same ticks always end a refit in the same tick.

mod points;
mod solve;

use super::evidence::Evidence;
use super::features::BasisValues;
use super::layout::{Layout, NOISE};
use super::linalg::{add_outer, add_scaled, packed};
use super::memory::Data;
use super::model::{MAX_MODEL_OUTPUTS, ModelFit, normal};
use crate::seed::Rng;
use crate::state::StateVisitor;

/// Ticks that are caught up in a slice: more than one, so that a refit comes nearer to the present even where the
/// budget allows a slice a tick.
const AT_ONCE: u64 = 2;

/// How models are fitted anew.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RefitSettings {
    /// Points of the evidence.
    pub points: usize,
    /// Adam steps.
    pub steps: u64,
    /// Operations up to which there are more steps.
    pub extra_steps: u64,
    /// Size of a step.
    pub step: f64,
    /// Width of the prior of the scales' logarithms.
    pub width: f64,
    /// Least noise, as a part of the prior's scale.
    pub noise_floor: f64,
    /// Whether outputs are centred and scaled.
    pub standardise: bool,
    /// Whether points that the model in use finds strange count less.
    pub robust: bool,
    /// Whether most points are as far from each other as can be; if not, a third of them are the newest ticks.
    pub spread: bool,
    /// Most ticks of the memory.
    pub memory: usize,
}

/// What is done next.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Phase {
    Idle,
    Points,
    Ascend,
    Gather,
    Factor,
    Weigh,
    Again,
    InvertLower,
    Invert,
    CatchUp,
}

const PHASES: [Phase; 10] = [
    Phase::Idle,
    Phase::Points,
    Phase::Ascend,
    Phase::Gather,
    Phase::Factor,
    Phase::Weigh,
    Phase::Again,
    Phase::InvertLower,
    Phase::Invert,
    Phase::CatchUp,
];

/// A refit under way.
#[derive(Debug, Clone)]
pub struct Refit {
    settings: RefitSettings,
    phase: Phase,
    /// Progress within the phase.
    at: u64,
    /// The ticks that are gathered.
    range: [u64; 2],
    /// Next fit; its covariance is where `A` is factored.
    next: ModelFit,
    evidence: Evidence,
    matrix: Vec<f64>,
    right: Vec<f64>,
    squares: Vec<f64>,
    gathered: f64,
    /// Times that the noise was adapted.
    rounds: u64,
    // Scratch memory.
    row: Vec<f64>,
    q: Vec<f64>,
    y: [f64; MAX_MODEL_OUTPUTS],
    /// The squared error of the tick that was read, in predictive variances, and whether there was contact.
    surprise: f64,
    contact: bool,
    /// Squared errors of the points in predictive variances, and their median.
    strange: Vec<f64>,
    usual: f64,
    phi: Vec<f64>,
    /// Where points are spread out: components of each tick, and its squared distance from the points chosen so far.
    looks: Vec<f64>,
    least: Vec<f64>,
    /// Number of refits that were completed.
    pub completed: u64,
    /// The evidence before the last step.
    pub log_evidence: f64,
}

/// What a refit is made from: the model with the fit that predicts, and its ticks.
pub struct RefitSource<'a> {
    /// What the model looks at.
    pub layout: &'a Layout,
    /// The fit that predicts, until the new one takes its place.
    pub fit: &'a mut ModelFit,
    /// The ticks.
    pub data: &'a dyn Data,
    /// Scratch memory of its predictions: values of the features' parts,
    pub basis: &'a mut BasisValues,
    /// and of the features.
    pub phi: &'a mut [f64],
}

impl Refit {
    /// No refit yet.
    pub fn new(layout: &Layout, fit: &ModelFit, settings: RefitSettings) -> Self {
        let (len, outputs) = (fit.regression.len, fit.regression.outputs);
        let mut next = fit.clone();
        next.features.reserve(layout);
        let spread = if settings.spread { settings.memory } else { 0 };
        Self {
            settings,
            phase: Phase::Idle,
            at: 0,
            range: [0; 2],
            next,
            evidence: Evidence::new(layout, settings.points, outputs),
            matrix: vec![0.0; packed(len)],
            right: vec![0.0; len * outputs],
            squares: vec![0.0; outputs],
            gathered: 0.0,
            rounds: 0,
            row: vec![0.0; len],
            q: vec![0.0; layout.width],
            y: [0.0; MAX_MODEL_OUTPUTS],
            surprise: 1.0,
            contact: false,
            strange: Vec::with_capacity(settings.points),
            usual: 1.0,
            phi: vec![0.0; len],
            looks: vec![0.0; spread * layout.components],
            least: vec![0.0; spread],
            completed: 0,
            log_evidence: 0.0,
        }
    }

    /// Whether strange points count less.
    pub fn is_robust(&self) -> bool {
        self.settings.robust && self.completed > 0
    }

    /// Whether a refit is under way.
    pub fn busy(&self) -> bool {
        self.phase != Phase::Idle
    }

    /// Begins a refit, unless one is under way.
    pub fn begin(&mut self) {
        if !self.busy() {
            self.enter(Phase::Points);
        }
    }

    /// Adam steps: more where points are few.
    fn steps(&self, layout: &Layout) -> u64 {
        (self.settings.extra_steps / self.evidence.cost(layout).max(1))
            .clamp(self.settings.steps, 4 * self.settings.steps)
    }

    /// The least noise.
    fn floor(&self) -> f64 {
        self.settings.noise_floor * self.evidence.amplitude
    }

    fn enter(&mut self, phase: Phase) {
        self.phase = phase;
        self.at = 0;
    }

    /// Operations of the next slice, at most.
    pub fn next_cost(&self, source: &RefitSource) -> u64 {
        let (len, outputs) = (self.row.len() as u64, source.fit.regression.outputs as u64);
        match self.phase {
            Phase::Idle => 0,
            Phase::Points => self.cost_of_points(source),
            Phase::Ascend => self.evidence.cost(source.layout),
            Phase::Gather => len * (len + 2 * outputs),
            Phase::Factor | Phase::Again => self.cost_of_row(),
            Phase::Weigh => 3 * len * len * outputs,
            Phase::InvertLower => self.cost_of_row() + self.cost_of_samples(),
            Phase::Invert => 2 * (len - self.at) * (self.at + 1),
            Phase::CatchUp => AT_ONCE * self.next.regression.cost_in_row(),
        }
    }

    /// Operations on row `at` of a triangle.
    fn cost_of_row(&self) -> u64 {
        (self.at + 1) * (self.at + 1)
    }

    /// One slice. Returns its operations, and whether `fit` is a new one now.
    pub fn step(&mut self, source: &mut RefitSource, rng: &mut Rng) -> (u64, bool) {
        let len = source.fit.regression.len;
        let cost = match self.phase {
            Phase::Idle => 0,
            Phase::Points => self.choose_points(source, rng),
            Phase::Ascend => self.ascend(source.layout, rng),
            Phase::Gather => self.gather(source),
            Phase::Factor | Phase::Again => self.factor(len),
            Phase::Weigh => self.weigh(len),
            Phase::InvertLower => self.invert_lower(len, rng),
            Phase::Invert => self.invert(len),
            Phase::CatchUp => {
                let mut cost = 0;
                for _ in 0..AT_ONCE {
                    let (more, finished) = self.catch_up(source, rng);
                    cost += more;
                    if finished {
                        return (cost, true);
                    }
                }
                cost
            }
        };
        (cost, false)
    }

    fn ascend(&mut self, layout: &Layout, rng: &mut Rng) -> u64 {
        let RefitSettings { width, step, noise_floor, .. } = self.settings;
        match self.evidence.step(layout, width, step, noise_floor) {
            Some(evidence) => self.log_evidence = evidence,
            None => self.at = u64::MAX - 1,
        }
        self.at += 1;
        if self.at >= self.steps(layout) {
            self.next.features.scales.copy_from_slice(&self.evidence.scales);
            self.measure_components(layout);
            self.next.features.build(layout);
            self.matrix.fill(0.0);
            self.right.fill(0.0);
            self.squares.fill(0.0);
            self.gathered = 0.0;
            self.rounds = 0;
            self.next.regression.lambda = self.evidence.noise();
            if 2 * (self.range[1] - self.range[0]) < 3 * self.row.len() as u64 {
                // Few ticks: recursion takes fewer operations than a factor of the whole matrix.
                self.next.regression.forget(|| normal(rng));
                self.range[1] = self.range[0];
                self.enter(Phase::CatchUp);
            } else {
                self.enter(Phase::Gather);
            }
        }
        self.evidence.cost(layout)
    }

    /// Mean squares of the components over the points.
    fn measure_components(&mut self, layout: &Layout) {
        let features = &mut self.next.features;
        for u in 0..layout.circles {
            features.frequencies[u] =
                super::functions::exp(features.scales[Layout::scale(u, super::layout::ScaleKind::Frequency)]);
        }
        features.mean_squares.fill(1e-6);
        for point in 0..self.evidence.len {
            self.evidence.point(point, &mut self.q);
            let e = &mut self.row[..layout.components];
            layout.components(&features.frequencies, &self.q, e, None);
            for (to, e) in features.mean_squares.iter_mut().zip(e) {
                *to += *e * *e / self.evidence.len as f64;
            }
        }
    }

    fn gather(&mut self, source: &mut RefitSource) -> u64 {
        let tick = self.range[0] + self.at;
        self.at += 1;
        if tick >= self.range[1] || tick < source.data.range().0 {
            if tick >= self.range[1] {
                self.enter(Phase::Factor);
            }
            return 1;
        }
        if !self.read(source, tick) {
            return 1;
        }
        let outputs = source.fit.regression.outputs;
        self.next.features.evaluate(source.layout, &self.q, source.basis, &mut self.phi);
        let weight = 1.0 / self.noisier();
        add_outer(&mut self.matrix, weight, &self.phi);
        for j in 0..outputs {
            let y = (self.y[j] - self.next.center) / self.next.scale;
            add_scaled(&mut self.right[j * self.phi.len()..][..self.phi.len()], weight * y, &self.phi);
            self.squares[j] += weight * y * y;
        }
        self.gathered += 1.0;
        (self.phi.len() * (self.phi.len() + 2 * outputs)) as u64
    }

    fn catch_up(&mut self, source: &mut RefitSource, rng: &mut Rng) -> (u64, bool) {
        let tick = self.range[1] + self.at;
        self.at += 1;
        if tick >= source.data.range().1 {
            if self.range[0] == self.range[1] && self.rounds == 0 {
                // Recursion from the beginning; once more if the noise turns out to be another.
                self.rounds = 1;
                let floor = self.floor();
                let regression = &mut self.next.regression;
                let noise = regression.evident_noise().unwrap_or(0.0).max(floor);
                if noise > 2.0 * regression.lambda || noise < 0.2 * regression.lambda {
                    regression.lambda = noise;
                    self.next.features.scales[NOISE] = self.evidence.scale_of_noise(noise);
                    regression.forget(|| normal(rng));
                    self.enter(Phase::CatchUp);
                    return (1, false);
                }
            }
            self.next.regression.trust();
            std::mem::swap(source.fit, &mut self.next);
            self.completed += 1;
            self.enter(Phase::Idle);
            return (1, true);
        }
        if !self.read(source, tick) {
            return (1, false);
        }
        let outputs = source.fit.regression.outputs;
        let noisier = self.noisier();
        let mut errors = [0.0; MAX_MODEL_OUTPUTS];
        self.next.features.evaluate(source.layout, &self.q, source.basis, &mut self.phi);
        let regression = &mut self.next.regression;
        regression.predict(&self.phi, &mut errors[..outputs]);
        for (error, y) in errors[..outputs].iter_mut().zip(&self.y) {
            *error = (y - self.next.center) / self.next.scale - *error;
        }
        regression.prepare(&self.phi);
        regression.discount(noisier);
        regression.update(&self.phi, &errors[..outputs], || normal(rng));
        (regression.cost_in_row(), false)
    }

    /// Passes on the state.
    pub fn visit(&mut self, layout: &Layout, visitor: &mut dyn StateVisitor) {
        let mut phase = PHASES.iter().position(|p| *p == self.phase).unwrap_or(0) as u32;
        visitor.number("phase", &mut phase);
        self.phase = PHASES.get(phase as usize).copied().unwrap_or(Phase::Idle);
        visitor.number("at", &mut self.at);
        visitor.numbers("range", &mut self.range);
        visitor.enter("next");
        self.next.visit(layout, visitor);
        visitor.leave();
        visitor.nested("evidence", &mut self.evidence);
        visitor.numbers("matrix", &mut self.matrix);
        visitor.numbers("right", &mut self.right);
        visitor.numbers("squares", &mut self.squares);
        visitor.number("usual", &mut self.usual);
        visitor.number("gathered", &mut self.gathered);
        visitor.number("rounds", &mut self.rounds);
        visitor.number("completed", &mut self.completed);
        visitor.number("log_evidence", &mut self.log_evidence);
    }
}
