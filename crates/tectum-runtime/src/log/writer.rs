//! Writes a log as plain MCAP records. Each record is handed to the operating system before its call returns.
//!
//! MCAP's usual chunks would compress better, but a killed process would lose every message since the last
//! chunk. Here a message is in the operating system's cache as soon as its call returns: the process may die at
//! any instant without loss. Only a power failure loses the last seconds. [`LogWriter::finish`] syncs the file
//! to the disk.
//!
//! A full disk is noticed before it cuts off a message, see [`disk_reserve`](super::disk_reserve). Gap messages
//! and the end of the log still have space then.
//!
//! A message costs no allocation: its bytes are assembled in the writer, and `mcap` allocates nothing more once
//! the checksum's batch buffer has grown to its 32 KiB.

use super::disk_reserve::{DiskReserve, RESERVE};
use super::log_file::{LogFile, io_error};
use super::{
    ENCAPSULATION, GAP_TOPIC, HISTOGRAMS_METADATA, LatencyHistograms, LogError, LogHeader, LogPlace, LogRecord,
    LogSegment, LogTotals, MESSAGE_OVERHEAD, MISSING_METADATA, RUN_METADATA, SCENARIO_ATTACHMENT, TOTALS_METADATA,
    WARNINGS_METADATA,
};
use crate::wire::{Command, Gap, Learning, Observation, Sample};
use mcap::records::MessageHeader;
use rustix::fs::{CWD, RenameFlags};
use rustix::io::Errno;
use std::borrow::Cow;
use std::collections::BTreeMap;
use std::fs::{File, TryLockError};
use std::io::{self, BufWriter, Seek, SeekFrom};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::AtomicI32;

/// Bytes that are handed to the operating system at once: what a quick lockstep run logs between two polls.
const BUFFER: usize = 256 * 1024;

/// Bytes of the largest message's data.
const MAX_MESSAGE: usize = ENCAPSULATION.len() + size_of::<Observation>();
const _: () = assert!(size_of::<Command>() <= size_of::<Observation>());
const _: () = assert!(size_of::<Learning>() <= size_of::<Observation>());
const _: () = assert!(size_of::<Gap>() <= size_of::<Observation>());

/// A log that is being written. If dropped without [`finish`](Self::finish), it leaves a torn file, as a killed
/// process does, readable up to its last message.
pub struct LogWriter {
    file: Output,
    channels: [u16; 4],
    written: [u64; 4],
    /// Offset from the run's clock to wall time, ns.
    shift_ns: i128,
    /// Log time of the last message; a gap has no time of its own.
    last_ns: u64,
    /// Contents of the earlier segments.
    before: LogSegment,
    data: [u8; MAX_MESSAGE],
}

type Mcap = mcap::Writer<BufWriter<LogFile>>;

/// The file with its `mcap` writer. After a failure it accepts nothing more.
struct Output {
    path: PathBuf,
    /// `None` only once the writer has been taken apart at the end.
    mcap: Option<Mcap>,
    errno: Arc<AtomicI32>,
    failed: bool,
    reserve: DiskReserve,
    /// Bytes written so far: the beginning of the log and the messages.
    position: u64,
}

/// The contents of a finished log.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct LogSummary {
    /// The file.
    pub path: PathBuf,
    /// Its size, bytes.
    pub bytes: u64,
    /// Messages written to it: observations, commands, learning records, gaps.
    pub written: [u64; 4],
    /// The logger's totals.
    pub totals: LogTotals,
}

impl LogWriter {
    /// Starts a new log at `path` and writes everything up to the first message. The file gets its name when it
    /// describes its run: a process that is killed meanwhile leaves no log that cannot be read.
    ///
    /// # Errors
    ///
    /// [`LogError::Write`] if the file exists already or cannot be made or written; [`LogError::Header`] if
    /// `header` lacks the scenario.
    pub fn create(path: &Path, header: &LogHeader) -> Result<LogWriter, LogError> {
        let run = header.to_map(path)?;
        let draft = draft_of(path);
        let file = open_draft(path, &draft).map_err(|e| LogError::write(path, e))?;
        let log = Self::over(file, path, header, run)
            .and_then(|log| rename_to_new(&draft, path).map(|()| log).map_err(|e| LogError::write(path, e)));
        if log.is_err() {
            let _ = std::fs::remove_file(&draft);
        }
        log
    }

