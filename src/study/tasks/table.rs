//! The table for people.

use std::fmt::Write as _;

use super::{TaskOutcome, TaskTable};
use crate::stats::Spread;
use crate::study::text::cells;
use crate::text::{columns, figures, thousands};

impl TaskTable {
    /// The result as one JSON object.
    pub fn to_json(&self) -> String {
        serde_json::to_string(self).unwrap_or_default()
    }

    /// The result as text.
    pub fn to_text(&self) -> String {
        let mut rows = vec![
            cells(["", "to the level", "", "", "", "", "", ""]),
            cells(["", "median", "worst", "worst s", "end", "reward", "recovery", "ms a tick"]),
        ];
        let mut task = "";
        for outcome in &self.tasks {
            if outcome.task != task {
                task = &outcome.task;
                let mut head = cells([task, "", "", "", "", "", "", ""]);
                let _ = write!(head[0], ": {}", outcome.level);
                rows.push(head);
            }
            rows.push(outcome.row());
        }
        let mut text = columns(&rows);
        let cores = self.machine.get("cores").map_or("the", String::as_str);
        let _ = writeln!(text, "\n{:.1} s, runs sharing {cores} cores; end, reward: worst of the seeds", self.seconds);
        if let Some(folder) = &self.folder {
            let _ = writeln!(text, "folder  {}", folder.display());
        }
        text
    }
}

impl TaskOutcome {
    fn row(&self) -> Vec<String> {
        let [median, worst] = ticks_in_words(&self.ticks_to_level);
        let largest = |values: &[f64]| Spread::of(values.iter().copied()).map(|spread| spread.max);
        let least = |values: &[f64]| Spread::of(values.iter().map(|x| -x)).map(|spread| -spread.max);
        let recovery = match &self.recovery[..] {
            [] => String::new(),
            ticks => ticks_in_words(ticks)[1].clone(),
        };
        let at_once = |words: String| if self.reference && words == "0" { "yes".to_owned() } else { words };
        vec![
            format!("  {}", self.learner),
            at_once(median),
            at_once(worst),
            figures(self.worst_seconds_to_level.filter(|_| !self.reference)),
            format!("{} {}", figures(largest(&self.end)), self.end_unit),
            figures(least(&self.reward)),
            at_once(recovery),
            figures(Some(self.ms_per_tick)),
        ]
    }
}

/// Median and worst number of ticks; a seed that never got there counts as the worst.
fn ticks_in_words(ticks: &[Option<u64>]) -> [String; 2] {
    let mut sorted: Vec<u64> = ticks.iter().map(|t| t.unwrap_or(u64::MAX)).collect();
    sorted.sort_unstable();
    let word = |ticks: Option<&u64>| match ticks {
        Some(&u64::MAX) => "never".to_owned(),
        Some(&ticks) => thousands(ticks),
        None => "-".to_owned(),
    };
    [word(sorted.get(sorted.len().saturating_sub(1) / 2)), word(sorted.last())]
}
