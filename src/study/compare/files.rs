//! The files of a comparison: all measurements as CSV and JSON, and the figure.

use std::fmt::Write as _;

use super::{ComparisonResult, DECADES, LearnerRun, colour_number};
use crate::report::figure;
use crate::report::figure::learning::{CurvePoint, LearnerCurve, LearningFigure, LearningPanel, ReferenceLine};
use crate::study::StudyError;
use crate::study::error::write_file;
use crate::study::text::{csv_cell, seeds_shown};
use crate::text::thousands;

/// The figure shows losses up to this one: standing still costs 0.63.
const HIGHEST: f64 = 2.0;

pub(super) fn write(result: &ComparisonResult) -> Result<(), StudyError> {
    let path = |name: &str| result.folder.join(name);
    write_file(&path("compare.json"), result.to_json())?;
    write_file(&path("compare.csv"), seed_rows(result))?;
    write_file(&path("curves.csv"), test_rows(result))?;
    Ok(figure::learning::draw(&learning_figure(result), &path("figure.svg"))?)
}

/// `compare.csv`: one row per learner and seed. A missing value is an empty cell.
fn seed_rows(result: &ComparisonResult) -> String {
    let changes = result.learners.iter().map(|l| l.changes.len()).max().unwrap_or(0);
    let mut head: Vec<String> = ["learner", "seed", "ticks", "ticks_to_level"].map(str::to_owned).to_vec();
    head.extend(DECADES.map(|tick| format!("loss_at_{tick}")));
    head.extend(["loss", "share_of_gap", "worst_loss_after_level"].map(str::to_owned));
    head.extend((1..=changes).flat_map(|i| [format!("change_{i}_at"), format!("ticks_to_recover_{i}")]));
    head.extend(["loss_at_end", "diverged_at", "weights_hash"].map(str::to_owned));
    let mut text = head.join(",") + "\n";
    for (learner, rows) in result.learners.iter().zip(&result.rows) {
        for row in rows {
            let mut cells = vec![learner.name.clone(), row.seed.to_string(), learner.ticks.to_string()];
            cells.push(csv_cell(row.ticks_to_level));
            cells.extend(row.loss_at.map(csv_cell));
            cells.extend([row.loss.to_string(), row.share_of_gap.to_string(), csv_cell(row.worst_after_level)]);
            cells.extend((0..changes).flat_map(|i| {
                let at = learner.changes.get(i).map(|change| change.tick);
                [csv_cell(at), csv_cell(row.ticks_to_recover.get(i).copied().flatten())]
            }));
            cells.extend([row.loss_at_end.to_string(), csv_cell(row.diverged_at), row.weights_hash.clone()]);
            text += &(cells.join(",") + "\n");
        }
    }
    text
}

/// `curves.csv`: one row per test.
fn test_rows(result: &ComparisonResult) -> String {
    let mut text = "learner,seed,tick,changes,loss,miss_m\n".to_owned();
    for ((learner, rows), runs) in result.learners.iter().zip(&result.rows).zip(&result.runs) {
        for (row, run) in rows.iter().zip(runs) {
            for test in &run.tests {
                let (loss, miss) = (test.score.loss, test.score.miss_m);
                let _ = writeln!(text, "{},{},{},{},{loss},{miss}", learner.name, row.seed, test.tick, test.condition);
            }
        }
    }
    text
}

/// The learning curves from the beginning, and one panel for each change.
fn learning_figure(result: &ComparisonResult) -> LearningFigure {
    let panel = |condition: usize| LearningPanel {
        title: panel_title(result, condition),
        x: if condition == 0 { "ticks" } else { "ticks since the change" }.to_owned(),
        curves: (0..result.runs.len()).filter_map(|learner| curve(result, condition, learner)).collect(),
        lines: reference_lines(result, condition),
    };
    LearningFigure {
        title: format!("Loss on the test set, without exploration noise; {}", seeds_shown(&result.seeds)),
        y: "loss a tick",
        highest: HIGHEST,
        panels: (0..result.references.conditions.len()).map(panel).collect(),
    }
}

/// The losses of one learner in one condition, over the ticks since its beginning. `None` if the learner does
/// not meet it.
fn curve(result: &ComparisonResult, condition: usize, learner: usize) -> Option<LearnerCurve> {
    let runs: &[LearnerRun] = &result.runs[learner];
    let learner = &result.learners[learner];
    let from = if condition == 0 { 0 } else { learner.changes.get(condition - 1)?.tick };
    let tests = |run: usize| runs[run].tests.iter().filter(move |test| test.condition == condition);
    let points = tests(0).enumerate().filter_map(|(at, first)| {
        let losses = (0..runs.len()).filter_map(|run| tests(run).nth(at)).map(|test| test.score.loss);
        CurvePoint::of(first.tick - from, losses)
    });
    let colour = colour_number(&learner.name, result.learners.iter().map(|other| &other.name[..]));
    Some(LearnerCurve { name: learner.name.clone(), colour, points: points.collect() })
}

/// The losses of the reference controllers in one condition, and the level in the first.
fn reference_lines(result: &ComparisonResult, condition: usize) -> Vec<ReferenceLine> {
    let scores = &result.references.conditions[condition];
    let classical = scores.damped_least_squares.loss;
    let optimum = scores.trajectory_optimum.loss;
    let line = |name: &str, value| ReferenceLine { name: name.to_owned(), value };
    if condition == 0 {
        let level = line("level", result.level);
        vec![level, line("damped least squares", classical), line("trajectory optimum", optimum)]
    } else {
        vec![line("least squares", classical), line("optimum", optimum)]
    }
}

/// The change, with its tick if that is the same for all learners.
fn panel_title(result: &ComparisonResult, condition: usize) -> String {
    let changes: Vec<_> = result.learners.iter().filter_map(|l| l.changes.get(condition.checked_sub(1)?)).collect();
    let Some(first) = changes.first() else { return "from the beginning".to_owned() };
    let when = if changes.iter().all(|change| change.tick == first.tick) {
        format!(" at tick {}", thousands(first.tick))
    } else {
        String::new()
    };
    format!("after the change{when}: {}", first.change)
}
