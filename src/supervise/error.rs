//! The errors with which a run fails to start.

use crate::channel::ChannelError;
use crate::checkpoint::CheckpointError;
use crate::runtime::{PipeError, channel_exit_code, exit};
use crate::scenario::ScenarioError;

/// Why a run could not start. It leaves nothing behind.
#[derive(Debug, thiserror::Error)]
pub enum LaunchError {
    /// The scenario is not valid.
    #[error(transparent)]
    Scenario(#[from] ScenarioError),
    /// The checkpoint to resume from cannot be used.
    #[error(transparent)]
    Checkpoint(#[from] CheckpointError),
    /// What another run has learned does not fit this one.
    #[error(
        "{path}: what was learned there does not fit this run: {difference}; run a scenario with the same inputs, \
         outputs and learner"
    )]
    OtherLearner {
        /// The checkpoint.
        path: String,
        /// The first difference.
        difference: String,
    },
    /// A policy cannot be written.
    #[error("{path} cannot be written: {cause}; choose another file with --out")]
    Export {
        /// The file.
        path: String,
        /// What is wrong.
        cause: String,
    },
    /// Shared memory cannot be set up.
    #[error(transparent)]
    Channel(#[from] ChannelError),
    /// The run's folder cannot be used.
    #[error("the run's folder {path} cannot be used: {cause}; choose another with --out")]
    Folder {
        /// The folder.
        path: String,
        /// What is wrong with it.
        cause: String,
    },
    /// The log would not fit on the disk.
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
    /// A program does not exist or cannot be started.
    #[error("the {role} cannot be started: {program}: {cause}")]
    Start {
        /// Which process.
        role: &'static str,
        /// The program.
        program: String,
        /// What is wrong, and the remedy.
        cause: String,
    },
    /// A process does not become ready in time.
    #[error(
        "the {role} did not get ready within {seconds} s; start it by hand with --by-hand to see why, or allow more \
         with [restart] set_up_s"
    )]
    NotReady {
        /// Which process.
        role: &'static str,
        /// The time it had, s.
        seconds: u64,
    },
    /// A process ended before the first tick.
    #[error("{message}")]
    Refused {
        /// The exit code to end with.
        code: u8,
        /// The process's own error message.
        message: String,
    },
    /// The plant is a program of its own, which cannot run inside this process.
    #[error("the plant is `{0}`, which cannot run in one process with the controller; use --mode lockstep or realtime")]
    NotSimulated(String),
    /// The controller's program, started as a child of this process, cannot be used.
    #[error(transparent)]
    Pipe(#[from] PipeError),
    /// A plant with servos cannot follow virtual time.
    #[error(
        "the plant drives servos, which run in real time only, and --mode is {0}; leave --mode out, or give realtime \
         (with plant.servos.port = \"emulator\", and neither trackers nor a leader, also lockstep)"
    )]
    OnlyRealtime(&'static str),
    /// Signal handlers cannot be installed.
    #[error("signals cannot be handled: {0}")]
    Signals(std::io::Error),
    /// A thread cannot be started.
    #[error("a thread cannot be started: {0}; raise the limit of processes (ulimit -u), or end others")]
    Thread(std::io::Error),
    /// The launcher's thread ended by a panic, which is a mistake in this library.
    #[error("the launcher of the run ended by a panic; its message is on standard error")]
    LauncherPanicked,
}

impl LaunchError {
    /// The exit code for this error.
    pub fn exit_code(&self) -> u8 {
        match self {
            Self::Scenario(_)
            | Self::Checkpoint(_)
            | Self::OtherLearner { .. }
            | Self::Export { .. }
            | Self::Folder { .. }
            | Self::NoRoom { .. }
            | Self::OnlyRealtime(_)
            | Self::NotSimulated(_)
            | Self::Start { .. } => exit::INPUT,
            Self::Refused { code, .. } => *code,
            Self::Pipe(error) => error.exit_code(),
            Self::NotReady { .. } => exit::PROCESS,
            Self::Channel(error) => channel_exit_code(error),
            Self::Signals(_) | Self::Thread(_) | Self::LauncherPanicked => exit::ERROR,
        }
    }
}
