//! Copies a log's records into a new file, whose layout may be another one: with chunks or without.

use std::borrow::Cow;
use std::collections::{BTreeMap, BTreeSet};
use std::io::{ErrorKind, Read, Seek, Write};
use std::path::Path;

use mcap::records::{MessageHeader, Metadata};
use mcap::{McapError, WriteOptions};

use super::LogError;
use super::chunk::ChunkRecords;
use super::parse::{self, op};
use super::reader::{MAX_RECORD, damaged};

/// Copies a log's records into a new file.
pub(super) struct RecordCopier<'a, R: Read, W: Write + Seek> {
    path: &'a Path,
    source: R,
    sink: RecordSink<W>,
    /// Bytes read, and where the last whole record ends.
    at: u64,
    end: u64,
    body: Vec<u8>,
}

/// Where the records go.
struct RecordSink<W: Write + Seek> {
    mcap: mcap::Writer<W>,
    /// Topics that are not copied, and the ids of their channels.
    left_out: Vec<&'static str>,
    left_out_channels: BTreeSet<u16>,
}

impl<'a, R: Read, W: Write + Seek> RecordCopier<'a, R, W> {
    /// Copies the log `source`, whose last whole record ends at byte `end`, to `sink`, with the layout of `options`.
    pub fn begin(path: &'a Path, mut source: R, sink: W, end: u64, options: WriteOptions) -> Result<Self, LogError> {
        let mut at = mcap::MAGIC.len() as u64;
        source.read_exact(&mut [0; mcap::MAGIC.len()]).map_err(|e| LogError::read(path, e))?;
        let mut body = Vec::new();
        let first = read_record(path, &mut source, &mut at, &mut body)?;
        let (profile, library) =
            parse::header(&body).filter(|_| first == op::HEADER).ok_or_else(|| damaged(path, 8, "no header"))?;
        let mcap = options.profile(profile).library(library).create(sink).map_err(|e| write_error(path, at, e))?;
        let sink = RecordSink { mcap, left_out: Vec::new(), left_out_channels: BTreeSet::new() };
        Ok(Self { path, source, sink, at, end, body })
    }

    /// Leaves out the messages of these topics.
    pub fn without(mut self, topics: impl Iterator<Item = &'static str>) -> Self {
        self.sink.left_out.extend(topics);
        self
    }

    /// Copies the next record, or all records of the next chunk. Returns false after the last whole record, and at the
    /// end of the data section.
    pub fn copy_record(&mut self) -> Result<bool, LogError> {
        if self.at >= self.end {
            return Ok(false);
        }
        let (path, start) = (self.path, self.at);
        let opcode = read_record(path, &mut self.source, &mut self.at, &mut self.body)?;
        if opcode != op::CHUNK {
            return self.sink.copy(path, start, opcode, &self.body);
        }
        let mut chunk = ChunkRecords::unpack(&self.body).map_err(|why| damaged(path, start, why))?;
        while let Some(record) = chunk.next_record() {
            let (opcode, body) = record.map_err(|why| damaged(path, start, why))?;
            self.sink.copy(path, start, opcode, body)?;
        }
        Ok(true)
    }

    /// The number of bytes after the last whole record. If they begin with a zero, all must be zeros.
    pub fn incomplete_bytes(&mut self) -> Result<u64, LogError> {
        let failed = |e| LogError::read(self.path, e);
        // Skips whole records of a summary, which is written anew.
        let summary = self.end.saturating_sub(self.at);
        std::io::copy(&mut self.source.by_ref().take(summary), &mut std::io::sink()).map_err(failed)?;
        let (mut count, mut first, mut all_zeros, mut buffer) = (0, 1, true, [0; 8192]);
        loop {
            let n = match self.source.read(&mut buffer) {
                Err(e) if e.kind() == ErrorKind::Interrupted => continue,
                other => other.map_err(failed)?,
            };
            if n == 0 {
                break;
            }
            if count == 0 {
                first = buffer[0];
            }
            all_zeros &= buffer[..n].iter().all(|&byte| byte == 0);
            count += n as u64;
        }
        if first == 0 && !all_zeros {
            return Err(damaged(self.path, self.end, "zeros stand where a record should begin"));
        }
        Ok(count)
    }

