//! Reference controller for pendulums: energy swing-up (Åström & Furuta 2000), and a linear-quadratic regulator near
//! the top.
//!
//! Below, the command works with the swing until the pendulum has the energy that it has at rest at the top. Near the
//! top, the regulator of the true model, linearised there, takes over.

use super::small_matrix::Matrix;
use super::true_model::TrueModel;
use crate::plant::{BodyConfig, MAX_STATES};
use crate::policy::Outputs;
use tectum_core::MAX_OUTPUTS;
use tectum_core::angle::wrap_f64;

/// Step of the finite differences.
const STEP: f64 = 1e-5;
/// Steps of the Riccati iteration; it has converged long before.
const RICCATI_STEPS: usize = 5000;

/// The kinds of pendulum.
#[derive(Debug, Clone, Copy)]
enum Swing {
    Pendulum,
    CartPole,
    Furuta,
}

/// The controller.
pub struct EnergySwingUp {
    swing: Swing,
    limit: f64,
    /// Feedback from the state near the top.
    gains: Vec<f64>,
}

impl EnergySwingUp {
    /// For a body that is a pendulum, with its true model and commands up to `limit`; `None` for another body.
    pub fn new(body: &BodyConfig, model: &TrueModel, limit: f64) -> Option<Self> {
        let (swing, weights): (_, &[f64]) = match body {
            BodyConfig::Pendulum(_) => (Swing::Pendulum, &[1.0, 0.1]),
            BodyConfig::CartPole(_) => (Swing::CartPole, &[1.0, 10.0, 0.1, 0.1]),
            BodyConfig::Furuta(_) => (Swing::Furuta, &[1.0, 10.0, 0.01, 0.01]),
            _ => return None,
        };
        Some(Self { swing, limit, gains: regulator(model, weights)? })
    }

    /// The command for the true state.
    pub fn command(&self, state: &[f64]) -> Outputs {
        let (angle, rate) = match self.swing {
            Swing::Pendulum => (state[0], state[1]),
            Swing::CartPole | Swing::Furuta => (state[1], state[3]),
        };
        let balance = -self.gains.iter().zip(state).map(|(gain, x)| gain * x).sum::<f64>();
        let [near, slow] = match self.swing {
            Swing::Pendulum => [0.35, 2.0],
            Swing::CartPole => [0.4, 4.0],
            Swing::Furuta => [0.35, 8.0],
        };
        let command = if angle.abs() < near && rate.abs() < slow { balance } else { self.pump(state, angle, rate) };
        let mut commands = [0.0; MAX_OUTPUTS];
        commands[0] = command.clamp(-self.limit, self.limit) as f32;
        commands
    }

    /// The command that brings the energy towards that of the top.
    fn pump(&self, state: &[f64], angle: f64, rate: f64) -> f64 {
        let sign = |x: f64| if x >= 0.0 { 1.0 } else { -1.0 };
        // Energy over the inertia about the hinge, 0 at rest at the top: 1.5 g / length is that of a rod.
        let energy = |stiffness: f64| 0.5 * rate * rate + stiffness * (libm::cos(angle) - 1.0);
        match self.swing {
            Swing::Pendulum => -energy(15.0) * sign(rate),
            Swing::CartPole => 0.15 * energy(14.3) * sign(rate * libm::cos(angle)) - 0.2 * state[0] - 0.1 * state[2],
            Swing::Furuta => -0.02 * energy(114.0) * sign(rate * libm::cos(angle)),
        }
    }
}

/// The gains of the linear-quadratic regulator at the top, for weights of the squared states and a small one of the
/// squared command.
fn regulator(model: &TrueModel, weights: &[f64]) -> Option<Vec<f64>> {
    let n = model.dynamic_states();
    let (mut a, mut b) = (Matrix::zero(n, n), Matrix::zero(n, 1));
    for i in 0..=n {
        let [ahead, behind] = [STEP, -STEP].map(|change| {
            let mut state = [0.0; MAX_STATES];
            let mut command = [0.0];
            if i < n {
                state[i] = change
            } else {
                command[0] = change
            }
            model.step(&mut state[..model.states()], &command);
            state
        });
        for row in 0..n {
            let slope = wrap_f64(ahead[row] - behind[row]) / (2.0 * STEP);
            if i < n { a[(row, i)] = slope } else { b[(row, 0)] = slope }
        }
    }
    let mut cost = Matrix::zero(n, n);
    for (i, weight) in weights.iter().enumerate() {
        cost[(i, i)] = *weight;
    }
    let mut value = cost.clone();
    let mut gains = vec![0.0; n];
    for _ in 0..RICCATI_STEPS {
        let ahead = value.times(&b);
        let own = 0.1 + b.transposed_times(&ahead)[(0, 0)];
        let coupling = a.transposed_times(&ahead);
        for i in 0..n {
            gains[i] = coupling[(i, 0)] / own;
        }
        let mut next = a.transposed_times(&value.times(&a));
        next.add(&cost);
        for i in 0..n {
            for j in 0..n {
                next[(i, j)] -= gains[i] * gains[j] * own;
            }
        }
        next.make_symmetric();
        value = next;
    }
    gains.iter().all(|gain| gain.is_finite()).then_some(gains)
}

#[cfg(test)]
mod tests {
    use super::super::true_model::body_model;
    use super::*;
    use crate::plant::task::Task;

    #[test]
    fn every_pendulum_swings_up_and_stays() {
        for (name, start, angle) in [
            ("pendulum", &[3.13, 0.0][..], 0),
            ("cart-pole", &[0.01, 3.13, 0.0, 0.0], 1),
            ("furuta", &[0.01, 3.13, 0.0, 0.0], 1),
        ] {
            let task = Task::named(name).unwrap();
            let model = body_model(&task, 0).unwrap();
            let controller = EnergySwingUp::new(&task.body, &model, task.max_command).unwrap();
            let mut state = start.to_vec();
            let mut up = 0;
            for _ in 0..1000 {
                let command = f64::from(controller.command(&state)[0]);
                model.step(&mut state, &[command]);
                up = if state[angle].abs() < 0.3 { up + 1 } else { 0 };
            }
            assert!(up > 100, "{name}: up for the last {up} ticks of 1000: {state:?}");
        }
    }
}
