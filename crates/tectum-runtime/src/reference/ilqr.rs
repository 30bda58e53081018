//! Reference controller: control-limited iLQR on the true model (Tassa, Mansard & Todorov 2014).
//!
//! Every tick it plans the next ticks through the plant's own equations and reward, and sends the first command. It
//! knows the true state, in time, whatever the learner is shown. Derivatives are central differences, second order for
//! the reward, first order for the dynamics (Gauss-Newton). The plan of the tick before, shifted by one tick, is
//! improved; a trial begins with rivals: no command, and square waves of several periods. The better one is kept. It
//! is a good controller and no proven optimum: what it reaches is a scale for what learners reach.

use rand::RngExt as _;

use super::small_matrix::Matrix;
use super::true_model::TrueModel;
use crate::plant::MAX_STATES;
use crate::policy::Outputs;
use crate::seed::{Rng, stream};
use tectum_core::MAX_OUTPUTS;
use tectum_core::angle::wrap_f64;

/// Step of the finite differences, in units of a state and of the largest command.
const STEP: f64 = 1e-4;
/// Cost of a squared command, in units of the largest one. It keeps commands small where they do nothing, such as at a
/// stop.
const EFFORT: f64 = 1e-5;
/// Iterations for the first plan of each rival, for the shifted plan, and for the rival of a tick.
const FIRST_ITERATIONS: usize = 25;
const ITERATIONS: usize = 3;
const RIVAL_ITERATIONS: usize = 5;
/// A rival replaces the plan if its cost is lower by this share.
const BETTER: f64 = 0.01;

type State = [f64; MAX_STATES];
type Command = [f64; MAX_OUTPUTS];

/// Commands in units of the largest one, the states that they lead through, and the cost of all.
#[derive(Clone)]
struct Trajectory {
    commands: Vec<Command>,
    /// One more than commands.
    states: Vec<State>,
    cost: f64,
}

/// What a backward pass gives for each tick: a change of the command, and its feedback from the dynamic states.
struct Policy {
    change: Vec<Vec<f64>>,
    feedback: Vec<Matrix>,
}

/// The controller.
pub struct IterativeLqr {
    model: TrueModel,
    limit: f64,
    horizon: usize,
    plan: Option<Trajectory>,
    rng: Rng,
}

impl IterativeLqr {
    /// For commands up to `limit`, with a plan of `horizon` ticks.
    pub fn new(model: TrueModel, limit: f64, horizon: usize, seed: u64) -> Self {
        Self { model, limit, horizon, plan: None, rng: stream(seed, "rivals") }
    }

    /// The command for the true state; `fresh` when a trial begins with it.
    pub fn command(&mut self, state: &[f64], fresh: bool) -> Outputs {
        let mut start = [0.0; MAX_STATES];
        start[..state.len()].copy_from_slice(state);
        let mut best = match self.plan.take().filter(|_| !fresh) {
            Some(plan) => {
                let mut commands = plan.commands;
                commands.rotate_left(1);
                commands[self.horizon - 1] = [0.0; MAX_OUTPUTS];
                self.improved(self.rolled_out(&start, commands), ITERATIONS)
            }
            None => {
                let mut best =
                    self.improved(self.rolled_out(&start, vec![[0.0; MAX_OUTPUTS]; self.horizon]), FIRST_ITERATIONS);
                for rival in self.first_rivals() {
                    let rival = self.improved(self.rolled_out(&start, rival), FIRST_ITERATIONS);
                    if rival.cost < best.cost {
                        best = rival;
                    }
                }
                best
            }
        };
        let rival = self.square_wave();
        let rival = self.improved(self.rolled_out(&start, rival), RIVAL_ITERATIONS);
        if rival.cost < best.cost - BETTER * best.cost.abs() {
            best = self.improved(rival, ITERATIONS);
        }
        let command = best.commands[0].map(|command| (self.limit * command) as f32);
        self.plan = Some(best);
        command
    }

