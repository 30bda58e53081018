//! The paper's experiments, run again: the closed-loop arm of its figure 4, the saccades of its figure 2, the open-loop arm
//! that it only mentions, and its outlook.
//!
//! Every experiment is one of the built-in scenarios under several seeds. What comes out is shown as the paper shows it,
//! with the spread over seeds that the paper does not have.

mod arm;
mod eye;
mod open_loop;
mod outlook;

pub use arm::{ArmResult, ArmRow, arm};
pub use eye::{EyeResult, EyeRow, EyeVariant, eye};
pub use open_loop::{OpenLoopArm, OpenLoopResult, open_loop};
pub use outlook::{OutlookResult, OutlookRow, outlook};

use std::io::Write as _;
use std::path::{Path, PathBuf};

use super::{ChildProcesses, Spread, StudyError};
use crate::report::figures;
use crate::supervise::{LaunchError, RunFolder};

/// What to reproduce, and how much of it.
#[derive(Debug, Clone)]
pub struct ReproduceSettings {
    /// Number of seeds.
    pub seeds: u64,
    /// The first of them; the others follow.
    pub first_seed: u64,
    /// Ticks (or trials) of each run; `None` for the paper's.
    pub ticks: Option<u64>,
    /// Folder for the files; `None` for `runs/<experiment>-<n>`.
    pub out: Option<PathBuf>,
    /// Show a progress line on standard error, if that is a terminal.
    pub progress: bool,
}

impl ReproduceSettings {
    fn seeds(&self) -> Vec<u64> {
        (self.first_seed..self.first_seed.saturating_add(self.seeds)).collect()
    }

    fn pool(&self) -> Result<ChildProcesses, StudyError> {
        ChildProcesses::new(self.progress).map_err(|e| LaunchError::Signals(e).into())
    }

    /// `5 seeds from 1`
    fn in_words(&self) -> String {
        match self.seeds {
            1 => format!("seed {}", self.first_seed),
            n => format!("{n} seeds from {}", self.first_seed),
        }
    }

    /// The folder of the experiment called `name`: made first, so that a place that cannot be written is no surprise after
    /// a minute's work.
    fn folder(&self, name: &str) -> Result<RunFolder, StudyError> {
        Ok(RunFolder::create(self.out.as_deref(), None, name)?)
    }
}

/// Writes a file of lines.
fn write_lines(path: &Path, lines: impl IntoIterator<Item = String>) -> Result<(), StudyError> {
    let mut text = Vec::new();
    for line in lines {
        // To memory, which takes all.
        let _ = writeln!(text, "{line}");
    }
    std::fs::write(path, text).map_err(StudyError::write(path))
}

/// A number for a CSV: nothing where there is none.
fn cell(value: Option<f64>) -> String {
    value.map_or_else(String::new, |x| x.to_string())
}

/// `0.0731 (0.0720 to 0.0743)`; `-` for none.
fn in_words(spread: Option<Spread>) -> String {
    match spread {
        Some(s) => format!("{} ({} to {})", figures(Some(s.median)), figures(Some(s.min)), figures(Some(s.max))),
        None => "-".to_owned(),
    }
}
