//! The host's end of the bus: a port in exclusive use, and instructions with deadlines.
//!
//! Every instruction ends by its deadline, whatever the bus does: silence, incomplete answers, noise, or single
//! bytes. The bus time of a tick is therefore at most the sum of the two budgets of [`BusBudget`].
//!
//! The clock is an argument: CLOCK_MONOTONIC on hardware, a stepped clock with the emulated chain in tests.
//!
//! *USB adapters* deliver answers when their latency timer expires, by default 16 ms for FTDI adapters. Set it to 1
//! (`/sys/bus/usb-serial/devices/ttyUSB0/latency_timer`); otherwise a read does not fit into a tick of 50 ms.

mod line;

use std::time::Duration;

use serialport::SerialPort;

use super::model::{Protocol, Register, RegisterBlock, ServoModel, ServoSeries, model};
use super::packet;

pub use super::packet::{AnswerFault, ServoReply};
pub use line::{latency_advice, latency_ms, stable_name};

use line::{Line, open_port};

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
    #[error("servo {id}: {fault}")]
    NoAnswer {
        /// The servo that was to answer.
        id: u8,
        /// What came instead.
        fault: AnswerFault,
    },
    /// An instruction that could not be sent.
    #[error("{0}")]
    NotSent(AnswerFault),
    /// A servo that obeys and does not say so.
    #[error(
        "servo {id} does what it is told and does not acknowledge it: its response level (address {address}) is too \
         low; write {level} there"
    )]
    Mute {
        /// The id.
        id: u8,
        /// Address of the register that says what it answers.
        address: u8,
        /// The value with which it answers everything.
        level: u8,
    },
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
        matches!(self, Self::Denied(_) | Self::Mute { .. })
    }
}