    /// Square waves for the beginning of a trial.
    fn first_rivals(&mut self) -> Vec<Vec<Command>> {
        (0..12).map(|_| self.square_wave()).collect()
    }

    /// Commands that change their sign at a random period and phase, in one output or in all.
    fn square_wave(&mut self) -> Vec<Command> {
        let outputs = self.model.commands();
        let mut commands = vec![[0.0; MAX_OUTPUTS]; self.horizon];
        for output in 0..outputs {
            let period = 2.0 + 38.0 * self.rng.random::<f64>();
            let phase = self.rng.random::<f64>();
            let size = if outputs == 1 { 1.0 } else { 0.3 * self.rng.random::<f64>() };
            for (t, command) in commands.iter_mut().enumerate() {
                let up = libm::floor(2.0 * (t as f64 / period + phase)) % 2.0 == 0.0;
                command[output] = if up { size } else { -size };
            }
        }
        commands
    }

    /// Advances `state` by a tick and returns its cost.
    fn step(&self, state: &mut State, command: &Command) -> f64 {
        let (states, outputs) = (self.model.states(), self.model.commands());
        let mut scaled = *command;
        scaled.iter_mut().for_each(|u| *u *= self.limit);
        let effort: f64 = command[..outputs].iter().map(|u| u * u).sum();
        EFFORT * effort - self.model.step(&mut state[..states], &scaled[..outputs])
    }

    fn rolled_out(&self, start: &State, commands: Vec<Command>) -> Trajectory {
        let mut states = Vec::with_capacity(self.horizon + 1);
        let (mut state, mut cost) = (*start, 0.0);
        states.push(state);
        for command in &commands {
            cost += self.step(&mut state, command);
            states.push(state);
        }
        Trajectory { commands, states, cost }
    }

    /// The trajectory after so many iterations, or until one finds no improvement.
    fn improved(&self, mut trajectory: Trajectory, iterations: usize) -> Trajectory {
        let mut ridge = 1e-6;
        for _ in 0..iterations {
            let policy = self.backward(&trajectory, ridge);
            let tried = [1.0, 0.5, 0.25, 0.1, 0.03].map(|share| (share, &policy));
            let better = tried.into_iter().map(|(share, policy)| self.forward(&trajectory, policy, share));
            match better.into_iter().find(|new| new.cost < trajectory.cost - 1e-9 * trajectory.cost.abs()) {
                Some(new) => {
                    let gain = trajectory.cost - new.cost;
                    trajectory = new;
                    ridge = (ridge * 0.2_f64).max(1e-8);
                    if gain < 1e-6 * trajectory.cost.abs() {
                        break;
                    }
                }
                None if ridge > 1e2 => break,
                None => ridge = (ridge * 30.0_f64).max(1e-4),
            }
        }
        trajectory
    }

    /// Follows a policy from the trajectory's start.
    fn forward(&self, trajectory: &Trajectory, policy: &Policy, share: f64) -> Trajectory {
        let (dynamic, outputs) = (self.model.dynamic_states(), self.model.commands());
        let (mut state, mut cost) = (trajectory.states[0], 0.0);
        let (mut states, mut commands) = (vec![state], Vec::with_capacity(self.horizon));
        for t in 0..self.horizon {
            let deviation: Vec<f64> =
                (0..dynamic).map(|i| self.difference(i, state[i], trajectory.states[t][i])).collect();
            let feedback = policy.feedback[t].apply(&deviation);
            let mut command = trajectory.commands[t];
            for i in 0..outputs {
                command[i] = (command[i] + share * policy.change[t][i] + feedback[i]).clamp(-1.0, 1.0);
            }
            cost += self.step(&mut state, &command);
            states.push(state);
            commands.push(command);
        }
        Trajectory { commands, states, cost }
    }

    fn difference(&self, i: usize, a: f64, b: f64) -> f64 {
        if self.model.wraps(i) { wrap_f64(a - b) } else { a - b }
    }

