//! Tectum: a shared-memory runtime for closed-loop control in which the controller learns on line.
//!
//! A plant, a controller and a logger run as separate processes and exchange fixed-size samples over zero-copy
//! iceoryx2 channels, inside a strict tick. The rooms, and who may know whom, are drawn in `ARCHITECTURE.md`; in short,
//! [`simd`], [`encoder`], [`policy`], [`learner`] and [`plant`] are pure computation, [`wire`] is plain data,
//! [`channel`] and [`clock`] are the only doors to the outside, and [`runtime`] joins them into loops.

#![warn(missing_docs)]

pub mod bench;
pub mod channel;
pub mod checkpoint;
pub mod clock;
pub mod doctor;
pub mod log;
pub mod process;
mod programs;
pub mod reference;
pub mod report;
mod run_folder;
pub mod runtime;
pub mod scenario;
pub mod servo;
pub mod stats;
pub mod study;
pub mod supervise;
mod text;
pub mod wire;

pub use tectum_core::{learner, plant, policy, seed, state};
pub use tectum_encoder as encoder;
pub use tectum_encoder::simd;

/// The build's identity: package version and git commit, as compared in the handshake and written into every log.
pub const BUILD: &str = env!("TECTUM_BUILD");
