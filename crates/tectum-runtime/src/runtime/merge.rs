//! Merges the samples of the three channels into one log: in the order of ticks, each sample once, with a
//! statement of the missing ones.
//!
//! It knows no channels and no clock: the logger's loop passes in the samples that it receives. A restarted
//! logger continues after the existing log ([`LogRecovery`]). When the log can no longer be written (its disk
//! is full), the merger still consumes samples, so that no process waits for the logger.

use std::collections::BTreeMap;
use std::path::PathBuf;

use super::log_rotator::LogRotator;
use crate::log::{
    AccountKeeper, LatencyHistograms, LogAccount, LogError, LogRecord, LogRecovery, LogSegment, LogTotals, LogWriter,
    segment_number_of,
};
use crate::wire::{Command, Gap, Header, Learning, Observation};

/// One channel's input to the log.
#[derive(Debug, Clone, Default)]
pub(super) struct MergeInput {
    /// 0 observation, 1 command, 2 learning.
    channel: u64,
    /// The sample that was received and is not yet written.
    head: Option<LogRecord>,
    /// Sequence number of the run's first sample.
    first: u64,
    /// Sequence number of the next one.
    expected: u64,
    /// The last tick received.
    last: Option<u64>,
    /// The last tick written or left out.
    done: Option<u64>,
    /// No sample of this tick or an earlier one can still arrive.
    through: Option<u64>,
    /// Sequence number of the first sample that could not be written; `None` while the log can be written.
    missing_since: Option<u64>,
    /// Samples lost.
    pub lost: u64,
    /// Samples left out on purpose.
    pub thinned: u64,
    /// Samples that arrived twice.
    pub duplicates: u64,
}

impl MergeInput {
    /// The input of channel `i`, which continues after the existing log.
    fn after(recovered: &LogRecovery, i: usize) -> Self {
        Self {
            channel: i as u64,
            first: recovered.segment.first(i),
            expected: recovered.segment.begins[i],
            last: recovered.last_ticks[i],
            done: recovered.last_ticks[i],
            through: recovered.last_ticks[i],
            lost: recovered.segment.lost[i],
            thinned: recovered.segment.thinned[i],
            duplicates: recovered.segment.duplicates[i],
            ..Self::default()
        }
    }

    /// Puts a sample into the empty head. Returns the gap that must be stated before it. A sample whose number
    /// is below the expected one is dropped: it is a duplicate that a restarted process has sent again.
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

    /// Counts the samples from the expected one up to but without `sequence` as lost. A log that can no longer
    /// be written states all its missing samples at the end instead.
    fn gap_until(&mut self, sequence: u64) -> Option<Gap> {
        let (first, count) = (self.expected, sequence.saturating_sub(self.expected));
        self.expected = self.expected.max(sequence);
        if self.missing_since.is_some() || count == 0 {
            return None;
        }
        self.lost += count;
        Some(Gap { channel: self.channel, first, count, total: self.lost })
    }

    /// Marks that nothing is written from here on.
    fn stop_writing(&mut self) {
        let waiting = self.head.as_ref().and_then(LogRecord::header).map(|header| header.sequence);
        self.missing_since = Some(waiting.unwrap_or(self.expected));
    }

    /// The run is over, and `sent` samples were sent. Returns the gap after the last written sample.
    fn end(&mut self, sent: u64) -> Option<Gap> {
        let end = self.expected.max(sent);
        if let Some(first) = self.missing_since.take() {
            self.expected = first;
        }
        self.gap_until(end)
    }

    /// The number of ticks of which no sample can still arrive.
    fn consumed(&self) -> u64 {
        self.through.map_or(0, |tick| tick + 1)
    }
}

/// The head that is first in the order of (tick, channel).
#[derive(Debug, PartialEq)]
struct NextHead {
    tick: u64,
    input: usize,
    /// No sample that belongs before it can still arrive: every other input has a later head, or is through the
    /// tick.
    settled: bool,
}

