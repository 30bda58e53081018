//! The segments of a run's log: finding their files, and reading all of them as one log.

use std::collections::{BTreeMap, VecDeque};
use std::path::{Path, PathBuf};

use super::{LOG_FILE, LogError, LogReader, LogRecord, LogSegment, LogTotals, MessageCounts, RUN_METADATA};

/// Finds a log: `given` itself, the one in the folder `given`, or that of the run called `given` under `runs/`.
/// Returns its segments in order; only one if `given` is a file.
///
/// # Errors
///
/// [`LogError::NoLog`] if there is none.
pub fn find(given: &Path) -> Result<Vec<PathBuf>, LogError> {
    let path = crate::run_folder::find(given, Path::exists);
    let log = if path.is_dir() { segments(&path) } else { vec![path.clone()] };
    if log.first().is_some_and(|log| log.exists()) {
        return Ok(log);
    }
    let why = if path.is_dir() { "is a folder without a log.mcap" } else { "does not exist" };
    Err(LogError::NoLog { path, why: why.to_owned() })
}

/// The file of the segment `number` in a run's folder: `log.mcap`, `log-1.mcap` and so on. A logger begins with that of
/// its incarnation, or with the next that is free.
pub fn segment_path(folder: &Path, number: u32) -> PathBuf {
    folder.join(match number {
        0 => LOG_FILE.to_owned(),
        n => format!("log-{n}.mcap"),
    })
}

/// The segments in `folder`, in order.
pub fn segments(folder: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let mut found: Vec<u32> = entries.filter_map(|entry| segment_number(entry.file_name().to_str()?)).collect();
    found.sort_unstable();
    found.into_iter().map(|n| segment_path(folder, n)).collect()
}

/// The number of the segment at `path`.
pub(crate) fn segment_number_of(path: &Path) -> Option<u32> {
    segment_number(path.file_name()?.to_str()?)
}

/// The number in a segment's file name.
fn segment_number(name: &str) -> Option<u32> {
    if name == LOG_FILE {
        return Some(0);
    }
    let digits = name.strip_prefix("log-")?.strip_suffix(".mcap")?;
    digits.parse().ok().filter(|n: &u32| *n > 0 && n.to_string() == digits)
}

/// A run's log: an iterator over the messages of all its segments. Its description is that of the first segment.
///
/// A torn segment in the middle ends with its last whole record; the next segment begins with statements of the
/// samples that did not reach it. A segment whose logger was killed before it described the run is skipped if
/// there are others.
pub struct RunLog {
    path: PathBuf,
    run: BTreeMap<String, String>,
    scenario: String,
    /// The segment that is being read.
    log: LogReader,
    waiting: VecDeque<PathBuf>,
    ended: Vec<SegmentEnd>,
}

/// How far a segment was read, and how it ends.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SegmentEnd {
    /// The file.
    pub path: PathBuf,
    /// The incarnation of the logger that wrote it.
    pub number: u32,
    /// It was read to the end that its logger wrote.
    pub finished: bool,
    /// It was torn and then repaired.
    pub repaired: bool,
    /// Bytes up to the end of the last whole record.
    pub position: u64,
}

impl SegmentEnd {
    fn of(log: &LogReader) -> Self {
        Self {
            path: log.path().to_owned(),
            number: log.log_segment().number,
            finished: log.finished(),
            repaired: log.repaired(),
            position: log.position(),
        }
    }
}

impl RunLog {
    /// Opens the segments, which must be in order.
    ///
    /// # Errors
    ///
    /// As [`LogReader::open`], for the first segment that is a log.
    pub fn open(segments: &[PathBuf]) -> Result<RunLog, LogError> {
        let mut waiting: VecDeque<PathBuf> = segments.iter().cloned().collect();
        let single = segments.len() == 1;
        let mut refused = None;
        while let Some(path) = waiting.pop_front() {
            match LogReader::open(&path) {
                Ok(log) => {
                    let folder = path.parent().filter(|_| !single).unwrap_or(&path);
                    return Ok(RunLog { path: folder.to_owned(), waiting, ..RunLog::of(log) });
                }
                Err(error @ LogError::NotALog { .. }) => drop(refused.get_or_insert(error)),
                Err(error) => return Err(error),
            }
        }
        let none = || LogError::NoLog { path: PathBuf::new(), why: "is no log".to_owned() };
        Err(refused.unwrap_or_else(none))
    }

