//! The host's end of the bus: a port in exclusive use, and instructions with deadlines.
//!
//! The codec is rustypot's. A `DeadlinePort` wraps the port and ends every instruction by its deadline,
//! whatever the bus does: silence, incomplete answers, noise, or single bytes. The bus time of a tick is
//! therefore at most the sum of the two budgets of [`BusBudget`].
//!
//! The clock is an argument: CLOCK_MONOTONIC on hardware, a stepped clock with the emulated chain in tests.
//!
//! *USB adapters* deliver answers when their latency timer expires, by default 16 ms for FTDI adapters. Set it to 1
//! (`/sys/bus/usb-serial/devices/ttyUSB0/latency_timer`); otherwise a read does not fit into a tick of 50 ms.

use std::cell::Cell;
use std::fs::File;
use std::io::{self, ErrorKind, Read, Write};
use std::path::Path;
use std::time::Duration;

use rustix::fs::{FlockOperation, OFlags, flock};
use rustypot::DynamixelProtocolHandler;
use serialport::SerialPort;

use super::model::{Protocol, Register, RegisterBlock, ServoModel, ServoSeries, model};

/// Opens the port again after it was gone.
pub type PortOpener = Box<dyn FnMut() -> Result<Box<dyn SerialPort>, BusError> + Send>;

/// The clock of a bus, ns.
pub type BusClock = Box<dyn Fn() -> u64 + Send>;

/// The largest durations of a tick's instructions, ns.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct BusBudget {
    /// A synchronous read, including its one repetition.
    pub read_ns: u64,
    /// A synchronous write.
    pub write_ns: u64,
}

impl BusBudget {
    /// Three tenths of the period for reading and one tenth for writing: 15 ms and 5 ms of 50 ms.
    pub fn of(period_ns: u64) -> Self {
        Self { read_ns: period_ns / 10 * 3, write_ns: period_ns / 10 }
    }
}

/// Errors of the bus.
#[derive(Debug, thiserror::Error)]
pub enum BusError {
    /// The device does not exist.
    #[error("{0}: there is no such port; look at the cable, and at what `ls /dev/ttyUSB* /dev/ttyACM*` says")]
    NoPort(String),
    /// The user may not open the device.
    #[error("{0}: no permission to open the port; join the group that owns it (often: sudo usermod -aG dialout $USER)")]
    Denied(String),
    /// Another process uses the port.
    #[error("{0}: another program has the port; end it first")]
    Busy(String),
    /// Any other problem with the port.
    #[error("{0}: the port cannot be used: {1}")]
    Port(String, String),
    /// An instruction without a valid answer.
    #[error("{0}")]
    NoAnswer(String),
    /// A servo does not take a value.
    #[error("{0}")]
    Refused(String),
    /// A goal that is outside the limits. It was not sent.
    #[error("servo {id} would be sent to {goal}, outside its limits of {low} to {high} steps; it was not sent")]
    Goal {
        /// The id.
        id: u8,
        /// The goal, steps.
        goal: i32,
        /// The lowest allowed goal.
        low: i32,
        /// The highest allowed goal.
        high: i32,
    },
}

impl BusError {
    /// Whether the cause is what the user has set up, rather than a cable, a servo or another program.
    pub fn is_configuration(&self) -> bool {
        matches!(self, Self::Denied(_))
    }
}

/// A bus of servos.
pub struct Bus {
    port: DeadlinePort,
    handler: DynamixelProtocolHandler,
    series: &'static ServoSeries,
    budget: BusBudget,
    opener: Option<PortOpener>,
    /// Limits of goal positions by id, steps.
    goal_limits: Vec<(u8, [i32; 2])>,
}

/// A servo's answer in a synchronous read.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ServoReply {
    /// The requested bytes.
    pub bytes: Vec<u8>,
    /// The error byte of its status packet.
    pub error: u8,
}

impl Bus {
    /// Opens the port at `path` for exclusive use; `clock` returns the time, ns.
    ///
    /// # Errors
    /// When the port does not exist, another process uses it, or the operating system denies access.
    pub fn open(
        path: &str,
        protocol: Protocol,
        baud: u32,
        budget: BusBudget,
        clock: BusClock,
    ) -> Result<Self, BusError> {
        let name = stable_name(path);
        let timeout = Duration::from_nanos(budget.read_ns);
        let mut bus = Self::over(open_port(path, baud, timeout)?, protocol, budget, clock);
        bus.set_opener(Box::new(move || open_port(&name, baud, timeout)));
        Ok(bus)
    }

