//! The host's end of the wire: a port of one's own, and instructions that never take longer than they may.
//!
//! The codec is rustypot's. Around the port stands a `DeadlinePort` one, which gives every instruction an
//! instant by which it is over, whatever the bus does: nothing, too little, noise, or one byte now and then.
//! What a tick may cost is therefore known: the two budgets of [`BusBudget`], and no more.
//!
//! Time is handed in: CLOCK_MONOTONIC on hardware, a stepped clock with the emulated chain in tests.
//!
//! *USB adapters* pass answers on when their latency timer says so, 16 ms by default with FTDI's. Set it to 1
//! (`/sys/bus/usb-serial/devices/ttyUSB0/latency_timer`), or no tick of 50 ms has room for a read.

use std::fs::File;
use std::io::{self, ErrorKind, Read, Write};
use std::path::Path;
use std::time::Duration;

use rustix::fs::{FlockOperation, OFlags, flock};
use rustypot::DynamixelProtocolHandler;
use serialport::SerialPort;

use super::model::{Protocol, Register, RegisterBlock, ServoModel, ServoSeries, model};

/// Where the bus takes the time from, ns.
pub type BusClock = Box<dyn Fn() -> u64 + Send>;

/// What the instructions of a tick may cost at most, ns.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct BusBudget {
    /// A synchronous read with its one repetition.
    pub read_ns: u64,
    /// A synchronous write.
    pub write_ns: u64,
}

impl BusBudget {
    /// Three tenths of the period for reading and one for writing: 15 and 5 of 50 ms.
    pub fn of(period_ns: u64) -> Self {
        Self { read_ns: period_ns / 10 * 3, write_ns: period_ns / 10 }
    }
}

/// Why the bus cannot be used, or did not answer.
#[derive(Debug, thiserror::Error)]
pub enum BusError {
    /// There is no such device.
    #[error("{0}: there is no such port; look at the cable, and at what `ls /dev/ttyUSB* /dev/ttyACM*` says")]
    NoPort(String),
    /// The operating system does not let this user have it.
    #[error("{0}: no permission to open the port; join the group that owns it (often: sudo usermod -aG dialout $USER)")]
    Denied(String),
    /// Another process has it.
    #[error("{0}: another program has the port; end it first")]
    Busy(String),
    /// Anything else about the port.
    #[error("{0}: the port cannot be used: {1}")]
    Port(String, String),
    /// An instruction without a proper answer.
    #[error("{0}")]
    Silent(String),
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
    /// The bytes asked for.
    pub bytes: Vec<u8>,
    /// The error byte of its status packet.
    pub error: u8,
}

impl Bus {
    /// Opens the port at `path` for this process alone; `clock` tells the time, ns.
    ///
    /// # Errors
    /// When there is no such port, it is another's, or the operating system refuses it.
    pub fn open(
        path: &str,
        protocol: Protocol,
        baud: u32,
        budget: BusBudget,
        clock: BusClock,
    ) -> Result<Self, BusError> {
        probe(path)?;
        let opened = serialport::new(path, baud).timeout(Duration::from_nanos(budget.read_ns)).open();
        // serialport locks the port itself (flock and TIOCEXCL), and frees it with its descriptor.
        let port = opened.map_err(|error| match error.kind() {
            serialport::ErrorKind::NoDevice if error.description.contains("lock") => BusError::Busy(path.to_owned()),
            serialport::ErrorKind::NoDevice if error.description.contains("busy") => BusError::Busy(path.to_owned()),
            serialport::ErrorKind::Io(ErrorKind::ResourceBusy) => BusError::Busy(path.to_owned()),
            _ => BusError::Port(path.to_owned(), error.to_string()),
        })?;
        Ok(Self::over(port, protocol, budget, clock))
    }

    /// A bus over a port that is open.
    pub fn over(port: Box<dyn SerialPort>, protocol: Protocol, budget: BusBudget, clock: BusClock) -> Self {
        let handler = match protocol {
            Protocol::Dynamixel => DynamixelProtocolHandler::v2(),
            Protocol::Feetech => DynamixelProtocolHandler::v1(),
        };
        let port = DeadlinePort { port, clock, until: u64::MAX };
        Self { port, handler, series: protocol.series(), budget }
    }

