//! The launcher's loop over a run in progress: phases, signals, deaths, hangs, restarts, and the end.
//!
//! It decides; the [`SupervisedWorld`] has the clock and does what was decided.

use std::time::Duration;

use super::children::{DeathKind, ProcessDeath, ProcessFailure};
use super::fault_injector::ProcessFaultInjector;
use super::restarts::{RestartIncident, RestartTracker};
use super::stall::StallWatch;
use super::world::{ProcessAction, SupervisedWorld};
use super::{LaunchError, RunOutcome};
use crate::channel::BoardsCopy;
use crate::scenario::{FaultsConfig, RestartConfig};
use crate::wire::{Control, Phase, ProcessState, Role, Status};

/// After a signal: how long the processes have to end in good order, and then to end at once. The
/// sum is below the second that a user waits after Ctrl-C.
const STOP_LIMIT: Duration = Duration::from_millis(600);
const ABORT_LIMIT: Duration = Duration::from_millis(200);
/// After a failure nobody waits at a terminal, and the others' results count.
const FAILURE_STOP_LIMIT: Duration = Duration::from_secs(5);
/// After the planned end: how long the last samples may take to reach the disk.
const CLOSE_LIMIT: Duration = Duration::from_secs(60);
/// How long the end of a killed process may take, ns. One that waits in the kernel for a disk that does not answer
/// cannot be killed.
const KILL_LIMIT_NS: u64 = 10_000_000_000;
/// How often the launcher reads the status boards, ns: often enough to end a lockstep run promptly. In real
/// time it reads them seldom, because its processor time adds to the latency of the control loop. Deaths and
/// signals wake it at once.
const POLL_NS: u64 = 5_000_000;
const POLL_REALTIME_NS: u64 = 200_000_000;
/// The same in real time while all is well and nobody watches.
const POLL_CALM_NS: u64 = 500_000_000;

/// By which rules a run is supervised.
#[derive(Debug, Clone, Default)]
pub struct SupervisorRules {
    /// Whether ticks follow the real clock.
    pub realtime: bool,
    /// Whether set-up waits for a user who starts processes, or for another machine, and so has no limit.
    pub waits: bool,
    /// `[restart]`.
    pub restart: RestartConfig,
    /// `[faults]`.
    pub faults: FaultsConfig,
}

/// A run in progress.
pub struct Supervisor<W> {
    world: W,
    control: Control,
    restarts: RestartTracker,
    fault_injector: ProcessFaultInjector,
    /// In lockstep only.
    stall: Option<StallWatch>,
    poll_ns: u64,
    /// How long a process may take to get ready, or to connect.
    set_up_limit: Duration,
    /// Whether set-up has a limit.
    set_up_is_limited: bool,
    /// When each process was killed as hung, ns; `None` for one that was not, or has ended.
    killed_at: [Option<u64>; 3],
    /// Why the run ends before its last tick, if it does.
    ended: Option<RunOutcome>,
    /// The first failure that no restart repaired.
    failure: Option<ProcessFailure>,
    /// The failures of all processes that died.
    deaths: Vec<ProcessFailure>,
}

/// How a run ended, for its summary.
#[derive(Debug)]
pub struct RunEnd {
    /// How.
    pub ended: RunOutcome,
    /// The first failure that no restart repaired.
    pub failure: Option<ProcessFailure>,
    /// The failures of all processes that died.
    pub deaths: Vec<ProcessFailure>,
    /// All restarts.
    pub incidents: Vec<RestartIncident>,
    /// The last status of each process.
    pub boards: [Status; 3],
    /// The tick at which the run's folder was found to be removed, if it was.
    pub folder_removed_at: Option<u64>,
}

