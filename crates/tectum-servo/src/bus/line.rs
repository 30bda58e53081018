//! The port: opened for exclusive use, with a name that stays, and instructions and answers that end by a deadline.

use std::fs::File;
use std::io::{self, ErrorKind};
use std::path::Path;
use std::time::Duration;

use rustix::fs::{FlockOperation, OFlags, flock};
use serialport::SerialPort;

use super::{BusClock, BusError};
use crate::model::Protocol;
use crate::packet::{self, AnswerFault, ServoReply};

/// Opens the port at `path` for exclusive use.
pub(super) fn open_port(path: &str, baud: u32, timeout: Duration) -> Result<Box<dyn SerialPort>, BusError> {
    probe(path)?;
    // serialport locks the port itself (flock and TIOCEXCL), and releases it with the descriptor.
    serialport::new(path, baud).timeout(timeout).open().map_err(|error| match error.kind() {
        serialport::ErrorKind::NoDevice if error.description.contains("lock") => BusError::Busy(path.to_owned()),
        serialport::ErrorKind::NoDevice if error.description.contains("busy") => BusError::Busy(path.to_owned()),
        serialport::ErrorKind::Io(ErrorKind::ResourceBusy) => BusError::Busy(path.to_owned()),
        _ => BusError::Port(path.to_owned(), error.to_string()),
    })
}

/// The name under which the port at `path` comes back after its cable was out: `path` itself if it is a link,
/// which udev or the user keeps up to date, otherwise its link under `/dev/serial/by-id`, if it has one. The
/// system numbers `/dev/ttyUSB0` anew.
pub fn stable_name(path: &str) -> String {
    if std::fs::symlink_metadata(path).is_ok_and(|file| file.is_symlink()) {
        return path.to_owned();
    }
    let real = std::fs::canonicalize(path).ok();
    let links = std::fs::read_dir("/dev/serial/by-id").into_iter().flatten().flatten().map(|entry| entry.path());
    let mut same = links.filter(|link| real.is_some() && std::fs::canonicalize(link).ok() == real);
    same.next().map_or_else(|| path.to_owned(), |link| link.display().to_string())
}

/// Checks that the port exists, may be opened, and is not locked: serialport does not distinguish these errors.
/// The lock is released at once, because serialport takes its own.
fn probe(path: &str) -> Result<(), BusError> {
    use std::os::unix::fs::OpenOptionsExt as _;
    let flags = OFlags::NOCTTY | OFlags::NONBLOCK;
    let file = File::options().read(true).write(true).custom_flags(flags.bits() as i32).open(Path::new(path));
    let file = file.map_err(|error| match error.kind() {
        ErrorKind::NotFound => BusError::NoPort(path.to_owned()),
        ErrorKind::PermissionDenied => BusError::Denied(path.to_owned()),
        ErrorKind::ResourceBusy => BusError::Busy(path.to_owned()),
        _ => BusError::Port(path.to_owned(), error.to_string()),
    })?;
    flock(&file, FlockOperation::NonBlockingLockExclusive).map_err(|_| BusError::Busy(path.to_owned()))
}

/// Silence after which the line counts as quiet, ns.
const QUIET_NS: u64 = 1_000_000;
/// Longest time for draining, ns.
const DRAIN_NS: u64 = 3_000_000;

/// A port whose reads and writes end by a deadline. A port that the operating system has given up is closed, so
/// that its name is free when the cable comes back.
pub(super) struct Line {
    /// The port; `None` when it is gone.
    pub port: Option<Box<dyn SerialPort>>,
    pub clock: BusClock,
    protocol: Protocol,
    /// Deadline of the current instruction, ns.
    pub deadline: u64,
    /// Received bytes of the current instruction that belong to no answer yet.
    received: Vec<u8>,
}

impl Line {
    pub fn new(port: Box<dyn SerialPort>, protocol: Protocol, clock: BusClock) -> Self {
        Self { port: Some(port), clock, protocol, deadline: u64::MAX, received: Vec::new() }
    }