    fn over(file: File, path: &Path, header: &LogHeader, run: BTreeMap<String, String>) -> Result<LogWriter, LogError> {
        let errno = Arc::new(AtomicI32::new(0));
        let reserve = DiskReserve::of(file.try_clone().map_err(|e| LogError::write(path, e))?);
        let sink = BufWriter::with_capacity(BUFFER, LogFile { file, errno: errno.clone() });
        let library = format!("tectum {}", crate::BUILD);
        let options = mcap::WriteOptions::new().use_chunks(false).compression(None).profile("ros2").library(library);
        let mcap = options.create(sink).map_err(|e| LogError::write(path, io_error(e, &errno)))?;
        let mut file = Output { path: path.to_owned(), mcap: Some(mcap), errno, failed: false, reserve, position: 0 };
        let channels = file.run(|mcap| write_description(mcap, header, run))?;
        file.position = file.reserve.length().map_err(|e| LogError::write(path, e))?;
        let mut data = [0; MAX_MESSAGE];
        data[..ENCAPSULATION.len()].copy_from_slice(&ENCAPSULATION);
        let shift_ns = i128::from(header.wall_at_t0_ns) - i128::from(header.t0_ns);
        let (last_ns, before) = (header.wall_at_t0_ns, header.segment);
        Ok(LogWriter { file, channels, written: [0; 4], shift_ns, last_ns, before, data })
    }

    /// Writes an observation and hands it to the operating system.
    ///
    /// # Errors
    ///
    /// [`LogError::Write`], like all methods that write. If the disk [is full](LogError::is_full) and
    /// [`broken`](Self::broken) is false, the sample was not written and the log can still be closed. After any
    /// other failure the log accepts nothing more, and every call returns the error again.
    pub fn observation(&mut self, sample: &Observation) -> Result<(), LogError> {
        self.append_observation(sample)?;
        self.flush()
    }

    /// Writes a command and hands it to the operating system.
    ///
    /// # Errors
    ///
    /// As [`observation`](Self::observation).
    pub fn command(&mut self, sample: &Command) -> Result<(), LogError> {
        self.append_command(sample)?;
        self.flush()
    }

    /// Writes a learning record and hands it to the operating system.
    ///
    /// # Errors
    ///
    /// As [`observation`](Self::observation).
    pub fn learning(&mut self, sample: &Learning) -> Result<(), LogError> {
        self.append_learning(sample)?;
        self.flush()
    }

    /// Writes a statement of missing samples and hands it to the operating system. A gap has the time of the
    /// message before it, and gaps are numbered in the order of writing.
    ///
    /// # Errors
    ///
    /// As [`observation`](Self::observation).
    pub fn gap(&mut self, gap: &Gap) -> Result<(), LogError> {
        self.append(&LogRecord::Gap(*gap))?;
        self.flush()
    }

    /// Writes a record of any kind into the process's own buffer, where a kill can still lose it. For batches,
    /// each completed by [`flush`](Self::flush).
    ///
    /// # Errors
    ///
    /// As [`observation`](Self::observation).
    pub fn append(&mut self, record: &LogRecord) -> Result<(), LogError> {
        match record {
            LogRecord::Observation(s) => self.append_observation(s),
            LogRecord::Command(s) => self.append_command(s),
            LogRecord::Learning(s) => self.append_learning(s),
            LogRecord::Gap(gap) => self.message(3, self.written[3], self.last_ns, gap),
        }
    }

    /// [`append`](Self::append) for an observation.
    ///
    /// # Errors
    ///
    /// As [`observation`](Self::observation).
    #[inline]
    pub(crate) fn append_observation(&mut self, s: &Observation) -> Result<(), LogError> {
        self.sample(0, s.header.sequence, s.header.published_ns, s)
    }

    /// [`append`](Self::append) for a command.
    ///
    /// # Errors
    ///
    /// As [`observation`](Self::observation).
    #[inline]
    pub(crate) fn append_command(&mut self, s: &Command) -> Result<(), LogError> {
        self.sample(1, s.header.sequence, s.header.published_ns, s)
    }

