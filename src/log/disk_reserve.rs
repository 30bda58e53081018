//! Room on the disk ahead of what is written, so that a log can be closed when there is no more.
//!
//! The file is given blocks beyond its end (`fallocate`, which leaves its size as it is), always enough for the statements, the
//! histograms and the summary that close a log. So a disk without room shows before a message is cut off by it, and nobody
//! else can take what the end needs. A limit on the size of files (`ulimit -f`) is looked at in the same way.

use std::fs::File;
use std::io::{self, ErrorKind};

use rustix::fs::{FallocateFlags, fallocate};
use rustix::process::{Resource, getrlimit};

/// What is kept for the end of a log, bytes: statements of gaps, histograms (tens of kilobytes as a rule), schemas once more.
pub(super) const RESERVE: u64 = 512 * 1024;
/// How much more is asked for at a time, bytes.
const STEP: u64 = 1024 * 1024;

/// A file's room.
pub(super) struct DiskReserve {
    file: File,
    /// The byte up to which the file has its blocks.
    until: u64,
}

impl DiskReserve {
    pub fn of(file: File) -> Self {
        Self { file, until: 0 }
    }

    /// Makes sure that behind byte `at` there is room for the end of the log.
    ///
    /// # Errors
    /// When there is not: the disk, the quota or the limit on the size of files is used up. The room asked for before is
    /// still there. A file system that gives no room ahead is no error: there, writing tells.
    #[inline]
    pub fn secure(&mut self, at: u64) -> io::Result<()> {
        if at + RESERVE <= self.until { Ok(()) } else { self.extend(at) }
    }

    #[cold]
    fn extend(&mut self, at: u64) -> io::Result<()> {
        let limit = getrlimit(Resource::Fsize).current.unwrap_or(u64::MAX);
        if at + RESERVE > limit {
            return Err(ErrorKind::FileTooLarge.into());
        }
        let until = at + RESERVE + STEP;
        let done = loop {
            match fallocate(&self.file, FallocateFlags::KEEP_SIZE, self.until, until - self.until) {
                Err(rustix::io::Errno::INTR) => {}
                done => break done.map_err(io::Error::from),
            }
        };
        match done {
            Ok(()) => self.until = until.min(limit),
            Err(e) => match e.kind() {
                ErrorKind::StorageFull | ErrorKind::QuotaExceeded | ErrorKind::FileTooLarge => return Err(e),
                // Nothing of the kind here: as far as the limit goes, there may be room, and it is not asked for again.
                _ => self.until = limit,
            },
        }
        Ok(())
    }

    /// Bytes in the file.
    pub fn length(&self) -> io::Result<u64> {
        Ok(self.file.metadata()?.len())
    }

    /// Gives back what lies behind the end of the file, at byte `end`.
    pub fn give_back(&self, end: u64) -> io::Result<()> {
        if self.until > end && self.until < u64::MAX { self.file.set_len(end) } else { Ok(()) }
    }
}
