//! How much work a tick is: operations, which are the same on every machine, in place of time, which is not.
//!
//! An operation is a multiplication with an addition. Learning and refits count theirs themselves. What the planner's
//! steps through the learned world take follows from the sizes of the models:
//!
//! ```text
//! value     C M + 12 M + K (1 + O) + O F           C components, M Fourier pairs, K products, F features,
//! Jacobian  value + C M + O (3 M + 2 K + D M)      O outputs, D places of q, A places of the reward's Hessian
//! Hessian   Jacobian + 1/2 A^2 M + 4 A K
//! step      values of dynamics and reward
//! expansion Jacobian of the dynamics, Hessian of the reward and its eigenvalues, and its way back through the plan
//! ```

use super::dynamics::Dynamics;
use super::layout::Places;
use super::model::Model;

/// Operations that a core makes in a millisecond. A machine that makes fewer takes longer than `budget_ms`; the summary
/// of a run says so.
pub const OPERATIONS_PER_MS: f64 = 2e6;

/// The operations of the planner's work: those of one evaluated step, and of one that is expanded.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct StepCost {
    step: u64,
    expansion: u64,
}

/// Operations of a model's value, and of its Jacobian.
pub fn of_model(model: &Model, width: u64) -> [u64; 2] {
    let features = &model.fit.features;
    let (waves, products) = (features.pairs as u64, features.nodes.len() as u64);
    let (outputs, components) = (model.outputs() as u64, model.layout.components as u64);
    let value = (components + 12) * waves + products * (1 + outputs) + outputs * features.len as u64;
    [value, value + components * waves + outputs * (3 * waves + 2 * products + width * waves)]
}

impl StepCost {
    /// That of a world of these models; the reward's Hessian has `active` places, `moving` of which it is concave in.
    pub fn of(places: Places, dynamics: &Dynamics, reward: &Model, (active, moving): (usize, usize)) -> Self {
        let (width, states, active) = (places.len() as u64, places.state() as u64, active as u64);
        let moving = moving as u64;
        let [value, slopes] = of_model(reward, width);
        let [move_value, move_slopes] = dynamics
            .moving_models()
            .map(|model| of_model(model, width))
            .fold([0, 0], |sum, cost| [sum[0] + cost[0], sum[1] + cost[1]]);
        let (waves, products) = (reward.fit.features.pairs as u64, reward.fit.features.nodes.len() as u64);
        let curves = active * active * waves / 2 + 4 * active * products;
        // The eigenvalues take some five sweeps of rotations where the reward is not concave, and nothing elsewhere.
        let concave = 6 * moving * moving * moving;
        let back = states * states * width + states * width * width;
        Self { step: move_value + value, expansion: move_slopes + slopes + curves + concave + back }
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
