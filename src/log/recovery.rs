//! What a run's log holds so far, for a logger that comes back: it goes on from there, and states what is missing.

use std::fs::File;
use std::path::Path;

use super::{HISTOGRAMS_METADATA, LatencyHistograms, LogError, LogReader, LogSegment, MessageCounts, segments};

/// The account of all segments that lie in a run's folder.
#[derive(Debug, Clone)]
pub struct LogRecovery {
    /// What the next segment goes on from; its number is the new logger's to set.
    pub segment: LogSegment,
    /// The last tick written on each channel.
    pub last_ticks: [Option<u64>; 3],
    /// The tick from which on samples are missing because there was no room for them.
    pub missing_from: Option<u64>,
    /// The three durations of the ticks so far.
    pub timings: LatencyHistograms,
    /// Size of all files, bytes.
    pub bytes: u64,
}

/// Messages between two signs of life.
const BEAT: u64 = 4096;

impl LogRecovery {
    /// Before the first segment of a run that begins with the samples `begins`, at tick `tick`: not 0 where it goes on with
    /// another run.
    pub fn none(period_ns: u64, begins: [u64; 3], tick: u64) -> Self {
        Self {
            segment: LogSegment { begins, ..LogSegment::default() },
            last_ticks: [tick.checked_sub(1); 3],
            missing_from: None,
            timings: LatencyHistograms::new(period_ns),
            bytes: 0,
        }
    }

    /// Reads all segments in `folder`, and touches none; this is what came before them. One that is torn or damaged counts as
    /// far as it can be read; one that does not describe its run, not at all. `beat` is called now and then.
    pub fn with(mut self, folder: &Path, mut beat: impl FnMut()) -> Self {
        let mut account = None;
        for path in segments(folder) {
            self.bytes += std::fs::metadata(&path).map_or(0, |file| file.len());
            if let Ok(log) = LogReader::open(&path) {
                let account = account.get_or_insert_with(|| log.account());
                self.take(log, account, &mut beat);
            }
        }
        self
    }

    /// What the log at `path`, which was left torn, holds by itself, with what its beginning says of those before it. Half a
    /// record at its end is cut off.
    ///
    /// # Errors
    ///
    /// As [`LogReader::open`].
    pub fn of_torn(path: &Path) -> Result<Self, LogError> {
        let mut past = Self::none(0, [0; 3], 0);
        let log = LogReader::open(path)?;
        let (before, mut account) = (log.begins(), log.account());
        let end = past.take(log, &mut account, &mut || ());
        (0..4).for_each(|i| past.segment.written[i] += before.written[i]);
        (0..3).for_each(|i| past.segment.thinned[i] = past.thinned(i, before.first(i)));
        // What is cut off is none of the log's: that it stays is no harm either.
        let _ = File::options().write(true).open(path).and_then(|file| file.set_len(end));
        Ok(past)
    }

    /// Takes a segment in; gives the byte at which its last whole record ended.
    fn take(&mut self, mut log: LogReader, account: &mut MessageCounts, beat: &mut impl FnMut()) -> u64 {
        let mut n: u64 = 0;
        for record in log.by_ref() {
            // Behind damage nothing is known.
            let Ok(record) = record else { break };
            account.take(&record);
            self.timings.take(&record);
            n += 1;
            if n.is_multiple_of(BEAT) {
                beat();
            }
        }
        self.segment.written[3] = account.gaps;
        for (i, lane) in account.lanes.iter().enumerate() {
            self.segment.written[i] = lane.messages;
        }
        for (i, lane) in account.lanes.iter().enumerate() {
            self.last_ticks[i] = lane.ticks.map_or(self.last_ticks[i], |(_, last)| Some(last));
        }
        let said = log.begins();
        match log.totals() {
            // Whoever repaired a log has counted its totals; the logger's own say what it saw and did not write.
            Some(totals) => {
                (self.segment.lost, self.segment.thinned) = (totals.lost, totals.thinned);
                self.segment.duplicates = totals.duplicates;
                for i in 0..3 {
                    let known = [self.segment.written[i], totals.lost[i], totals.thinned[i]];
                    self.segment.begins[i] = known.iter().fold(said.first(i), |sum, n| sum.saturating_add(*n));
                }
            }
            None => {
                self.segment.duplicates = said.duplicates;
                for (i, lane) in account.lanes.iter().enumerate() {
                    let next = lane.next().max(said.begins[i]).max(self.segment.begins[i]);
                    (self.segment.begins[i], self.segment.lost[i]) = (next, lane.stated);
                    self.segment.thinned[i] = self.thinned(i, said.first(i));
                }
            }
        }
        self.missing_from = self.missing_from.or(log.missing_from());
        // What the logger saw beside what it wrote is in its own histograms.
        if let Some(map) = log.metadata().get(HISTOGRAMS_METADATA) {
            self.timings.restore(map);
        }
        log.position()
    }

    /// What is neither written nor lost of channel `i`, whose first sample in the run is `first`.
    fn thinned(&self, i: usize, first: u64) -> u64 {
        let LogSegment { begins, written, lost, .. } = &self.segment;
        begins[i].saturating_sub(first).saturating_sub(written[i]).saturating_sub(lost[i])
    }
}
