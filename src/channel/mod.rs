//! Channels between processes. The only module that names iceoryx2.
//!
//! A run has a domain of its own (an iceoryx2 prefix and root). The launcher creates the domain, and creates
//! and holds every service in it; the other processes only open them. Three publish-subscribe services carry
//! the samples, blackboards show the run's phase and each process's state, and a service without a payload carries
//! the run's identity. A futex wakes the controller.
//!
//! Every publish-subscribe service overflows: a full reader loses its oldest sample, and no writer ever waits
//! for a reader. The logger is no such reader. It takes the samples from rings in shared memory ([`LogTail`]), in
//! which plant and controller note what they have sent. In lockstep nothing may be lost. There the plant does not
//! run further ahead of the logger than [`LOG_BUFFER`], so no entry is overwritten and no writer has to block.

mod bare_exchange;
mod boards;
mod crash_store;
mod domain;
mod domain_lock;
mod identity;
mod log_ring;
mod participant_ports;
mod ports;
mod services;
mod shared_page;
mod stale_domains;
mod vision_ports;
mod wake;

pub(crate) use bare_exchange::BareExchange;
pub use boards::{BoardReader, BoardWriter, StatusBoard};
pub(crate) use crash_store::CrashStore;
pub(crate) use domain::reclaim_dead;
pub use domain::{DomainName, remove_domain};
pub use identity::Identity;
pub(crate) use log_ring::ring_file;
pub use log_ring::{LogAppender, LogTail};
pub use participant_ports::{ControllerPorts, LoggerPorts, PlantPorts};
pub use ports::{Payload, Receiver, Sender};
pub use services::RunServices;
pub(crate) use shared_page::SharedPage;
pub use stale_domains::{DomainOwner, StaleDomain};
pub(crate) use stale_domains::{list_domains, remove_stale_domains};
pub use vision_ports::{TrackerPorts, VisionReceiver};
pub(crate) use wake::wake_file;
pub use wake::{WakeListener, WakeNotifier};

use iceoryx2::prelude::ServiceName;

/// The version of iceoryx2 that all processes of a run must have, whatever their language.
pub(crate) const ICEORYX2: &str = "0.10.0";

/// Samples that the logger can be behind in lockstep, where none may be lost.
pub const LOG_BUFFER: usize = 1024;
/// Samples that plant and controller can be behind: they read the newest, and one more slot makes a late one
/// visible.
const LOOP_BUFFER: usize = 2;
/// Samples of each tracker that the bridge can be behind: it takes the newest at every tick.
const VISION_BUFFER: usize = 4;

/// How often a process can be started within a run: each start has a page of its own on its board.
pub(crate) const INCARNATIONS: u32 = 256;

/// The service whose attributes identify the run. It is created before all others.
pub(crate) const IDENTITY: &str = "identity";
/// Name of the launcher's board.
pub(crate) const CONTROL: &str = "control";

/// The service of the board called `name`.
pub(crate) fn board_name(name: &str) -> String {
    format!("board/{name}")
}

fn service_name(name: &str) -> Result<ServiceName, ChannelError> {
    name.try_into().map_err(|e| ChannelError::set_up(format!("the name {name}"), e))
}

/// Why a channel cannot be set up or used.
#[derive(Debug, thiserror::Error)]
pub enum ChannelError {
    /// iceoryx2 refused to create or open something.
    #[error("{what} of the run's domain could not be set up: {cause}{hint}")]
    SetUp {
        /// The resource.
        what: String,
        /// iceoryx2's reason.
        cause: String,
        /// What the user can do about it; empty where nothing is known.
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
    /// The process does not fit the run.
    #[error("{0}")]
    Mismatch(Mismatch),
}

/// Why a process is refused: one of the handshake's values differs.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "the {role} does not fit the run: its {what} is {ours}, the run's is {theirs}; start it from the same build and \
     with the same scenario as the run"
)]
pub struct Mismatch {
    /// The refused process.
    pub role: &'static str,
    /// The value that differs: `schema`, `scenario` or `build`.
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
