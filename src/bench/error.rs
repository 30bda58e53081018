//! Why a bench gave nothing.

use std::path::{Path, PathBuf};

use crate::channel::ChannelError;
use crate::log::LogError;
use crate::report::ReportError;
use crate::runtime::exit;
use crate::scenario::ScenarioError;
use crate::supervise::LaunchError;

/// Why a bench gave nothing.
#[derive(Debug, thiserror::Error)]
pub enum BenchError {
    /// A run of it could not begin, or its folder cannot be used.
    #[error(transparent)]
    Launch(#[from] LaunchError),
    /// The scenario.
    #[error(transparent)]
    Scenario(#[from] ScenarioError),
    /// Shared memory.
    #[error(transparent)]
    Channel(#[from] ChannelError),
    /// The log of one of its runs.
    #[error(transparent)]
    Log(#[from] LogError),
    /// A figure.
    #[error(transparent)]
    Report(#[from] ReportError),
    /// Something that was asked for and makes no sense; says what, and the remedy.
    #[error("{0}")]
    Asked(String),
    /// A file.
    #[error("{} cannot be written: {error}; choose another folder", path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// What the operating system said.
        error: std::io::Error,
    },
    /// One of its runs failed.
    #[error("a run of the bench failed: {message}")]
    Run {
        /// The run's exit code.
        code: u8,
        /// The run's own words.
        message: String,
    },
    /// The process at the other end of a way.
    #[error("the other process of {way}: {cause}")]
    Peer {
        /// Which way.
        way: &'static str,
        /// What is wrong.
        cause: String,
    },
    /// A signal came before the end.
    #[error("ended by signal {0}: a bench writes its results at its end, so there are none")]
    Signal(u32),
}

impl BenchError {
    /// The exit code that tells this error.
    pub fn exit_code(&self) -> u8 {
        match self {
            Self::Launch(error) => error.exit_code(),
            Self::Run { code, .. } => *code,
            Self::Signal(number) => exit::by_signal(*number),
            Self::Scenario(_) | Self::Asked(_) | Self::Report(_) | Self::Write { .. } => exit::INPUT,
            Self::Peer { .. } => exit::PROCESS,
            Self::Channel(_) | Self::Log(_) => exit::ERROR,
        }
    }

    /// For `map_err`: a file that cannot be written.
    pub(super) fn write(path: &Path) -> impl FnOnce(std::io::Error) -> Self {
        let path = path.to_owned();
        move |error| Self::Write { path, error }
    }
}
