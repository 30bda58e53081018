//! The movement model: how the inputs that commands move answer to commands.
//!
//! `change = B u`, a matrix learned by recursive least squares with forgetting, one covariance for all rows. A joint that
//! blocks shows as a row that goes to 0 by itself. Since a body moves without noise to speak of, an error beyond three
//! hundredths of the usual movement means that the body has changed: uncertainty is then put back, and as many ticks as there are
//! outputs tell the new matrix.

use crate::policy::Outputs;
use crate::state::{Persist, StateVisitor};
use crate::{MAX_INPUTS, MAX_OUTPUTS};

/// What is kept of the past in a tick.
const KEPT: f64 = 0.98;
/// The prior variance of an entry, in units of the inverse variance of the exploration.
const PRIOR: f64 = 1e4;
/// Square of the error, relative to the usual movement, at which the body counts as changed.
const CHANGED: f64 = 1e-3;
/// The same in mean squared errors of late: a body that is never quite where it is expected has not changed for that.
const UNUSUAL: f64 = 100.0;
/// Ticks over which that mean is taken.
const LATE: f64 = 400.0;
/// An input whose answer is below this share of the largest one does not move.
const STUCK: f32 = 0.02;

/// The movement model.
#[derive(Debug, Clone)]
pub(super) struct MovementModel {
    outputs: usize,
    moved: usize,
    /// By moved input: the answer to each output.
    pub gains: [Outputs; MAX_INPUTS],
    covariance: [[f64; MAX_OUTPUTS]; MAX_OUTPUTS],
    prior: f64,
    /// Running mean of the squared change.
    usual: f64,
    /// Running mean of the largest squared error.
    errors: f64,
    seen: usize,
    /// Ticks since uncertainty was put back.
    since: usize,
}

impl MovementModel {
    /// Knows nothing of how `outputs` outputs, explored with standard deviation `sigma`, move `moved` inputs.
    pub fn new(outputs: usize, moved: usize, sigma: f64) -> Self {
        let prior = PRIOR / (sigma * sigma);
        let mut model = Self {
            outputs,
            moved,
            gains: [[0.0; MAX_OUTPUTS]; MAX_INPUTS],
            covariance: [[0.0; MAX_OUTPUTS]; MAX_OUTPUTS],
            prior,
            usual: 0.0,
            errors: 0.0,
            seen: 0,
            since: 0,
        };
        model.doubt();
        model
    }

    /// Whether there were enough ticks to tell the matrix.
    pub fn ready(&self) -> bool {
        self.seen > self.outputs
    }

    /// Whether commands move moved input `i`, in comparison with the others.
    pub fn moves(&self, i: usize) -> bool {
        let size = |row: &Outputs| row.iter().map(|b| b.abs()).fold(0.0, f32::max);
        let most = self.gains[..self.moved].iter().map(size).fold(0.0, f32::max);
        size(&self.gains[i]) > STUCK * most
    }

    /// Puts uncertainty back.
    fn doubt(&mut self) {
        self.since = 0;
        self.covariance = [[0.0; MAX_OUTPUTS]; MAX_OUTPUTS];
        for i in 0..self.outputs {
            self.covariance[i][i] = self.prior;
        }
    }

