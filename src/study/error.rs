//! Why a study gave nothing.

use std::path::{Path, PathBuf};

use crate::report::ReportError;
use crate::runtime::exit;
use crate::scenario::ScenarioError;
use crate::supervise::LaunchError;

/// Why a study gave nothing.
#[derive(Debug, thiserror::Error)]
pub enum StudyError {
    /// The folder for its files, or its signal handlers.
    #[error(transparent)]
    Launch(#[from] LaunchError),
    /// A scenario.
    #[error(transparent)]
    Scenario(#[from] ScenarioError),
    /// Something that was asked for and makes no sense; says what, and the remedy.
    #[error("{0}")]
    Asked(String),
    /// A figure.
    #[error(transparent)]
    Report(#[from] ReportError),
    /// A file.
    #[error("{} cannot be written: {error}; choose another --out", path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// What the operating system said.
        error: std::io::Error,
    },
    /// A signal came before the end.
    #[error("ended by signal {0}: a study writes its results at its end, so there are none")]
    Signal(u32),
}

impl StudyError {
    /// The exit code that tells this error.
    pub fn exit_code(&self) -> u8 {
        match self {
            Self::Launch(error) => error.exit_code(),
            Self::Signal(number) => exit::by_signal(*number),
            Self::Scenario(_) | Self::Asked(_) | Self::Report(_) | Self::Write { .. } => exit::INPUT,
        }
    }

    /// For `map_err`: a file that cannot be written.
    pub(super) fn write(path: &Path) -> impl FnOnce(std::io::Error) -> Self {
        let path = path.to_owned();
        move |error| Self::Write { path, error }
    }
}
