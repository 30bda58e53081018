//! The plant's loop: waits for its tick and for the command, advances the plant, and sends the observation.
//!
//! With each observation, the plant's whole state is kept in the crash store. A plant that is restarted after a SIGKILL
//! restores that state and sends its last observation again, under the same sequence number. Receivers that have
//! received it drop it, and the controller answers it again. So in lockstep the restart of either process changes no
//! result.
//!
//! In real time the state is kept before the observation is sent. In lockstep it is kept afterwards, while the
//! controller works, and the command with which the plant advances is kept before it does: a plant that died between
//! sending and keeping is one tick behind, repeats that tick with the same command, and sends the same observation.

use hdrhistogram::Histogram;

use super::checkpoint_schedule::CheckpointSchedule;
use super::command_inbox::CommandInbox;
use super::peer_monitor::PeerMonitor;
use super::stopwatch::Stopwatch;
use super::{Participant, PlantReport, PlantSide, RuntimeError, Session};
use crate::channel::{BoardReader, CrashStore, LOG_BUFFER, PlantPorts};
use crate::checkpoint::{self, CheckpointWriter};
use crate::clock::{Backoff, TimeSource, WakeReason, pause, precise_timers};
use crate::plant::Plant;
use crate::state::{self, Persist, StateVisitor};
use crate::stats::{Percentiles, histogram};
use crate::wire::{Command, Observation, ProcessState, Role, Status, flag};

/// Ticks between two checks of the logger's progress. In lockstep the plant never runs ahead of the logger by
/// more than the logger's buffer, so that no sample overflows. This flow control costs one check per so many
/// ticks.
const CREDIT_TICKS: u64 = LOG_BUFFER as u64 / 4;

/// Interval at which a plant that acts within the tick polls for its command, ns: far less than the bus of
/// servos takes.
const COMMAND_POLL_NS: u64 = 100_000;

/// The plant's loop: runs `body` as the plant of the run.
///
/// # Errors
/// When the process does not fit the run, the run ends abnormally, or the plant missed too many deadlines
/// ([`RuntimeError::Overrun`]). After an overrun, report, log and checkpoint are complete all the same.
pub fn run_plant<P: Plant>(participant: Participant, body: P) -> Result<PlantReport, RuntimeError> {
    if !participant.plan.scenario.gate.positions.is_empty() && body.joints().is_none() {
        return Err(RuntimeError::NoJoints(participant.plan.scenario.plant.program.clone()));
    }
    let mut plant_loop = PlantLoop::start(participant, body)?;
    while plant_loop.run_tick()? {}
    plant_loop.finish()
}

/// [`run_plant`] with the plant that the run's scenario describes. It is compiled here, with full optimisation.
///
/// # Errors
/// [`RuntimeError::NotSimulated`] when the scenario names another program's plant; otherwise as for [`run_plant`].
pub fn run_simulator(participant: Participant) -> Result<PlantReport, RuntimeError> {
    let body = participant
        .plan
        .described_plant()
        .ok_or_else(|| RuntimeError::NotSimulated(participant.plan.scenario.plant.program.clone()))?;
    run_plant(participant, body)
}

/// The part of the loop that survives the process: the plant and its last observation.
struct PlantLoopState<P> {
    side: PlantSide<P>,
    observation: Observation,
    /// Observations that were sent, or are about to be.
    sent_count: u64,
    /// The sequence number of the next command, if none is lost.
    expected: u64,
}

impl<P: Plant> PlantLoopState<P> {
    /// The state as a checkpoint at the start of `tick`.
    fn checkpoint(&mut self, tick: u64, participant: &Participant) -> Vec<u8> {
        checkpoint::encode(&participant.facts(tick, self.sent_count), self, None)
    }

    /// Restores the state from the crash store, or from the checkpoint with which the run resumes, if there is
    /// one. Returns true if it was the crash store: the process has been restarted. `before` is what its predecessors
    /// showed last.
    fn restore(
        &mut self,
        crash_store: &mut CrashStore,
        participant: &Participant,
        before: &Status,
    ) -> Result<bool, RuntimeError> {
        let restarted = crash_store.newest().is_some();
        let first = participant.manifest.resumed.as_ref().map_or(0, |resumed| resumed.sequences[0]);
        if !restarted && before.sent > first {
            self.forget(participant, before)?;
            return Ok(false);
        }
        if let Some((_, bytes)) = crash_store.newest() {
            if !state::load(self, bytes) {
                return Err(RuntimeError::Memory(Role::Plant.name()));
            }
        } else {
            participant.resume(self)?;
        }
        crash_store.reopen();
        Ok(restarted)
    }

