//! The samples and boards that processes exchange: plain, fixed-size, versioned data.
//!
//! Every sample is `#[repr(C)]` and consists of naturally aligned primitives without implicit padding. So its
//! bytes are its shared-memory layout and also, behind four bytes of encapsulation, its CDR encoding. The
//! `sample!` macro is the one source of the Rust type, its field table and its `ros2msg` text. [`schema_hash`]
//! covers all of them; it is compared when a process joins a run.
//!
//! Instants are nanoseconds of one monotonic clock (CLOCK_MONOTONIC in real time, the tick's virtual time in
//! lockstep).

mod boards;
mod samples;
mod schema;

pub use boards::{Control, Phase, ProcessState, Status};
pub use samples::{Ahead, Command, Gap, Header, Learning, Observation, Vision};
pub use schema::{Field, Sample, schema_hash};

pub use tectum_core::agent::MAX_COLUMNS;
pub use tectum_core::flag;
pub use tectum_scenario::limits::{MAX_AHEAD, MAX_INPUTS, MAX_MEASURES, MAX_OUTPUTS};
pub use tectum_scenario::{ChannelNames, Role};

/// A number for each output that a command can carry; those beyond the plant's outputs are 0.
pub type OutputValues = [f32; MAX_OUTPUTS];
