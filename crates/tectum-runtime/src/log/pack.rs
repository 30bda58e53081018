//! Packs a whole log: puts its records into chunks with an index, compressed.
//!
//! While a run writes its log, every message is a record by itself, so that a kill loses none. Many programs read such
//! a file slowly, or show it as empty, because they look for chunks and their index. Packing changes no message and no
//! statement, only the layout: [`LogReader`] reads both. Views of the samples follow behind them
//! ([`views`](super::views)). The packed log replaces the other one at once or not at all.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufReader, BufWriter, ErrorKind, Seek, Write};
use std::path::{Path, PathBuf};

use mcap::records::MessageHeader;
use serde::Serialize;

use super::copier::RecordCopier;
use super::views::{SampleViews, ViewChannel, ViewFacts};
use super::{LogError, LogReader, MessageCounts, in_use};

/// Size of a chunk's records before they are compressed, bytes. Its reader unpacks a chunk at a time.
const CHUNK_BYTES: u64 = 1024 * 1024;

/// What a packed log has beside the samples and statements of the log.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PackExtras {
    /// An index of the messages in each chunk, and views of the samples: for viewers.
    Views,
    /// The index alone.
    Index,
    /// Neither. The index of random numbers is a quarter of their packed size, and this package's readers do without.
    Nothing,
}

/// The result of packing a log.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct PackedLog {
    /// The log that was given.
    pub log: PathBuf,
    /// The packed log.
    pub packed: PathBuf,
    /// Size of the log that was given, bytes.
    pub bytes_before: u64,
    /// Size of the packed log, bytes.
    pub bytes: u64,
    /// Whether the log was packed before, and nothing was written.
    pub already_packed: bool,
}

impl PackedLog {
    /// The object of `--json`.
    pub fn to_json(&self) -> String {
        serde_json::to_string_pretty(self).unwrap_or_default()
    }

    /// The result as text.
    pub fn to_text(&self) -> String {
        if self.already_packed {
            return format!("{} is packed already; it was left alone\n", self.log.display());
        }
        let [before, after] = [self.bytes_before, self.bytes].map(|bytes| bytes as f64 / 1e6);
        format!("{} is packed: {before:.2} MB, now {after:.2} MB\n", self.packed.display())
    }
}

/// Packs the whole log at `path`, with `extras`. Without `out` the packed log replaces
/// it; with `out` it is written there. A log that is packed already is not changed.
///
/// # Errors
///
/// As [`LogReader::open`] and its iterator; [`LogError::InUse`] while its logger is running; [`LogError::Torn`] if it
/// is torn; [`LogError::Write`] if the new file cannot be written or exists.
pub fn pack(path: &Path, out: Option<&Path>, extras: PackExtras) -> Result<PackedLog, LogError> {
    let read = |e| LogError::read(path, e);
    let file = File::open(path).map_err(read)?;
    if in_use(&file) {
        return Err(LogError::InUse { path: path.to_owned() });
    }
    let bytes_before = file.metadata().map_err(read)?.len();
    let target = out.unwrap_or(path);
    let write = |e| LogError::write(target, e);
    if out.is_some_and(Path::exists) {
        return Err(write(ErrorKind::AlreadyExists.into()));
    }
    let (counts, log) = read_whole(path, path)?;
    if log.packed() && out.is_none() {
        let log = path.to_owned();
        return Ok(PackedLog { packed: log.clone(), log, bytes_before, bytes: bytes_before, already_packed: true });
    }
    let folder = target.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let mut draft = tempfile::NamedTempFile::new_in(folder).map_err(write)?;
    copy(path, file, log.position(), extras, draft.as_file_mut()).map_err(|error| match error {
        LogError::Write { error, .. } => write(error),
        other => other,
    })?;
    // Before the packed log takes the other one's place, it is seen to hold the same.
    let (packed_counts, packed) = read_whole(draft.path(), target)?;
    if packed_counts != counts || packed.metadata() != log.metadata() {
        return Err(write(std::io::Error::other("the packed log does not hold what the log holds; it was not kept")));
    }
    let permissions = path.metadata().map_err(read)?.permissions();
    draft.as_file().set_permissions(permissions).map_err(write)?;
    draft.as_file().sync_all().map_err(write)?;
    let bytes = draft.as_file().metadata().map_err(write)?.len();
    match out {
        Some(_) => drop(draft.persist_noclobber(target).map_err(|e| write(e.error))?),
        None => drop(draft.persist(target).map_err(|e| write(e.error))?),
    }
    // Also syncs the names.
    File::open(folder).and_then(|folder| folder.sync_all()).map_err(write)?;
    Ok(PackedLog { log: path.to_owned(), packed: target.to_owned(), bytes_before, bytes, already_packed: false })
}

