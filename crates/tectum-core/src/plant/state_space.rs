//! Plants in state-space form: a state of a few numbers, and a step that advances it by one tick.
//!
//! A [`StateSpace`] is the pure model: dynamics, reward, inputs. It has no state of its own, so that a controller that
//! knows the true plant can plan with it. A [`StateSpacePlant`] is the plant that runs: the model, its state, and the
//! trials (new starts or new targets) that come at fixed ticks.
//!
//! All of them compute in double precision, with `libm` for the elementary functions, so that the bits are the same on
//! every machine.

use super::{Outcome, Plant};
use crate::flag;
use crate::seed::{Rng, stream};
use crate::state::{Persist, StateVisitor};
use crate::{MAX_MEASURES, MAX_OUTPUTS};

/// Most numbers in a state.
pub const MAX_STATES: usize = 24;

/// The true model of a plant. Constants of a trial, such as its target, are part of the state.
pub trait StateSpace {
    /// Number of numbers in a state; at most [`MAX_STATES`].
    fn states(&self) -> usize;

    /// The first so many numbers of a state decide the future, with the commands. The others are constants of the
    /// trial, or follow from the first ones.
    fn dynamic_states(&self) -> usize;

    /// Whether number `i` of a state is an angle that wraps into [-pi, pi).
    fn wraps(&self, i: usize) -> bool;

    /// Number of commands; at most [`MAX_OUTPUTS`].
    fn commands(&self) -> usize;

    /// Advances `state` by one tick with `command`, and returns the reward of the tick. Commands are limited to the
    /// range that the plant's actuators have.
    fn step(&self, state: &mut [f64], command: &[f64]) -> f64;
}

/// A model with what a plant needs besides: starts and targets, inputs and measures.
pub trait SimulatedModel: StateSpace {
    /// Name of the random stream of starts and targets.
    const STREAM: &'static str = "targets";
    /// Indices of the numbers of a state that are inputs, in their order. A model with further inputs adds them in
    /// [`SimulatedModel::sense`].
    const INPUTS: &'static [usize];
    /// Whether a new trial begins from a new start, as an episode does. Otherwise it only has another target.
    const RESETS: bool;

    /// Ticks of a trial; 0 for a single one without end.
    fn trial_ticks(&self) -> u64;

    /// Begins a trial. `first` is true for the first trial of a run, which starts from the model's start in any case.
    fn begin(&self, rng: &mut Rng, state: &mut [f64], first: bool);

    /// Writes the inputs of `state`.
    fn sense(&self, state: &[f64], inputs: &mut [f32]) {
        for (input, &i) in inputs.iter_mut().zip(Self::INPUTS) {
            *input = state[i] as f32;
        }
    }

    /// The measures of `state`; the first one is the error.
    fn measures(&self, state: &[f64]) -> [f64; MAX_MEASURES];
}

/// A plant with the model `M`.
#[derive(Debug, Clone)]
pub struct StateSpacePlant<M> {
    model: M,
    state: [f64; MAX_STATES],
    rng: Rng,
    /// Number of trials that have begun.
    trials: u64,
    /// Whether the latest sensing began a trial from a new start.
    truncated: bool,
}

impl<M: SimulatedModel> StateSpacePlant<M> {
    /// The plant; its starts and targets come from a stream of the run's `seed`.
    pub fn with_model(model: M, seed: u64) -> Self {
        let rng = stream(seed, M::STREAM);
        Self { model, state: [0.0; MAX_STATES], rng, trials: 0, truncated: false }
    }

    /// The model.
    pub fn model(&self) -> &M {
        &self.model
    }

    /// The state, in the model's order and units.
    pub fn state(&self) -> &[f64] {
        &self.state[..self.model.states()]
    }

    /// Replaces the state until the next trial begins.
    pub fn set_state(&mut self, state: &[f64]) {
        let states = self.model.states();
        self.state[..states].copy_from_slice(&state[..states]);
    }

    /// Whether the latest sensing ended an episode because its time was over: the inputs are those of a new start.
    pub fn truncated(&self) -> bool {
        self.truncated
    }

    /// Whether a trial begins in `tick`; begins all trials up to then. Their sequence is a function of the tick.
    fn begin_trials(&mut self, tick: u64) -> bool {
        let states = self.model.states();
        let every = self.model.trial_ticks();
        let due = tick.checked_div(every).map_or(1, |ended| ended + 1);
        let fresh = self.trials < due;
        self.truncated = fresh && M::RESETS && self.trials > 0;
        while self.trials < due {
            self.model.begin(&mut self.rng, &mut self.state[..states], self.trials == 0);
            self.trials += 1;
        }
        fresh
    }
}