/// Finds the head that is written next.
fn first_head(inputs: &[MergeInput; 3]) -> Option<NextHead> {
    let tick_of = |input: &MergeInput| Some(input.head.as_ref()?.header()?.tick);
    let heads = inputs.iter().enumerate().filter_map(|(i, input)| Some((tick_of(input)?, i)));
    let (tick, input) = heads.min()?;
    let settled =
        inputs.iter().all(|input| input.head.is_some() || input.through.is_some_and(|through| through >= tick));
    Some(NextHead { tick, input, settled })
}

/// The three inputs and the log.
pub(super) struct LogMerger {
    /// Observations, commands and learning records.
    pub inputs: [MergeInput; 3],
    /// `None` when it can no longer be written, or could not be created because the disk is full.
    log: Option<LogWriter>,
    /// The log contains every `every`-th tick.
    every: u64,
    /// In real time: histograms of the ticks' durations.
    timings: Option<LatencyHistograms>,
    /// The tick from which on samples are missing because the log could not be written.
    missing_from: Option<u64>,
    /// Why it could not.
    failure: Option<String>,
    /// What the earlier segments hold, for a log of which nothing is left.
    before: LogSegment,
    /// The first tick of this segment.
    first_tick: u64,
    /// Whether something was written since the last flush.
    unflushed: bool,
    /// Flushes since the log was last compared with what was written.
    unchecked: u32,
    /// The newest tick of which a sample was written or left out.
    written_tick: Option<u64>,
    /// Where the log is to have several segments.
    rotator: Option<LogRotator>,
    /// Leaves the account for the next logger.
    keeper: Option<AccountKeeper>,
}

/// Flushes between two comparisons of the log's file with what was written to it.
const CHECK_EVERY: u32 = 16;

/// The result of a log.
#[derive(Debug, Clone)]
pub(super) struct MergeOutcome {
    /// Totals of the run, over all segments.
    pub totals: LogTotals,
    /// Samples written, over all segments.
    pub written: [u64; 3],
    /// Why the log could not be written or closed.
    pub failure: Option<String>,
    /// In real time: histograms of the ticks' durations.
    pub timings: Option<LatencyHistograms>,
    /// Size of the last segment, if it was closed, bytes.
    pub bytes: Option<u64>,
    /// Number of segments that were removed.
    pub removed: u64,
    /// Size of the segments before the last, where the log is to have several, bytes.
    pub closed: u64,
}

impl LogMerger {
    /// Continues after `recovered`, into `log`. When `log` is an error, all samples from now on are missing.
    pub fn new(log: Result<LogWriter, LogError>, recovered: &LogRecovery, every: u64, real: bool) -> Self {
        let mut merger = Self {
            inputs: [0, 1, 2].map(|i| MergeInput::after(recovered, i)),
            log: None,
            every,
            timings: real.then(|| recovered.timings.clone()),
            missing_from: recovered.missing_from,
            failure: None,
            before: recovered.segment,
            first_tick: recovered.last_ticks.into_iter().min().flatten().map_or(0, |tick| tick + 1),
            unflushed: true,
            unchecked: 0,
            written_tick: None,
            rotator: None,
            keeper: None,
        };
        match log {
            Ok(log) => merger.log = Some(log),
            Err(error) => merger.give_up(merger.consumed(), &error),
        }
        merger
    }

    /// The same merger, whose log goes on in another segment when `rotator` says so. Its keeper of accounts is set
    /// before.
    pub fn rotating(mut self, rotator: Option<LogRotator>) -> Self {
        self.rotator = rotator;
        // A logger that has come back began a segment. Those that die before one is full keep the log's limit, too.
        // First it leaves an account that needs none of the segments before.
        if self.rotator.as_ref().is_some_and(|rotator| rotator.closed_bytes() > 0) {
            self.flush();
        }
        if let (Some(log), Some(rotator)) = (&self.log, &mut self.rotator) {
            rotator.remove_oldest(log.bytes());
        }
        self
    }

    /// The same merger, which leaves its account with `keeper`.
    pub fn accounting(self, keeper: AccountKeeper) -> Self {
        Self { keeper: Some(keeper), ..self }
    }

