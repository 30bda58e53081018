//! The errors of the loops, and the exit codes of all programs.

use crate::channel::ChannelError;
use crate::checkpoint::CheckpointError;
use crate::log::LogError;
use crate::scenario::ScenarioError;

/// Exit codes, the same for every program of the package.
pub mod exit {
    /// Success.
    pub const OK: u8 = 0;
    /// An error that no other code covers.
    pub const ERROR: u8 = 1;
    /// Bad input: arguments, scenario, folder, or a disk without room, including one that fills up during the
    /// run.
    pub const INPUT: u8 = 2;
    /// A process does not fit the run that it should join.
    pub const MISMATCH: u8 = 3;
    /// A process of the run failed or died.
    pub const PROCESS: u8 = 4;
    /// Ended by SIGINT (Ctrl-C).
    pub const INTERRUPTED: u8 = 130;
    /// Ended by SIGHUP: the terminal was closed, or the connection was lost.
    pub const HUNG_UP: u8 = 129;
    /// Ended by SIGQUIT (Ctrl-\).
    pub const QUIT: u8 = 131;
    /// Ended by SIGTERM.
    pub const TERMINATED: u8 = 143;

    /// The exit code after termination by signal `number`, as in shells: 128 plus the number.
    pub fn by_signal(number: u32) -> u8 {
        128_u8.saturating_add(u8::try_from(number).unwrap_or(0))
    }
}

/// Why a loop could not continue.
#[derive(Debug, thiserror::Error)]
pub enum RuntimeError {
    /// A channel failed.
    #[error(transparent)]
    Channel(#[from] ChannelError),
    /// The run's scenario is invalid.
    #[error(transparent)]
    Scenario(#[from] ScenarioError),
    /// The log failed.
    #[error(transparent)]
    Log(#[from] LogError),
    /// The checkpoint from which the run resumes cannot be used.
    #[error(transparent)]
    Checkpoint(#[from] CheckpointError),
    /// The thread that writes checkpoints cannot be started.
    #[error("no thread can be started for checkpoints: {0}; look at the limits of the system (ulimit -u)")]
    Thread(std::io::Error),
    /// There is no such run.
    #[error("there is no run at {path}: {cause}; name a run that `tectum run` has started, or its folder")]
    NoRun {
        /// The folder in which it was expected.
        path: String,
        /// The reason.
        cause: String,
    },
    /// The run's folder is closed to this user.
    #[error("the run at {path} cannot be read: permission denied; start all processes of a run as the same user")]
    OtherUser {
        /// The folder in which it was expected.
        path: String,
    },
    /// The pipe to the program that started this controller failed.
    #[error("the pipe to the program that started this controller failed: {0}")]
    Pipe(std::io::Error),
    /// The state of an agent cannot be put back after a test.
    #[error(
        "after a test the agent's visit_state lists other values than before it; it must always list all, in order"
    )]
    StateAfterTest,
    /// A file in the run's folder cannot be written.
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
    /// The scenario limits joint positions, but the plant does not report them.
    #[error(
        "`positions` under [gate] needs a plant that tells where its joints are, and `{0}` does not; \
         take it out, or give its `Plant` the method `joints`"
    )]
    NoJoints(String),
    /// The plant could not keep its deadlines.
    #[error(
        "the plant passed over {overruns} ticks in a row up to tick {tick}, and {most} are allowed \
         (`max_consecutive` under [overrun]); give it more than {period_ms} ms a tick, a priority and a core of its \
         own under [realtime], or a machine with less to do"
    )]
    Overrun {
        /// Ticks skipped in a row.
        overruns: u64,
        /// Number of skipped ticks that is allowed.
        most: u64,
        /// The tick at which the plant ended the run.
        tick: u64,
        /// The tick's period, ms.
        period_ms: f64,
    },
    /// Signal handlers could not be installed.
    #[error("signals cannot be handled: {0}")]
    Signals(std::io::Error),
    /// The launcher has ended.
    #[error("the run's launcher has ended; so does the {0}")]
    Orphaned(&'static str),
    /// The launcher aborted the run.
    #[error("the run was ended by its launcher")]
    Aborted,
    /// The process's state no longer fits into its crash store.
    #[error(
        "the state of the {0} has grown beyond the room that its crash store reserved at the start; \
         a plant must list as many numbers at every tick"
    )]
    Memory(&'static str),
    /// The process has come back in lockstep, and what it remembered is gone.
    #[error(
        "the {0} died, and somebody has removed its memory in /dev/shm (systemd-logind does so when its user logs out, \
         unless RemoveIPC=no is set in /etc/systemd/logind.conf); in lockstep it cannot go on without; start a new run"
    )]
    Forgotten(&'static str),
    /// Samples were lost in a lockstep run.
    #[error("{lost} samples of channel {channel} were lost in lockstep, which must not happen; the log states where")]
    Lost {
        /// The channel.
        channel: String,
        /// Number of lost samples.
        lost: u64,
    },
    /// SIGINT, SIGTERM, SIGHUP or SIGQUIT.
    #[error("ended by signal {0}")]
    Signal(u32),
}

impl RuntimeError {
    /// The exit code for this error.
    pub fn exit_code(&self) -> u8 {
        match self {
            Self::Channel(error) => channel_exit_code(error),
            Self::OtherUser { .. } => exit::MISMATCH,
            Self::Checkpoint(_)
            | Self::Scenario(_)
            | Self::NoRun { .. }
            | Self::File { .. }
            | Self::Log(_)
            | Self::NotSimulated(_)
            | Self::NoJoints(_)
            | Self::Forgotten(_) => exit::INPUT,
            Self::Orphaned(_) | Self::Aborted | Self::Overrun { .. } | Self::Pipe(_) | Self::StateAfterTest => {
                exit::PROCESS
            }
            Self::Signal(number) => exit::by_signal(*number),
            Self::Signals(_) | Self::Thread(_) | Self::Lost { .. } | Self::Memory(_) => exit::ERROR,
        }
    }
}

/// The exit code for an error of the channels, which is the same for a process and for the launcher.
pub fn channel_exit_code(error: &ChannelError) -> u8 {
    match error {
        error if error.is_mismatch() => exit::MISMATCH,
        error if error.is_input() => exit::INPUT,
        _ => exit::ERROR,
    }
}
