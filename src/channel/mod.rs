//! Channels between processes, and the only room that names iceoryx2.
//!
//! A run lives in a [`Domain`] of its own (an iceoryx2 prefix and root), created by the launcher, which also creates and
//! holds every service; the other processes only open them. Three publish-subscribe services carry the samples, an
//! event service wakes the controller, and blackboards show the run's phase and each process's state.
//!
//! Every publish-subscribe service overflows: a full reader loses its oldest sample and no writer ever waits for a
//! reader. Where nothing may be lost (lockstep), the plant does not run further ahead of the logger than the reader's
//! buffer (see [`LOG_BUFFER`]), so that overflow cannot happen, rather than block on it.

mod bare_exchange;
mod crash_store;
mod domain;
mod ports;
mod services;
mod shared_page;
mod stale_domains;

pub use bare_exchange::BareExchange;
pub use crash_store::CrashStore;
pub use domain::{Domain, DomainName, reclaim_dead, remove_domain};
pub use ports::{BoardReader, BoardWriter, Payload, Receiver, Sender, StatusBoard, WakeListener, WakeNotifier};
pub use services::{
    CONTROL, ControllerPorts, Identity, LoggerPorts, PlantPorts, RunServices, TrackerPorts, VisionReceiver, WAKE,
    board_name,
};
pub use shared_page::{SharedPage, WORDS};
pub use stale_domains::{DomainOwner, StaleDomain, list_domains, remove_stale_domains};

/// The version of iceoryx2 that all processes of a run must have, whatever their language.
pub const ICEORYX2: &str = "0.10.0";

/// Samples that a logger can be behind before the oldest is lost.
pub const LOG_BUFFER: usize = 1024;

/// How often a process can be started within a run: each start has a page of its own on its board.
pub const INCARNATIONS: u32 = 256;

/// What can go wrong with a channel.
#[derive(Debug, thiserror::Error)]
pub enum ChannelError {
    /// iceoryx2 refused to create or open something.
    #[error("{what} of the run's domain could not be set up: {cause}{hint}")]
    SetUp {
        /// What was asked for.
        what: String,
        /// iceoryx2's reason.
        cause: String,
        /// What the user may do about it; empty where nothing is known.
        hint: &'static str,
    },
    /// A sample could not be sent or received.
    #[error("channel {channel} failed while the run was going: {cause}")]
    Transfer {
        /// The channel's name.
        channel: String,
        /// iceoryx2's reason.
        cause: String,
    },
    /// The process does not belong to the run.
    #[error("{0}")]
    Mismatch(Mismatch),
}

/// The one sentence with which a process is refused.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "the {role} does not fit the run: its {what} is {ours}, the run's is {theirs}; start it from the same build and \
     with the same scenario as the run"
)]
pub struct Mismatch {
    /// Which process.
    pub role: &'static str,
    /// What differs: `schema`, `scenario` or `build`.
    pub what: &'static str,
    /// The process's own value.
    pub ours: String,
    /// The run's value.
    pub theirs: String,
}

impl ChannelError {
    fn set_up(what: impl Into<String>, cause: impl std::fmt::Debug) -> Self {
        let cause = format!("{cause:?}");
        let hint = if cause.contains("DoesNotExist") {
            "; the run is over or was never started"
        } else if cause.contains("Permission") {
            "; start all processes of a run as the same user"
        } else if ["UnableToGenerateUniqueNodeId", "OutOfMemory", "NotFound", "StorageFull"]
            .iter()
            .any(|what| cause.contains(what))
        {
            "; is /dev/shm mounted and large enough?"
        } else if cause.contains("Exceeds") {
            "; another process already has this role in the run"
        } else {
            ""
        };
        Self::SetUp { what: what.into(), cause, hint }
    }
}
