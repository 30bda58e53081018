//! A process's place in a run: finding the run, proving that it fits, and going through the phases together.
//!
//! The launcher leaves a card in the run's folder. A process takes its seat with it: it reads the run's scenario, opens
//! the run's channels (which checks schema, scenario and build), and then follows the launcher's board: ports made,
//! ports connected, go. Nobody sends a first sample before everybody is connected.

use std::cell::Cell;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::{Foreign, RuntimeError};
use crate::channel::{ChannelError, Desk, DomainName, Identity, Vault};
use crate::checkpoint::{self, Checkpoint, Facts, Writer};
use crate::clock::{Life, RealtimeReport, Signals, TimeSource, pause};
use crate::scenario::{ChannelsTable, Plan, Scenario};
use crate::state::Remember;
use crate::wire::{Phase, Role, State, Status, schema_hash};

/// How ticks follow each other.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Mode {
    /// As fast as the processes go; nothing is missed and nothing is lost.
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
pub struct Card {
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
    /// In lockstep: leave the real instants of each tick in the run's folder ([`laps`](super::laps)).
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub stopwatch: bool,
    /// The run that this one goes on with.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub resumed: Option<Resumed>,
    /// For programs that are not this library's.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub wire: Option<Foreign>,
}

/// Where a run that goes on with another one begins.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Resumed {
    /// The other run's folder, with the checkpoints.
    pub from: PathBuf,
    /// The tick that begins.
    pub tick: u64,
    /// Sequence numbers of the next observation, and of the next command and learning record.
    pub sequences: [u64; 2],
}

impl Card {
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
    pub(super) fn find(run: &Path) -> Result<(PathBuf, Self, Life), RuntimeError> {
        let named = Path::new("runs").join(run);
        let folder = if !Self::path(run).exists() && Self::path(&named).exists() { named } else { run.to_owned() };
        let none = |cause: String| RuntimeError::NoRun { path: folder.display().to_string(), cause };
        let text = std::fs::read_to_string(Self::path(&folder)).map_err(|e| none(e.to_string()))?;
        let card: Self = serde_json::from_str(&text).map_err(|e| none(e.to_string()))?;
        let launcher = Life::of(card.launcher).ok_or_else(|| none("the run is over".to_owned()))?;
        Ok((folder, card, launcher))
    }

    /// The run's id as a number.
    pub fn run_id(&self) -> u64 {
        u64::from_str_radix(&self.run, 16).unwrap_or(0)
    }
}

/// A process's place in a run.
#[derive(Debug)]
pub struct Seat {
    /// The run's folder.
    pub folder: PathBuf,
    /// The run's card.
    pub card: Card,
    /// The run's scenario.
    pub plan: Plan,
    /// Which part of the run the process is.
    pub role: Role,
    signals: Signals,
    launcher: Life,
}

impl Seat {
    /// Finds the run called `run` (a folder, or a name under `runs/`) and takes the place of `role` in it. With
    /// `scenario`, the process reads that file instead of the run's own copy, and the handshake says whether it fits.
    ///
    /// # Errors
    /// [`RuntimeError::NoRun`] when there is no such run or it is over, [`RuntimeError::Scenario`] for a bad scenario.
    pub fn take(run: &Path, role: Role, scenario: Option<&Path>) -> Result<Self, RuntimeError> {
        let signals = Signals::install().map_err(RuntimeError::Signals)?;
        let (folder, card, launcher) = Card::find(run)?;
        let own = Card::scenario_path(&folder);
        let plan = Scenario::load(scenario.unwrap_or(&own))?.plan()?;
        Ok(Self { folder, card, plan, role, signals, launcher })
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
        open: impl FnOnce(&DomainName, &Identity, &ChannelsTable) -> Result<(P, Desk), ChannelError>,
    ) -> Result<(P, Desk), RuntimeError> {
        Ok(open(&self.card.domain, &self.identity(), &self.plan.scenario.channels)?)
    }

    /// The process's vault, for a state of `size` bytes and the last so many entries of so many bytes each.
    ///
    /// # Errors
    /// When shared memory has no room for it.
    pub(super) fn vault(&self, size: usize, entries: [usize; 2]) -> Result<Vault, RuntimeError> {
        let room = size + GROWTH;
        Ok(Vault::open(&self.card.domain, self.role, self.card.run_id(), room, entries)?)
    }

    /// Gives `part` the state of the checkpoint that the run begins with. False if it begins with none.
    ///
    /// # Errors
    /// When the checkpoint cannot be read or is not this process's.
    pub(super) fn resume(&self, part: &mut dyn Remember) -> Result<bool, RuntimeError> {
        let Some(resumed) = &self.card.resumed else { return Ok(false) };
        let checkpoint = Checkpoint::read(&checkpoint::path(&resumed.from, resumed.tick, self.role))?;
        checkpoint.fits(self.role, self.plan.hash)?;
        checkpoint.restore(part)?;
        Ok(true)
    }

