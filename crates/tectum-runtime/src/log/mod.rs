//! The run's log: one or several MCAP files, written message by message, and read back even if they are torn.
//!
//! A log must be usable without this program, and after any death of the logger. So every sample goes into an
//! unchunked MCAP file as `cdr` under a `ros2msg` schema, which MCAP tools in other languages can decode. The
//! resolved scenario, units, build and clock are at its start. Each message is handed to the operating system
//! before the call that wrote it returns, so killing the logger loses no acknowledged message.
//!
//! What a file holds, in order:
//!
//! 1. the attachment `scenario.toml`: the scenario with every default filled in;
//! 2. the metadata record `tectum.run`: see [`LogHeader`];
//! 3. schemas and channels: `/observation`, `/command` and `/learning` (or the scenario's names for them), and
//!    `/gap`;
//! 4. the messages: four bytes of encapsulation (`00 01 00 00`) and then the sample's own bytes;
//! 5. if the logger closed the log: in real time the metadata record `tectum.histograms` (see
//!    [`LatencyHistograms`]), where something did not go well `tectum.warnings` (a sentence for each warning's
//!    name), then `tectum.totals` (see [`LogTotals`]), MCAP's summary, and checksums. [`repair()`] adds all but
//!    the warnings to a torn log, with the metadata record `tectum.repair`.
//!
//! *Segments.* A logger that is restarted within its run does not change the existing files, torn or not. It
//! writes another file beside `log.mcap`: `log-1.mcap`, `log-2.mcap` and so on, numbered by its starts (a
//! number is missing where the logger was killed before it created the file). Each is a log by itself;
//! `tectum.run` states which segment it is and what the earlier ones hold (see [`LogSegment`]). Messages on
//! `/gap` at the beginning of the new segment state which samples reached none of them. Totals and histograms
//! are those of the run so far. [`RunLog`] reads all segments as one log.
//!
//! *A full disk.* Disk space is reserved ahead of the written bytes, so that the file can still be closed when
//! the disk is full. Then the metadata record `tectum.missing` states at once from which tick on samples are
//! missing (`from_tick`) and why (`why`). At the run's end follow the messages on `/gap` that state all missing
//! samples, and totals whose `missing_from` names the tick again. A file system that cannot reserve space
//! leaves a torn log instead.
//!
//! `log_time` and `publish_time` of a message are its `published_ns`, converted from the run's clock to wall
//! time by the two instants in `tectum.run`. In lockstep tick 0 has the wall time at which the run was launched, so
//! that a log lies in time where it belongs; the samples themselves hold the run's own clock alone.

mod account;
mod chunk;
mod copier;
mod csv;
mod disk_reserve;
mod error;
mod header;
mod info;
mod latency_histograms;
mod log_file;
mod message_counts;
mod pack;
mod parse;
mod reader;
mod recovery;
mod repair;
mod segments;
mod views;
mod writer;

pub use crate::scenario::LogRotation;
pub use account::remove_account;
pub(crate) use account::{ACCOUNT_EVERY, AccountKeeper, LogAccount, LogPlace};
pub use csv::{CsvChannel, csv};
pub use error::LogError;
pub use header::flag_words;
pub use header::{LogClock, LogHeader, LogSegment};
pub use info::{ChannelInfo, LogInfo, LogState, SegmentInfo};
pub use latency_histograms::LatencyHistograms;
pub use message_counts::{ChannelCounts, MessageCounts};
pub use pack::{PackExtras, PackedLog, pack};
pub use reader::LogReader;
pub use recovery::LogRecovery;
pub use repair::{Repair, TornContents, mend, repair};
pub use segments::{RunLog, SegmentEnd, find, segments};
pub(crate) use segments::{segment_number_of, segment_path};
pub use views::{SampleViews, ViewChannel, ViewFacts, ViewMessage};
pub use writer::{LogSummary, LogWriter};

use crate::wire::{Command, Gap, Header, Learning, Observation};
use std::collections::BTreeMap;
use std::fs::{File, TryLockError};