    /// [`append`](Self::append) for a learning record.
    ///
    /// # Errors
    ///
    /// As [`observation`](Self::observation).
    #[inline]
    pub(crate) fn append_learning(&mut self, s: &Learning) -> Result<(), LogError> {
        self.sample(2, s.header.sequence, s.header.published_ns, s)
    }

    /// Hands everything appended to the operating system.
    ///
    /// # Errors
    ///
    /// As [`observation`](Self::observation).
    pub fn flush(&mut self) -> Result<(), LogError> {
        self.file.run(mcap::Writer::flush)
    }

    /// Writes to the log, and flushes, that samples are missing from `tick` on, and why.
    ///
    /// # Errors
    ///
    /// As [`observation`](Self::observation).
    pub fn missing_from(&mut self, tick: u64, why: &LogError) -> Result<(), LogError> {
        let map = [("from_tick", tick.to_string()), ("why", why.to_string())];
        self.metadata(MISSING_METADATA, map.map(|(key, value)| (key.to_owned(), value)).into())?;
        self.flush()
    }

    /// Writes the histograms before the log is closed. Leaves them out if there may be no space for them.
    ///
    /// # Errors
    ///
    /// As [`observation`](Self::observation).
    pub fn timings(&mut self, timings: &LatencyHistograms) -> Result<(), LogError> {
        self.metadata_if_room(HISTOGRAMS_METADATA, timings.to_map())
    }

    /// Writes what did not go well in the run, a sentence for each name, before the log is closed. Writes nothing
    /// if there is none, or may be no space.
    ///
    /// # Errors
    ///
    /// As [`observation`](Self::observation).
    pub fn warnings(&mut self, warnings: BTreeMap<String, String>) -> Result<(), LogError> {
        if warnings.is_empty() { Ok(()) } else { self.metadata_if_room(WARNINGS_METADATA, warnings) }
    }

    fn metadata_if_room(&mut self, name: &str, map: BTreeMap<String, String>) -> Result<(), LogError> {
        let size: usize = map.iter().map(|(key, value)| key.len() + value.len()).sum();
        if size as u64 > RESERVE / 2 && self.file.reserve.ensure(self.file.position + size as u64).is_err() {
            return Ok(());
        }
        self.metadata(name, map)
    }

    fn metadata(&mut self, name: &str, metadata: BTreeMap<String, String>) -> Result<(), LogError> {
        let record = mcap::records::Metadata { name: name.into(), metadata };
        self.file.run(|mcap| mcap.write_metadata(&record))
    }

    /// Compares what was written with what is there. For use after [`flush`](Self::flush).
    ///
    /// # Errors
    ///
    /// [`LogError::Gone`] if the file is no longer at its path, or is shorter than what was written.
    pub fn check_in_place(&self) -> Result<(), LogError> {
        let gone = |what| Err(LogError::Gone { path: self.file.path.clone(), what });
        match (self.file.reserve.length(), self.is_in_place()) {
            (_, false) => gone("was removed or replaced"),
            (Ok(length), true) if length < self.file.position => gone("was cut off"),
            _ => Ok(()),
        }
    }

    /// Whether the file at the log's path is the one that is written. A device, as in tests, has no place.
    pub fn is_in_place(&self) -> bool {
        self.file.reserve.is_file_at(&self.file.path)
    }

    /// Bytes written so far.
    pub fn bytes(&self) -> u64 {
        self.file.position
    }

    /// Syncs what was flushed to the disk.
    ///
    /// # Errors
    ///
    /// As [`observation`](Self::observation); the log can still be written.
    pub fn sync(&self) -> Result<(), LogError> {
        self.file.reserve.sync().map_err(|e| LogError::write(&self.file.path, e))
    }

    /// Whether writing has failed: the file is then torn, and accepts nothing more.
    pub fn broken(&self) -> bool {
        self.file.failed
    }

    /// Messages written so far: observations, commands, learning records, gaps.
    pub fn written(&self) -> [u64; 4] {
        self.written
    }

    /// The place behind the last message. For use after [`flush`](Self::flush).
    pub(crate) fn place(&self) -> LogPlace {
        LogPlace { position: self.file.position, gaps: self.written[3], last_ns: self.last_ns }
    }

    /// The file.
    pub fn path(&self) -> &Path {
        &self.file.path
    }

