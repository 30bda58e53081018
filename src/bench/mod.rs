//! `tectum bench`: how fast Tectum is, measured so that critics can agree.
//!
//! Latency counts from the *scheduled* instant, between real processes, at the real cadence, and includes the
//! ticks that a stall skipped. Beside it, in blocks that take turns, stand the bare transports from one process
//! to another and back with the same payload, so that the overhead of Tectum is a ratio and not a number of
//! this machine alone. Every number comes with its spread and with a description of the machine.

mod all;
mod context;
mod costs;
mod encoder;
mod error;
mod growth;
mod latency;
mod latency_outcome;
mod learner;
mod lockstep;
mod machine;
mod run_block;
mod targets;
mod usage;

pub use all::{AllBenches, AllOutcome, all};
pub use costs::{CallsSettings, CostsOutcome};
pub use encoder::encoder;
pub use error::BenchError;
pub use growth::{GrowthOutcome, GrowthSettings, growth};
pub use latency::{LatencySettings, Pace, latency};
pub use latency_outcome::LatencyOutcome;
pub use learner::learner;
pub use lockstep::{LockstepOutcome, LockstepSettings, lockstep};
use machine::Machine;
