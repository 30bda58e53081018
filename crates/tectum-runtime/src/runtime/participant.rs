//! Joining a run: a process finds the run, checks that it fits, and goes through the phases with the others.
//!
//! The launcher writes a manifest into the run's folder. A process becomes a participant by it: it reads the
//! run's scenario, opens the run's channels (which checks schema, scenario and build), and then follows the
//! phases on the launcher's board: ports created, ports connected, run. No process sends a first sample before
//! all processes are connected.

use std::cell::Cell;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::{RuntimeError, WireManifest};
use crate::channel::{ChannelError, CrashStore, DomainName, Identity, StatusBoard};
use crate::checkpoint::{self, Checkpoint, CheckpointFacts, CheckpointWriter};
use crate::clock::{ProcessHandle, RealtimeReport, RealtimeRequest, TerminationSignals, TimeSource, coarse_ns, pause};
use crate::run_folder;
use crate::scenario::{Plan, RealtimeProcess, Scenario};
use crate::state::Persist;
use crate::wire::{ChannelNames, Phase, ProcessState, Role, Status, schema_hash};

/// The mode of a run: how its ticks follow each other.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Mode {
    /// As fast as the processes can. No command is missed and no sample is lost.
    #[default]
    Lockstep,
    /// At the scenario's period, on the real clock.
    Realtime,
    /// Plant and controller in one process without transport or log, for studies.
    InProcess,
}

impl Mode {
    /// The mode's name, as on the command line and in the log.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Lockstep => "lockstep",
            Self::Realtime => "realtime",
            Self::InProcess => "in-process",
        }
    }
}

/// The run's manifest: the file in the run's folder by which processes join.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct RunManifest {
    /// The run's id: 16 hexadecimal digits.
    #[serde(deserialize_with = "run_id_text")]
    pub run: String,
    /// The run's mode.
    pub mode: Mode,
    /// The run's iceoryx2 domain.
    pub domain: DomainName,
    /// The launcher's process id.
    pub launcher: u32,
    /// Wall time when the run was launched, ns since 1970; 0 if the launcher did not say.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub launched_wall_ns: u64,
    /// Ticks between checkpoints; 0: only at the end, and when one is requested.
    #[serde(default)]
    pub checkpoint_every: u64,
    /// Number of checkpoints of each process that are kept, the newest ones; 0: all.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub keep_checkpoints: u64,
    /// In lockstep: whether to write the real instants of each tick into the run's folder, for `tectum bench`.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub stopwatch: bool,
    /// The checkpoint from which this run resumes another one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub resumed: Option<ResumePoint>,
    /// The learner's state with which this run begins: what another run has learned.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub started_from: Option<StartPoint>,
    /// Whether the learner is frozen: it neither learns nor explores.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub frozen: bool,
    /// The scenario's file, as the user named it, for messages.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub source: String,
    /// The folder of the scenario's file: its paths begin there.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub scenario_folder: Option<PathBuf>,
    /// The facts that programs in other languages need.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub wire: Option<WireManifest>,
}

#[allow(clippy::trivially_copy_pass_by_ref)] // as serde calls it
fn is_zero(number: &u64) -> bool {
    *number == 0
}

/// A run's id from a manifest.
fn run_id_text<'de, D: serde::Deserializer<'de>>(deserializer: D) -> Result<String, D::Error> {
    let text = String::deserialize(deserializer)?;
    if text.len() == 16 && text.bytes().all(|b| b.is_ascii_hexdigit()) {
        Ok(text)
    } else {
        Err(serde::de::Error::custom(format!("\"{text}\" is not the id of a run, which has 16 hexadecimal digits")))
    }
}

/// The point at which a run resumes another one.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct ResumePoint {
    /// The other run's folder, with the checkpoints.
    pub from: PathBuf,
    /// The first tick.
    pub tick: u64,
    /// Sequence numbers of the next observation, and of the next command and learning record.
    pub sequences: [u64; 2],
    /// Hash of the other run's scenario, hexadecimal. That of this run has another number of ticks if it goes on beyond
    /// the other's end.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub scenario: Option<String>,
}