    /// The inbox for the next command. The process's predecessor may have received that already.
    fn inbox(&self, crash_store: &CrashStore, real: bool) -> CommandInbox {
        let mut inbox = CommandInbox::new(self.expected, self.sent_count, real);
        if let Some(command) = crash_store.entry(self.sent_count) {
            inbox.put(bytemuck::pod_read_unaligned(command));
        }
        inbox
    }

    /// Keeps the state in the crash store.
    fn save(&mut self, crash_store: &mut CrashStore) -> Result<(), RuntimeError> {
        let kept = crash_store.store(self.sent_count, |to| state::save(self, to));
        if kept { Ok(()) } else { Err(RuntimeError::Memory(Role::Plant.name())) }
    }

    /// Goes on without what the predecessor remembered, which is gone. Sequence numbers and counts are those that its
    /// board showed last. It may have sent one more observation.
    fn forget(&mut self, participant: &Participant, before: &Status) -> Result<(), RuntimeError> {
        participant.refuse_without_memory()?;
        self.sent_count = before.sent + 1;
        let report = self.side.report_mut();
        (report.ticks, report.missed, report.late) = (before.sent, before.missed, before.late);
        (report.skipped, report.forgot_at) = (before.lost, Some(before.ticks));
        Ok(())
    }
}

impl<P: Plant> Persist for PlantLoopState<P> {
    fn visit_state(&mut self, visitor: &mut dyn StateVisitor) {
        visitor.nested("plant", &mut self.side);
        visitor.words("observation", &mut self.observation);
        visitor.number("said", &mut self.sent_count);
        visitor.number("expected", &mut self.expected);
    }
}

/// Commands in the journal: the one with which the plant advances, and one that may be overwritten meanwhile.
const JOURNAL: usize = 2;

/// The loop in progress. Fields are dropped in this order, so that a loop that fails publishes so before its
/// ports close.
struct PlantLoop<P> {
    stopwatch: Stopwatch,
    controller: PeerMonitor,
    logger: PeerMonitor,
    inbox: CommandInbox,
    /// Real time: from a tick's scheduled instant to the wake-up for it, ns.
    wake_up: Histogram<u64>,
    /// Real time: from the wake-up to the sending of the observation, ns.
    work: Histogram<u64>,
    time: TimeSource,
    session: Session,
    writer: CheckpointWriter,
    crash_store: CrashStore,
    state: PlantLoopState<P>,
    ports: PlantPorts,
    real: bool,
    /// Whether the state is kept after the observation has been sent.
    saves_late: bool,
    backoff: Backoff,
    /// For the logger, which wakes nobody.
    logger_backoff: Backoff,
    /// The run's number of ticks.
    ticks: u64,
    checkpoints: CheckpointSchedule,
    /// The next tick to begin.
    tick: u64,
    /// Whether the plant has advanced through all ticks before `tick`.
    advanced: bool,
    /// Whether the plant has already acted in the tick before `tick`, because it acts within the tick.
    acted: bool,
    /// Ticks skipped in a row.
    overruns: u64,
    /// Whether this is the first tick after a restart. The time for which the process was dead is no overrun.
    first_after_restart: bool,
    /// The error with which the run ends, because the plant skipped too many ticks.
    gave_up: Option<RuntimeError>,
}