    /// Fills the head of input `i`, if it is empty, with the next sample from `receive`. In lockstep, all
    /// samples of ticks before `known` had been sent before the call. Those that have not arrived will not
    /// arrive.
    pub fn fill(&mut self, i: usize, known: u64, mut receive: impl FnMut() -> Option<LogRecord>) {
        let input = &mut self.inputs[i];
        while input.head.is_none() {
            let Some(record) = receive() else {
                input.through = input.through.max(known.checked_sub(1));
                return;
            };
            let Some(header) = record.header() else { continue };
            if let Some(gap) = input.accept(header, &record)
                && let Some(log) = &mut self.log
                && let Err(error) = log.gap(&gap)
            {
                self.give_up(header.tick, &error);
                return;
            }
        }
    }

    /// Whether the log contains a part of the ticks only.
    pub fn is_thinned(&self) -> bool {
        self.every > 1
    }

    /// Sequence number of the next observation.
    pub fn expected(&self) -> u64 {
        self.inputs[0].expected
    }

    /// In lockstep, where the log is thinned: the number of ticks before the next one that is logged, if no sample of
    /// them was received yet. 0 where every sample has to be looked at, because something else depends on it.
    pub fn unlogged_ticks(&self) -> u64 {
        let next = self.expected();
        if self.rotator.is_some() || !self.is_between_ticks() { 0 } else { next.next_multiple_of(self.every) - next }
    }

    /// Whether the log can be written, and the next sample of every channel is of the same tick. Never in real time,
    /// where samples are counted for each channel by itself.
    fn is_between_ticks(&self) -> bool {
        let next = self.expected();
        let ready = |input: &MergeInput| input.head.is_none() && input.expected == next;
        let writes = |input: &MergeInput| input.missing_since.is_none();
        self.timings.is_none() && self.inputs.iter().all(|input| ready(input) && writes(input))
    }

    /// In lockstep: writes the samples of a tick that is logged, in place of filling the heads with them. Returns
    /// false, and does nothing, unless they are what comes next on each channel.
    pub fn write_tick(&mut self, observation: &Observation, command: &Command, learning: &Learning) -> bool {
        let tick = self.expected();
        let headers = [&observation.header, &command.header, &learning.header];
        let follow = headers.iter().all(|header| (header.tick, header.sequence) == (tick, tick));
        if !follow || !tick.is_multiple_of(self.every) || !self.is_between_ticks() {
            return false;
        }
        if self.rotates_before(tick) {
            self.rotate(tick);
        }
        let Some(log) = &mut self.log else { return false };
        self.unflushed = true;
        self.written_tick = self.written_tick.max(Some(tick));
        let mut failure = None;
        for input in &mut self.inputs {
            input.expected += 1;
            (input.last, input.through) = (Some(tick), input.through.max(Some(tick)));
            let result = match input.channel {
                _ if failure.is_some() => Ok(()),
                0 => log.append_observation(observation),
                1 => log.append_command(command),
                _ => log.append_learning(learning),
            };
            failure = failure.or(result.err());
            if failure.is_none() {
                input.done = Some(tick);
            } else {
                // Not written, and still to be accounted for.
                input.head = Some(match input.channel {
                    0 => LogRecord::Observation(*observation),
                    1 => LogRecord::Command(*command),
                    _ => LogRecord::Learning(*learning),
                });
            }
        }
        if let Some(error) = failure {
            self.give_up(tick, &error);
        }
        true
    }

    /// Leaves out the next `count` samples of each channel, one a tick, in place of receiving them.
    pub fn leave_out(&mut self, count: u64) {
        for input in &mut self.inputs {
            input.expected += count;
            input.thinned += count;
            let last = input.expected.checked_sub(1);
            (input.last, input.done, input.through) = (last, last, input.through.max(last));
            self.written_tick = self.written_tick.max(last);
        }
    }

