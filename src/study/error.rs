//! Why a study gave no result.

use std::path::{Path, PathBuf};

use crate::report::ReportError;
use crate::runtime::{PipeError, exit};
use crate::scenario::ScenarioError;
use crate::supervise::LaunchError;

/// Why a study gave no result.
#[derive(Debug, thiserror::Error)]
pub enum StudyError {
    /// The result folder cannot be made, or the signal handlers cannot be installed.
    #[error(transparent)]
    Launch(#[from] LaunchError),
    /// A scenario is invalid.
    #[error(transparent)]
    Scenario(#[from] ScenarioError),
    /// An argument is invalid; the text names it and the remedy.
    #[error("{0}")]
    Asked(String),
    /// A controller's program of one's own failed.
    #[error("{name} with seed {seed}: {error}")]
    Controller {
        /// The learner.
        name: String,
        /// The seed of the run.
        seed: u64,
        /// What the program said, or how it ended.
        error: PipeError,
    },
    /// A run with processes of its own failed.
    #[error("{message}")]
    Run {
        /// The exit code.
        code: u8,
        /// Which run, and why.
        message: String,
    },
    /// The figure cannot be drawn or written.
    #[error(transparent)]
    Report(#[from] ReportError),
    /// A result file cannot be written.
    #[error("{} cannot be written: {error}; choose another --out", path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// The operating system's error.
        error: std::io::Error,
    },
    /// Not all runs of a study are in the files from which it is to be put together.
    #[error(
        "{} of {of} runs are missing: {}; make them with --seeds and --part, and merge again",
        missing.len(), some(missing)
    )]
    Missing {
        /// Names of the runs.
        missing: Vec<String>,
        /// Number of runs that the study has.
        of: usize,
    },
    /// A signal ended the study early. The runs that are done are kept.
    #[error("ended by signal {signal}: {done} of {of} runs are done and kept in {}; {remedy}", path.display())]
    Interrupted {
        /// The signal.
        signal: u32,
        /// Number of runs that are kept.
        done: usize,
        /// Number of runs that the study, or this part of it, has.
        of: usize,
        /// The file of rows.
        path: PathBuf,
        /// How it goes on.
        remedy: String,
    },
    /// A signal ended the study early.
    #[error("ended by signal {0}: no run was done, and results are written at the end, so there are none")]
    Signal(u32),
}

impl StudyError {
    /// The exit code for this error.
    pub fn exit_code(&self) -> u8 {
        match self {
            Self::Launch(error) => error.exit_code(),
            Self::Controller { error, .. } => error.exit_code(),
            Self::Run { code, .. } => *code,
            Self::Signal(number) | Self::Interrupted { signal: number, .. } => exit::by_signal(*number),
            Self::Missing { .. } | Self::Scenario(_) | Self::Asked(_) | Self::Report(_) | Self::Write { .. } => {
                exit::INPUT
            }
        }
    }
}

/// The first few of some names.
fn some(names: &[String]) -> String {
    const SHOWN: usize = 8;
    let more = if names.len() > SHOWN { ", ..." } else { "" };
    names.iter().take(SHOWN).map(String::as_str).collect::<Vec<_>>().join(", ") + more
}

/// Writes one result file of a study.
pub(super) fn write_file(path: &Path, contents: impl AsRef<[u8]>) -> Result<(), StudyError> {
    std::fs::write(path, contents).map_err(|error| StudyError::Write { path: path.to_owned(), error })
}
