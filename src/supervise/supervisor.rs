//! A run in progress, as its launcher sees it: phases, signals, deaths, silences, returns, and the end.

use std::time::Duration;

use super::children::{ChildProcesses, ProcessFailure};
use super::fault_injector::ProcessFaultInjector;
use super::restarts::{RestartIncident, RestartTracker};
use super::{Launch, LaunchError, RunOutcome, RunProgress};
use crate::channel::{DomainName, RunServices, reclaim_dead};
use crate::clock::{TerminationSignals, monotonic_ns, pause};
use crate::process::say;
use crate::runtime::{Mode, exit};
use crate::wire::{Control, Phase, ProcessState, Role, Status};

/// How long processes that the launcher starts may take to get ready or to connect.
const SET_UP_LIMIT: Duration = Duration::from_secs(20);
/// After a signal or a failure: how long the processes have to end in good order, and then to end at once. Together they
/// stay below the second that a user waits after Ctrl-C.
const STOP_LIMIT: Duration = Duration::from_millis(600);
const ABORT_LIMIT: Duration = Duration::from_millis(200);
/// After the planned end: how long the last samples may take to reach the disk.
const CLOSE_LIMIT: Duration = Duration::from_secs(60);
/// How long it may take to take away what a dead process held.
const BURY_LIMIT: Duration = Duration::from_secs(5);
/// How often the launcher looks at boards, ns: often enough to end a lockstep run promptly, and in real time, where its
/// processor time is somebody else's latency, seldom. Deaths and signals wake it at once.
const LOOK_NS: u64 = 5_000_000;
const LOOK_REALTIME_NS: u64 = 200_000_000;

/// A run in progress.
pub(super) struct Supervisor {
    // Processes go before the domain: one that is still setting up would make files in what has been wiped.
    children: ChildProcesses,
    services: RunServices,
    domain: DomainName,
    control: Control,
    signals: TerminationSignals,
    progress: RunProgress,
    restarts: RestartTracker,
    fault_injector: ProcessFaultInjector,
    look_ns: u64,
    /// Why the run ends before its last tick, if it does.
    ended: Option<RunOutcome>,
    /// The first failure that was not made good.
    failure: Option<ProcessFailure>,
    /// What all those said who died.
    deaths: Vec<ProcessFailure>,
}

/// How a run ended, for its summary.
pub(super) struct RunEnd {
    pub ended: RunOutcome,
    pub failure: Option<ProcessFailure>,
    pub deaths: Vec<ProcessFailure>,
    pub incidents: Vec<RestartIncident>,
    /// What each process said last of itself.
    pub boards: [Status; 3],
}

impl Supervisor {
    pub fn new(
        launch: &Launch,
        services: RunServices,
        children: ChildProcesses,
        signals: TerminationSignals,
        progress: RunProgress,
        domain: &DomainName,
    ) -> Self {
        Self {
            services,
            domain: domain.clone(),
            children,
            control: Control::default(),
            signals,
            progress,
            fault_injector: ProcessFaultInjector::of(&launch.plan.scenario.faults),
            restarts: RestartTracker::new(&launch.plan.scenario.restart, monotonic_ns()),
            look_ns: if launch.mode == Mode::Realtime { LOOK_REALTIME_NS } else { LOOK_NS },
            ended: None,
            failure: None,
            deaths: Vec::new(),
        }
    }

    fn enter(&mut self, phase: Phase) {
        self.control.phase = phase as u32;
        self.services.control.put(self.control);
    }

    fn state(&self, role: Role) -> ProcessState {
        self.services.status(role).state()
    }

