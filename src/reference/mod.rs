//! The yardstick for reaching: a fixed test set, the noiseless test of a policy on it, and controllers for scale.
//!
//! The test shows 40 targets of 80 ticks each in sequence, from all angles 0, without exploration noise; its targets are
//! drawn with a seed that nobody tunes on or reports on. A policy's *loss* is its mean loss a tick over the test, its *miss*
//! the mean distance of the end-effector from the target at the targets' last ticks. What the numbers mean is told by four
//! references, measured on the same test:
//!
//! | reference | what it knows | file |
//! |---|---|---|
//! | `zero` | nothing: all commands are 0, as with weights 0 | here |
//! | `random` | nothing: the exploration noise alone | here |
//! | `damped-least-squares` | the true arm; moves by its Jacobian, one tick at a time | `damped_least_squares.rs` |
//! | `trajectory-optimum` | the true arm and the true reward; plans each reach as a whole | `optimum.rs` |
//!
//! The arm can change during a run. A [`FixedArm`] is the arm as it stands from some tick on, with its own test set and its own
//! references: what a blocked arm cannot reach is nobody's loss.

mod damped_least_squares;
mod optimum;
mod world;

pub use damped_least_squares::DampedLeastSquares;
pub use optimum::{STARTS, trajectory_optimum};
pub use world::FixedArm;

use serde::Serialize;

use crate::encoder::Encoder;
use crate::plant::Arm;
use crate::policy::{Exploration, LinearPolicy, Outputs};
use crate::runtime::PlantSide;
use crate::scenario::{FaultsConfig, Plan};
use crate::wire::{Command, Observation};

/// The loss to reach: that of the paper's rule after 9 million ticks, exploration noise's share taken out.
pub const LEVEL: f64 = 0.0375;
/// Targets of the test.
pub const TARGETS: usize = 40;
/// The seed of the test's targets and of the random reference.
pub const TEST_SEED: u64 = 2010;

/// What came of a test.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Score {
    /// Mean loss (reward with its sign turned) a tick.
    pub loss: f64,
    /// Mean distance from the target at the targets' last ticks, m.
    pub miss_m: f64,
}

/// The test in one world. It is built once, and taken as often as one likes.
#[derive(Debug, Clone)]
pub struct TestSet {
    /// The scenario with the world's arm and the test's targets.
    plan: Plan,
    world: FixedArm,
    encoder: Encoder,
}

impl TestSet {
    /// The test of `world` for policies of `plan`, whose plant is the arm.
    pub fn new(plan: &Plan, world: FixedArm) -> Self {
        let mut plan = plan.clone();
        // A test of what was learned, not of what went wrong on the way.
        plan.scenario.faults = FaultsConfig::default();
        plan.scenario.plant.arm = Some(world.with_targets(&world.draw_targets(TARGETS, TEST_SEED)));
        let encoder = plan.encoder();
        Self { plan, world, encoder }
    }

    /// The world that the test is for.
    pub fn world(&self) -> &FixedArm {
        &self.world
    }

    /// The test's targets, m, where they are and not where a mirrored camera shows them.
    pub fn targets(&self) -> &[[f64; 2]] {
        self.plan.scenario.plant.arm.as_ref().map_or(&[], |arm| &arm.targets)
    }

    /// Ticks for which each target is shown.
    pub fn ticks_a_target(&self) -> u64 {
        self.world.table().target_every
    }

    /// The score of whatever answers inputs with commands.
    pub fn drive(&self, control: impl FnMut(&[f32]) -> Outputs) -> Score {
        self.drive_targets(control, |_| {})
    }

    /// The same; `each` is given the score of each target in turn, when that is over.
    fn drive_targets(&self, mut control: impl FnMut(&[f32]) -> Outputs, mut each: impl FnMut(Score)) -> Score {
        let period_s = self.plan.scenario.period_ms / 1000.0;
        let table = self.plan.scenario.plant.arm.clone().unwrap_or_default();
        let mut side = PlantSide::new(Arm::new(&table, period_s, TEST_SEED), &self.plan);
        let (mut observation, mut command) = (Observation::default(), Command::default());
        let every = self.ticks_a_target();
        let ticks = TARGETS as u64 * every;
        let (mut loss, mut miss, mut target_loss) = (0.0, 0.0, 0.0);
        // One more look than there are ticks: what comes of a tick is told with the next observation.
        for tick in 0..=ticks {
            side.observe(tick, 0, 0, &mut observation);
            if tick > 0 {
                loss -= f64::from(observation.reward);
                target_loss -= f64::from(observation.reward);
                if tick.is_multiple_of(every) {
                    let miss_m = f64::from(observation.measures[0]);
                    miss += miss_m;
                    each(Score { loss: std::mem::take(&mut target_loss) / every as f64, miss_m });
                }
            }
            if tick < ticks {
                command.drawn = control(&observation.inputs[..self.plan.inputs.len()]);
                side.step(tick, Some(&command));
            }
        }
        Score { loss: loss / ticks as f64, miss_m: miss / TARGETS as f64 }
    }

    /// The score of a policy's mean commands.
    pub fn score(&self, policy: &LinearPolicy) -> Score {
        self.drive(self.mean_commands(policy))
    }

    /// The score of each target with a policy's mean commands, in the order of the targets.
    pub fn score_targets(&self, policy: &LinearPolicy) -> Vec<Score> {
        let mut scores = Vec::with_capacity(TARGETS);
        self.drive_targets(self.mean_commands(policy), |score| scores.push(score));
        scores
    }

    /// A policy's mean commands for inputs.
    fn mean_commands(&self, policy: &LinearPolicy) -> impl FnMut(&[f32]) -> Outputs {
        let mut encoder = self.encoder.clone();
        let mut features = encoder.features();
        move |inputs| {
            encoder.encode(inputs, &mut features);
            policy.mean(features.as_slice())
        }
    }

    /// The score of standing still, which is that of a policy whose weights are 0.
    pub fn zero(&self) -> Score {
        self.drive(|_| Outputs::default())
    }

    /// The score of each target when standing still.
    pub fn zero_targets(&self) -> Vec<Score> {
        let mut scores = Vec::with_capacity(TARGETS);
        self.drive_targets(|_| Outputs::default(), |score| scores.push(score));
        scores
    }

    /// The score of the exploration noise alone.
    pub fn random(&self) -> Score {
        let sigma = self.plan.scenario.policy.sigma as f32;
        let mut noise = Exploration::new(TEST_SEED, sigma, self.plan.outputs.len());
        self.drive(|_| noise.draw())
    }

    /// The score of damped least squares with the true arm.
    pub fn damped_least_squares(&self) -> Score {
        let controller = DampedLeastSquares::new(&self.world);
        self.drive(|inputs| controller.command(inputs))
    }

    /// The score of the best movements, each planned as a whole from `starts` first guesses. Takes seconds; `go_on` is asked
    /// now and then, and when it says false the result is `None`.
    pub fn optimum(&self, starts: usize, go_on: impl Fn() -> bool) -> Option<Score> {
        trajectory_optimum(&self.world, self.targets(), self.ticks_a_target() as usize, starts, go_on)
    }

    /// The score of each target with these movements.
    pub fn optimum_targets(&self, starts: usize) -> Option<Vec<Score>> {
        let ticks = self.ticks_a_target() as usize;
        let movements = optimum::best_movements(&self.world, self.targets(), ticks, starts, || true)?;
        Some(movements.iter().map(|m| Score { loss: m.cost / ticks as f64, miss_m: m.miss_m }).collect())
    }
}

#[cfg(test)]
mod tests;
