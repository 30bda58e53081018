//! The file that a log's writer writes to.

use std::fs::File;
use std::io::{self, ErrorKind, Seek, SeekFrom, Write};
use std::sync::Arc;
use std::sync::atomic::{AtomicI32, Ordering};

/// A file that remembers the operating system's last error. `mcap` wraps errors so that their code is lost, but
/// the caller must know whether the disk is full.
pub(super) struct LogFile {
    pub file: File,
    pub errno: Arc<AtomicI32>,
}

impl LogFile {
    fn remember_error<T>(&self, result: io::Result<T>) -> io::Result<T> {
        if let Err(e) = &result
            && e.kind() != ErrorKind::Interrupted
        {
            self.errno.store(e.raw_os_error().unwrap_or(0), Ordering::Relaxed);
        }
        result
    }
}

impl Write for LogFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let result = self.file.write(bytes);
        self.remember_error(result)
    }

    fn flush(&mut self) -> io::Result<()> {
        let result = self.file.flush();
        self.remember_error(result)
    }
}

impl Seek for LogFile {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        let result = self.file.seek(to);
        self.remember_error(result)
    }
}

/// The operating system's error if there was one, or else that of `mcap`.
pub(super) fn io_error(error: mcap::McapError, errno: &AtomicI32) -> io::Error {
    match (errno.load(Ordering::Relaxed), error) {
        (0, mcap::McapError::Io(e)) => e,
        (0, e) => io::Error::other(e),
        (code, _) => io::Error::from_raw_os_error(code),
    }
}