impl<P: Plant> PlantLoop<P> {
    /// Joins the run. After a restart, sends the last observation again.
    fn start(participant: Participant, body: P) -> Result<Self, RuntimeError> {
        let (mut ports, status_board) = participant.open(PlantPorts::open)?;
        if participant.plan.scenario.link.ahead > 0 {
            ports.open_ahead()?;
        }
        let mut state = PlantLoopState {
            side: PlantSide::new(body, &participant.plan),
            observation: Observation::default(),
            sent_count: 0,
            expected: 0,
        };
        let mut crash_store = participant.crash_store(state::size(&mut state), [JOURNAL, size_of::<Command>()])?;
        let before = status_board.before;
        let restarted = state.restore(&mut crash_store, &participant, &before)?;
        let writer = participant.checkpoint_writer()?;
        // Reader of the observation: the controller, which also writes the command.
        let connected = || Ok(ports.observation.connect()? >= 1 && ports.command.connect()? >= 1);
        let (session, time) = participant.begin(status_board, connected)?;
        precise_timers();

        let real = time.is_real();
        let backoff = ports.lockstep_wake.take().map_or_else(Backoff::default, Backoff::woken_by);
        state.observation.header.run = session.participant.manifest.run_id();
        state.observation.header.incarnation = session.incarnation();
        let manifest = &session.participant.manifest;
        // A plant that acts within the tick goes on after it has sent, and commands ahead have no journal.
        let saves_late = !real && ports.ahead.is_none() && state.side.command_deadline_ns().is_none();
        let mut plant_loop = Self {
            stopwatch: Stopwatch::of(&session.participant),
            controller: PeerMonitor::new(Role::Controller),
            logger: PeerMonitor::new(Role::Logger),
            inbox: state.inbox(&crash_store, real),
            wake_up: histogram(),
            work: histogram(),
            real,
            saves_late,
            backoff,
            logger_backoff: Backoff::default(),
            ticks: session.participant.plan.scenario.ticks,
            checkpoints: CheckpointSchedule::new(manifest.checkpoint_every, session.checkpoints_requested(), real),
            tick: manifest.resumed.as_ref().map_or(0, |resumed| resumed.tick),
            advanced: true,
            acted: false,
            overruns: 0,
            first_after_restart: restarted || state.side.report().forgot_at.is_some(),
            gave_up: None,
            time,
            session,
            writer,
            crash_store,
            state,
            ports,
        };
        plant_loop.session.status.sent = plant_loop.state.sent_count;
        if restarted {
            plant_loop.send_again()?;
        } else if plant_loop.state.side.report().forgot_at.is_some() {
            (plant_loop.tick, plant_loop.advanced) = (before.ticks + 1, false);
        }
        Ok(plant_loop)
    }

    /// After a restart, sends the last observation again and continues behind it.
    fn send_again(&mut self) -> Result<(), RuntimeError> {
        let last = self.state.observation.header.tick;
        (self.tick, self.advanced) = (last + 1, false);
        self.time.step_to(last);
        self.ports.observation.send(&self.state.observation)?;
        self.ports.wake.notify();
        self.ports.log.append(&self.state.observation);
        Ok(())
    }

    /// One tick. Returns false when the loop is over.
    fn run_tick(&mut self) -> Result<bool, RuntimeError> {
        if self.wake()? == WakeReason::Cancelled {
            return Ok(false);
        }
        let woken = self.time.now();
        let late_before = self.state.side.report().late;
        self.advance()?;
        let skipped = self.skip_overrun_ticks();
        let looks = self.publish_counts();
        let ends = if looks { self.session.stopping() } else { self.session.interrupted() };
        if self.gives_up(skipped) || self.tick >= self.ticks || ends {
            return Ok(false);
        }
        if !self.real && self.tick.is_multiple_of(CREDIT_TICKS) && !self.await_logger()? {
            return Ok(false);
        }
        let late = if self.state.side.report().late > late_before { flag::LATE } else { 0 };
        self.checkpoint(looks)?;
        self.observe(late, skipped);
        self.send(woken)?;
        self.act()?;
        self.tick += 1;
        self.advanced = false;
        Ok(true)
    }

    /// Waits until the tick begins: in real time until its scheduled instant, in lockstep until the command of
    /// the tick before has arrived.
    fn wake(&mut self) -> Result<WakeReason, RuntimeError> {
        // A plant that acts within the tick has the command already.
        let awaited = if self.advanced || self.acted { None } else { Some(self.tick - 1) };
        self.await_tick(awaited)
    }

