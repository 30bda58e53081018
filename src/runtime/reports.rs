//! What each process leaves in the run's folder when its loop is over, for the launcher's summary.

use std::path::{Path, PathBuf};

use hdrhistogram::Histogram;
use serde::{Deserialize, Serialize, de::DeserializeOwned};

use super::{RuntimeError, Snapshot, TickBudget};
use crate::clock::RealtimeReport;
use crate::report::Window;
use crate::state::{Ledger, Remember};
use crate::wire::Role;

/// Percentiles of a duration, us.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Percentiles {
    /// Number of values.
    pub count: u64,
    /// Median.
    pub p50: f64,
    /// 90th percentile.
    pub p90: f64,
    /// 99th percentile.
    pub p99: f64,
    /// 99.9th percentile.
    pub p999: f64,
    /// Largest.
    pub max: f64,
}

impl Percentiles {
    /// The percentiles of a histogram of nanoseconds; `None` when it is empty.
    pub fn of(histogram: &Histogram<u64>) -> Option<Self> {
        let at = |q| histogram.value_at_quantile(q) as f64 / 1000.0;
        (!histogram.is_empty()).then(|| Self {
            count: histogram.len(),
            p50: at(0.5),
            p90: at(0.9),
            p99: at(0.99),
            p999: at(0.999),
            max: histogram.max() as f64 / 1000.0,
        })
    }
}

/// A minute in nanoseconds, to three significant digits; longer waits count as a minute.
pub(super) fn histogram() -> Histogram<u64> {
    Histogram::new_with_max(60_000_000_000, 3).expect("fixed bounds")
}

/// The plant's account.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct PlantReport {
    /// Ticks begun.
    pub ticks: u64,
    /// Ticks whose command was not applied: it was not there in time, was not a number, or the plant passed the tick over.
    pub missed: u64,
    /// Commands that came after their tick, and were dropped.
    pub late: u64,
    /// Ticks passed over because the plant itself was late.
    pub skipped: u64,
    /// Ticks in which the gate limited what was wanted, for whatever reason.
    pub clamped: u64,
    /// Ticks in which the gate limited the change of the applied command.
    pub step_limited: u64,
    /// Ticks in which the gate kept a joint from going over its limits.
    pub position_limited: u64,
    /// Commands that the gate's ramp limited.
    pub ramped: u64,
    /// Commands that held a value that is not a number.
    pub non_finite: u64,
    /// Checkpoints written by the process that ended the run.
    pub checkpoints: u64,
    /// Why one could not be written, one sentence; null where all could.
    pub checkpoint_failure: Option<String>,
    /// Real time: from a tick's scheduled instant to the plant's waking up for it.
    pub wake_up: Option<Percentiles>,
    /// Real time: from the sensing of an observation to the sending of the command that answers it.
    pub observation_to_command: Option<Percentiles>,
    /// Real time: from waking up to the observation's being sent.
    pub work: Option<Percentiles>,
}

impl Remember for PlantReport {
    /// Percentiles are made at the end.
    fn remember(&mut self, ledger: &mut dyn Ledger) {
        for (name, count) in [
            ("ticks", &mut self.ticks),
            ("missed", &mut self.missed),
            ("late", &mut self.late),
            ("skipped", &mut self.skipped),
            ("clamped", &mut self.clamped),
            ("step_limited", &mut self.step_limited),
            ("position_limited", &mut self.position_limited),
            ("ramped", &mut self.ramped),
            ("non_finite", &mut self.non_finite),
        ] {
            ledger.number(name, count);
        }
    }
}

/// The controller's account.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct ControllerReport {
    /// Observations answered.
    pub ticks: u64,
    /// Observations that it never saw.
    pub unseen: u64,
    /// Ticks in which a fault of the channel let it hear nothing, and it answered so.
    pub unheard: u64,
    /// Observations that a fault of the channel let come after their tick; it neither answers nor learns from them.
    pub stale: u64,
    /// Ticks learned from.
    pub learned: u64,
    /// Times that the trace was cut.
    pub cuts: u64,
    /// Observations with an input that is not a number.
    pub invalid: u64,
    /// The first tick at which the weights were no longer numbers.
    pub diverged_at: Option<u64>,
    /// Checkpoints written by the process that ended the run.
    pub checkpoints: u64,
    /// Why one could not be written, one sentence; null where all could.
    pub checkpoint_failure: Option<String>,
    /// Real time: how the ticks were spent.
    pub tick_budget: Option<TickBudget>,
    /// XXH3-64 of the weights at the end, hexadecimal.
    pub weights_hash: String,
    /// Losses and errors over the run.
    pub windows: Vec<Window>,
    /// Inputs around the first whole target switch.
    pub first_switch: Vec<Snapshot>,
    /// Inputs around the last whole target switch.
    pub last_switch: Vec<Snapshot>,
}

impl Remember for ControllerReport {
    /// What is made at the end is not in it.
    fn remember(&mut self, ledger: &mut dyn Ledger) {
        for (name, count) in [
            ("ticks", &mut self.ticks),
            ("unseen", &mut self.unseen),
            ("unheard", &mut self.unheard),
            ("stale", &mut self.stale),
            ("learned", &mut self.learned),
            ("cuts", &mut self.cuts),
            ("invalid", &mut self.invalid),
        ] {
            ledger.number(name, count);
        }
        ledger.maybe("diverged_at", &mut self.diverged_at);
    }
}

/// The logger's account. The three channels stand in the order observation, command, learning.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct LoggerReport {
    /// Messages written.
    pub written: [u64; 3],
    /// Samples lost.
    pub lost: [u64; 3],
    /// Samples left out on purpose.
    pub thinned: [u64; 3],
    /// Size of the log, bytes.
    pub bytes: u64,
}

/// Where the report of `role` lies in the run's folder.
fn report_path(folder: &Path, role: Role) -> PathBuf {
    folder.join(format!("{}.json", role.name()))
}

/// Where the account of the real-time set-up of `role` lies in the run's folder. A file of its own, because it is there
/// from before the first tick on: launcher and logger read it when the run begins.
pub fn realtime_path(folder: &Path, role: Role) -> PathBuf {
    folder.join(format!("{}.realtime.json", role.name()))
}

/// Writes a report, whole or not at all.
pub(super) fn write<T: Serialize>(folder: &Path, role: Role, report: &T) -> Result<(), RuntimeError> {
    write_to(report_path(folder, role), report)
}

/// Writes the account of a process's real-time set-up.
pub(super) fn write_realtime(folder: &Path, role: Role, report: &RealtimeReport) -> Result<(), RuntimeError> {
    write_to(realtime_path(folder, role), report)
}

fn write_to<T: Serialize>(path: PathBuf, report: &T) -> Result<(), RuntimeError> {
    let failed = |cause| RuntimeError::File { path: path.display().to_string(), cause };
    let text = serde_json::to_string_pretty(report).map_err(|e| failed(e.into()))?;
    let draft = path.with_extension("json.part");
    std::fs::write(&draft, text).and_then(|()| std::fs::rename(&draft, &path)).map_err(failed)
}

/// Reads a report; `None` when the process left none.
pub fn read<T: DeserializeOwned>(folder: &Path, role: Role) -> Option<T> {
    read_from(&report_path(folder, role))
}

/// Reads the account of a process's real-time set-up; `None` when there is none, as in lockstep.
pub fn read_realtime(folder: &Path, role: Role) -> Option<RealtimeReport> {
    read_from(&realtime_path(folder, role))
}

fn read_from<T: DeserializeOwned>(path: &Path) -> Option<T> {
    serde_json::from_str(&std::fs::read_to_string(path).ok()?).ok()
}
