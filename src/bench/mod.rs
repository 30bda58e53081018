//! `tectum bench`: how fast Tectum is, measured so that critics can agree.
//!
//! Latency counts from the *scheduled* instant, between real processes, at the real cadence, and includes the
//! ticks that a stall skipped. Beside it, in blocks that take turns, stand the bare transports from one process
//! to another and back with the same payload, so that the overhead of Tectum is a ratio and not a number of
//! this machine alone. Every number comes with its spread and with a description of the machine.

mod all;
mod cache_evictor;
mod calls;
mod context;
mod costs;
mod encoder;
mod encoder_cases;
mod error;
mod exchange;
mod latency;
mod latency_outcome;
mod learner;
mod learner_cases;
mod lockstep;
mod machine;
mod peer;
mod run_block;
mod targets;
mod tick_times;
mod transport;
mod usage;

pub use all::{AllBenches, AllOutcome, all};
pub use calls::CallCase;
pub use costs::{CallsSettings, CostsOutcome, GrowthKey};
pub use encoder::encoder;
pub use encoder_cases::InputRing;
pub use error::BenchError;
pub use latency::{LatencySettings, Pace, latency};
pub use latency_outcome::LatencyOutcome;
pub use learner::learner;
pub use learner_cases::{ControlLoop, rule_growth, rule_versions};
pub use lockstep::{LockstepOutcome, LockstepSettings, lockstep};
use machine::Machine;
pub use peer::serve;
use tick_times::{Latencies, TickTimes};
pub use transport::Transport;
