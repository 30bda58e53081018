//! Why a run cannot be watched, in one sentence each, with the remedy.

use std::path::PathBuf;

use crate::channel::ChannelError;
use crate::runtime::{channel_exit_code, exit};
use crate::scenario::ScenarioError;

/// Why a run cannot be watched.
#[derive(Debug, thiserror::Error)]
pub enum WatchError {
    /// The folder holds no run.
    #[error("there is no run in {}: {cause}; {}", path.display(), living(living_runs))]
    NoRun {
        /// Where it was looked for.
        path: PathBuf,
        /// What is wrong there.
        cause: String,
        /// The runs that are alive.
        living_runs: Vec<PathBuf>,
    },
    /// The run is over.
    #[error(
        "the run in {path} is over, and only a living run can be watched: tectum film {path} shows how its arm moved, \
         tectum log info {path} what is in its log; {}", living(living_runs), path = path.display()
    )]
    Over {
        /// The run's folder.
        path: PathBuf,
        /// The runs that are alive.
        living_runs: Vec<PathBuf>,
    },
    /// No run is named, and none is alive.
    #[error("no run is alive; start one with tectum run, or wait for one with tectum watch --wait")]
    NoneLiving,
    /// The run is of a build that leaves nothing for watchers.
    #[error("the run in {} has nothing to watch: {cause}; start the run with the same build as tectum watch",
        path.display())]
    Unwatchable {
        /// The run's folder.
        path: PathBuf,
        /// What is missing.
        cause: String,
    },
    /// Shared memory.
    #[error(transparent)]
    Channel(#[from] ChannelError),
    /// The run's scenario.
    #[error(transparent)]
    Scenario(#[from] ScenarioError),
    /// There is no terminal to draw on.
    #[error(
        "there is no terminal to draw on: standard input and standard output must both be one; use --web for a page in \
         a browser, or --json for one object with the numbers of now"
    )]
    NoTerminal,
    /// The terminal failed.
    #[error("the terminal cannot be used: {0}")]
    Terminal(std::io::Error),
    /// The address cannot be listened on.
    #[error(
        "nothing can be served at {address}: {cause}; give another address, such as 127.0.0.1:0, which takes any free \
         port"
    )]
    Address {
        /// The address.
        address: String,
        /// What is wrong with it.
        cause: String,
    },
    /// This build has no server for Foxglove.
    #[error(
        "this build has no server for Foxglove; build one with cargo build --release --features foxglove, or use --web"
    )]
    NoFoxglove,
    /// The page's address cannot be printed.
    #[error("standard output cannot be written: {0}")]
    Output(std::io::Error),
    /// The launcher of the run to watch cannot be started.
    #[error("the run cannot be launched: {0}")]
    Launcher(std::io::Error),
    /// The operating system allows no further thread.
    #[error(
        "there can be no thread for metrics: {0}; raise the limit on this user's processes and threads (ulimit -u)"
    )]
    Thread(std::io::Error),
    /// Signals cannot be handled.
    #[error("signals cannot be handled: {0}")]
    Signals(std::io::Error),
}

fn living(runs: &[PathBuf]) -> String {
    match runs {
        [] => "no run is alive".to_owned(),
        [one] => format!("the run in {} is alive", one.display()),
        many => {
            let names: Vec<_> = many.iter().take(5).map(|path| path.display().to_string()).collect();
            let more = if many.len() > names.len() { " and others" } else { "" };
            format!("alive are {}{more}", names.join(", "))
        }
    }
}

impl WatchError {
    /// The exit code for this error.
    pub fn exit_code(&self) -> u8 {
        match self {
            Self::Channel(error) => channel_exit_code(error),
            Self::Signals(_) | Self::Launcher(_) | Self::Thread(_) => exit::ERROR,
            _ => exit::INPUT,
        }
    }
}
