//! The samples that processes exchange: plain, fixed-size, versioned data.
//!
//! Every sample is `#[repr(C)]`, made of naturally aligned primitives without implicit padding, so that its bytes are at
//! once its shared-memory layout and (behind four bytes of encapsulation) its CDR encoding. The `sample!` macro is the
//! one source of the Rust type, of its field table and of its `ros2msg` text; [`schema_hash`] covers all of them and is
//! compared when a process joins a run.
//!
//! Instants are nanoseconds of one monotonic clock (CLOCK_MONOTONIC in real time, the tick's virtual time in lockstep).

mod boards;
mod channel_names;
mod samples;
mod schema;

pub use boards::{Control, Phase, ProcessState, Role, Status};
pub use channel_names::ChannelNames;
pub use samples::{Command, Gap, Header, Learning, Observation, Vision, flag};
pub use schema::{Field, Sample, schema_hash};

/// Most inputs that an observation can carry.
pub const MAX_INPUTS: usize = 16;
/// Most outputs that a command can carry.
pub const MAX_OUTPUTS: usize = 8;
/// Most measures that an observation can carry beside its inputs.
pub const MAX_MEASURES: usize = 6;