    /// The series on it.
    pub fn series(&self) -> &'static ServoSeries {
        self.series
    }

    /// Now, ns.
    pub fn now(&self) -> u64 {
        (self.port.clock)()
    }

    /// Does `work` with the port, within `budget` ns; with the time that it took.
    fn within<T>(
        &mut self,
        budget: u64,
        work: impl FnOnce(&DynamixelProtocolHandler, &mut dyn SerialPort) -> Result<T, Box<dyn std::error::Error>>,
    ) -> (Result<T, BusError>, u64) {
        let began = self.now();
        self.port.until = began.saturating_add(budget);
        let result = work(&self.handler, &mut self.port).map_err(|e| BusError::Silent(e.to_string()));
        (result, self.now().saturating_sub(began))
    }

    /// Lets what is still on its way arrive, and forgets it: an answer does not say to what it is one, so that
    /// a late one would pass for that of the next question.
    fn settle(&mut self) {
        let until = self.now().saturating_add(SETTLE_NS);
        let mut late = [0; 64];
        while self.now() < until {
            self.port.until = self.now().saturating_add(QUIET_NS);
            if !matches!(self.port.read(&mut late), Ok(1..)) {
                break;
            }
        }
    }

    /// Whether servo `id` answers.
    pub fn ping(&mut self, id: u8) -> bool {
        let answer = self.within(self.budget.read_ns, |handler, port| handler.ping(port, id)).0;
        // rustypot takes a time-out for a no, and anything else for an error.
        answer.unwrap_or(false)
    }

    /// Asks servo `id` something, once more if need be, each time with half the budget.
    fn ask<T>(
        &mut self,
        id: u8,
        question: impl Fn(&DynamixelProtocolHandler, &mut dyn SerialPort) -> Result<T, Box<dyn std::error::Error>>,
    ) -> Result<T, BusError> {
        let half = self.budget.read_ns / 2;
        let mut last = String::new();
        for _ in 0..2 {
            match self.within(half, &question).0 {
                Ok(answer) => return Ok(answer),
                Err(error) => last = error.to_string(),
            }
            self.settle();
        }
        Err(BusError::Silent(format!("servo {id} does not answer ({last})")))
    }

    /// A register of one servo.
    ///
    /// # Errors
    /// When no proper answer comes within the budget, also not the second time.
    pub fn read(&mut self, id: u8, register: Register) -> Result<i32, BusError> {
        self.ask(id, |handler, port| {
            let bytes = handler.read(port, id, register.address, register.width)?;
            if bytes.len() != usize::from(register.width) {
                return Err("what came answers something else".into());
            }
            Ok(register.decode(&bytes))
        })
    }

    /// The model number of one servo, and the model if its series has it.
    ///
    /// # Errors
    /// As for [`Bus::read`].
    pub fn model(&mut self, id: u8) -> Result<(i32, Option<&'static ServoModel>), BusError> {
        let number = self.read(id, self.series.model)?;
        let known = u16::try_from(number).ok().and_then(|number| model(self.series.protocol, number));
        Ok((number, known))
    }

    /// Sets a register of one servo, and waits for its word that it has done so.
    ///
    /// # Errors
    /// As for [`Bus::read`]; and where the servo refuses.
    pub fn write(&mut self, id: u8, register: Register, value: i32) -> Result<(), BusError> {
        let data = &register.encode(value)[..usize::from(register.width)];
        let status = self.ask(id, |handler, port| handler.write_with_error(port, id, register.address, data))?;
        // Protocol 1.0 tells conditions there, protocol 2.0 a number that says why it refuses.
        match status.v2_instruction_error() {
            why if self.series.protocol == Protocol::Dynamixel && why != 0 => {
                let text = format!("servo {id} refuses {value} at address {} (error {why})", register.address);
                Err(BusError::Silent(text))
            }
            _ => Ok(()),
        }
    }

    /// One synchronous read, once more if need be: the servos' answers in order. With the time that it took, ns.
    ///
    /// # Errors
    /// When one of them does not answer as it should, also not the second time, or the budget is spent.
    pub fn sync_read(&mut self, ids: &[u8], block: RegisterBlock) -> (Result<Vec<ServoReply>, BusError>, u64) {
        let half = self.budget.read_ns / 2;
        let mut spent = 0;
        let mut failed = BusError::Silent(String::new());
        for _ in 0..2 {
            let (result, took) =
                self.within(half, |h, port| h.sync_read_with_error(port, ids, block.address, block.length));
            spent += took;
            match result {
                Ok(answers) if answers.iter().all(|(bytes, _)| bytes.len() == usize::from(block.length)) => {
                    let answers = answers.into_iter();
                    return (Ok(answers.map(|(bytes, e)| ServoReply { bytes, error: e.byte() }).collect()), spent);
                }
                Ok(_) => failed = BusError::Silent("an answer is too short".to_owned()),
                Err(error) => failed = error,
            }
        }
        (Err(failed), spent)
    }

    /// One synchronous write, which nobody answers. With the time that it took, ns.
    ///
    /// # Errors
    /// When the port does not take it.
    pub fn sync_write(&mut self, ids: &[u8], address: u8, data: &[Vec<u8>]) -> (Result<(), BusError>, u64) {
        self.within(self.budget.write_ns, |h, port| h.sync_write(port, ids, address, data))
    }

    /// The same value for all, or one for each, in one register.
    ///
    /// # Errors
    /// As for [`Bus::sync_write`].
    pub fn sync_set(&mut self, ids: &[u8], register: Register, value: impl Fn(usize) -> i32) -> Result<(), BusError> {
        let width = usize::from(register.width);
        let data: Vec<_> = (0..ids.len()).map(|i| register.encode(value(i))[..width].to_vec()).collect();
        self.sync_write(ids, register.address, &data).0
    }

    /// Turns torque off, whatever the servos say to it: three times, since nobody answers, and none of them can
    /// do harm.
    pub fn torque_off(&mut self, ids: &[u8]) {
        for _ in 0..3 {
            let _ = self.sync_set(ids, self.series.torque_enable, |_| 0);
        }
    }
}

