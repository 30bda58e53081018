//! One learner, one seed: the run, its tests on the way, and what its ticks cost.

use std::time::Instant;

use super::LearnerEntry;
use crate::plant::SimulatedPlant;
use crate::reference::{Score, TestSet};
use crate::runtime::{Controller, PlantSide};
use crate::study::JobProgress;
use crate::wire::{Command, Observation};

/// One test of the policy as it was.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PolicyTest {
    /// Ticks done before the test.
    pub tick: u64,
    /// Changes of the arm before the test; the test is the one of that world.
    pub world: usize,
    /// What came of it.
    pub score: Score,
}

/// What a tick cost, ns.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TickCost {
    /// From the observation to the command: learning, encoding, drawing.
    pub before: f64,
    /// After the command has gone out.
    pub after: f64,
}

/// What came of a run.
#[derive(Debug, Clone)]
pub struct LearnerRun {
    /// The tests, in the order of time.
    pub samples: Vec<PolicyTest>,
    /// Some ticks' costs.
    pub costs: Vec<TickCost>,
    /// The first tick at which the weights were no longer numbers.
    pub diverged_at: Option<u64>,
    /// XXH3-64 of the weights at the end, hexadecimal.
    pub weights_hash: String,
}

/// Ticks between two reports, so that a slow learner's run ends well within a second.
const REPORT: u64 = 64;
/// Ticks in a row that are timed, and how often in a run.
const TIMED: u64 = 8;
const TIMES: u64 = 400;

/// Ticks to the next test, `since` ticks after the beginning or the last change. Instants are known to that.
///
/// 20 ticks, a second, in the first 1,000; then a twentieth of the power of ten below: 50 up to 10,000, 500 up to 100,000.
pub fn spacing(since: u64) -> u64 {
    if since < 1_000 { 20 } else { 10_u64.pow(since.ilog10()) / 20 }
}

/// Runs `entry` with `seed`, with one test for each world: that of the beginning and that after each change. `None` if the
/// study is to end before the run does.
pub fn run(entry: &LearnerEntry, seed: u64, tests: &[TestSet], progress: &JobProgress) -> Option<LearnerRun> {
    let plan = entry.plan(seed);
    let mut side = PlantSide::new(SimulatedPlant::of(&plan)?, &plan);
    let mut controller = Controller::new(&plan);
    let (mut observation, mut command) = (Observation::default(), Command::default());
    let ticks = plan.scenario.ticks;
    let stride = (ticks / TIMES).max(TIMED);
    let look = look();
    let mut course =
        LearnerRun { samples: Vec::new(), costs: Vec::new(), diverged_at: None, weights_hash: String::new() };
    let (mut world, mut next) = (0, spacing(0));
    for tick in 0..ticks {
        side.observe(tick, 0, 0, &mut observation);
        if tick % stride < TIMED {
            let began = Instant::now();
            controller.respond(&observation, &mut command);
            let answered = Instant::now();
            controller.after_command(&observation);
            let settled = Instant::now();
            let ns = |from: Instant, to: Instant| ((to - from).as_nanos() as f64 - look).max(0.0);
            course.costs.push(TickCost { before: ns(began, answered), after: ns(answered, settled) });
        } else {
            controller.respond(&observation, &mut command);
            controller.after_command(&observation);
        }
        side.step(tick, Some(&command));

        let done = tick + 1;
        if done.is_multiple_of(REPORT) && !progress.report(REPORT) {
            return None;
        }
        let change = entry.changes.get(world).map(|change| change.tick);
        if done == next || done == ticks || change == Some(done) {
            let score = tests[world].score(controller.policy());
            course.samples.push(PolicyTest { tick: done, world, score });
            if change == Some(done) {
                world += 1;
            }
            let since = done - if world == 0 { 0 } else { entry.changes[world - 1].tick };
            next = done + spacing(since);
        }
    }
    if !progress.report(ticks % REPORT) {
        return None;
    }
    let report = controller.finish();
    course.diverged_at = report.diverged_at;
    course.weights_hash = report.weights_hash;
    Some(course)
}

/// What a look at the clock costs, ns.
fn look() -> f64 {
    const LOOKS: u32 = 10_000;
    let began = Instant::now();
    for _ in 0..LOOKS {
        std::hint::black_box(Instant::now());
    }
    began.elapsed().as_nanos() as f64 / f64::from(LOOKS)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_power_of_ten_is_tested_at() {
        let (mut at, mut tests) = (0, vec![]);
        while at < 12_000_000 {
            at += spacing(at);
            tests.push(at);
        }
        assert!([1_000, 10_000, 100_000, 1_000_000, 10_000_000].iter().all(|tick| tests.contains(tick)));
        assert!(tests.len() < 1000, "{}", tests.len());
        assert!(tests.windows(2).skip(50).all(|pair| (pair[1] - pair[0]) * 20 <= pair[0]));
    }
}
