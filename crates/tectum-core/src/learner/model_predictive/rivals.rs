//! Where rival plans begin: a plan improves only downhill, and needs others to leave a local optimum.
//!
//! | kind | commands |
//! |---|---|
//! | zeros | none |
//! | disturbed | the plan and a square wave on each command |
//! | wave | a square wave on each command |
//! | goal | straight to the best of some remembered postures, for the inputs that do not move now |
//!
//! The goal is found by the learned reward: of some remembered ticks, the inputs that commands move are combined with
//! the other inputs of now (a target, a blocked joint), and the combination of the largest predicted reward is taken.
//! The way there follows from damped least squares on the learned dynamics, `u = (JᵀJ + e I)⁻¹ Jᵀ (goal - z)`, with the
//! effect `J` of a command summed over the ticks in which it acts.

use rand::RngExt as _;

use super::linalg::{add_scaled, cholesky, dot, packed, solve_lower, solve_lower_transposed};
use super::memory::Memory;
use super::operations::StepCost;
use super::planner::{CommandPlan, FIRST_MU};
use super::world::{CHANGE, LearnedWorld, World as _, wrap};
use crate::seed::Rng;
use crate::{MAX_INPUTS, MAX_OUTPUTS};

/// Number of kinds.
pub const KINDS: u32 = 4;
/// An input is held where commands move it by less than this part of what they move others.
const HELD: f64 = 0.01;
/// Remembered postures that are compared.
const POSTURES: usize = 32;

/// Writes the commands from which a rival of `kind` begins, in the first state of `plan`. The bits of `moving` are the
/// inputs that move.
pub fn draw(
    kind: u32,
    rng: &mut Rng,
    world: &mut LearnedWorld,
    (memory, moving): (&Memory, u32),
    plan: &CommandPlan,
    rival: &mut CommandPlan,
) {
    let start = plan.state(0);
    rival.mu = FIRST_MU;
    match kind {
        0 => rival.commands.fill(0.0),
        1 => {
            rival.commands.copy_from_slice(&plan.commands);
            add_wave(rng, rival, world.places.commands);
        }
        2 => {
            rival.commands.fill(0.0);
            add_wave(rng, rival, world.places.commands);
        }
        _ => approach(rng, world, memory, moving, start, rival),
    }
}

/// Operations of drawing a rival of `kind`.
pub fn cost(kind: u32, cost: &StepCost, horizon: usize) -> u64 {
    match kind {
        0..=2 => 0,
        _ => POSTURES as u64 * cost.posture + (horizon as u64 + 1) * (cost.movement + cost.step),
    }
}

/// Adds a square wave of random period, phase and height to each command.
fn add_wave(rng: &mut Rng, rival: &mut CommandPlan, m: usize) {
    for j in 0..m {
        let period = rng.random_range(2..=rival.horizon);
        let phase = rng.random_range(0..2 * period);
        let height = rng.random_range(-1.0..1.0);
        for t in 0..rival.horizon {
            let sign = if (t + phase) / period % 2 == 0 { 1.0 } else { -1.0 };
            let u = &mut rival.commands[t * m + j];
            *u = (*u + sign * height).clamp(-1.0, 1.0);
        }
    }
}

