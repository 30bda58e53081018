//! The errors of a link.

use std::path::PathBuf;

use tectum::channel::ChannelError;
use tectum::runtime::{RuntimeError, exit};
use tectum::scenario::ScenarioError;
use tectum::supervise::LaunchError;

/// Why a link cannot begin or go on.
#[derive(Debug, thiserror::Error)]
pub enum LinkError {
    /// The key cannot be used.
    #[error("the key {} cannot be used: {cause}; make one with `tectum link key > FILE` and copy it to both machines",
        path.display())]
    Key {
        /// Its file.
        path: PathBuf,
        /// Why.
        cause: String,
    },
    /// The operating system has no random numbers.
    #[error("/dev/urandom cannot be read: {0}")]
    Random(std::io::Error),
    /// An address is no address.
    #[error("{text:?} is no address of a link: {cause}; give one such as udp/192.168.7.2:7447")]
    Address {
        /// As it was given.
        text: String,
        /// Why.
        cause: String,
    },
    /// Without a key the address may not be used.
    #[error(
        "{address} is neither loopback nor one of link.hosts in the scenario; without --key a link uses only those: \
         name both machines there, or give both the same --key"
    )]
    Open {
        /// The address.
        address: String,
    },
    /// The network cannot be used.
    #[error("{address} cannot be used: {cause}")]
    Carrier {
        /// The address.
        address: String,
        /// The reason of the operating system, or of zenoh.
        cause: String,
    },
    /// Nobody answers.
    #[error(
        "the other machine gave no answer at {address} for {seconds} s; start `tectum link {side}` there, with {hint}"
    )]
    Silent {
        /// The address.
        address: String,
        /// How long the link waited.
        seconds: u64,
        /// What has to be started there.
        side: &'static str,
        /// What the two have to share.
        hint: &'static str,
    },
    /// Nobody sends back what `tectum link ping` sends.
    #[error("nothing came back from {address} for {seconds} s; start `tectum link ping --listen ADDRESS` there")]
    NoEcho {
        /// The address.
        address: String,
        /// How long it was tried.
        seconds: u64,
    },
    /// The clocks cannot be compared.
    #[error("the offset between the clocks is not known: {address} answered no round trip for {seconds} s")]
    Clock {
        /// The address.
        address: String,
        /// How long the link waited.
        seconds: u64,
    },
    /// The other machine's run does not fit.
    #[error("{0}")]
    Refused(String),
    /// The other machine ended the run.
    #[error("{0}")]
    Ended(String),
    /// A thread cannot be started.
    #[error("no thread can be started: {0}; look at the limits of the system (ulimit -u)")]
    Thread(std::io::Error),
    /// Signals cannot be heard.
    #[error("signals cannot be heard: {0}")]
    Signals(std::io::Error),
    /// A file of the run cannot be written.
    #[error("{} cannot be written: {cause}", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// The operating system's reason.
        cause: std::io::Error,
    },
    /// The run on this machine ends.
    #[error(transparent)]
    Runtime(#[from] RuntimeError),
    /// The scenario cannot be used.
    #[error(transparent)]
    Scenario(#[from] ScenarioError),
    /// The run cannot be launched.
    #[error(transparent)]
    Launch(#[from] LaunchError),
}

impl From<ChannelError> for LinkError {
    fn from(error: ChannelError) -> Self {
        Self::Runtime(error.into())
    }
}

impl LinkError {
    /// The exit code for this error.
    pub fn exit_code(&self) -> u8 {
        match self {
            Self::Refused(_) => exit::MISMATCH,
            Self::Ended(_) => exit::PROCESS,
            Self::Random(_) | Self::Thread(_) | Self::Signals(_) => exit::ERROR,
            Self::Runtime(error) => error.exit_code(),
            Self::Launch(error) => error.exit_code(),
            _ => exit::INPUT,
        }
    }
}
