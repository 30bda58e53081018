//! The logger's loop: everything that the others send, merged by tick, into one file.

use super::{Card, LoggerReport, Mode, Resumed, RuntimeError, Seat, Session, read_realtime};
use crate::channel::{LoggerPorts, Receiver};
use crate::clock::{TimeSource, facts, monotonic_ns, pause, wall_ns};
use crate::log::{Clock, LogError, LogHeader, LogWriter, Record, Totals};
use crate::wire::{Command, Gap, Header, Learning, Observation, Role, State};

/// One channel on its way into the log.
struct Lane {
    /// 0 observation, 1 command, 2 learning.
    channel: u64,
    /// Received and not yet written.
    head: Option<Record>,
    /// Sequence number of the next sample.
    expected: u64,
    /// The tick received last.
    last: Option<u64>,
    lost: u64,
    thinned: u64,
}

impl Lane {
    fn new(channel: u64) -> Self {
        Self { channel, head: None, expected: 0, last: None, lost: 0, thinned: 0 }
    }

    /// Receives into an empty head. A gap in the sequence numbers is returned, to be written before the sample.
    fn fill<T: Copy + crate::channel::Payload>(
        &mut self,
        receiver: &Receiver<T>,
        header: impl Fn(&T) -> &Header,
        record: impl Fn(T) -> Record,
    ) -> Result<Option<Gap>, RuntimeError> {
        if self.head.is_some() {
            return Ok(None);
        }
        let Some(sample) = receiver.receive()? else { return Ok(None) };
        let header = header(&sample);
        let gap = self.gap_until(header.sequence);
        self.expected = header.sequence + 1;
        self.last = Some(header.tick);
        self.head = Some(record(sample));
        Ok(gap)
    }

    /// Counts the samples from the expected one up to but without `sequence` as lost.
    fn gap_until(&mut self, sequence: u64) -> Option<Gap> {
        let (first, count) = (self.expected, sequence.saturating_sub(self.expected));
        self.lost += count;
        self.expected = self.expected.max(sequence);
        (count > 0).then_some(Gap { channel: self.channel, first, count, total: self.lost })
    }

    fn consumed(&self) -> u64 {
        self.last.map_or(0, |tick| tick + 1)
    }
}

fn tick_of(record: &Record) -> u64 {
    match record {
        Record::Observation(s) => s.header.tick,
        Record::Command(s) => s.header.tick,
        Record::Learning(s) => s.header.tick,
        Record::Gap(_) => 0,
    }
}

/// The head that comes first by (tick, channel).
#[derive(Debug, PartialEq)]
struct First {
    tick: u64,
    lane: usize,
    /// No sample that belongs before it can still come: every other lane has a later head, or has had the tick.
    settled: bool,
}

fn first(lanes: &[Lane; 3]) -> Option<First> {
    let heads = lanes.iter().enumerate().filter_map(|(i, lane)| Some((tick_of(lane.head.as_ref()?), i)));
    let (tick, lane) = heads.min()?;
    let settled = lanes.iter().all(|lane| lane.head.is_some() || lane.last.is_some_and(|last| last >= tick));
    Some(First { tick, lane, settled })
}

/// The three lanes and the file.
struct Merge {
    lanes: [Lane; 3],
    log: LogWriter,
    every: u64,
}

impl Merge {
    /// Fills empty heads from the channels.
    fn receive(&mut self, ports: &LoggerPorts) -> Result<(), RuntimeError> {
        let [a, b, c] = &mut self.lanes;
        let gaps = [
            a.fill(&ports.observation, |s: &Observation| &s.header, Record::Observation)?,
            b.fill(&ports.command, |s: &Command| &s.header, Record::Command)?,
            c.fill(&ports.learning, |s: &Learning| &s.header, Record::Learning)?,
        ];
        for gap in gaps.iter().flatten() {
            self.log.gap(gap)?;
        }
        Ok(())
    }

