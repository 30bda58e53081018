//! The plant's loop: waits for its tick and for the command, and survives its own death.
//!
//! What the plant is about to say is kept in the vault, with the plant's whole state, before it is said. A plant that comes
//! back after a SIGKILL takes that up and says its last observation again, under the same sequence number: who has heard it
//! drops it, and the controller answers it again. So in lockstep nothing is changed by the death of either.

use hdrhistogram::Histogram;

use super::peer_monitor::PeerMonitor;
use super::reports::{Percentiles, histogram};
use super::stopwatch::Stopwatch;
use super::{Participant, PlantReport, PlantSide, RuntimeError, Session};
use crate::channel::{BoardReader, ChannelError, LOG_BUFFER, PlantPorts, Receiver};
use crate::checkpoint;
use crate::clock::{Backoff, WakeReason, pause, precise_timers};
use crate::plant::Plant;
use crate::state::{self, Persist, StateVisitor};
use crate::wire::{Command, Observation, Role, Status, flag};

/// Takes commands off the channel and sorts them by tick.
struct CommandInbox<'a> {
    channel: &'a Receiver<Command>,
    /// The sequence number of the next command, if none is lost.
    expected: u64,
    found: Option<Command>,
    /// Commands that came after their tick, since the loop asked last.
    late: u64,
    failure: Option<ChannelError>,
    answered: &'a mut Histogram<u64>,
    real: bool,
}

impl CommandInbox<'_> {
    /// Whether the command of `tick` is there. Older ones are counted as late and dropped. In lockstep nothing can lie behind it
    /// that is not of a later tick or said twice, so the channel is not asked again.
    fn look_for(&mut self, tick: u64) -> bool {
        while self.real || self.found.is_none() {
            match self.channel.receive() {
                Ok(None) => return self.found.is_some(),
                // Said again by a controller that has come back.
                Ok(Some(command)) if command.header.sequence < self.expected => {}
                Ok(Some(command)) => {
                    self.expected = command.header.sequence + 1;
                    if self.real {
                        // The command carries the instant at which its observation had been sensed.
                        let header = &command.header;
                        self.answered.saturating_record(header.published_ns.saturating_sub(header.sensed_ns));
                    }
                    if command.header.tick == tick {
                        self.found = Some(command);
                    } else {
                        self.late += 1;
                    }
                }
                Err(error) => {
                    // The wait must end; the loop tells the error.
                    self.failure = Some(error);
                    return true;
                }
            }
        }
        true
    }
}

/// Ticks between two looks at how far the logger is. In lockstep the plant never runs further ahead of it than its
/// buffer, so that nothing overflows: the logger is inside the barrier, at the price of one look in so many ticks.
const CREDIT: u64 = LOG_BUFFER as u64 / 4;

/// How often a body that acts at once looks for its command, ns: far less than what the bus takes.
const NAP_NS: u64 = 100_000;

/// The plant and what it said last.
struct PlantLoopState<P> {
    side: PlantSide<P>,
    observation: Observation,
    /// Observations said or about to be.
    sent_count: u64,
    /// The sequence number of the next command, if none is lost.
    expected: u64,
}

impl<P: Plant> Persist for PlantLoopState<P> {
    fn visit_state(&mut self, visitor: &mut dyn StateVisitor) {
        visitor.nested("plant", &mut self.side);
        visitor.words("observation", &mut self.observation);
        visitor.number("said", &mut self.sent_count);
        visitor.number("expected", &mut self.expected);
    }
}

impl<P: Plant> PlantLoopState<P> {
    /// The state as a checkpoint, as of when `tick` begins.
    fn checkpoint(&mut self, tick: u64, participant: &Participant) -> Vec<u8> {
        checkpoint::encode(&participant.facts(tick, self.sent_count), self, None)
    }
}