/// Commands towards the best of some remembered postures.
fn approach(
    rng: &mut Rng,
    world: &mut LearnedWorld,
    memory: &Memory,
    moving: u32,
    start: &[f64],
    rival: &mut CommandPlan,
) {
    let places = world.places;
    let (n, m, nx) = (places.inputs, places.commands, places.state());
    let mut goal = [0.0; MAX_INPUTS];
    let mut best = f64::NEG_INFINITY;
    let mut q = [0.0; 2 * MAX_INPUTS + 3 * MAX_OUTPUTS];
    let q = &mut q[..places.len()];
    let mut next = [0.0; 2 * MAX_INPUTS + 2 * MAX_OUTPUTS];
    let next = &mut next[..nx];
    q[..nx].copy_from_slice(start);
    let moving = world.commanded(q, moving);
    for _ in 0..POSTURES {
        let tick = rng.random_range(memory.first..memory.stored);
        q.fill(0.0);
        for i in 0..n {
            q[i] = if moving & (1 << i) != 0 { memory.q(tick)[i] } else { start[i] };
        }
        let reward = world.reward_of(q);
        if reward > best {
            best = reward;
            goal[..n].copy_from_slice(&q[..n]);
        }
    }
    let reach = rng.random_range(0.1..1.0);
    rival.states[..nx].copy_from_slice(start);
    for t in 0..rival.horizon {
        q[..nx].copy_from_slice(&rival.states[t * nx..(t + 1) * nx]);
        q[nx..].fill(0.0);
        let mut u = [0.0; MAX_OUTPUTS];
        world.towards(q, &goal[..n], moving, &mut u[..m]);
        let largest = u[..m].iter().fold(0.0, |a: f64, u| a.max(u.abs()));
        let factor = if largest > reach { reach / largest } else { 1.0 };
        for (to, u) in rival.commands[t * m..(t + 1) * m].iter_mut().zip(&u) {
            *to = factor * u;
        }
        q[nx..].copy_from_slice(&rival.commands[t * m..(t + 1) * m]);
        world.step(q, next);
        rival.states[(t + 1) * nx..(t + 2) * nx].copy_from_slice(next);
    }
}

impl LearnedWorld<'_> {
    /// Those of the inputs `moving` that a command moves from `q`; all of them where none shows. A blocked joint is
    /// where it is.
    fn commanded(&mut self, q: &[f64], moving: u32) -> u32 {
        self.dynamics_jacobian(q);
        let width = self.places.len();
        let mut effects = [0.0; MAX_INPUTS];
        for (i, effect) in effects.iter_mut().enumerate().filter(|(i, _)| moving >> i & 1 == 1) {
            let row = &self.scratch.dynamics[i * width..(i + 1) * width];
            let each = (0..self.places.commands).flat_map(|j| (0..3).map(move |ago| (j, ago)));
            *effect = each.map(|(j, ago)| row[self.places.command(j, ago)].abs()).sum();
        }
        let least = HELD * effects.iter().fold(0.0, |a: f64, b| a.max(*b));
        let bits = (0..MAX_INPUTS).filter(|i| effects[*i] > least).fold(0, |bits, i| bits | 1 << i);
        if bits == 0 { moving } else { bits }
    }

    /// The command that brings moving inputs from `q` to `goal`, by damped least squares.
    fn towards(&mut self, q: &[f64], goal: &[f64], moving: u32, u: &mut [f64]) {
        let (n, m, width) = (self.places.inputs, self.places.commands, self.places.len());
        self.dynamics_jacobian(q);
        let mut normal = [0.0; MAX_OUTPUTS * (MAX_OUTPUTS + 1) / 2];
        u.fill(0.0);
        let mut total = 1e-12;
        for i in (0..n).filter(|i| moving & (1 << i) != 0) {
            let row = &self.scratch.dynamics[i * width..(i + 1) * width];
            let mut effect = [0.0; MAX_OUTPUTS];
            for (j, effect) in effect[..m].iter_mut().enumerate() {
                *effect = (0..3).map(|ago| row[self.places.command(j, ago)]).sum();
            }
            let apart = goal[i] - q[i];
            let apart = if self.ranges.wraps[i] { wrap(apart) } else { apart };
            for r in 0..m {
                add_scaled(&mut normal[packed(r)..packed(r + 1)], effect[r], &effect[..=r]);
                u[r] += effect[r] * apart / CHANGE;
            }
            total += dot(&effect, &effect);
        }
        for r in 0..m {
            normal[packed(r) + r] += 0.01 * total / m as f64;
        }
        if cholesky(&mut normal, m) {
            solve_lower(&normal, u);
            solve_lower_transposed(&normal, u);
        } else {
            u.fill(0.0);
        }
    }
}
