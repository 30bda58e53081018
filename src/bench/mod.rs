//! `tectum bench`: how fast it is, measured so that its critics agree.
//!
//! Latency counts from the *scheduled* instant, between real processes, at the real cadence, with what a stall swallowed
//! added; beside it, in blocks that take turns, stand the bare ways from one process to another and back with the same
//! payload, so that what Tectum adds is a ratio and not a number of this machine alone. Every number comes with its spread
//! and with the machine it was measured on.

mod all;
mod block;
mod calls;
mod costs;
mod encoder;
mod error;
mod evict;
mod exchange;
mod lap;
mod latency;
mod learner;
mod line;
mod lockstep;
mod machine;
mod peer;
mod progress;
mod targets;
mod usage;

pub use all::{All, AllOutcome, all};
pub use calls::Nanoseconds;
pub use costs::{Calls, Cost, CostsOutcome, Growth};
pub use encoder::encoder;
pub use error::BenchError;
pub use evict::Evictor;
pub use exchange::Exchange;
pub use lap::{Lap, Latencies, SERIES, SeriesPercentiles, hgrm};
pub use latency::{Caches, CaseOutcome, Latency, LatencyOutcome, Pace, Ratio, latency};
pub use learner::learner;
pub use line::Way;
pub use lockstep::{CaseRate, Lockstep, LockstepOutcome, lockstep};
pub use machine::Machine;
pub use peer::serve;
use progress::Progress;
pub use targets::Target;
pub use usage::{ProcessUse, Usage};
