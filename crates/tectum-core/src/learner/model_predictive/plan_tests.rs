//! Tests of the plan: against differences, and on a world that is known.

use rand::RngExt as _;

use super::command_limits::CommandLimits;
use super::layout::Places;
use super::planner::{CommandPlan, Planner};
use super::world::World;
use crate::seed::stream;

/// A linear world: two positions with velocities that commands change, and a cost of distance and effort.
struct Linear;

const PLACES: Places = Places { inputs: 2, commands: 2 };
const GOAL: [f64; 2] = [0.8, -0.5];

impl World for Linear {
    fn step(&mut self, q: &[f64], next: &mut [f64]) -> f64 {
        for i in 0..2 {
            next[2 + i] = 0.8 * q[2 + i] + 0.3 * q[8 + i] + 0.05 * q[9 - i];
            next[i] = q[i] + next[2 + i];
        }
        next[4..6].copy_from_slice(&q[8..]);
        next[6..8].copy_from_slice(&q[4..6]);
        -(0..2).map(|i| (q[i] - GOAL[i]).powi(2) + 0.1 * q[8 + i].powi(2)).sum::<f64>()
    }

    fn expand(&mut self, q: &[f64], jacobian: &mut [f64], gradient: &mut [f64], hessian: &mut [f64]) {
        let width = PLACES.len();
        jacobian.fill(0.0);
        gradient.fill(0.0);
        hessian.fill(0.0);
        for i in 0..2 {
            for row in [i, 2 + i] {
                let row = &mut jacobian[row * width..(row + 1) * width];
                (row[2 + i], row[8 + i], row[9 - i]) = (0.8, 0.3, 0.05);
            }
            jacobian[i * width + i] = 1.0;
            jacobian[(4 + i) * width + 8 + i] = 1.0;
            jacobian[(6 + i) * width + 4 + i] = 1.0;
            gradient[i] = -2.0 * (q[i] - GOAL[i]);
            gradient[8 + i] = -0.2 * q[8 + i];
            hessian[i * width + i] = -2.0;
            hessian[(8 + i) * width + 8 + i] = -0.2;
        }
    }

    fn difference(&self, a: &[f64], b: &[f64], out: &mut [f64]) {
        for ((a, b), out) in a.iter().zip(b).zip(out) {
            *out = a - b;
        }
    }
}

/// A planner for commands that change by `step` at most.
fn planner(step: f64) -> Planner {
    Planner::new(PLACES, 12, CommandLimits::new(PLACES, vec![step; PLACES.commands]))
}

#[test]
fn a_linear_world_with_quadratic_rewards_is_solved_within_the_limits() {
    let mut planner = planner(f64::INFINITY);
    let mut plan = CommandPlan::new(PLACES, 12);
    let start = [0.0; 8];
    planner.roll_out(&mut Linear, &mut plan, &start);
    for _ in 0..15 {
        planner.improve(&mut Linear, &mut plan);
    }
    assert!(plan.commands.iter().any(|u| u.abs() == 1.0), "the limits matter here");
    // No single command can be changed for the better: the problem is convex, so this is the optimum.
    let best = plan.value;
    for at in 0..plan.commands.len() {
        let before = plan.commands[at];
        for step in [-1e-4, 1e-4] {
            plan.commands[at] = (before + step).clamp(-1.0, 1.0);
            planner.roll_out(&mut Linear, &mut plan, &start);
            assert!(plan.value < best + 1e-9, "command {at}: {} {best}", plan.value);
        }
        plan.commands[at] = before;
    }
}

#[test]
fn commands_that_may_change_by_steps_only_are_planned_with_these() {
    let mut planner = planner(0.2);
    let mut plan = CommandPlan::new(PLACES, 12);
    let start = [0.0; 8];
    planner.roll_out(&mut Linear, &mut plan, &start);
    for _ in 0..30 {
        planner.improve(&mut Linear, &mut plan);
    }
    let changes = |plan: &CommandPlan| {
        let before = [0.0; 2].iter().chain(&plan.commands);
        plan.commands.iter().zip(before).map(|(u, before)| (u - before).abs()).collect::<Vec<_>>()
    };
    let at_limit = changes(&plan).iter().filter(|change| (**change - 0.2).abs() < 1e-12).count();
    assert!(at_limit > 2 && changes(&plan).iter().all(|change| *change < 0.2 + 1e-12), "{:?}", changes(&plan));
    // The problem is convex: what is worse nearby in all directions is the optimum.
    let (best, commands) = (plan.value, plan.commands.clone());
    let mut rng = stream(3, "directions");
    for _ in 0..2000 {
        for (to, u) in plan.commands.iter_mut().zip(&commands) {
            *to = u + rng.random_range(-1e-3..1e-3);
        }
        planner.roll_out(&mut Linear, &mut plan, &start);
        assert!(plan.value < best + 1e-9, "{} {best}", plan.value);
    }
}

#[test]
fn the_gains_give_the_plan_of_a_disturbed_start() {
    let mut planner = planner(f64::INFINITY);
    let (mut plan, mut other) = (CommandPlan::new(PLACES, 12), CommandPlan::new(PLACES, 12));
    let start = [0.7, -0.4, 0.02, 0.0, 0.0, 0.0, 0.0, 0.0];
    let mut disturbed = start;
    disturbed[0] += 0.01;
    disturbed[3] -= 0.01;
    for (plan, start) in [(&mut plan, &start), (&mut other, &disturbed)] {
        planner.roll_out(&mut Linear, plan, start);
        for _ in 0..15 {
            planner.improve(&mut Linear, plan);
            plan.mu = 1e-9;
        }
        planner.improve(&mut Linear, plan);
    }
    for j in 0..2 {
        let gain = &plan.gains[j * 8..(j + 1) * 8];
        let answered = plan.commands[j] + 0.01 * gain[0] - 0.01 * gain[3];
        assert!((answered - other.commands[j]).abs() < 1e-6, "{answered} {}", other.commands[j]);
    }
}
