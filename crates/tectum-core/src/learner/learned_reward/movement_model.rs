//! The movement model: the effect of commands on the inputs that they move.
//!
//! `change = B u`. The matrix is learned by recursive least squares with forgetting, with one covariance for
//! all rows. The row of a blocked joint goes to 0. Movements have almost no noise, so an error of more than
//! three hundredths of the usual movement shows that the plant has changed. The covariance is then reset to the
//! prior, and as many ticks as there are outputs determine the new matrix.

use crate::policy::Outputs;
use crate::state::{Persist, StateVisitor};
use crate::{MAX_INPUTS, MAX_OUTPUTS};

/// Forgetting factor per tick.
const FORGETTING: f64 = 0.98;
/// The prior variance of an entry, in units of the inverse variance of the exploration.
const PRIOR: f64 = 1e4;
/// Squared error, relative to the mean squared change, above which the plant counts as changed.
const CHANGE_THRESHOLD: f64 = 1e-3;
/// The same threshold in multiples of the recent mean squared error, for plants whose movements always have errors.
const OUTLIER_RATIO: f64 = 100.0;
/// Time constant of the recent mean squared error, ticks.
const ERROR_WINDOW: f64 = 400.0;
/// An input whose largest gain is below this fraction of the largest of all does not move.
const MIN_GAIN_RATIO: f32 = 0.02;

/// What a movement tells.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum MovementVerdict {
    /// It was as expected, or the model has learned from it.
    Usual,
    /// The plant seems to have changed.
    Changed,
    /// A new target began, and something else than the command has moved the inputs. Nothing was learned.
    Unrelated,
}

/// The movement model.
#[derive(Debug, Clone)]
pub(super) struct MovementModel {
    outputs: usize,
    moved: usize,
    /// By moved input: the gain of each output.
    pub gains: [Outputs; MAX_INPUTS],
    covariance: [[f64; MAX_OUTPUTS]; MAX_OUTPUTS],
    prior: f64,
    /// Running mean of the squared change.
    mean_square_change: f64,
    /// Running mean of the largest squared error.
    mean_square_error: f64,
    /// Number of ticks learned from.
    ticks: usize,
    /// Ticks since the covariance was reset.
    ticks_since_reset: usize,
}

impl MovementModel {
    /// A model with all gains 0 for `outputs` outputs, explored with standard deviation `sigma`, and `moved`
    /// moved inputs.
    pub fn new(outputs: usize, moved: usize, sigma: f64) -> Self {
        let prior = PRIOR / (sigma * sigma);
        let mut model = Self {
            outputs,
            moved,
            gains: [[0.0; MAX_OUTPUTS]; MAX_INPUTS],
            covariance: [[0.0; MAX_OUTPUTS]; MAX_OUTPUTS],
            prior,
            mean_square_change: 0.0,
            mean_square_error: 0.0,
            ticks: 0,
            ticks_since_reset: 0,
        };
        model.reset_covariance();
        model
    }

    /// Whether enough ticks were learned from to determine the matrix.
    pub fn ready(&self) -> bool {
        self.ticks > self.outputs
    }

    /// Whether commands still move moved input `i`, compared with the others.
    pub fn moves(&self, i: usize) -> bool {
        let size = |row: &Outputs| row.iter().map(|b| b.abs()).fold(0.0, f32::max);
        let largest = self.gains[..self.moved].iter().map(size).fold(0.0, f32::max);
        size(&self.gains[i]) > MIN_GAIN_RATIO * largest
    }

    /// Resets the covariance to the prior.
    fn reset_covariance(&mut self) {
        self.ticks_since_reset = 0;
        self.covariance = [[0.0; MAX_OUTPUTS]; MAX_OUTPUTS];
        for i in 0..self.outputs {
            self.covariance[i][i] = self.prior;
        }
    }

    /// The largest squared error of the model's prediction.
    fn largest_error(&self, applied: &Outputs, changes: &[f32]) -> f64 {
        let rows = self.gains.iter().zip(changes).take(self.moved);
        let errors = rows.map(|(row, change)| f64::from(change - predicted(row, applied)));
        errors.map(|error| error * error).fold(0.0, f64::max)
    }

    /// The squared error above which the plant counts as changed.
    fn largest_usual_error(&self) -> f64 {
        CHANGE_THRESHOLD * self.mean_square_change + OUTLIER_RATIO * self.mean_square_error
    }

