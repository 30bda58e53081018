//! The reports that processes write into the run's folder when their loops are over, for the launcher's
//! summary.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::Write as _;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize, de::DeserializeOwned};

use super::run_counts::RunCounts;
use super::{RuntimeError, Snapshot, TargetsAround, TickBudget};
use crate::clock::RealtimeReport;
use crate::state::{Persist, StateVisitor};
use crate::stats::{Percentiles, Window};
use crate::wire::{MAX_COLUMNS, Role};

/// The plant's report.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct PlantReport {
    /// Ticks begun.
    pub ticks: u64,
    /// Ticks whose command was not applied: it had not arrived in time, was not finite, or the plant skipped
    /// the tick.
    pub missed: u64,
    /// Those of them in which the gate applied a command that an earlier one had brought ahead.
    #[serde(default)]
    pub ahead: u64,
    /// Commands that arrived after their tick and were dropped.
    pub late: u64,
    /// Ticks skipped because the plant itself was late.
    pub skipped: u64,
    /// Ticks in which the gate limited the command, for any reason.
    pub clamped: u64,
    /// Ticks in which the gate limited the change of the applied command.
    pub step_limited: u64,
    /// Ticks in which the gate kept a joint within its position limits.
    pub position_limited: u64,
    /// Commands that the gate's ramp limited.
    pub ramped: u64,
    /// Commands with a value that is not finite.
    pub non_finite: u64,
    /// The tick at which the plant came back without what it had remembered; null where it never did.
    pub forgot_at: Option<u64>,
    /// Checkpoints written by the process that ended the run.
    pub checkpoints: u64,
    /// Why a checkpoint could not be written, one sentence; null where all could.
    pub checkpoint_failure: Option<String>,
    /// Real time: from a tick's scheduled instant to the plant's wake-up for it.
    pub wake_up: Option<Percentiles>,
    /// Real time: from the sensing of an observation to the sending of the command that answers it.
    pub observation_to_command: Option<Percentiles>,
    /// Real time: from the plant's wake-up to the sending of the observation.
    pub work: Option<Percentiles>,
}

impl Persist for PlantReport {
    /// The percentiles are not part of the state: they are computed at the end.
    fn visit_state(&mut self, visitor: &mut dyn StateVisitor) {
        for (name, count) in [
            ("ticks", &mut self.ticks),
            ("missed", &mut self.missed),
            ("ahead", &mut self.ahead),
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
        visitor.optional("forgot_at", &mut self.forgot_at);
    }
}

/// The controller's report. A controller in another language may leave out what it does not count.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct ControllerReport {
    /// Observations answered.
    pub ticks: u64,
    /// Observations that it never received.
    pub unseen: u64,
    /// Ticks whose observation a channel fault withheld. The controller answers them with the flag `UNHEARD`.
    pub unheard: u64,
    /// Observations that a channel fault delayed beyond their tick. The controller neither answers nor learns
    /// from them.
    pub stale: u64,
    /// Ticks learned from.
    pub learned: u64,
    /// Number of times that the trace was cut.
    pub cuts: u64,
    /// Observations with an input that is not a number.
    pub invalid: u64,
    /// The first tick at which learning met a number that is not finite.
    pub diverged_at: Option<u64>,
    /// The tick at which the controller came back without what it had remembered and learned; null where it never
    /// did.
    pub forgot_at: Option<u64>,
    /// The tick of the checkpoint whose learner it began with; null where it began with a fresh one.
    pub started_from: Option<u64>,
    /// Whether the learner was frozen: nothing was learned, and nothing explored.
    pub frozen: bool,
    /// Counts from which the run is judged.
    pub counts: RunCounts,
    /// What the learner counted, by name.
    pub learner: BTreeMap<String, u64>,
    /// Checkpoints written by the process that ended the run.
    pub checkpoints: u64,
    /// Why a checkpoint could not be written, one sentence; null where all could.
    pub checkpoint_failure: Option<String>,
    /// Real time: the tick budget.
    pub tick_budget: Option<TickBudget>,
    /// XXH3-64 of the weights at the end, hexadecimal.
    pub weights_hash: String,
    /// Losses and errors over the run.
    pub windows: Vec<Window>,
    /// Inputs around the first complete target switch.
    pub first_switch: Vec<Snapshot>,
    /// Inputs around a late target switch: with an arm, around a typical one.
    pub last_switch: Vec<Snapshot>,
    /// What single targets cost around the ticks that the summary looks at; empty without an arm.
    pub targets: Vec<TargetsAround>,
}

