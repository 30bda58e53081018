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
    /// A signal ended the study early.
    #[error("ended by signal {0}: a study writes its results at its end, so there are none")]
    Signal(u32),
}

impl StudyError {
    /// The exit code for this error.
    pub fn exit_code(&self) -> u8 {
        match self {
            Self::Launch(error) => error.exit_code(),
            Self::Controller { error, .. } => error.exit_code(),
            Self::Signal(number) => exit::by_signal(*number),
            Self::Scenario(_) | Self::Asked(_) | Self::Report(_) | Self::Write { .. } => exit::INPUT,
        }
    }
}

/// Writes one result file of a study.
pub(super) fn write_file(path: &Path, contents: impl AsRef<[u8]>) -> Result<(), StudyError> {
    std::fs::write(path, contents).map_err(|error| StudyError::Write { path: path.to_owned(), error })
}
