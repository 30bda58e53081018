//! The run's log: MCAP files, written one message at a time and read back, whole or torn, one or several.
//!
//! A log must be worth something without this program and after any death of the logger. So every sample goes into an
//! unchunked MCAP file as `cdr` under a `ros2msg` schema, which MCAP tools in other languages decode unaided; the
//! resolved scenario, units, build and clock stand at its start; and each message has left the process before the call
//! that wrote it returns, so that killing the logger costs none that it had acknowledged.
//!
//! What a file holds, in order:
//!
//! 1. the attachment `scenario.toml`: the scenario with every default filled in;
//! 2. the metadata record `tectum.run`: see [`LogHeader`];
//! 3. schemas and channels: `/observation`, `/command` and `/learning` (or the scenario's names for them), and `/gap`;
//! 4. the messages: four bytes of encapsulation (`00 01 00 00`) and then the sample's own bytes;
//! 5. if the logger came to its end, in real time the metadata record `tectum.histograms` (see [`LatencyHistograms`]), then
//!    `tectum.totals` (see [`LogTotals`]), MCAP's summary, and checksums; [`repair()`] gives them to a log that was torn, with
//!    the metadata record `tectum.repair`.
//!
//! *Segments.* A logger that was started anew within its run leaves what it finds as it is, torn or not, and writes another
//! file beside `log.mcap`: `log-1.mcap`, `log-2.mcap` and so on, numbered by its starts (a number is missing where it was killed
//! before it could begin). Each is a log by itself; `tectum.run` says which segment it is and what those before it hold (see
//! [`LogSegment`]). What reached none of them is stated by the messages on `/gap` at the beginning of the new one; totals and
//! histograms are those of the run so far. [`RunLog`] reads all of them as one log.
//!
//! *A full disk.* The file is given room ahead of what is written, so that it can still be closed when there is no more. Then
//! the metadata record `tectum.missing` says at once from which tick on samples are missing (`from_tick`) and why (`why`); behind
//! it, at the run's end, come the statements on `/gap` of all that is missing, and totals whose `missing_from` names the tick
//! again. A file system that cannot give room ahead leaves a torn log instead.
//!
//! `log_time` and `publish_time` of a message are its `published_ns`, moved from the run's clock to wall time by the two
//! instants in `tectum.run`. In lockstep both are 0, so that equal runs write equal messages.

mod csv;
mod disk_reserve;
mod error;
mod header;
mod info;
mod latency_histograms;
mod log_file;
mod message_counts;
mod parse;
mod reader;
mod recovery;
mod repair;
mod segments;
mod writer;

pub use crate::stats::{Percentiles, histogram};
pub use csv::{CsvChannel, csv};
pub use error::LogError;
pub(crate) use header::flag_words;
pub use header::{LogClock, LogHeader, LogSegment};
pub use info::{ChannelInfo, LogInfo, LogState, SegmentInfo};
pub use latency_histograms::LatencyHistograms;
pub use message_counts::{ChannelCounts, MessageCounts};
pub use reader::LogReader;
pub use recovery::LogRecovery;
pub use repair::{Repair, TornContents, mend, repair};
pub use segments::{RunLog, SegmentEnd, find, segment_path, segments};
pub use writer::{LogSummary, LogWriter};

use crate::wire::{Command, Gap, Header, Learning, Observation};
use std::collections::BTreeMap;
use std::fs::{File, TryLockError};

/// Topic of the log's own statements about what it lacks.
pub const GAP_TOPIC: &str = "/gap";
/// Name of the attachment with the resolved scenario.
pub const SCENARIO_ATTACHMENT: &str = "scenario.toml";
/// Name of the metadata record that describes the run.
pub const RUN_METADATA: &str = "tectum.run";
/// Name of the metadata record that closes a log.
pub const TOTALS_METADATA: &str = "tectum.totals";
/// Name of the metadata record of a torn log that was made whole: at which byte it was torn, and who counted its totals.
pub const REPAIR_METADATA: &str = "tectum.repair";
/// Name of the metadata record that says from which tick on samples are missing because there was no room for them.
pub const MISSING_METADATA: &str = "tectum.missing";
/// Name of the metadata record with the histograms of a run on the real clock.
pub const HISTOGRAMS_METADATA: &str = "tectum.histograms";
/// The log's file in a run's folder; see [`segment_path`] for those of a logger that was started anew.
pub const LOG_FILE: &str = "log.mcap";

/// What a log takes beside its messages, bytes: schemas (twice), scenario, metadata and summary. An allowance for
/// scenarios of a few kilobytes, not a bound.
pub const FIXED_BYTES: u64 = 16 * 1024;

/// CDR encapsulation, plain and little-endian: what stands before every sample's bytes.
const ENCAPSULATION: [u8; 4] = [0, 1, 0, 0];
/// What MCAP puts around a message's data: operation code and length (9), channel, sequence and two instants (22).
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

/// Whether a logger that lives still writes this log: it holds a lock on the file as long as it does.
fn in_use(log: &File) -> bool {
    matches!(log.try_lock_shared(), Err(TryLockError::WouldBlock))
}

/// How a log ended, channel by channel: the run so far, with all segments before. The three channels stand in the order
/// observation, command, learning. Every sequence number that the logger knows of is written, lost or thinned.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct LogTotals {
    /// Samples that were sent and never reached the log.
    pub lost: [u64; 3],
    /// Samples left out on purpose, because only every N-th tick is written.
    pub thinned: [u64; 3],
    /// Samples that came twice, from a process that was started anew and said again what it had said last: the second was
    /// dropped.
    pub duplicates: [u64; 3],
    /// The tick from which on samples are missing, because there was no room for them or the log could not be written.
    pub missing_from: Option<u64>,
    /// The last tick that the logger saw, written or not; `None` if it saw none.
    pub last_tick: Option<u64>,
    /// The run came to its planned end, and the logger saw it.
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

    /// `None` if a key is missing or does not hold what it should. What logs did not have before there were segments may be
    /// missing.
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

/// Bytes that a tick adds to a log of which every `every`-th tick is written (0 counts as 1): three messages with their
/// exact overhead, shared out over the ticks between. A whole log takes [`FIXED_BYTES`] more, or thereabouts.
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
    fn totals_survive_their_map() {
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
        // As written before there were segments.
        let mut older = none.to_map([0; 4]);
        older.retain(|key, _| key != "missing_from" && !key.ends_with("duplicates"));
        assert_eq!(LogTotals::from_map(&older), Some(none));
        let mut broken = totals.to_map([8; 4]);
        broken.insert("command.lost".into(), "some".into());
        assert_eq!(LogTotals::from_map(&broken), None);
    }

    /// A decoder in another language found this the hard way.
    #[test]
    fn nested_types_have_two_parts() {
        let text = Observation::ros2msg();
        assert!(text.starts_with("tectum/Header header\n") && text.contains("\nMSG: tectum/Header\n"), "{text}");
    }

    #[test]
    fn thinning_divides_the_bytes() {
        assert_eq!(bytes_per_tick(1), 521.0);
        assert_eq!(bytes_per_tick(0), 521.0);
        assert_eq!(bytes_per_tick(100), 5.21);
    }
}