    /// A log of one segment, at its beginning.
    pub fn of(log: LogReader) -> RunLog {
        let run = log.metadata().get(RUN_METADATA).cloned().unwrap_or_default();
        let (path, scenario) = (log.path().to_owned(), log.scenario().to_owned());
        RunLog { path, run, scenario, log, waiting: VecDeque::new(), ended: Vec::new() }
    }

    /// The log, as messages name it: the file, or the folder with the segments.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// A value of the run's description, for example `seed` or `clock`.
    pub fn run(&self, key: &str) -> Option<&str> {
        self.run.get(key).map(String::as_str)
    }

    /// All of the run's description.
    pub fn description(&self) -> &BTreeMap<String, String> {
        &self.run
    }

    /// The resolved scenario, TOML.
    pub fn scenario(&self) -> &str {
        &self.scenario
    }

    /// Every `every()`-th tick is written.
    pub fn every(&self) -> u64 {
        self.run("every").and_then(|every| every.parse().ok()).unwrap_or(1).max(1)
    }

    /// The description of the first segment: the default, unless it is a later segment read by itself.
    pub fn log_segment(&self) -> LogSegment {
        LogSegment::from_map(&self.run)
    }

    /// Message counts to which the log's messages can be added.
    pub fn message_counts(&self) -> MessageCounts {
        MessageCounts::after(&self.log_segment())
    }

    /// The segment that is being read.
    pub fn current_segment(&self) -> &LogReader {
        &self.log
    }

    /// How many segments have been begun; the last message read belongs to the last of them.
    pub fn segments_begun(&self) -> usize {
        self.ended.len() + 1
    }

    /// The segments that have been begun, each with its end; that of the last is known when the log has been
    /// read to its end.
    pub fn segments(&self) -> Vec<SegmentEnd> {
        self.ended.iter().cloned().chain([SegmentEnd::of(&self.log)]).collect()
    }

    /// The totals of the last segment; `None` before the last message has been read, and if the segment is torn.
    pub fn totals(&self) -> Option<LogTotals> {
        self.log.totals()
    }

    /// The tick from which on samples are missing because the disk was full; known after the last message.
    pub fn missing_from(&self) -> Option<u64> {
        self.log.missing_from()
    }

    /// Whether the last segment was torn and then repaired; known after the last message.
    pub fn repaired(&self) -> bool {
        self.log.repaired()
    }

    /// Whether the log was read to the end that its last logger wrote. False until the iterator has ended.
    pub fn finished(&self) -> bool {
        self.waiting.is_empty() && self.log.finished()
    }

    /// Opens the next segment. `None` if there is none.
    fn open_next_segment(&mut self) -> Option<Result<(), LogError>> {
        loop {
            match LogReader::open(&self.waiting.pop_front()?) {
                Ok(log) if log.run("run") == self.run("run") => {
                    self.ended.push(SegmentEnd::of(&self.log));
                    self.log = log;
                    return Some(Ok(()));
                }
                Ok(log) => {
                    return Some(Err(LogError::not_a_log(log.path(), "it belongs to another run than log.mcap")));
                }
                Err(LogError::NotALog { .. }) => {}
                Err(error) => return Some(Err(error)),
            }
        }
    }
}

impl Iterator for RunLog {
    type Item = Result<LogRecord, LogError>;

    fn next(&mut self) -> Option<Self::Item> {
        loop {
            match self.log.next() {
                Some(Err(error)) => {
                    self.waiting.clear();
                    return Some(Err(error));
                }
                Some(record) => return Some(record),
                None => match self.open_next_segment()? {
                    Ok(()) => {}
                    Err(error) => {
                        self.waiting.clear();
                        return Some(Err(error));
                    }
                },
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn segments_are_in_the_order_of_their_numbers() {
        let folder = tempfile::tempdir().unwrap();
        let names =
            ["log-10.mcap", "log.mcap", "log-2.mcap", "log-02.mcap", "log-0.mcap", "log-x.mcap", "log.mcap.torn"];
        names.iter().for_each(|name| std::fs::write(folder.path().join(name), "").unwrap());
        let found: Vec<_> =
            find(folder.path()).unwrap().iter().map(|p| p.strip_prefix(folder.path()).unwrap().to_owned()).collect();
        assert_eq!(found, ["log.mcap", "log-2.mcap", "log-10.mcap"].map(PathBuf::from));
        assert_eq!(find(&folder.path().join("log-2.mcap")).unwrap().len(), 1);
        let none = find(&folder.path().join("log-3.mcap")).unwrap_err().to_string();
        assert!(none.contains("log-3.mcap does not exist"), "{none}");
    }
}
