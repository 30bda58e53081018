//! Launching and supervising a run: a folder, a domain, processes, phases, and an orderly end.
//!
//! The launcher creates every service of the run and holds it until all processes have ended; the processes only open
//! them. It leads them through the phases (ports made, connected, go), watches their boards and their lives, and ends
//! the run when it is done, when a signal comes, or when a process fails. Whatever happens, it leaves no process and no
//! shared memory behind.

mod children;
mod error;
mod folder;
mod progress;
mod story;
mod study;
mod summary;

pub use error::LaunchError;
pub(crate) use folder::RunFolder;
pub(crate) use progress::Progress;
pub(crate) use story::reach;
pub use study::study;
pub use summary::{Ended, ProcessRealtime, Span, Summary};

use std::path::{Path, PathBuf};
use std::time::Duration;

use children::Crew;

use crate::channel::{DomainName, Hub, sweep};
use crate::clock::{Refusal, Signals, monotonic_ns, pause, wall_ns};
use crate::process::say;
use crate::runtime::{Card, Mode, identity, read_realtime};
use crate::scenario::Plan;
use crate::wire::{Control, Phase, Role, State};

/// What to run, and how.
#[derive(Debug, Clone)]
pub struct Launch {
    /// The scenario.
    pub plan: Plan,
    /// Lockstep or real time.
    pub mode: Mode,
    /// The folder for the run; without one, `runs/<scenario>-<n>`.
    pub out: Option<PathBuf>,
    /// The run's name, in place of `<scenario>-<n>`.
    pub name: Option<String>,
    /// Processes that somebody else starts.
    pub by_hand: Vec<Role>,
    /// Show a progress line on standard error.
    pub progress: bool,
}

/// How long processes that the launcher starts may take to get ready or to connect.
const SET_UP_LIMIT: Duration = Duration::from_secs(20);
/// Real time: from the last process's being connected to tick 0.
const LEAD_NS: u64 = 100_000_000;
/// After a signal or a failure: how long the processes have to end in good order, and then to end at once. Together they
/// stay below the second that a user waits after Ctrl-C.
const STOP_LIMIT: Duration = Duration::from_millis(600);
const ABORT_LIMIT: Duration = Duration::from_millis(200);
/// After the planned end: how long the last samples may take to reach the disk.
const CLOSE_LIMIT: Duration = Duration::from_secs(60);
/// How often the launcher looks at boards and processes, ns: often enough to end a lockstep run promptly, and in real
/// time, where its processor time is somebody else's latency, four times less often.
const LOOK_NS: u64 = 5_000_000;
const LOOK_REALTIME_NS: u64 = 20_000_000;

/// Runs a scenario with its processes.
///
/// # Errors
/// When the run cannot begin. A run that began always gives a summary, which says how it ended.
pub fn run(launch: &Launch) -> Result<Summary, LaunchError> {
    let signals = Signals::install().map_err(LaunchError::Signals)?;
    let plan = &launch.plan;
    let folder = RunFolder::create(launch.out.as_deref(), launch.name.as_deref(), &plan.scenario.name)?;
    folder.check_room(plan)?;

    // What a launcher that was killed could not take away any more.
    for left in sweep(false) {
        say(&format!("tectum: removed {} from shared memory, which a run that was killed had left", left.domain));
    }
    let run = run_id(plan);
    let domain = DomainName::of(run);
    let hub = Hub::create(&domain, &identity(plan), &plan.scenario.channels)?;
    let card = Card { run: format!("{run:016x}"), mode: launch.mode, domain, launcher: std::process::id() };
    folder.write_card(&card, plan)?;

    let mut control = Control::default();
    hub.control.put(control);
    let crew = Crew::start(plan, folder.path(), &launch.by_hand)?;
    let mut run = Run { hub, crew, control, signals, progress: Progress::new(launch, &folder), ended: None };
    run.set_up(launch)?;
    folder.keep();
    if launch.mode == Mode::Realtime {
        warn_of_refusals(folder.path());
    }

    let began = monotonic_ns();
    if run.ended.is_none() {
        control = run.control;
        control.t0_ns = if launch.mode == Mode::Realtime { began + LEAD_NS } else { 0 };
        run.control = control;
        run.enter(Phase::Run);
        run.supervise(if launch.mode == Mode::Realtime { LOOK_REALTIME_NS } else { LOOK_NS });
    }
    let seconds = run.close(began);
    // The domain goes with the hub, before anything is drawn or printed.
    let Run { hub, crew, ended, .. } = run;
    let failure = crew.failure();
    let boards = Role::ALL.map(|role| hub.status(role));
    drop(hub);
    if let Some(failure) = &failure {
        folder.keep_words(failure);
    }
    Ok(Summary::of_run(launch, folder.path(), &boards, ended.unwrap_or(Ended::Complete), failure, seconds))
}