    /// A bus over an open port.
    pub fn over(port: Box<dyn SerialPort>, protocol: Protocol, budget: BusBudget, clock: BusClock) -> Self {
        let handler = match protocol {
            Protocol::Dynamixel => DynamixelProtocolHandler::v2(),
            Protocol::Feetech => DynamixelProtocolHandler::v1(),
        };
        let port = DeadlinePort { port: Some(port), clock, deadline: u64::MAX, failed: Cell::new(false) };
        Self { port, handler, series: protocol.series(), budget, opener: None, goal_limits: Vec::new() }
    }

    /// Sets how the port is opened again after it was gone.
    pub fn set_opener(&mut self, opener: PortOpener) {
        self.opener = Some(opener);
    }

    /// Whether the port is gone: the operating system has reported an error, as after a cable was pulled out.
    /// Every instruction fails until [`Bus::reopen`] succeeds.
    pub fn is_gone(&self) -> bool {
        self.port.port.is_none()
    }

    /// Opens the port again, by its stable name. Changes nothing if it is open.
    ///
    /// # Errors
    /// As for [`Bus::open`].
    pub fn reopen(&mut self) -> Result<(), BusError> {
        if self.is_gone() {
            let Some(opener) = &mut self.opener else {
                return Err(BusError::NoAnswer("the port is gone".to_owned()));
            };
            self.port.port = Some(opener()?);
        }
        Ok(())
    }

    /// Sets the limits of goal positions, steps, by id. From now on a goal position outside them is refused
    /// where its packet is made, whatever asked for it. Servos that are not named have no limits.
    pub fn limit_goals(&mut self, limits: Vec<(u8, [i32; 2])>) {
        self.goal_limits = limits;
    }

    /// Checks the goal position in `data`, which is written to servo `id` from `address` on, if there is one.
    fn check_goal(&self, id: u8, address: u8, data: &[u8]) -> Result<(), BusError> {
        let Some(&(_, [low, high])) = self.goal_limits.iter().find(|(of, _)| *of == id) else { return Ok(()) };
        let block = RegisterBlock { address, length: data.len() as u8 };
        match block.decode(self.series.goal_position, data) {
            Some(goal) if !(low..=high).contains(&goal) => Err(BusError::Goal { id, goal, low, high }),
            _ => Ok(()),
        }
    }