    /// Closes the log: writes the totals, which are those of the run with all segments, and MCAP's summary and
    /// checksums, and syncs the file to the disk.
    ///
    /// # Errors
    ///
    /// As [`observation`](Self::observation); the file is then torn, but readable. [`LogError::Gone`] if the file
    /// is no longer at its path.
    pub fn finish(mut self, totals: &LogTotals) -> Result<LogSummary, LogError> {
        let written = std::array::from_fn(|i| self.before.written[i] + self.written[i]);
        self.metadata(TOTALS_METADATA, totals.to_map(written))?;
        self.file.run(mcap::Writer::finish)?;
        let path = self.file.path.clone();
        let in_place = self.is_in_place();
        let bytes = self.file.sync().map_err(|e| LogError::write(&path, e))?;
        if !in_place {
            return Err(LogError::Gone { path, what: "was removed or replaced" });
        }
        Ok(LogSummary { path, bytes, written: self.written, totals: *totals })
    }

    fn sample<S: Sample>(&mut self, channel: usize, sequence: u64, published_ns: u64, s: &S) -> Result<(), LogError> {
        let wall = (i128::from(published_ns) + self.shift_ns).clamp(0, i128::from(u64::MAX));
        self.message(channel, sequence, wall as u64, s)
    }

    fn message<S: Sample>(&mut self, channel: usize, sequence: u64, ns: u64, sample: &S) -> Result<(), LogError> {
        let head = ENCAPSULATION.len();
        let end = head + size_of::<S>();
        self.data[head..end].copy_from_slice(bytemuck::bytes_of(sample));
        // Gap messages always have space in the reserve.
        if channel < 3 {
            self.file.reserve.ensure(self.file.position).map_err(|e| LogError::write(&self.file.path, e))?;
        }
        let header = MessageHeader {
            channel_id: self.channels[channel],
            // MCAP has only 32 bits here; the sample's own header has all 64.
            sequence: sequence as u32,
            log_time: ns,
            publish_time: ns,
        };
        let data = &self.data[..end];
        self.file.run(|mcap| mcap.write_to_known_channel(&header, data))?;
        self.file.position += (MESSAGE_OVERHEAD + end) as u64;
        self.last_ns = ns;
        self.written[channel] += 1;
        Ok(())
    }
}

impl Output {
    fn run<T>(&mut self, work: impl FnOnce(&mut Mcap) -> mcap::McapResult<T>) -> Result<T, LogError> {
        let result = match &mut self.mcap {
            Some(mcap) if !self.failed => work(mcap),
            _ => Err(mcap::McapError::AttemptedWriteAfterFailure),
        };
        result.map_err(|e| {
            self.failed = true;
            LogError::write(&self.path, io_error(e, &self.errno))
        })
    }

    /// Takes the writer apart, syncs the file, and returns its size in bytes.
    fn sync(&mut self) -> io::Result<u64> {
        let Some(mcap) = self.mcap.take() else { return Ok(0) };
        let mut sink = mcap.into_inner().into_inner().map_err(|e| e.into_error())?;
        let end = sink.file.seek(SeekFrom::End(0))?;
        self.reserve.release(end)?;
        sink.file.sync_all()?;
        Ok(end)
    }
}

impl Drop for Output {
    fn drop(&mut self) {
        // Dropping the `mcap` writer would write a summary and make a torn log look whole.
        if let Some(mcap) = self.mcap.take() {
            drop(mcap.into_inner());
        }
    }
}

/// Where a log is begun.
fn draft_of(path: &Path) -> PathBuf {
    let mut draft = path.as_os_str().to_owned();
    draft.push(".new");
    draft.into()
}

/// Opens the draft of a log that does not exist yet. A draft that a killed process left is begun anew.
fn open_draft(path: &Path, draft: &Path) -> io::Result<File> {
    if path.try_exists()? {
        return Err(io::ErrorKind::AlreadyExists.into());
    }
    // Appending: if somebody cuts the file off meanwhile, it stays too short, and that is seen.
    let file = File::options().append(true).create(true).open(draft)?;
    // The lock tells `repair` that the log is not torn but being written, and another writer that the draft is in
    // use. A file system without locks cannot tell.
    if let Err(TryLockError::WouldBlock) = file.try_lock() {
        return Err(io::ErrorKind::AlreadyExists.into());
    }
    file.set_len(0)?;
    Ok(file)
}

