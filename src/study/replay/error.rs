//! Why a log cannot be replayed.

use std::path::PathBuf;

use crate::checkpoint::CheckpointError;
use crate::log::LogError;
use crate::runtime::{PipeError, exit};
use crate::scenario::{Rule, ScenarioError};

/// Why a log cannot be replayed. A log that can be replayed with a different result is not an error but a
/// [`Difference`](super::Difference).
#[derive(Debug, thiserror::Error)]
pub enum ReplayError {
    /// The log cannot be read.
    #[error(transparent)]
    Log(#[from] LogError),
    /// The scenario in the log is invalid for this build.
    #[error(
        "the scenario in the log {} cannot be read: {error}; replay it with the build that wrote it ({build})",
        path.display()
    )]
    Scenario {
        /// The log.
        path: PathBuf,
        /// Why it is invalid.
        error: Box<ScenarioError>,
        /// The build that wrote it.
        build: String,
    },
    /// The controller's program of the run cannot be used.
    #[error(transparent)]
    Pipe(#[from] PipeError),
    /// What the run began with cannot be used.
    #[error(transparent)]
    Checkpoint(#[from] CheckpointError),
    /// The run began with what another one had learned, and that is not there.
    #[error(
        "the log {} is of a run that began with what another run had learned; {} should hold that, and does not: \
         {cause}; put the file back", path.display(), file.display()
    )]
    Start {
        /// The log.
        path: PathBuf,
        /// The file.
        file: PathBuf,
        /// What is wrong.
        cause: String,
    },
    /// The log was written with `every` above 1.
    #[error(
        "the log {} holds every {every}th tick only, and a replay needs all that was learned from; run the \
         scenario again with `every = 1` under [log]", path.display()
    )]
    Thinned {
        /// The log.
        path: PathBuf,
        /// The log holds one tick in this many.
        every: u64,
    },
    /// The logger lost samples.
    #[error(
        "the log {} states a gap on channel {channel}, {count} missing from sequence number {first} on; {until}, \
         and what was learned behind that{behind} cannot be told; run the scenario again in lockstep, where \
         nothing is lost while its logger lives, or on a machine with less to do", path.display()
    )]
    Lost {
        /// The log.
        path: PathBuf,
        /// The channel.
        channel: &'static str,
        /// Sequence number of the first missing sample.
        first: u64,
        /// How many are missing in a row.
        count: u64,
        /// How far the log was replayed, in words.
        until: String,
        /// The ticks after the gap, in words.
        behind: String,
    },
    /// The log does not begin with its run.
    #[error(
        "the log {} begins in the middle of what was learned, and what came before cannot be told from it; {remedy}",
        path.display()
    )]
    Middle {
        /// The log.
        path: PathBuf,
        /// The remedy.
        remedy: &'static str,
    },
    /// The other learner cannot run with the scenario of the log.
    #[error("the learner {rule:?} cannot learn from the log {}: {error}", path.display())]
    Learner {
        /// The log.
        path: PathBuf,
        /// Its rule.
        rule: Rule,
        /// The reason.
        error: Box<ScenarioError>,
    },
}

impl ReplayError {
    /// The exit code for this error.
    pub fn exit_code(&self) -> u8 {
        match self {
            Self::Pipe(error) => error.exit_code(),
            _ => exit::INPUT,
        }
    }
}