    /// The facts of a checkpoint of this process, which sends `sequence` next.
    pub(super) fn facts(&self, tick: u64, sequence: u64) -> Facts {
        Facts::new(self.role, self.card.run_id(), tick, sequence, self.plan.hash)
    }

    /// What writes this process's checkpoints.
    ///
    /// # Errors
    /// When there can be no more threads.
    pub(super) fn writer(&self) -> Result<Writer, RuntimeError> {
        Writer::new(&self.folder, self.role).map_err(RuntimeError::Thread)
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
        desk: Desk,
        mut connected: impl FnMut() -> Result<bool, ChannelError>,
    ) -> Result<(Session, TimeSource), RuntimeError> {
        // Ports and learner are there, and no peer waits yet. Whoever is connected has left its account of this.
        if self.card.mode == Mode::Realtime {
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
        let mut session = Session { seat: self, desk, status, beat: Cell::new(0) };
        session.enter(State::Ready);
        session.await_phase(Phase::Connect)?;
        while !connected()? && session.incarnation() == 0 {
            session.check()?;
            pause(SET_UP_PACE_NS);
        }
        session.enter(State::Connected);
        session.await_phase(Phase::Run)?;
        super::reports::keep_room(&session.seat.folder, session.seat.role);
        session.enter(State::Running);
        let period = session.seat.plan.period_ns;
        let time = match session.seat.card.mode {
            Mode::Realtime => TimeSource::real(session.desk.control.get().t0_ns, period),
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
pub enum End {
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
    pub seat: Seat,
    /// What it shows on its board; [`Session::show`] puts it there.
    pub status: Status,
    desk: Desk,
    /// Signs of life given so far.
    beat: Cell<u64>,
}

impl Session {
    /// The process's start number within the run, from 0.
    pub fn incarnation(&self) -> u32 {
        self.desk.incarnation
    }

    /// The start number of the process that has, or will have, the place of `role`.
    #[inline]
    pub fn incarnation_of(&self, role: Role) -> u32 {
        self.desk.control.get().incarnations[role as usize]
    }

    /// Shows a sign of life, and says whether, and why, the loop should end.
    pub fn end(&self) -> Option<End> {
        self.show();
        if self.seat.signals.received() != 0 {
            return Some(End::Signal(self.seat.signals.received()));
        }
        match self.desk.control.get().phase() {
            Phase::Abort => Some(End::Abort),
            // A launcher that was killed cannot say so.
            _ if self.seat.launcher.ended() => Some(End::Orphaned),
            Phase::Stop => Some(End::Stop),
            _ => None,
        }
    }

    /// The cheap part of [`Session::end`], for every tick: signals and the board, no system call.
    #[inline]
    pub fn stopping(&self) -> bool {
        self.seat.signals.received() != 0 || self.desk.control.get().phase() >= Phase::Stop
    }

    /// Checkpoints that were asked for so far.
    #[inline]
    pub fn checkpoints_asked(&self) -> u32 {
        self.desk.control.get().checkpoints
    }

    /// Whether a signal asked the process to end: cheap enough for every tick.
    #[inline]
    pub fn interrupted(&self) -> bool {
        self.seat.signals.received() != 0
    }

    /// Whether the loop must end at once, its peers being beyond waiting for.
    pub fn must_end(&self) -> bool {
        matches!(self.end(), Some(End::Abort | End::Signal(_) | End::Orphaned))
    }

    /// Puts the status on the board.
    #[inline]
    pub fn show(&self) {
        self.beat.set(self.beat.get() + 1);
        self.desk.status.put(Status { beat: self.beat.get(), ..self.status });
    }

    /// Enters a state and shows it.
    pub fn enter(&mut self, state: State) {
        self.status.state = state as u32;
        self.show();
    }

    /// An end that is not the run's planned one, as an error.
    ///
    /// # Errors
    /// When the loop must end at once.
    pub fn check(&self) -> Result<(), RuntimeError> {
        match self.end() {
            Some(End::Abort) => Err(RuntimeError::Aborted),
            Some(End::Signal(number)) => Err(RuntimeError::Signal(number)),
            Some(End::Orphaned) => Err(RuntimeError::Orphaned(self.seat.role.name())),
            Some(End::Stop) | None => Ok(()),
        }
    }

    fn await_phase(&self, phase: Phase) -> Result<(), RuntimeError> {
        while self.desk.control.get().phase() < phase {
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
        super::reports::write(&self.seat.folder, self.seat.role, report)?;
        self.enter(State::Finished);
        Ok(())
    }
}

impl Drop for Session {
    fn drop(&mut self) {
        if self.status.state() != State::Finished {
            self.enter(State::Failed);
        }
    }
}