/// Whether the port is there, may be opened, and is nobody else's: what serialport would not tell apart. The
/// lock is let go again at once, since serialport takes one for itself.
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

/// How long nothing comes before a line counts as quiet, and how long that is waited for at most, ns.
const QUIET_NS: u64 = 1_000_000;
const SETTLE_NS: u64 = 3_000_000;

/// A port whose reads end at an instant.
struct DeadlinePort {
    port: Box<dyn SerialPort>,
    clock: BusClock,
    /// ns.
    until: u64,
}

impl Read for DeadlinePort {
    fn read(&mut self, to: &mut [u8]) -> io::Result<usize> {
        let left = self.until.saturating_sub((self.clock)());
        if left == 0 {
            return Err(ErrorKind::TimedOut.into());
        }
        // Ports round down to milliseconds, and 0 would be for ever.
        let left = left.clamp(1_000_000, 1_000_000_000);
        self.port.set_timeout(Duration::from_nanos(left)).map_err(io::Error::from)?;
        self.port.read(to)
    }
}

impl Write for DeadlinePort {
    fn write(&mut self, from: &[u8]) -> io::Result<usize> {
        let left = self.until.saturating_sub((self.clock)());
        if left == 0 {
            return Err(ErrorKind::TimedOut.into());
        }
        let left = left.clamp(1_000_000, 1_000_000_000);
        self.port.set_timeout(Duration::from_nanos(left)).map_err(io::Error::from)?;
        self.port.write(from)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.port.flush()
    }
}

/// Hands calls on to the port inside.
macro_rules! hand_on {
    ($($name:ident(&self) -> $to:ty;)* @ $($change:ident(&mut self $(, $arg:ident: $kind:ty)?) -> $result:ty;)*) => {
        $(fn $name(&self) -> $to { self.port.$name() })*
        $(fn $change(&mut self $(, $arg: $kind)?) -> $result { self.port.$change($($arg)?) })*
    };
}

impl SerialPort for DeadlinePort {
    fn clear(&self, buffer: serialport::ClearBuffer) -> serialport::Result<()> {
        self.port.clear(buffer)
    }

    hand_on! {
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