/// The learner's state with which a run begins. The run's folder has a copy of it
/// ([`RunManifest::start_path`]).
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct StartPoint {
    /// The other run's folder, or its checkpoint, as the user named it.
    pub source: String,
    /// The tick at which it was learned.
    pub tick: u64,
    /// The checkpoint's checksum, hexadecimal.
    pub check: String,
}

impl RunManifest {
    /// The manifest's file in a run's folder.
    pub fn path(folder: &Path) -> PathBuf {
        folder.join("run.json")
    }

    /// The file of the run's scenario, with every default filled in.
    pub fn scenario_path(folder: &Path) -> PathBuf {
        folder.join("scenario.toml")
    }

    /// The copy of the checkpoint whose learner the run begins with.
    pub fn start_path(folder: &Path) -> PathBuf {
        folder.join("start.controller.safetensors")
    }

    /// The file of the run's log.
    pub fn log_path(folder: &Path) -> PathBuf {
        folder.join(crate::log::LOG_FILE)
    }

    /// Finds the run called `run` (a folder, or a name under `runs/`): its folder, its manifest, and its
    /// launcher.
    pub(super) fn find(run: &Path) -> Result<(PathBuf, Self, ProcessHandle), RuntimeError> {
        let folder = run_folder::find(run, |folder| Self::path(folder).exists());
        let none = |cause: String| RuntimeError::NoRun { path: folder.display().to_string(), cause };
        let text = std::fs::read_to_string(Self::path(&folder)).map_err(|e| match e.kind() {
            std::io::ErrorKind::PermissionDenied => RuntimeError::OtherUser { path: folder.display().to_string() },
            _ => none(e.to_string()),
        })?;
        let manifest: Self = serde_json::from_str(&text).map_err(|e| none(e.to_string()))?;
        let launcher = ProcessHandle::of(manifest.launcher).ok_or_else(|| none("the run is over".to_owned()))?;
        Ok((folder, manifest, launcher))
    }

    /// The run's id as a number.
    pub fn run_id(&self) -> u64 {
        u64::from_str_radix(&self.run, 16).unwrap_or(0)
    }
}

/// A process that has found its run and has a role in it.
#[derive(Debug)]
pub struct Participant {
    /// The run's folder.
    pub folder: PathBuf,
    /// The run's manifest.
    pub manifest: RunManifest,
    /// The run's scenario.
    pub plan: Plan,
    /// The process's role.
    pub role: Role,
    signals: TerminationSignals,
    launcher: ProcessHandle,
}

impl Participant {
    /// Finds the run called `run` (a folder, or a name under `runs/`) and takes `role` in it. With `scenario`,
    /// the process reads that file instead of the run's own copy, and the handshake checks that it is the same.
    ///
    /// # Errors
    /// [`RuntimeError::NoRun`] when there is no such run or it is over, [`RuntimeError::Scenario`] for a bad
    /// scenario.
    pub fn take(run: &Path, role: Role, scenario: Option<&Path>) -> Result<Self, RuntimeError> {
        let signals = TerminationSignals::install().map_err(RuntimeError::Signals)?;
        let (folder, manifest, launcher) = RunManifest::find(run)?;
        let own = RunManifest::scenario_path(&folder);
        let plan = Scenario::load(scenario.unwrap_or(&own))?.plan()?;
        let plan = plan.with_origin(&manifest.source, manifest.scenario_folder.as_deref());
        Ok(Self { folder, manifest, plan, role, signals, launcher })
    }

    /// The identity that the handshake compares.
    pub fn identity(&self) -> Identity {
        identity(&self.plan)
    }

    /// Opens the process's ports with `open`, one of the `open` functions of [`crate::channel`]'s ports.
    ///
    /// # Errors
    /// As for that function.
    pub fn open<P>(
        &self,
        open: impl FnOnce(&DomainName, &Identity, &ChannelNames) -> Result<(P, StatusBoard), ChannelError>,
    ) -> Result<(P, StatusBoard), RuntimeError> {
        Ok(open(&self.manifest.domain, &self.identity(), &self.plan.scenario.channels)?)
    }