/// Copies the log `file` at `path` up to byte `end` into chunks.
fn copy(path: &Path, file: File, end: u64, extras: PackExtras, target: &mut File) -> Result<(), LogError> {
    let mut sink = BufWriter::new(target);
    let options = mcap::WriteOptions::new().compression(Some(mcap::Compression::Zstd)).chunk_size(Some(CHUNK_BYTES));
    let options = options.emit_message_indexes(extras != PackExtras::Nothing);
    let mut log = LogReader::open(path)?;
    let mut sample_views = SampleViews::new(ViewFacts::of_log(&log));
    // A packed log may have views. They are made anew, or are not wanted.
    let topics = sample_views.channels().iter().map(|channel| channel.topic);
    let copier = RecordCopier::begin(path, BufReader::new(file), &mut sink, end, options)?;
    let mut copier = copier.without(topics);
    while copier.copy_record()? {}
    if extras == PackExtras::Views {
        let channels = copier.write(|mcap| declare(&sample_views, mcap))?;
        for record in log.by_ref() {
            let record = record?;
            copier.write(|mcap| {
                sample_views.take(&record, |message| {
                    let (channel_id, sequence) = (channels[message.channel], message.sequence as u32);
                    let (log_time, publish_time) = (message.ns, message.ns);
                    let header = MessageHeader { channel_id, sequence, log_time, publish_time };
                    mcap.write_to_known_channel(&header, message.data)
                })
            })?;
        }
    }
    copier.finish()?;
    sink.flush().map_err(|error| LogError::write(path, error))
}

/// Declares the topics of the views; returns the ids of their channels.
fn declare<W: Write + Seek>(views: &SampleViews, mcap: &mut mcap::Writer<W>) -> mcap::McapResult<Vec<u16>> {
    let declare = |channel: &ViewChannel| {
        let schema = mcap.add_schema(channel.schema_name, "ros2msg", channel.schema.as_bytes())?;
        mcap.add_channel(schema, channel.topic, "cdr", &BTreeMap::new())
    };
    views.channels().iter().map(declare).collect()
}

