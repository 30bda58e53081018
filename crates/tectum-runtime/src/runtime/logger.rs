//! The logger's loop: receives all samples of the run, merges them by tick, and writes them into one log.
//!
//! A restarted logger writes a new segment of the log (see [`crate::log`]). It takes over the account that the logger
//! before it left, reads what was written after it, and states which samples are missing between the existing segments
//! and the first sample that it receives. When the disk is full, it continues to receive, so that no process waits for
//! it in vain, and closes the log with a statement of the samples that are missing.

use std::collections::BTreeMap;

use super::faults::FaultyChannel;
use super::log_rotator::LogRotator;
use super::merge::{LogMerger, MergeOutcome};
use super::{
    ControllerReport, LoggerReport, Mode, Participant, PlantReport, ResumePoint, RuntimeError, Session, StartPoint,
    judge, read_columns, read_realtime, read_report,
};
use crate::channel::{LogTail, LoggerPorts};
use crate::clock::{TimeSource, machine_facts, monotonic_ns, pause, wall_ns};
use crate::log::{
    ACCOUNT_EVERY, AccountKeeper, LogClock, LogHeader, LogRecord, LogRecovery, LogSegment, LogWriter,
    segment_number_of, segment_path, segments,
};
use crate::scenario::FaultChannel;
use crate::wire::{Header, Learning, ProcessState, Role, Status};

/// The progress of plant and controller, read from the boards of their current incarnations.
struct SenderProgress {
    /// Status of plant and controller.
    boards: [Status; 2],
    /// Samples sent on observation, command and learning.
    sent: [u64; 3],
}

impl SenderProgress {
    /// Reads the boards of the incarnations that have, or will have, the roles now.
    fn update(&mut self, ports: &mut LoggerPorts, session: &Session) -> Result<(), RuntimeError> {
        ports.plant.set_incarnation(session.incarnation_of(Role::Plant))?;
        ports.controller.set_incarnation(session.incarnation_of(Role::Controller))?;
        self.boards = [ports.plant.get(), ports.controller.get()];
        // The board of a restarted process is empty at first, so the count must not decrease.
        let [plant, controller] = self.boards.map(|board| board.sent);
        for (sent, now) in self.sent.iter_mut().zip([plant, controller, controller]) {
            *sent = now.max(*sent);
        }
        Ok(())
    }

    /// Whether both senders have finished, or will not return.
    fn finished(&self, session: &Session) -> bool {
        let senders = [Role::Plant, Role::Controller];
        senders
            .iter()
            .zip(&self.boards)
            .all(|(&role, board)| board.state() == ProcessState::Finished || session.is_gone(role))
    }
}

/// The logger's loop.
///
/// # Errors
/// When the process does not fit the run, the log cannot be created, or the run ends abnormally. The log is
/// closed wherever that is possible. A log that can no longer be written is no error of the loop; the report
/// states it.
pub fn run_logger(participant: Participant) -> Result<LoggerReport, RuntimeError> {
    let (mut ports, status_board) = participant.open(LoggerPorts::open)?;
    let (mut session, time) = participant.begin(status_board, || Ok(true))?;
    let folder = session.participant.folder.clone();
    let recovered = recover(&session);
    // What the log has already is still in the rings.
    let begins = recovered.segment.begins;
    ports.observation.skip_while(|sample| sample.header.sequence < begins[0]);
    ports.command.skip_while(|sample| sample.header.sequence < begins[1]);
    ports.learning.skip_while(|sample| sample.header.sequence < begins[2]);
    let mut merger = open_log(&session, &time, &recovered)?;
    let mut senders = SenderProgress { boards: Default::default(), sent: [0; 3] };

    let ended = follow(&mut merger, &mut ports, &mut senders, &mut session, &time);
    session.enter(ProcessState::Closing);
    let last = merger.path().unwrap_or_else(|| segment_path(&folder, session.incarnation()));
    let complete = senders.boards[Role::Plant as usize].ticks >= session.participant.plan.scenario.ticks;
    let MergeOutcome { totals, written, failure, timings, bytes, removed, closed } =
        merger.close(senders.sent, complete, warnings(&session, &senders));
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
        // Of a segment that could not be closed, what is there.
        bytes: if session.participant.plan.scenario.log.rotate.is_some() { closed } else { recovered.bytes }
            + bytes.unwrap_or_else(|| std::fs::metadata(&last).map_or(0, |file| file.len())),
        removed_segments: removed,
        reread: recovered.read,
        wake_up_lateness,
        observation_to_command,
        command_to_applied,
    };
    session.finish(&report)?;
    check_losses(&session, &time, &report)?;
    Ok(report)
}

