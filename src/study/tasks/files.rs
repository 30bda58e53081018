//! The files of a study of tasks: the table as JSON, every test as CSV, and a figure for each task.

use std::fmt::Write as _;
use std::path::Path;

use super::outcome::RunResult;
use super::{TaskOutcome, TaskTable};
use crate::report::figure::learning::{CurvePoint, LearnerCurve, LearningFigure, LearningPanel, ReferenceLine, draw};
use crate::study::StudyError;
use crate::study::compare::colour_number;
use crate::study::error::write_file;
use crate::study::text::seeds_shown;

/// A figure shows losses up to so many times the level, or, without one, up to this loss.
const HIGHEST_LEVELS: f64 = 50.0;
const HIGHEST: f64 = 2.0;

/// The runs of a controller on a task, with their seeds.
pub(super) type TaskRuns = Vec<(u64, RunResult)>;

/// Writes the files into `folder`.
///
/// # Errors
/// When one cannot be written.
pub(super) fn write(table: &TaskTable, folder: &Path) -> Result<(), StudyError> {
    write_file(&folder.join("tasks.json"), table.to_json())?;
    write_file(&folder.join("curves.csv"), test_rows(table))?;
    let entries: Vec<_> = table.tasks.iter().zip(&table.runs).collect();
    for entries in entries.chunk_by(|(a, _), (b, _)| a.task == b.task) {
        draw(&figure(entries), &folder.join(format!("{}.svg", entries[0].0.task)))?;
    }
    Ok(())
}

/// `curves.csv`: one row per test. A reference controller has no seed.
fn test_rows(table: &TaskTable) -> String {
    let mut text = "task,learner,seed,tick,changed,reward,end\n".to_owned();
    for (outcome, runs) in table.tasks.iter().zip(&table.runs) {
        for (seed, run) in runs {
            let seed = if outcome.reference { String::new() } else { seed.to_string() };
            for test in &run.tests {
                let (reward, end) = (test.score.reward, test.score.end);
                let (task, learner, tick) = (&outcome.task, &outcome.learner, test.tick);
                let _ = writeln!(text, "{task},{learner},{seed},{tick},{},{reward},{end}", u8::from(test.changed));
            }
        }
    }
    text
}

/// The learning curves of one task up to its change, on logarithmic axes. A reward of at most 1 is shown as what is
/// missing of it.
fn figure(entries: &[(&TaskOutcome, &TaskRuns)]) -> LearningFigure {
    let outcome = entries[0].0;
    let best = if outcome.level_reward.is_some_and(|level| level > 0.0) { 1.0 } else { 0.0 };
    let (learners, references): (Vec<_>, Vec<_>) = entries.iter().partition(|(outcome, _)| !outcome.reference);
    let level = outcome.level_reward.map(|reward| ReferenceLine { name: "level".to_owned(), value: best - reward });
    let line = |(outcome, _): &(&TaskOutcome, &TaskRuns)| {
        let value = best - outcome.reward.first()?;
        Some(ReferenceLine { name: outcome.learner.clone(), value })
    };
    let names = || learners.iter().map(|(outcome, _)| &outcome.learner[..]);
    let colour = |(outcome, _): &(&TaskOutcome, &TaskRuns)| colour_number(&outcome.learner, names());
    let panel = LearningPanel {
        title: format!("{}, ticks of {} ms", outcome.task, outcome.period_ms),
        x: "ticks".to_owned(),
        curves: learners.iter().map(|entry| curve(entry, colour(entry), best)).collect(),
        lines: level.into_iter().chain(references.iter().filter_map(line)).collect(),
    };
    let seeds = learners.first().map_or(&[][..], |(outcome, _)| &outcome.seeds);
    let (title, y) = if best > 0.0 { ("1 - reward", "1 - reward a tick") } else { ("Loss", "loss a tick") };
    LearningFigure {
        title: format!("{title} a tick in the test, without exploration noise; {}", seeds_shown(seeds)),
        y,
        highest: outcome.level_reward.map_or(HIGHEST, |reward| HIGHEST_LEVELS * (best - reward)),
        panels: vec![panel],
    }
}

fn curve((outcome, runs): &(&TaskOutcome, &TaskRuns), colour: usize, best: f64) -> LearnerCurve {
    let tests = |run: usize| runs[run].1.tests.iter().filter(|test| !test.changed);
    let points = tests(0).enumerate().filter_map(|(at, first)| {
        let losses = (0..runs.len()).filter_map(|run| tests(run).nth(at)).map(|test| best - test.score.reward);
        CurvePoint::of(first.tick, losses)
    });
    LearnerCurve { name: outcome.learner.clone(), colour, points: points.collect() }
}
