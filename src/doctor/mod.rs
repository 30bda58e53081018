//! Is this machine fit for real time, and is everything tidy: `tectum doctor`.
//!
//! Each check says what it found, how good that is, and what to do about it. What counts in the end is measured: how late
//! a thread wakes up that sleeps until an absolute instant, as the plant does. What runs left in shared memory is listed
//! with its owner, and removed on request if it has none.

mod cleanup;
mod lateness;
mod machine;

use std::fmt::Write as _;
use std::path::Path;

use serde::Serialize;

pub use lateness::{Lateness, PERIOD_NS, measure};

use crate::channel::{StaleDomain, list_domains, remove_stale_domains};

/// How good something is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Verdict {
    /// As it should be.
    Fine,
    /// Runs work; the remedy makes them better.
    CouldBeBetter,
    /// Runs fail, or miss their deadlines.
    Problem,
}

impl Verdict {
    /// In words.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Fine => "fine",
            Self::CouldBeBetter => "could be better",
            Self::Problem => "a problem",
        }
    }
}

/// One thing that was looked at.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Check {
    /// What.
    pub name: &'static str,
    /// How good it is.
    pub verdict: Verdict,
    /// What was found.
    pub found: String,
    /// What to do about it; null where nothing is to be done.
    pub remedy: Option<String>,
}

impl Check {
    fn fine(name: &'static str, found: impl Into<String>) -> Self {
        Self { name, verdict: Verdict::Fine, found: found.into(), remedy: None }
    }

    fn better(name: &'static str, found: impl Into<String>, remedy: impl Into<String>) -> Self {
        Self { name, verdict: Verdict::CouldBeBetter, found: found.into(), remedy: Some(remedy.into()) }
    }

    fn problem(name: &'static str, found: impl Into<String>, remedy: impl Into<String>) -> Self {
        Self { verdict: Verdict::Problem, ..Self::better(name, found, remedy) }
    }
}

/// Everything that was found.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Examination {
    /// The worst of all checks.
    pub verdict: Verdict,
    /// The checks, in the order of the text.
    pub checks: Vec<Check>,
    /// How late threads woke up; null where it was not measured.
    pub wake_up_lateness: Option<Lateness>,
    /// What runs have in shared memory, after any cleaning.
    pub domains: Vec<StaleDomain>,
    /// What was removed.
    pub removed: Vec<StaleDomain>,
}

/// Looks at everything: removes first what belongs to nobody if `clean`, measures for `seconds` (0 leaves that out), and
/// looks for room on the disk of `folder`.
pub fn examine(clean: bool, seconds: u32, folder: &Path) -> Examination {
    let removed = if clean { remove_stale_domains(true) } else { Vec::new() };
    let domains = list_domains();
    let mut checks = machine::checks();
    checks.extend(cleanup::room(folder));
    checks.push(cleanup::debris(&domains, &removed));
    let lateness = (seconds > 0).then(|| measure(seconds));
    checks.extend(lateness.as_ref().map(Lateness::check));
    let verdict = checks.iter().map(|check| check.verdict).max().unwrap_or(Verdict::Fine);
    Examination { verdict, checks, wake_up_lateness: lateness, domains, removed }
}

impl Examination {
    /// One JSON object.
    pub fn to_json(&self) -> String {
        serde_json::to_string(self).unwrap_or_default()
    }

    /// A line a check, and the remedies below.
    pub fn to_text(&self) -> String {
        let mut text = String::new();
        for check in &self.checks {
            let _ = writeln!(text, "{:<20} {:<16} {}", check.name, check.verdict.name(), check.found);
            if let Some(remedy) = &check.remedy {
                let _ = writeln!(text, "{:<20} {:<16} -> {remedy}", "", "");
            }
        }
        if let Some(lateness) = &self.wake_up_lateness {
            text.push('\n');
            text += &lateness.to_text();
        }
        text
    }
}

/// Bytes in the unit that suits them.
fn bytes(n: u64) -> String {
    match n {
        n if n < 10 << 20 => format!("{} KiB", n >> 10),
        n if n < 10 << 30 => format!("{} MiB", n >> 20),
        n => format!("{} GiB", n >> 30),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_worst_check_is_the_verdict() {
        let found = examine(false, 0, Path::new("."));
        assert_eq!(found.verdict, found.checks.iter().map(|c| c.verdict).max().unwrap());
        assert!(Verdict::Problem > Verdict::CouldBeBetter && Verdict::CouldBeBetter > Verdict::Fine);
        // Whatever is not as it should be comes with a remedy.
        assert!(found.checks.iter().all(|c| c.remedy.is_some() == (c.verdict != Verdict::Fine)), "{found:?}");
        assert!(found.checks.iter().all(|c| found.to_text().contains(c.name) && !c.found.is_empty()));
        assert!(found.wake_up_lateness.is_none() && found.removed.is_empty());
    }
}