    /// Writes the head that comes first, if no earlier sample can still come; with `force` in any case. False when there
    /// was nothing to write.
    fn write_first(&mut self, force: bool) -> Result<bool, LogError> {
        let Some(First { tick, lane: first, settled }) = first(&self.lanes) else { return Ok(false) };
        if !settled && !force {
            return Ok(false);
        }
        let lane = &mut self.lanes[first];
        if let Some(record) = lane.head.take() {
            if tick.is_multiple_of(self.every) {
                self.log.append(&record)?;
            } else {
                lane.thinned += 1;
            }
        }
        Ok(true)
    }

    /// Writes all that has come. False when nothing had.
    fn drain(&mut self, ports: &LoggerPorts, force: bool) -> Result<bool, RuntimeError> {
        let mut any = false;
        loop {
            self.receive(ports)?;
            if !self.write_first(force)? {
                return Ok(any);
            }
            any = true;
        }
    }

    fn consumed(&self) -> u64 {
        self.lanes.iter().map(Lane::consumed).min().unwrap_or(0)
    }

    /// What was sent and never came, by the senders' own account.
    fn count_missing(&mut self, sent: [u64; 3]) -> Result<(), LogError> {
        for (lane, sent) in self.lanes.iter_mut().zip(sent) {
            if let Some(gap) = lane.gap_until(sent) {
                self.log.gap(&gap)?;
            }
        }
        Ok(())
    }
}

/// The logger's loop.
///
/// # Errors
/// When the process does not fit the run, the log cannot be written, or the run ends in disorder; the log is closed in
/// every case in which that is possible.
pub fn run_logger(seat: Seat) -> Result<LoggerReport, RuntimeError> {
    let (mut ports, desk) = seat.open(LoggerPorts::open)?;
    let (mut session, time) = seat.begin(desk, || {
        let channels = [ports.observation.connect()?, ports.command.connect()?, ports.learning.connect()?];
        Ok(channels.iter().all(|&writers| writers >= 1))
    })?;
    let path = Card::log_path(&session.seat.folder);
    let header = header(&session.seat, &time);
    let log = LogWriter::create(&path, &header)?;
    let mut merge = Merge { lanes: [0, 1, 2].map(Lane::new), log, every: header.every };

    if let Some(Resumed { tick, sequences: [observation, answer], .. }) = session.seat.card.resumed {
        for (lane, sequence) in merge.lanes.iter_mut().zip([observation, answer, answer]) {
            lane.expected = sequence;
        }
        session.status.consumed = tick;
    }
    if session.incarnation() > 0 {
        // What was sent before is lost to this start of the logger; nobody need wait for it.
        session.status.consumed = ports.plant.get().ticks;
    }
    session.show();

    let ended = follow(&mut merge, &mut ports, &mut session, &time);
    if let Err(RuntimeError::Log(error)) = ended {
        // Nothing more can be written; what is there stays readable.
        return Err(error.into());
    }
    let (plant, controller) = (ports.plant.get(), ports.controller.get());
    merge.count_missing([plant.sent, controller.sent, controller.sent])?;
    let lanes = &merge.lanes;
    let totals = Totals {
        lost: lanes.each_ref().map(|lane| lane.lost),
        thinned: lanes.each_ref().map(|lane| lane.thinned),
        last_tick: lanes.iter().filter_map(|lane| lane.last).max(),
        complete: plant.ticks >= session.seat.plan.scenario.ticks,
    };
    let summary = merge.log.finish(&totals)?;
    ended?;
    let [observation, command, learning, _] = summary.written;
    let report = LoggerReport {
        written: [observation, command, learning],
        lost: totals.lost,
        thinned: totals.thinned,
        bytes: summary.bytes,
    };
    session.finish(&report)?;
    // In lockstep the plant waits for the logger: a loss there is a fault of this program.
    if let (false, Some(i)) = (time.is_real(), totals.lost.iter().position(|&lost| lost > 0)) {
        let channel = ["observation", "command", "learning"][i].to_owned();
        return Err(RuntimeError::Lost { channel, lost: totals.lost[i] });
    }
    Ok(report)
}

