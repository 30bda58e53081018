//! Three channels on their way into one log: merged by tick, each sample once, and what is missing stated.
//!
//! Without channels and clock: the logger's loop hands in what it receives. A logger that comes back goes on from what the log
//! holds ([`LogRecovery`]); a log that takes nothing more (its disk is full) does not hold up those whose samples it would have held.

use crate::log::{LatencyHistograms, LogError, LogRecord, LogRecovery, LogTotals, LogWriter};
use crate::wire::{Gap, Header};

/// One channel on its way into the log.
#[derive(Debug, Clone, Default)]
pub(super) struct MergeInput {
    /// 0 observation, 1 command, 2 learning.
    channel: u64,
    /// Received and not yet written.
    head: Option<LogRecord>,
    /// Sequence number of the run's first sample.
    first: u64,
    /// Sequence number of the next one.
    expected: u64,
    /// The last tick received.
    last: Option<u64>,
    /// No sample of this tick or an earlier one will still come.
    through: Option<u64>,
    /// Sequence number of the first sample that the log did not take.
    missing_since: Option<u64>,
    pub lost: u64,
    pub thinned: u64,
    pub duplicates: u64,
}

impl MergeInput {
    fn after(past: &LogRecovery, i: usize) -> Self {
        Self {
            channel: i as u64,
            first: past.segment.first(i),
            expected: past.segment.begins[i],
            last: past.last_ticks[i],
            through: past.last_ticks[i],
            lost: past.segment.lost[i],
            thinned: past.segment.thinned[i],
            duplicates: past.segment.duplicates[i],
            ..Self::default()
        }
    }

    /// Takes a sample into the empty head; gives what is to be stated before it. A sample that the channel has had, or a later
    /// one, is dropped: a process that was started anew says again what it had said last.
    fn accept(&mut self, header: &Header, record: &LogRecord) -> Option<Gap> {
        if header.sequence < self.expected {
            self.duplicates += 1;
            return None;
        }
        let gap = self.gap_until(header.sequence);
        self.expected = header.sequence.saturating_add(1);
        self.last = self.last.max(Some(header.tick));
        self.through = self.through.max(self.last);
        self.head = Some(*record);
        gap
    }

    /// Counts the samples from the expected one up to but without `sequence` as lost. A log that takes nothing more states
    /// at its end all that it lacks.
    fn gap_until(&mut self, sequence: u64) -> Option<Gap> {
        let (first, count) = (self.expected, sequence.saturating_sub(self.expected));
        self.expected = self.expected.max(sequence);
        if self.missing_since.is_some() || count == 0 {
            return None;
        }
        self.lost += count;
        Some(Gap { channel: self.channel, first, count, total: self.lost })
    }

    /// From here on, nothing is written.
    fn close(&mut self) {
        let waiting = self.head.as_ref().and_then(LogRecord::header).map(|header| header.sequence);
        self.missing_since = Some(waiting.unwrap_or(self.expected));
    }

    /// The run is over, and `sent` samples were sent: what is missing behind all that was written.
    fn end(&mut self, sent: u64) -> Option<Gap> {
        let end = self.expected.max(sent);
        if let Some(first) = self.missing_since.take() {
            self.expected = first;
        }
        self.gap_until(end)
    }

    fn consumed(&self) -> u64 {
        self.through.map_or(0, |tick| tick + 1)
    }
}

/// The head that comes first by (tick, channel).
#[derive(Debug, PartialEq)]
struct NextHead {
    tick: u64,
    lane: usize,
    /// No sample that belongs before it can still come: every other lane has a later head, or has had the tick.
    settled: bool,
}

fn first(lanes: &[MergeInput; 3]) -> Option<NextHead> {
    let tick_of = |lane: &MergeInput| Some(lane.head.as_ref()?.header()?.tick);
    let heads = lanes.iter().enumerate().filter_map(|(i, lane)| Some((tick_of(lane)?, i)));
    let (tick, lane) = heads.min()?;
    let settled = lanes.iter().all(|lane| lane.head.is_some() || lane.through.is_some_and(|through| through >= tick));
    Some(NextHead { tick, lane, settled })
}

/// The three lanes and the log.
pub(super) struct LogMerger {
    pub lanes: [MergeInput; 3],
    /// `None` once it could not be written any more, or could not be made for want of room.
    log: Option<LogWriter>,
    every: u64,
    /// Real time: the durations of the ticks.
    timings: Option<LatencyHistograms>,
    /// The tick from which on samples are missing because the log did not take them.
    missing_from: Option<u64>,
    /// Why it did not.
    failure: Option<String>,
}

/// What came of a log.
#[derive(Debug, Clone)]
pub(super) struct MergeOutcome {
    /// The run's, with all segments.
    pub totals: LogTotals,
    /// Samples written, with all segments.
    pub written: [u64; 3],
    pub failure: Option<String>,
    pub timings: Option<LatencyHistograms>,
}