/// Topic of the log's own statements of missing samples.
pub(crate) const GAP_TOPIC: &str = "/gap";
/// Name of the attachment with the resolved scenario.
pub(crate) const SCENARIO_ATTACHMENT: &str = "scenario.toml";
/// Name of the metadata record that describes the run.
pub(crate) const RUN_METADATA: &str = "tectum.run";
/// Name of the metadata record that closes a log.
pub const TOTALS_METADATA: &str = "tectum.totals";
/// Name of the metadata record of a repaired log: at which byte it was torn, and whether the logger or the
/// repair counted its totals.
pub(crate) const REPAIR_METADATA: &str = "tectum.repair";
/// Name of the metadata record that states from which tick on samples are missing because the disk was full.
pub(crate) const MISSING_METADATA: &str = "tectum.missing";
/// Name of the metadata record with the histograms of a run in real time.
pub(crate) const HISTOGRAMS_METADATA: &str = "tectum.histograms";
/// Name of the metadata record with what did not go well in the run: a sentence for each warning's name.
pub(crate) const WARNINGS_METADATA: &str = "tectum.warnings";
/// The log's file in a run's folder; `segment_path` gives those of a restarted logger.
pub const LOG_FILE: &str = "log.mcap";

/// Size of a log without its messages, bytes: schemas (twice), scenario, metadata and summary. An estimate for
/// scenarios of a few kilobytes, not a bound.
pub const FIXED_BYTES: u64 = 16 * 1024;

/// CDR encapsulation, plain and little-endian. It precedes every sample's bytes.
const ENCAPSULATION: [u8; 4] = [0, 1, 0, 0];
/// MCAP's bytes around a message's data: operation code and length (9), channel, sequence and two instants (22).
const MESSAGE_OVERHEAD: usize = 9 + 22;

/// One message of a log.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum LogRecord {
    /// From the plant.
    Observation(Observation),
    /// From the controller's policy.
    Command(Command),
    /// From the controller's learner.
    Learning(Learning),
    /// From the logger: samples are missing here.
    Gap(Gap),
}

impl LogRecord {
    /// Its channel: 0 observation, 1 command, 2 learning, 3 gap.
    pub fn channel(&self) -> usize {
        match self {
            LogRecord::Observation(_) => 0,
            LogRecord::Command(_) => 1,
            LogRecord::Learning(_) => 2,
            LogRecord::Gap(_) => 3,
        }
    }

    /// The sample's header; a gap has none.
    pub fn header(&self) -> Option<&Header> {
        match self {
            LogRecord::Observation(s) => Some(&s.header),
            LogRecord::Command(s) => Some(&s.header),
            LogRecord::Learning(s) => Some(&s.header),
            LogRecord::Gap(_) => None,
        }
    }
}

/// Whether a logger is still writing this log: it holds a lock on the file.
fn in_use(log: &File) -> bool {
    matches!(log.try_lock_shared(), Err(TryLockError::WouldBlock))
}

/// Totals at the end of a log, for each channel: those of the run so far, all earlier segments included. The
/// order of channels is observation, command, learning. Every sequence number that the logger knows of is
/// written, lost or thinned.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct LogTotals {
    /// Samples that were sent and never reached the log.
    pub lost: [u64; 3],
    /// Samples left out on purpose, because only every N-th tick is written.
    pub thinned: [u64; 3],
    /// Samples that a restarted process sent a second time; the second was dropped.
    pub duplicates: [u64; 3],
    /// The tick from which on samples are missing because the disk was full or the log could not be written.
    pub missing_from: Option<u64>,
    /// The last tick that the logger saw, written or not; `None` if it saw none.
    pub last_tick: Option<u64>,
    /// The run reached its planned end, and the logger received its last samples.
    pub complete: bool,
}

/// Names of the three channels in metadata, in the order of [`LogTotals`].
const CHANNELS: [&str; 3] = ["observation", "command", "learning"];

