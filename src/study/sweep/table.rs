//! The tables of a sweep: CSV files, and text for people.

use super::SweepResult;
use crate::study::StudyError;
use crate::study::text::{cells, csv_cell, push_files, spread_in_words, write_lines};
use crate::text::columns;

/// A cell with text; in quotes if it needs them.
fn text_cell(text: &str) -> String {
    if text.contains([',', '"', '\n']) { format!("\"{}\"", text.replace('"', "\"\"")) } else { text.to_owned() }
}

/// Writes `sweep.csv`, a row for each combination and seed, and `curves.csv`, a row for each window of each run.
pub(super) fn write_tables(result: &SweepResult) -> Result<(), StudyError> {
    let keys: Vec<&String> = result.rows.first().map_or_else(Vec::new, |row| row.settings.keys().collect());
    let head = |more: &str| {
        let keys = keys.iter().map(|key| text_cell(key));
        keys.chain([more.to_owned()]).collect::<Vec<_>>().join(",")
    };
    let mut rows =
        vec![head("seed,ticks,first_loss,loss,loss_without_noise,end_error,missed,learned,diverged_at,hash")];
    let mut curves = vec![head("seed,from,ticks,loss,loss_without_noise,end_error")];
    for (row, runs) in result.rows.iter().zip(&result.runs) {
        let settings: String = row.settings.values().map(|value| text_cell(value) + ",").collect();
        for (seed, run) in result.seeds.iter().zip(runs) {
            let ends = run.ends();
            let [first, last] = [0, 1].map(|i| ends.as_ref().map(|ends| &ends[i]));
            let numbers = [
                csv_cell(first.map(|w| w.loss)),
                csv_cell(last.map(|w| w.loss)),
                csv_cell(last.map(|w| w.loss_without_noise())),
                csv_cell(last.and_then(|w| w.end_error)),
                run.missed.to_string(),
                run.learned.to_string(),
                csv_cell(run.diverged_at),
                run.weights_hash.clone(),
            ];
            rows.push(format!("{settings}{seed},{},{}", run.ticks, numbers.join(",")));
            for w in &run.windows {
                let (from, ticks, loss, end) = (w.from, w.ticks, w.loss, csv_cell(w.end_error));
                curves.push(format!("{settings}{seed},{from},{ticks},{loss},{},{end}", w.loss_without_noise()));
            }
        }
    }
    write_lines(&result.csv[0], &rows)?;
    write_lines(&result.csv[1], &curves)
}

impl SweepResult {
    /// The result as a table for people.
    pub fn to_text(&self) -> String {
        let seeds = crate::study::reproduce::seeds_in_words(&self.seeds);
        let mut text = format!("sweep over {}, {seeds}: {:.1} s\n\n", self.scenario, self.seconds);
        let mut rows =
            vec![cells(["settings", "loss at first", "loss at the end", "error at a target's end", "diverged"])];
        for (name, row) in self.names.iter().zip(&self.rows) {
            rows.push(vec![
                if name.is_empty() { "as in the scenario".to_owned() } else { name.clone() },
                spread_in_words(row.first_loss),
                spread_in_words(row.loss),
                spread_in_words(row.end_error),
                row.diverged.iter().filter(|tick| tick.is_some()).count().to_string(),
            ]);
        }
        text.push_str(&columns(&rows));
        text.push_str("\nmedian over seeds (least to largest); means over the first and the last twentieth of a run\n");
        push_files(&mut text, Some(&self.figure), &self.csv);
        text
    }
}
