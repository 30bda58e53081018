//! The logger's loop: everything that the others send, merged by tick, into one log.
//!
//! A logger that comes back into its run writes a segment of its own (see [`crate::log`]): it reads what is there, and states
//! what is missing between that and the first sample that it receives. When the disk is full, it goes on receiving, so that
//! nobody waits for it in vain, and closes the log with what it could not hold.

use super::faults::FaultyChannel;
use super::merge::{LogMerger, MergeOutcome};
use super::{LoggerReport, Mode, Participant, ResumePoint, RuntimeError, Session, read_realtime};
use crate::channel::{ChannelError, LoggerPorts, Receiver};
use crate::clock::{TimeSource, facts, monotonic_ns, pause, wall_ns};
use crate::log::{LogClock, LogHeader, LogRecord, LogRecovery, LogSegment, LogWriter, segment_path};
use crate::scenario::FaultChannel;
use crate::wire::{Learning, ProcessState, Role, Status};

/// How far the senders are, by their boards, whichever of their incarnations has them.
struct SenderProgress {
    boards: [Status; 2],
    /// Samples sent on observation, command and learning.
    sent: [u64; 3],
}

impl SenderProgress {
    /// Looks at the boards, at the pages of those who have, or will have, the places now.
    fn update(&mut self, ports: &mut LoggerPorts, session: &Session) -> Result<(), RuntimeError> {
        ports.plant.set_incarnation(session.incarnation_of(Role::Plant))?;
        ports.controller.set_incarnation(session.incarnation_of(Role::Controller))?;
        self.boards = [ports.plant.get(), ports.controller.get()];
        // The board of a process that comes back is empty at first.
        let [plant, controller] = self.boards.map(|board| board.sent);
        for (sent, now) in self.sent.iter_mut().zip([plant, controller, controller]) {
            *sent = now.max(*sent);
        }
        Ok(())
    }

    fn finished(&self) -> bool {
        self.boards.iter().all(|board| board.state() == ProcessState::Finished)
    }
}

/// The logger's loop.
///
/// # Errors
/// When the process does not fit the run, the log cannot be begun, or the run ends in disorder; the log is closed in every
/// case in which that is possible. A log that cannot be written any more is no error of the loop, but told in the report.
pub fn run_logger(participant: Participant) -> Result<LoggerReport, RuntimeError> {
    let (mut ports, status_board) = participant.open(LoggerPorts::open)?;
    let (mut session, time) = participant.begin(status_board, || {
        let channels = [ports.observation.connect()?, ports.command.connect()?, ports.learning.connect()?];
        Ok(channels.iter().all(|&writers| writers >= 1))
    })?;
    let (folder, period_ns) = (session.participant.folder.clone(), session.participant.plan.period_ns);
    let incarnation = session.incarnation();
    let past = match &session.participant.manifest.resumed {
        Some(ResumePoint { tick, sequences: [observation, answer], .. }) => {
            LogRecovery::none(period_ns, [*observation, *answer, *answer], *tick)
        }
        None => LogRecovery::none(period_ns, [0; 3], 0),
    };
    let past = if incarnation > 0 { past.with(&folder, || session.publish_status()) } else { past };
    let header = header(&session, &time, &past);
    let log = LogWriter::create(&segment_path(&folder, incarnation), &header);
    let mut merge = match log {
        // There was a log before; nobody shall wait for one who cannot make another.
        Err(error) if incarnation > 0 && error.is_full() => {
            LogMerger::new(Err(error), &past, header.every, time.is_real())
        }
        log => LogMerger::new(Ok(log?), &past, header.every, time.is_real()),
    };
    let mut senders = SenderProgress { boards: Default::default(), sent: [0; 3] };

    let ended = follow(&mut merge, &mut ports, &mut senders, &mut session, &time);
    let complete = senders.boards[Role::Plant as usize].ticks >= session.participant.plan.scenario.ticks;
    let MergeOutcome { totals, written, failure, timings } = merge.close(senders.sent, complete);
    ended?;
    let [wake_up_lateness, observation_to_command, command_to_applied] =
        timings.map_or([None; 3], |timings| timings.percentiles());
    let report = LoggerReport {
        written,
        lost: totals.lost,
        thinned: totals.thinned,
        duplicates: totals.duplicates,
        missing_from: totals.missing_from,
        failure,
        bytes: past.bytes + std::fs::metadata(segment_path(&folder, incarnation)).map_or(0, |file| file.len()),
        wake_up_lateness,
        observation_to_command,
        command_to_applied,
    };
    session.finish(&report)?;
    // In lockstep the plant waits for the logger: a loss there is a fault of this program, unless somebody was away, there
    // was no room, or the scenario wants it.
    let returned = Role::ALL.iter().any(|&role| session.incarnation_of(role) > 0);
    let faulty =
        session.participant.plan.scenario.faults.channel.iter().any(|fault| fault.channel == FaultChannel::Learning);
    let excused = time.is_real() || returned || faulty || report.failure.is_some();
    if let (false, Some(i)) = (excused, report.lost.iter().position(|&lost| lost > 0)) {
        let channel = ["observation", "command", "learning"][i].to_owned();
        return Err(RuntimeError::Lost { channel, lost: report.lost[i] });
    }
    Ok(report)
}

