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
mod error;
mod identity;
mod log_ring;
mod own_files;
mod participant_ports;
mod ports;
mod services;
mod shared_memory;
mod shared_page;
mod stale_domains;
mod vision_ports;
mod wake;
mod watch_files;

pub use bare_exchange::{BareExchange, Exchange};
pub use boards::{BoardReader, BoardWriter, StatusBoard};
pub use crash_store::CrashStore;
pub use domain::{DomainName, remove_domain};
pub use domain::{is_member, reclaim_dead};
pub use error::{ChannelError, Mismatch, SetUpCause};
pub use identity::Identity;
pub use log_ring::ring_file;
pub use log_ring::{LogAppender, LogTail};
pub use participant_ports::{ControllerPorts, LoggerPorts, PlantPorts};
pub use ports::{Payload, Receiver, Sender};
pub use services::RunServices;
pub use shared_memory::{check_shared_memory, fill_domain};
pub use shared_page::SharedPage;
pub use stale_domains::{DomainOwner, StaleDomain};
pub use stale_domains::{list_domains, remove_stale_domains};
pub use vision_ports::{TrackerPorts, VisionReceiver};
pub use wake::wake_file;
pub use wake::{WakeListener, WakeNotifier};
pub use watch_files::{BoardsCopy, BoardsFile, MessageTail, WatchFiles, list_watched};

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

/// Pages of a process's board: each of its starts has a page of its own. After so many starts there is another board.
const BOARD_PAGES: u32 = 256;

/// The service whose attributes identify the run. It is created before all others.
pub(crate) const IDENTITY: &str = "identity";
/// The channel of commands ahead. A scenario cannot name it, and no channel of a scenario can have this name.
pub(crate) const AHEAD: &str = "commands.ahead";
/// Name of the launcher's board.
pub(crate) const CONTROL: &str = "control";

/// The service of the board called `name`.
pub(crate) fn board_name(name: &str) -> String {
    format!("board/{name}")
}

fn service_name(name: &str) -> Result<ServiceName, ChannelError> {
    name.try_into().map_err(|e| ChannelError::set_up(format!("the name {name}"), e))
}
