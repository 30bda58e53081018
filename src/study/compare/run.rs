//! The run of one learner with one seed: its noiseless tests, and the cost of its ticks.

use std::time::Instant;

use super::{Condition, LearnerEntry};
use crate::reference::Score;
use crate::runtime::{Controller, PlantSide};
use crate::study::JobProgress;
use crate::wire::{Command, Observation};

/// One test of the policy.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct PolicyTest {
    /// Ticks done before the test.
    pub tick: u64,
    /// Number of changes of the arm before the test. The test is the one of the condition with this number.
    pub condition: usize,
    /// The result.
    pub score: Score,
}

/// The cost of one tick, ns.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct TickCost {
    /// From the observation to the command: learning, encoding, drawing.
    pub before: f64,
    /// After the command was sent.
    pub after: f64,
}

/// The result of a run.
#[derive(Debug, Clone)]
pub(super) struct LearnerRun {
    /// The tests, in the order of ticks.
    pub tests: Vec<PolicyTest>,
    /// The costs of some ticks.
    pub costs: Vec<TickCost>,
    /// The first tick at which the weights were no longer numbers.
    pub diverged_at: Option<u64>,
    /// XXH3-64 of the weights at the end, hexadecimal.
    pub weights_hash: String,
}

/// Ticks between two reports of progress, so that a slow learner's run stops well within a second.
const REPORT: u64 = 64;
/// Consecutive ticks that are timed together.
const TIMED: u64 = 8;
/// How many times in a run such ticks are timed.
const TIMES: u64 = 400;

/// Ticks until the next test, `since` ticks after the beginning or the last change.
///
/// 20 ticks, a second, within the first 1,000 ticks; afterwards a twentieth of the power of ten below: 50 up
/// to 10,000, 500 up to 100,000.
pub(super) fn test_interval(since: u64) -> u64 {
    if since < 1_000 { 20 } else { 10_u64.pow(since.ilog10()) / 20 }
}

/// Runs `entry` with `seed` and tests it in the current one of `conditions`. `None` if the study has to stop
/// before the run ends.
pub(super) fn run(
    entry: &LearnerEntry,
    seed: u64,
    conditions: &[Condition],
    progress: &JobProgress,
) -> Option<LearnerRun> {
    let plan = entry.plan(seed);
    let mut side = PlantSide::new(plan.simulated_plant()?, &plan);
    let mut controller = Controller::new(&plan);
    let (mut observation, mut command) = (Observation::default(), Command::default());
    let ticks = plan.scenario.ticks;
    let stride = (ticks / TIMES).max(TIMED);
    let clock_ns = clock_read_ns();
    let (mut tests, mut costs) = (Vec::new(), Vec::new());
    let (mut condition, mut next) = (0, entry.test_stride * test_interval(0));
    for tick in 0..ticks {
        side.observe(tick, 0, 0, &mut observation);
        if tick % stride < TIMED {
            costs.push(timed_tick(&mut controller, &observation, &mut command, clock_ns));
        } else {
            controller.respond(&observation, &mut command);
            controller.after_command(&observation);
        }
        side.step(tick, Some(&command));

        let done = tick + 1;
        if done.is_multiple_of(REPORT) && !progress.report(REPORT) {
            return None;
        }
        let change = entry.changes.get(condition).map(|change| change.tick);
        if done == next || done == ticks || change == Some(done) {
            let score = conditions[condition].test.score_agent(controller.agent());
            tests.push(PolicyTest { tick: done, condition, score });
            if change == Some(done) {
                condition += 1;
            }
            let since = done - if condition == 0 { 0 } else { entry.changes[condition - 1].tick };
            next = done + entry.test_stride * test_interval(since);
        }
    }
    if !progress.report(ticks % REPORT) {
        return None;
    }
    let report = controller.finish();
    Some(LearnerRun { tests, costs, diverged_at: report.diverged_at, weights_hash: report.weights_hash })
}

/// One tick of the controller, timed. Reading the clock takes `clock_ns`, which is not counted.
fn timed_tick(
    controller: &mut Controller,
    observation: &Observation,
    command: &mut Command,
    clock_ns: f64,
) -> TickCost {
    let began = Instant::now();
    controller.respond(observation, command);
    let answered = Instant::now();
    controller.after_command(observation);
    let ended = Instant::now();
    let ns = |from: Instant, to: Instant| ((to - from).as_nanos() as f64 - clock_ns).max(0.0);
    TickCost { before: ns(began, answered), after: ns(answered, ended) }
}

/// The cost of reading the clock, ns.
fn clock_read_ns() -> f64 {
    const READS: u32 = 10_000;
    let began = Instant::now();
    for _ in 0..READS {
        std::hint::black_box(Instant::now());
    }
    began.elapsed().as_nanos() as f64 / f64::from(READS)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_power_of_ten_has_a_test() {
        let (mut at, mut tests) = (0, vec![]);
        while at < 12_000_000 {
            at += test_interval(at);
            tests.push(at);
        }
        assert!([1_000, 10_000, 100_000, 1_000_000, 10_000_000].iter().all(|tick| tests.contains(tick)));
        assert!(tests.len() < 1000, "{}", tests.len());
        assert!(tests.windows(2).skip(50).all(|pair| (pair[1] - pair[0]) * 20 <= pair[0]));
    }
}