/// A bus of servos.
pub struct Bus {
    line: Line,
    series: &'static ServoSeries,
    budget: BusBudget,
    opener: Option<PortOpener>,
    /// Limits of goal positions by id, steps.
    goal_limits: Vec<(u8, [i32; 2])>,
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
        let line = Line::new(port, protocol, clock);
        Self { line, series: protocol.series(), budget, opener: None, goal_limits: Vec::new() }
    }

    /// Sets how the port is opened again after it was gone.
    pub fn set_opener(&mut self, opener: PortOpener) {
        self.opener = Some(opener);
    }

    /// Whether the port is gone: the operating system has reported an error, as after a cable was pulled out.
    /// Every instruction fails until [`Bus::reopen`] succeeds.
    pub fn is_gone(&self) -> bool {
        self.line.port.is_none()
    }

    /// Opens the port again, by its stable name. Changes nothing if it is open.
    ///
    /// # Errors
    /// As for [`Bus::open`].
    pub fn reopen(&mut self) -> Result<(), BusError> {
        if self.is_gone() {
            let Some(opener) = &mut self.opener else {
                return Err(BusError::NotSent(AnswerFault::Gone));
            };
            self.line.port = Some(opener()?);
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
        self.line.now()
    }

    /// Sends `packet` and receives the answers of `ids`, in this order and with `length` bytes each, within `budget`
    /// ns. Returns the answers and the duration, ns.
    fn exchange(
        &mut self,
        packet: &[u8],
        ids: &[u8],
        length: usize,
        budget: u64,
    ) -> (Result<Vec<ServoReply>, BusError>, u64) {
        let began = self.now();
        self.line.deadline = began.saturating_add(budget);
        let sent = self.line.send(packet).map_err(BusError::NotSent);
        if ids.is_empty() {
            self.line.skip_echo();
        }
        let mut receive = |id| self.line.receive(id, length).map_err(|fault| BusError::NoAnswer { id, fault });
        let result = sent.and_then(|()| ids.iter().map(|&id| receive(id)).collect());
        (result, self.now().saturating_sub(began))
    }

    /// Whether servo `id` answers.
    pub fn ping(&mut self, id: u8) -> bool {
        // A Dynamixel answers with model and firmware.
        let length = if self.series.protocol == Protocol::Dynamixel { 3 } else { 0 };
        let packet = packet::ping(self.series.protocol, id);
        self.exchange(&packet, &[id], length, self.budget.read_ns).0.is_ok()
    }

    /// Sends an instruction to servo `id`, and repeats it once if it fails, each time with half the budget.
    fn request(&mut self, id: u8, packet: &[u8], length: usize) -> Result<ServoReply, BusError> {
        let half = self.budget.read_ns / 2;
        let mut result = Err(BusError::NotSent(AnswerFault::NotSent));
        for _ in 0..2 {
            result = self.exchange(packet, &[id], length, half).0;
            if let Ok(answers) = &mut result
                && let Some(answer) = answers.pop()
            {
                return Ok(answer);
            }
            self.line.drain(u64::MAX);
        }
        result.and(Err(BusError::NoAnswer { id, fault: AnswerFault::Silent }))
    }

    /// Reads a register of one servo.
    ///
    /// # Errors
    /// When both attempts fail to get a valid answer within the budget.
    pub fn read(&mut self, id: u8, register: Register) -> Result<i32, BusError> {
        let block = RegisterBlock { address: register.address, length: register.width };
        Ok(register.decode(&self.read_block(id, block)?))
    }

    /// Reads `length` bytes of one servo from `block`'s address on.
    ///
    /// # Errors
    /// As for [`Bus::read`].
    pub fn read_block(&mut self, id: u8, block: RegisterBlock) -> Result<Vec<u8>, BusError> {
        let packet = packet::read(self.series.protocol, id, block);
        Ok(self.request(id, &packet, usize::from(block.length))?.bytes)
    }

    /// The model number of one servo, and the model if it is known.
    ///
    /// # Errors
    /// As for [`Bus::read`]. A servo that answers a ping and no read is told apart from one that is not there.
    pub fn model(&mut self, id: u8) -> Result<(i32, Option<&'static ServoModel>), BusError> {
        let number = match self.read(id, self.series.model) {
            Err(BusError::NoAnswer { fault: AnswerFault::Silent, .. }) if self.ping(id) => return Err(self.mute(id)),
            number => number?,
        };
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
        let packet = packet::write(self.series.protocol, id, register.address, data);
        let status = match self.request(id, &packet, 0) {
            // Lost, or obeyed in silence?
            Err(error @ BusError::NoAnswer { fault: AnswerFault::Silent, .. }) => {
                return Err(if matches!(self.read(id, register), Ok(found) if found == value) {
                    self.mute(id)
                } else {
                    error
                });
            }
            status => status?,
        };
        // In protocol 1.0 the error byte has flags. In protocol 2.0 it has the reason of a refusal, and in bit 7
        // whether the servo has an error of its own.
        match status.error & 0x7f {
            number if self.series.protocol == Protocol::Dynamixel && number != 0 => {
                let text = format!("servo {id} refuses {value} at address {} (error {number})", register.address);
                Err(BusError::Refused(text))
            }
            _ => Ok(()),
        }
    }

    /// The error of a servo that is there and does not answer as it should.
    fn mute(&self, id: u8) -> BusError {
        let level = if self.series.protocol == Protocol::Dynamixel { 2 } else { 1 };
        BusError::Mute { id, address: self.series.response_level.address, level }
    }

    /// Whether the adapter sends back what it is sent; its own bytes are then dropped.
    pub fn echoes(&self) -> bool {
        self.line.echoes()
    }

    /// A synchronous read, repeated once if it fails. Returns the servos' answers in order, and the duration, ns.
    ///
    /// # Errors
    /// When both attempts lack a valid answer of a servo, or exceed the budget.
    pub fn sync_read(&mut self, ids: &[u8], block: RegisterBlock) -> (Result<Vec<ServoReply>, BusError>, u64) {
        let half = self.budget.read_ns / 2;
        let packet = packet::sync_read(self.series.protocol, ids, block);
        let began = self.now();
        let (first, took) = self.exchange(&packet, ids, usize::from(block.length), half);
        let Err(first) = first else { return (first, took) };
        // The servos behind the one that failed are still answering; with that the first half of the budget ends.
        self.line.drain(began.saturating_add(half));
        let second = self.exchange(&packet, ids, usize::from(block.length), half).0;
        // What failed first is the cause; what follows it may be its consequence.
        (second.map_err(|_| first), self.now().saturating_sub(began))
    }

    /// A synchronous write, which servos do not answer. Returns the duration, ns.
    ///
    /// # Errors
    /// When writing to the port fails, or a goal position is outside the limits; nothing is sent then.
    pub fn sync_write(&mut self, ids: &[u8], address: u8, data: &[Vec<u8>]) -> (Result<(), BusError>, u64) {
        if let Some(error) = ids.iter().zip(data).find_map(|(&id, data)| self.check_goal(id, address, data).err()) {
            return (Err(error), 0);
        }
        let packet = packet::sync_write(self.series.protocol, ids, address, data);
        let (sent, took) = self.exchange(&packet, &[], 0, self.budget.write_ns);
        (sent.map(drop), took)
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