/// What did not go well in the run, a sentence for each name. Plant and controller have left their reports by the time
/// at which they have finished; of a run that ends otherwise, the launcher's summary tells.
fn warnings(session: &Session, senders: &SenderProgress) -> BTreeMap<String, String> {
    let participant = &session.participant;
    let plant: Option<PlantReport> = read_report(&participant.folder, Role::Plant);
    let finished = senders.boards.iter().all(|board| board.state() == ProcessState::Finished);
    let Some(plant) = plant.filter(|_| finished) else { return BTreeMap::new() };
    let controller: Option<ControllerReport> = read_report(&participant.folder, Role::Controller);
    let warnings = judge(&participant.plan, &plant, controller.as_ref());
    warnings.into_iter().map(|warning| (warning.key(), warning.text)).collect()
}

/// What the log already contains: the segments of earlier incarnations, from the point at which the run
/// resumes.
fn recover(session: &Session) -> LogRecovery {
    let participant = &session.participant;
    let period_ns = participant.plan.period_ns;
    let recovered = match &participant.manifest.resumed {
        Some(ResumePoint { tick, sequences: [observation, answer], .. }) => {
            LogRecovery::none(period_ns, [*observation, *answer, *answer], *tick)
        }
        None => LogRecovery::none(period_ns, [0; 3], 0),
    };
    match session.incarnation() {
        0 => recovered,
        _ => recovered.with(&participant.folder, || session.publish_status()),
    }
}

/// Creates this incarnation's segment of the log.
fn open_log(session: &Session, time: &TimeSource, recovered: &LogRecovery) -> Result<LogMerger, RuntimeError> {
    let header = header(session, time, recovered);
    let participant = &session.participant;
    let first_tick = recovered.last_ticks.into_iter().flatten().max().map_or(0, |tick| tick + 1);
    let rotator = LogRotator::of(&participant.plan, &participant.folder, &header, first_tick);
    let log = LogWriter::create(&segment_path(&participant.folder, header.segment.number), &header);
    match log {
        // A log exists already. Without room for another segment, the run goes on, so that nothing waits for
        // the logger.
        Err(error) if session.incarnation() > 0 && error.is_full() => {
            Ok(LogMerger::new(Err(error), recovered, header.every, time.is_real()))
        }
        log => {
            let keeper = AccountKeeper::new(&participant.folder, header.run_text(), ACCOUNT_EVERY);
            let merger = LogMerger::new(Ok(log?), recovered, header.every, time.is_real());
            Ok(merger.accounting(keeper).rotating(rotator))
        }
    }
}

/// In lockstep the plant waits for the logger, so lost samples are a bug of this program, unless a process was
/// restarted, the disk was full, or the scenario injects faults.
fn check_losses(session: &Session, time: &TimeSource, report: &LoggerReport) -> Result<(), RuntimeError> {
    let restarted = Role::ALL.iter().any(|&role| session.incarnation_of(role) > 0);
    let faulty =
        session.participant.plan.scenario.faults.channel.iter().any(|fault| fault.channel == FaultChannel::Learning);
    let excused = time.is_real() || restarted || faulty || report.failure.is_some();
    if let (false, Some(i)) = (excused, report.lost.iter().position(|&lost| lost > 0)) {
        let channel = ["observation", "command", "learning"][i].to_owned();
        return Err(RuntimeError::Lost { channel, lost: report.lost[i] });
    }
    Ok(())
}