/// Writes until both senders have finished and everything is written.
fn follow(
    merge: &mut Merge,
    ports: &mut LoggerPorts,
    session: &mut Session,
    time: &TimeSource,
) -> Result<(), RuntimeError> {
    // Nobody waits for the logger, so it looks in now and then instead of being woken: often enough to keep far from its
    // buffer's end, seldom enough to cost nothing.
    let real = time.is_real();
    let nap = if real { (session.seat.plan.period_ns / 4).clamp(200_000, 10_000_000) } else { 200_000 };
    // In real time a sample may never come; two periods later its tick is written without it.
    let patience = (2 * session.seat.plan.period_ns / nap).max(8);
    let mut naps = 0;
    loop {
        ports.plant.turn_to(session.incarnation_of(Role::Plant))?;
        ports.controller.turn_to(session.incarnation_of(Role::Controller))?;
        let over = [&ports.plant, &ports.controller].iter().all(|board| board.get().state() == State::Finished);
        let ended = session.check();
        let last = over || ended.is_err();
        let force = last || (real && naps >= patience);
        let any = merge.drain(ports, force)?;
        session.status.consumed = session.status.consumed.max(merge.consumed());
        session.status.lost = merge.lanes.iter().map(|lane| lane.lost).sum();
        session.show();
        if last {
            return ended;
        }
        naps = if any { 0 } else { naps + 1 };
        pause(nap);
    }
}

fn header(seat: &Seat, time: &TimeSource) -> LogHeader {
    let (plan, card) = (&seat.plan, &seat.card);
    let mut header = LogHeader::new(plan, card.run_id(), card.mode.name(), facts());
    if card.mode == Mode::Realtime {
        header.clock = Clock::Monotonic;
        header.t0_ns = time.scheduled(0);
        header.wall_at_t0_ns = (wall_ns() + header.t0_ns).saturating_sub(monotonic_ns());
        // Every process has left its account before it was ready.
        let accounts = Role::ALL.map(|role| (role, read_realtime(&seat.folder, role)));
        let text = |report| serde_json::to_string(&report).unwrap_or_default();
        header.realtime =
            accounts.into_iter().filter_map(|(role, report)| Some((role.name().to_owned(), text(report?)))).collect();
    }
    header
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A lane that received `last` last and still holds it, or not.
    fn lane(channel: u64, last: Option<u64>, held: bool) -> Lane {
        let head = last.filter(|_| held).map(|tick| {
            let mut sample = Learning::default();
            sample.header.tick = tick;
            Record::Learning(sample)
        });
        Lane { head, last, ..Lane::new(channel) }
    }

    #[test]
    fn a_sample_waits_for_those_that_belong_before_it() {
        let lanes = |a, b, c| [a, b, c];
        // The command of tick 5 is there, its observation is not yet.
        let early = lanes(lane(0, Some(4), false), lane(1, Some(5), true), lane(2, Some(4), false));
        assert_eq!(first(&early), Some(First { tick: 5, lane: 1, settled: false }));
        // With the observation there, that one comes first, and nothing of tick 4 is missing.
        let both = lanes(lane(0, Some(5), true), lane(1, Some(5), true), lane(2, Some(5), true));
        assert_eq!(first(&both), Some(First { tick: 5, lane: 0, settled: true }));
        // Observation and command of tick 5 are written; the next observation may be a while.
        let last = lanes(lane(0, Some(5), false), lane(1, Some(5), false), lane(2, Some(5), true));
        assert_eq!(first(&last), Some(First { tick: 5, lane: 2, settled: true }));
        // At the start nothing is known of the others.
        let start = lanes(lane(0, Some(0), true), lane(1, None, false), lane(2, None, false));
        assert_eq!(first(&start), Some(First { tick: 0, lane: 0, settled: false }));
        assert_eq!(first(&[0, 1, 2].map(Lane::new)), None);
    }

    #[test]
    fn gaps_are_counted_once_and_added_up() {
        let mut lane = Lane::new(2);
        assert_eq!(lane.gap_until(0), None);
        lane.expected = 4;
        assert_eq!(lane.gap_until(7), Some(Gap { channel: 2, first: 4, count: 3, total: 3 }));
        assert_eq!(lane.gap_until(7), None);
        assert_eq!(lane.gap_until(8), Some(Gap { channel: 2, first: 7, count: 1, total: 4 }));
    }
}
