//! Writing a log: plain MCAP records, each out of the process before its call returns.
//!
//! MCAP's usual chunks would compress better and cost every message since the last one when the process is killed. Here
//! a message lies in the operating system's cache as soon as its call is over: the process may die at any instant, only
//! a machine that loses its power takes the last seconds with it. [`LogWriter::finish`] asks for the disk itself.
//!
//! A disk that is full is noticed before a message is cut off by it: see [`room`](super::room). Statements of gaps and the end
//! of the log have room all the same.
//!
//! A message costs no allocation: its bytes are put together in the writer, and `mcap` keeps what it needs once the
//! checksum's batch buffer has grown to its 32 KiB.

use super::disk_reserve::{DiskReserve, RESERVE};
use super::log_file::{LogFile, io_error};
use super::{
    ENCAPSULATION, GAP_TOPIC, HISTOGRAMS_METADATA, LatencyHistograms, LogError, LogHeader, LogRecord, LogSegment,
    LogTotals, MESSAGE_OVERHEAD, MISSING_METADATA, RUN_METADATA, SCENARIO_ATTACHMENT, TOTALS_METADATA,
};
use crate::wire::{Command, Gap, Learning, Observation, Sample};
use mcap::records::MessageHeader;
use std::borrow::Cow;
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, BufWriter, Seek, SeekFrom};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::AtomicI32;

/// Room for the largest message's data.
const LARGEST: usize = ENCAPSULATION.len() + size_of::<Observation>();
const _: () = assert!(size_of::<Command>() <= size_of::<Observation>());
const _: () = assert!(size_of::<Learning>() <= size_of::<Observation>());
const _: () = assert!(size_of::<Gap>() <= size_of::<Observation>());

/// A log being written. Dropped without [`finish`](Self::finish) it leaves what a killed process leaves: a torn file,
/// readable up to its last message.
pub struct LogWriter {
    file: Output,
    channels: [u16; 4],
    written: [u64; 4],
    /// From the run's clock to wall time, ns.
    shift_ns: i128,
    /// Log time of the last message; a gap has no time of its own.
    last_ns: u64,
    /// What earlier segments hold.
    before: LogSegment,
    data: [u8; LARGEST],
}

type Mcap = mcap::Writer<BufWriter<LogFile>>;

/// The file under its `mcap` writer, which takes nothing more after a failure.
struct Output {
    path: PathBuf,
    /// `None` only once the writer has been taken apart at the end.
    mcap: Option<Mcap>,
    errno: Arc<AtomicI32>,
    failed: bool,
    room: DiskReserve,
    /// Bytes written so far, of messages and what comes before them.
    at: u64,
}

/// What a finished log holds.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct LogSummary {
    /// The file.
    pub path: PathBuf,
    /// Its size, bytes.
    pub bytes: u64,
    /// Messages written to it: observations, commands, learning records, gaps.
    pub written: [u64; 4],
    /// What the logger said at the end.
    pub totals: LogTotals,
}

impl LogWriter {
    /// Starts a new log at `path` and writes everything up to the first message.
    ///
    /// # Errors
    ///
    /// [`LogError::Write`] if the file exists already or cannot be made or written; [`LogError::Header`] if `header`
    /// lacks the scenario.
    pub fn create(path: &Path, header: &LogHeader) -> Result<LogWriter, LogError> {
        let run = header.to_map(path)?;
        let file = File::create_new(path).map_err(|e| LogError::write(path, e))?;
        // Tells those who would repair it that it is not torn but being written. Where there are no locks, nobody is told.
        let _ = file.try_lock();
        Self::over(file, path, header, run)
    }

    fn over(file: File, path: &Path, header: &LogHeader, run: BTreeMap<String, String>) -> Result<LogWriter, LogError> {
        let errno = Arc::new(AtomicI32::new(0));
        let room = DiskReserve::of(file.try_clone().map_err(|e| LogError::write(path, e))?);
        let sink = BufWriter::with_capacity(64 * 1024, LogFile { file, errno: errno.clone() });
        let library = format!("tectum {}", crate::BUILD);
        let options = mcap::WriteOptions::new().use_chunks(false).compression(None).profile("ros2").library(library);
        let mcap = options.create(sink).map_err(|e| LogError::write(path, io_error(e, &errno)))?;
        let mut file = Output { path: path.to_owned(), mcap: Some(mcap), errno, failed: false, room, at: 0 };
        let channels = file.run(|mcap| describe(mcap, header, run))?;
        file.at = file.room.length().map_err(|e| LogError::write(path, e))?;
        let mut data = [0; LARGEST];
        data[..ENCAPSULATION.len()].copy_from_slice(&ENCAPSULATION);
        let shift_ns = i128::from(header.wall_at_t0_ns) - i128::from(header.t0_ns);
        let (last_ns, before) = (header.wall_at_t0_ns, header.segment);
        Ok(LogWriter { file, channels, written: [0; 4], shift_ns, last_ns, before, data })
    }