    /// The best change and feedback for each tick, from the last one back.
    fn backward(&self, trajectory: &Trajectory, ridge: f64) -> Policy {
        let (dynamic, outputs) = (self.model.dynamic_states(), self.model.commands());
        let (mut value, mut curvature) = (vec![0.0; dynamic], Matrix::zero(dynamic, dynamic));
        let mut policy =
            Policy { change: vec![Vec::new(); self.horizon], feedback: vec![Matrix::zero(0, 0); self.horizon] };
        for t in (0..self.horizon).rev() {
            let (gradient, mut hessian, jacobian) = self.derivatives(&trajectory.states[t], &trajectory.commands[t]);
            // The cost to go as a function of state and command together.
            let through = jacobian.apply_transposed(&value);
            let q: Vec<f64> = gradient.iter().zip(through).map(|(a, b)| a + b).collect();
            hessian.add(&jacobian.transposed_times(&curvature.times(&jacobian)));
            let (change, feedback) = self.best_change(&q, &hessian, &trajectory.commands[t], ridge);
            (value, curvature) = value_before(&q, &hessian, &change, &feedback, (dynamic, outputs));
            policy.change[t] = change;
            policy.feedback[t] = feedback;
        }
        policy
    }

    /// The command's change within its limits that minimises the quadratic cost, and the feedback of outputs that are
    /// not at a limit.
    fn best_change(&self, q: &[f64], hessian: &Matrix, command: &Command, ridge: f64) -> (Vec<f64>, Matrix) {
        let (dynamic, outputs) = (self.model.dynamic_states(), self.model.commands());
        let block = |i: usize, j: usize| hessian[(dynamic + i, dynamic + j)] + if i == j { ridge } else { 0.0 };
        let mut change = vec![0.0; outputs];
        let mut free: Vec<usize> = (0..outputs).collect();
        // Outputs that the unlimited solution drives beyond a limit are put there, until none is.
        for _ in 0..=outputs {
            let solution = solve_free(&free, &change, block, &q[dynamic..]);
            let Some(solution) = solution else { break };
            let mut limited = false;
            for (&i, wanted) in free.iter().zip(&solution) {
                let within = wanted.clamp(-1.0 - command[i], 1.0 - command[i]);
                limited |= within != *wanted;
                change[i] = within;
            }
            if !limited {
                break;
            }
            free.retain(|&i| change[i] > -1.0 - command[i] && change[i] < 1.0 - command[i]);
        }
        let mut feedback = Matrix::zero(outputs, dynamic);
        for state in 0..dynamic {
            let coupling: Vec<f64> = (0..outputs).map(|i| hessian[(dynamic + i, state)]).collect();
            let still = vec![0.0; outputs];
            if let Some(column) = solve_free(&free, &still, block, &coupling) {
                free.iter().zip(column).for_each(|(&i, value)| feedback[(i, state)] = value);
            }
        }
        (change, feedback)
    }

    /// Gradient and Hessian of the cost, by state and command together, the Hessian without negative eigenvalues; and
    /// the Jacobian of the next state.
    fn derivatives(&self, state: &State, command: &Command) -> (Vec<f64>, Matrix, Matrix) {
        let (dynamic, outputs) = (self.model.dynamic_states(), self.model.commands());
        let n = dynamic + outputs;
        let cost_at = |changes: &[(usize, f64)]| {
            let (mut state, mut command) = (*state, *command);
            for &(i, change) in changes {
                if i < dynamic { state[i] += change } else { command[i - dynamic] += change }
            }
            let cost = self.step(&mut state, &command);
            (cost, state)
        };
        let (here, _) = cost_at(&[]);
        let (mut gradient, mut hessian) = (vec![0.0; n], Matrix::zero(n, n));
        let mut jacobian = Matrix::zero(dynamic, n);
        let mut ahead = vec![0.0; n];
        for i in 0..n {
            let ((plus, next), (minus, last)) = (cost_at(&[(i, STEP)]), cost_at(&[(i, -STEP)]));
            ahead[i] = plus;
            gradient[i] = (plus - minus) / (2.0 * STEP);
            hessian[(i, i)] = (plus - 2.0 * here + minus) / (STEP * STEP);
            for row in 0..dynamic {
                jacobian[(row, i)] = self.difference(row, next[row], last[row]) / (2.0 * STEP);
            }
        }
        for i in 0..n {
            for j in 0..i {
                let (both, _) = cost_at(&[(i, STEP), (j, STEP)]);
                let mixed = (both - ahead[i] - ahead[j] + here) / (STEP * STEP);
                (hessian[(i, j)], hessian[(j, i)]) = (mixed, mixed);
            }
        }
        (gradient, hessian.without_negative_eigenvalues(), jacobian)
    }
}

