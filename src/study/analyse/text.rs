//! An analysis as text: tables for people, CSV for spreadsheets.

use std::fmt::Write as _;

use super::movement::{COLUMNS, Measures};
use super::{Analysis, Fit, MovementGroup, MovementGroups};
use crate::study::text::csv_cell;
use crate::text::{columns, thousands};

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

/// Measures that mean nothing with exploration noise: the speeds are those of the noise, and the beginning
/// and the end of a reach cannot be found.
const NOISE_SENSITIVE: [&str; 7] =
    ["onset_s", "duration_s", "mean_speed_m_s", "peak_to_mean", "peak_position", "symmetry", "deviation"];

impl Analysis {
    /// The result as one JSON object.
    pub fn to_json(&self) -> String {
        serde_json::to_string(self).unwrap_or_default()
    }

    /// The movements as CSV, one per row. A measure that does not exist is an empty cell.
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
                    let _ = write!(text, ",{}", csv_cell(value(measures).filter(|_| known)));
                }
            }
            text.push('\n');
        }
        text
    }

    /// The result as tables for people.
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
        if let Some(groups) = &self.noiseless {
            text += &self.table("without exploration noise", groups, true);
        }
        text += &self.table("as measured, exploration noise included", &self.measured, self.noiseless.is_none());
        if let Some(why) = &self.noiseless_missing {
            let _ = writeln!(text, "without exploration noise: {why}");
        }
        text
    }

    /// A table of medians at the beginning, at the end, and of all movements. A `complete` table also has the
    /// minimum-jerk movement, the measures that exploration noise would spoil, and isochrony.
    fn table(&self, title: &str, groups: &MovementGroups, complete: bool) -> String {
        let mut rows = vec![[
            format!("medians, {title}"),
            format!("first {}", thousands(groups.early.n as u64)),
            format!("last {}", thousands(groups.late.n as u64)),
            "all".to_owned(),
            if complete { "minimum jerk".to_owned() } else { String::new() },
        ]];
        for line in LINES {
            if complete || !NOISE_SENSITIVE.contains(&line.0) {
                rows.push(self.table_row(line, groups, complete));
            }
        }
        let mut text = "\n".to_owned() + &columns(&rows);
        if complete {
            for (which, group) in [("last", &groups.late), ("all", &groups.all)] {
                let _ = writeln!(
                    text,
                    "isochrony, {which} {}: duration {}; peak speed {}",
                    thousands(group.n as u64),
                    fit_in_words(group.isochrony.duration, "s"),
                    fit_in_words(group.isochrony.peak_speed, "m/s"),
                );
            }
        }
        text
    }

    /// The row of one measure.
    fn table_row(
        &self,
        (name, words, decimals): (&str, &str, usize),
        groups: &MovementGroups,
        complete: bool,
    ) -> [String; 5] {
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
            "settled_share_s" => format!("{words} within {:.0} % of the distance", 100.0 * self.definitions.near_share),
            _ => words.to_owned(),
        };
        let jerk = COLUMNS.iter().find(|(column, _)| *column == name).and_then(|(_, value)| value(&self.minimum_jerk));
        let jerk = if complete { number(jerk) } else { String::new() };
        [words, median(&groups.early), median(&groups.late), median(&groups.all), jerk]
    }
}

/// A straight line in words: `0.62 s + 0.05 s a metre (r 0.31)`.
fn fit_in_words(fit: Option<Fit>, unit: &str) -> String {
    let Some(fit) = fit else { return "-".to_owned() };
    let sign = if fit.slope < 0.0 { '-' } else { '+' };
    let r = fit.r.map_or(String::new(), |r| format!(" (r {r:.2})"));
    format!("{:.2} {unit} {sign} {:.2} {unit} a metre{r}", fit.intercept, fit.slope.abs())
}
