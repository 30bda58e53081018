//! A process's place in a run: finding the run, proving that it fits, and going through the phases together.
//!
//! The launcher leaves a card in the run's folder. A process takes its seat with it: it reads the run's scenario, opens
//! the run's channels (which checks schema, scenario and build), and then follows the launcher's board: ports made,
//! ports connected, go. Nobody sends a first sample before everybody is connected.

use std::cell::Cell;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::{RuntimeError, WireManifest};
use crate::channel::{ChannelError, CrashStore, DomainName, Identity, StatusBoard};
use crate::checkpoint::{self, Checkpoint, CheckpointFacts, CheckpointWriter};
use crate::clock::{ProcessHandle, RealtimeReport, TerminationSignals, TimeSource, pause};
use crate::scenario::{ChannelsConfig, Plan, Scenario};
use crate::state::Persist;
use crate::wire::{Phase, ProcessState, Role, Status, schema_hash};

/// How ticks follow each other.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Mode {
    /// As fast as the processes go; nothing is missed and nothing is lost.
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

/// What the launcher leaves in the run's folder for those who join.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct RunManifest {
    /// The run's id, hexadecimal.
    pub run: String,
    /// How ticks follow each other.
    pub mode: Mode,
    /// The run's domain.
    pub domain: DomainName,
    /// The launcher's process id.
    pub launcher: u32,
    /// A checkpoint every so many ticks; 0: only at the end, and when one is asked for.
    #[serde(default)]
    pub checkpoint_every: u64,
    /// In lockstep: leave the real instants of each tick in the run's folder ([`tick_times`](super::tick_times)).
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub stopwatch: bool,
    /// The run that this one goes on with.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub resumed: Option<ResumePoint>,
    /// For programs that are not this library's.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub wire: Option<WireManifest>,
}

/// Where a run that goes on with another one begins.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct ResumePoint {
    /// The other run's folder, with the checkpoints.
    pub from: PathBuf,
    /// The tick that begins.
    pub tick: u64,
    /// Sequence numbers of the next observation, and of the next command and learning record.
    pub sequences: [u64; 2],
}

impl RunManifest {
    /// The card's file in a run's folder.
    pub fn path(folder: &Path) -> PathBuf {
        folder.join("run.json")
    }

    /// The run's scenario, every default filled in.
    pub fn scenario_path(folder: &Path) -> PathBuf {
        folder.join("scenario.toml")
    }

    /// The run's log.
    pub fn log_path(folder: &Path) -> PathBuf {
        folder.join(crate::log::LOG_FILE)
    }

    /// Finds the run called `run` (a folder, or a name under `runs/`): its folder, its card, and the launcher's life.
    pub(super) fn find(run: &Path) -> Result<(PathBuf, Self, ProcessHandle), RuntimeError> {
        let named = Path::new("runs").join(run);
        let folder = if !Self::path(run).exists() && Self::path(&named).exists() { named } else { run.to_owned() };
        let none = |cause: String| RuntimeError::NoRun { path: folder.display().to_string(), cause };
        let text = std::fs::read_to_string(Self::path(&folder)).map_err(|e| none(e.to_string()))?;
        let manifest: Self = serde_json::from_str(&text).map_err(|e| none(e.to_string()))?;
        let launcher = ProcessHandle::of(manifest.launcher).ok_or_else(|| none("the run is over".to_owned()))?;
        Ok((folder, manifest, launcher))
    }

    /// The run's id as a number.
    pub fn run_id(&self) -> u64 {
        u64::from_str_radix(&self.run, 16).unwrap_or(0)
    }
}

/// A process's place in a run.
#[derive(Debug)]
pub struct Participant {
    /// The run's folder.
    pub folder: PathBuf,
    /// The run's card.
    pub manifest: RunManifest,
    /// The run's scenario.
    pub plan: Plan,
    /// Which part of the run the process is.
    pub role: Role,
    signals: TerminationSignals,
    launcher: ProcessHandle,
}