impl<W: SupervisedWorld> Supervisor<W> {
    /// A run whose processes have just been started.
    pub fn new(world: W, rules: &SupervisorRules) -> Self {
        let now = world.now_ns();
        Self {
            world,
            control: Control::default(),
            fault_injector: ProcessFaultInjector::new(&rules.faults),
            restarts: RestartTracker::new(&rules.restart, now),
            stall: (!rules.realtime).then(|| StallWatch::new(rules.restart.hang_s, now)),
            poll_ns: if rules.realtime { POLL_REALTIME_NS } else { POLL_NS },
            set_up_limit: Duration::from_secs_f64(rules.restart.set_up_s),
            set_up_is_limited: !rules.waits,
            killed_at: [None; 3],
            ended: None,
            failure: None,
            deaths: Vec::new(),
        }
    }

    /// The world around the run.
    pub fn world(&self) -> &W {
        &self.world
    }

    fn enter(&mut self, phase: Phase) {
        self.control.phase = phase as u32;
        self.world.put_control(self.control);
    }

    fn state(&self, role: Role) -> ProcessState {
        self.world.status(role).state()
    }

    /// Leads the processes through set-up. Returns early, without an error, when a signal comes.
    ///
    /// # Errors
    /// When a process dies or does not get ready in time.
    pub fn set_up(&mut self) -> Result<(), LaunchError> {
        let limit = self.set_up_is_limited.then_some(self.set_up_limit);
        if self.await_state(ProcessState::Ready, limit)? {
            self.enter(Phase::Connect);
            if self.await_state(ProcessState::Connected, limit)? {
                self.world.fill_memory()?;
            }
        }
        Ok(())
    }

    /// Waits until all processes have reached `state`. False when a signal ends the run first.
    fn await_state(&mut self, state: ProcessState, limit: Option<Duration>) -> Result<bool, LaunchError> {
        let began = self.world.now_ns();
        while let Some(late) = Role::ALL.into_iter().find(|&role| self.state(role) < state) {
            if self.poll() {
                return match self.failure.take() {
                    // No tick has run yet, so there is nothing to summarise.
                    Some(failure) => Err(LaunchError::Refused { code: failure.code, message: failure.message }),
                    None => Ok(false),
                };
            }
            let waited = Duration::from_nanos(self.world.now_ns() - began);
            if limit.is_some_and(|limit| waited > limit) {
                return Err(LaunchError::NotReady { role: late.name(), seconds: waited.as_secs() });
            }
            self.world.pause(POLL_NS / 10);
        }
        Ok(true)
    }

    /// Starts the ticks, and watches the run until all processes have finished or it must end early.
    pub fn run_ticks(&mut self, t0_ns: u64) {
        if self.ended.is_some() {
            return;
        }
        self.control.t0_ns = t0_ns;
        self.restarts.ticks_begin(self.world.now_ns());
        self.enter(Phase::Run);
        while Role::ALL.iter().any(|&role| self.state(role) != ProcessState::Finished) {
            if self.poll() {
                return;
            }
            if self.world.checkpoint_asked() {
                self.control.checkpoints += 1;
                self.world.put_control(self.control);
            }
            let (tick, now) = (self.world.status(Role::Plant).ticks, self.world.now_ns());
            self.fault_injector.inject(tick, now, &mut self.world);
            self.kill_hung();
            self.check_progress();
            self.check_folder(false);
            self.restart_due();
            self.world.show_progress();
            self.world.await_event(self.look_interval());
        }
    }

    /// How long the launcher waits for an event until it looks again, ns.
    fn look_interval(&self) -> u64 {
        let runs = |role: &Role| self.state(*role) == ProcessState::Running;
        let calm = self.poll_ns == POLL_REALTIME_NS && Role::ALL.iter().all(runs) && !self.world.is_watched();
        let calm_ns = self.restarts.longest_look_away(POLL_CALM_NS).filter(|_| calm);
        self.fault_injector.poll_interval(calm_ns.unwrap_or(0).max(self.poll_ns))
    }