    /// Writes an observation and hands it to the operating system.
    ///
    /// # Errors
    ///
    /// [`LogError::Write`], as all methods that write. If it [is full](LogError::is_full) and [`broken`](Self::broken) is
    /// false, the sample was not written and the log can still be closed. After any other failure the log takes nothing
    /// more, and every call says so again.
    pub fn observation(&mut self, sample: &Observation) -> Result<(), LogError> {
        self.sample(0, sample.header.sequence, sample.header.published_ns, sample)?;
        self.flush()
    }

    /// Writes a command and hands it to the operating system.
    ///
    /// # Errors
    ///
    /// As [`observation`](Self::observation).
    pub fn command(&mut self, sample: &Command) -> Result<(), LogError> {
        self.sample(1, sample.header.sequence, sample.header.published_ns, sample)?;
        self.flush()
    }

    /// Writes a learning record and hands it to the operating system.
    ///
    /// # Errors
    ///
    /// As [`observation`](Self::observation).
    pub fn learning(&mut self, sample: &Learning) -> Result<(), LogError> {
        self.sample(2, sample.header.sequence, sample.header.published_ns, sample)?;
        self.flush()
    }

    /// Writes that samples are missing and hands it to the operating system. A gap stands at the time of the message
    /// before it, and gaps are numbered in the order of writing.
    ///
    /// # Errors
    ///
    /// As [`observation`](Self::observation).
    pub fn gap(&mut self, gap: &Gap) -> Result<(), LogError> {
        self.append(&LogRecord::Gap(*gap))?;
        self.flush()
    }

    /// Writes a record of any kind into the process's own buffer, where a kill can still lose it: for batches, each
    /// closed by [`flush`](Self::flush).
    ///
    /// # Errors
    ///
    /// As [`observation`](Self::observation).
    pub fn append(&mut self, record: &LogRecord) -> Result<(), LogError> {
        match record {
            LogRecord::Observation(s) => self.sample(0, s.header.sequence, s.header.published_ns, s),
            LogRecord::Command(s) => self.sample(1, s.header.sequence, s.header.published_ns, s),
            LogRecord::Learning(s) => self.sample(2, s.header.sequence, s.header.published_ns, s),
            LogRecord::Gap(gap) => self.message(3, self.written[3], self.last_ns, gap),
        }
    }

    /// Hands everything appended to the operating system.
    ///
    /// # Errors
    ///
    /// As [`observation`](Self::observation).
    pub fn flush(&mut self) -> Result<(), LogError> {
        self.file.run(mcap::Writer::flush)
    }

    /// Says in the log itself, and at once, that samples are missing from `tick` on, and why.
    ///
    /// # Errors
    ///
    /// As [`observation`](Self::observation).
    pub fn missing_from(&mut self, tick: u64, why: &LogError) -> Result<(), LogError> {
        let map = [("from_tick", tick.to_string()), ("why", why.to_string())];
        self.metadata(MISSING_METADATA, map.map(|(key, value)| (key.to_owned(), value)).into())?;
        self.flush()
    }

    /// Writes the histograms, before the log is closed. Where there may be no room for them, they are left out.
    ///
    /// # Errors
    ///
    /// As [`observation`](Self::observation).
    pub fn timings(&mut self, timings: &LatencyHistograms) -> Result<(), LogError> {
        let map = timings.to_map();
        let size: usize = map.iter().map(|(key, value)| key.len() + value.len()).sum();
        if size as u64 > RESERVE / 2 && self.file.room.secure(self.file.at + size as u64).is_err() {
            return Ok(());
        }
        self.metadata(HISTOGRAMS_METADATA, map)
    }

    fn metadata(&mut self, name: &str, metadata: BTreeMap<String, String>) -> Result<(), LogError> {
        let record = mcap::records::Metadata { name: name.into(), metadata };
        self.file.run(|mcap| mcap.write_metadata(&record))
    }