impl LogTotals {
    fn to_map(self, written: [u64; 4]) -> BTreeMap<String, String> {
        let mut map = BTreeMap::new();
        for (i, name) in CHANNELS.iter().enumerate() {
            map.insert(format!("{name}.written"), written[i].to_string());
            map.insert(format!("{name}.lost"), self.lost[i].to_string());
            map.insert(format!("{name}.thinned"), self.thinned[i].to_string());
            map.insert(format!("{name}.duplicates"), self.duplicates[i].to_string());
        }
        map.insert("gap.written".into(), written[3].to_string());
        let tick = |tick: Option<u64>| tick.map_or(String::new(), |tick| tick.to_string());
        map.insert("missing_from".into(), tick(self.missing_from));
        map.insert("last_tick".into(), tick(self.last_tick));
        map.insert("complete".into(), self.complete.to_string());
        map
    }

    /// `None` if a key is missing or its value cannot be parsed. Keys that logs did not have before segments
    /// were introduced may be missing.
    fn from_map(map: &BTreeMap<String, String>) -> Option<LogTotals> {
        let mut totals = LogTotals::default();
        for (i, name) in CHANNELS.iter().enumerate() {
            totals.lost[i] = map.get(&format!("{name}.lost"))?.parse().ok()?;
            totals.thinned[i] = map.get(&format!("{name}.thinned"))?.parse().ok()?;
            totals.duplicates[i] = map.get(&format!("{name}.duplicates")).map_or(Ok(0), |n| n.parse()).ok()?;
        }
        let tick = |text: &str| if text.is_empty() { Ok(None) } else { text.parse().map(Some) };
        totals.last_tick = tick(map.get("last_tick")?).ok()?;
        totals.missing_from = tick(map.get("missing_from").map_or("", String::as_str)).ok()?;
        totals.complete = map.get("complete")?.parse().ok()?;
        Some(totals)
    }
}

/// Bytes that a tick adds to a log of which every `every`-th tick is written (0 counts as 1): three messages
/// with their exact overhead, averaged over the ticks. A whole log takes about [`FIXED_BYTES`] more.
pub fn bytes_per_tick(every: u64) -> f64 {
    let samples = size_of::<Observation>() + size_of::<Command>() + size_of::<Learning>();
    let written = samples + 3 * (MESSAGE_OVERHEAD + ENCAPSULATION.len());
    written as f64 / every.max(1) as f64
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::wire::Sample as _;

    #[test]
    fn totals_are_equal_after_a_round_trip_through_their_map() {
        let totals = LogTotals {
            lost: [1, 2, 3],
            thinned: [4, 5, 6],
            duplicates: [0, 1, 2],
            missing_from: Some(5),
            last_tick: Some(7),
            complete: true,
        };
        assert_eq!(LogTotals::from_map(&totals.to_map([8; 4])), Some(totals));
        let none = LogTotals::default();
        assert_eq!(LogTotals::from_map(&none.to_map([0; 4])), Some(none));
        // As written before segments were introduced.
        let mut older = none.to_map([0; 4]);
        older.retain(|key, _| key != "missing_from" && !key.ends_with("duplicates"));
        assert_eq!(LogTotals::from_map(&older), Some(none));
        let mut broken = totals.to_map([8; 4]);
        broken.insert("command.lost".into(), "some".into());
        assert_eq!(LogTotals::from_map(&broken), None);
    }

    /// Decoders in other languages require it.
    #[test]
    fn nested_types_have_two_parts() {
        let text = Observation::ros2msg();
        assert!(text.starts_with("tectum/Header header\n") && text.contains("\nMSG: tectum/Header\n"), "{text}");
    }

    #[test]
    fn thinning_divides_the_bytes() {
        assert_eq!(bytes_per_tick(1), 745.0);
        assert_eq!(bytes_per_tick(0), 745.0);
        assert_eq!(bytes_per_tick(100), 7.45);
    }
}