impl Persist for ControllerReport {
    /// Fields that are computed at the end are not part of the state.
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
        visitor.optional("forgot_at", &mut self.forgot_at);
    }
}

/// The logger's report. It covers the whole run, including what earlier incarnations of the logger wrote. The
/// three channels are in the order observation, command, learning.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct LoggerReport {
    /// Messages written.
    pub written: [u64; 3],
    /// Samples lost.
    pub lost: [u64; 3],
    /// Samples left out on purpose (`every` under `[log]`).
    pub thinned: [u64; 3],
    /// Samples that arrived twice. One of each pair was dropped.
    pub duplicates: [u64; 3],
    /// The tick from which on samples are missing because the log could not be written.
    pub missing_from: Option<u64>,
    /// Why the log could not be written or closed.
    pub failure: Option<String>,
    /// Size of the log, all segments that are there, bytes.
    pub bytes: u64,
    /// Segments that were removed because the log had reached its limit.
    #[serde(default)]
    pub removed_segments: u64,
    /// Messages of earlier segments that this logger read before it listened: those after the last account.
    #[serde(default)]
    pub reread: u64,
    /// Real time: from a tick's scheduled instant to its sensing; see
    /// [`LatencyHistograms`](crate::log::LatencyHistograms).
    pub wake_up_lateness: Option<Percentiles>,
    /// Real time: from the sensing of an observation to the sending of the command that answers it.
    pub observation_to_command: Option<Percentiles>,
    /// Real time: from the sending of a command to the observation that reports it as applied.
    pub command_to_applied: Option<Percentiles>,
}

/// The report's file of `role` in the run's folder.
fn report_path(folder: &Path, role: Role) -> PathBuf {
    folder.join(format!("{}.json", role.name()))
}

/// The file with the real-time settings of `role` in the run's folder. It is separate from the report because
/// launcher and logger read it before the first tick.
pub fn realtime_path(folder: &Path, role: Role) -> PathBuf {
    folder.join(format!("{}.realtime.json", role.name()))
}

/// The file with the names of the agent's own columns in the run's folder; the logger reads it before the first tick.
fn columns_path(folder: &Path) -> PathBuf {
    folder.join("controller.columns.json")
}

/// Writes the names of the agent's own columns.
pub(super) fn write_columns(folder: &Path, columns: &[&str]) -> Result<(), RuntimeError> {
    write_to(columns_path(folder), &columns)
}

/// The names of the agent's own columns in the learning record; none when the controller left none.
pub fn read_columns(folder: &Path) -> Vec<String> {
    let mut columns: Vec<String> = read_from(&columns_path(folder)).unwrap_or_default();
    columns.truncate(MAX_COLUMNS);
    columns
}

/// Writes a report atomically: the whole file or none.
pub(super) fn write<T: Serialize>(folder: &Path, role: Role, report: &T) -> Result<(), RuntimeError> {
    write_to(report_path(folder, role), report)
}

/// Writes a process's real-time settings.
pub(super) fn write_realtime(folder: &Path, role: Role, report: &RealtimeReport) -> Result<(), RuntimeError> {
    write_to(realtime_path(folder, role), report)
}

/// Disk space reserved for a report, bytes. The controller's report contains its windows.
const RESERVED_BYTES: u64 = 256 << 10;

/// Reserves disk space for the report of `role`, so that it can still be written when the disk fills up during
/// the run. Does nothing on file systems that cannot reserve space.
pub(super) fn reserve_space(folder: &Path, role: Role) {
    if let Ok(file) = open_draft(&report_path(folder, role)) {
        let _ = rustix::fs::fallocate(&file, rustix::fs::FallocateFlags::KEEP_SIZE, 0, RESERVED_BYTES);
    }
}

/// Removes what processes left in the folder for themselves: the reserved space (`*.json.part`) of those that ended
/// without writing their report, and the logger's account.
pub fn remove_unwritten_reports(folder: &Path) {
    for role in Role::ALL {
        let _ = std::fs::remove_file(draft_of(&report_path(folder, role)));
    }
    crate::log::remove_account(folder);
}

/// The file under which a report is written before it gets its name.
fn draft_of(path: &Path) -> PathBuf {
    path.with_extension("json.part")
}

/// Opens the draft of the file at `path` without truncating it, so that its reserved space stays.
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

/// Reads a process's real-time settings; `None` when there are none, as in lockstep.
pub fn read_realtime(folder: &Path, role: Role) -> Option<RealtimeReport> {
    read_from(&realtime_path(folder, role))
}

fn read_from<T: DeserializeOwned>(path: &Path) -> Option<T> {
    serde_json::from_str(&std::fs::read_to_string(path).ok()?).ok()
}