    /// The series of the servos on the bus.
    pub fn series(&self) -> &'static ServoSeries {
        self.series
    }

    /// The current time of the bus's clock, ns.
    pub fn now(&self) -> u64 {
        (self.port.clock)()
    }

    /// Runs `work` with the port, within `budget` ns. Returns its result and duration, ns.
    fn within<T>(
        &mut self,
        budget: u64,
        work: impl FnOnce(&DynamixelProtocolHandler, &mut dyn SerialPort) -> Result<T, Box<dyn std::error::Error>>,
    ) -> (Result<T, BusError>, u64) {
        let began = self.now();
        self.port.deadline = began.saturating_add(budget);
        let result = work(&self.handler, &mut self.port).map_err(|e| BusError::NoAnswer(e.to_string()));
        if self.port.failed.take() {
            self.port.port = None;
        }
        (result, self.now().saturating_sub(began))
    }

    /// Reads and drops bytes that are still arriving. An answer does not identify its instruction, so a late
    /// answer would be taken for that of the next instruction.
    fn drain(&mut self) {
        let end = self.now().saturating_add(DRAIN_NS);
        let mut late = [0; 64];
        while self.now() < end {
            self.port.deadline = self.now().saturating_add(QUIET_NS);
            if !matches!(self.port.read(&mut late), Ok(1..)) {
                break;
            }
        }
    }

    /// Whether servo `id` answers.
    pub fn ping(&mut self, id: u8) -> bool {
        let answer = self.within(self.budget.read_ns, |handler, port| handler.ping(port, id)).0;
        // rustypot returns false after a time-out, and an error for anything else.
        answer.unwrap_or(false)
    }

    /// Sends an instruction to servo `id`, and repeats it once if it fails, each time with half the budget.
    fn request<T>(
        &mut self,
        id: u8,
        instruction: impl Fn(&DynamixelProtocolHandler, &mut dyn SerialPort) -> Result<T, Box<dyn std::error::Error>>,
    ) -> Result<T, BusError> {
        let half = self.budget.read_ns / 2;
        let mut last = String::new();
        for _ in 0..2 {
            match self.within(half, &instruction).0 {
                Ok(answer) => return Ok(answer),
                Err(error) => last = error.to_string(),
            }
            self.drain();
        }
        Err(BusError::NoAnswer(format!("servo {id} does not answer ({last})")))
    }

    /// Reads a register of one servo.
    ///
    /// # Errors
    /// When both attempts fail to get a valid answer within the budget.
    pub fn read(&mut self, id: u8, register: Register) -> Result<i32, BusError> {
        self.request(id, |handler, port| {
            let bytes = handler.read(port, id, register.address, register.width)?;
            if bytes.len() != usize::from(register.width) {
                return Err("the answer has the wrong length".into());
            }
            Ok(register.decode(&bytes))
        })
    }

    /// Reads `length` bytes of one servo from `block`'s address on.
    ///
    /// # Errors
    /// As for [`Bus::read`].
    pub fn read_block(&mut self, id: u8, block: RegisterBlock) -> Result<Vec<u8>, BusError> {
        self.request(id, |handler, port| {
            let bytes = handler.read(port, id, block.address, block.length)?;
            if bytes.len() != usize::from(block.length) {
                return Err("the answer has the wrong length".into());
            }
            Ok(bytes)
        })
    }

    /// The model number of one servo, and the model if it is known.
    ///
    /// # Errors
    /// As for [`Bus::read`].
    pub fn model(&mut self, id: u8) -> Result<(i32, Option<&'static ServoModel>), BusError> {
        let number = self.read(id, self.series.model)?;
        let known = u16::try_from(number).ok().and_then(|number| model(self.series.protocol, number));
        Ok((number, known))
    }

    /// Writes a register of one servo, and waits for its acknowledgement.
    ///
    /// # Errors
    /// As for [`Bus::read`], and when the servo refuses the value.
    pub fn write(&mut self, id: u8, register: Register, value: i32) -> Result<(), BusError> {
        let data = &register.encode(value)[..usize::from(register.width)];
        self.check_goal(id, register.address, data)?;
        let status = self.request(id, |handler, port| handler.write_with_error(port, id, register.address, data))?;
        // In protocol 1.0 the error byte has flags; in protocol 2.0 it has the reason of a refusal.
        match status.v2_instruction_error() {
            number if self.series.protocol == Protocol::Dynamixel && number != 0 => {
                let text = format!("servo {id} refuses {value} at address {} (error {number})", register.address);
                Err(BusError::Refused(text))
            }
            _ => Ok(()),
        }
    }

    /// A synchronous read, repeated once if it fails. Returns the servos' answers in order, and the duration, ns.
    ///
    /// # Errors
    /// When both attempts lack a valid answer of a servo, or exceed the budget.
    pub fn sync_read(&mut self, ids: &[u8], block: RegisterBlock) -> (Result<Vec<ServoReply>, BusError>, u64) {
        let half = self.budget.read_ns / 2;
        let mut spent = 0;
        let mut failed = BusError::NoAnswer(String::new());
        for _ in 0..2 {
            let (result, took) =
                self.within(half, |h, port| h.sync_read_with_error(port, ids, block.address, block.length));
            spent += took;
            match result {
                Ok(answers) if answers.iter().all(|(bytes, _)| bytes.len() == usize::from(block.length)) => {
                    let answers = answers.into_iter();
                    return (Ok(answers.map(|(bytes, e)| ServoReply { bytes, error: e.byte() }).collect()), spent);
                }
                Ok(_) => failed = BusError::NoAnswer("an answer is too short".to_owned()),
                Err(error) => failed = error,
            }
        }
        (Err(failed), spent)
    }

    /// A synchronous write, which servos do not answer. Returns the duration, ns.
    ///
    /// # Errors
    /// When writing to the port fails, or a goal position is outside the limits; nothing is sent then.
    pub fn sync_write(&mut self, ids: &[u8], address: u8, data: &[Vec<u8>]) -> (Result<(), BusError>, u64) {
        if let Some(error) = ids.iter().zip(data).find_map(|(&id, data)| self.check_goal(id, address, data).err()) {
            return (Err(error), 0);
        }
        self.within(self.budget.write_ns, |h, port| h.sync_write(port, ids, address, data))
    }

    /// Writes one register of all servos: `value` is called with the index of each servo.
    ///
    /// # Errors
    /// As for [`Bus::sync_write`].
    pub fn sync_set(&mut self, ids: &[u8], register: Register, value: impl Fn(usize) -> i32) -> Result<(), BusError> {
        let width = usize::from(register.width);
        let data: Vec<_> = (0..ids.len()).map(|i| register.encode(value(i))[..width].to_vec()).collect();
        self.sync_write(ids, register.address, &data).0
    }

    /// Turns torque off and ignores errors. The write is repeated three times, since servos do not acknowledge
    /// it and the repetition is harmless.
    pub fn torque_off(&mut self, ids: &[u8]) {
        for _ in 0..3 {
            let _ = self.sync_set(ids, self.series.torque_enable, |_| 0);
        }
    }
}

