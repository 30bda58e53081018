//! Pieces of text that several studies use: cells of tables and of CSV files, lists of seeds, lines of a
//! summary.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use super::error::{StudyError, write_file};
use crate::stats::Spread;
use crate::text::{figures, thousands};

/// Cells of a table's row.
pub(super) fn cells<const N: usize>(words: [&str; N]) -> Vec<String> {
    words.map(str::to_owned).to_vec()
}

/// A value as a cell of a CSV file; empty for `None`.
pub(super) fn csv_cell<T: ToString>(value: Option<T>) -> String {
    value.map_or_else(String::new, |value| value.to_string())
}

/// Writes a file of lines.
pub(super) fn write_lines(path: &Path, lines: &[String]) -> Result<(), StudyError> {
    let text: String = lines.iter().flat_map(|line| [line.as_str(), "\n"]).collect();
    write_file(path, text)
}

/// `0.0731 (0.0720 to 0.0743)`: median, smallest and largest value; `-` for `None`.
pub(super) fn spread_in_words(spread: Option<Spread>) -> String {
    match spread {
        Some(s) => {
            let [median, min, max] = [s.median, s.min, s.max].map(|x| figures(Some(x)));
            format!("{median} ({min} to {max})")
        }
        None => "-".to_owned(),
    }
}

/// Whose runs a figure shows: `median and range of 3 seeds, 5000 to 5002`.
pub(super) fn seeds_shown(seeds: &[u64]) -> String {
    match seeds {
        [] => "no seeds".to_owned(),
        [seed] => format!("seed {seed}"),
        [first, .., last] => format!("median and range of {} seeds, {first} to {last}", seeds.len()),
    }
}

/// Appends one line for each seed whose weights diverged: `<name>seed 3 diverged at <unit> 1,204`.
pub(super) fn push_divergences(text: &mut String, name: &str, unit: &str, seeds: &[u64], diverged: &[Option<u64>]) {
    for (seed, tick) in seeds.iter().zip(diverged) {
        if let Some(tick) = tick {
            let _ = writeln!(text, "{name}seed {seed} diverged at {unit} {}", thousands(*tick));
        }
    }
}

/// Appends one line for each result file.
pub(super) fn push_files(text: &mut String, figure: Option<&Path>, tables: &[PathBuf]) {
    if let Some(figure) = figure {
        let _ = writeln!(text, "figure  {}", figure.display());
    }
    for table in tables {
        let _ = writeln!(text, "table   {}", table.display());
    }
}