    /// Sends an instruction. What has arrived before belongs to nothing any more and is dropped.
    pub fn send(&mut self, packet: &[u8]) -> Result<(), AnswerFault> {
        self.received.clear();
        if self.is_anything_waiting()? {
            let deadline = self.deadline;
            let quiet = self.drain(deadline);
            self.deadline = deadline;
            if !quiet {
                return Err(AnswerFault::Babble);
            }
        }
        let mut sent = 0;
        while sent < packet.len() {
            match self.limited(|port| port.write(&packet[sent..])) {
                Ok(0) => return Err(AnswerFault::NotSent),
                Ok(n) => sent += n,
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(error) if is_passing(&error) => return Err(AnswerFault::NotSent),
                Err(_) => return Err(AnswerFault::Gone),
            }
        }
        Ok(())
    }

    /// Receives the answer of servo `id` with `length` bytes.
    pub fn receive(&mut self, id: u8, length: usize) -> Result<ServoReply, AnswerFault> {
        loop {
            if let Some((taken, reply)) = packet::answer(self.protocol, id, length, &self.received)? {
                self.received.drain(..taken);
                return Ok(reply);
            }
            let mut bytes = [0; 256];
            match self.read(&mut bytes) {
                Ok(n) => self.received.extend_from_slice(&bytes[..n]),
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(error) if !is_passing(&error) => return Err(AnswerFault::Gone),
                Err(_) if self.received.is_empty() => return Err(AnswerFault::Silent),
                Err(_) => return Err(AnswerFault::Incomplete),
            }
        }
    }

    /// Reads and drops bytes that are still arriving, until `limit` at most. An answer does not identify its
    /// instruction, so a late answer would be taken for that of the next one. Returns whether the line has become quiet.
    pub fn drain(&mut self, limit: u64) -> bool {
        self.received.clear();
        let end = self.now().saturating_add(DRAIN_NS).min(limit);
        let mut late = [0; 64];
        while self.now() < end {
            self.deadline = self.now().saturating_add(QUIET_NS);
            match self.read(&mut late) {
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(_) => return true,
                Ok(_) => {}
            }
        }
        false
    }

    pub fn now(&self) -> u64 {
        (self.clock)()
    }

    /// Whether received bytes wait to be read. An operating system that cannot say so has lost the device.
    fn is_anything_waiting(&mut self) -> Result<bool, AnswerFault> {
        let waiting = self.port.as_ref().ok_or(AnswerFault::Gone)?.bytes_to_read();
        waiting.map(|waiting| waiting > 0).map_err(|_| {
            self.port = None;
            AnswerFault::Gone
        })
    }

    fn read(&mut self, to: &mut [u8]) -> io::Result<usize> {
        self.limited(|port| match port.read(to)? {
            // The end of a serial line that cannot end: the device is no longer there.
            0 => Err(gone()),
            n => Ok(n),
        })
    }

    /// Does `work` with the port within the time until the deadline. Closes the port when it has failed.
    fn limited<T>(&mut self, work: impl FnOnce(&mut dyn SerialPort) -> io::Result<T>) -> io::Result<T> {
        let left = self.deadline.saturating_sub(self.now());
        let port = self.port.as_mut().ok_or_else(gone)?;
        if left == 0 {
            return Err(ErrorKind::TimedOut.into());
        }
        // Ports round down to milliseconds, and 0 would mean no time-out.
        let left = left.clamp(1_000_000, 1_000_000_000);
        let result =
            port.set_timeout(Duration::from_nanos(left)).map_err(io::Error::from).and_then(|()| work(port.as_mut()));
        if result.as_ref().is_err_and(|error| !is_passing(error)) {
            self.port = None;
        }
        result
    }
}

/// Whether an error of the port says only that it was not ready in time.
fn is_passing(error: &io::Error) -> bool {
    matches!(error.kind(), ErrorKind::TimedOut | ErrorKind::Interrupted | ErrorKind::WouldBlock)
}

/// The error of a port that is gone.
fn gone() -> io::Error {
    io::Error::new(ErrorKind::BrokenPipe, "the port is gone")
}