    /// Handles deaths and signals. True when the run must end early.
    fn poll(&mut self) -> bool {
        for death in self.world.reap() {
            self.killed_at[death.failure.role as usize] = None;
            self.deaths.push(death.failure.clone());
            let running = self.ended.is_none() && self.control.phase() == Phase::Run;
            let requested = self.fault_injector.take_restart(death.failure.role);
            if running && self.restarts.schedule(&death, self.world.now_ns(), requested) {
                self.world.say(&format!("tectum: {}; it is started again", death.failure.message));
            } else {
                self.fail(death.failure);
            }
        }
        if self.ended.is_none() {
            if self.world.signal() != 0 {
                self.ended = Some(RunOutcome::Signal(self.world.signal()));
            } else if self.failure.is_some() {
                self.ended = Some(RunOutcome::Failed);
            }
        }
        self.announce_losses();
        let status = Role::ALL.map(|role| self.world.status(role));
        self.world.publish(BoardsCopy { control: self.control, status });
        self.ended.is_some()
    }

    /// Once the run ends, tells the processes which of them will not return, so that nobody waits for those and
    /// each closes its files in good order.
    fn announce_losses(&mut self) {
        if self.ended.is_none() {
            return;
        }
        let before = self.control.gone;
        for role in Role::ALL {
            if self.world.is_empty(role) && self.state(role) != ProcessState::Finished {
                self.control.set_gone(role);
            }
        }
        if self.control.gone != before {
            // In one step, or a plant in lockstep would go on without its controller for a moment.
            if self.control.phase() == Phase::Run {
                self.control.phase = Phase::Stop as u32;
            }
            self.world.put_control(self.control);
        }
    }

    fn fail(&mut self, failure: ProcessFailure) {
        self.world.say_to_watchers(&failure.message);
        self.failure.get_or_insert(failure);
    }

    /// Says so when the run's folder has been removed.
    fn check_folder(&mut self, now: bool) {
        let tick = self.world.status(Role::Plant).ticks;
        if self.world.folder_removed(now, tick) {
            let message = "tectum: the run's folder has been removed, and the log with it; the run goes on without one";
            self.world.say(message);
        }
    }

    /// Kills processes whose heartbeat has stopped, and restarted ones that do not get ready in time.
    fn kill_hung(&mut self) {
        let now = self.world.now_ns();
        for role in Role::ALL {
            if !self.world.has_child(role) {
                continue;
            }
            if let Some(killed) = self.killed_at[role as usize] {
                self.await_kill(role, now - killed);
                continue;
            }
            let board = self.world.status(role);
            let hangs = match board.state() {
                _ if self.fault_injector.is_stopped(role) => false,
                ProcessState::Running => self.restarts.hangs(role, board.beat, now),
                // It waits for the disk. The end of the run has a limit of its own.
                ProcessState::Closing => self.restarts.closes_too_long(role, board.beat, now, CLOSE_LIMIT),
                ProcessState::Finished | ProcessState::Failed => false,
                _ => self.restarts.since_start(role, now) > self.set_up_limit.as_nanos() as u64,
            };
            if hangs {
                self.world.say(&format!("tectum: the {} gives no sign of life any more and is killed", role.name()));
                self.world.act(role, ProcessAction::KillGroup);
                self.killed_at[role as usize] = Some(now);
            }
        }
    }

    /// Ends the run if a process that was killed `ago` ns before is still there: nobody can wait for it.
    fn await_kill(&mut self, role: Role, ago: u64) {
        if ago > KILL_LIMIT_NS {
            let message = format!(
                "the {} gives no sign of life and cannot be killed: it waits for a disk or a device that does not \
                 answer",
                role.name()
            );
            self.fail(ProcessFailure::new(role, message));
        }
    }

    /// Ends a lockstep run whose processes all wait for each other.
    fn check_progress(&mut self) {
        let Some(stall) = &mut self.stall else { return };
        let boards = Role::ALL.map(|role| self.world.status(role));
        if stall.stalls(boards, self.world.now_ns()) {
            let tick = boards[Role::Plant as usize].ticks;
            let message = format!(
                "at tick {tick} no process gets on: all of them live, and each waits for another; a sample was lost \
                 between them"
            );
            self.fail(ProcessFailure::new(Role::Plant, message));
        }
    }

