//! The port: opened for exclusive use, with a name that stays, and instructions and answers that end by a deadline.

use std::fs::File;
use std::io::{self, ErrorKind};
use std::path::{Path, PathBuf};
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

/// Says what to do about the latency timer of the USB adapter behind the port at `path`, if it has one that holds
/// answers back.
pub fn latency_advice(path: &str) -> Option<String> {
    let (milliseconds, file) = latency_timer(Path::new("/sys/bus/usb-serial/devices"), path)?;
    (milliseconds > 2).then(|| {
        format!(
            "the latency timer of {path} is {milliseconds} ms: its adapter holds every answer back for so long, so \
             that an answer may come too late; set it to 1: echo 1 | sudo tee {}",
            file.display()
        )
    })
}

/// The latency timer of the adapter behind the port at `path`, ms; `None` if it has none.
pub fn latency_ms(path: &str) -> Option<u32> {
    latency_timer(Path::new("/sys/bus/usb-serial/devices"), path).map(|(milliseconds, _)| milliseconds)
}

fn latency_timer(devices: &Path, path: &str) -> Option<(u32, PathBuf)> {
    let real = std::fs::canonicalize(path).ok()?;
    let file = devices.join(real.file_name()?).join("latency_timer");
    let milliseconds = std::fs::read_to_string(&file).ok()?.trim().parse().ok()?;
    Some((milliseconds, file))
}

/// Checks that the port exists, may be opened, and is not locked: serialport does not distinguish these errors.
/// The lock is released at once, because serialport takes its own. To close the file is not enough: a process that
/// another thread starts at this moment has it, too, until it becomes another program.
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
    let lock = |operation| flock(&file, operation).map_err(|_| BusError::Busy(path.to_owned()));
    lock(FlockOperation::NonBlockingLockExclusive)?;
    lock(FlockOperation::Unlock)
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
    /// The current instruction, until it is known whether it came back.
    sent: Vec<u8>,
    /// Whether the adapter sends back what it is sent, once that is known.
    echo: Option<bool>,
}

impl Line {
    pub fn new(port: Box<dyn SerialPort>, protocol: Protocol, clock: BusClock) -> Self {
        Self {
            port: Some(port),
            clock,
            protocol,
            deadline: u64::MAX,
            received: Vec::new(),
            sent: Vec::new(),
            echo: None,
        }
    }

    /// Sends an instruction. What has arrived before belongs to nothing any more and is dropped.
    pub fn send(&mut self, packet: &[u8]) -> Result<(), AnswerFault> {
        self.received.clear();
        self.sent = packet.to_vec();
        if self.is_anything_waiting()? {
            let deadline = self.deadline;
            self.drain(deadline);
            self.deadline = deadline;
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
            let echo_is_over = self.take_echo();
            if echo_is_over && let Some((taken, reply)) = packet::answer(self.protocol, id, length, &self.received)? {
                self.received.drain(..taken);
                self.echo.get_or_insert(false);
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

    /// Drops the instruction from the received bytes if an adapter has sent it back. Returns whether what follows are
    /// answers. An answer that has the very bytes of its instruction is taken for an echo only while nothing is known
    /// of the adapter: before the first answer.
    fn take_echo(&mut self) -> bool {
        if self.sent.is_empty() || self.echo == Some(false) {
            return true;
        }
        if self.received.len() < self.sent.len() && self.sent.starts_with(&self.received) {
            return false;
        }
        if self.received.starts_with(&self.sent) {
            self.received.drain(..self.sent.len());
            self.echo = Some(true);
        }
        self.sent.clear();
        true
    }

    /// After an instruction that nobody answers: receives what the adapter sends back, if it does.
    pub fn skip_echo(&mut self) {
        let mut bytes = [0; 256];
        while self.echo == Some(true) && !self.take_echo() {
            match self.read(&mut bytes) {
                Ok(n) => self.received.extend_from_slice(&bytes[..n]),
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(_) => return,
            }
        }
    }

    /// Whether the adapter sends back what it is sent.
    pub fn echoes(&self) -> bool {
        self.echo == Some(true)
    }

    /// Reads and drops bytes that are still arriving, until the line is quiet or `limit` has come. An answer does not
    /// identify its instruction, so a late answer would be taken for that of the next one.
    pub fn drain(&mut self, limit: u64) {
        self.received.clear();
        let end = self.now().saturating_add(DRAIN_NS).min(limit);
        let mut late = [0; 64];
        while self.now() < end {
            self.deadline = self.now().saturating_add(QUIET_NS);
            match self.read(&mut late) {
                Err(error) if error.kind() != ErrorKind::Interrupted => return,
                _ => {}
            }
        }
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_latency_timer_is_that_of_the_device_behind_a_link() {
        let folder = std::env::temp_dir().join(format!("tectum-latency-{}", std::process::id()));
        let (devices, port, link) = (folder.join("devices"), folder.join("ttyUSB7"), folder.join("arm"));
        std::fs::create_dir_all(devices.join("ttyUSB7")).unwrap();
        std::fs::write(&port, "").unwrap();
        std::fs::write(devices.join("ttyUSB7/latency_timer"), "16\n").unwrap();
        std::os::unix::fs::symlink(&port, &link).unwrap();
        let found = [&port, &link].map(|path| latency_timer(&devices, path.to_str().unwrap()).map(|(ms, _)| ms));
        let none = latency_timer(&devices, devices.to_str().unwrap());
        std::fs::remove_dir_all(&folder).unwrap();
        assert_eq!((found, none), ([Some(16), Some(16)], None));
    }
}
