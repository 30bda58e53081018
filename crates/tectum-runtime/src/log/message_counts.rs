//! Counts the messages of a log: how many there are, which ticks they cover, and how many are missing between
//! them.
//!
//! A gap shows twice: in the logger's statement on `/gap` and in the sequence numbers. The two are counted
//! separately, so that they can be compared. The statement precedes the channel's next sample.

use super::{LogRecord, LogSegment};
use crate::wire::{Gap, Header};

/// Most incarnations of a writer that are listed.
const MAX_INCARNATIONS: usize = 256;

/// The messages of a log, counted as they are read.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct MessageCounts {
    /// Observation, command, learning.
    pub channels: [ChannelCounts; 3],
    /// Statements of missing samples.
    pub gaps: u64,
}

/// One channel's samples.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct ChannelCounts {
    /// Samples in the log.
    pub messages: u64,
    /// Ticks of the first and the last of them.
    pub ticks: Option<(u64, u64)>,
    /// Instants at which the first and the last of them were published, ns of the run's clock.
    pub published_ns: Option<(u64, u64)>,
    /// Sequence number of the next sample.
    pub expected: u64,
    /// The writer's incarnations, each with the tick of its first sample, in the order of the log.
    pub incarnations: Vec<(u32, u64)>,
    /// Samples that the log states to be missing, including those of earlier segments.
    pub stated: u64,
    /// Missing sequence numbers that no statement explains: thinned samples in a thinned log, otherwise a fault.
    pub unexplained: u64,
    /// Statements that the sequence numbers contradict, and samples whose number is not greater than the
    /// previous one.
    pub contradictions: u64,
    /// The statements since the last sample.
    pending: Option<StatedGaps>,
}

/// Consecutive statements: sequence numbers from the first missing one up to but excluding `end`, and how many
/// are missing. In a thinned log, some of the numbers between may be thinned and not missing.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct StatedGaps {
    first: u64,
    end: u64,
    count: u64,
}

impl MessageCounts {
    /// The counts at the beginning of a segment.
    pub fn after(segment: &LogSegment) -> Self {
        let mut counts = Self::default();
        for (i, channel) in counts.channels.iter_mut().enumerate() {
            (channel.expected, channel.stated) = (segment.begins[i], segment.lost[i]);
        }
        counts
    }

    /// The counts after `segment`, as [`after`](Self::after), where the channels' last ticks are known.
    pub(super) fn going_on(segment: &LogSegment, last_ticks: [Option<u64>; 3]) -> Self {
        let mut counts = Self::after(segment);
        for (channel, tick) in counts.channels.iter_mut().zip(last_ticks) {
            channel.ticks = tick.map(|tick| (tick, tick));
        }
        counts
    }

    /// Counts the next message. For a sample, returns how many samples of its channel are stated to be missing
    /// right before it.
    pub fn take(&mut self, record: &LogRecord) -> u64 {
        let channel = match record {
            LogRecord::Observation(_) => 0,
            LogRecord::Command(_) => 1,
            LogRecord::Learning(_) => 2,
            LogRecord::Gap(gap) => {
                self.gaps += 1;
                if let Some(channel) = usize::try_from(gap.channel).ok().and_then(|i| self.channels.get_mut(i)) {
                    channel.take_statement(gap);
                }
                return 0;
            }
        };
        record.header().map_or(0, |header| self.channels[channel].take(header))
    }
}

impl ChannelCounts {
    fn take_statement(&mut self, gap: &Gap) {
        self.stated = self.stated.saturating_add(gap.count);
        self.contradictions += u64::from(gap.total != self.stated);
        let pending = self.pending.get_or_insert(StatedGaps { first: gap.first, end: gap.first, count: 0 });
        self.contradictions += u64::from(gap.first < pending.end);
        pending.end = gap.first.saturating_add(gap.count);
        pending.count = pending.count.saturating_add(gap.count);
    }

