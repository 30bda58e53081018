//! Why a run could not begin.

use crate::channel::ChannelError;
use crate::checkpoint::CheckpointError;
use crate::runtime::exit;
use crate::scenario::ScenarioError;

/// Why a run could not begin. Nothing is left behind.
#[derive(Debug, thiserror::Error)]
pub enum LaunchError {
    /// The scenario.
    #[error(transparent)]
    Scenario(#[from] ScenarioError),
    /// The checkpoint to go on from.
    #[error(transparent)]
    Checkpoint(#[from] CheckpointError),
    /// Shared memory.
    #[error(transparent)]
    Channel(#[from] ChannelError),
    /// The folder for the run.
    #[error("the run's folder {path} cannot be used: {cause}; choose another with --out")]
    Folder {
        /// The folder.
        path: String,
        /// What is wrong with it.
        cause: String,
    },
    /// The log would not fit.
    #[error(
        "the log needs about {needed} MB and {path} has {free} MB free; thin it with `[log] every`, run fewer --ticks, \
         or choose another --out"
    )]
    NoRoom {
        /// The folder.
        path: String,
        /// Megabytes needed.
        needed: u64,
        /// Megabytes free.
        free: u64,
    },
    /// A program is not there or cannot be started.
    #[error("the {role} cannot be started: {program}: {cause}")]
    Start {
        /// Which process.
        role: &'static str,
        /// The program.
        program: String,
        /// What is wrong, and the remedy.
        cause: String,
    },
    /// A process does not get ready.
    #[error("the {role} did not get ready within {seconds} s; start it by hand with --by-hand to see why")]
    NotReady {
        /// Which process.
        role: &'static str,
        /// How long it had.
        seconds: u64,
    },
    /// A process ended before the run had begun.
    #[error("{message}")]
    Refused {
        /// The exit code that says how.
        code: u8,
        /// The process's own words.
        message: String,
    },
    /// The simulator cannot simulate it.
    #[error("the plant is `{0}`, which cannot run in one process with the controller; use --mode lockstep or realtime")]
    NotSimulated(String),
    /// Servos know no virtual time.
    #[error(
        "the plant is one of servos, which live in real time alone, and --mode is {0}; leave --mode out, or give realtime"
    )]
    OnlyRealtime(&'static str),
    /// Signal handlers could not be installed.
    #[error("signals cannot be handled: {0}")]
    Signals(std::io::Error),
}

impl LaunchError {
    /// The exit code that tells this error.
    pub fn exit_code(&self) -> u8 {
        match self {
            Self::Scenario(_)
            | Self::Checkpoint(_)
            | Self::Folder { .. }
            | Self::NoRoom { .. }
            | Self::OnlyRealtime(_)
            | Self::NotSimulated(_) => exit::INPUT,
            Self::Start { .. } => exit::INPUT,
            Self::Refused { code, .. } => *code,
            Self::NotReady { .. } => exit::PROCESS,
            Self::Channel(_) | Self::Signals(_) => exit::ERROR,
        }
    }
}
