//! A replay's result as text.

use std::fmt::Write as _;

use super::{Difference, OffPolicy, ReplayResult};
use crate::reference::Score;
use crate::study::compare::name_of;
use crate::text::thousands;

impl ReplayResult {
    /// The result as one JSON object.
    pub fn to_json(&self) -> String {
        serde_json::to_string_pretty(self).unwrap_or_default()
    }

    /// The first difference in a sentence.
    pub fn failure(&self) -> Option<String> {
        let Difference { tick, channel, field, logged, replayed } = self.difference.as_ref()?;
        Some(format!(
            "the log {} does not replay: at tick {tick}, channel {channel}, {field} is {logged}, \
             and should be {replayed}",
            self.log.display()
        ))
    }

    /// The result for people.
    pub fn to_text(&self) -> String {
        let mut text = format!("{}, {}, seed {}\n\n", self.scenario, self.mode, self.seed);
        for warning in &self.warnings {
            push_row(&mut text, "note", warning);
        }
        if self.torn {
            push_row(&mut text, "note", "the log was cut off; it was replayed as far as it goes");
        }
        let plant =
            if self.plant_simulated { ", the plant run again" } else { ", inputs and rewards taken as they are" };
        push_row(&mut text, "observations", &format!("{}{plant}", thousands(self.observations)));
        push_row(&mut text, "commands", &thousands(self.commands));
        let (learnings, hashes) = (thousands(self.learnings), thousands(self.hashes));
        push_row(&mut text, "learning", &format!("{learnings} records, {hashes} hashes of the weights"));
        if self.unseen > 0 {
            let unseen = thousands(self.unseen);
            push_row(&mut text, "unseen", &format!("{unseen} observations that the controller passed by"));
        }
        push_row(&mut text, "weights", &self.weights_hash);
        let result = if self.difference.is_some() { "not the same" } else { "the same, bit for bit" };
        push_row(&mut text, "result", result);
        if let Some(other) = &self.other {
            push_row(&mut text, "", "");
            self.push_other(&mut text, other);
        }
        text
    }

    /// Appends the result of the other learner.
    fn push_other(&self, text: &mut String, other: &OffPolicy) {
        let rule = name_of(other.rule);
        push_row(text, "off-policy", &format!("{rule}, which did not choose the commands that it learned from"));
        let (learned, cuts) = (thousands(other.learned), thousands(other.cuts));
        push_row(text, "learned", &format!("{learned} ticks, its trace cut {cuts} times"));
        push_row(text, "weights", &format!("{}, norm {:.4}", other.weights_hash, other.weights_norm));
        let distance = other.distance;
        push_row(text, "distance", &format!("{distance:.3e} between its mean command and the log's, root mean square"));
        if let (Some(own), Some(score)) = (self.noiseless, other.noiseless) {
            let loss = |score: Score| format!("{:.4} a tick, miss {:.3} m", score.loss, score.miss_m);
            let (score, own) = (loss(score), loss(own));
            push_row(text, "loss", &format!("{score}; the log's own: {own} (40 targets, without noise)"));
        }
        if let Some(tick) = other.diverged_at {
            push_row(text, "diverged", &format!("at tick {tick} its weights were no longer numbers"));
        }
    }
}

/// Appends a line: a key and a value.
fn push_row(text: &mut String, key: &str, value: &str) {
    let line = format!("{key:<14}{value}");
    let _ = writeln!(text, "{}", line.trim_end());
}