    /// Waits until the tick begins: in lockstep until the command of tick `awaited` has arrived.
    fn await_tick(&mut self, awaited: Option<u64>) -> Result<WakeReason, RuntimeError> {
        let (tick, real) = (self.tick, self.real);
        let mut failure = None;
        let wake = self.time.await_tick(
            tick,
            &mut self.backoff,
            || awaited.is_none_or(|awaited| self.inbox.poll_for(&self.ports.command, awaited)),
            || {
                if real {
                    // The next tick may be a second away.
                    return self.session.end_reason().is_some();
                }
                // The command is on its way, unless the controller was killed before it had received the
                // observation.
                failure = match self.controller.check(&mut self.ports.controller, &self.session) {
                    Ok(true) if awaited.is_some() => {
                        self.ports.observation.send(&self.state.observation).err().map(RuntimeError::from)
                    }
                    checked => checked.err(),
                };
                failure.is_some() || self.session.must_end() || self.session.is_gone(Role::Controller)
            },
        );
        failure.map_or(Ok(wake), Err)
    }

    /// Advances the plant through the tick before, with the command that has arrived for it.
    fn advance(&mut self) -> Result<(), RuntimeError> {
        if self.advanced {
            return Ok(());
        }
        let tick = self.tick - 1;
        self.inbox.poll_for(&self.ports.command, tick);
        self.inbox.check()?;
        self.take_ahead()?;
        self.stopwatch.end();
        if self.acted {
            self.inbox.drop_as_late();
            self.state.side.finish_step(tick);
        } else {
            let command = self.inbox.take();
            if let Some(command) = command.as_ref().filter(|_| self.saves_late) {
                self.crash_store.append(self.state.sent_count, bytemuck::bytes_of(command));
            }
            self.state.side.step(tick, command.as_ref());
        }
        self.state.side.report_mut().late += self.inbox.take_late();
        Ok(())
    }

    /// Takes the commands ahead that have come. They are sent before the commands that they belong to.
    fn take_ahead(&mut self) -> Result<(), RuntimeError> {
        if let Some(channel) = &self.ports.ahead {
            while let Some(ahead) = channel.receive()? {
                self.state.side.keep_ahead(Some(&ahead));
            }
        }
        Ok(())
    }

    /// Skips the ticks whose whole period has passed before the plant woke up, and returns their number. They
    /// are never made up for in a burst.
    fn skip_overrun_ticks(&mut self) -> u64 {
        let due = self.time.due().min(self.ticks).max(self.tick);
        if self.real {
            let now = self.time.now();
            for tick in self.tick..=due {
                self.wake_up.saturating_record(now.saturating_sub(self.time.scheduled(tick)));
            }
        }
        self.state.side.skip(self.tick, due);
        let skipped = due - self.tick;
        self.tick = due;
        skipped
    }

    /// Publishes the counts on the plant's board. Returns whether the launcher's board is to be read in this tick.
    fn publish_counts(&mut self) -> bool {
        let report = self.state.side.report();
        let status = &mut self.session.status;
        status.ticks = self.tick;
        status.missed = report.missed;
        status.late = report.late;
        status.lost = report.skipped;
        self.session.publish_progress()
    }

    /// Counts ticks skipped in a row. Returns true when there are more than the scenario allows, so that the
    /// run ends.
    fn gives_up(&mut self, skipped: u64) -> bool {
        self.overruns = if skipped == 0 || self.first_after_restart { 0 } else { self.overruns + skipped };
        self.first_after_restart = false;
        let scenario = &self.session.participant.plan.scenario;
        let most = scenario.overrun.max_consecutive;
        let gives_up = self.real && most > 0 && self.overruns > most;
        if gives_up {
            let (overruns, tick, period_ms) = (self.overruns, self.tick, scenario.period_ms);
            self.gave_up = Some(RuntimeError::Overrun { overruns, most, tick, period_ms });
        }
        gives_up
    }

    /// Waits until the logger has room for the next [`CREDIT_TICKS`] ticks. Returns false when the run ends
    /// first.
    fn await_logger(&mut self) -> Result<bool, RuntimeError> {
        let board: &mut BoardReader<Status> = &mut self.ports.logger;
        self.logger_backoff.begin();
        while board.get().consumed + (LOG_BUFFER as u64) < self.tick + CREDIT_TICKS {
            if self.logger_backoff.pause() {
                self.logger.check(board, &self.session)?;
                if self.session.end_reason().is_some() {
                    return Ok(false);
                }
            }
        }
        Ok(true)
    }