    /// Writes the first head, if no earlier sample can still arrive; with `force` in any case. Returns false
    /// when nothing was written.
    pub fn write_first(&mut self, force: bool) -> bool {
        let Some(NextHead { tick, input: first, settled }) = first_head(&self.inputs) else { return false };
        if !settled && !force {
            return false;
        }
        if self.rotates_before(tick) {
            self.rotate(tick);
        }
        self.written_tick = self.written_tick.max(Some(tick));
        let input = &mut self.inputs[first];
        let Some(record) = &input.head else { return false };
        if let Some(timings) = &mut self.timings {
            timings.take(record);
        }
        if input.missing_since.is_none() {
            if !tick.is_multiple_of(self.every) {
                input.thinned += 1;
            } else {
                self.unflushed = true;
                if let Some(Err(error)) = self.log.as_mut().map(|log| log.append(record)) {
                    self.give_up(tick, &error);
                }
            }
        }
        self.inputs[first].head = None;
        self.inputs[first].done = self.inputs[first].done.max(Some(tick));
        true
    }

    /// Passes everything written to the operating system, so that a kill cannot lose it.
    pub fn flush(&mut self) {
        self.unchecked += 1;
        let check = self.unchecked >= CHECK_EVERY;
        self.unchecked *= u32::from(!check);
        // Most polls of a thinned log find nothing to write.
        if !std::mem::take(&mut self.unflushed) && !check {
            return;
        }
        let Some(log) = &mut self.log else { return };
        if let Err(error) = log.flush().and_then(|()| if check { log.check_in_place() } else { Ok(()) }) {
            self.give_up(self.consumed(), &error);
        }
        self.keep_account();
    }

    /// Leaves the account where one is due. What could not be written belongs into no account.
    fn keep_account(&mut self) {
        let (Some(keeper), Some(log), None) = (&self.keeper, &self.log, self.missing_from) else { return };
        let (current, messages) = (segment_number_of(log.path()).unwrap_or(0), log.written().iter().sum());
        if !keeper.is_due(current, messages) {
            return;
        }
        let account = LogAccount {
            run: String::new(),
            current,
            place: log.place(),
            held: self.next_segment(),
            last_ticks: self.inputs.each_ref().map(|input| input.done),
            timings: self.timings.as_ref().map(LatencyHistograms::state),
        };
        if let Some(keeper) = &mut self.keeper {
            keeper.keep(account, messages);
        }
    }

    /// Syncs what was written to the disk.
    pub fn sync(&mut self) {
        if let Some(Err(error)) = self.log.as_ref().map(LogWriter::sync) {
            self.give_up(self.consumed(), &error);
        }
    }

    /// Whether the log goes on in another segment before `tick`. The samples of a tick stay together.
    fn rotates_before(&self, tick: u64) -> bool {
        let (Some(log), Some(rotator)) = (&self.log, &self.rotator) else { return false };
        let begins = self.written_tick.is_some_and(|written| tick > written);
        begins && self.missing_from.is_none() && rotator.is_due(log.bytes(), tick)
    }

    /// Closes the segment, and goes on in another one, which begins with `tick`.
    fn rotate(&mut self, tick: u64) {
        let (totals, segment) = (self.totals(false), self.next_segment());
        let (Some(mut log), Some(rotator)) = (self.log.take(), &mut self.rotator) else { return };
        let path = log.path().to_owned();
        let timings = self.timings.as_ref().map_or(Ok(()), |timings| log.timings(timings));
        let next = timings.and_then(|()| log.finish(&totals)).and_then(|closed| {
            let (path, header) = rotator.next(&path, closed.bytes, tick, segment);
            let next = LogWriter::create(&path, header)?;
            rotator.remove_oldest(next.bytes());
            Ok(next)
        });
        match next {
            Ok(next) => {
                (self.log, self.before, self.first_tick) = (Some(next), segment, tick);
                // With the account: one stretch of samples may fill several segments, and a logger that is killed in it
                // would leave them all to be read again.
                self.unflushed = true;
                self.flush();
            }
            Err(error) => self.give_up(tick, &error),
        }
    }

    /// What the next segment says of those before it. A sample that waits to be written belongs to the next.
    fn next_segment(&self) -> LogSegment {
        let inputs = &self.inputs;
        let waits = |input: &MergeInput| input.head.as_ref().and_then(LogRecord::header).map(|header| header.sequence);
        let written = self.log.as_ref().map_or([0; 4], LogWriter::written);
        LogSegment {
            number: 0,
            begins: inputs.each_ref().map(|input| waits(input).unwrap_or(input.expected)),
            written: std::array::from_fn(|i| self.before.written[i] + written[i]),
            lost: inputs.each_ref().map(|input| input.lost),
            thinned: inputs.each_ref().map(|input| input.thinned),
            duplicates: inputs.each_ref().map(|input| input.duplicates),
        }
    }