    fn take(&mut self, header: &Header) -> u64 {
        self.messages += 1;
        self.ticks = Some((self.ticks.map_or(header.tick, |(first, _)| first), header.tick));
        let incarnation = header.incarnation;
        if self.incarnations.last().is_none_or(|&(last, _)| last != incarnation)
            && self.incarnations.len() < MAX_INCARNATIONS
        {
            self.incarnations.push((incarnation, header.tick));
        }
        let ns = header.published_ns;
        self.published_ns = Some((self.published_ns.map_or(ns, |(first, _)| first), ns));
        let none = StatedGaps { first: self.expected, end: self.expected, count: 0 };
        let StatedGaps { first, end, count } = self.pending.take().unwrap_or(none);
        let jump = header.sequence.checked_sub(self.expected);
        // Without thinning the statement equals the jump in sequence numbers; with thinning it lies within the
        // jump.
        let consistent = jump.is_some() && first >= self.expected && end <= header.sequence;
        self.contradictions += u64::from(!consistent);
        self.unexplained += jump.unwrap_or(0).saturating_sub(count);
        self.expected = header.sequence.saturating_add(1);
        count
    }

    /// Samples stated to be missing after the last one; no sequence number shows these.
    pub fn lost_at_end(&self) -> u64 {
        self.pending.map_or(0, |pending| pending.count)
    }

    /// Sequence number of the first sample that the log does not account for.
    pub(super) fn next(&self) -> u64 {
        self.pending.map_or(self.expected, |pending| pending.end).max(self.expected)
    }

    /// Messages per second of the run's clock, between the first and the last.
    pub fn rate(&self) -> Option<f64> {
        let (first, last) = self.published_ns.filter(|(first, last)| last > first)?;
        (self.messages > 1).then(|| (self.messages - 1) as f64 * 1e9 / (last - first) as f64)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::wire::Command;

    fn count_commands(records: &[LogRecord]) -> ChannelCounts {
        let mut counts = MessageCounts::default();
        for record in records {
            counts.take(record);
        }
        counts.channels[1].clone()
    }

    fn sample(sequence: u64) -> LogRecord {
        let mut command = Command::default();
        (command.header.tick, command.header.sequence) = (sequence, sequence);
        LogRecord::Command(command)
    }

    fn gap(first: u64, count: u64, total: u64) -> LogRecord {
        LogRecord::Gap(Gap { channel: 1, first, count, total })
    }

    #[test]
    fn statements_and_sequence_numbers_are_compared() {
        let consistent = count_commands(&[sample(0), gap(1, 2, 2), sample(3), sample(4), gap(5, 1, 3)]);
        assert_eq!((consistent.messages, consistent.stated, consistent.lost_at_end()), (3, 3, 1));
        assert_eq!((consistent.unexplained, consistent.contradictions), (0, 0));
        assert_eq!(count_commands(&[sample(0), sample(3)]).unexplained, 2, "nothing states it");
        for faulty in [
            &[sample(0), gap(1, 3, 3), sample(3)][..],
            &[sample(0), gap(1, 2, 9), sample(3)],
            &[sample(0), gap(0, 2, 2), sample(3)],
            &[sample(0), sample(0)],
            &[sample(0), gap(1, u64::MAX, u64::MAX), gap(1, u64::MAX, u64::MAX), sample(u64::MAX)],
        ] {
            assert!(count_commands(faulty).contradictions > 0, "{faulty:?}");
        }
    }

    #[test]
    fn thinned_samples_are_not_lost() {
        let counts = count_commands(&[sample(0), sample(7), gap(9, 2, 2), sample(14)]);
        assert_eq!((counts.stated, counts.unexplained, counts.contradictions), (2, 6 + 4, 0));
        // Number 10 was received and thinned.
        let counts = count_commands(&[sample(7), gap(9, 1, 1), gap(11, 2, 3), sample(14)]);
        assert_eq!((counts.stated, counts.unexplained, counts.contradictions), (3, 7 + 3, 0));
    }
}
