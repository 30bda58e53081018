//! The comparison for people: a few tables as plain text.

use std::fmt::Write as _;

use super::ComparisonResult;
use crate::stats::Spread;
use crate::study::text::cells;
use crate::text::thousands;

impl ComparisonResult {
    /// The result as one JSON object.
    pub fn to_json(&self) -> String {
        serde_json::to_string(self).unwrap_or_default()
    }

    /// The result as tables for people.
    pub fn to_text(&self) -> String {
        let mut text = String::new();
        let (first, last) = (self.seeds.first().unwrap_or(&0), self.seeds.last().unwrap_or(&0));
        let seeds = if first == last { format!("seed {first}") } else { format!("seeds {first} to {last}") };
        let _ = writeln!(
            text,
            "{seeds}: {:.1} s, runs sharing {} cores; level {}\n",
            self.seconds,
            self.cores(),
            self.level
        );
        text += &aligned(&self.learning_table());
        let recovery = self.recovery_table();
        if recovery.len() > 2 {
            let _ = write!(text, "\n{}", aligned(&recovery));
        }
        let _ = write!(text, "\n{}", aligned(&self.reference_table()));
        let folder = self.folder.display();
        let _ =
            writeln!(text, "\nfigure  {folder}/figure.svg\ntables  {folder}/compare.csv, curves.csv and compare.json");
        text
    }

    fn cores(&self) -> &str {
        self.machine.get("cores").map_or("the", String::as_str)
    }

    /// Learning before the first change.
    fn learning_table(&self) -> Vec<Vec<String>> {
        let mut rows = vec![
            cells(["", "", "to the level", "", "loss", "", "gap left", "", "ns a tick", "", ""]),
            cells([
                "learner", "ticks", "median", "worst", "median", "worst", "median", "worst", "median", "p99",
                "diverged",
            ]),
        ];
        for l in &self.learners {
            let until = l.changes.first().map_or(l.ticks, |change| change.tick);
            let [level, worst_level] = ticks_in_words(&l.ticks_to_level);
            let [loss, worst_loss] = spread(l.loss, |x| format!("{x:.4}"));
            let [gap, worst_gap] = spread(l.share_of_gap, |x| format!("{:.1} %", 100.0 * x));
            rows.push(vec![
                l.name.clone(),
                thousands(until),
                level,
                worst_level,
                loss,
                worst_loss,
                gap,
                worst_gap,
                thousands(l.ns_per_tick as u64),
                thousands(l.cost_ns.tick.p99 as u64),
                l.diverged.to_string(),
            ]);
        }
        rows
    }

    /// Recovery after each change.
    fn recovery_table(&self) -> Vec<Vec<String>> {
        let mut rows = vec![
            cells(["", "", "", "got over after", "", "loss at the end", ""]),
            cells(["learner", "change", "at tick", "median", "worst", "median", "worst"]),
        ];
        for l in &self.learners {
            for (i, change) in l.changes.iter().enumerate() {
                let [median, worst] = ticks_in_words(&change.ticks_to_recover);
                let last = i + 1 == l.changes.len();
                let [loss, worst_loss] =
                    if last { spread(l.loss_at_end, |x| format!("{x:.4}")) } else { Default::default() };
                let name = if i == 0 { l.name.clone() } else { String::new() };
                rows.push(vec![name, change.change.clone(), thousands(change.tick), median, worst, loss, worst_loss]);
            }
        }
        rows
    }

    /// The reference controllers, which give the losses a scale: one row per condition.
    fn reference_table(&self) -> Vec<Vec<String>> {
        let mut rows = vec![cells([""]), cells(["for scale"])];
        let controllers = self.references.by_controller();
        for (name, _) in &controllers {
            rows[0].extend(cells([*name, ""]));
            rows[1].extend(cells(["loss", "miss (m)"]));
        }
        for (i, condition) in self.references.conditions.iter().enumerate() {
            let mut row = vec![condition.name.clone()];
            for (_, scores) in &controllers {
                row.extend([format!("{:.4}", scores[i].loss), format!("{:.3}", scores[i].miss_m)]);
            }
            rows.push(row);
        }
        rows
    }
}

/// Median and worst of some ticks. `None`, which stands for never, is later than all ticks.
fn ticks_in_words(ticks: &[Option<u64>]) -> [String; 2] {
    let mut sorted: Vec<u64> = ticks.iter().map(|at| at.unwrap_or(u64::MAX)).collect();
    sorted.sort_unstable();
    let show = |at: Option<&u64>| match at {
        Some(&u64::MAX) => "never".to_owned(),
        Some(&at) => thousands(at),
        None => "-".to_owned(),
    };
    [show(sorted.get(sorted.len().saturating_sub(1) / 2)), show(sorted.last())]
}

/// Median and largest value.
fn spread(spread: Option<Spread>, show: impl Fn(f64) -> String) -> [String; 2] {
    spread.map_or_else(|| ["-".to_owned(), "-".to_owned()], |s| [show(s.median), show(s.max)])
}

/// Aligns rows in columns: words to the left, numbers to the right. The first row names groups of two
/// columns: a name stands over its own column and the next.
fn aligned(rows: &[Vec<String>]) -> String {
    let length = |cell: &String| cell.chars().count();
    let columns = rows.iter().map(Vec::len).max().unwrap_or(0);
    let widest = |column: usize| rows.iter().skip(1).filter_map(|row| row.get(column)).map(length).max().unwrap_or(0);
    let mut widths: Vec<usize> = (0..columns).map(widest).collect();
    for (column, group) in rows[0].iter().enumerate().filter(|(_, group)| !group.is_empty()) {
        let room: usize = widths[column..].iter().take(2).sum::<usize>() + GAP;
        widths[column] += length(group).saturating_sub(room);
    }
    let left = |column: usize| column == 0 || rows[1][column] == "change";
    let mut text = String::new();
    for (number, row) in rows.iter().enumerate() {
        let mut line = String::new();
        let mut column = 0;
        while column < row.len() {
            let double = number == 0 && !row[column].is_empty();
            let width = widths[column] + if double { GAP + widths[column + 1] } else { 0 };
            let gap = if column == 0 { "" } else { "  " };
            let cell = &row[column];
            let _ =
                if left(column) { write!(line, "{gap}{cell:<width$}") } else { write!(line, "{gap}{cell:>width$}") };
            column += if double { 2 } else { 1 };
        }
        text += line.trim_end();
        text.push('\n');
    }
    text
}

/// Blanks between columns.
const GAP: usize = 2;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn never_is_later_than_any_tick() {
        assert_eq!(ticks_in_words(&[Some(3000), None, Some(1000)]), ["3,000", "never"]);
        assert_eq!(ticks_in_words(&[None, None]), ["never", "never"]);
        assert_eq!(ticks_in_words(&[]), ["-", "-"]);
    }

    #[test]
    fn a_group_name_spans_two_columns() {
        let rows = vec![
            cells(["", "to the level", "", ""]),
            cells(["who", "median", "worst", "n"]),
            cells(["paper", "9,000", "never", "1"]),
        ];
        let expected = "        to the level\nwho    median  worst  n\npaper   9,000  never  1\n";
        assert_eq!(aligned(&rows), expected);
    }
}