    /// The totals of the run so far.
    fn totals(&self, complete: bool) -> LogTotals {
        let inputs = &self.inputs;
        LogTotals {
            lost: inputs.each_ref().map(|input| input.lost),
            thinned: inputs.each_ref().map(|input| input.thinned),
            duplicates: inputs.each_ref().map(|input| input.duplicates),
            missing_from: self.missing_from,
            last_tick: inputs.iter().filter_map(|input| input.last).max(),
            complete,
        }
    }

    /// The log is not written any more from `tick` on. The merger still consumes samples.
    fn give_up(&mut self, tick: u64, error: &LogError) {
        self.failure.get_or_insert_with(|| error.to_string());
        self.inputs.iter_mut().filter(|input| input.missing_since.is_none()).for_each(MergeInput::stop_writing);
        let from = *self.missing_from.get_or_insert(tick);
        let Some(log) = &mut self.log else { return };
        let gone = matches!(error, LogError::Gone { .. });
        if gone || log.broken() || log.missing_from(from, error).is_err() {
            self.abandon();
        }
    }

    /// Drops a log that cannot even be closed. Part of the appended samples may be missing from the file, so
    /// the counts are read from the file. Nothing is left of a log that somebody removed.
    fn abandon(&mut self) {
        let Some(log) = self.log.take() else { return };
        let (path, in_place) = (log.path().to_owned(), log.is_in_place());
        drop(log);
        let held = if in_place { LogRecovery::of_torn(&path).ok() } else { None };
        let complete_until = match &held {
            Some(held) => held.last_ticks.into_iter().flatten().map(|tick| tick + 1).min(),
            None => Some(self.first_tick),
        };
        let held = held.map_or(self.before, |held| held.segment);
        for (i, input) in self.inputs.iter_mut().enumerate() {
            (input.missing_since, input.lost) = (Some(held.begins[i]), held.lost[i]);
            input.thinned = held.thinned[i];
        }
        self.missing_from = self.missing_from.min(complete_until.or(self.missing_from));
    }

    /// Every input has received, or need not wait for, the ticks up to but without this one.
    pub fn consumed(&self) -> u64 {
        self.inputs.iter().map(MergeInput::consumed).min().unwrap_or(0)
    }

    /// The file of the segment that is being written.
    pub fn path(&self) -> Option<PathBuf> {
        self.log.as_ref().map(|log| log.path().to_owned())
    }

    /// States the samples that were sent, by the senders' own counts, and never arrived, and the run's `warnings` by
    /// name. Then closes the log.
    pub fn close(mut self, sent: [u64; 3], complete: bool, warnings: BTreeMap<String, String>) -> MergeOutcome {
        self.unchecked = CHECK_EVERY;
        self.flush();
        let gaps: Vec<Gap> = self.inputs.iter_mut().zip(sent).filter_map(|(input, sent)| input.end(sent)).collect();
        let totals = self.totals(complete);
        let written =
            self.inputs.each_ref().map(|input| input.expected.saturating_sub(input.first + input.lost + input.thinned));
        let (removed, closed) = self.rotator.as_ref().map_or((0, 0), |r| (r.removed, r.closed_bytes()));
        let (failure, timings) = (self.failure, self.timings);
        let mut outcome = MergeOutcome { totals, written, failure, timings, bytes: None, removed, closed };
        let Some(mut log) = self.log else { return outcome };
        let ended = gaps
            .iter()
            .try_for_each(|gap| log.append(&LogRecord::Gap(*gap)))
            .and_then(|()| outcome.timings.as_ref().map_or(Ok(()), |timings| log.timings(timings)))
            .and_then(|()| log.warnings(warnings))
            .and_then(|()| log.finish(&totals));
        match ended {
            Ok(closed) => outcome.bytes = Some(closed.bytes),
            Err(error) => {
                outcome.failure.get_or_insert_with(|| error.to_string());
            }
        }
        outcome
    }
}

#[cfg(test)]
mod tests;