    /// Learns that `applied` changed the moved inputs by `changes`. With `new_target` a new target began, and
    /// changes that contradict the model, or come before there is one, are not the command's.
    pub fn learn(&mut self, applied: &Outputs, changes: &[f32], new_target: bool) -> MovementVerdict {
        let known = self.ticks_since_reset >= self.outputs;
        if new_target && !(known && self.largest_error(applied, changes) <= self.largest_usual_error()) {
            return MovementVerdict::Unrelated;
        }
        let n = self.outputs;
        let mut gain = [0.0; MAX_OUTPUTS];
        let mut scale = FORGETTING;
        for (i, gain) in gain.iter_mut().enumerate().take(n) {
            *gain = (0..n).map(|j| self.covariance[i][j] * f64::from(applied[j])).sum();
            scale += *gain * f64::from(applied[i]);
        }
        let mut worst = 0.0_f64;
        let mut square = 0.0;
        for (row, &change) in self.gains.iter_mut().zip(changes).take(self.moved) {
            let error = f64::from(change - predicted(row, applied));
            for (b, g) in row.iter_mut().zip(gain) {
                *b += (g / scale * error) as f32;
            }
            worst = worst.max(error * error);
            square += f64::from(change * change) / self.moved as f64;
        }
        for i in 0..n {
            for j in 0..=i {
                let remaining = (self.covariance[i][j] - gain[i] * gain[j] / scale) / FORGETTING;
                (self.covariance[i][j], self.covariance[j][i]) = (remaining, remaining);
            }
            // Without excitation, forgetting would let the covariance grow without limit.
            self.covariance[i][i] = self.covariance[i][i].clamp(0.0, 2.0 * self.prior);
        }
        self.ticks_since_reset += 1;
        // After a reset, errors mean nothing until as many ticks as there are outputs have been learned from.
        let settled = self.ticks_since_reset > self.outputs;
        let threshold = CHANGE_THRESHOLD * self.mean_square_change;
        let changed = settled && worst > threshold + OUTLIER_RATIO * self.mean_square_error;
        if changed {
            self.reset_covariance();
            // Repeated alarms raise the threshold: such errors are then normal for this plant.
            self.mean_square_error = 4.0 * self.mean_square_error + threshold / OUTLIER_RATIO;
        } else if settled {
            self.mean_square_error += (worst - self.mean_square_error) / ERROR_WINDOW;
        }
        self.ticks += 1;
        self.mean_square_change += (square - self.mean_square_change) / self.ticks.min(100) as f64;
        if changed { MovementVerdict::Changed } else { MovementVerdict::Usual }
    }
}

/// The change that `applied` makes by the gains in `row`.
fn predicted(row: &Outputs, applied: &Outputs) -> f32 {
    row.iter().zip(applied).map(|(b, u)| b * u).sum()
}

impl Persist for MovementModel {
    fn visit_state(&mut self, visitor: &mut dyn StateVisitor) {
        visitor.numbers("gains", &mut self.gains);
        visitor.numbers("covariance", &mut self.covariance);
        visitor.number("usual", &mut self.mean_square_change);
        visitor.number("errors", &mut self.mean_square_error);
        let mut counts = [self.ticks as u64, self.ticks_since_reset as u64];
        visitor.numbers("counts", &mut counts);
        [self.ticks, self.ticks_since_reset] = counts.map(|n| n as usize);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::policy::Exploration;

    #[test]
    fn a_blocked_joint_is_detected_within_a_few_ticks() {
        let mut model = MovementModel::new(4, 4, 0.003);
        let mut exploration = Exploration::new(3, 0.003, 4);
        let mut simulate = |model: &mut MovementModel, ticks: usize, gains: [f32; 4]| {
            for _ in 0..ticks {
                let u = exploration.draw();
                let changes: [f32; 4] = std::array::from_fn(|j| gains[j] * u[j]);
                model.learn(&u, &changes, false);
            }
        };
        for gains in [[31.4; 4], [31.4, 31.4, 0.0, 31.4], [31.4, -20.0, 0.0, 31.4]] {
            simulate(&mut model, 16, gains);
            for (i, gain) in gains.iter().enumerate() {
                for j in 0..4 {
                    let expected = if i == j { *gain } else { 0.0 };
                    assert!((model.gains[i][j] - expected).abs() < 1.0, "{i} {j}: {}", model.gains[i][j]);
                }
                assert_eq!(model.moves(i), *gain != 0.0, "{i}");
            }
        }
        simulate(&mut model, 100_000, [31.4; 4]);
        assert!((model.gains[2][2] - 31.4).abs() < 0.1);
    }

    #[test]
    fn a_plant_with_inexact_movements_has_not_changed() {
        let mut model = MovementModel::new(4, 4, 0.003);
        let mut exploration = Exploration::new(3, 0.003, 4);
        let mut simulate = |model: &mut MovementModel, ticks: usize, gains: [f32; 4]| {
            let mut alarms = 0;
            for _ in 0..ticks {
                let (u, noise) = (exploration.draw(), exploration.draw());
                // A fifth of each movement is error.
                let changes: [f32; 4] = std::array::from_fn(|j| gains[j] * u[j] + 6.0 * noise[j]);
                alarms += usize::from(model.learn(&u, &changes, false) == MovementVerdict::Changed);
            }
            alarms
        };
        assert!(simulate(&mut model, 3000, [31.4; 4]) < 10);
        assert_eq!(simulate(&mut model, 3000, [31.4; 4]), 0, "the errors are normal by now");
        // A joint that turns in the other direction ten times as fast is still detected as a change.
        assert!(simulate(&mut model, 100, [31.4, -314.0, 31.4, 31.4]) > 0);
    }
}