    /// Whether the process must end before it has begun, for one that waits for more than its peers in the run.
    ///
    /// # Errors
    /// When the launcher has ended the run or is gone, or a signal came.
    pub fn check_set_up(&self, status_board: &StatusBoard) -> Result<(), RuntimeError> {
        match self.signals.received() {
            0 if status_board.control.get().phase() >= Phase::Stop => Err(RuntimeError::Aborted),
            0 if self.launcher.ended() => Err(RuntimeError::Orphaned(self.role.name())),
            0 => Ok(()),
            number => Err(RuntimeError::Signal(number)),
        }
    }

    /// The process's crash store, for a state of `size` bytes and the last `entries[0]` journal entries of
    /// `entries[1]` bytes each.
    ///
    /// # Errors
    /// When shared memory has no room for it.
    pub(super) fn crash_store(&self, size: usize, entries: [usize; 2]) -> Result<CrashStore, RuntimeError> {
        let capacity = size + GROWTH;
        Ok(CrashStore::open(&self.manifest.domain, self.role, self.manifest.run_id(), capacity, entries)?)
    }

    /// Restores `part` from the checkpoint from which the run resumes. Returns false if the run resumes none.
    ///
    /// # Errors
    /// When the checkpoint cannot be read or is not this process's.
    pub(super) fn resume(&self, part: &mut dyn Persist) -> Result<bool, RuntimeError> {
        let Some(resumed) = &self.manifest.resumed else { return Ok(false) };
        let checkpoint = Checkpoint::read(&checkpoint::path(&resumed.from, resumed.tick, self.role))?;
        let scenario = resumed.scenario.as_ref().and_then(|hash| u64::from_str_radix(hash, 16).ok());
        checkpoint.fits(self.role, scenario.unwrap_or(self.plan.hash))?;
        checkpoint.restore(part)?;
        Ok(true)
    }

    /// The checkpoint whose learner the run begins with, if it begins with one.
    ///
    /// # Errors
    /// When it cannot be read.
    pub(super) fn start(&self) -> Result<Option<Checkpoint>, RuntimeError> {
        let begins = self.manifest.started_from.is_some();
        Ok(begins.then(|| Checkpoint::read(&RunManifest::start_path(&self.folder))).transpose()?)
    }

    /// Refuses to go on without what the process's predecessor remembered, in a run whose result would depend on it.
    ///
    /// # Errors
    /// [`RuntimeError::Forgotten`] in lockstep.
    pub(super) fn refuse_without_memory(&self) -> Result<(), RuntimeError> {
        if self.manifest.mode == Mode::Realtime { Ok(()) } else { Err(RuntimeError::Forgotten(self.role.name())) }
    }

    /// The facts of a checkpoint of this process, whose next sample has the number `sequence`.
    pub(super) fn facts(&self, tick: u64, sequence: u64) -> CheckpointFacts {
        let mut facts = CheckpointFacts::new(self.role, self.manifest.run_id(), tick, sequence, self.plan.hash);
        facts.scenario_text = (self.role == Role::Controller).then(|| self.plan.scenario.to_toml());
        facts
    }

    /// Starts the writer of this process's checkpoints.
    ///
    /// # Errors
    /// When its thread cannot be started.
    pub(super) fn checkpoint_writer(&self) -> Result<CheckpointWriter, RuntimeError> {
        CheckpointWriter::new(&self.folder, self.role, self.manifest.keep_checkpoints).map_err(RuntimeError::Thread)
    }

