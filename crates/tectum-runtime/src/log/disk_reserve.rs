//! Reserves disk space ahead of what is written, so that a log can be closed when the disk is full.
//!
//! The file gets blocks beyond its end (`fallocate`, which keeps its size), always enough for the gap messages,
//! the histograms and the summary that close a log. So a full disk is noticed before it cuts off a message, and
//! no other program can take the space that the end needs. A limit on the size of files (`ulimit -f`) is
//! checked in the same way.

use std::fs::File;
use std::io::{self, ErrorKind};
use std::os::unix::fs::MetadataExt as _;
use std::path::Path;

use rustix::fs::{FallocateFlags, fallocate};
use rustix::process::{Resource, getrlimit};

/// Space that is kept for the end of a log, bytes: gap messages, histograms (usually tens of kilobytes), and
/// schemas once more.
pub(super) const RESERVE: u64 = 512 * 1024;
/// Additional space per request, bytes.
const STEP: u64 = 1024 * 1024;

/// The space reserved for a file.
pub(super) struct DiskReserve {
    file: File,
    /// The byte up to which the file has blocks.
    reserved_end: u64,
}

impl DiskReserve {
    pub fn of(file: File) -> Self {
        Self { file, reserved_end: 0 }
    }

    /// Ensures that [`RESERVE`] bytes after byte `at` are reserved.
    ///
    /// # Errors
    /// When the disk, the quota or the limit on the size of files is used up. Space reserved earlier stays
    /// reserved. A file system that cannot reserve space is no error: there, a full disk shows when writing.
    #[inline]
    pub fn ensure(&mut self, at: u64) -> io::Result<()> {
        if at + RESERVE <= self.reserved_end { Ok(()) } else { self.extend(at) }
    }

    #[cold]
    fn extend(&mut self, at: u64) -> io::Result<()> {
        let limit = getrlimit(Resource::Fsize).current.unwrap_or(u64::MAX);
        if at + RESERVE > limit {
            return Err(ErrorKind::FileTooLarge.into());
        }
        let new_end = at + RESERVE + STEP;
        let result = loop {
            match fallocate(&self.file, FallocateFlags::KEEP_SIZE, self.reserved_end, new_end - self.reserved_end) {
                Err(rustix::io::Errno::INTR) => {}
                result => break result.map_err(io::Error::from),
            }
        };
        match result {
            Ok(()) => self.reserved_end = new_end.min(limit),
            Err(e) => match e.kind() {
                ErrorKind::StorageFull | ErrorKind::QuotaExceeded | ErrorKind::FileTooLarge => return Err(e),
                // This file system cannot reserve space: assume that there is space up to the limit, and do not
                // ask again.
                _ => self.reserved_end = limit,
            },
        }
        Ok(())
    }

    /// Size of the file, bytes.
    pub fn length(&self) -> io::Result<u64> {
        Ok(self.file.metadata()?.len())
    }

    /// Syncs the file's content to the disk.
    pub fn sync(&self) -> io::Result<()> {
        self.file.sync_data()
    }

    /// Whether `path` leads to this file.
    pub fn is_file_at(&self, path: &Path) -> bool {
        match (std::fs::metadata(path), self.file.metadata()) {
            (Ok(at_path), Ok(ours)) => (at_path.dev(), at_path.ino()) == (ours.dev(), ours.ino()),
            (Err(error), _) => error.kind() != ErrorKind::NotFound,
            _ => true,
        }
    }

    /// Frees the space reserved beyond the end of the file, at byte `end`.
    pub fn release(&self, end: u64) -> io::Result<()> {
        if self.reserved_end > end && self.reserved_end < u64::MAX { self.file.set_len(end) } else { Ok(()) }
    }
}
