//! What each process leaves in the run's folder when its loop is over, for the launcher's summary.

use std::fs::File;
use std::io::Write as _;
use std::path::{Path, PathBuf};

use hdrhistogram::Histogram;
use serde::{Deserialize, Serialize, de::DeserializeOwned};

use super::{RuntimeError, Snapshot, TargetsAround, TickBudget};
use crate::clock::RealtimeReport;
pub use crate::log::Percentiles;
use crate::report::Window;
use crate::state::{Persist, StateVisitor};
use crate::wire::Role;

/// A minute in nanoseconds, to three significant digits; longer waits count as a minute.
pub(super) fn histogram() -> Histogram<u64> {
    crate::log::histogram()
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

impl Persist for PlantReport {
    /// Percentiles are made at the end.
    fn visit_state(&mut self, visitor: &mut dyn StateVisitor) {
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
            visitor.number(name, count);
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
    /// Inputs around a late target switch: with an arm, a typical one.
    pub last_switch: Vec<Snapshot>,
    /// What single targets cost around the ticks that the summary looks at; empty without an arm.
    pub targets: Vec<TargetsAround>,
}

impl Persist for ControllerReport {
    /// What is made at the end is not in it.
    fn visit_state(&mut self, visitor: &mut dyn StateVisitor) {
        for (name, count) in [
            ("ticks", &mut self.ticks),
            ("unseen", &mut self.unseen),
            ("unheard", &mut self.unheard),
            ("stale", &mut self.stale),
            ("learned", &mut self.learned),
            ("cuts", &mut self.cuts),
            ("invalid", &mut self.invalid),
        ] {
            visitor.number(name, count);
        }
        visitor.optional("diverged_at", &mut self.diverged_at);
    }
}

/// The logger's account: of the run, with what earlier loggers of the same run wrote. The three channels stand in the order
/// observation, command, learning.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct LoggerReport {
    /// Messages written.
    pub written: [u64; 3],
    /// Samples lost.
    pub lost: [u64; 3],
    /// Samples left out on purpose.
    pub thinned: [u64; 3],
    /// Samples that came twice, of which one was dropped.
    pub duplicates: [u64; 3],
    /// The tick from which on samples are missing because the log did not take them.
    pub missing_from: Option<u64>,
    /// Why it did not, or why it could not be closed.
    pub failure: Option<String>,
    /// Size of the log, all segments, bytes.
    pub bytes: u64,
    /// Real time: from a tick's scheduled instant to its sensing; see [`LatencyHistograms`](crate::log::Timings).
    pub wake_up_lateness: Option<Percentiles>,
    /// Real time: from the sensing of an observation to the sending of the command that answers it.
    pub observation_to_command: Option<Percentiles>,
    /// Real time: from the sending of a command to the observation that tells that it was applied.
    pub command_to_applied: Option<Percentiles>,
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

/// Room kept for a report, bytes; the controller's has its windows in it.
const ROOM: u64 = 256 << 10;

/// Keeps room on the disk for the report of `role`, so that a disk that fills up meanwhile costs nobody's account. Best
/// effort: not every file system can.
pub(super) fn keep_room(folder: &Path, role: Role) {
    if let Ok(file) = open_draft(&report_path(folder, role)) {
        let _ = rustix::fs::fallocate(&file, rustix::fs::FallocateFlags::KEEP_SIZE, 0, ROOM);
    }
}

/// Takes away what processes left that never came to their report.
pub fn sweep_drafts(folder: &Path) {
    for role in Role::ALL {
        let _ = std::fs::remove_file(draft_of(&report_path(folder, role)));
    }
}

fn draft_of(path: &Path) -> PathBuf {
    path.with_extension("json.part")
}

/// Opens the draft of the file at `path` as it is: its room is not given away.
fn open_draft(path: &Path) -> std::io::Result<File> {
    File::options().write(true).create(true).truncate(false).open(draft_of(path))
}

fn write_to<T: Serialize>(path: PathBuf, report: &T) -> Result<(), RuntimeError> {
    let failed = |cause| RuntimeError::File { path: path.display().to_string(), cause };
    let text = serde_json::to_string_pretty(report).map_err(|e| failed(e.into()))?;
    let written = open_draft(&path).and_then(|mut file| {
        file.write_all(text.as_bytes())?;
        file.set_len(text.len() as u64)
    });
    written.and_then(|()| std::fs::rename(draft_of(&path), &path)).map_err(failed)
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