/// Writes until both senders have finished and everything is written.
fn follow(
    merge: &mut LogMerger,
    ports: &mut LoggerPorts,
    senders: &mut SenderProgress,
    session: &mut Session,
    time: &TimeSource,
) -> Result<(), RuntimeError> {
    // Nobody waits for the logger, so it looks in now and then instead of being woken: often enough to keep far from its
    // buffer's end, seldom enough to cost nothing.
    let real = time.is_real();
    let nap = if real { session.participant.plan.period_ns.clamp(200_000, 50_000_000) } else { 200_000 };
    // In real time a sample may never come; two periods later its tick is written without it.
    let patience = (2 * session.participant.plan.period_ns / nap).max(8);
    let mut naps = 0;
    let mut line = FaultyChannel::of(&session.participant.plan);
    loop {
        senders.update(ports, session)?;
        let ended = session.check();
        let last = senders.finished() || ended.is_err();
        let force = last || (real && naps >= patience);
        // In lockstep a sample's sequence number is its tick.
        let known = if real { [0; 3] } else { senders.sent };
        let any = drain(merge, ports, &mut line, known, force)?;
        session.status.consumed = merge.consumed();
        session.status.ticks = session.status.consumed;
        session.status.lost = merge.lanes.iter().map(|lane| lane.lost).sum();
        session.publish_status();
        if last {
            return ended;
        }
        naps = if any { 0 } else { naps + 1 };
        pause(nap);
    }
}

/// Writes all that has come, beyond the reach of a kill before anybody is told. False when nothing had.
fn drain(
    merge: &mut LogMerger,
    ports: &LoggerPorts,
    line: &mut FaultyChannel<Learning>,
    known: [u64; 3],
    force: bool,
) -> Result<bool, RuntimeError> {
    let mut any = false;
    loop {
        merge.fill(0, known[0], || ports.observation.receive().map(|sample| sample.map(LogRecord::Observation)))?;
        merge.fill(1, known[1], || ports.command.receive().map(|sample| sample.map(LogRecord::Command)))?;
        merge.fill(2, known[2], || read_learning(&ports.learning, line))?;
        if !merge.write_first(force) {
            break;
        }
        any = true;
    }
    merge.flush();
    Ok(any)
}

/// The next learning record that the scenario's faults let through. One that comes out in another tick than its own is not
/// waited for: the log is in the order of ticks.
fn read_learning(
    channel: &Receiver<Learning>,
    line: &mut FaultyChannel<Learning>,
) -> Result<Option<LogRecord>, ChannelError> {
    while let Some(sample) = channel.receive()? {
        let (tick, mut read) = (sample.header.tick, None);
        line.pass(tick, Some(&sample), |out| {
            if out.header.tick == tick {
                read = Some(*out);
            }
        });
        if let Some(sample) = read {
            return Ok(Some(LogRecord::Learning(sample)));
        }
    }
    Ok(None)
}

fn header(session: &Session, time: &TimeSource, past: &LogRecovery) -> LogHeader {
    let participant = &session.participant;
    let (plan, manifest) = (&participant.plan, &participant.manifest);
    let mut header = LogHeader::new(plan, manifest.run_id(), manifest.mode.name(), facts());
    header.segment = LogSegment { number: session.incarnation(), ..past.segment };
    if manifest.mode == Mode::Realtime {
        header.clock = LogClock::Monotonic;
        header.t0_ns = time.scheduled(0);
        header.wall_at_t0_ns = (wall_ns() + header.t0_ns).saturating_sub(monotonic_ns());
        // Every process has left its account before it was ready.
        let accounts = Role::ALL.map(|role| (role, read_realtime(&participant.folder, role)));
        let text = |report| serde_json::to_string(&report).unwrap_or_default();
        header.realtime =
            accounts.into_iter().filter_map(|(role, report)| Some((role.name().to_owned(), text(report?)))).collect();
    }
    header
}
