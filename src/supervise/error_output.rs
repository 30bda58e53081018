//! What a process writes to its standard error. The launcher reads it between its other work, without a thread and
//! without ever waiting: a program that the process has started may hold the pipe open for ever.

use std::io::{IsTerminal as _, Read as _, Write as _};
use std::os::fd::{AsFd as _, BorrowedFd};
use std::process::ChildStderr;
use std::sync::Arc;

use rustix::fs::{OFlags, fcntl_getfl, fcntl_setfl};

use crate::channel::WatchFiles;
use crate::clock::monotonic_ns;
use crate::wire::Role;

/// Bytes that are kept: the beginning.
const KEPT: usize = 64 << 10;
/// How long a line is held back, ns. The line that is followed by the end is the reason for the end, which the
/// launcher states itself.
const HELD_NS: u64 = 200_000_000;

/// The standard error of a process that runs.
#[derive(Debug)]
pub(super) struct ErrorOutput {
    /// `None` when it has been closed.
    pipe: Option<ChildStderr>,
    text: Vec<u8>,
    /// Whether its lines appear on the launcher's own standard error while the process lives.
    shown: bool,
    /// The line in progress.
    line: Vec<u8>,
    /// The last whole line, if it is not shown yet, and when it came.
    held: Option<(String, u64)>,
    /// The process, and where watchers find its lines.
    role: Role,
    watch_files: Arc<WatchFiles>,
}

/// What a process has written to its standard error.
#[derive(Debug, Default)]
pub(super) struct CollectedOutput {
    /// The beginning of it.
    pub text: String,
    /// The last line, if it came too shortly before the end to be shown.
    pub held: Option<String>,
}

impl ErrorOutput {
    /// Reads from `pipe` of the process in `role`, and shows its lines if `shown`. A pipe that cannot be read without
    /// waiting is not read at all.
    pub fn of(pipe: Option<ChildStderr>, role: Role, shown: bool, watch_files: Arc<WatchFiles>) -> Self {
        let pipe = pipe.filter(|pipe| {
            let flags = fcntl_getfl(pipe).map(|flags| flags | OFlags::NONBLOCK);
            flags.and_then(|flags| fcntl_setfl(pipe, flags)).is_ok()
        });
        Self { pipe, text: Vec::new(), shown, line: Vec::new(), held: None, role, watch_files }
    }

    /// The pipe, to wait until it can be read.
    pub fn pipe(&self) -> Option<BorrowedFd<'_>> {
        self.pipe.as_ref().map(|pipe| pipe.as_fd())
    }

    /// Whether a line is held back, and has to be shown when the process writes no other.
    pub fn holds_line(&self) -> bool {
        self.held.is_some()
    }

    /// Reads what has come, so that the process never blocks on a full pipe.
    pub fn read(&mut self) {
        let mut bytes = [0; 4096];
        // A process that writes faster than this reads cannot hold up the launcher.
        for _ in 0..64 {
            let Some(pipe) = &mut self.pipe else { break };
            match pipe.read(&mut bytes) {
                Ok(0) => self.pipe = None,
                Ok(n) => self.take_bytes(&bytes[..n]),
                Err(error) if error.kind() == std::io::ErrorKind::Interrupted => {}
                Err(error) if error.kind() == std::io::ErrorKind::WouldBlock => break,
                Err(_) => self.pipe = None,
            }
        }
        if self.held.as_ref().is_some_and(|(_, came)| monotonic_ns() - came > HELD_NS) {
            show(self.held.take().map(|(line, _)| line), self.shown);
        }
    }

    fn take_bytes(&mut self, bytes: &[u8]) {
        self.text.extend(&bytes[..bytes.len().min(KEPT - self.text.len())]);
        for &byte in bytes {
            if byte == b'\n' {
                self.end_line();
            } else if self.line.len() < KEPT {
                self.line.push(byte);
            }
        }
    }

    /// Holds the line in progress, and shows the one before.
    fn end_line(&mut self) {
        let line = String::from_utf8_lossy(&std::mem::take(&mut self.line)).into_owned();
        self.watch_files.say(&format!("{}: {line}", self.role.name()));
        let before = self.held.replace((line, monotonic_ns()));
        show(before.map(|(line, _)| line), self.shown);
    }

    /// Everything that the process, which has ended, wrote. What a program that it has started writes later is still
    /// read and shown.
    pub fn take(&mut self) -> CollectedOutput {
        self.read();
        if !self.line.is_empty() {
            self.end_line();
        }
        let text = String::from_utf8_lossy(&std::mem::take(&mut self.text)).into_owned();
        CollectedOutput { text, held: self.held.take().map(|(line, _)| line) }
    }
}

impl Drop for ErrorOutput {
    fn drop(&mut self) {
        self.read();
        if !self.line.is_empty() {
            self.end_line();
        }
        show(self.held.take().map(|(line, _)| line), self.shown);
    }
}

/// Shows a line of a process on standard error, above a progress line that may be there.
pub(super) fn show(line: Option<String>, shown: bool) {
    let Some(line) = line.filter(|_| shown) else { return };
    let mut to = std::io::stderr();
    let above = if to.is_terminal() { "\r\x1b[K" } else { "" };
    let _ = to.write_all(format!("{above}{line}\n").as_bytes());
}
