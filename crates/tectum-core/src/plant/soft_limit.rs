//! A joint's stop as MuJoCo computes it: a spring and damper that act on the joint's acceleration.
//!
//! MuJoCo solves for the forces of all active constraints together. The models here have one limited joint, so that
//! the solution has a closed form: `f = max(0, (a_ref - a_0) / (A + R))` with the acceleration `a_0` without the
//! stop, the inverse inertia `A` at the joint, and the regularisation `R`. Source: MuJoCo documentation, chapter
//! "Computation", sections "Constraint model" and "Solver parameters", with the default `solimp`.

/// MuJoCo's default impedance: least, greatest, and the width over which it grows (midpoint 0.5, power 2).
const IMPEDANCE: [f64; 3] = [0.9, 0.95, 0.001];

/// The stops of one joint.
#[derive(Debug, Clone, Copy)]
pub(super) struct SoftLimit {
    /// Least and greatest position.
    pub range: [f64; 2],
    /// First number of `solreflimit`, s; its damping ratio is 1.
    pub time_constant: f64,
    /// Inverse inertia of the joint in the model's zero posture (`dof_invweight0`).
    pub inverse_weight: f64,
}

impl SoftLimit {
    /// The force on the joint, for its position, velocity and acceleration `free` without the stop, and its inverse
    /// inertia now. Positive towards greater positions; 0 within the range.
    pub fn force(&self, position: f64, velocity: f64, free: f64, inverse_inertia: f64) -> f64 {
        let (below, above) = (position - self.range[0], self.range[1] - position);
        if below < 0.0 {
            self.push(below, velocity, free, inverse_inertia)
        } else if above < 0.0 {
            -self.push(above, -velocity, -free, inverse_inertia)
        } else {
            0.0
        }
    }

    /// The force along the direction in which `distance`, negative beyond the stop, grows.
    fn push(&self, distance: f64, velocity: f64, free: f64, inverse_inertia: f64) -> f64 {
        let [_, greatest, _] = IMPEDANCE;
        let stiffness = 1.0 / (greatest * self.time_constant).powi(2);
        let damping = 2.0 / (greatest * self.time_constant);
        let impedance = impedance(distance);
        let reference = -damping * velocity - stiffness * impedance * distance;
        let regularisation = self.inverse_weight * (1.0 - impedance) / impedance;
        ((reference - free) / (inverse_inertia + regularisation)).max(0.0)
    }
}

fn impedance(distance: f64) -> f64 {
    let [least, greatest, width] = IMPEDANCE;
    let x = (distance.abs() / width).min(1.0);
    let share = if x <= 0.5 { 2.0 * x * x } else { 1.0 - 2.0 * (1.0 - x) * (1.0 - x) };
    least + share * (greatest - least)
}
