//! `tectum doctor`: checks whether this machine is fit for real time, and finds what earlier runs left in
//! shared memory.
//!
//! Each check reports what it found, how good that is, and a remedy. The decisive value is measured: how late a
//! thread wakes up that sleeps until an absolute instant, as the plant does. Domains in shared memory are
//! listed with their owners; those without an owner are removed on request.

mod cleanup;
mod lateness;
mod machine;

use std::fmt::Write as _;
use std::path::Path;

use serde::Serialize;

pub use lateness::Lateness;
use lateness::measure;

use crate::channel::{StaleDomain, list_domains, remove_stale_domains};

/// The result of a check.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Verdict {
    /// As it should be.
    Fine,
    /// Runs work; the remedy improves them.
    CouldBeBetter,
    /// Runs fail or miss their deadlines.
    Problem,
}

impl Verdict {
    /// The verdict in words.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Fine => "fine",
            Self::CouldBeBetter => "could be better",
            Self::Problem => "a problem",
        }
    }
}

/// One check of the machine.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Check {
    /// Name of the check.
    pub name: &'static str,
    /// Its result.
    pub verdict: Verdict,
    /// What was found.
    pub found: String,
    /// What to do about it; null where nothing needs to be done.
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

/// All results.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Examination {
    /// The worst verdict of all checks.
    pub verdict: Verdict,
    /// The checks, in the order of the text output.
    pub checks: Vec<Check>,
    /// How late threads woke up; null where it was not measured.
    pub wake_up_lateness: Option<Lateness>,
    /// The domains of runs in shared memory, after any cleaning.
    pub domains: Vec<StaleDomain>,
    /// The domains that were removed.
    pub removed: Vec<StaleDomain>,
}

/// Runs all checks. With `clean`, first removes domains that have no owner. Measures the wake-up lateness for
/// `seconds` (0 skips it), and checks the free space on the disk of `folder`.
pub fn examine(clean: bool, seconds: u32, folder: &Path) -> Examination {
    let removed = if clean { remove_stale_domains(true) } else { Vec::new() };
    let domains = list_domains();
    let mut checks = machine::checks();
    checks.extend(cleanup::free_space(folder));
    checks.push(cleanup::removal_at_logout());
    checks.push(cleanup::debris(&domains, &removed));
    let lateness = (seconds > 0).then(|| measure(seconds));
    checks.extend(lateness.as_ref().map(Lateness::check));
    let verdict = checks.iter().map(|check| check.verdict).max().unwrap_or(Verdict::Fine);
    Examination { verdict, checks, wake_up_lateness: lateness, domains, removed }
}

impl Examination {
    /// The results as one JSON object.
    pub fn to_json(&self) -> String {
        serde_json::to_string(self).unwrap_or_default()
    }

    /// One line per check, with its remedy below.
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

/// Formats a number of bytes in KiB, MiB or GiB.
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
        // Every check that is not fine has a remedy.
        assert!(found.checks.iter().all(|c| c.remedy.is_some() == (c.verdict != Verdict::Fine)), "{found:?}");
        assert!(found.checks.iter().all(|c| found.to_text().contains(c.name) && !c.found.is_empty()));
        assert!(found.wake_up_lateness.is_none() && found.removed.is_empty());
    }
}
