//! Reads a log piece by piece. The file may be larger than memory, torn, damaged, or not a log.
//!
//! A torn log (its logger was killed, or the machine lost power) ends with its last whole record, and
//! [`LogReader::finished`] is then false. That is no error. An invalid record or a wrong checksum is an error:
//! the file was changed after it was written.

use super::chunk::ChunkRecords;
use super::parse::{self, op};
use super::{
    ENCAPSULATION, LogError, LogPlace, LogRecord, LogSegment, LogTotals, MISSING_METADATA, MessageCounts,
    REPAIR_METADATA, RUN_METADATA, SCENARIO_ATTACHMENT, TOTALS_METADATA,
};
use crate::wire::{Command, Gap, Learning, Observation, Sample};
use mcap::McapError;
use mcap::sans_io::{LinearReadEvent, LinearReader, LinearReaderOptions};
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{ErrorKind, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

#[cfg(test)]
mod tests;

/// Bytes requested from the file at a time.
const READ_SIZE: usize = 256 * 1024;
/// Largest length of a record, bytes. Tectum's records are far smaller; a greater length field is damage, and
/// no memory is reserved for it.
pub(super) const MAX_RECORD: usize = 16 * 1024 * 1024;

/// A log being read: an iterator over its messages in the order of the file.
///
/// It uses a few hundred kilobytes of memory, however large the log is. It ends after an error.
pub struct LogReader {
    source: Box<dyn Read + Send>,
    linear: LinearReader,
    contents: LogContents,
    /// The chunk that is being read, and where in the file it begins.
    chunk: Option<(ChunkRecords, u64)>,
    packed: bool,
    /// Bytes up to the end of the last whole record.
    position: u64,
    /// The first message, read while looking for the run's description.
    first: Option<LogRecord>,
    /// Only zeros have been read since the last whole record.
    zeros: bool,
    done: bool,
    finished: bool,
}

/// The contents of the records read so far.
struct LogContents {
    path: PathBuf,
    metadata: BTreeMap<String, BTreeMap<String, String>>,
    scenario: String,
    /// Name and text of each schema.
    schemas: BTreeMap<u16, (String, Vec<u8>)>,
    /// The sample type of each channel; `None` for channels of other programs.
    channels: BTreeMap<u16, Option<SampleKind>>,
    /// Offset from the run's clock to wall time, ns; `None` where no run is described.
    shift_ns: Option<i128>,
    /// Log time of the last message; a gap has the same time.
    last_ns: u64,
    /// The run's number of ticks; no tick of a sample is greater.
    ticks: u64,
    /// Gaps read so far; a gap's sequence number.
    gaps: u64,
    /// The data section has ended.
    data_ended: bool,
}

#[derive(Debug, Clone, Copy)]
enum SampleKind {
    Observation,
    Command,
    Learning,
    Gap,
}

/// A record as the iterator sees it. One exists at a time, so that its size does not matter.
#[allow(clippy::large_enum_variant)]
enum ReadStep {
    Message(LogRecord),
    Other,
}

impl LogReader {
    /// Opens a log and reads up to its first message, so that its description is known.
    ///
    /// # Errors
    ///
    /// [`LogError::Read`] if the file cannot be opened or read, [`LogError::NotALog`] if it is something else
    /// or was cut off inside its description, [`LogError::Version`] if its samples have another layout than
    /// this build's, [`LogError::Damaged`] if a record makes no sense.
    pub fn open(path: &Path) -> Result<LogReader, LogError> {
        let file = File::open(path).map_err(|e| LogError::read(path, e))?;
        Self::over(path, Box::new(file))
    }

    /// Reads a log from any source of bytes; messages name it `path`.
    ///
    /// # Errors
    ///
    /// As [`open`](Self::open).
    pub fn over(path: &Path, source: Box<dyn Read + Send>) -> Result<LogReader, LogError> {
        let options = LinearReaderOptions::default()
            // Chunks of a packed log are returned as records, so that their place in the file is known.
            .with_emit_chunks(true)
            .with_check_finishes_after_end_magic(true)
            .with_validate_data_section_crc(true)
            .with_validate_summary_section_crc(true)
            .with_record_length_limit(MAX_RECORD);
        let contents = LogContents {
            path: path.to_owned(),
            metadata: BTreeMap::new(),
            scenario: String::new(),
            schemas: BTreeMap::new(),
            channels: BTreeMap::new(),
            shift_ns: None,
            last_ns: 0,
            ticks: u64::MAX,
            gaps: 0,
            data_ended: false,
        };
        let mut log = LogReader {
            source,
            linear: LinearReader::new_with_options(options),
            contents,
            chunk: None,
            packed: false,
            position: mcap::MAGIC.len() as u64,
            first: None,
            zeros: false,
            done: false,
            finished: false,
        };
        log.first = log.read_message()?;
        if !log.contents.metadata.contains_key(RUN_METADATA) {
            let why = if log.finished || log.first.is_some() {
                "an MCAP file, but not one that describes a run"
            } else {
                "it ends before the description of its run does"
            };
            return Err(LogError::not_a_log(path, why));
        }
        Ok(log)
    }

    /// Opens a log that is not packed, reads its description, and goes on at `place`. Checksums are not compared: they
    /// cover what is passed over, too.
    ///
    /// # Errors
    ///
    /// As [`open`](Self::open).
    pub(super) fn open_at(path: &Path, place: LogPlace) -> Result<LogReader, LogError> {
        let mut log = Self::open(path)?;
        let mut file = File::open(path).map_err(|e| LogError::read(path, e))?;
        file.seek(SeekFrom::Start(place.position)).map_err(|e| LogError::read(path, e))?;
        let options = LinearReaderOptions::default()
            .with_skip_start_magic(true)
            .with_emit_chunks(true)
            .with_check_finishes_after_end_magic(true)
            .with_record_length_limit(MAX_RECORD);
        (log.source, log.linear) = (Box::new(file), LinearReader::new_with_options(options));
        (log.first, log.position) = (None, place.position);
        (log.zeros, log.done, log.finished, log.contents.data_ended) = (false, false, false, false);
        (log.contents.gaps, log.contents.last_ns) = (place.gaps, place.last_ns);
        Ok(log)
    }

    /// The file.
    pub fn path(&self) -> &Path {
        &self.contents.path
    }

    /// All metadata records read so far, by name. `tectum.run` is known from the start, `tectum.totals` after
    /// the last message.
    pub fn metadata(&self) -> &BTreeMap<String, BTreeMap<String, String>> {
        &self.contents.metadata
    }

    /// A value of the run's description, for example `seed` or `clock`.
    pub fn run(&self, key: &str) -> Option<&str> {
        self.contents.run(key)
    }

    /// The resolved scenario, TOML.
    pub fn scenario(&self) -> &str {
        &self.contents.scenario
    }

    /// The logger's totals; `None` before the last message has been read, and for a torn log.
    pub fn totals(&self) -> Option<LogTotals> {
        LogTotals::from_map(self.contents.metadata.get(TOTALS_METADATA)?)
    }

    /// Which segment of the run's log the file is, and what the earlier segments hold.
    pub fn log_segment(&self) -> LogSegment {
        self.contents.metadata.get(RUN_METADATA).map(LogSegment::from_map).unwrap_or_default()
    }

    /// Message counts to which the file's messages can be added.
    pub fn message_counts(&self) -> MessageCounts {
        MessageCounts::after(&self.log_segment())
    }

    /// The tick from which on samples are missing because the disk was full; known after the last message.
    pub fn missing_from(&self) -> Option<u64> {
        let stated = || self.contents.metadata.get(MISSING_METADATA)?.get("from_tick")?.parse().ok();
        self.totals().map_or_else(stated, |totals| totals.missing_from)
    }

    /// Whether the log was torn and then repaired; known after the last message.
    pub fn repaired(&self) -> bool {
        self.contents.metadata.contains_key(REPAIR_METADATA)
    }

    /// Every `every()`-th tick is written.
    pub fn every(&self) -> u64 {
        self.run("every").and_then(|every| every.parse().ok()).unwrap_or(1).max(1)
    }

    /// Whether the file was read to the end that its logger wrote, with correct checksums. False until the
    /// iterator has ended.
    pub fn finished(&self) -> bool {
        self.finished
    }

    /// Whether the messages are in chunks: the log was packed. Known after the first message.
    pub fn packed(&self) -> bool {
        self.packed
    }

    /// Bytes from the file's start to the end of the last whole record read.
    pub fn position(&self) -> u64 {
        self.position
    }

    /// The next message, or `None` at the end, whole or torn.
    fn read_message(&mut self) -> Result<Option<LogRecord>, LogError> {
        while !self.done {
            match self.read_record() {
                Ok(Some(ReadStep::Message(record))) => return Ok(Some(record)),
                Ok(Some(ReadStep::Other)) => {}
                Ok(None) => self.done = true,
                Err(e) => {
                    self.done = true;
                    return Err(e);
                }
            }
        }
        Ok(None)
    }

    fn read_record(&mut self) -> Result<Option<ReadStep>, LogError> {
        loop {
            if let Some((chunk, start)) = &mut self.chunk {
                let start = *start;
                match chunk.next_record() {
                    Some(Ok((opcode, body))) => return self.contents.take(opcode, body, start).map(Some),
                    Some(Err(why)) => return Err(damaged(&self.contents.path, start, why)),
                    None => self.chunk = None,
                }
            }
            let event = match self.linear.next_event() {
                None => {
                    self.finished = true;
                    return Ok(None);
                }
                Some(Err(error)) => return end_without_magic(&self.contents.path, self.position, error),
                Some(Ok(event)) => event,
            };
            match event {
                LinearReadEvent::ReadRequest(n) => {
                    let buffer = self.linear.insert(n.max(READ_SIZE));
                    let bytes = loop {
                        match self.source.read(buffer) {
                            Err(e) if e.kind() == ErrorKind::Interrupted => {}
                            other => break other.map_err(|e| LogError::read(&self.contents.path, e))?,
                        }
                    };
                    self.linear.notify_read(bytes);
                }
                LinearReadEvent::Record { data, opcode } => {
                    // A file system leaves zeros up to the end for pages that were never written to the disk.
                    self.zeros |= opcode == 0;
                    if self.zeros {
                        if opcode == 0 && data.is_empty() {
                            continue;
                        }
                        return Err(damaged(
                            &self.contents.path,
                            self.position,
                            "zeros stand where a record should begin",
                        ));
                    }
                    let start = self.position;
                    self.position += 9 + data.len() as u64;
                    if opcode == op::CHUNK {
                        let chunk =
                            ChunkRecords::unpack(data).map_err(|why| damaged(&self.contents.path, start, why))?;
                        (self.chunk, self.packed) = (Some((chunk, start)), true);
                        continue;
                    }
                    return self.contents.take(opcode, data, start).map(Some);
                }
            }
        }
    }
}

/// What it means that MCAP's reader fails behind the last whole record, at byte `position`: a torn log ends there.
fn end_without_magic(path: &Path, position: u64, error: McapError) -> Result<Option<ReadStep>, LogError> {
    let magic = mcap::MAGIC.len() as u64;
    match error {
        McapError::UnexpectedEof if position > magic => Ok(None),
        McapError::UnexpectedEof => Err(LogError::not_a_log(path, "it is empty or ends within its first bytes")),
        McapError::BadMagic if position == magic => {
            Err(LogError::not_a_log(path, "it does not start like an MCAP file"))
        }
        McapError::BytesAfterEndMagic => Err(LogError::BehindEnd { path: path.to_owned(), end: position + magic }),
        error => Err(damaged(path, position, &error.to_string())),
    }
}

impl LogContents {
    fn run(&self, key: &str) -> Option<&str> {
        self.metadata.get(RUN_METADATA)?.get(key).map(String::as_str)
    }

    /// Takes the record that begins at byte `at`.
    fn take(&mut self, opcode: u8, body: &[u8], at: u64) -> Result<ReadStep, LogError> {
        // After the data comes MCAP's summary, which repeats schemas and channels.
        if self.data_ended {
            return Ok(ReadStep::Other);
        }
        let bad = |what: &str| damaged(&self.path, at, what);
        match opcode {
            op::MESSAGE => return self.take_message(body, at),
            op::SCHEMA => {
                let (id, name, encoding, text) = parse::schema(body).ok_or_else(|| bad("a schema is cut short"))?;
                if encoding == "ros2msg" {
                    self.schemas.insert(id, (name.to_owned(), text.to_vec()));
                }
            }
            op::CHANNEL => {
                let channel = parse::channel(body).ok_or_else(|| bad("a channel is cut short"))?;
                let kind = self.kind(&channel)?;
                self.channels.insert(channel.id, kind);
            }
            op::METADATA => {
                let (name, map) = parse::metadata(body).ok_or_else(|| bad("metadata is cut short"))?;
                self.take_metadata(name, map);
            }
            op::ATTACHMENT => {
                let attachment = parse::attachment(body).ok_or_else(|| bad("an attachment is cut short"))?;
                if attachment.name == SCENARIO_ATTACHMENT {
                    let text = std::str::from_utf8(attachment.data).map_err(|_| bad("the scenario is not text"))?;
                    self.scenario = text.to_owned();
                }
            }
            op::DATA_END => self.data_ended = true,
            _ => {}
        }
        Ok(ReadStep::Other)
    }

    fn take_message(&mut self, body: &[u8], at: u64) -> Result<ReadStep, LogError> {
        let bad = |what: &str| damaged(&self.path, at, what);
        let message = parse::message(body).ok_or_else(|| bad("a message is cut short"))?;
        let kind = match self.channels.get(&message.channel) {
            // A channel of another program in the same file is ignored.
            Some(None) => return Ok(ReadStep::Other),
            Some(Some(kind)) => *kind,
            None => return Err(bad("a message belongs to no channel")),
        };
        let record = kind.decode(message.data).ok_or_else(|| bad("a message has the wrong size"))?;
        let (sequence, ns) = self.envelope(&record);
        let time_differs = ns.is_some_and(|ns| [message.log_time, message.publish_time] != [ns; 2]);
        if record.header().is_some_and(|header| header.tick >= self.ticks) {
            return Err(bad("a sample's tick is beyond the last tick of its run"));
        }
        if message.sequence != sequence as u32 || time_differs {
            return Err(bad("a message's sequence number or time is not that of the sample in it"));
        }
        self.last_ns = message.log_time;
        self.gaps += u64::from(matches!(record, LogRecord::Gap(_)));
        Ok(ReadStep::Message(record))
    }

    fn take_metadata(&mut self, name: &str, map: BTreeMap<String, String>) {
        if name == RUN_METADATA {
            let ns = |key: &str| map.get(key)?.parse::<u64>().ok();
            if let (Some(t0), Some(wall)) = (ns("t0_ns"), ns("wall_at_t0_ns")) {
                self.shift_ns = Some(i128::from(wall) - i128::from(t0));
                self.last_ns = wall;
            }
            self.ticks = ns("ticks").unwrap_or(u64::MAX);
        }
        self.metadata.insert(name.to_owned(), map);
    }

    /// The sequence number and the log time that a record's message must have; no time where the run's clock is
    /// not known.
    fn envelope(&self, record: &LogRecord) -> (u64, Option<u64>) {
        let Some(header) = record.header() else { return (self.gaps, Some(self.last_ns)) };
        let wall = |shift: i128| (i128::from(header.published_ns) + shift).clamp(0, i128::from(u64::MAX)) as u64;
        (header.sequence, self.shift_ns.map(wall))
    }

    /// The sample type that a channel carries; `None` for a channel of another program.
    fn kind(&self, channel: &parse::ChannelRecord) -> Result<Option<SampleKind>, LogError> {
        let Some((name, text)) = self.schemas.get(&channel.schema) else { return Ok(None) };
        let check = |kind: SampleKind, expected: &'static str, ours: String| {
            let version = channel.metadata.get("sample").map_or("a sample without a version", String::as_str);
            if version == expected && channel.encoding == "cdr" && *text == ours.into_bytes() {
                return Ok(Some(kind));
            }
            let found = match version == expected {
                true => format!("another definition of {expected}"),
                false => version.to_owned(),
            };
            let build = self.run("build").unwrap_or("unknown").to_owned();
            Err(LogError::Version { path: self.path.clone(), topic: channel.topic.to_owned(), found, expected, build })
        };
        match name.as_str() {
            Observation::ROS_NAME => check(SampleKind::Observation, Observation::NAME, Observation::ros2msg()),
            Command::ROS_NAME => check(SampleKind::Command, Command::NAME, Command::ros2msg()),
            Learning::ROS_NAME => check(SampleKind::Learning, Learning::NAME, Learning::ros2msg()),
            Gap::ROS_NAME => check(SampleKind::Gap, Gap::NAME, Gap::ros2msg()),
            _ => Ok(None),
        }
    }
}

impl Iterator for LogReader {
    type Item = Result<LogRecord, LogError>;

    fn next(&mut self) -> Option<Self::Item> {
        match self.first.take() {
            Some(record) => Some(Ok(record)),
            None => self.read_message().transpose(),
        }
    }
}

impl SampleKind {
    fn decode(self, data: &[u8]) -> Option<LogRecord> {
        let body = data.strip_prefix(&ENCAPSULATION[..])?;
        // The bytes may not be aligned, so the sample is copied, not cast.
        Some(match self {
            SampleKind::Observation => LogRecord::Observation(bytemuck::try_pod_read_unaligned(body).ok()?),
            SampleKind::Command => LogRecord::Command(bytemuck::try_pod_read_unaligned(body).ok()?),
            SampleKind::Learning => LogRecord::Learning(bytemuck::try_pod_read_unaligned(body).ok()?),
            SampleKind::Gap => LogRecord::Gap(bytemuck::try_pod_read_unaligned(body).ok()?),
        })
    }
}

pub(super) fn damaged(path: &Path, at: u64, why: &str) -> LogError {
    LogError::Damaged { path: path.to_owned(), at, why: why.to_owned() }
}
