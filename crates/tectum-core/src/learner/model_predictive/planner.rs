//! Control-limited iLQR: a plan of commands that maximises the sum of predicted rewards over a horizon.
//!
//! Tassa, Mansard & Todorov 2014 ("Control-limited differential dynamic programming"), with Gauss-Newton second
//! derivatives of the dynamics and concave rewards. Backwards from the horizon, with `V` (nx x nx) and `v` (nx) of the
//! next step, Jacobian `F` (nx x D) of the next state and gradient `g`, Hessian `H` of the reward by `q = [x, u]`:
//!
//! ```text
//! Q_qq = H + Fᵀ V F,   Q_q = g + Fᵀ v
//! du = argmin of 1/2 duᵀ (mu I - Q_uu) du - Q_uᵀ du  within the limits;   K = (mu I - Q_uu)⁻¹ Q_ux where free
//! v = Q_x + Kᵀ Q_uu du + Kᵀ Q_u + Q_xu du,   V = Q_xx + Kᵀ Q_uu K + Kᵀ Q_ux + Q_xu K
//! ```
//!
//! A command that is limited by the one before, which is a part of the state, follows it: its row of `K` is 1 there.
//!
//! Then forwards with `u + a du + K (x_new - x)`, for a = 1, 1/2, .. until the sum of rewards rises.

use super::box_qp;
use super::command_limits::CommandLimits;
use super::layout::Places;
use super::linalg::{add_congruence, add_scaled, dot, solve_lower, solve_lower_transposed};
use super::world::World;
use crate::MAX_OUTPUTS;
use crate::state::{Persist, StateVisitor};

/// The regularisation of a plan's first iteration in a tick, at most.
pub const FIRST_MU: f64 = 1e-3;

/// A plan that is expected to gain less than this is done: the full step is tried, and nothing else. In the sum of
/// rewards, in standard deviations of a reward.
const CONVERGED: f64 = 1e-4;

/// How far the line search goes along the steps.
const SIZES: [f64; 4] = [1.0, 0.5, 0.2, 0.05];

/// A plan: states, commands, gains.
#[derive(Debug, Clone)]
pub struct CommandPlan {
    places: Places,
    /// Number of commands.
    pub horizon: usize,
    /// States, one more than commands.
    pub states: Vec<f64>,
    /// Commands.
    pub commands: Vec<f64>,
    /// Gains `K` (m x nx) of each step.
    pub gains: Vec<f64>,
    /// The sum of predicted rewards.
    pub value: f64,
    /// The regularisation `mu`.
    pub mu: f64,
}

impl CommandPlan {
    /// Commands of 0.
    pub fn new(places: Places, horizon: usize) -> Self {
        let (nx, m) = (places.state(), places.commands);
        Self {
            places,
            horizon,
            states: vec![0.0; (horizon + 1) * nx],
            commands: vec![0.0; horizon * m],
            gains: vec![0.0; horizon * m * nx],
            value: 0.0,
            mu: FIRST_MU,
        }
    }

    /// The state of a step.
    pub fn state(&self, step: usize) -> &[f64] {
        let nx = self.places.state();
        &self.states[step * nx..(step + 1) * nx]
    }

    /// The command of a step.
    pub fn command(&self, step: usize) -> &[f64] {
        let m = self.places.commands;
        &self.commands[step * m..(step + 1) * m]
    }

    /// Drops the first command and repeats the last.
    pub fn shift(&mut self) {
        let m = self.places.commands;
        self.commands.copy_within(m.., 0);
    }

    /// Takes over another plan.
    pub fn copy_from(&mut self, other: &Self) {
        self.states.copy_from_slice(&other.states);
        self.commands.copy_from_slice(&other.commands);
        self.gains.copy_from_slice(&other.gains);
        self.value = other.value;
        self.mu = other.mu;
    }
}

impl Persist for CommandPlan {
    fn visit_state(&mut self, visitor: &mut dyn StateVisitor) {
        visitor.numbers("states", &mut self.states);
        visitor.numbers("commands", &mut self.commands);
        visitor.numbers("gains", &mut self.gains);
        visitor.number("value", &mut self.value);
        visitor.number("mu", &mut self.mu);
    }
}

/// Scratch memory of the optimisation.
#[derive(Debug, Clone)]
pub struct Planner {
    places: Places,
    trial: CommandPlan,
    steps: Vec<f64>,
    jacobian: Vec<f64>,
    gradient: Vec<f64>,
    hessian: Vec<f64>,
    product: Vec<f64>,
    value: Vec<f64>,
    slope: Vec<f64>,
    next_value: Vec<f64>,
    q: Vec<f64>,
    apart: Vec<f64>,
    /// What the gate lets through.
    pub limits: CommandLimits,
    /// Steps of the world that were evaluated, and expanded, since the beginning.
    pub work: [u64; 2],
}