/// Reads the log in `file`, which messages name `path`, to its end, and counts its messages.
fn read_whole(file: &Path, path: &Path) -> Result<(MessageCounts, LogReader), LogError> {
    let source = File::open(file).map_err(|e| LogError::read(path, e))?;
    let mut log = LogReader::over(path, Box::new(source))?;
    let mut counts = log.message_counts();
    for record in log.by_ref() {
        counts.take(&record?);
    }
    if !log.finished() {
        return Err(LogError::Torn { path: path.to_owned() });
    }
    Ok((counts, log))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::log::header::tests::sample_header;
    use crate::log::{LogTotals, LogWriter, repair};
    use crate::wire::{Header, Observation};

    /// A log of `ticks` observations at `path`, torn unless it is to be finished.
    fn write(path: &Path, ticks: u64, finish: bool) {
        let header = crate::log::LogHeader { ticks, ..sample_header() };
        let mut log = LogWriter::create(path, &header).unwrap();
        for tick in 0..ticks {
            let header = Header { run: 1, tick, sequence: tick, published_ns: tick, ..Header::default() };
            log.observation(&Observation { header, reward: tick as f32, ..Observation::default() }).unwrap();
        }
        if finish {
            log.finish(&LogTotals { last_tick: Some(ticks - 1), complete: true, ..LogTotals::default() }).unwrap();
        }
    }

    fn records(path: &Path) -> Vec<crate::log::LogRecord> {
        LogReader::open(path).unwrap().map(Result::unwrap).collect()
    }

    #[test]
    fn a_packed_log_holds_the_same_and_is_indexed() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("log.mcap");
        write(&path, 9_000, true);
        let before = records(&path);
        let packed = pack(&path, None, PackExtras::Index).unwrap();
        assert!(!packed.already_packed && packed.bytes < packed.bytes_before / 4, "{packed:?}");
        assert_eq!(records(&path), before);
        let bytes = std::fs::read(&path).unwrap();
        let summary = mcap::Summary::read(&bytes).unwrap().unwrap();
        assert!(summary.chunk_indexes.len() > 1, "{}", summary.chunk_indexes.len());
        assert_eq!(summary.stats.unwrap().message_count, 9_000);
        assert_eq!(mcap::MessageStream::new(&bytes).unwrap().count(), 9_000);
        assert!(pack(&path, None, PackExtras::Index).unwrap().already_packed);
        assert_eq!(std::fs::read(&path).unwrap(), bytes);
    }

    #[test]
    fn views_stand_beside_the_samples() {
        let folder = tempfile::tempdir().unwrap();
        let (path, packed) = (folder.path().join("log.mcap"), folder.path().join("packed.mcap"));
        write(&path, 100, true);
        pack(&path, Some(&packed), PackExtras::Views).unwrap();
        assert_eq!(records(&packed), records(&path));
        let bytes = std::fs::read(&packed).unwrap();
        let messages: Vec<_> = mcap::MessageStream::new(&bytes).unwrap().map(Result::unwrap).collect();
        let of = |topic: &str| messages.iter().filter(|m| m.channel.topic == topic).collect::<Vec<_>>();
        let measures = of("/measures");
        assert_eq!((measures.len(), of("/inputs").len(), of("/joint_states").len()), (100, 100, 0));
        assert_eq!(of("/loss")[7].data[4..8], (-7.0_f32).to_le_bytes());
        assert_eq!(measures[7].log_time, 7);
        assert_eq!(measures[7].data[4..8], 7.0_f32.to_le_bytes());
        // Packed again they are there once, or not at all.
        let mut sizes = Vec::new();
        let kinds = [(PackExtras::Views, messages.len()), (PackExtras::Index, 100), (PackExtras::Nothing, 100)];
        for (extras, count) in kinds {
            let again = folder.path().join(format!("again-{extras:?}.mcap"));
            sizes.push(pack(&packed, Some(&again), extras).unwrap().bytes);
            let bytes = std::fs::read(&again).unwrap();
            assert_eq!((mcap::MessageStream::new(&bytes).unwrap().count(), records(&again)), (count, records(&path)));
        }
        // An entry of the index is an instant and a place.
        assert!(sizes[0] > sizes[1] && sizes[1] > sizes[2] + 100 * 16, "{sizes:?}");
        let schema = measures[0].channel.schema.as_ref().unwrap();
        assert_eq!(std::str::from_utf8(&schema.data).unwrap(), "float32 reward # \nfloat32 error # \n");
    }

    #[test]
    fn a_torn_log_is_not_packed_and_a_cut_packed_log_can_be_repaired() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("log.mcap");
        write(&path, 9_000, false);
        let before = std::fs::read(&path).unwrap();
        let error = pack(&path, None, PackExtras::Index).unwrap_err().to_string();
        assert!(error.contains("torn") && error.contains("tectum log repair"), "{error}");
        assert_eq!(std::fs::read(&path).unwrap(), before);
        repair(&path, None).unwrap();
        let all = records(&path);
        pack(&path, None, PackExtras::Index).unwrap();
        let bytes = std::fs::read(&path).unwrap();
        let cut = folder.path().join("cut.mcap");
        for length in (0..bytes.len()).step_by(bytes.len() / 50) {
            std::fs::write(&cut, &bytes[..length]).unwrap();
            let Ok(log) = LogReader::open(&cut) else { continue };
            let some: Vec<_> = log.map(Result::unwrap).collect();
            assert_eq!(some, all[..some.len()], "{length}");
        }
        std::fs::write(&cut, &bytes[..bytes.len() - 40]).unwrap();
        assert!(repair(&cut, None).unwrap().mended.is_some());
        assert_eq!(records(&cut), all);
    }
}