impl<M: SimulatedModel> Plant for StateSpacePlant<M> {
    fn sense(&mut self, tick: u64, inputs: &mut [f32]) -> bool {
        let fresh = self.begin_trials(tick);
        self.model.sense(&self.state, inputs);
        fresh
    }

    /// An episode that was cut off is stated with the inputs of the new start.
    fn sensing_flags(&self) -> u32 {
        if self.truncated { flag::TRUNCATED } else { 0 }
    }

    fn advance(&mut self, _tick: u64, applied: &[f32]) -> Outcome {
        let (states, commands) = (self.model.states(), self.model.commands());
        let mut command = [0.0; MAX_OUTPUTS];
        for (to, from) in command.iter_mut().zip(&applied[..commands]) {
            *to = f64::from(*from);
        }
        let reward = self.model.step(&mut self.state[..states], &command[..commands]);
        let measures = self.model.measures(&self.state[..states]).map(|measure| measure as f32);
        Outcome { reward: reward as f32, measures }
    }
}

impl<M: SimulatedModel> Persist for StateSpacePlant<M> {
    fn visit_state(&mut self, visitor: &mut dyn StateVisitor) {
        visitor.numbers("state", &mut self.state);
        visitor.nested("rng", &mut self.rng);
        visitor.number("trials", &mut self.trials);
        visitor.boolean("truncated", &mut self.truncated);
    }
}

/// The number of integration steps in a tick of `period_s`, s, that are nearest to `step_s`, and their length, s.
pub(super) fn substeps(period_s: f64, step_s: f64) -> (usize, f64) {
    let count = (period_s / step_s).round().max(1.0);
    (count as usize, period_s / count)
}

/// One step of the classical Runge-Kutta method (fourth order) for positions `q` and velocities `v` with
/// accelerations `acceleration(q, v)`. Returns the positions of the method's last stage: MuJoCo reports bodies there
/// after a step.
pub(super) fn runge_kutta<const N: usize>(
    q: &mut [f64; N],
    v: &mut [f64; N],
    dt: f64,
    acceleration: impl Fn(&[f64; N], &[f64; N]) -> [f64; N],
) -> [f64; N] {
    let ahead = |from: &[f64; N], rate: &[f64; N], dt: f64| std::array::from_fn(|i| from[i] + dt * rate[i]);
    let a0 = acceleration(q, v);
    let (q1, v1): ([f64; N], [f64; N]) = (ahead(q, v, 0.5 * dt), ahead(v, &a0, 0.5 * dt));
    let a1 = acceleration(&q1, &v1);
    let (q2, v2): ([f64; N], [f64; N]) = (ahead(q, &v1, 0.5 * dt), ahead(v, &a1, 0.5 * dt));
    let a2 = acceleration(&q2, &v2);
    let (q3, v3): ([f64; N], [f64; N]) = (ahead(q, &v2, dt), ahead(v, &a2, dt));
    let a3 = acceleration(&q3, &v3);
    for i in 0..N {
        q[i] += dt / 6.0 * (v[i] + 2.0 * v1[i] + 2.0 * v2[i] + v3[i]);
        v[i] += dt / 6.0 * (a0[i] + 2.0 * a1[i] + 2.0 * a2[i] + a3[i]);
    }
    q3
}

/// The reward of dm_control's cart-pole swing-up, which is 1 at best: for a rod that is upright (`angle`, rad), still
/// (`rate` and its margin, rad/s), and near the middle (`position`), with a small command.
pub(super) fn swing_up_reward(angle: f64, [rate, margin]: [f64; 2], position: f64, command: f64) -> f64 {
    let upright = (libm::cos(angle) + 1.0) / 2.0;
    let centred = (1.0 + tolerance(position, 2.0)) / 2.0;
    let small_command = (4.0 + quadratic_tolerance(command)) / 5.0;
    let slow = (1.0 + tolerance(rate, margin)) / 2.0;
    upright * small_command * slow * centred
}

/// A value of 1 at 0 that falls to `at_margin` at a distance of `margin`, along a Gaussian: the function `tolerance`
/// of dm_control with its default arguments, where `at_margin` is 0.1.
fn tolerance(x: f64, margin: f64) -> f64 {
    let scaled = x / margin * libm::sqrt(-2.0 * libm::log(0.1));
    libm::exp(-0.5 * scaled * scaled)
}

/// The same along a parabola that reaches 0 at a distance of 1.
fn quadratic_tolerance(x: f64) -> f64 {
    (1.0 - x * x).max(0.0)
}
