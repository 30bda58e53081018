//! A controller's program at the other end of a pipe: a run in one process, a replay or a study starts it as a child,
//! hands it observations on its standard input, and reads its commands and learning records from its standard output.
//!
//! There is no shared memory and no clock. Parent and child take turns, so that the numbers are those of lockstep.
//! `docs/wire.md` has the protocol, for programs in other languages. The watchdog is that of a run: a child that ends
//! is noticed at once, and one that gives no answer for `hang_s` under `[restart]` is killed. It is not started again:
//! whatever made it fail would fail in the same way.
//!
//! A *test* shows what was learned, without exploration noise: the child keeps its state, answers observations with
//! its mean commands without learning, and continues from the kept state afterwards.

mod child;
mod error;
mod frame;
mod parent;
mod program;

pub use child::serve_controller;
pub use error::PipeError;
pub use parent::{PipedController, PipedStart};

use std::path::PathBuf;

use serde::{Deserialize, Serialize};

use crate::wire::schema_hash;

/// The option with which a controller's program is started.
pub const PIPE_OPTION: &str = "--pipe";
/// Version of the protocol.
const VERSION: u32 = 2;

/// The first number of a frame.
mod kind {
    pub const START: u32 = 1;
    pub const READY: u32 = 2;
    pub const OBSERVATION: u32 = 3;
    pub const COMMAND: u32 = 4;
    pub const LEARNING: u32 = 5;
    pub const REPORT: u32 = 6;
    pub const FAILED: u32 = 7;
    pub const TEST: u32 = 8;
    pub const TESTED: u32 = 9;
}

/// The parent's first frame.
#[derive(Debug, Serialize, Deserialize)]
struct Start {
    version: u32,
    /// Hash of the layout of all samples, hexadecimal.
    schema: String,
    /// The scenario as TOML, every default filled in.
    scenario: String,
    /// Where the scenario comes from, for messages.
    source: String,
    /// The folder at which the scenario's paths begin.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    folder: Option<PathBuf>,
    /// The checkpoint whose learner the controller is to begin with.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    start: Option<PathBuf>,
    /// Whether the learner is frozen.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    frozen: bool,
    /// For controllers in other languages: the scenario as JSON, names and ranges
    /// ([`wire_manifest::facts`](super::wire_manifest::facts)).
    #[serde(default)]
    run: serde_json::Value,
}

/// The child's answer to it.
#[derive(Debug, Serialize, Deserialize)]
struct Ready {
    version: u32,
    schema: String,
    /// Names of the agent's own columns in the learning record.
    #[serde(default)]
    columns: Vec<String>,
}

/// The child's last frame, if it cannot go on.
#[derive(Debug, Serialize, Deserialize)]
struct Failed {
    /// The exit code that fits.
    code: u8,
    message: String,
}

fn schema_text() -> String {
    format!("{:016x}", schema_hash())
}

fn json<T: Serialize>(value: &T) -> Vec<u8> {
    serde_json::to_vec(value).unwrap_or_default()
}
