//! The run of one learner with one seed: its noiseless tests, and the cost of its ticks.

use serde::{Deserialize, Deserializer, Serialize, Serializer};

use super::cost::{ClockCost, TickCost};
use super::{Condition, LearnerEntry};
use crate::policy::Outputs;
use crate::reference::Score;
use crate::runtime::{PipeError, PlantSide};
use crate::study::subject::Subject;
use crate::study::{JobProgress, StudyError, exact};
use crate::wire::{Command, Observation};

/// One test of the policy.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub(super) struct PolicyTest {
    /// Ticks done before the test.
    pub tick: u64,
    /// Number of changes of the arm before the test. The test is the one of the condition with this number.
    pub condition: usize,
    /// The result.
    #[serde(with = "exact_score")]
    pub score: Score,
}

/// A score as two numbers that are read back bit by bit.
mod exact_score {
    use super::*;

    #[derive(Serialize, Deserialize)]
    struct ScoreRow(#[serde(with = "exact")] f64, #[serde(with = "exact")] f64);

    pub fn serialize<S: Serializer>(score: &Score, to: S) -> Result<S::Ok, S::Error> {
        ScoreRow(score.loss, score.miss_m).serialize(to)
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(from: D) -> Result<Score, D::Error> {
        ScoreRow::deserialize(from).map(|ScoreRow(loss, miss_m)| Score { loss, miss_m })
    }
}

/// The result of a run.
#[derive(Debug, Clone, Serialize, Deserialize)]
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
///
/// # Errors
/// When the controller's program fails.
pub(super) fn run(
    entry: &LearnerEntry,
    seed: u64,
    conditions: &[Condition],
    progress: &JobProgress,
) -> Result<Option<LearnerRun>, StudyError> {
    match run_subject(entry, seed, conditions, progress) {
        // The pool says it of the whole study.
        Err(PipeError::Interrupted { .. }) => Ok(None),
        other => other.map_err(|error| StudyError::Controller { name: entry.name.clone(), seed, error }),
    }
}

fn run_subject(
    entry: &LearnerEntry,
    seed: u64,
    conditions: &[Condition],
    progress: &JobProgress,
) -> Result<Option<LearnerRun>, PipeError> {
    let plan = entry.plan(seed);
    let Some(plant) = plan.simulated_plant() else { return Ok(None) };
    let (mut side, mut subject) = (PlantSide::new(plant, &plan), Subject::new(&plan, progress)?);
    let (mut observation, mut command) = (Observation::default(), Command::default());
    let ticks = plan.scenario.ticks;
    let stride = (ticks / TIMES).max(TIMED);
    let clock = ClockCost::measure();
    let (mut tests, mut costs) = (Vec::new(), Vec::new());
    let (mut condition, mut next) = (0, entry.test_stride * test_interval(0));
    for tick in 0..ticks {
        side.observe(tick, 0, 0, &mut observation);
        if tick % stride < TIMED {
            costs.push(clock.timed(&mut subject, &observation, &mut command)?);
        } else {
            subject.respond(&observation, &mut command)?;
            subject.after_command(&observation)?;
        }
        side.keep_ahead(subject.ahead());
        side.step(tick, Some(&command));

        let done = tick + 1;
        if done.is_multiple_of(REPORT) && !progress.report(REPORT) {
            return Ok(None);
        }
        let change = entry.changes.get(condition).map(|change| change.tick);
        if done == next || done == ticks || change == Some(done) {
            let Some(score) = test(&mut subject, &conditions[condition], done, progress)? else { return Ok(None) };
            tests.push(PolicyTest { tick: done, condition, score });
            if change == Some(done) {
                condition += 1;
            }
            let since = done - if condition == 0 { 0 } else { entry.changes[condition - 1].tick };
            next = done + entry.test_stride * test_interval(since);
        }
    }
    if !progress.report(ticks % REPORT) {
        return Ok(None);
    }
    let report = subject.finish()?;
    Ok(Some(LearnerRun { tests, costs, diverged_at: report.diverged_at, weights_hash: report.weights_hash }))
}

/// Tests what was learned in the first `done` ticks. `None` if the study has to stop.
fn test(
    subject: &mut Subject,
    condition: &Condition,
    done: u64,
    progress: &JobProgress,
) -> Result<Option<Score>, PipeError> {
    let (mut frozen, mut stopped) = (subject.frozen(condition.test.plan(), done)?, false);
    let score = condition.test.drive(|seen| {
        stopped |= !progress.report(0);
        if stopped { Outputs::default() } else { frozen.command(seen) }
    });
    frozen.end()?;
    Ok((!stopped).then_some(score))
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
