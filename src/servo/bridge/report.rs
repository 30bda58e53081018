//! The bridge's account: what the bus cost, and every time that torque went off.

use serde::{Deserialize, Serialize};

use crate::stats::Percentiles;

use super::safety::TripCause;
use super::vision::VisionReport;

/// Torque went off.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct TripEvent {
    /// When.
    pub tick: u64,
    /// Why.
    pub cause: TripCause,
}

/// What the bridge leaves in the run's folder as `bridge.json`.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub struct BridgeReport {
    /// Ticks lived through.
    pub ticks: u64,
    /// Reads that not all servos answered.
    pub blind: u64,
    /// Goals that the port did not take.
    pub unwritten: u64,
    /// Times that torque went on.
    pub armed: u64,
    /// Times that it went off before the end, and why.
    pub events: Vec<TripEvent>,
    /// What a tick's synchronous read takes.
    pub bus_read: Option<Percentiles>,
    /// What a tick's synchronous write takes.
    pub bus_write: Option<Percentiles>,
    /// What came from trackers, where the scenario asks for them.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub vision: Option<VisionReport>,
}

/// ns as us.
pub(super) fn microseconds(ns: u64) -> f32 {
    ns as f32 / 1000.0
}