    /// Restarts a process whose delay is over.
    fn restart_due(&mut self) {
        // One at a time: reclaiming could take what a process that is still setting up has half created for a
        // dead one's.
        let sets_up = |role| self.world.has_child(role) && self.state(role) < ProcessState::Running;
        if Role::ALL.into_iter().any(sets_up) {
            return;
        }
        let Some(role) = self.restarts.due(self.world.now_ns()) else { return };
        if !self.world.reclaim() {
            let cause = "the shared memory that it held cannot be reclaimed";
            let message = format!("the {} cannot be started again: {cause}", role.name());
            return self.fail(ProcessFailure::new(role, message));
        }
        let incarnation = self.restarts.record_restart(role, self.world.now_ns());
        if let Err(error) = self.world.set_incarnation(role, incarnation) {
            return self.fail(ProcessFailure::new(role, error));
        }
        self.control.incarnations[role as usize] = incarnation;
        self.world.put_control(self.control);
        if let Err(error) = self.world.start_again(role) {
            // There may be room for another process (RLIMIT_NPROC, memory) the next time.
            let death = ProcessDeath { failure: ProcessFailure::new(role, error), kind: DeathKind::Failure };
            if !self.restarts.schedule(&death, self.world.now_ns(), false) {
                self.fail(death.failure);
            }
        }
    }

    /// Ends the run and waits for the processes. Returns the seconds that the ticks took.
    pub fn close(&mut self, began: u64) -> f64 {
        if self.ended.is_some() {
            self.enter(if self.control.phase() >= Phase::Run { Phase::Stop } else { Phase::Abort });
            self.end_set_ups();
            let failed = self.ended == Some(RunOutcome::Failed);
            self.await_end(if failed { FAILURE_STOP_LIMIT } else { STOP_LIMIT });
        }
        self.check_folder(true);
        let seconds = (self.world.now_ns() - began) as f64 / 1e9;
        if self.ended.is_none() && !self.await_end(CLOSE_LIMIT) {
            self.ended = Some(RunOutcome::Failed);
        }
        self.enter(Phase::Abort);
        if !self.await_end(ABORT_LIMIT) {
            let remaining: Vec<Role> = Role::ALL.into_iter().filter(|&role| self.world.has_child(role)).collect();
            for role in remaining {
                let name = role.name();
                self.world.say(&format!("tectum: the {name} has not ended in time and is killed; it leaves no report"));
            }
            self.world.kill_all();
        }
        self.poll();
        self.world.await_last_words();
        self.world.clear_progress();
        seconds
    }

    /// Ends restarted processes that are still setting up: the others would wait for them until it is too late to keep
    /// their own results.
    fn end_set_ups(&mut self) {
        for role in Role::ALL {
            let restarted = self.control.incarnations[role as usize] > 0;
            if restarted && self.state(role) < ProcessState::Running {
                self.world.act(role, ProcessAction::Terminate);
            }
        }
    }

    /// Waits until all processes have ended. False when `limit` passes first.
    fn await_end(&mut self, limit: Duration) -> bool {
        let began = self.world.now_ns();
        loop {
            self.poll();
            if self.world.all_ended() {
                return true;
            }
            if Duration::from_nanos(self.world.now_ns() - began) > limit {
                return false;
            }
            self.world.await_event(POLL_NS / 5);
        }
    }

    /// The failures of all processes that died so far.
    pub fn deaths(&self) -> &[ProcessFailure] {
        &self.deaths
    }

    /// Dissolves the run, which removes its domain.
    pub fn into_end(self) -> RunEnd {
        RunEnd {
            ended: self.ended.unwrap_or(RunOutcome::Complete),
            failure: self.failure,
            deaths: self.deaths,
            incidents: self.restarts.incidents,
            boards: Role::ALL.map(|role| self.world.status(role)),
            folder_removed_at: self.world.folder_removed_at(),
        }
    }
}
