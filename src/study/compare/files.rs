//! The files of a comparison: all that was measured, as CSV and JSON, and the figure.

use std::fmt::Write as _;

use super::{ComparisonResult, DECADES, LEARNERS, name_of};
use crate::report::figure;
use crate::report::figure::learning::{CurvePoint, LearnerCurve, LearningFigure, LearningPanel, ReferenceLine};
use crate::study::{Spread, StudyError};

pub(super) fn write(compared: &ComparisonResult) -> Result<(), StudyError> {
    put(compared, "compare.json", &compared.to_json())?;
    put(compared, "compare.csv", &rows(compared))?;
    put(compared, "curves.csv", &curves(compared))?;
    Ok(figure::learning::draw(&learning(compared), &compared.folder.join("figure.svg"))?)
}

fn put(compared: &ComparisonResult, name: &str, text: &str) -> Result<(), StudyError> {
    let path = compared.folder.join(name);
    std::fs::write(&path, text).map_err(StudyError::write(&path))
}

/// A row for each learner and seed; what there is not stays empty.
fn rows(compared: &ComparisonResult) -> String {
    let changes = compared.learners.iter().map(|l| l.changes.len()).max().unwrap_or(0);
    let mut head: Vec<String> = ["learner", "seed", "ticks", "ticks_to_level"].map(str::to_owned).to_vec();
    head.extend(DECADES.map(|tick| format!("loss_at_{tick}")));
    head.extend(["loss", "share_of_gap", "worst_loss_after_level"].map(str::to_owned));
    head.extend((1..=changes).flat_map(|i| [format!("change_{i}_at"), format!("ticks_to_recover_{i}")]));
    head.extend(["loss_at_end", "diverged_at", "weights_hash"].map(str::to_owned));
    let mut text = head.join(",") + "\n";
    for (learner, rows) in compared.learners.iter().zip(&compared.rows) {
        for row in rows {
            let mut cells = vec![learner.name.clone(), row.seed.to_string(), learner.ticks.to_string()];
            cells.push(show(row.ticks_to_level));
            cells.extend(row.loss_at.map(show));
            cells.extend([row.loss.to_string(), row.share_of_gap.to_string(), show(row.worst_after_level)]);
            cells.extend((0..changes).flat_map(|i| {
                let at = learner.changes.get(i).map(|change| change.tick);
                [show(at), show(row.ticks_to_recover.get(i).copied().flatten())]
            }));
            cells.extend([row.loss_at_end.to_string(), show(row.diverged_at), row.weights_hash.clone()]);
            text += &(cells.join(",") + "\n");
        }
    }
    text
}

fn show<T: ToString>(value: Option<T>) -> String {
    value.map_or_else(String::new, |value| value.to_string())
}

/// A row for each test.
fn curves(compared: &ComparisonResult) -> String {
    let mut text = "learner,seed,tick,changes,loss,miss_m\n".to_owned();
    for ((learner, rows), courses) in compared.learners.iter().zip(&compared.rows).zip(&compared.courses) {
        for (row, course) in rows.iter().zip(courses) {
            for s in &course.samples {
                let (loss, miss) = (s.score.loss, s.score.miss_m);
                let _ = writeln!(text, "{},{},{},{},{loss},{miss}", learner.name, row.seed, s.tick, s.world);
            }
        }
    }
    text
}

/// The learning curves, and one panel for what came after each change.
fn learning(compared: &ComparisonResult) -> LearningFigure {
    let worlds = &compared.references.worlds;
    let panel = |world: usize| {
        let curve = |(number, courses): (usize, &Vec<super::LearnerRun>)| {
            let learner = &compared.learners[number];
            let from = if world == 0 { 0 } else { learner.changes.get(world - 1)?.tick };
            let samples = |i: usize| courses[i].samples.iter().filter(move |s| s.world == world);
            let points = samples(0).enumerate().filter_map(|(at, first)| {
                let losses = (0..courses.len()).filter_map(|i| samples(i).nth(at)).map(|s| s.score.loss);
                let Spread { min, median, max } = Spread::of(losses)?;
                Some(CurvePoint { ticks: first.tick - from, low: min, middle: median, high: max })
            });
            // A learner keeps its colour whoever else is there.
            let colour = LEARNERS.iter().position(|&rule| name_of(rule) == learner.name).unwrap_or(LEARNERS.len());
            Some(LearnerCurve { name: learner.name.clone(), colour, points: points.collect() })
        };
        let classical = worlds[world].damped_least_squares.loss;
        let optimum = worlds[world].trajectory_optimum.loss;
        let line = |name: &str, value| ReferenceLine { name: name.to_owned(), value };
        let lines = if world == 0 {
            let level = line("level", compared.level);
            vec![level, line("damped least squares", classical), line("trajectory optimum", optimum)]
        } else {
            vec![line("least squares", classical), line("optimum", optimum)]
        };
        let ticks: Vec<u64> =
            compared.learners.iter().filter_map(|l| Some(l.changes.get(world.checked_sub(1)?)?.tick)).collect();
        let what = compared.learners.iter().find_map(|l| Some(&l.changes.get(world.checked_sub(1)?)?.change));
        let when = match ticks.first() {
            Some(first) if ticks.iter().all(|tick| tick == first) => {
                format!(" at tick {}", crate::report::thousands(*first))
            }
            _ => String::new(),
        };
        LearningPanel {
            title: what
                .map_or_else(|| "from the beginning".to_owned(), |what| format!("after the change{when}: {what}")),
            x: if world == 0 { "ticks" } else { "ticks since the change" }.to_owned(),
            curves: compared.courses.iter().enumerate().filter_map(curve).collect(),
            lines,
        }
    };
    let (first, last) = (compared.seeds.first().unwrap_or(&0), compared.seeds.last().unwrap_or(&0));
    let seeds = match compared.seeds.len() {
        1 => format!("seed {first}"),
        n => format!("median and range of {n} seeds, {first} to {last}"),
    };
    LearningFigure {
        title: format!("Loss on the test set, without exploration noise; {seeds}"),
        panels: (0..worlds.len()).map(panel).collect(),
    }
}
