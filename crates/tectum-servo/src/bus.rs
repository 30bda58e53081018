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

use std::fs::File;
use std::io::{self, ErrorKind, Read, Write};
use std::path::Path;
use std::time::Duration;

use rustix::fs::{FlockOperation, OFlags, flock};
use rustypot::DynamixelProtocolHandler;
use serialport::SerialPort;

use super::model::{Protocol, Register, RegisterBlock, ServoModel, ServoSeries, model};

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
}

/// A bus of servos.
pub struct Bus {
    port: DeadlinePort,
    handler: DynamixelProtocolHandler,
    series: &'static ServoSeries,
    budget: BusBudget,
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
        probe(path)?;
        let opened = serialport::new(path, baud).timeout(Duration::from_nanos(budget.read_ns)).open();
        // serialport locks the port itself (flock and TIOCEXCL), and releases it with the descriptor.
        let port = opened.map_err(|error| match error.kind() {
            serialport::ErrorKind::NoDevice if error.description.contains("lock") => BusError::Busy(path.to_owned()),
            serialport::ErrorKind::NoDevice if error.description.contains("busy") => BusError::Busy(path.to_owned()),
            serialport::ErrorKind::Io(ErrorKind::ResourceBusy) => BusError::Busy(path.to_owned()),
            _ => BusError::Port(path.to_owned(), error.to_string()),
        })?;
        Ok(Self::over(port, protocol, budget, clock))
    }

    /// A bus over an open port.
    pub fn over(port: Box<dyn SerialPort>, protocol: Protocol, budget: BusBudget, clock: BusClock) -> Self {
        let handler = match protocol {
            Protocol::Dynamixel => DynamixelProtocolHandler::v2(),
            Protocol::Feetech => DynamixelProtocolHandler::v1(),
        };
        let port = DeadlinePort { port, clock, deadline: u64::MAX };
        Self { port, handler, series: protocol.series(), budget }
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
        let status = self.request(id, |handler, port| handler.write_with_error(port, id, register.address, data))?;
        // In protocol 1.0 the error byte has flags; in protocol 2.0 it has the reason of a refusal.
        match status.v2_instruction_error() {
            number if self.series.protocol == Protocol::Dynamixel && number != 0 => {
                let text = format!("servo {id} refuses {value} at address {} (error {number})", register.address);
                Err(BusError::NoAnswer(text))
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
    /// When writing to the port fails.
    pub fn sync_write(&mut self, ids: &[u8], address: u8, data: &[Vec<u8>]) -> (Result<(), BusError>, u64) {
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

/// A port whose reads and writes end by a deadline.
struct DeadlinePort {
    port: Box<dyn SerialPort>,
    clock: BusClock,
    /// Deadline of the current instruction, ns.
    deadline: u64,
}

impl DeadlinePort {
    /// Sets the time-out of the port to the time until the deadline.
    fn limit_time(&mut self) -> io::Result<()> {
        let left = self.deadline.saturating_sub((self.clock)());
        if left == 0 {
            return Err(ErrorKind::TimedOut.into());
        }
        // Ports round down to milliseconds, and 0 would mean no time-out.
        let left = left.clamp(1_000_000, 1_000_000_000);
        self.port.set_timeout(Duration::from_nanos(left)).map_err(io::Error::from)
    }
}

impl Read for DeadlinePort {
    fn read(&mut self, to: &mut [u8]) -> io::Result<usize> {
        self.limit_time()?;
        self.port.read(to)
    }
}

impl Write for DeadlinePort {
    fn write(&mut self, from: &[u8]) -> io::Result<usize> {
        self.limit_time()?;
        self.port.write(from)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.port.flush()
    }
}

/// Delegates methods to the inner port.
macro_rules! delegate {
    ($($name:ident(&self) -> $to:ty;)* @ $($change:ident(&mut self $(, $arg:ident: $kind:ty)?) -> $result:ty;)*) => {
        $(fn $name(&self) -> $to { self.port.$name() })*
        $(fn $change(&mut self $(, $arg: $kind)?) -> $result { self.port.$change($($arg)?) })*
    };
}

impl SerialPort for DeadlinePort {
    fn clear(&self, buffer: serialport::ClearBuffer) -> serialport::Result<()> {
        self.port.clear(buffer)
    }

    delegate! {
        name(&self) -> Option<String>;
        baud_rate(&self) -> serialport::Result<u32>;
        data_bits(&self) -> serialport::Result<serialport::DataBits>;
        flow_control(&self) -> serialport::Result<serialport::FlowControl>;
        parity(&self) -> serialport::Result<serialport::Parity>;
        stop_bits(&self) -> serialport::Result<serialport::StopBits>;
        timeout(&self) -> Duration;
        bytes_to_read(&self) -> serialport::Result<u32>;
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
