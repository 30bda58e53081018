//! The bridge's report: duration of bus instructions, and every time that torque went off.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::stats::Percentiles;

use super::safety::{SafetyState, TripCause};
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
    /// Number of ticks without torque, by the reason.
    #[serde(default)]
    pub without_torque: BTreeMap<String, u64>,
    /// Why torque was off at the end, if its safety had turned it off.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub off_at_end: Option<TripCause>,
    /// Duration of a tick's synchronous read, us.
    pub bus_read: Option<Percentiles>,
    /// Duration of a tick's synchronous write, us.
    pub bus_write: Option<Percentiles>,
    /// Report on the trackers, if the scenario uses them.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub vision: Option<VisionReport>,
}

impl BridgeReport {
    /// Counts a tick without torque in this state.
    pub(super) fn count_without_torque(&mut self, state: SafetyState) {
        let reason = match state {
            SafetyState::Tripped(cause) => cause.to_string(),
            SafetyState::ReadOnly => "not armed".to_owned(),
            SafetyState::Ready | SafetyState::Driving => "no command yet".to_owned(),
        };
        *self.without_torque.entry(reason).or_default() += 1;
    }
}

/// Converts ns to us.
pub(super) fn microseconds(ns: u64) -> f32 {
    ns as f32 / 1000.0
}