/// Opens the port at `path` for exclusive use.
fn open_port(path: &str, baud: u32, timeout: Duration) -> Result<Box<dyn SerialPort>, BusError> {
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
struct DeadlinePort {
    /// The port; `None` when it is gone.
    port: Option<Box<dyn SerialPort>>,
    clock: BusClock,
    /// Deadline of the current instruction, ns.
    deadline: u64,
    /// Whether the operating system has refused to say how much there is to read: the device is no longer there.
    failed: Cell<bool>,
}

/// The error of a port that is gone.
fn gone() -> io::Error {
    io::Error::new(ErrorKind::BrokenPipe, "the port is gone")
}

impl DeadlinePort {
    /// Does `work` with the port within the time until the deadline. Closes the port when it has failed.
    fn limited<T>(&mut self, work: impl FnOnce(&mut dyn SerialPort) -> io::Result<T>) -> io::Result<T> {
        let left = self.deadline.saturating_sub((self.clock)());
        let port = self.port.as_mut().ok_or_else(gone)?;
        if left == 0 {
            return Err(ErrorKind::TimedOut.into());
        }
        // Ports round down to milliseconds, and 0 would mean no time-out.
        let left = left.clamp(1_000_000, 1_000_000_000);
        let result =
            port.set_timeout(Duration::from_nanos(left)).map_err(io::Error::from).and_then(|()| work(port.as_mut()));
        let passes = |error: &io::Error| {
            matches!(error.kind(), ErrorKind::TimedOut | ErrorKind::Interrupted | ErrorKind::WouldBlock)
        };
        if result.as_ref().is_err_and(|error| !passes(error)) {
            self.port = None;
        }
        result
    }
}

impl Read for DeadlinePort {
    fn read(&mut self, to: &mut [u8]) -> io::Result<usize> {
        let wanted = !to.is_empty();
        self.limited(|port| match port.read(to)? {
            // The end of a serial line that cannot end: the device is no longer there.
            0 if wanted => Err(gone()),
            n => Ok(n),
        })
    }
}

impl Write for DeadlinePort {
    fn write(&mut self, from: &[u8]) -> io::Result<usize> {
        self.limited(|port| port.write(from))
    }

    fn flush(&mut self) -> io::Result<()> {
        self.port.as_mut().ok_or_else(gone)?.flush()
    }
}

/// Delegates methods to the inner port.
macro_rules! delegate {
    ($($name:ident(&self) -> $to:ty;)* @ $($change:ident(&mut self $(, $arg:ident: $kind:ty)?) -> $result:ty;)*) => {
        $(fn $name(&self) -> $to { self.port.as_ref().ok_or_else(gone)?.$name() })*
        $(fn $change(&mut self $(, $arg: $kind)?) -> $result {
            self.port.as_mut().ok_or_else(gone)?.$change($($arg)?)
        })*
    };
}

impl SerialPort for DeadlinePort {
    fn name(&self) -> Option<String> {
        self.port.as_ref()?.name()
    }

    fn timeout(&self) -> Duration {
        self.port.as_ref().map_or(Duration::ZERO, |port| port.timeout())
    }

    fn clear(&self, buffer: serialport::ClearBuffer) -> serialport::Result<()> {
        self.port.as_ref().ok_or_else(gone)?.clear(buffer)
    }

    fn bytes_to_read(&self) -> serialport::Result<u32> {
        let waiting = self.port.as_ref().ok_or_else(gone)?.bytes_to_read();
        self.failed.set(waiting.is_err());
        waiting
    }

    delegate! {
        baud_rate(&self) -> serialport::Result<u32>;
        data_bits(&self) -> serialport::Result<serialport::DataBits>;
        flow_control(&self) -> serialport::Result<serialport::FlowControl>;
        parity(&self) -> serialport::Result<serialport::Parity>;
        stop_bits(&self) -> serialport::Result<serialport::StopBits>;
        bytes_to_write(&self) -> serialport::Result<u32>;
        try_clone(&self) -> serialport::Result<Box<dyn SerialPort>>;
        set_break(&self) -> serialport::Result<()>;
        clear_break(&self) -> serialport::Result<()>;
        @
        set_baud_rate(&mut self, rate: u32) -> serialport::Result<()>;
        set_data_bits(&mut self, bits: serialport::DataBits) -> serialport::Result<()>;
        set_flow_control(&mut self, control: serialport::FlowControl) -> serialport::Result<()>;
        set_parity(&mut self, parity: serialport::Parity) -> serialport::Result<()>;
        set_stop_bits(&mut self, bits: serialport::StopBits) -> serialport::Result<()>;
        set_timeout(&mut self, timeout: Duration) -> serialport::Result<()>;
        write_request_to_send(&mut self, level: bool) -> serialport::Result<()>;
        write_data_terminal_ready(&mut self, level: bool) -> serialport::Result<()>;
        read_clear_to_send(&mut self) -> serialport::Result<bool>;
        read_data_set_ready(&mut self) -> serialport::Result<bool>;
        read_ring_indicator(&mut self) -> serialport::Result<bool>;
        read_carrier_detect(&mut self) -> serialport::Result<bool>;
    }
}
