//! How long each leg of a command's way takes, and what the link leaves in the run's folder about it.

use std::collections::BTreeMap;
use std::path::Path;

use hdrhistogram::Histogram;
use serde::Serialize;
use tectum::stats::{Percentiles, histogram};

use crate::LinkError;
use crate::clock_offset::ClockOffset;
use crate::connection::StrangerCounts;

/// Names of the legs, in the order of the way; then the whole way, and the network's part of it.
const NAMES: [&str; 7] = [
    "plant_to_link_us",
    "network_to_controller_us",
    "controllers_machine_us",
    "network_to_plant_us",
    "link_to_plant_us",
    "observation_to_command_us",
    "network_both_ways_us",
];

/// The instants of one observation and its command, on the clock of the plant's machine, ns.
#[derive(Debug, Clone, Copy)]
pub struct Instants {
    /// The plant sent the observation.
    pub published: u64,
    /// The link sent it.
    pub sent: u64,
    /// The controller's machine received it.
    pub received_there: u64,
    /// The controller's machine sent the command.
    pub sent_there: u64,
    /// The link received the command.
    pub received: u64,
    /// The plant could take it.
    pub given: u64,
}

/// A histogram for each leg. The two legs over the network lie between clocks, so that they are known only to the
/// uncertainty of the offset; the others are not affected by it, and neither is their sum.
pub struct Legs([Histogram<u64>; 7]);

impl Default for Legs {
    fn default() -> Self {
        Self(NAMES.map(|_| histogram()))
    }
}

impl Legs {
    /// Records the way of one command.
    pub fn record(&mut self, at: &Instants) {
        let way = [at.published, at.sent, at.received_there, at.sent_there, at.received, at.given];
        for (leg, ends) in self.0.iter_mut().zip(way.windows(2)) {
            leg.saturating_record(ends[1].saturating_sub(ends[0]));
        }
        self.0[5].saturating_record(at.given.saturating_sub(at.published));
        let there = at.sent_there.saturating_sub(at.received_there);
        self.0[6].saturating_record(at.received.saturating_sub(at.sent).saturating_sub(there));
    }

    /// Percentiles of each leg, us.
    pub fn percentiles(&self) -> BTreeMap<&'static str, Option<Percentiles>> {
        NAMES.into_iter().zip(self.0.iter().map(Percentiles::of)).collect()
    }
}

/// What one end of a link counted: `link.json` in the run's folder.
#[derive(Debug, Default, Serialize)]
pub struct LinkReport {
    /// `plant` or `controller`.
    pub side: &'static str,
    /// Where the two ends met.
    pub address: String,
    /// Whether a key was used.
    pub key: bool,
    /// The other clock against this one, as known at the end.
    pub clock: Option<ClockOffset>,
    /// Observations that were sent (plant) or received (controller).
    pub observations: u64,
    /// Commands that were received (plant) or sent (controller).
    pub commands: u64,
    /// Plant's side: commands that never came.
    pub commands_lost: u64,
    /// Learning records that were received (plant) or sent (controller).
    pub learning_records: u64,
    /// Lockstep: samples that were sent again.
    pub repeated: u64,
    /// How often the other end became another session: its process or machine had come back.
    pub sessions: u64,
    /// Datagrams that were not taken.
    pub refused: StrangerCounts,
    /// Plant's side in real time: percentiles of each leg, us.
    pub legs: BTreeMap<&'static str, Option<Percentiles>>,
}

impl LinkReport {
    /// Writes the file.
    ///
    /// # Errors
    /// [`LinkError::File`].
    pub fn write(&self, folder: &Path) -> Result<(), LinkError> {
        let path = folder.join("link.json");
        let text = serde_json::to_string_pretty(self).unwrap_or_default();
        std::fs::write(&path, text).map_err(|cause| LinkError::File { path, cause })
    }
}