    /// Leads the processes through set-up.
    pub fn set_up(&mut self, launch: &Launch) -> Result<(), LaunchError> {
        for (state, next) in [(ProcessState::Ready, Phase::Connect), (ProcessState::Connected, Phase::Run)] {
            let began = monotonic_ns();
            while Role::ALL.iter().any(|&role| self.state(role) < state) {
                if self.look() {
                    return match self.failure.take() {
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

    /// Lets the ticks begin, and watches until all processes have finished or the run is to end early.
    pub fn go(&mut self, t0_ns: u64) {
        if self.ended.is_some() {
            return;
        }
        self.control.t0_ns = t0_ns;
        self.enter(Phase::Run);
        while Role::ALL.iter().any(|&role| self.state(role) != ProcessState::Finished) {
            if self.look() {
                return;
            }
            if self.signals.checkpoint_asked() {
                self.control.checkpoints += 1;
                self.services.control.put(self.control);
            }
            self.fault_injector.act(self.services.status(Role::Plant).ticks, monotonic_ns(), &self.children);
            self.listen();
            self.revive();
            self.progress.show(&self.services);
            self.children.await_end(self.fault_injector.patience(self.look_ns));
        }
    }

    /// Looks at signals and deaths. True when the run is to end early.
    fn look(&mut self) -> bool {
        for death in self.children.reap(&self.services) {
            self.deaths.push(death.failure.clone());
            let going = self.ended.is_none() && self.control.phase() == Phase::Run;
            let wanted = self.fault_injector.wanted(death.role);
            if going && self.restarts.take(&death, monotonic_ns(), wanted) {
                say(&format!("tectum: {}; it is started again", death.failure.message));
            } else {
                self.fail(death.failure);
            }
        }
        if self.ended.is_none() {
            if self.signals.received() != 0 {
                self.ended = Some(RunOutcome::Signal(self.signals.received()));
            } else if self.failure.is_some() {
                self.ended = Some(RunOutcome::Failed);
            }
        }
        self.ended.is_some()
    }

    fn fail(&mut self, failure: ProcessFailure) {
        self.failure.get_or_insert(failure);
    }

    /// Kills those who give no sign of life, and those who came back and do not get ready.
    fn listen(&mut self) {
        let now = monotonic_ns();
        for role in Role::ALL {
            let Some(process) = self.children.child(role) else { continue };
            let board = self.services.status(role);
            let hangs = match board.state() {
                _ if self.fault_injector.stands(role) => false,
                ProcessState::Running => self.restarts.silent(role, board.beat, now),
                ProcessState::Finished | ProcessState::Failed => false,
                _ => self.restarts.age(role, now) > SET_UP_LIMIT.as_nanos() as u64,
            };
            if hangs {
                say(&format!("tectum: the {} gives no sign of life any more and is killed", role.name()));
                process.kill();
            }
        }
    }

    /// Starts a process again whose wait is over.
    fn revive(&mut self) {
        // One at a time: what a process has half made while it is set up must not be taken for a dead one's.
        let settles = |role| self.children.child(role).is_some() && self.state(role) < ProcessState::Running;
        if Role::ALL.into_iter().any(settles) {
            return;
        }
        let Some(role) = self.restarts.due(monotonic_ns()) else { return };
        let failed = |message: String| ProcessFailure { code: exit::PROCESS, message, said: (role, String::new()) };
        // What could not be taken away may not be in the way. If it is, the new start fails, and is tried again.
        if reclaim_dead(&self.domain, BURY_LIMIT).is_none() {
            let text = format!("the {} cannot be started again: what it held cannot be taken from it", role.name());
            return self.fail(failed(text));
        }
        let incarnation = self.restarts.started(role, monotonic_ns());
        if let Err(error) = self.services.set_incarnation(role, incarnation) {
            return self.fail(failed(error.to_string()));
        }
        self.control.incarnations[role as usize] = incarnation;
        self.services.control.put(self.control);
        if let Err(error) = self.children.start_again(role) {
            self.fail(failed(error.to_string()));
        }
    }

    /// Ends the run and waits for the processes. Gives the seconds that the ticks took.
    pub fn close(&mut self, began: u64) -> f64 {
        if self.ended.is_some() {
            self.enter(if self.control.phase() >= Phase::Run { Phase::Stop } else { Phase::Abort });
            self.await_end(STOP_LIMIT);
        }
        let seconds = (monotonic_ns() - began) as f64 / 1e9;
        if self.ended.is_none() && !self.await_end(CLOSE_LIMIT) {
            self.ended = Some(RunOutcome::Failed);
        }
        self.enter(Phase::Abort);
        if !self.await_end(ABORT_LIMIT) {
            self.children.kill();
        }
        self.look();
        self.progress.clear();
        seconds
    }

    /// Waits until all processes have ended. False when `limit` passes first.
    fn await_end(&mut self, limit: Duration) -> bool {
        let began = monotonic_ns();
        loop {
            self.look();
            if self.children.gone() {
                return true;
            }
            if Duration::from_nanos(monotonic_ns() - began) > limit {
                return false;
            }
            self.children.await_end(LOOK_NS / 5);
        }
    }

    /// Takes the run apart: the domain is wiped.
    pub fn end(self) -> RunEnd {
        RunEnd {
            ended: self.ended.unwrap_or(RunOutcome::Complete),
            failure: self.failure,
            deaths: self.deaths,
            incidents: self.restarts.incidents,
            boards: Role::ALL.map(|role| self.services.status(role)),
        }
    }
}