    /// Learns that `applied` changed the moved inputs by `changes`. Returns whether the body seems to have changed.
    pub fn learn(&mut self, applied: &Outputs, changes: &[f32]) -> bool {
        let n = self.outputs;
        let mut gain = [0.0; MAX_OUTPUTS];
        let mut scale = KEPT;
        for (i, gain) in gain.iter_mut().enumerate().take(n) {
            *gain = (0..n).map(|j| self.covariance[i][j] * f64::from(applied[j])).sum();
            scale += *gain * f64::from(applied[i]);
        }
        let mut worst = 0.0_f64;
        let mut square = 0.0;
        for (row, &change) in self.gains.iter_mut().zip(changes).take(self.moved) {
            let expected: f32 = row.iter().zip(applied).map(|(b, u)| b * u).sum();
            let error = f64::from(change - expected);
            for (b, g) in row.iter_mut().zip(gain) {
                *b += (g / scale * error) as f32;
            }
            worst = worst.max(error * error);
            square += f64::from(change * change) / self.moved as f64;
        }
        for i in 0..n {
            for j in 0..=i {
                let left = (self.covariance[i][j] - gain[i] * gain[j] / scale) / KEPT;
                (self.covariance[i][j], self.covariance[j][i]) = (left, left);
            }
            // Without excitation forgetting would blow the covariance up.
            self.covariance[i][i] = self.covariance[i][i].clamp(0.0, 2.0 * self.prior);
        }
        self.since += 1;
        // Once it has doubted, as many ticks as there are outputs must be heard out.
        let heard = self.since > self.outputs;
        let least = CHANGED * self.usual;
        let changed = heard && worst > least + UNUSUAL * self.errors;
        if changed {
            self.doubt();
            // Alarms that come again and again are the body's way.
            self.errors = 4.0 * self.errors + least / UNUSUAL;
        } else if heard {
            self.errors += (worst - self.errors) / LATE;
        }
        self.seen += 1;
        self.usual += (square - self.usual) / self.seen.min(100) as f64;
        changed
    }
}

impl Persist for MovementModel {
    fn visit_state(&mut self, visitor: &mut dyn StateVisitor) {
        visitor.numbers("gains", &mut self.gains);
        visitor.numbers("covariance", &mut self.covariance);
        visitor.number("usual", &mut self.usual);
        visitor.number("errors", &mut self.errors);
        let mut counts = [self.seen as u64, self.since as u64];
        visitor.numbers("counts", &mut counts);
        [self.seen, self.since] = counts.map(|n| n as usize);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::policy::Exploration;

    #[test]
    fn a_blocked_joint_is_known_within_a_few_ticks() {
        let mut model = MovementModel::new(4, 4, 0.003);
        let mut exploration = Exploration::new(3, 0.003, 4);
        let mut live = |model: &mut MovementModel, ticks: usize, gains: [f32; 4]| {
            for _ in 0..ticks {
                let u = exploration.draw();
                let changes: [f32; 4] = std::array::from_fn(|j| gains[j] * u[j]);
                model.learn(&u, &changes);
            }
        };
        for gains in [[31.4; 4], [31.4, 31.4, 0.0, 31.4], [31.4, -20.0, 0.0, 31.4]] {
            live(&mut model, 16, gains);
            for (i, gain) in gains.iter().enumerate() {
                for j in 0..4 {
                    let expected = if i == j { *gain } else { 0.0 };
                    assert!((model.gains[i][j] - expected).abs() < 1.0, "{i} {j}: {}", model.gains[i][j]);
                }
                assert_eq!(model.moves(i), *gain != 0.0, "{i}");
            }
        }
        live(&mut model, 100_000, [31.4; 4]);
        assert!((model.gains[2][2] - 31.4).abs() < 0.1);
    }

    #[test]
    fn a_body_that_is_never_quite_where_it_is_expected_has_not_changed() {
        let mut model = MovementModel::new(4, 4, 0.003);
        let mut exploration = Exploration::new(3, 0.003, 4);
        let mut live = |model: &mut MovementModel, ticks: usize, gains: [f32; 4]| {
            let mut alarms = 0;
            for _ in 0..ticks {
                let (u, noise) = (exploration.draw(), exploration.draw());
                // A fifth of each movement is not as it was asked for.
                let changes: [f32; 4] = std::array::from_fn(|j| gains[j] * u[j] + 6.0 * noise[j]);
                alarms += usize::from(model.learn(&u, &changes));
            }
            alarms
        };
        assert!(live(&mut model, 3000, [31.4; 4]) < 10);
        assert_eq!(live(&mut model, 3000, [31.4; 4]), 0, "it knows that by now");
        // A joint that turns the other way ten times as fast is another body all the same.
        assert!(live(&mut model, 100, [31.4, -314.0, 31.4, 31.4]) > 0);
    }
}
