//! The test set for reaching: fixed targets, a noiseless test of a policy on them, and reference controllers.
//!
//! Studies and the summary of a run measure policies with it. `noiseless.rs` drives a plant without exploration
//! noise.
//!
//! The test shows 40 targets of 80 ticks each in sequence. It starts with all angles at 0 and adds no
//! exploration noise. The targets are drawn with a seed that serves neither tuning nor reporting. A policy's
//! *loss* is its mean loss per tick over the test. Its *miss* is the mean distance between end-effector and
//! target in each target's last tick. Four references, measured on the same test, give these numbers a scale:
//!
//! | reference | what it knows | file |
//! |---|---|---|
//! | `zero` | nothing: all commands are 0, as with weights 0 | here |
//! | `random` | nothing: it sends exploration noise alone | here |
//! | `damped-least-squares` | the true arm; moves by its Jacobian, one tick at a time | `damped_least_squares.rs` |
//! | `trajectory-optimum` | the true arm and the true reward; plans each reach as a whole | `optimum.rs` |
//!
//! The arm can change during a run. A `FixedArm` is the arm in one condition, from some tick on. Each
//! condition has its own test set and its own references, so that a policy is never measured by what a
//! blocked arm cannot reach.

mod damped_least_squares;
mod fixed_arm;
mod ilqr;
mod noiseless;
mod optimum;
mod resolved_rates;
mod small_matrix;
mod swing_up;
mod true_model;

use damped_least_squares::DampedLeastSquares;
pub use fixed_arm::FixedArm;
pub use ilqr::IterativeLqr;
pub use noiseless::{FrozenAgent, MeanPolicy, Rollout, TestPercept};
pub use optimum::STARTS;
use optimum::trajectory_optimum;
pub use resolved_rates::ResolvedRates;
pub use swing_up::EnergySwingUp;
pub use true_model::{LaggedModel, TrueModel, body_model};

use serde::Serialize;

use crate::agent::ShippedAgent;
use crate::plant::Arm;
use crate::policy::{Exploration, LinearPolicy, Outputs};
use crate::scenario::Plan;

/// The loss to reach: the loss of the paper's rule after 9 million ticks, without the cost of exploration
/// noise.
pub const LEVEL: f64 = 0.0375;
/// Number of targets in the test.
pub const TARGETS: usize = 40;
/// The seed of every study's test targets, unless it is asked for others, and of the random reference.
pub const TEST_SEED: u64 = 2010;

/// The result of a test.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Score {
    /// Mean loss (reward with its sign turned) per tick.
    pub loss: f64,
    /// Mean distance from the target in the targets' last ticks, m.
    pub miss_m: f64,
}

/// The test for one condition of the arm. Built once, used for any number of policies.
#[derive(Debug, Clone)]
pub struct TestSet {
    /// The scenario, with the arm in this condition and the test's targets.
    plan: Plan,
    arm: FixedArm,
    policy: MeanPolicy,
}

impl TestSet {
    /// The test with `arm` for policies of `plan`, whose plant is the simulator's arm.
    pub fn new(plan: &Plan, arm: FixedArm) -> Self {
        Self::of_seed(plan, arm, TEST_SEED)
    }

    /// The same with the targets of another seed.
    pub fn of_seed(plan: &Plan, arm: FixedArm, seed: u64) -> Self {
        let mut plan = plan.clone();
        plan.scenario.plant.arm = Some(arm.with_targets(&arm.draw_targets(TARGETS, seed)));
        let policy = MeanPolicy::new(&plan);
        Self { plan, arm, policy }
    }

    /// The scenario of the test.
    pub fn plan(&self) -> &Plan {
        &self.plan
    }

    /// The true positions of the test's targets, m. A mirrored camera shows them elsewhere.
    pub fn targets(&self) -> &[[f64; 2]] {
        self.plan.scenario.plant.arm.as_ref().map_or(&[], |arm| &arm.targets)
    }

    /// Ticks for which each target is shown.
    pub fn ticks_a_target(&self) -> u64 {
        self.arm.config().target_every
    }