/// The plant's loop: seats `body` in the run and lives through it.
///
/// # Errors
/// When the process does not fit the run, the run ends in disorder, or the plant gives up on its deadlines
/// ([`RuntimeError::Overrun`]); what is said of such a run is complete all the same.
pub fn run_plant<P: Plant>(participant: Participant, body: P) -> Result<PlantReport, RuntimeError> {
    if !participant.plan.scenario.gate.positions.is_empty() && body.joints().is_none() {
        return Err(RuntimeError::NoJoints(participant.plan.scenario.plant.program.clone()));
    }
    let (mut ports, status_board) = participant.open(PlantPorts::open)?;
    let mut loop_state = PlantLoopState {
        side: PlantSide::new(body, &participant.plan),
        observation: Observation::default(),
        sent_count: 0,
        expected: 0,
    };
    let mut crash_store = participant.crash_store(state::size(&mut loop_state), [0, 0])?;
    let returned = crash_store.newest().is_some();
    if let Some((_, bytes)) = crash_store.newest() {
        if !state::load(&mut loop_state, bytes) {
            return Err(RuntimeError::Memory(Role::Plant.name()));
        }
    } else {
        participant.resume(&mut loop_state)?;
    }
    crash_store.reopen();
    let writer = participant.writer()?;
    // Readers of the observation: controller and logger. Writer of the command: the controller.
    let connected = || Ok(ports.observation.connect()? >= 2 && ports.command.connect()? >= 1);
    let (mut session, mut time) = participant.begin(status_board, connected)?;
    precise_timers();

    let real = time.is_real();
    let ticks = session.participant.plan.scenario.ticks;
    let (mut wake_up, mut answered, mut work) = (histogram(), histogram(), histogram());
    let mut inbox = CommandInbox {
        channel: &ports.command,
        expected: loop_state.expected,
        found: None,
        late: 0,
        failure: None,
        answered: &mut answered,
        real,
    };
    loop_state.observation.header.run = session.participant.manifest.run_id();
    loop_state.observation.header.incarnation = session.incarnation();
    let (mut controller, mut logger) = (PeerMonitor::new(Role::Controller), PeerMonitor::new(Role::Logger));

    let (most, period_ms) =
        (session.participant.plan.scenario.overrun.max_consecutive, session.participant.plan.scenario.period_ms);
    // The time that a plant was away is no overrun of the one that has come back.
    let (mut overruns, mut given_up, mut back) = (0, None, returned);
    let manifest = session.participant.manifest.clone();
    let mut watch = Stopwatch::of(&session.participant);
    let mut asked = session.checkpoints_asked();
    let mut tick = manifest.resumed.as_ref().map_or(0, |resumed| resumed.tick);
    // Whether all ticks before this one are lived through.
    let mut stepped = true;
    // Whether the command of the tick in progress has been passed on to a body that acts at once.
    let mut decided = false;
    session.status.sent = loop_state.sent_count;
    if returned {
        (tick, stepped) = (loop_state.observation.header.tick + 1, false);
        time.step_to(loop_state.observation.header.tick);
        ports.observation.send(&loop_state.observation)?;
        ports.wake.notify();
    }
    loop {
        let mut failure = None;
        let wake = time.await_tick(
            tick,
            || stepped || inbox.look_for(tick - 1),
            || {
                if real {
                    // A tick may be a second away.
                    return session.end_reason().is_some();
                }
                // The answer is under way, unless whoever should give it was killed before hearing the question.
                failure = match controller.check(&mut ports.controller, &session) {
                    Ok(true) if !stepped => {
                        ports.observation.send(&loop_state.observation).err().map(RuntimeError::from)
                    }
                    looked => looked.err(),
                };
                failure.is_some() || session.must_end()
            },
        );
        if let Some(error) = failure {
            return Err(error);
        }
        if wake == WakeReason::Cancelled {
            break;
        }
        let woken = time.now();
        let late_before = loop_state.side.report.late;
        if !stepped {
            inbox.look_for(tick - 1);
            if let Some(error) = inbox.failure.take() {
                return Err(error.into());
            }
            watch.end();
            if decided {
                // Whatever came since has come after it was decided on.
                inbox.late += u64::from(inbox.found.take().is_some());
                loop_state.side.finish_step(tick - 1);
            } else {
                loop_state.side.step(tick - 1, inbox.found.take().as_ref());
            }
            loop_state.side.report.late += std::mem::take(&mut inbox.late);
        }
        // Whoever wakes up a period late or more passes ticks over; never makes them up in a burst.
        let due = time.due().min(ticks).max(tick);
        if real {
            let now = time.now();
            for tick in tick..=due {
                wake_up.saturating_record(now.saturating_sub(time.scheduled(tick)));
            }
        }
        loop_state.side.skip(tick, due);
        let skipped = due - tick;
        tick = due;
        let report = &loop_state.side.report;
        session.status.ticks = tick;
        session.status.missed = report.missed;
        session.status.late = report.late;
        session.status.lost = report.skipped;
        session.publish_status();
        overruns = if skipped == 0 || back { 0 } else { overruns + skipped };
        back = false;
        if real && most > 0 && overruns > most {
            given_up = Some(RuntimeError::Overrun { overruns, most, tick, period_ms });
            break;
        }
        if tick >= ticks || session.stopping() {
            break;
        }
        if !real && tick.is_multiple_of(CREDIT) && !await_credit(&mut ports.logger, &mut logger, &session, tick)? {
            break;
        }

        let late = if report.late > late_before { flag::LATE } else { 0 };
        if session.status.checkpoint == tick + 1 {
            loop_state.expected = inbox.expected;
            writer.write(tick, loop_state.checkpoint(tick, &session.participant));
        }
        // Announced a tick ahead, before the observation goes out: the controller then cuts its own after its command.
        let wanted = session.checkpoints_asked();
        if wanted != asked || manifest.checkpoint_every > 0 && (tick + 1).is_multiple_of(manifest.checkpoint_every) {
            asked = wanted;
            session.status.checkpoint = tick + 2;
            session.publish_status();
        }
        loop_state.side.observe(tick, late, u32::try_from(skipped).unwrap_or(u32::MAX), &mut loop_state.observation);
        let header = &mut loop_state.observation.header;
        header.sequence = loop_state.sent_count;
        header.scheduled_ns = time.scheduled(tick);
        header.sensed_ns = time.now();
        watch.begin();
        loop_state.sent_count += 1;
        loop_state.expected = inbox.expected;
        loop_state.observation.header.published_ns = time.now();
        if !crash_store.store(loop_state.sent_count, |to| state::save(&mut loop_state, to)) {
            return Err(RuntimeError::Memory(Role::Plant.name()));
        }
        ports.observation.send(&loop_state.observation)?;
        if real {
            ports.wake.notify();
            work.saturating_record(time.now().saturating_sub(woken));
        }
        session.status.sent = loop_state.sent_count;
        decided = false;
        if let Some(within) = loop_state.side.acts_within() {
            let until = time.scheduled(tick) + within;
            while !inbox.look_for(tick) && time.now() < until && !session.stopping() {
                pause(NAP_NS);
            }
            if let Some(error) = inbox.failure.take() {
                return Err(error.into());
            }
            loop_state.side.apply(tick, inbox.found.take().as_ref(), true);
            decided = true;
        }
        tick += 1;
        stepped = false;
    }
    session.publish_status();
    session.check()?;
    loop_state.expected = inbox.expected;
    writer.write_last(tick, loop_state.checkpoint(tick, &session.participant), session.stopping());
    let mut report = loop_state.side.report;
    match writer.finish() {
        Ok(written) => report.checkpoints = written,
        Err(cause) => report.checkpoint_failure = Some(cause),
    }
    if real {
        report.wake_up = Percentiles::of(&wake_up);
        report.observation_to_command = Percentiles::of(&answered);
        report.work = Percentiles::of(&work);
    }
    watch.leave()?;
    session.finish(&report)?;
    // Whoever listens for another observation finds that there is none.
    ports.wake.notify();
    given_up.map_or(Ok(report), Err)
}

/// Waits until the logger has room for the next [`CREDIT`] ticks. False when the run is to end first.
fn await_credit(
    board: &mut BoardReader<Status>,
    logger: &mut PeerMonitor,
    session: &Session,
    tick: u64,
) -> Result<bool, RuntimeError> {
    let mut backoff = Backoff::default();
    while board.get().consumed + (LOG_BUFFER as u64) < tick + CREDIT {
        if backoff.pause() {
            logger.check(board, session)?;
            if session.end_reason().is_some() {
                return Ok(false);
            }
        }
    }
    Ok(true)
}
