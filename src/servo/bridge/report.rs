//! The bridge's report: duration of bus instructions, and every time that torque went off.

use serde::{Deserialize, Serialize};

use crate::stats::Percentiles;

use super::safety::TripCause;
use super::vision::VisionReport;

/// An event in which torque went off.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct TripEvent {
    /// The tick.
    pub tick: u64,
    /// The cause.
    pub cause: TripCause,
}

/// The report that the bridge writes to `bridge.json` in the run's folder.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub struct BridgeReport {
    /// Number of ticks.
    pub ticks: u64,
    /// Number of ticks in which not all servos answered.
    pub blind: u64,
    /// Number of ticks whose goals could not be written.
    pub unwritten: u64,
    /// Number of times that torque went on.
    pub armed: u64,
    /// Events in which torque went off before the end.
    pub events: Vec<TripEvent>,
    /// Duration of a tick's synchronous read, us.
    pub bus_read: Option<Percentiles>,
    /// Duration of a tick's synchronous write, us.
    pub bus_write: Option<Percentiles>,
    /// Report on the trackers, if the scenario uses them.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub vision: Option<VisionReport>,
}

/// Converts ns to us.
pub(super) fn microseconds(ns: u64) -> f32 {
    ns as f32 / 1000.0
}
