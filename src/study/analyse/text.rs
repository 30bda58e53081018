//! An analysis for people and for spreadsheets.

use std::fmt::Write as _;

use super::movement::{COLUMNS, Measures};
use super::{Analysis, Fit, MovementGroup, MovementGroups};
use crate::report::thousands;

/// The measures in the table: name in [`COLUMNS`], words, decimals.
const LINES: [(&str, &str, usize); 14] = [
    ("distance_m", "distance to the target (m)", 2),
    ("onset_s", "appearance to onset (s)", 2),
    ("duration_s", "duration of the reach (s)", 2),
    ("peak_speed_m_s", "peak speed (m/s)", 2),
    ("mean_speed_m_s", "mean speed (m/s)", 2),
    ("peak_to_mean", "peak speed / mean speed", 2),
    ("peak_position", "where in the reach the peak lies", 2),
    ("symmetry", "symmetry of the profile", 2),
    ("peaks", "peaks of the profile", 1),
    ("straightness", "path / straight line", 2),
    ("deviation", "deviation / straight line", 2),
    ("settled_s", "settled after (s)", 2),
    ("settled_share_s", "settled after (s)", 2),
    ("end_error_m", "error at the end (m)", 3),
];

impl Analysis {
    /// One JSON object.
    pub fn to_json(&self) -> String {
        serde_json::to_string(self).unwrap_or_default()
    }

    /// One row a movement; a measure that there is not is an empty cell.
    pub fn to_csv(&self) -> String {
        let mut text = "from_tick,ticks".to_owned();
        for prefix in ["measured", "noiseless"] {
            COLUMNS.iter().for_each(|(name, _)| text += &format!(",{prefix}_{name}"));
        }
        text.push('\n');
        let none = Measures::default();
        for row in &self.rows {
            let _ = write!(text, "{},{}", row.from, row.ticks);
            for (known, measures) in
                [(true, &row.measured), (row.noiseless.is_some(), row.noiseless.as_ref().unwrap_or(&none))]
            {
                for (_, value) in COLUMNS {
                    match value(measures).filter(|_| known) {
                        Some(x) => drop(write!(text, ",{x}")),
                        None => text.push(','),
                    }
                }
            }
            text.push('\n');
        }
        text
    }

    /// The table for people.
    pub fn to_text(&self) -> String {
        let mut text = format!(
            "{}, seed {}: {} movements in {} ticks",
            self.scenario,
            self.seed,
            thousands(self.n as u64),
            thousands(self.ticks)
        );
        let left_out = self.left_out;
        let reasons = [
            (left_out.without_start, "without a measured start"),
            (left_out.gaps, "with gaps or missed ticks"),
            (left_out.unfinished, "unfinished"),
        ];
        let reasons: Vec<String> =
            reasons.iter().filter(|(n, _)| *n > 0).map(|(n, why)| format!("{} {why}", thousands(*n))).collect();
        if !reasons.is_empty() {
            let _ = write!(text, "; left out: {}", reasons.join(", "));
        }
        text.push('\n');
        if self.torn {
            text += "The log was cut off; it was analysed as far as it goes.\n";
        }
        if let Some(view) = &self.noiseless {
            text += &self.table("without exploration noise", view, true);
        }
        text += &self.table("as measured, exploration noise included", &self.measured, self.noiseless.is_none());
        if let Some(why) = &self.noiseless_missing {
            let _ = writeln!(text, "without exploration noise: {why}");
        }
        text
    }

    /// Medians at the beginning, at the end, of all, and of the movement to compare with; then isochrony, if `whole`.
    fn table(&self, head: &str, view: &MovementGroups, whole: bool) -> String {
        let mut rows = vec![[
            format!("medians, {head}"),
            format!("first {}", thousands(view.early.n as u64)),
            format!("last {}", thousands(view.late.n as u64)),
            "all".to_owned(),
            if whole { "minimum jerk".to_owned() } else { String::new() },
        ]];
        for (name, words, decimals) in LINES {
            // With noise in them, speeds say how the noise shakes the arm, and where a reach begins and ends, nothing.
            let shaken =
                ["onset_s", "duration_s", "mean_speed_m_s", "peak_to_mean", "peak_position", "symmetry", "deviation"];
            if !whole && shaken.contains(&name) {
                continue;
            }
            let number = |x: Option<f64>| x.map_or("-".to_owned(), |x| format!("{x:.decimals$}"));
            let median = |group: &MovementGroup| {
                let share = match name {
                    "duration_s" => group.completed,
                    "settled_s" => group.settled,
                    "settled_share_s" => group.settled_share,
                    _ => return number(group.get(name).map(|q| q.median)),
                };
                format!("{} ({:.0} %)", number(group.get(name).map(|q| q.median)), 100.0 * share)
            };
            let words = match name {
                "duration_s" => format!("{words}, of those that ended"),
                "settled_s" => format!("{words} within {} m", self.definitions.near_m),
                "settled_share_s" => {
                    format!("{words} within {:.0} % of the distance", 100.0 * self.definitions.near_share)
                }
                _ => words.to_owned(),
            };
            let jerk =
                COLUMNS.iter().find(|(column, _)| *column == name).and_then(|(_, value)| value(&self.minimum_jerk));
            let jerk = if whole { number(jerk) } else { String::new() };
            rows.push([words, median(&view.early), median(&view.late), median(&view.all), jerk]);
        }
        let widths: [usize; 5] =
            std::array::from_fn(|column| rows.iter().map(|row| row[column].chars().count()).max().unwrap_or(0));
        let mut text = "\n".to_owned();
        for row in &rows {
            let mut line = format!("{:<1$}", row[0], widths[0]);
            for (cell, width) in row.iter().zip(widths).skip(1) {
                let _ = write!(line, "  {cell:>width$}");
            }
            text += line.trim_end();
            text.push('\n');
        }
        if whole {
            for (which, group) in [("last", &view.late), ("all", &view.all)] {
                let _ = writeln!(
                    text,
                    "isochrony, {which} {}: duration {}; peak speed {}",
                    thousands(group.n as u64),
                    line(group.isochrony.duration, "s"),
                    line(group.isochrony.peak_speed, "m/s"),
                );
            }
        }
        text
    }
}

/// `0.62 s + 0.05 s for a metre more (r 0.31)`.
fn line(fit: Option<Fit>, unit: &str) -> String {
    let Some(fit) = fit else { return "-".to_owned() };
    let sign = if fit.slope < 0.0 { '-' } else { '+' };
    let r = fit.r.map_or(String::new(), |r| format!(" (r {r:.2})"));
    format!("{:.2} {unit} {sign} {:.2} {unit} a metre{r}", fit.intercept, fit.slope.abs())
}
