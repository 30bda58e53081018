//! The errors with which a bench ends.

use std::path::PathBuf;

use crate::log::LogError;
use crate::report::ReportError;
use crate::runtime::exit;
use crate::scenario::ScenarioError;
use crate::supervise::LaunchError;
use crate::timing::TimingError;

/// Why a bench has no results.
#[derive(Debug, thiserror::Error)]
pub enum BenchError {
    /// One of its runs could not start, or its folder cannot be used.
    #[error(transparent)]
    Launch(#[from] LaunchError),
    /// The scenario is not valid.
    #[error(transparent)]
    Scenario(#[from] ScenarioError),
    /// The log of one of its runs cannot be read.
    #[error(transparent)]
    Log(#[from] LogError),
    /// A figure cannot be drawn.
    #[error(transparent)]
    Report(#[from] ReportError),
    /// An argument makes no sense. The text names it and the remedy.
    #[error("{0}")]
    Asked(String),
    /// A file cannot be written.
    #[error("{} cannot be written: {error}; choose another folder", path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// The error of the operating system.
        error: std::io::Error,
    },
    /// One of its runs failed.
    #[error("a run of the bench failed: {message}")]
    Run {
        /// The run's exit code.
        code: u8,
        /// The run's own error message.
        message: String,
    },
    /// Calls or exchanges cannot be timed. A signal is not among the reasons.
    #[error(transparent)]
    Timing(TimingError),
    /// A signal came before the end.
    #[error("ended by signal {0}: a bench writes its results at its end, so there are none")]
    Signal(u32),
}

impl From<TimingError> for BenchError {
    fn from(error: TimingError) -> Self {
        match error {
            TimingError::Signal(number) => Self::Signal(number),
            other => Self::Timing(other),
        }
    }
}

impl BenchError {
    /// The exit code for this error.
    pub fn exit_code(&self) -> u8 {
        match self {
            Self::Launch(error) => error.exit_code(),
            Self::Run { code, .. } => *code,
            Self::Signal(number) => exit::by_signal(*number),
            Self::Scenario(_) | Self::Asked(_) | Self::Report(_) | Self::Write { .. } => exit::INPUT,
            Self::Timing(TimingError::Peer { .. }) => exit::PROCESS,
            Self::Timing(TimingError::Scenario(_) | TimingError::NotSimulated) => exit::INPUT,
            Self::Timing(_) | Self::Log(_) => exit::ERROR,
        }
    }
}
