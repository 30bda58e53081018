//! When the log of a run goes on in another segment, and which segments are removed (`[log] rotate`, `limit_mb`).
//!
//! The rules are pure: sizes and ticks are handed in. A segment that is removed is the oldest one; the current one
//! always stays. How many were removed is stated in the logger's report, and the first segment that is left states what
//! came before it.

use std::collections::VecDeque;
use std::path::{Path, PathBuf};

use crate::log::{LogHeader, LogRotation, LogSegment, segments};
use crate::scenario::Plan;

/// The segments of a log, and when the next one begins.
#[derive(Debug)]
pub(super) struct LogRotator {
    folder: PathBuf,
    /// Bytes of a segment; `None` for any size.
    bytes: Option<u64>,
    /// Ticks of a segment; `None` for any number.
    ticks: Option<u64>,
    /// Bytes of all segments beyond which the oldest is removed.
    limit: Option<u64>,
    /// Description of the current segment.
    header: LogHeader,
    /// The segments before the current one, each with its size, the oldest first.
    closed: VecDeque<(PathBuf, u64)>,
    /// The first tick of the current segment.
    first_tick: u64,
    /// Segments removed.
    pub removed: u64,
}

impl LogRotator {
    /// For the log in `folder` of a run of `plan`; `header` is that of the current segment, which begins with
    /// `first_tick`. `None` where the log stays in one file.
    pub fn of(plan: &Plan, folder: &Path, header: &LogHeader, first_tick: u64) -> Option<Self> {
        let config = &plan.scenario.log;
        let (bytes, ticks) = match config.rotate? {
            LogRotation::Bytes(bytes) => (Some(bytes), None),
            LogRotation::Seconds(seconds) => {
                (None, Some((seconds * 1e9 / plan.period_ns as f64).ceil().max(1.0) as u64))
            }
        };
        let before: Vec<PathBuf> = segments(folder).into_iter().collect();
        // Segments are numbered from 0, so that the number of the oldest says how many came before it.
        let removed = before.first().and_then(|path| crate::log::segment_number_of(path)).unwrap_or(0);
        let size = |path: PathBuf| (std::fs::metadata(&path).map_or(0, |file| file.len()), path);
        let closed = before.into_iter().map(size).map(|(bytes, path)| (path, bytes)).collect();
        Some(Self {
            folder: folder.to_owned(),
            bytes,
            ticks,
            limit: config.limit_mb.map(|limit| (1e6 * limit) as u64),
            header: header.clone(),
            closed,
            first_tick,
            removed: u64::from(removed),
        })
    }

    /// Whether the current segment, of so many bytes and up to the tick `tick`, is to end.
    pub fn is_due(&self, bytes: u64, tick: u64) -> bool {
        let ticks = tick.saturating_sub(self.first_tick);
        self.bytes.is_some_and(|most| bytes >= most) || self.ticks.is_some_and(|most| ticks >= most)
    }

    /// The current segment at `path` is closed with so many bytes. Gives file and description of the next one, which
    /// begins with `tick` and with what `segment` says of those before it.
    pub fn next(&mut self, path: &Path, bytes: u64, tick: u64, segment: LogSegment) -> (PathBuf, &LogHeader) {
        self.closed.push_back((path.to_owned(), bytes));
        self.first_tick = tick;
        let number = self.header.segment.number.saturating_add(1);
        self.header.segment = LogSegment { number, ..segment };
        (crate::log::segment_path(&self.folder, number), &self.header)
    }

    /// Removes the oldest segments while all of them, with a current one of `bytes` bytes, are larger than the limit.
    pub fn remove_oldest(&mut self, bytes: u64) {
        let Some(limit) = self.limit else { return };
        while self.closed_bytes() + bytes > limit {
            let Some((path, _)) = self.closed.pop_front() else { return };
            // One that cannot be removed is no longer counted: it must not stop the others from being removed.
            if std::fs::remove_file(path).is_ok() {
                self.removed += 1;
            }
        }
    }

    /// Bytes of the segments before the current one.
    pub fn closed_bytes(&self) -> u64 {
        self.closed.iter().map(|(_, bytes)| bytes).sum()
    }
}
