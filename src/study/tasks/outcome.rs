//! From the tests of the runs to the table's entries.

use serde::Serialize;

use super::candidate::Candidate;
use super::levels::Level;
use super::plan::TaskPlan;
use super::test::TestScore;

/// One test of a run.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct PhaseTest {
    /// Ticks done before the test.
    pub tick: u64,
    /// Whether the plant had changed.
    pub changed: bool,
    /// The result.
    pub score: TestScore,
}

/// The result of one run.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct RunResult {
    /// The tests, in the order of their ticks.
    pub tests: Vec<PhaseTest>,
    /// Whether the learner stopped because of a number that was not finite.
    pub diverged: bool,
    /// Processor time of the controller a tick, ms.
    pub ms_per_tick: f64,
}

impl RunResult {
    /// That of a reference, whose tests are the whole run.
    pub fn of_reference(scores: &[TestScore], ms_per_tick: f64) -> Self {
        let test = |(i, score): (usize, &TestScore)| PhaseTest { tick: 0, changed: i > 0, score: *score };
        Self { tests: scores.iter().enumerate().map(test).collect(), diverged: false, ms_per_tick }
    }

    /// The ticks after `begin` from which on all tests of a phase reached `level`; `None` if the last one did not.
    fn ticks_to(&self, level: &Level, changed: bool, begin: u64) -> Option<u64> {
        let tests = self.tests.iter().filter(|test| test.changed == changed);
        let held = tests.rev().take_while(|test| level.is_reached(test.score));
        held.last().map(|test| test.tick.saturating_sub(begin))
    }

    fn last(&self, changed: bool) -> Option<TestScore> {
        self.tests.iter().rfind(|test| test.changed == changed).map(|test| test.score)
    }
}

/// One entry of the table: a controller on a task.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TaskOutcome {
    /// The task.
    pub task: String,
    /// The learner or reference controller.
    pub learner: String,
    /// Whether it is a reference controller.
    pub reference: bool,
    /// The level, in words.
    pub level: String,
    /// The level as a reward a tick, if it is one.
    #[serde(skip)]
    pub(super) level_reward: Option<f64>,
    /// The seeds, in the order of all lists. A reference controller has one run and no seeds.
    pub seeds: Vec<u64>,
    /// Length of a run, ticks.
    pub ticks: u64,
    /// Period of a tick, ms.
    pub period_ms: f64,
    /// Ticks to the level, held from then on until the change or the end; null where never.
    pub ticks_to_level: Vec<Option<u64>>,
    /// The same of the worst seed, s of the plant's time; null if a seed never reached the level.
    pub worst_seconds_to_level: Option<f64>,
    /// Error in the last tick of the trials, before the change or at the end, in `end_unit`.
    pub end: Vec<f64>,
    /// Unit of `end`.
    pub end_unit: &'static str,
    /// Mean reward a tick in the last test before the change or at the end.
    pub reward: Vec<f64>,
    /// Ticks after the change until the level of the changed plant is reached, held from then on; null where never.
    /// Empty if the plant does not change.
    pub recovery: Vec<Option<u64>>,
    /// Error at the end of the run after the change; empty if the plant does not change.
    pub end_after_change: Vec<f64>,
    /// Mean reward a tick in the last test after the change; empty if the plant does not change.
    pub reward_after_change: Vec<f64>,
    /// Seeds whose learner stopped because of a number that was not finite.
    pub diverged: usize,
    /// Processor time of the controller a tick, ms: the mean over all seeds.
    pub ms_per_tick: f64,
}

impl TaskOutcome {
    pub(super) fn of(task: &TaskPlan, candidate: &Candidate, runs: &[(u64, RunResult)]) -> Self {
        let [level, after] = &task.levels;
        let change = task.change();
        let is_reference = candidate.is_reference();
        let to_level: Vec<_> = runs.iter().map(|(_, run)| run.ticks_to(level, false, 0)).collect();
        let scores = |changed| runs.iter().filter_map(move |(_, run)| run.last(changed));
        let worst = to_level.iter().copied().collect::<Option<Vec<u64>>>().and_then(|ticks| ticks.into_iter().max());
        let recovery = change.map_or_else(Vec::new, |begin| {
            runs.iter().map(|(_, run)| run.ticks_to(after, true, if is_reference { 0 } else { begin })).collect()
        });
        Self {
            task: task.task.name.clone(),
            learner: candidate.name(),
            reference: is_reference,
            level: level.words(),
            level_reward: level.reward,
            seeds: if is_reference { Vec::new() } else { runs.iter().map(|(seed, _)| *seed).collect() },
            ticks: candidate.ticks(task),
            period_ms: task.task.period_ms,
            worst_seconds_to_level: worst.map(|ticks| ticks as f64 * task.task.period_ms / 1000.0),
            ticks_to_level: to_level,
            end: scores(false).map(|score| score.end).collect(),
            end_unit: level.unit,
            reward: scores(false).map(|score| score.reward).collect(),
            recovery,
            end_after_change: scores(true).map(|score| score.end).collect(),
            reward_after_change: scores(true).map(|score| score.reward).collect(),
            diverged: runs.iter().filter(|(_, run)| run.diverged).count(),
            ms_per_tick: runs.iter().map(|(_, run)| run.ms_per_tick).sum::<f64>() / runs.len().max(1) as f64,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::levels::Level;
    use super::*;

    #[test]
    fn a_level_counts_from_the_test_after_which_it_is_held() {
        let level = Level { reward: Some(-1.0), end: None, unit: "m", reason: "" };
        let test = |tick, changed, reward| PhaseTest { tick, changed, score: TestScore { reward, end: 0.0 } };
        let tests = vec![
            test(50, false, -0.5),
            test(100, false, -2.0),
            test(150, false, -0.9),
            test(200, false, -1.0),
            test(250, true, -3.0),
            test(300, true, -0.1),
        ];
        let run = RunResult { tests, diverged: false, ms_per_tick: 0.0 };
        assert_eq!(run.ticks_to(&level, false, 0), Some(150));
        assert_eq!(run.ticks_to(&level, true, 200), Some(100));
        let never = Level { reward: Some(-0.01), ..level };
        assert_eq!(run.ticks_to(&never, true, 200), None);
        let not_a_number = RunResult { tests: vec![test(50, false, f64::NAN)], ..run };
        assert_eq!(not_a_number.ticks_to(&level, false, 0), None);
    }
}
