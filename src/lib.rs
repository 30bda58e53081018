//! Tectum: a shared-memory runtime for closed-loop control in which the controller learns on line.
//!
//! A plant, a controller and a logger run as separate processes and exchange fixed-size samples over zero-copy
//! iceoryx2 channels, inside a strict tick. The rooms, and who may know whom, are drawn in `ARCHITECTURE.md`; in short,
//! [`lanes`], [`encoder`], [`policy`], [`learner`] and [`plant`] are pure computation, [`wire`] is plain data, [`channel`] and
//! [`clock`] are the only doors to the outside, and [`runtime`] joins them into loops.

#![warn(missing_docs)]

pub mod bench;
pub mod channel;
pub mod checkpoint;
pub mod clock;
pub mod doctor;
pub mod encoder;
pub mod learner;
pub mod log;
pub mod plant;
pub mod policy;
pub mod process;
pub mod reference;
pub mod report;
pub mod runtime;
pub mod scenario;
pub mod seed;
pub mod servo;
pub mod simd;
pub mod state;
pub mod study;
pub mod supervise;
pub mod wire;

/// The build's identity: package version and git commit, as compared in the handshake and written into every log.
pub const BUILD: &str = env!("TECTUM_BUILD");