    /// Writes the checkpoint that was announced for this tick, and announces the next one. `looks`: whether the
    /// launcher's board is to be read.
    fn checkpoint(&mut self, looks: bool) -> Result<(), RuntimeError> {
        let announced = self.session.status.checkpoint;
        if self.checkpoints.is_due(announced, self.tick) {
            self.state.expected = self.inbox.expected;
            self.writer.write(self.tick, self.state.checkpoint(self.tick, &self.session.participant));
        }
        let requested = looks.then(|| self.session.checkpoints_requested());
        let controller = || {
            self.controller.check(&mut self.ports.controller, &self.session)?;
            Ok(self.ports.controller.get())
        };
        if let Some(next) = self.checkpoints.next(announced, self.tick, requested, controller)? {
            self.session.status.checkpoint = next;
            self.session.publish_status();
        }
        Ok(())
    }

    /// Senses and fills the observation of the tick.
    fn observe(&mut self, late: u32, skipped: u64) {
        let skipped = u32::try_from(skipped).unwrap_or(u32::MAX);
        self.state.side.observe(self.tick, late, skipped, &mut self.state.observation);
        let header = &mut self.state.observation.header;
        header.sequence = self.state.sent_count;
        header.scheduled_ns = self.time.scheduled(self.tick);
        header.sensed_ns = self.time.now();
        self.stopwatch.begin();
    }

    /// Keeps the whole state with the observation in the crash store, and sends the observation. `woken` is the instant
    /// at which the plant woke up for the tick.
    fn send(&mut self, woken: u64) -> Result<(), RuntimeError> {
        let state = &mut self.state;
        state.sent_count += 1;
        self.inbox.observed = state.sent_count;
        state.expected = self.inbox.expected;
        state.observation.header.published_ns = self.time.now();
        if !self.saves_late {
            state.save(&mut self.crash_store)?;
        }
        self.ports.observation.send(&self.state.observation)?;
        if self.real {
            self.ports.wake.notify();
            self.work.saturating_record(self.time.now().saturating_sub(woken));
        } else {
            self.ports.wake.notify_waiting();
        }
        self.ports.log.append(&self.state.observation);
        if self.saves_late {
            self.state.save(&mut self.crash_store)?;
        }
        self.ports.observation.prepare(&self.state.observation)?;
        self.session.status.sent = self.state.sent_count;
        Ok(())
    }

    /// For a plant that acts within the tick: waits for the tick's command, up to the plant's limit, and passes
    /// it on.
    fn act(&mut self) -> Result<(), RuntimeError> {
        self.acted = false;
        if let Some(within) = self.state.side.command_deadline_ns() {
            // In lockstep no command is late.
            if !self.real && self.await_tick(Some(self.tick))? == WakeReason::Cancelled {
                return Ok(());
            }
            let until = self.time.scheduled(self.tick) + within;
            while !self.inbox.poll_for(&self.ports.command, self.tick)
                && self.time.now() < until
                && !self.session.stopping()
            {
                pause(COMMAND_POLL_NS);
            }
            self.inbox.check()?;
            self.take_ahead()?;
            self.state.side.apply(self.tick, self.inbox.take().as_ref(), true);
            self.acted = true;
        }
        Ok(())
    }

    /// Ends the loop: writes the last checkpoint and the report.
    fn finish(mut self) -> Result<PlantReport, RuntimeError> {
        self.state.side.stop();
        self.session.enter(ProcessState::Closing);
        self.session.check()?;
        self.state.expected = self.inbox.expected;
        // Without the controller, the command of the tick before is missing: there is no state at the start of this
        // tick. A checkpoint of the plant alone would be of no use either.
        if !self.session.is_gone(Role::Controller) {
            let checkpoint = self.state.checkpoint(self.tick, &self.session.participant);
            self.writer.write_last(self.tick, checkpoint, self.session.stopping());
        }
        let mut report = self.state.side.into_report();
        match self.writer.finish() {
            Ok(written) => report.checkpoints = written,
            Err(cause) => report.checkpoint_failure = Some(cause),
        }
        if self.real {
            report.wake_up = Percentiles::of(&self.wake_up);
            report.observation_to_command = Percentiles::of(&self.inbox.response_times);
            report.work = Percentiles::of(&self.work);
        }
        self.stopwatch.write()?;
        self.session.finish(&report)?;
        // Wakes a controller that still waits, so that it sees the end of the run.
        self.ports.wake.notify();
        self.gave_up.map_or(Ok(report), Err)
    }
}

#[cfg(test)]
mod tests;
