//! Shared by all tests that start real processes: the test kit, and scenarios of this repository for it.
//!
//! The kit (`crates/tectum-testkit`) starts the programs, waits, kills and looks at what is left. What stands here is
//! of use to this repository's tests alone.

#![allow(dead_code, unused_imports)] // Each test binary uses only a part of this module.

pub mod browser;
pub mod bytes;
pub mod content;
pub mod python;
pub mod slow;
pub mod snapshot;
pub mod terminal;
pub mod web_watcher;

use std::fs;
use std::ops::Deref;
use std::path::{Path, PathBuf};

pub use tectum_testkit::{
    Process, ProcessOutcome, WATCHDOG, assert_no_debris, children, domain, has_ended, program, read_json,
    shared_memory, signal_process, stop_process_for,
};

/// The `tectum` program under test.
pub const TECTUM: &str = env!("CARGO_BIN_EXE_tectum");

/// `[learner]` of a model-predictive learner with small models and short plans, so that debug builds are quick.
pub const SMALL_PLANNER: &str = "[learner]\nrule = \"model-predictive\"\n[learner.plan]\nhorizon = 8\nmemory = 400\n\
    points = 40\nreward_features = 150\ndynamics_features = 150\nrival_iterations = 2\nrefit_operations = 2.0\n";

/// Writes a copy of a shipped scenario with [`SMALL_PLANNER`] in place of its learner, every tick in its log, and
/// `more` appended. Returns its path.
pub fn planner_scenario(test_folder: &TestFolder, name: &str, more: &str) -> String {
    let text = unpacked(&fs::read_to_string(format!("scenarios/{name}.toml")).unwrap());
    let (head, rest) = text.split_once("\n[learner]").unwrap();
    let (_, tail) = rest.split_once("\n[gate]").unwrap();
    let text = format!("{head}\n{SMALL_PLANNER}\n[gate]{tail}\n{more}");
    test_folder.write_file("planner.toml", text).to_str().unwrap().to_owned()
}

/// The path of an example program; cargo builds the examples beside the binaries.
pub fn example(name: &str) -> PathBuf {
    Path::new(TECTUM).parent().unwrap().join("examples").join(name)
}

/// The kit's folder, with the scenarios of this repository.
pub struct TestFolder(tectum_testkit::TestFolder);

impl Deref for TestFolder {
    type Target = tectum_testkit::TestFolder;

    fn deref(&self) -> &Self::Target {
        &self.0
    }
}

impl TestFolder {
    pub fn new() -> Self {
        Self(tectum_testkit::TestFolder::new())
    }

    /// A folder whose programs may take longer than the usual [`WATCHDOG`].
    pub fn with_watchdog(watchdog: std::time::Duration) -> Self {
        Self(tectum_testkit::TestFolder::new().with_watchdog(watchdog))
    }

    /// Writes a copy of `scenarios/paper.toml` with other values for some keys, and returns its path. The paper's
    /// rule is quick. Of a key that occurs several times, the first occurrence is changed.
    #[track_caller]
    pub fn arm_scenario(&self, changes: &[(&str, &str)]) -> String {
        self.scenario("paper", changes, "")
    }

    /// Like [`arm_scenario`](Self::arm_scenario) for any shipped scenario, with `more` appended to its text. Lines
    /// stay where they are, for messages that name them. The log stays as it was written: what a test does to its bytes
    /// would otherwise be done to compressed chunks.
    #[track_caller]
    pub fn scenario(&self, name: &str, changes: &[(&str, &str)], more: &str) -> String {
        let text = unpacked(&fs::read_to_string(format!("scenarios/{name}.toml")).unwrap()) + more;
        let mut lines: Vec<String> = text.lines().map(str::to_owned).collect();
        for (key, value) in changes {
            let line = lines.iter_mut().find(|line| line.split(" = ").next() == Some(key));
            *line.unwrap_or_else(|| panic!("no key {key}")) = format!("{key} = {value}");
        }
        self.write_file("scenario.toml", lines.join("\n")).to_str().unwrap().to_owned()
    }

    /// A scenario like that of [`arm_scenario`](Self::arm_scenario), with a period of 5 ms, that does not end within a
    /// test. A run checks before it starts that there is disk space for its whole log. So this log is thinned where
    /// ticks are quick, and a machine that is short of disk space can still run the tests.
    pub fn endless_scenario(&self, mode: &str) -> String {
        let (ticks, every) = if mode == "lockstep" { ("10_000_000", "20") } else { ("500_000", "1") };
        self.arm_scenario(&[("ticks", ticks), ("every", every), ("period_ms", "5")])
    }

    /// Starts a subcommand of `tectum` that must refuse its input, and returns the message.
    #[track_caller]
    pub fn refused(&self, command: &str, arguments: &[&str]) -> String {
        self.tectum(command, arguments).refusal()
    }
}

/// The scenario with `pack = false` in place of the first line under `[log]` that says nothing, or at its end.
fn unpacked(scenario: &str) -> String {
    let mut lines: Vec<&str> = scenario.lines().collect();
    let Some(log) = lines.iter().position(|line| *line == "[log]") else { return scenario.to_owned() };
    match lines[log..].iter().position(|line| line.is_empty() || line.starts_with('#')) {
        Some(free) => lines[log + free] = "pack = false",
        None => lines.push("pack = false"),
    }
    lines.join("\n") + "\n"
}

/// Appends text to a file.
#[track_caller]
pub fn append(path: impl AsRef<Path>, more: &str) {
    let text = fs::read_to_string(&path).unwrap() + more;
    fs::write(path, text).unwrap();
}
