//! Scenario files: TOML in, a validated [`Plan`] out.

mod file;

pub use file::*;

use crate::encoder::Map;

/// A validated scenario: what the processes of a run are built from. Everything in it is finite, in range and consistent.
#[derive(Debug, Clone, PartialEq)]
pub struct Plan {
    /// The scenario with every default filled in.
    pub scenario: Scenario,
    /// Period of the tick, ns.
    pub period_ns: u64,
    /// The observation's inputs, in order; at most [`crate::wire::MAX_INPUTS`].
    pub inputs: Vec<SignalTable>,
    /// The command's outputs, in order; at most [`crate::wire::MAX_OUTPUTS`].
    pub outputs: Vec<SignalTable>,
    /// Names of the observation's measures, in order; at most [`crate::wire::MAX_MEASURES`].
    pub measures: Vec<String>,
    /// The encoder's maps, in order, ranges and units resolved.
    pub maps: Vec<Map>,
    /// 64-bit hash of the resolved scenario, as compared in the handshake.
    pub hash: u64,
}