impl Participant {
    /// Finds the run called `run` (a folder, or a name under `runs/`) and takes the place of `role` in it. With
    /// `scenario`, the process reads that file instead of the run's own copy, and the handshake says whether it fits.
    ///
    /// # Errors
    /// [`RuntimeError::NoRun`] when there is no such run or it is over, [`RuntimeError::Scenario`] for a bad scenario.
    pub fn take(run: &Path, role: Role, scenario: Option<&Path>) -> Result<Self, RuntimeError> {
        let signals = TerminationSignals::install().map_err(RuntimeError::Signals)?;
        let (folder, manifest, launcher) = RunManifest::find(run)?;
        let own = RunManifest::scenario_path(&folder);
        let plan = Scenario::load(scenario.unwrap_or(&own))?.plan()?;
        Ok(Self { folder, manifest, plan, role, signals, launcher })
    }

    /// What the handshake compares.
    pub fn identity(&self) -> Identity {
        identity(&self.plan)
    }

    /// Opens the process's ports with `open`, one of the `open` functions of [`crate::channel`]'s ports.
    ///
    /// # Errors
    /// As for those.
    pub fn open<P>(
        &self,
        open: impl FnOnce(&DomainName, &Identity, &ChannelsConfig) -> Result<(P, StatusBoard), ChannelError>,
    ) -> Result<(P, StatusBoard), RuntimeError> {
        Ok(open(&self.manifest.domain, &self.identity(), &self.plan.scenario.channels)?)
    }

    /// The process's vault, for a state of `size` bytes and the last so many entries of so many bytes each.
    ///
    /// # Errors
    /// When shared memory has no room for it.
    pub(super) fn crash_store(&self, size: usize, entries: [usize; 2]) -> Result<CrashStore, RuntimeError> {
        let room = size + GROWTH;
        Ok(CrashStore::open(&self.manifest.domain, self.role, self.manifest.run_id(), room, entries)?)
    }

    /// Gives `part` the state of the checkpoint that the run begins with. False if it begins with none.
    ///
    /// # Errors
    /// When the checkpoint cannot be read or is not this process's.
    pub(super) fn resume(&self, part: &mut dyn Persist) -> Result<bool, RuntimeError> {
        let Some(resumed) = &self.manifest.resumed else { return Ok(false) };
        let checkpoint = Checkpoint::read(&checkpoint::path(&resumed.from, resumed.tick, self.role))?;
        checkpoint.fits(self.role, self.plan.hash)?;
        checkpoint.restore(part)?;
        Ok(true)
    }

    /// The facts of a checkpoint of this process, which sends `sequence` next.
    pub(super) fn facts(&self, tick: u64, sequence: u64) -> CheckpointFacts {
        CheckpointFacts::new(self.role, self.manifest.run_id(), tick, sequence, self.plan.hash)
    }

    /// What writes this process's checkpoints.
    ///
    /// # Errors
    /// When there can be no more threads.
    pub(super) fn writer(&self) -> Result<CheckpointWriter, RuntimeError> {
        CheckpointWriter::new(&self.folder, self.role).map_err(RuntimeError::Thread)
    }