impl Planner {
    /// For plans of `horizon` commands within `limits`.
    pub fn new(places: Places, horizon: usize, limits: CommandLimits) -> Self {
        let (nx, m, width) = (places.state(), places.commands, places.len());
        Self {
            places,
            trial: CommandPlan::new(places, horizon),
            steps: vec![0.0; horizon * m],
            jacobian: vec![0.0; nx * width],
            gradient: vec![0.0; width],
            hessian: vec![0.0; width * width],
            product: vec![0.0; nx * width],
            value: vec![0.0; nx * nx],
            slope: vec![0.0; nx],
            next_value: vec![0.0; nx * nx],
            q: vec![0.0; width],
            apart: vec![0.0; nx],
            limits,
            work: [0; 2],
        }
    }

    /// Predicts states and rewards of a plan from `start`, and brings its commands within the limits.
    pub fn roll_out(&mut self, world: &mut dyn World, plan: &mut CommandPlan, start: &[f64]) {
        let (nx, m) = (self.places.state(), self.places.commands);
        plan.states[..nx].copy_from_slice(start);
        plan.value = 0.0;
        for t in 0..plan.horizon {
            let (done, rest) = plan.states.split_at_mut((t + 1) * nx);
            self.q[..nx].copy_from_slice(&done[t * nx..]);
            for (j, u) in plan.commands[t * m..(t + 1) * m].iter_mut().enumerate() {
                *u = self.limits.clamp(&self.q, j, *u);
                self.q[nx + j] = *u;
            }
            plan.value += world.step(&self.q, &mut rest[..nx]);
        }
        self.work[0] += plan.horizon as u64;
    }

    /// One iteration. Returns whether another one may make the plan better still.
    pub fn improve(&mut self, world: &mut dyn World, plan: &mut CommandPlan) -> bool {
        let goes_on = self.backward(world, plan) > CONVERGED;
        let sizes = if goes_on { &SIZES[..] } else { &SIZES[..1] };
        for &size in sizes {
            self.forward(world, plan, size);
            if self.trial.value > plan.value {
                plan.states.copy_from_slice(&self.trial.states);
                plan.commands.copy_from_slice(&self.trial.commands);
                plan.value = self.trial.value;
                plan.mu = (plan.mu * if size == 1.0 { 0.3 } else { 1.0 }).max(1e-6);
                return goes_on;
            }
        }
        if goes_on {
            plan.mu = (plan.mu * 5.0).min(1e4);
        }
        goes_on
    }

    fn forward(&mut self, world: &mut dyn World, plan: &CommandPlan, size: f64) {
        let (nx, m) = (self.places.state(), self.places.commands);
        self.trial.states[..nx].copy_from_slice(&plan.states[..nx]);
        self.trial.value = 0.0;
        for t in 0..plan.horizon {
            let (done, rest) = self.trial.states.split_at_mut((t + 1) * nx);
            let state = &done[t * nx..];
            world.difference(state, plan.state(t), &mut self.apart);
            for j in 0..m {
                let at = t * m + j;
                let back = dot(&plan.gains[at * nx..(at + 1) * nx], &self.apart);
                let u = plan.commands[at] + size * self.steps[at] + back;
                self.trial.commands[at] = self.limits.clamp(state, j, u);
            }
            self.q[..nx].copy_from_slice(state);
            self.q[nx..].copy_from_slice(&self.trial.commands[t * m..(t + 1) * m]);
            self.trial.value += world.step(&self.q, &mut rest[..nx]);
        }
        self.work[0] += plan.horizon as u64;
    }

    /// Steps and gains of all commands. Returns what the steps are expected to gain.
    fn backward(&mut self, world: &mut dyn World, plan: &mut CommandPlan) -> f64 {
        let (nx, m) = (self.places.state(), self.places.commands);
        let mut expected = 0.0;
        self.value.fill(0.0);
        self.slope.fill(0.0);
        for t in (0..plan.horizon).rev() {
            self.q[..nx].copy_from_slice(plan.state(t));
            self.q[nx..].copy_from_slice(plan.command(t));
            world.expand(&self.q, &mut self.jacobian, &mut self.gradient, &mut self.hessian);
            self.back_up();
            expected += self.optimise_step(plan, t, m);
            self.pass_value(plan, t);
        }
        self.work[1] += plan.horizon as u64;
        expected
    }