    /// In real time, requests the scenario's settings from the operating system. Then goes through the phases
    /// ready and connected, and returns the time source with which the ticks begin. `connected` is called until
    /// it returns true: every port has its peers. A restarted process calls it once, because its peers may be
    /// restarting themselves; every port connects to peers that join later on its own.
    ///
    /// # Errors
    /// When the run ends before it begins, or a port fails. A setting that the operating system refuses is no
    /// error; it is in the process's [`RealtimeReport`].
    pub fn begin(
        self,
        status_board: StatusBoard,
        mut connected: impl FnMut() -> Result<bool, ChannelError>,
    ) -> Result<(Session, TimeSource), RuntimeError> {
        // Ports and learner exist, and no peer waits yet. Peers find the report once this process is connected.
        if self.manifest.mode == Mode::Realtime {
            let table = format!("realtime.{}", self.role.name());
            let report = RealtimeReport::request(realtime_request(self.plan.scenario.realtime.of(self.role)), &table);
            super::reports::write_realtime(&self.folder, self.role, &report)?;
        }
        let identity = self.identity();
        let build = identity.build_hash();
        let Identity { schema, scenario, .. } = identity;
        let status = Status {
            pid: std::process::id(),
            schema,
            scenario,
            build,
            loss: f32::NAN,
            end_error: f32::NAN,
            ..Status::default()
        };
        let mut session = Session {
            participant: self,
            status_board,
            status,
            heartbeat: Cell::new(0),
            first_ticks: Cell::new(FIRST_TICKS),
            coarse_ns: Cell::new(0),
        };
        session.enter(ProcessState::Ready);
        session.await_phase(Phase::Connect)?;
        while !connected()? && session.incarnation() == 0 {
            session.check()?;
            pause(SET_UP_POLL_NS);
        }
        session.enter(ProcessState::Connected);
        session.await_phase(Phase::Run)?;
        super::reports::reserve_space(&session.participant.folder, session.participant.role);
        session.enter(ProcessState::Running);
        let period = session.participant.plan.period_ns;
        let time = match session.participant.manifest.mode {
            Mode::Realtime => TimeSource::real(session.status_board.control.get().t0_ns, period),
            Mode::Lockstep | Mode::InProcess => TimeSource::stepped(period),
        };
        Ok((session, time))
    }
}

/// The identity that the handshake compares, for a run of `plan` by this build.
pub fn identity(plan: &Plan) -> Identity {
    Identity { schema: schema_hash(), scenario: plan.hash, build: crate::BUILD.to_owned() }
}

/// The scenario's settings of a process as a request to the operating system.
fn realtime_request(process: &RealtimeProcess) -> RealtimeRequest {
    RealtimeRequest {
        priority: process.priority,
        cores: process.cores.clone(),
        lock_memory: process.lock_memory,
        prefault_stack_kib: process.prefault_stack_kib,
        ..RealtimeRequest::default()
    }
}

/// The number of bytes by which a process's state may grow during the run: mainly the windows of the
/// statistics.
const GROWTH: usize = 64 << 10;

/// Lockstep: so many of a process's first ticks are shown on its board one by one. Whether it has sent anything yet
/// decides how a successor goes on.
const FIRST_TICKS: u32 = 16;

/// Interval at which the phase is polled while a run is set up, ns.
const SET_UP_POLL_NS: u64 = 500_000;

/// The reason for which a loop should end before its last tick.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum EndReason {
    /// The run ends in good order: the plant after its current tick, the others after their last sample.
    Stop,
    /// The run ends at once.
    Abort,
    /// This process received a termination signal.
    Signal(u32),
    /// The launcher has ended.
    Orphaned,
}

/// A process in a run that has begun.
pub struct Session {
    /// The process's role and run.
    pub participant: Participant,
    /// The process's status. [`Session::publish_status`] puts it on the board.
    pub status: Status,
    status_board: StatusBoard,
    /// Number of heartbeats so far.
    heartbeat: Cell<u64>,
    /// Lockstep: how many of the first ticks are still to be shown, and the coarse clock when it was last read.
    first_ticks: Cell<u32>,
    coarse_ns: Cell<u64>,
}

impl Session {
    /// The process's start number within the run, from 0.
    pub fn incarnation(&self) -> u32 {
        self.status_board.incarnation
    }

    /// The start number of the process that has, or will have, `role`.
    #[inline]
    pub fn incarnation_of(&self, role: Role) -> u32 {
        self.status_board.control.get().incarnations[role as usize]
    }

    /// Whether the process in `role` has ended without finishing and will not return: nobody waits for it.
    #[inline]
    pub fn is_gone(&self, role: Role) -> bool {
        self.status_board.control.get().is_gone(role)
    }