    /// Writing has failed: the file is torn, and takes nothing more.
    pub fn broken(&self) -> bool {
        self.file.failed
    }

    /// Messages written so far: observations, commands, learning records, gaps.
    pub fn written(&self) -> [u64; 4] {
        self.written
    }

    /// The file.
    pub fn path(&self) -> &Path {
        &self.file.path
    }

    /// Closes the log: totals, which are those of the run with all segments, MCAP's summary and checksums, and then the disk
    /// itself.
    ///
    /// # Errors
    ///
    /// As [`observation`](Self::observation); the file is then torn, but readable.
    pub fn finish(mut self, totals: &LogTotals) -> Result<LogSummary, LogError> {
        let written = std::array::from_fn(|i| self.before.written[i] + self.written[i]);
        self.metadata(TOTALS_METADATA, totals.to_map(written))?;
        self.file.run(mcap::Writer::finish)?;
        let path = self.file.path.clone();
        let bytes = self.file.sync().map_err(|e| LogError::write(&path, e))?;
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
        // A statement of what is missing has its room always.
        if channel < 3 {
            self.file.room.secure(self.file.at).map_err(|e| LogError::write(&self.file.path, e))?;
        }
        let header = MessageHeader {
            channel_id: self.channels[channel],
            // MCAP has 32 bits here; the sample's own header has them all.
            sequence: sequence as u32,
            log_time: ns,
            publish_time: ns,
        };
        let data = &self.data[..end];
        self.file.run(|mcap| mcap.write_to_known_channel(&header, data))?;
        self.file.at += (MESSAGE_OVERHEAD + end) as u64;
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

    /// Takes the writer apart, syncs the file and gives its size in bytes.
    fn sync(&mut self) -> io::Result<u64> {
        let Some(mcap) = self.mcap.take() else { return Ok(0) };
        let mut sink = mcap.into_inner().into_inner().map_err(|e| e.into_error())?;
        let end = sink.file.seek(SeekFrom::End(0))?;
        self.room.give_back(end)?;
        sink.file.sync_all()?;
        Ok(end)
    }
}

impl Drop for Output {
    fn drop(&mut self) {
        // Left alone, `mcap` would write a summary and make a broken-off log look whole.
        if let Some(mcap) = self.mcap.take() {
            drop(mcap.into_inner());
        }
    }
}

/// Everything before the first message; gives the ids of the four channels.
fn describe(mcap: &mut Mcap, header: &LogHeader, run: BTreeMap<String, String>) -> mcap::McapResult<[u16; 4]> {
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
        channel::<Observation>(mcap, &observation)?,
        channel::<Command>(mcap, &command)?,
        channel::<Learning>(mcap, &learning)?,
        channel::<Gap>(mcap, GAP_TOPIC)?,
    ];
    // From here on the file says whose it is, even if nothing else follows.
    mcap.flush()?;
    Ok(channels)
}

fn channel<S: Sample>(mcap: &mut Mcap, topic: &str) -> mcap::McapResult<u16> {
    let schema = mcap.add_schema(S::ROS_NAME, "ros2msg", S::ros2msg().as_bytes())?;
    mcap.add_channel(schema, topic, "cdr", &BTreeMap::from([("sample".to_owned(), S::NAME.to_owned())]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::log::header::tests::sample_header;

    /// A device that is always full shows what a full disk does at the first byte.
    #[test]
    fn a_full_device_is_named_as_such() {
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

    /// What the constructor's comment promises: after each call the file itself holds the message.
    #[test]
    fn every_message_is_in_the_file_when_its_call_returns() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("log.mcap");
        let size = || std::fs::metadata(&path).unwrap().len();
        let mut log = LogWriter::create(&path, &sample_header()).unwrap();
        let start = size();
        log.observation(&Observation::default()).unwrap();
        assert_eq!(size() - start, 31 + 4 + 184);
        log.command(&Command::default()).unwrap();
        log.learning(&Learning::default()).unwrap();
        assert_eq!((size() - start) as f64, crate::log::bytes_per_tick(1));
        log.append(&LogRecord::Gap(Gap::default())).unwrap();
        assert_eq!((size() - start) as f64, crate::log::bytes_per_tick(1));
        log.flush().unwrap();
        assert_eq!(size() - start, 521 + 31 + 4 + 32);
        assert_eq!(log.written(), [1; 4]);
    }
}