    /// The score of a controller: `control` answers what it sees in each tick with a command.
    pub fn drive(&self, control: impl FnMut(&TestPercept) -> Outputs) -> Score {
        self.drive_targets(control, |_| {})
    }

    /// The same. Calls `each` with the score of each target when that is over.
    fn drive_targets(&self, mut control: impl FnMut(&TestPercept) -> Outputs, mut each: impl FnMut(Score)) -> Score {
        let period_s = self.plan.scenario.period_ms / 1000.0;
        let config = self.plan.scenario.plant.arm.clone().unwrap_or_default();
        let mut rollout = Rollout::new(Arm::new(&config, period_s, TEST_SEED), &self.plan);
        let every = self.ticks_a_target();
        let ticks = TARGETS as u64 * every;
        let (mut loss, mut miss, mut target_loss) = (0.0, 0.0, 0.0);
        for tick in 0..ticks {
            rollout.sense(tick);
            let outcome = rollout.advance(tick, &mut control);
            loss -= f64::from(outcome.reward);
            target_loss -= f64::from(outcome.reward);
            if (tick + 1).is_multiple_of(every) {
                let miss_m = f64::from(outcome.measures[0]);
                miss += miss_m;
                each(Score { loss: std::mem::take(&mut target_loss) / every as f64, miss_m });
            }
        }
        Score { loss: loss / ticks as f64, miss_m: miss / TARGETS as f64 }
    }

    /// The score of what an agent has learned.
    pub fn score_agent(&self, agent: &ShippedAgent) -> Score {
        let mut frozen = FrozenAgent::of(agent, &self.plan);
        self.drive(|seen| frozen.command(seen))
    }

    /// The score of each target with a policy's mean commands, in the order of the targets.
    pub fn score_targets(&self, policy: &LinearPolicy) -> Vec<Score> {
        let mut scores = Vec::with_capacity(TARGETS);
        let mut mean = self.mean_commands(policy);
        self.drive_targets(&mut mean, |score| scores.push(score));
        scores
    }

    /// A controller that answers inputs with the mean commands of `policy`.
    fn mean_commands(&self, policy: &LinearPolicy) -> impl FnMut(&TestPercept) -> Outputs {
        let mut mean = self.policy.clone();
        move |seen| mean.command(policy, seen.inputs)
    }

    /// The score of zero commands, which is the score of a policy whose weights are 0.
    pub fn zero(&self) -> Score {
        self.drive(|_| Outputs::default())
    }

    /// The score of each target with zero commands.
    pub fn zero_targets(&self) -> Vec<Score> {
        let mut scores = Vec::with_capacity(TARGETS);
        self.drive_targets(|_| Outputs::default(), |score| scores.push(score));
        scores
    }

    /// The score of exploration noise alone.
    pub fn random(&self) -> Score {
        let sigma = self.plan.scenario.policy.sigma as f32;
        let mut noise = Exploration::new(TEST_SEED, sigma, self.plan.outputs.len());
        self.drive(|_| noise.draw())
    }

    /// The score of damped least squares with the true arm.
    pub fn damped_least_squares(&self) -> Score {
        let controller = DampedLeastSquares::new(&self.arm);
        self.drive(|seen| controller.command(seen.inputs))
    }

    /// The score of the best movements, each planned as a whole from `starts` first guesses. Takes seconds.
    /// Calls `go_on` now and then; the result is `None` once that returns false.
    pub fn optimum(&self, starts: usize, go_on: impl Fn() -> bool) -> Option<Score> {
        trajectory_optimum(&self.arm, self.targets(), self.ticks_a_target() as usize, starts, go_on)
    }

    /// The score of each target with the best movements, in the order of the targets.
    pub fn optimum_targets(&self, starts: usize) -> Option<Vec<Score>> {
        let ticks = self.ticks_a_target() as usize;
        let movements = optimum::best_movements(&self.arm, self.targets(), ticks, starts, || true)?;
        Some(movements.iter().map(|m| Score { loss: m.cost / ticks as f64, miss_m: m.miss_m }).collect())
    }
}

#[cfg(test)]
mod tests;