    /// Publishes a heartbeat, and returns whether, and why, the loop should end.
    pub fn end_reason(&self) -> Option<EndReason> {
        self.publish_status();
        if self.participant.signals.received() != 0 {
            return Some(EndReason::Signal(self.participant.signals.received()));
        }
        match self.status_board.control.get().phase() {
            Phase::Abort => Some(EndReason::Abort),
            // A launcher that was killed cannot set a phase.
            _ if self.participant.launcher.ended() => Some(EndReason::Orphaned),
            Phase::Stop => Some(EndReason::Stop),
            _ => None,
        }
    }

    /// Whether the run is ending. It is the cheap part of [`Session::end_reason`], for every tick: it checks
    /// signals and the board without a system call.
    #[inline]
    pub fn stopping(&self) -> bool {
        self.participant.signals.received() != 0 || self.status_board.control.get().phase() >= Phase::Stop
    }

    /// Number of checkpoints requested so far.
    #[inline]
    pub(crate) fn checkpoints_requested(&self) -> u32 {
        self.status_board.control.get().checkpoints
    }

    /// Whether the process received a termination signal. It is cheap enough for every tick.
    #[inline]
    pub(crate) fn interrupted(&self) -> bool {
        self.participant.signals.received() != 0
    }

    /// Whether the loop must end at once, without waiting for its peers.
    pub(crate) fn must_end(&self) -> bool {
        matches!(self.end_reason(), Some(EndReason::Abort | EndReason::Signal(_) | EndReason::Orphaned))
    }

    /// Publishes the status after a tick. Returns whether the launcher's board is to be read in this tick, too.
    ///
    /// In real time both is done in every tick. In lockstep it is done every few milliseconds, when the kernel's coarse
    /// clock has moved: a board that a process on another core has read costs a tick two transfers between the cores,
    /// which take longer than the plant's step. Whoever waits publishes by [`Session::end_reason`] meanwhile.
    #[inline]
    pub(crate) fn publish_progress(&self) -> bool {
        let due = self.participant.manifest.mode == Mode::Realtime || self.first_ticks.get() > 0 || {
            let now = coarse_ns();
            self.coarse_ns.replace(now) != now
        };
        if due {
            self.first_ticks.set(self.first_ticks.get().saturating_sub(1));
            self.publish_status();
        }
        due
    }

    /// Publishes the status and a heartbeat on the board.
    #[inline]
    pub fn publish_status(&self) {
        self.heartbeat.set(self.heartbeat.get() + 1);
        self.status_board.status.put(Status { beat: self.heartbeat.get(), ..self.status });
    }

    /// Enters a state and publishes it.
    pub fn enter(&mut self, state: ProcessState) {
        self.status.state = state as u32;
        self.publish_status();
    }

    /// An end other than the planned end of the run, as an error.
    ///
    /// # Errors
    /// When the loop must end at once.
    pub fn check(&self) -> Result<(), RuntimeError> {
        match self.end_reason() {
            Some(EndReason::Abort) => Err(RuntimeError::Aborted),
            Some(EndReason::Signal(number)) => Err(RuntimeError::Signal(number)),
            Some(EndReason::Orphaned) => Err(RuntimeError::Orphaned(self.participant.role.name())),
            Some(EndReason::Stop) | None => Ok(()),
        }
    }

    /// Waits until the run has reached `phase`.
    fn await_phase(&self, phase: Phase) -> Result<(), RuntimeError> {
        while self.status_board.control.get().phase() < phase {
            self.check()?;
            pause(SET_UP_POLL_NS);
        }
        self.check()
    }

    /// Leaves the run in good order: writes `report` into the run's folder, then publishes that the process has
    /// finished.
    ///
    /// # Errors
    /// When the report cannot be written.
    pub fn finish<T: Serialize>(&mut self, report: &T) -> Result<(), RuntimeError> {
        super::reports::write(&self.participant.folder, self.participant.role, report)?;
        self.enter(ProcessState::Finished);
        Ok(())
    }
}

impl Drop for Session {
    fn drop(&mut self) {
        if self.status.state() != ProcessState::Finished {
            self.enter(ProcessState::Failed);
        }
    }
}