/// Renames a file unless the new name is taken.
fn rename_to_new(from: &Path, to: &Path) -> io::Result<()> {
    match rustix::fs::renameat_with(CWD, from, CWD, to, RenameFlags::NOREPLACE) {
        // Not every file system knows the flag.
        Err(Errno::INVAL | Errno::NOSYS) if !to.try_exists()? => std::fs::rename(from, to),
        Err(Errno::INVAL | Errno::NOSYS) => Err(io::ErrorKind::AlreadyExists.into()),
        result => Ok(result?),
    }
}

/// Writes everything before the first message; returns the ids of the four channels.
fn write_description(mcap: &mut Mcap, header: &LogHeader, run: BTreeMap<String, String>) -> mcap::McapResult<[u16; 4]> {
    mcap.attach(&mcap::Attachment {
        log_time: header.wall_at_t0_ns,
        create_time: header.wall_at_t0_ns,
        name: SCENARIO_ATTACHMENT.into(),
        media_type: "application/toml".into(),
        data: Cow::Borrowed(header.scenario.as_bytes()),
    })?;
    mcap.write_metadata(&mcap::records::Metadata { name: RUN_METADATA.into(), metadata: run })?;
    let [observation, command, learning] = header.topics();
    let channels = [
        add_channel::<Observation>(mcap, &observation)?,
        add_channel::<Command>(mcap, &command)?,
        add_channel::<Learning>(mcap, &learning)?,
        add_channel::<Gap>(mcap, GAP_TOPIC)?,
    ];
    // From here on the file describes its run, even if nothing else follows.
    mcap.flush()?;
    Ok(channels)
}

fn add_channel<S: Sample>(mcap: &mut Mcap, topic: &str) -> mcap::McapResult<u16> {
    let schema = mcap.add_schema(S::ROS_NAME, "ros2msg", S::ros2msg().as_bytes())?;
    mcap.add_channel(schema, topic, "cdr", &BTreeMap::from([("sample".to_owned(), S::NAME.to_owned())]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::log::header::tests::sample_header;

    /// `/dev/full` behaves like a disk that is full at the first byte.
    #[test]
    fn a_full_device_is_reported_as_full() {
        let path = Path::new("/dev/full");
        let file = File::options().write(true).open(path).unwrap();
        let header = sample_header();
        let run = header.to_map(path).unwrap();
        let error = LogWriter::over(file, path, &header, run).err().unwrap();
        assert!(error.is_full(), "{error}");
        assert!(error.to_string().contains("/dev/full cannot be written: no space left on device; free"), "{error}");
    }

    #[test]
    fn a_log_is_never_overwritten() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("log.mcap");
        std::fs::write(&path, "precious").unwrap();
        let error = LogWriter::create(&path, &sample_header()).err().unwrap();
        assert!(!error.is_full());
        let text = error.to_string();
        assert!(text.contains(path.to_str().unwrap()) && text.contains("exists already"), "{text}");
        assert_eq!(std::fs::read(&path).unwrap(), b"precious");
        let below = LogWriter::create(&path.join("log.mcap"), &sample_header()).err().unwrap().to_string();
        assert!(below.contains("not a folder"), "{below}");
    }

    /// After each call the file itself holds the message.
    #[test]
    fn every_message_is_in_the_file_when_its_call_returns() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("log.mcap");
        let size = || std::fs::metadata(&path).unwrap().len();
        let mut log = LogWriter::create(&path, &sample_header()).unwrap();
        let start = size();
        log.observation(&Observation::default()).unwrap();
        assert_eq!(size() - start, 31 + 4 + 280);
        log.command(&Command::default()).unwrap();
        log.learning(&Learning::default()).unwrap();
        assert_eq!((size() - start) as f64, crate::log::bytes_per_tick(1));
        log.append(&LogRecord::Gap(Gap::default())).unwrap();
        assert_eq!((size() - start) as f64, crate::log::bytes_per_tick(1));
        log.flush().unwrap();
        assert_eq!(size() - start, 745 + 31 + 4 + 32);
        assert_eq!(log.written(), [1; 4]);
    }
}