impl LogMerger {
    /// Goes on from `past`, into `log`; without one, for the reason given, everything from now on is missing.
    pub fn new(log: Result<LogWriter, LogError>, past: &LogRecovery, every: u64, real: bool) -> Self {
        let mut merge = Self {
            lanes: [0, 1, 2].map(|i| MergeInput::after(past, i)),
            log: None,
            every,
            timings: real.then(|| past.timings.clone()),
            missing_from: past.missing_from,
            failure: None,
        };
        match log {
            Ok(log) => merge.log = Some(log),
            Err(error) => merge.give_up(merge.consumed(), &error),
        }
        merge
    }

    /// Fills the head of lane `i`, if it is empty, with what `receive` gives. In lockstep, all samples of ticks before
    /// `known` had been sent before the call: those that are not there will not come.
    pub fn fill<E>(
        &mut self,
        i: usize,
        known: u64,
        mut receive: impl FnMut() -> Result<Option<LogRecord>, E>,
    ) -> Result<(), E> {
        let lane = &mut self.lanes[i];
        while lane.head.is_none() {
            let Some(record) = receive()? else {
                lane.through = lane.through.max(known.checked_sub(1));
                return Ok(());
            };
            let Some(header) = record.header() else { continue };
            if let Some(gap) = lane.accept(header, &record)
                && let Some(log) = &mut self.log
                && let Err(error) = log.gap(&gap)
            {
                self.give_up(header.tick, &error);
                return Ok(());
            }
        }
        Ok(())
    }

    /// Writes the head that comes first, if no earlier sample can still come; with `force` in any case. False when there
    /// was nothing to write.
    pub fn write_first(&mut self, force: bool) -> bool {
        let Some(NextHead { tick, lane: first, settled }) = first(&self.lanes) else { return false };
        if !settled && !force {
            return false;
        }
        let lane = &mut self.lanes[first];
        let Some(record) = &lane.head else { return false };
        if let Some(timings) = &mut self.timings {
            timings.take(record);
        }
        if lane.missing_since.is_none() {
            if !tick.is_multiple_of(self.every) {
                lane.thinned += 1;
            } else if let Some(Err(error)) = self.log.as_mut().map(|log| log.append(record)) {
                self.give_up(tick, &error);
            }
        }
        self.lanes[first].head = None;
        true
    }

    /// Hands all that was written to the operating system: a kill cannot take it back.
    pub fn flush(&mut self) {
        if let Some(Err(error)) = self.log.as_mut().map(LogWriter::flush) {
            self.give_up(self.consumed(), &error);
        }
    }

    /// The log takes nothing more from `tick` on. Those who are waited for go on all the same.
    fn give_up(&mut self, tick: u64, error: &LogError) {
        self.failure.get_or_insert_with(|| error.to_string());
        self.lanes.iter_mut().filter(|lane| lane.missing_since.is_none()).for_each(MergeInput::close);
        let from = *self.missing_from.get_or_insert(tick);
        let Some(log) = &mut self.log else { return };
        if log.broken() || log.missing_from(from, error).is_err() {
            self.abandon();
        }
    }

    /// Leaves a log that cannot even be closed. What it holds, it says itself: part of what was appended may be gone.
    fn abandon(&mut self) {
        let Some(log) = self.log.take() else { return };
        let path = log.path().to_owned();
        drop(log);
        let Ok(held) = LogRecovery::of_torn(&path) else { return };
        for (i, lane) in self.lanes.iter_mut().enumerate() {
            (lane.missing_since, lane.lost) = (Some(held.segment.begins[i]), held.segment.lost[i]);
            lane.thinned = held.segment.thinned[i];
        }
        let whole = held.last_ticks.into_iter().flatten().map(|tick| tick + 1).min();
        self.missing_from = self.missing_from.min(whole.or(self.missing_from));
    }

    /// Every lane has received, or need not wait for, the ticks up to but without this one.
    pub fn consumed(&self) -> u64 {
        self.lanes.iter().map(MergeInput::consumed).min().unwrap_or(0)
    }

    /// States what was sent and never came, by the senders' own account, and closes the log.
    pub fn close(mut self, sent: [u64; 3], complete: bool) -> MergeOutcome {
        let gaps: Vec<Gap> = self.lanes.iter_mut().zip(sent).filter_map(|(lane, sent)| lane.end(sent)).collect();
        let lanes = &self.lanes;
        let totals = LogTotals {
            lost: lanes.each_ref().map(|lane| lane.lost),
            thinned: lanes.each_ref().map(|lane| lane.thinned),
            duplicates: lanes.each_ref().map(|lane| lane.duplicates),
            missing_from: self.missing_from,
            last_tick: lanes.iter().filter_map(|lane| lane.last).max(),
            complete,
        };
        let written = lanes.each_ref().map(|lane| lane.expected.saturating_sub(lane.first + lane.lost + lane.thinned));
        let mut closed = MergeOutcome { totals, written, failure: self.failure, timings: self.timings };
        let Some(mut log) = self.log else { return closed };
        let ended = gaps
            .iter()
            .try_for_each(|gap| log.append(&LogRecord::Gap(*gap)))
            .and_then(|()| closed.timings.as_ref().map_or(Ok(()), |timings| log.timings(timings)))
            .and_then(|()| log.finish(&totals));
        if let Err(error) = ended {
            closed.failure.get_or_insert_with(|| error.to_string());
        }
        closed
    }
}

#[cfg(test)]
mod tests;
