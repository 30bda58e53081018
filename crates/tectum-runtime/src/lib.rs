//! The runtime of [Tectum](https://docs.rs/tectum): what the processes of a run exchange, and the loops that they run.
//!
//! The modules from the bottom up: `run_folder` finds a run; [`wire`] defines the samples; [`clock`] is the operating
//! system; [`channel`] is the shared memory (iceoryx2); [`checkpoint`] keeps whole states in files; [`log`] writes and
//! reads MCAP; [`runtime`] holds the loops of plant, controller and logger, the gate, and runs inside one process;
//! [`reference`](mod@reference) tests what was learned; [`timing`] times calls and exchanges.
//!
//! The crate is a part of `tectum`, which re-exports what a plant, a controller, a tracker or a reader of logs needs.
//! Depend on `tectum`: everything else that is public here serves Tectum's own programs and may change at any time. It
//! is a crate of its own because the loops of a tick are compiled with full optimisation, and the tools around them are
//! not.
//!
//! ```
//! use tectum_runtime::runtime::in_process;
//! use tectum_scenario::Scenario;
//!
//! let plan = Scenario { ticks: 400, ..Scenario::find("arm")? }.plan()?;
//! let plant = plan.simulated_plant().expect("the arm is simulated");
//! let result = in_process(&plan, plant, |_, _| true);
//! assert_eq!(result.controller.ticks, 400);
//! # Ok::<(), tectum_scenario::ScenarioError>(())
//! ```

#![warn(missing_docs)]

pub mod channel;
pub mod checkpoint;
pub mod clock;
pub mod log;
pub mod reference;
pub mod run_folder;
pub mod runtime;
pub mod timing;
pub mod wire;

use tectum_core::{agent, learner, plant, policy, seed, state};
use tectum_encoder::{self as encoder, simd};
use tectum_report::{stats, text};
use tectum_scenario as scenario;

/// The build's identity: package version and git commit. The handshake compares it, and every log has it.
pub const BUILD: &str = env!("TECTUM_BUILD");