/// How long the logger sleeps between two polls, ns, and how often it may find nothing until it writes a tick without
/// the samples that have not arrived.
///
/// No process waits for a particular sample to be logged, so the logger polls instead of being woken: often enough to
/// stay far from the end of its buffer, and seldom enough to cost nothing. What it has not taken yet waits in rings
/// that outlive it. In lockstep a poll costs as much as some ticks, and takes their core; a ring holds what the fastest
/// run does in several milliseconds.
fn pace(period_ns: u64, real: bool) -> (u64, u64) {
    const LOCKSTEP_NS: u64 = 1_000_000;
    const SHORTEST_NS: u64 = 200_000;
    if !real {
        return (LOCKSTEP_NS, u64::MAX);
    }
    let poll_ns = (4 * period_ns).clamp(SHORTEST_NS, 200_000_000);
    // A sample may never arrive. Two periods are enough, and with short ones the writer may be held up for some.
    let patience_ns = (2 * period_ns).max(8 * period_ns.clamp(SHORTEST_NS, 50_000_000));
    (poll_ns, patience_ns.div_ceil(poll_ns))
}

/// Receives and writes until both senders have finished and everything is written.
fn follow(
    merger: &mut LogMerger,
    ports: &mut LoggerPorts,
    senders: &mut SenderProgress,
    session: &mut Session,
    time: &TimeSource,
) -> Result<(), RuntimeError> {
    let real = time.is_real();
    let (poll_ns, max_idle_polls) = pace(session.participant.plan.period_ns, real);
    let mut idle_polls = 0;
    let mut learning = FaultyChannel::of(&session.participant.plan);
    let by_ticks = !real && learning.is_fault_free();
    if by_ticks && merger.is_thinned() {
        ports.take_singly();
    }
    let sync_ns = session.participant.plan.scenario.log.sync_s.map(|seconds| (1e9 * seconds) as u64);
    let mut synced = monotonic_ns();
    loop {
        senders.update(ports, session)?;
        let ended = session.check();
        let last = senders.finished(session) || ended.is_err();
        let force = last || (real && idle_polls >= max_idle_polls);
        // In lockstep a sample's sequence number is its tick.
        let known = if real { [0; 3] } else { senders.sent };
        let any = drain(merger, ports, &mut learning, by_ticks, known, force);
        if sync_ns.is_some_and(|every| monotonic_ns() - synced >= every) {
            merger.sync();
            synced = monotonic_ns();
        }
        session.status.consumed = merger.consumed();
        session.status.ticks = session.status.consumed;
        session.status.lost = merger.inputs.iter().map(|input| input.lost).sum();
        session.publish_status();
        if last {
            return ended;
        }
        idle_polls = if any { 0 } else { idle_polls + 1 };
        pause(poll_ns);
    }
}

/// Writes all samples that have arrived and flushes them, so that a kill after the status is published loses none of
/// them; with `by_ticks`, whole ticks at once where that is possible. Returns false when none had arrived.
fn drain(
    merger: &mut LogMerger,
    ports: &mut LoggerPorts,
    learning: &mut FaultyChannel<Learning>,
    by_ticks: bool,
    known: [u64; 3],
    force: bool,
) -> bool {
    let mut any = false;
    loop {
        // What is left of a tick is written before anything of the next one is received.
        if by_ticks && merger.write_first(false) {
            any = true;
            continue;
        }
        if by_ticks && pass_over(merger, ports) && !force {
            break;
        }
        if by_ticks && write_tick(merger, ports) {
            any = true;
            continue;
        }
        merger.fill(0, known[0], || ports.observation.receive().map(LogRecord::Observation));
        merger.fill(1, known[1], || ports.command.receive().map(LogRecord::Command));
        merger.fill(2, known[2], || receive_learning(&mut ports.learning, learning));
        if !merger.write_first(force) {
            break;
        }
        any = true;
    }
    merger.flush();
    any
}

/// Writes the next tick, if all its samples are there.
fn write_tick(merger: &mut LogMerger, ports: &mut LoggerPorts) -> bool {
    let LoggerPorts { observation, command, learning, .. } = ports;
    let written = match (observation.front(), command.front(), learning.front()) {
        (Some(observation), Some(command), Some(learning)) => merger.write_tick(observation, command, learning),
        _ => false,
    };
    if written {
        observation.pop_front();
        command.pop_front();
        learning.pop_front();
    }
    written
}

/// Most ticks that are passed over at once, and so that may wait for the next poll: far fewer than the plant may be
/// ahead of the logger.
const MOST_PASSED_OVER: u64 = 128;

