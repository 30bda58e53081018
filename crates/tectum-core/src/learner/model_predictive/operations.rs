//! How much work a tick is: operations, which are the same on every machine, in place of time, which is not.
//!
//! An operation is half a nanosecond of one core of the machine on which the prices were taken ([`OPERATIONS_PER_MS`]):
//! about a multiplication with an addition, or a number that is read, where a model is wide and no longer fits into the
//! first level of cache. Learning and refits count theirs themselves. What the planner's steps through the learned
//! world take follows from the sizes of the models. With C components, M Fourier pairs, K nodes of the products' tree,
//! F features, S samples for caution (of a reward), D places of q, A of them in the reward's Hessian, of which m move,
//! U commands and X numbers of a state:
//!
//! ```text
//! row(N)    N + 16                                    a loop over N numbers
//! value     C row(M) + 2 M + 4 K + F / 2
//! caution   S (F / 2 + K)
//! Jacobian  value + (C + D) row(M) + 3 M + 2 K
//! Hessian   Jacobian + caution + 1/4 A^2 row(M) + 9/2 A K
//! step      values of dynamics and reward, and caution
//! expansion Jacobian of the dynamics, Hessian of the reward, 10 m^3 for its eigenvalues, 1/2 A (A + D) row(D) by q,
//!           2/5 (X^2 + D X) row(D) for Q, 5/2 U X row(X) for gains and values
//! ```
//!
//! The prices are those of arms of 2 to 8 joints and of the SO-101: within a third of the time of each, where the
//! plain number of multiplications was as little as 0.6 of it for wide models (docs/performance.md).

use super::dynamics::Dynamics;
use super::layout::Places;
use super::model::Model;

/// Operations that a core makes in a millisecond. A machine that makes fewer takes longer than `budget_ms`; the summary
/// of a run says so.
pub const OPERATIONS_PER_MS: f64 = 2e6;

/// By how many steps what is read for the first time in a tick costs more than later.
const COLD: u64 = 16;

/// The operations of the planner's work: those of one evaluated step, and of one that is expanded.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct StepCost {
    /// One evaluated step.
    pub step: u64,
    expansion: u64,
    /// The reward of a posture.
    pub posture: u64,
    /// The Jacobian of the movement.
    pub movement: u64,
}

/// A loop over `len` numbers.
const fn row(len: u64) -> u64 {
    len + 16
}

/// Operations of a model's value, and of its Jacobian by `width` places.
pub fn of_model(model: &Model, width: u64) -> [u64; 2] {
    let features = &model.fit.features;
    let (waves, products) = (features.pairs as u64, features.nodes.len() as u64);
    let components = model.layout.components as u64;
    let value = components * row(waves) + 2 * waves + 4 * products + features.len as u64 / 2;
    [value, value + (components + width) * row(waves) + 3 * waves + 2 * products]
}

/// Operations of telling how certain a reward is.
fn of_caution(reward: &Model) -> u64 {
    let features = &reward.fit.features;
    let samples = reward.fit.regression.samples as u64 - 1;
    samples * (features.len as u64 / 2 + features.nodes.len() as u64)
}

impl StepCost {
    /// That of a world of these models; the reward's Hessian has `active` places, `moving` of which it is concave in.
    pub fn of(places: Places, dynamics: &Dynamics, reward: &Model, (active, moving): (usize, usize)) -> Self {
        let (width, states, commands) = (places.len() as u64, places.state() as u64, places.commands as u64);
        let (active, moving) = (active as u64, moving as u64);
        let [value, slopes] = of_model(reward, width).map(|cost| cost + of_caution(reward));
        let [move_value, movement] = dynamics
            .models_in_use()
            .map(|model| of_model(model, width))
            .fold([0, 0], |sum, cost| [sum[0] + cost[0], sum[1] + cost[1]]);
        let (waves, products) = (reward.fit.features.pairs as u64, reward.fit.features.nodes.len() as u64);
        let curves = active * active * row(waves) / 4 + 9 * active * products / 2;
        let concave = 10 * moving * moving * moving;
        let by_q = active * (active + width) * row(width) / 2;
        let back = 2 * states * (states + width) * row(width) / 5 + 5 * commands * states * row(states) / 2;
        let expansion = movement + slopes + curves + concave + by_q + back;
        Self { step: move_value + value, expansion, posture: value, movement }
    }

    /// What is read before the first step of a tick: nothing of it is in the caches.
    pub fn first(self) -> u64 {
        COLD * self.step
    }

    /// The operations of some work: numbers of evaluated and of expanded steps.
    fn of_work(self, [steps, expansions]: [u64; 2]) -> u64 {
        self.step * steps + self.expansion * expansions
    }
}

/// What a tick may take, and what it has taken.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct OperationBudget {
    /// Most operations of a tick; `u64::MAX` for no limit.
    pub most: u64,
    /// Operations of this tick so far.
    pub spent: u64,
    /// What the planner's steps take in this tick.
    pub cost: StepCost,
}

impl OperationBudget {
    /// A budget of `millions` of operations; 0 for no limit.
    pub fn new(millions: f64) -> Self {
        Self { most: if millions > 0.0 { (millions * 1e6) as u64 } else { u64::MAX }, ..Self::default() }
    }

    /// How far a plan that is made before the command goes out may go: a quarter of the tick.
    pub fn before_command(&self) -> u64 {
        self.most / 4
    }

    /// What refits may take of the tick: no more than half of what is left, because a plan must follow.
    pub fn for_refits(&self, most: u64) -> u64 {
        most.min(self.most.saturating_sub(self.spent) / 2)
    }

    /// Adds the work of a planner since it was `began`.
    pub fn spend_work(&mut self, began: [u64; 2], work: [u64; 2]) {
        self.spent += self.cost.of_work([work[0] - began[0], work[1] - began[1]]);
    }

    /// Whether an iteration of a plan of `horizon` steps fits, with two trials of how far to go.
    pub fn has_iteration(&self, horizon: usize) -> bool {
        let horizon = horizon as u64;
        self.spent.saturating_add(self.cost.of_work([2 * horizon, horizon])) <= self.most
    }
}

/// What refits may take in a tick, and what they have taken.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct RefitShare {
    /// Most operations.
    pub most: u64,
    /// Operations so far.
    pub done: u64,
}

impl RefitShare {
    /// Whether a slice of these operations is done in this tick: if it fits, or else as the first, so that every refit
    /// ends.
    pub fn takes(&self, cost: u64) -> bool {
        self.done == 0 || self.done.saturating_add(cost) <= self.most
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_slice_that_does_not_fit_is_done_as_the_first_only() {
        let mut share = RefitShare { most: 10, done: 0 };
        assert!(share.takes(30));
        share.done = 4;
        assert!(share.takes(6) && !share.takes(7));
    }
}
