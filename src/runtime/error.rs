//! What ends a process before its time, and the exit codes of all programs.

use crate::channel::ChannelError;
use crate::checkpoint::CheckpointError;
use crate::log::LogError;
use crate::scenario::ScenarioError;

/// Exit codes, the same for every program of the package.
pub mod exit {
    /// All went well.
    pub const OK: u8 = 0;
    /// An error that no other code names.
    pub const ERROR: u8 = 1;
    /// Bad input: arguments, scenario, folder, or a disk without room, also one that fills up while the run goes on.
    pub const INPUT: u8 = 2;
    /// A process does not fit the run it was to join.
    pub const MISMATCH: u8 = 3;
    /// A process of the run failed or died.
    pub const PROCESS: u8 = 4;
    /// Ended by SIGINT (Ctrl-C).
    pub const INTERRUPTED: u8 = 130;
    /// Ended by SIGTERM.
    pub const TERMINATED: u8 = 143;

    /// The exit code after termination by signal `number`, as shells have it.
    pub fn by_signal(number: u32) -> u8 {
        128_u8.saturating_add(u8::try_from(number).unwrap_or(0))
    }
}

/// Why a loop could not go on.
#[derive(Debug, thiserror::Error)]
pub enum RuntimeError {
    /// The channels.
    #[error(transparent)]
    Channel(#[from] ChannelError),
    /// The run's scenario.
    #[error(transparent)]
    Scenario(#[from] ScenarioError),
    /// The log.
    #[error(transparent)]
    Log(#[from] LogError),
    /// The checkpoint that the run begins with.
    #[error(transparent)]
    Checkpoint(#[from] CheckpointError),
    /// No thread for writing checkpoints.
    #[error("no thread can be started for checkpoints: {0}; look at the limits of the system (ulimit -u)")]
    Thread(std::io::Error),
    /// There is no such run.
    #[error("there is no run at {path}: {cause}; name a run that `tectum run` has started, or its folder")]
    NoRun {
        /// Where it was looked for.
        path: String,
        /// What was wrong.
        cause: String,
    },
    /// A file of the run's folder.
    #[error("{path} cannot be written: {cause}")]
    File {
        /// The file.
        path: String,
        /// The operating system's reason.
        cause: std::io::Error,
    },
    /// The scenario names another plant than this program.
    #[error("the scenario names no arm and no eye: its plant is `{0}`, which must be started in the simulator's place")]
    NotSimulated(String),
    /// The scenario limits positions of joints that the plant does not tell.
    #[error(
        "`positions` under [gate] needs a plant that tells where its joints are, and `{0}` does not; take it out, or give its `Plant` the method `joints`"
    )]
    NoJoints(String),
    /// The plant could not keep its deadlines.
    #[error(
        "the plant passed over {overruns} ticks in a row up to tick {tick}, and {most} are allowed (`max_consecutive` under [overrun]); \
             give it more than {period_ms} ms a tick, a priority and a core of its own under [realtime], or a machine with less to do"
    )]
    Overrun {
        /// Ticks passed over in a row.
        overruns: u64,
        /// How many are allowed.
        most: u64,
        /// The tick at which it gave up.
        tick: u64,
        /// The tick's period, ms.
        period_ms: f64,
    },
    /// Signal handlers could not be installed.
    #[error("signals cannot be handled: {0}")]
    Signals(std::io::Error),
    /// The launcher is gone.
    #[error("the run's launcher has ended; so does the {0}")]
    Orphaned(&'static str),
    /// The launcher ended the run at once.
    #[error("the run was ended by its launcher")]
    Aborted,
    /// A plant's state that has no room in its vault any more.
    #[error(
        "what the {0} must remember has grown since its start, by more than its vault has room for; a plant lists as many numbers at every tick"
    )]
    Memory(&'static str),
    /// A lossless run lost something.
    #[error("{lost} samples of channel {channel} were lost in lockstep, which must not happen; the log states where")]
    Lost {
        /// The channel.
        channel: String,
        /// How many.
        lost: u64,
    },
    /// SIGINT or SIGTERM.
    #[error("ended by signal {0}")]
    Signal(u32),
}

impl RuntimeError {
    /// The exit code that tells this error.
    pub fn exit_code(&self) -> u8 {
        match self {
            Self::Channel(ChannelError::Mismatch(_)) => exit::MISMATCH,
            Self::Checkpoint(_)
            | Self::Scenario(_)
            | Self::NoRun { .. }
            | Self::File { .. }
            | Self::Log(_)
            | Self::NotSimulated(_)
            | Self::NoJoints(_) => exit::INPUT,
            Self::Orphaned(_) | Self::Aborted | Self::Overrun { .. } => exit::PROCESS,
            Self::Signal(number) => exit::by_signal(*number),
            Self::Channel(_) | Self::Signals(_) | Self::Thread(_) | Self::Lost { .. } | Self::Memory(_) => exit::ERROR,
        }
    }
}