/// Passes over the ticks that are not logged, unread. Where the sample after them has the sequence number of its tick,
/// no sample is missing before it and none was sent twice. Returns whether it has not arrived yet.
fn pass_over(merger: &mut LogMerger, ports: &mut LoggerPorts) -> bool {
    loop {
        let count = merger.unlogged_ticks().min(MOST_PASSED_OVER);
        if count == 0 {
            return false;
        }
        let LoggerPorts { observation, command, learning, .. } = ports;
        if observation.waiting().min(command.waiting()).min(learning.waiting()) <= count {
            return true;
        }
        let next = merger.expected() + count;
        let is_next = |header: Header| (header.tick, header.sequence) == (next, next);
        let follow = observation.peek(count).is_some_and(|sample| is_next(sample.header))
            && command.peek(count).is_some_and(|sample| is_next(sample.header))
            && learning.peek(count).is_some_and(|sample| is_next(sample.header));
        if !follow {
            return false;
        }
        observation.pass_over(count);
        command.pass_over(count);
        learning.pass_over(count);
        merger.leave_out(count);
    }
}

/// The next learning record that the scenario's faults let pass. A record that they delay beyond its tick is
/// not logged, because the log is in the order of ticks.
fn receive_learning(ring: &mut LogTail<Learning>, faulty: &mut FaultyChannel<Learning>) -> Option<LogRecord> {
    while let Some(sample) = ring.receive() {
        let (tick, mut received) = (sample.header.tick, None);
        faulty.pass(tick, Some(&sample), |out| {
            if out.header.tick == tick {
                received = Some(*out);
            }
        });
        if let Some(sample) = received {
            return Some(LogRecord::Learning(sample));
        }
    }
    None
}

/// The header of this incarnation's segment.
fn header(session: &Session, time: &TimeSource, recovered: &LogRecovery) -> LogHeader {
    let participant = &session.participant;
    let (plan, manifest) = (&participant.plan, &participant.manifest);
    let mut header = LogHeader::new(plan, manifest.run_id(), manifest.mode.name(), machine_facts());
    // The controller has written them before it was ready.
    header.columns = read_columns(&participant.folder);
    if let Some(StartPoint { source, tick, check }) = &manifest.started_from {
        let facts = [("", source.clone()), (".tick", tick.to_string()), (".check", check.clone())];
        header.beginning = facts.into_iter().map(|(key, value)| (format!("started_from{key}"), value)).collect();
    }
    if manifest.frozen {
        header.beginning.insert("frozen".to_owned(), "true".to_owned());
    }
    // Where the log is rotated, more segments than loggers may be there.
    let newest = segments(&participant.folder).last().and_then(|path| segment_number_of(path));
    let number = newest.map_or(0, |number| number + 1).max(session.incarnation());
    header.segment = LogSegment { number, ..recovered.segment };
    // A part of a run that goes on with another one begins when it was launched, at its own first tick.
    let first_ns = manifest.resumed.as_ref().map_or(0, |resumed| resumed.tick * participant.plan.period_ns);
    header.wall_at_t0_ns = manifest.launched_wall_ns.saturating_sub(first_ns);
    if manifest.mode == Mode::Realtime {
        header.clock = LogClock::Monotonic;
        header.t0_ns = time.scheduled(0);
        header.wall_at_t0_ns = (wall_ns() + header.t0_ns).saturating_sub(monotonic_ns());
        // Every process has written its real-time settings before it was ready.
        let reports = Role::ALL.map(|role| (role, read_realtime(&participant.folder, role)));
        let text = |report| serde_json::to_string(&report).unwrap_or_default();
        header.realtime =
            reports.into_iter().filter_map(|(role, report)| Some((role.name().to_owned(), text(report?)))).collect();
    }
    header
}

#[cfg(test)]
mod tests {
    use super::pace;

    /// In real time: far less than a ring holds between two polls, and a missing sample is waited for as long whatever
    /// the pace is.
    #[test]
    fn polls_are_rare_and_rings_do_not_overflow() {
        for (period_ms, poll_ms, polls) in [(0.05, 0.2, 8), (1.0, 4.0, 2), (50.0, 200.0, 2), (1000.0, 200.0, 10)] {
            let (poll_ns, idle) = pace((1e6 * period_ms) as u64, true);
            assert_eq!((poll_ns, idle), ((1e6 * poll_ms) as u64, polls), "{period_ms}");
            assert!(poll_ms / period_ms <= 4.0);
        }
        assert_eq!(pace(50_000_000, false).0, 1_000_000);
    }
}
