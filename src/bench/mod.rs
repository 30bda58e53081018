//! `tectum bench`: how fast it is, measured so that its critics agree.
//!
//! Latency counts from the *scheduled* instant, between real processes, at the real cadence, with what a stall swallowed
//! added; beside it, in blocks that take turns, stand the bare ways from one process to another and back with the same
//! payload, so that what Tectum adds is a ratio and not a number of this machine alone. Every number comes with its spread
//! and with the machine it was measured on.

mod all;
mod cache_evictor;
mod calls;
mod costs;
mod encoder;
mod error;
mod exchange;
mod latency;
mod learner;
mod lockstep;
mod machine;
mod peer;
mod run_block;
mod targets;
mod tick_times;
mod transport;
mod usage;

pub use all::{AllBenches, AllOutcome, all};
pub use cache_evictor::CacheEvictor;
pub use calls::CallTimes;
pub use costs::{CallCost, CallsSettings, CostsOutcome, Growth};
pub use encoder::encoder;
pub use error::BenchError;
pub use exchange::PeerExchange;
pub use latency::{Caches, CaseOutcome, LatencyOutcome, LatencySettings, Pace, Ratio, latency};
pub use learner::learner;
pub use lockstep::{CaseRate, LockstepOutcome, LockstepSettings, lockstep};
pub use machine::Machine;
pub use peer::serve;
pub use targets::TargetRow;
pub use tick_times::{Latencies, SERIES, SeriesPercentiles, TickTimes, hgrm};
pub use transport::Transport;
pub use usage::{ProcessUse, Usage};
