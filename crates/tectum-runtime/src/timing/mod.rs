//! Timed loops: what `tectum bench` and the criterion benches measure call by call, and exchanges over bare transports.
//!
//! They stand below the benches because loops of nanoseconds must be compiled with full optimisation, and the benches
//! around them need none. For the same reason their functions give lists and no iterators, whose closures would be
//! compiled where they are used. `calls.rs` times batches of calls in turns; `encoder_cases.rs` and `learner_cases.rs`
//! are what is called, and `joint_growth.rs` runs every learner on bodies of several sizes. `exchange.rs` exchanges
//! samples with a peer process over a bare transport, `tick_times.rs` turns instants into latencies, and
//! `cache_evictor.rs` makes the caches cold between ticks.

mod cache_evictor;
mod calls;
mod encoder_cases;
mod exchange;
mod joint_growth;
mod learner_cases;
mod peer;
mod tick_times;
mod transport;

pub use cache_evictor::CacheEvictor;
pub use calls::{CallCase, CallTimes, GrowthKey, in_turns};
pub use encoder_cases::InputRing;
pub use exchange::PeerExchange;
pub use joint_growth::{BodyCost, body_cost};
pub use learner_cases::{ControlLoop, WHOLE_TICK, rule_growth, rule_versions, tick_cases};
pub use peer::serve;
pub use tick_times::{Latencies, SERIES, SeriesPercentiles, TickTimes, hgrm};
pub use transport::Transport;

use crate::channel::ChannelError;
use crate::clock::TerminationSignals;
use crate::scenario::ScenarioError;

/// The scenario whose encoder, learner and plant are timed.
pub const SCENARIO: &str = "paper";

/// Why nothing was timed.
#[derive(Debug, thiserror::Error)]
pub enum TimingError {
    /// The scenario is not valid.
    #[error(transparent)]
    Scenario(#[from] ScenarioError),
    /// Shared memory cannot be set up.
    #[error(transparent)]
    Channel(#[from] ChannelError),
    /// The scenario's plant is not the simulator's.
    #[error("the plant of this scenario is not simulated; give one whose plant is tectum-simulator")]
    NotSimulated,
    /// The peer process of a bare transport failed.
    #[error("the other process of {transport}: {cause}")]
    Peer {
        /// The transport's name.
        transport: &'static str,
        /// What is wrong.
        cause: String,
    },
    /// A signal came before the end.
    #[error("ended by signal {0}")]
    Signal(u32),
}

/// An error if a signal has come that ends the bench.
fn check_signals(signals: &TerminationSignals) -> Result<(), TimingError> {
    match signals.received() {
        0 => Ok(()),
        number => Err(TimingError::Signal(number)),
    }
}