    /// In real time, asks the operating system for what the scenario says. Then goes through the phases: ready, connected,
    /// and then the time source with which the ticks begin. `connected` is asked until it says that every port has its
    /// peers. A process that comes back into a run that goes on asks once: its peers may be away themselves, and every
    /// port connects on its own to those who come.
    ///
    /// # Errors
    /// When the run ends before it begins, or a port fails. What the operating system refuses is none: it is in the
    /// process's [`RealtimeReport`].
    pub fn begin(
        self,
        status_board: StatusBoard,
        mut connected: impl FnMut() -> Result<bool, ChannelError>,
    ) -> Result<(Session, TimeSource), RuntimeError> {
        // Ports and learner are there, and no peer waits yet. Whoever is connected has left its account of this.
        if self.manifest.mode == Mode::Realtime {
            let table = format!("realtime.{}", self.role.name());
            let report = RealtimeReport::request(self.plan.scenario.realtime.of(self.role), &table);
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
        let mut session = Session { participant: self, status_board, status, beat: Cell::new(0) };
        session.enter(ProcessState::Ready);
        session.await_phase(Phase::Connect)?;
        while !connected()? && session.incarnation() == 0 {
            session.check()?;
            pause(SET_UP_PACE_NS);
        }
        session.enter(ProcessState::Connected);
        session.await_phase(Phase::Run)?;
        super::reports::keep_room(&session.participant.folder, session.participant.role);
        session.enter(ProcessState::Running);
        let period = session.participant.plan.period_ns;
        let time = match session.participant.manifest.mode {
            Mode::Realtime => TimeSource::real(session.status_board.control.get().t0_ns, period),
            Mode::Lockstep | Mode::InProcess => TimeSource::stepped(period),
        };
        Ok((session, time))
    }
}

/// What the handshake compares, for a run of `plan` by this build.
pub fn identity(plan: &Plan) -> Identity {
    Identity { schema: schema_hash(), scenario: plan.hash, build: crate::BUILD.to_owned() }
}

/// By how much a state may grow while the run goes on: the account's windows, in the main.
const GROWTH: usize = 64 << 10;

/// How often the phases are looked at while a run is set up, ns.
const SET_UP_PACE_NS: u64 = 500_000;

/// Why a loop should end before its last tick.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum EndReason {
    /// The run is to end in good order.
    Stop,
    /// The run ends now.
    Abort,
    /// This process was asked to end by a signal.
    Signal(u32),
    /// The launcher is gone.
    Orphaned,
}

/// A process in a run that has begun.
pub struct Session {
    /// Its place.
    pub participant: Participant,
    /// What it shows on its board; [`Session::show`] puts it there.
    pub status: Status,
    status_board: StatusBoard,
    /// Signs of life given so far.
    beat: Cell<u64>,
}

impl Session {
    /// The process's start number within the run, from 0.
    pub fn incarnation(&self) -> u32 {
        self.status_board.incarnation
    }

    /// The start number of the process that has, or will have, the place of `role`.
    #[inline]
    pub fn incarnation_of(&self, role: Role) -> u32 {
        self.status_board.control.get().incarnations[role as usize]
    }

    /// Shows a sign of life, and says whether, and why, the loop should end.
    pub fn end_reason(&self) -> Option<EndReason> {
        self.publish_status();
        if self.participant.signals.received() != 0 {
            return Some(EndReason::Signal(self.participant.signals.received()));
        }
        match self.status_board.control.get().phase() {
            Phase::Abort => Some(EndReason::Abort),
            // A launcher that was killed cannot say so.
            _ if self.participant.launcher.ended() => Some(EndReason::Orphaned),
            Phase::Stop => Some(EndReason::Stop),
            _ => None,
        }
    }

    /// The cheap part of [`Session::end`], for every tick: signals and the board, no system call.
    #[inline]
    pub fn stopping(&self) -> bool {
        self.participant.signals.received() != 0 || self.status_board.control.get().phase() >= Phase::Stop
    }

    /// Checkpoints that were asked for so far.
    #[inline]
    pub fn checkpoints_asked(&self) -> u32 {
        self.status_board.control.get().checkpoints
    }

    /// Whether a signal asked the process to end: cheap enough for every tick.
    #[inline]
    pub fn interrupted(&self) -> bool {
        self.participant.signals.received() != 0
    }

    /// Whether the loop must end at once, its peers being beyond waiting for.
    pub fn must_end(&self) -> bool {
        matches!(self.end_reason(), Some(EndReason::Abort | EndReason::Signal(_) | EndReason::Orphaned))
    }

    /// Puts the status on the board.
    #[inline]
    pub fn publish_status(&self) {
        self.beat.set(self.beat.get() + 1);
        self.status_board.status.put(Status { beat: self.beat.get(), ..self.status });
    }

    /// Enters a state and shows it.
    pub fn enter(&mut self, state: ProcessState) {
        self.status.state = state as u32;
        self.publish_status();
    }

    /// An end that is not the run's planned one, as an error.
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

    fn await_phase(&self, phase: Phase) -> Result<(), RuntimeError> {
        while self.status_board.control.get().phase() < phase {
            self.check()?;
            pause(SET_UP_PACE_NS);
        }
        self.check()
    }

    /// Leaves the run in good order: `report` goes into the run's folder, then the board says so.
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