    /// `Q_q` and `Q_qq`, in place of the reward's gradient and Hessian.
    fn back_up(&mut self) {
        let (nx, width) = (self.places.state(), self.places.len());
        for r in 0..nx {
            add_scaled(&mut self.gradient, self.slope[r], &self.jacobian[r * width..(r + 1) * width]);
        }
        add_congruence(&mut self.hessian, &self.jacobian, &self.value, &mut self.product, width);
    }

    /// Step and gain of command `t`. Returns what the step is expected to gain.
    fn optimise_step(&mut self, plan: &mut CommandPlan, t: usize, m: usize) -> f64 {
        let (nx, width) = (self.places.state(), self.places.len());
        let (mut h, mut g) = ([0.0; MAX_OUTPUTS * MAX_OUTPUTS], [0.0; MAX_OUTPUTS]);
        let (mut low, mut high) = ([0.0; MAX_OUTPUTS], [0.0; MAX_OUTPUTS]);
        let mut mu = plan.mu;
        let gains = &mut plan.gains[t * m * nx..(t + 1) * m * nx];
        gains.fill(0.0);
        for _ in 0..20 {
            for i in 0..m {
                for j in 0..m {
                    h[i * m + j] = -self.hessian[(nx + i) * width + nx + j];
                }
                h[i * m + i] += mu;
                g[i] = -self.gradient[nx + i];
                let command = plan.commands[t * m + i];
                [low[i], high[i]] = self.limits.range(&self.q, i).map(|end| end - command);
            }
            let Some(solution) = box_qp::solve(&h[..m * m], &g[..m], &low[..m], &high[..m], &[0.0; MAX_OUTPUTS][..m])
            else {
                mu = 10.0 * mu + 1e-6;
                continue;
            };
            self.steps[t * m..(t + 1) * m].copy_from_slice(&solution.x[..m]);
            // A command that is as far as it may be from the one before follows that one.
            let follows = |i: &usize| !solution.free[*i] && (plan.commands[t * m + i] + solution.x[*i]).abs() < 1.0;
            for i in (0..m).filter(follows) {
                gains[i * nx + self.limits.before(i)] = 1.0;
            }
            for x in 0..nx {
                let mut column = [0.0; MAX_OUTPUTS];
                let free = || (0..m).filter(|&i| solution.free[i]).enumerate();
                for (at, i) in free() {
                    let row = &self.hessian[(nx + i) * width..][..width];
                    let following = (0..m).filter(follows).map(|j| row[nx + j] * gains[j * nx + x]).sum::<f64>();
                    column[at] = row[x] + following;
                }
                solve_lower(&solution.factor, &mut column[..solution.order]);
                solve_lower_transposed(&solution.factor, &mut column[..solution.order]);
                for (at, i) in free() {
                    gains[i * nx + x] = column[at];
                }
            }
            let step = &solution.x[..m];
            return -(0..m).map(|i| step[i] * (g[i] + 0.5 * dot(&h[i * m..(i + 1) * m], step))).sum::<f64>();
        }
        self.steps[t * m..(t + 1) * m].fill(0.0);
        0.0
    }

    /// `v` and `V` of step `t`.
    fn pass_value(&mut self, plan: &CommandPlan, t: usize) {
        let (nx, m, width) = (self.places.state(), self.places.commands, self.places.len());
        let gains = &plan.gains[t * m * nx..(t + 1) * m * nx];
        let steps = &self.steps[t * m..(t + 1) * m];
        for x in 0..nx {
            self.slope[x] = self.gradient[x];
            self.next_value[x * nx..(x + 1) * nx].copy_from_slice(&self.hessian[x * width..x * width + nx]);
        }
        for i in 0..m {
            let row = &self.hessian[(nx + i) * width..(nx + i + 1) * width];
            // Q_uu du + Q_u, and Q_uu K + Q_ux, of command i.
            let pull = self.gradient[nx + i] + dot(&row[nx..], steps);
            add_scaled(&mut self.slope, pull, &gains[i * nx..(i + 1) * nx]);
            add_scaled(&mut self.slope, steps[i], &row[..nx]);
            self.apart.copy_from_slice(&row[..nx]);
            for j in 0..m {
                add_scaled(&mut self.apart, row[nx + j], &gains[j * nx..(j + 1) * nx]);
            }
            for x in 0..nx {
                let to = &mut self.next_value[x * nx..(x + 1) * nx];
                add_scaled(to, gains[i * nx + x], &self.apart);
                add_scaled(to, row[x], &gains[i * nx..(i + 1) * nx]);
            }
        }
        std::mem::swap(&mut self.value, &mut self.next_value);
    }
}