    pub fn add_metadata(&mut self, name: &str, metadata: BTreeMap<String, String>) -> Result<(), LogError> {
        let record = Metadata { name: name.into(), metadata };
        self.sink.mcap.write_metadata(&record).map_err(|e| write_error(self.path, self.end, e))
    }

    /// Writes more records behind the copied ones.
    pub fn write<T>(&mut self, work: impl FnOnce(&mut mcap::Writer<W>) -> mcap::McapResult<T>) -> Result<T, LogError> {
        work(&mut self.sink.mcap).map_err(|e| write_error(self.path, self.end, e))
    }

    pub fn finish(mut self) -> Result<(), LogError> {
        self.sink.mcap.finish().map(drop).map_err(|e| write_error(self.path, self.end, e))
    }
}

impl<W: Write + Seek> RecordSink<W> {
    /// Writes one record, which begins at byte `start` or in the chunk there. Returns false at the end of the data
    /// section.
    fn copy(&mut self, path: &Path, start: u64, opcode: u8, body: &[u8]) -> Result<bool, LogError> {
        let mcap = &mut self.mcap;
        let short = || damaged(path, start, "a record is cut short");
        let done = match opcode {
            op::SCHEMA => {
                let (id, name, encoding, text) = parse::schema(body).ok_or_else(short)?;
                mcap.add_schema_with_id(id, name, encoding, text).map(drop)
            }
            op::CHANNEL => {
                let c = parse::channel(body).ok_or_else(short)?;
                if self.left_out.contains(&c.topic) {
                    self.left_out_channels.insert(c.id);
                    return Ok(true);
                }
                mcap.add_channel_with_id(c.id, c.schema, c.topic, c.encoding, &c.metadata).map(drop)
            }
            op::MESSAGE => {
                let m = parse::message(body).ok_or_else(short)?;
                if self.left_out_channels.contains(&m.channel) {
                    return Ok(true);
                }
                let header = MessageHeader {
                    channel_id: m.channel,
                    sequence: m.sequence,
                    log_time: m.log_time,
                    publish_time: m.publish_time,
                };
                mcap.write_to_known_channel(&header, m.data)
            }
            op::METADATA => {
                let (name, metadata) = parse::metadata(body).ok_or_else(short)?;
                mcap.write_metadata(&Metadata { name: name.to_owned(), metadata })
            }
            op::ATTACHMENT => {
                let a = parse::attachment(body).ok_or_else(short)?;
                mcap.attach(&mcap::Attachment {
                    log_time: a.log_time,
                    create_time: a.create_time,
                    name: a.name.to_owned(),
                    media_type: a.media_type.to_owned(),
                    data: Cow::Borrowed(a.data),
                })
            }
            op::DATA_END => return Ok(false),
            // Our logger writes no other records, and no message depends on them. The writer makes its own indexes.
            _ => Ok(()),
        };
        done.map(|()| true).map_err(|e| write_error(path, start, e))
    }
}

fn read_record(path: &Path, source: &mut impl Read, at: &mut u64, body: &mut Vec<u8>) -> Result<u8, LogError> {
    let failed = |e| LogError::read(path, e);
    let mut head = [0; 9];
    source.read_exact(&mut head).map_err(failed)?;
    let [opcode, length @ ..] = head;
    let length = u64::from_le_bytes(length);
    // The reader has checked the length, but the file may have changed since.
    let n = usize::try_from(length).ok().filter(|&n| n <= MAX_RECORD);
    body.resize(n.ok_or_else(|| damaged(path, *at, "a record is larger than any of a log"))?, 0);
    source.read_exact(body).map_err(failed)?;
    *at += 9 + length;
    Ok(opcode)
}

/// An error of the writer: a full or failing disk, or a record that is invalid in a log.
fn write_error(path: &Path, at: u64, error: McapError) -> LogError {
    match error {
        McapError::Io(error) => LogError::write(path, error),
        other => damaged(path, at, &other.to_string()),
    }
}