/// Says what the processes asked of the operating system and were refused. The run goes on without.
fn warn_of_refusals(folder: &Path) {
    for role in Role::ALL {
        for refusal in read_realtime(folder, role).into_iter().flat_map(|report| report.refused) {
            let (name, Refusal { what, why, remedy }) = (role.name(), refusal);
            say(&format!("tectum: warning: the {name} asked for {what} and does not have it ({why}); {remedy}"));
        }
    }
}

/// A run's id: different for every run on this machine, also for two that start at the same instant.
fn run_id(plan: &Plan) -> u64 {
    let mut bytes = [0; 28];
    bytes[..8].copy_from_slice(&wall_ns().to_le_bytes());
    bytes[8..16].copy_from_slice(&monotonic_ns().to_le_bytes());
    bytes[16..20].copy_from_slice(&std::process::id().to_le_bytes());
    bytes[20..].copy_from_slice(&plan.hash.to_le_bytes());
    xxhash_rust::xxh3::xxh3_64(&bytes)
}

/// A run in progress.
struct Run {
    hub: Hub,
    crew: Crew,
    control: Control,
    signals: Signals,
    progress: Progress,
    /// Why the run ends before its last tick, if it does.
    ended: Option<Ended>,
}

impl Run {
    fn enter(&mut self, phase: Phase) {
        self.control.phase = phase as u32;
        self.hub.control.put(self.control);
    }

    fn state(&self, role: Role) -> State {
        self.hub.status(role).state()
    }

    /// Leads the processes through set-up.
    fn set_up(&mut self, launch: &Launch) -> Result<(), LaunchError> {
        for (state, next) in [(State::Ready, Phase::Connect), (State::Connected, Phase::Run)] {
            let began = monotonic_ns();
            while Role::ALL.iter().any(|&role| self.state(role) < state) {
                if self.look() {
                    return match self.crew.failure() {
                        // Nothing has begun yet, so nothing is left.
                        Some(failure) => Err(LaunchError::Refused { code: failure.code, message: failure.message }),
                        None => Ok(()),
                    };
                }
                let waited = Duration::from_nanos(monotonic_ns() - began);
                if launch.by_hand.is_empty() && waited > SET_UP_LIMIT {
                    let late = Role::ALL.into_iter().find(|&role| self.state(role) < state).map_or("", Role::name);
                    return Err(LaunchError::NotReady { role: late, seconds: waited.as_secs() });
                }
                pause(LOOK_NS / 10);
            }
            if next == Phase::Connect {
                self.enter(next);
            }
        }
        Ok(())
    }

    /// Looks at signals and processes. True when the run is to end early.
    fn look(&mut self) -> bool {
        self.crew.reap(&self.hub);
        if self.ended.is_none() {
            if self.signals.received() != 0 {
                self.ended = Some(Ended::Signal(self.signals.received()));
            } else if self.crew.failed() {
                self.ended = Some(Ended::Failed);
            }
        }
        self.ended.is_some()
    }

    /// Watches the run until its processes have finished or it is to end early.
    fn supervise(&mut self, look_ns: u64) {
        while Role::ALL.iter().any(|&role| self.state(role) < State::Finished) {
            if self.look() {
                return;
            }
            self.progress.show(&self.hub);
            pause(look_ns);
        }
    }

    /// Ends the run and waits for the processes. Gives the seconds that the ticks took.
    fn close(&mut self, began: u64) -> f64 {
        if self.ended.is_some() {
            self.enter(if self.control.phase() >= Phase::Run { Phase::Stop } else { Phase::Abort });
            self.await_end(STOP_LIMIT);
        }
        let seconds = (monotonic_ns() - began) as f64 / 1e9;
        if self.ended.is_none() && !self.await_end(CLOSE_LIMIT) {
            self.ended = Some(Ended::Failed);
        }
        self.enter(Phase::Abort);
        if !self.await_end(ABORT_LIMIT) {
            self.crew.kill();
        }
        self.crew.reap(&self.hub);
        self.progress.clear();
        seconds
    }

    /// Waits until all processes have ended. False when `limit` passes first.
    fn await_end(&mut self, limit: Duration) -> bool {
        let began = monotonic_ns();
        loop {
            self.crew.reap(&self.hub);
            if self.crew.gone() {
                return true;
            }
            if Duration::from_nanos(monotonic_ns() - began) > limit {
                return false;
            }
            pause(LOOK_NS / 5);
        }
    }
}
