//! The logger's account: what the log held at a certain byte, in a small file of the run's folder, so that a logger
//! that comes back need not read the whole log before it listens.
//!
//! An account stays true for as long as the file that it names is there: the logger only adds to a log. One that is
//! old, because the disk was full or the logger was killed before it could leave the next, costs a longer tail to read
//! and nothing else. Where there is none, or where the file is shorter than the account says, the log is read as a
//! whole.

use std::io;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::latency_histograms::HistogramsState;
use super::{LogReader, LogSegment, segment_path};

/// Messages after which the account is written again.
pub(crate) const ACCOUNT_EVERY: u64 = 4096;

/// A place in a segment, and what reading on from there needs to know of what stands before it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct LogPlace {
    /// Bytes from the file's start; a record begins there, or the file ends.
    pub position: u64,
    /// Statements of missing samples before it, in this segment.
    pub gaps: u64,
    /// Log time of the message before it, ns.
    pub last_ns: u64,
}

/// What all segments held up to a place in the last of them.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(crate) struct LogAccount {
    /// The run, as its log describes it.
    pub run: String,
    /// Number of the segment that was being written.
    pub current: u32,
    /// The place in it.
    pub place: LogPlace,
    /// What was written, lost and left out up to there, and with which samples the log goes on.
    pub held: LogSegment,
    /// The last tick written or left out on each channel.
    pub last_ticks: [Option<u64>; 3],
    /// In real time: the durations of the ticks so far.
    pub timings: Option<HistogramsState>,
}

impl LogAccount {
    /// The account in `folder`, and its segment's reader at the account's place. `None` where there is no account, or
    /// where it does not fit the segment.
    pub fn find(folder: &Path) -> Option<(LogAccount, LogReader)> {
        let account: LogAccount = serde_json::from_slice(&std::fs::read(account_path(folder)).ok()?).ok()?;
        let path = segment_path(folder, account.current);
        let long_enough = std::fs::metadata(&path).is_ok_and(|file| file.len() >= account.place.position);
        let tail = LogReader::open_at(&path, account.place).ok().filter(|_| long_enough)?;
        (tail.run("run") == Some(&account.run)).then_some((account, tail))
    }
}

/// When the account is written, and where.
#[derive(Debug)]
pub(crate) struct AccountKeeper {
    folder: PathBuf,
    run: String,
    every: u64,
    /// Segment and messages in it at the last account.
    last: Option<(u32, u64)>,
}

impl AccountKeeper {
    /// For the log of the run `run` in `folder`; an account every `every` messages.
    pub fn new(folder: &Path, run: String, every: u64) -> Self {
        Self { folder: folder.to_owned(), run, every, last: None }
    }

    /// Whether an account is due: so many messages after the last one, and at a segment's beginning.
    pub fn is_due(&self, current: u32, messages: u64) -> bool {
        self.last.is_none_or(|(segment, then)| segment != current || messages >= then + self.every)
    }

    /// Writes the account, in place of the one before, which stays where this fails: it is still true.
    pub fn keep(&mut self, mut account: LogAccount, messages: u64) {
        account.run.clone_from(&self.run);
        self.last = Some((account.current, messages));
        let path = account_path(&self.folder);
        let draft = draft_of(&path);
        let written = serde_json::to_vec(&account).map_err(io::Error::from);
        let written =
            written.and_then(|text| std::fs::write(&draft, text)).and_then(|()| std::fs::rename(&draft, path));
        if written.is_err() {
            let _ = std::fs::remove_file(draft);
        }
    }
}

/// Removes the account of a run that is over.
pub fn remove_account(folder: &Path) {
    let path = account_path(folder);
    let _ = std::fs::remove_file(draft_of(&path));
    let _ = std::fs::remove_file(path);
}

fn account_path(folder: &Path) -> PathBuf {
    folder.join("logger.account.json")
}

fn draft_of(path: &Path) -> PathBuf {
    path.with_extension("json.part")
}