/// The changes of the `free` outputs that make the gradient zero, with the other changes as given.
fn solve_free(
    free: &[usize],
    change: &[f64],
    block: impl Fn(usize, usize) -> f64,
    gradient: &[f64],
) -> Option<Vec<f64>> {
    let mut matrix = Matrix::zero(free.len(), free.len());
    let mut right = vec![0.0; free.len()];
    for (row, &i) in free.iter().enumerate() {
        for (column, &j) in free.iter().enumerate() {
            matrix[(row, column)] = block(i, j);
        }
        let others = (0..change.len()).filter(|j| !free.contains(j)).map(|j| block(i, j) * change[j]).sum::<f64>();
        right[row] = -gradient[i] - others;
    }
    matrix.solve(&right)
}

/// Gradient and curvature of the cost to go before a tick.
fn value_before(
    q: &[f64],
    hessian: &Matrix,
    change: &[f64],
    feedback: &Matrix,
    (dynamic, outputs): (usize, usize),
) -> (Vec<f64>, Matrix) {
    // State and command follow from the state: z = z0 + [I; K] x.
    let mut follow = Matrix::zero(dynamic + outputs, dynamic);
    let mut shift = vec![0.0; dynamic + outputs];
    for i in 0..dynamic {
        follow[(i, i)] = 1.0;
        for output in 0..outputs {
            follow[(dynamic + output, i)] = feedback[(output, i)];
        }
    }
    shift[dynamic..].copy_from_slice(change);
    let gradient: Vec<f64> = q.iter().zip(hessian.apply(&shift)).map(|(a, b)| a + b).collect();
    let mut curvature = follow.transposed_times(&hessian.times(&follow));
    curvature.make_symmetric();
    (follow.apply_transposed(&gradient), curvature)
}

#[cfg(test)]
mod tests {
    use super::super::true_model::body_model;
    use super::*;
    use crate::plant::task::Task;

    fn mean_reward(name: &str, start: &[f64], ticks: usize, horizon: usize) -> (f64, Vec<f64>) {
        let task = Task::named(name).unwrap();
        let (model, copy) = (body_model(&task, 0).unwrap(), body_model(&task, 0).unwrap());
        let mut controller = IterativeLqr::new(model, task.max_command, horizon, 1);
        let mut state = start.to_vec();
        let mut sum = 0.0;
        for tick in 0..ticks {
            let command = controller.command(&state, tick == 0).map(f64::from);
            sum += copy.step(&mut state, &command[..copy.commands()]);
        }
        (sum / ticks as f64, state)
    }

    #[test]
    fn the_point_mass_goes_to_its_target() {
        let (_, state) = mean_reward("point-mass", &[0.0, 0.0, 0.0, 0.0, 0.5, -0.7], 80, 20);
        assert!((state[0] - 0.5).abs() < 0.02 && (state[1] + 0.7).abs() < 0.02, "{state:?}");
    }

    #[test]
    fn the_pendulum_swings_up() {
        let (reward, state) = mean_reward("pendulum", &[3.13, 0.0], 120, 40);
        assert!(state[0].abs() < 0.05 && state[1].abs() < 0.1, "{state:?} {reward}");
    }
}
