//! The test of a controller on a task: without exploration noise, on starts and targets that are the same for all.

use serde::Serialize;

use super::plan::TaskPlan;
use crate::plant::{MAX_STATES, SimulatedPlant};
use crate::policy::Outputs;
use crate::runtime::PlantSide;
use crate::wire::{Command, Observation, flag};

/// Seed of the tests' starts and targets; it serves neither tuning nor reporting.
const TEST_SEED: u64 = 2010;

/// The result of a test.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub(super) struct TestScore {
    /// Mean reward a tick.
    pub reward: f64,
    /// Mean error in the last tick of the trials, in the unit of the task's level.
    pub end: f64,
}

/// What a controller can see in a test: the observation, and for references the body's true state.
pub(super) struct TestView<'a> {
    pub observation: &'a Observation,
    pub state: &'a [f64],
    /// Whether a trial begins.
    pub fresh: bool,
}

/// Drives the plant of `task` with `control`, after the change if `changed`. `in_time` takes delays away, for
/// references that know the true state. Calls `go_on` every tick; the result is `None` once that returns false.
pub(super) fn drive(
    task: &TaskPlan,
    changed: bool,
    in_time: bool,
    mut control: impl FnMut(&TestView) -> Outputs,
    go_on: &dyn Fn() -> bool,
) -> Option<TestScore> {
    let plan = task.plan();
    let mut timing = task.task.timing.clone();
    if in_time {
        (timing.delay, timing.reward_delay, timing.picture_delay) = (0, 0, 0);
    }
    let body = SimulatedPlant::new(&task.task.body, &timing, task.task.period_ms / 1000.0, TEST_SEED);
    let mut side = PlantSide::new(body, plan);
    let (mut observation, mut command) = (Observation::default(), Command::default());
    let trial = task.task.body.trial_ticks().max(1);
    let (first, ticks) = (task.test_begins(changed), task.test_ticks());
    let mut state = [0.0; MAX_STATES];
    let (mut reward, mut end, mut trials) = (0.0, 0.0, 0_u64);
    // The reward and the error of a tick are in the observation of the next one.
    for tick in first..=first + ticks {
        side.observe(tick, 0, 0, &mut observation);
        if tick > first {
            reward += f64::from(observation.reward);
        }
        if tick > first && tick.is_multiple_of(trial) {
            end += f64::from(observation.measures[0]);
            trials += 1;
        }
        if tick == first + ticks {
            break;
        }
        if !go_on() {
            return None;
        }
        let states = side.body_mut().state(&mut state);
        let fresh = tick == first || observation.header.flags & flag::NEW_TARGET != 0;
        command.header.tick = tick;
        let outputs = control(&TestView { observation: &observation, state: &state[..states], fresh });
        command.drawn[..outputs.len()].copy_from_slice(&outputs);
        side.step(tick, Some(&command));
    }
    Some(TestScore { reward: reward / ticks as f64, end: end / trials.max(1) as f64 })
}
