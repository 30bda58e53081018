//! A description of the machine, which stands beside every result.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::fs;
use std::path::Path;

use serde::Serialize;

use crate::clock::{cores, last_level_cache, machine_facts, wall_ns};
use crate::doctor::{Check, Verdict, examine};
use crate::text::utc_minute;

/// The properties of the machine that results may depend on.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct Machine {
    /// Processor, kernel, memory.
    pub facts: BTreeMap<String, String>,
    /// The checks of `tectum doctor`.
    pub checks: Vec<Check>,
    /// Cores that this process may use.
    pub cores: Vec<u32>,
    /// Size of the last-level cache, KiB.
    pub last_level_cache_kib: usize,
    /// The kernel's mitigations of processor vulnerabilities, by vulnerability; without those that do not apply.
    pub mitigations: BTreeMap<String, String>,
    /// The date, UTC.
    pub date: String,
    /// Version and commit of this program.
    pub build: &'static str,
}

impl Machine {
    /// This machine, now. The free disk space is that of `folder`.
    pub fn now(folder: &Path) -> Self {
        let entries = fs::read_dir("/sys/devices/system/cpu/vulnerabilities").into_iter().flatten().flatten();
        let mitigations = entries
            .filter_map(|entry| {
                let text = fs::read_to_string(entry.path()).ok()?.trim().to_owned();
                (text != "Not affected").then(|| (entry.file_name().to_string_lossy().into_owned(), text))
            })
            .collect();
        Self {
            facts: machine_facts(),
            checks: examine(false, 0, folder).checks,
            cores: cores(),
            last_level_cache_kib: last_level_cache() >> 10,
            mitigations,
            date: utc_minute(wall_ns() / 1_000_000_000),
            build: crate::BUILD,
        }
    }

    /// Two to four lines for people.
    pub fn to_text(&self) -> String {
        let fact = |key: &str| self.facts.get(key).map_or("?", String::as_str);
        let found = |name: &str| self.checks.iter().find(|c| c.name == name).map_or("?", |c| c.found.as_str());
        let mut text = format!(
            "{}, {} ({} cores, last-level cache {} KiB), {}, {}\ngovernor: {}; clock source: {}; load: {}\n",
            self.date,
            fact("processor"),
            self.cores.len(),
            self.last_level_cache_kib,
            fact("kernel"),
            self.build,
            found("frequency governor"),
            found("clock source"),
            found("load"),
        );
        if !self.mitigations.is_empty() {
            let all: Vec<_> = self.mitigations.iter().map(|(name, what)| format!("{name} ({what})")).collect();
            let _ = writeln!(text, "mitigations: {}", all.join("; "));
        }
        let not_fine = self.checks.iter().filter(|c| c.verdict != Verdict::Fine);
        let not_fine: Vec<_> = not_fine.map(|c| format!("{}: {}", c.name, c.found)).collect();
        if !not_fine.is_empty() {
            let _ = writeln!(text, "not as it should be: {}", not_fine.join("; "));
        }
        text
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_text_names_the_governor_and_the_build() {
        let machine = Machine::now(Path::new("."));
        assert!(!machine.cores.is_empty() && machine.last_level_cache_kib > 0);
        let text = machine.to_text();
        assert!(text.contains("governor: ") && text.contains(crate::BUILD), "{text}");
    }
}
