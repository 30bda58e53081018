//! Log recovery: what the existing segments of a run's log hold. A restarted logger continues from there and
//! states what is missing.

use std::fs::File;
use std::path::Path;

use super::{
    HISTOGRAMS_METADATA, LatencyHistograms, LogAccount, LogError, LogReader, LogSegment, MessageCounts,
    segment_number_of, segments,
};

/// The contents of all segments in a run's folder, counted.
#[derive(Debug, Clone)]
pub struct LogRecovery {
    /// The description with which the next segment begins; the new logger sets its number.
    pub segment: LogSegment,
    /// The last tick written on each channel.
    pub last_ticks: [Option<u64>; 3],
    /// The tick from which on samples are missing because the disk was full.
    pub missing_from: Option<u64>,
    /// The three durations of the ticks so far.
    pub timings: LatencyHistograms,
    /// Size of all files, bytes.
    pub bytes: u64,
    /// Messages that were read for this.
    pub read: u64,
    /// Messages before the first that is read: of segments that were removed, and what the account tells of.
    before: [u64; 4],
}

/// Messages between two calls of the heartbeat.
const HEARTBEAT_MESSAGES: u64 = 4096;

impl LogRecovery {
    /// Nothing written yet, in a run whose first samples have the sequence numbers `begins`, at tick `tick`.
    /// These are not 0 if the run continues another one.
    pub fn none(period_ns: u64, begins: [u64; 3], tick: u64) -> Self {
        Self {
            segment: LogSegment { begins, ..LogSegment::default() },
            last_ticks: [tick.checked_sub(1); 3],
            missing_from: None,
            timings: LatencyHistograms::new(period_ns),
            bytes: 0,
            read: 0,
            before: [0; 4],
        }
    }

    /// Adds all segments in `folder`, and changes none of the files. What the logger's account tells of is not read
    /// again. A torn or damaged segment is read as far as possible; one that does not describe its run is ignored.
    /// `heartbeat` is called regularly.
    pub fn with(mut self, folder: &Path, mut heartbeat: impl FnMut()) -> Self {
        let segments = segments(folder);
        self.bytes = segments.iter().map(|path| std::fs::metadata(path).map_or(0, |file| file.len())).sum();
        let mut counts = None;
        let mut next = 0;
        if let Some((account, tail)) = LogAccount::find(folder) {
            next = account.current.saturating_add(1);
            let counts = counts.insert(self.take_account(&account));
            self.add_segment(tail, counts, &mut heartbeat);
        }
        for path in segments.into_iter().filter(|path| segment_number_of(path).is_some_and(|number| number >= next)) {
            if let Ok(log) = LogReader::open(&path) {
                let counts = counts.get_or_insert_with(|| {
                    self.before = log.log_segment().written;
                    log.message_counts()
                });
                self.add_segment(log, counts, &mut heartbeat);
            }
        }
        self
    }

    /// Reads the torn log at `path`, together with what its header states about earlier segments. An incomplete
    /// record at its end is cut off.
    ///
    /// # Errors
    ///
    /// As [`LogReader::open`].
    pub fn of_torn(path: &Path) -> Result<Self, LogError> {
        let mut recovery = Self::none(0, [0; 3], 0);
        let log = LogReader::open(path)?;
        let (before, mut counts) = (log.log_segment(), log.message_counts());
        let end = recovery.add_segment(log, &mut counts, &mut || ());
        (0..4).for_each(|i| recovery.segment.written[i] += before.written[i]);
        (0..3).for_each(|i| recovery.segment.thinned[i] = recovery.thinned(i, before.first(i)));
        // A failure does no harm: readers ignore the incomplete record.
        let _ = File::options().write(true).open(path).and_then(|file| file.set_len(end));
        Ok(recovery)
    }

    /// Takes over what the logger's account tells; returns the counts that the messages behind its place are added to.
    fn take_account(&mut self, account: &LogAccount) -> MessageCounts {
        (self.segment, self.before, self.last_ticks) = (account.held, account.held.written, account.last_ticks);
        if let Some(timings) = &account.timings {
            self.timings.set_state(timings);
        }
        MessageCounts::going_on(&account.held, account.last_ticks)
    }

    /// Adds a segment; returns the byte at which its last whole record ends.
    fn add_segment(&mut self, mut log: LogReader, counts: &mut MessageCounts, heartbeat: &mut impl FnMut()) -> u64 {
        for record in log.by_ref() {
            // Nothing is known about the rest of a damaged file.
            let Ok(record) = record else { break };
            counts.take(&record);
            self.timings.take(&record);
            self.read += 1;
            if self.read.is_multiple_of(HEARTBEAT_MESSAGES) {
                heartbeat();
            }
        }
        self.segment.written[3] = self.before[3] + counts.gaps;
        for (i, channel) in counts.channels.iter().enumerate() {
            self.segment.written[i] = self.before[i] + channel.messages;
            self.last_ticks[i] = channel.ticks.map_or(self.last_ticks[i], |(_, last)| Some(last));
        }
        let start = log.log_segment();
        match log.totals() {
            // The logger's own totals include samples that it received and did not write. Those of a repair are
            // counted from the file.
            Some(totals) => {
                (self.segment.lost, self.segment.thinned) = (totals.lost, totals.thinned);
                self.segment.duplicates = totals.duplicates;
                for i in 0..3 {
                    let known = [self.segment.written[i], totals.lost[i], totals.thinned[i]];
                    self.segment.begins[i] = known.iter().fold(start.first(i), |sum, n| sum.saturating_add(*n));
                }
            }
            None => {
                for (i, channel) in counts.channels.iter().enumerate() {
                    let next = channel.next().max(start.begins[i]).max(self.segment.begins[i]);
                    (self.segment.begins[i], self.segment.lost[i]) = (next, channel.stated);
                    self.segment.duplicates[i] = self.segment.duplicates[i].max(start.duplicates[i]);
                    self.segment.thinned[i] = self.thinned(i, start.first(i));
                }
            }
        }
        self.missing_from = self.missing_from.or(log.missing_from());
        // The logger's own histograms include samples that it received and did not write.
        if let Some(map) = log.metadata().get(HISTOGRAMS_METADATA) {
            self.timings.restore(map);
        }
        log.position()
    }

    /// The number of samples of channel `i` that are neither written nor lost; its first sample in the run is
    /// `first`.
    fn thinned(&self, i: usize, first: u64) -> u64 {
        let LogSegment { begins, written, lost, .. } = &self.segment;
        begins[i].saturating_sub(first).saturating_sub(written[i]).saturating_sub(lost[i])
    }
}
