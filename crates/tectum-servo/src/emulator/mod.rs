//! An emulated chain of serial-bus servos: timed bytes in, timed bytes out.
//!
//! Pure computation, without clock, files or threads: the output is a function of seed, configuration, and the
//! received bytes with their times. [`EmulatedPort`] offers it as `serialport`'s trait with a stepped clock;
//! `tectum-servo-emulator` offers it as a pseudo-terminal in real time.
//!
//! *Like real servos*: packets, checksums, stuffing and error bytes; control tables with EEPROM and read-only
//! registers; transmission time and return delay; sequential answers to a synchronous read, where the servos
//! after a missing answer do not answer; two servos with one id that answer at the same time; no answers at a
//! wrong baud rate or too low a response level; speed and acceleration from registers; Dynamixel's bus watchdog and
//! its errors that last until a reboot; torque off after a loss of power.
//!
//! *Where the manuals are unclear, the worse behaviour is emulated*: goals are kept while torque is off, so
//! that turning it on moves the shaft to an old goal; with Feetech, writing a goal position turns torque on.
//!
//! *Not emulated*: mass, gravity and friction (without torque a shaft does not move); controller gains; current
//! and PWM modes; times in place of speeds (drive mode), indirect addresses; registered writes; bulk and fast reads;
//! Feetech's step mode, setting the middle position by writing 128 to torque, and the residual torque after an
//! overload (torque is turned off completely).

mod config;
mod faults;
mod motion;
mod port;
mod requests;
mod servo;
mod table;

use std::collections::VecDeque;

use rand::RngExt as _;

pub use config::{EmulatorConfig, ServoFault, ServoFaultKind};
pub use port::{EmulatedPort, SteppedClock};

use crate::model::{MODELS, Protocol, ServoModel};
use crate::packet::{self, BROADCAST, Packet, instruction};
use faults::ChainFaults;
use requests::RequestParser;
use servo::{EmulatedServo, ServoFaultState};
use table::instruction_error;
use tectum_core::seed::{self, Rng};

/// Silence after which an incomplete packet is dropped, ns.
const PACKET_TIMEOUT: u64 = 20_000_000;

/// Time between the answers to a broadcast ping, ns.
const PING_SLOT: u64 = 3_000_000;

/// A chain of emulated servos on one wire.
#[derive(Debug, Clone)]
pub struct EmulatedChain {
    protocol: Protocol,
    servos: Vec<EmulatedServo>,
    settings: EmulatorConfig,
    faults: ChainFaults,
    rng: Rng,
    parser: RequestParser,
    /// Time up to which the chain was simulated, ns.
    now: u64,
    /// Time of the last received byte, ns.
    received: u64,
    /// Time from which on the wire is free, ns.
    wire_free: u64,
    /// Answers, each with the time at which its last byte is sent, ns.
    answers: VecDeque<(u64, Vec<u8>)>,
    /// Number of answers so far, the key of their faults.
    answer_count: u64,
    /// How often the cable was pulled out of the host.
    pulled: u64,
    /// Whether it is out now.
    out: bool,
}

/// The true state of an emulated servo, independent of the bus.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub struct ServoState {
    /// Its id.
    pub id: u8,
    /// Position of its shaft, steps.
    pub position: f64,
    /// Speed of its shaft, steps/s.
    pub speed: f64,
    /// Whether torque is on.
    pub torque: bool,
    /// Its error bits.
    pub errors: u8,
    /// The longest distance that its shaft has turned between two instructions on the bus, steps: what a host that
    /// died or fell silent has left it to do.
    pub unattended: f64,
}

impl EmulatedChain {
    /// Servos with these ids, in their order on the wire, all in their middle position, with the baud rate
    /// `baud`. A repeated id gives two servos that answer at the same time.
    pub fn new(protocol: Protocol, ids: &[u8], baud: u32, settings: &EmulatorConfig, seed: u64) -> Self {
        let named = settings.model.as_ref().and_then(|name| MODELS.iter().find(|model| model.name == name));
        let default = MODELS.iter().find(|model| model.protocol == protocol);
        let model: &ServoModel =
            named.filter(|model| model.protocol == protocol).or(default).expect("a model of each protocol");
        Self::of(model, ids, baud, settings, seed)
    }

    /// A chain of servos of any model, with the control table of its protocol's series.
    pub fn of(model: &ServoModel, ids: &[u8], baud: u32, settings: &EmulatorConfig, seed: u64) -> Self {
        let protocol = model.protocol;
        let servos = ids.iter().map(|&id| EmulatedServo::new(model, id, baud, 2048.0, settings)).collect();
        let mut rng = seed::stream(seed, "emulator");
        let faults = ChainFaults::new(&settings.faults, rng.random());
        Self {
            protocol,
            servos,
            settings: settings.clone(),
            faults,
            rng,
            parser: RequestParser::new(protocol),
            now: 0,
            received: 0,
            wire_free: 0,
            answers: VecDeque::new(),
            answer_count: 0,
            pulled: 0,
            out: false,
        }
    }

    /// Pulls the cable out of the host: ports that are open fail from now on, also when it is back.
    pub fn pull_cable(&mut self) {
        (self.pulled, self.out) = (self.pulled + 1, true);
        self.answers.clear();
    }

    /// Puts the cable back: new ports can be opened.
    pub fn put_cable_back(&mut self) {
        self.out = false;
    }

    /// Whether the cable is out of the host.
    pub fn is_cable_out(&self) -> bool {
        self.out
    }

    /// How often the cable was pulled out so far.
    pub(crate) fn pulled(&self) -> u64 {
        self.pulled
    }

    /// Adds a fault whose times count from `now`, ns.
    pub fn add_fault(&mut self, now: u64, fault: ServoFault) {
        self.advance_to(now.max(self.now));
        let later = |seconds: f64| seconds + now as f64 / 1e9;
        let from_s = Some(later(fault.from_s.unwrap_or(0.0)));
        self.faults.push(ServoFault { from_s, until_s: fault.until_s.map(later), ..fault });
    }

    /// Overwrites registers of servo `id` for good, as another program may have done.
    pub fn overwrite(&mut self, id: u8, address: u8, bytes: &[u8]) {
        for servo in self.servos.iter_mut().filter(|servo| servo.id() == id) {
            servo.table.overwrite(address, bytes);
        }
    }

    /// Receives bytes that a host sends at `now` with `baud` (0: the servos' own rate). Times never decrease;
    /// the emulator starts at 0.
    pub fn receive(&mut self, now: u64, baud: u32, bytes: &[u8]) {
        if now.saturating_sub(self.received) > PACKET_TIMEOUT {
            self.parser.clear();
        }
        self.received = now;
        let baud_in_use =
            if baud == 0 { self.servos.first().map_or(1_000_000, |servo| servo.table.baud()) } else { baud };
        self.wire_free = self.wire_free.max(now) + wire_ns(bytes.len(), baud_in_use);
        if self.settings.echo {
            let due = self.answers.back().map_or(self.wire_free, |(last, _)| self.wire_free.max(*last));
            self.answers.push_back((due, bytes.to_vec()));
        }
        self.parser.push(bytes);
        while let Some(request) = self.parser.next_request() {
            let at = self.wire_free.max(self.now);
            self.advance_to(at);
            self.execute(&request, at, baud, baud_in_use);
        }
    }

    /// The time at which the next answer is sent completely, if there is one, ns.
    pub fn next_answer(&self) -> Option<u64> {
        self.answers.front().map(|(due, _)| *due)
    }

    /// The bytes of the next answer that is sent completely by `now`.
    pub fn take(&mut self, now: u64) -> Option<Vec<u8>> {
        let due = self.next_answer()?;
        if due <= now { self.answers.pop_front().map(|(_, bytes)| bytes) } else { None }
    }

    /// Simulates the servos until `now`, without an instruction.
    pub fn advance_to(&mut self, now: u64) {
        while self.now < now {
            let until = self.faults.next_change(self.now).min(now);
            self.advance_servos(until);
            self.now = until;
        }
        self.advance_servos(self.now);
    }

    /// Moves the shaft of servo `id` to `at` steps by hand; a servo with torque does not move. Returns whether
    /// the servo exists.
    pub fn move_by_hand(&mut self, now: u64, id: u8, at: f64) -> bool {
        self.advance_to(now.max(self.now));
        let mut found = false;
        for servo in self.servos.iter_mut().filter(|servo| servo.id() == id) {
            servo.move_by_hand(at);
            found = true;
        }
        found
    }

    /// The state of all servos at `now`, in their order on the wire.
    pub fn state(&mut self, now: u64) -> Vec<ServoState> {
        self.advance_to(now.max(self.now));
        let state = |servo: &EmulatedServo| ServoState {
            id: servo.id(),
            position: servo.shaft.at,
            speed: servo.shaft.speed,
            torque: servo.has_torque(),
            errors: servo.table.get(servo.table.series.hardware_error) as u8,
            unattended: servo.unattended(),
        };
        self.servos.iter().map(state).collect()
    }

    fn advance_servos(&mut self, until: u64) {
        // Faults change only at `next_change`, so those at `self.now` hold until `until`.
        let mut off = false;
        for servo in &mut self.servos {
            let (id, now, faults) = (servo.id(), self.now, &self.faults);
            off |= faults.is_active(ServoFaultKind::CableOut, id, now);
            let state = ServoFaultState {
                off,
                held: faults.is_active(ServoFaultKind::Overload, id, now),
                low_voltage: faults.is_active(ServoFaultKind::BrownOut, id, now),
                hot: faults.is_active(ServoFaultKind::Hot, id, now),
            };
            servo.advance(until, state);
        }
    }

    /// Executes a request that was received completely at `at`.
    fn execute(&mut self, request: &Packet, at: u64, baud: u32, wire_baud: u32) {
        let tuned = |servo: &EmulatedServo| servo.is_powered() && (baud == 0 || servo.table.baud() == baud);
        let listening: Vec<usize> = (0..self.servos.len()).filter(|&i| tuned(&self.servos[i])).collect();
        if !request.checksum_ok {
            // A Dynamixel reports a wrong checksum if the id is its own; a Feetech ignores the packet.
            if self.protocol == Protocol::Dynamixel {
                let own = listening.iter().copied().filter(|&i| self.servos[i].id() == request.id).collect();
                self.answer(own, at, wire_baud, instruction_error::CRC, |_, _| Vec::new());
            }
            return;
        }
        for &i in &listening {
            self.servos[i].note_instruction(at);
        }
        let all = request.id == BROADCAST;
        let addressed: Vec<usize> =
            listening.iter().copied().filter(|&i| all || self.servos[i].id() == request.id).collect();
        match request.code {
            instruction::PING if all => self.broadcast_ping(&listening, &addressed, at, wire_baud),
            instruction::PING => self.answer(addressed, at, wire_baud, 0, ping),
            instruction::READ if !all => match self.read_range(&request.parameters) {
                Some((address, length, _)) => self.read(addressed, at, wire_baud, address, length),
                None => self.answer(addressed, at, wire_baud, instruction_error::LENGTH, |_, _| Vec::new()),
            },
            instruction::WRITE => {
                let (address, data) = self.write_target(&request.parameters);
                let results: Vec<_> = addressed.iter().map(|&i| self.write(i, address, data)).collect();
                if !all {
                    let error = results.iter().copied().find(|&error| error != 0).unwrap_or(0);
                    let addressed = self.answering(addressed, instruction::WRITE);
                    self.answer_as(addressed, request.id, at, wire_baud, error);
                }
                self.advance_to(at);
            }
            instruction::REBOOT => {
                for &i in &addressed {
                    self.servos[i].power_up();
                }
                if !all {
                    self.answer(addressed, at, wire_baud, 0, |_, _| Vec::new());
                }
            }
            instruction::SYNC_READ if all => self.sync_read(&listening, at, wire_baud, &request.parameters),
            instruction::SYNC_WRITE if all => self.sync_write(&listening, at, &request.parameters),
            _ if !all => self.answer(addressed, at, wire_baud, instruction_error::INSTRUCTION, |_, _| Vec::new()),
            _ => {}
        }
    }

    /// Answers a broadcast ping: one slot per servo, in the order of ids; servos with the same id answer together.
    fn broadcast_ping(&mut self, listening: &[usize], addressed: &[usize], at: u64, baud: u32) {
        let mut slot = at;
        for (i, id) in self.by_id(addressed) {
            let same_id = self.with_id(listening, id);
            if same_id.first() == Some(&i) {
                self.answer(same_id, slot, baud, 0, ping);
            }
            slot += PING_SLOT;
        }
    }

    /// Those of `servos` whose response level lets them answer this instruction.
    fn answering(&self, mut servos: Vec<usize>, instruction: u8) -> Vec<usize> {
        let level = i32::from(instruction == instruction::WRITE) + i32::from(self.protocol == Protocol::Dynamixel);
        servos.retain(|&i| {
            let table = &self.servos[i].table;
            table.get(table.series.response_level) >= level
        });
        servos
    }

    fn read(&mut self, servos: Vec<usize>, at: u64, baud: u32, address: u16, length: u16) {
        let servos = self.answering(servos, instruction::READ);
        if servos.iter().any(|&i| self.servos[i].table.read(address, length).is_none()) {
            return self.answer(servos, at, baud, instruction_error::RANGE, |_, _| Vec::new());
        }
        self.answer(servos, at, baud, 0, move |servo, rng| {
            servo.measured(rng).read(address, length).map(<[u8]>::to_vec).unwrap_or_default()
        });
    }

    fn sync_read(&mut self, listening: &[usize], at: u64, baud: u32, parameters: &[u8]) {
        let Some((address, length, ids)) = self.read_range(parameters) else { return };
        let ids = ids.to_vec();
        let mut slot = at;
        for id in ids {
            let same_id = self.with_id(listening, id);
            let before = self.answers.len();
            self.read(same_id, slot, baud, address, length);
            // Each servo waits for the answer of the previous one, and does not answer without it.
            if self.answers.len() == before {
                return;
            }
            slot = self.answers.back().map_or(slot, |(due, _)| *due);
        }
    }

    fn sync_write(&mut self, listening: &[usize], at: u64, parameters: &[u8]) {
        let (address, length, rest) = match self.read_range(parameters) {
            Some(range) if range.1 > 0 => range,
            _ => return,
        };
        let rest = rest.to_vec();
        for entry in rest.chunks_exact(usize::from(length) + 1) {
            for i in self.with_id(listening, entry[0]) {
                self.write(i, address, &entry[1..]);
            }
        }
        self.advance_to(at);
    }

    fn write(&mut self, i: usize, address: u16, data: &[u8]) -> u8 {
        self.servos[i].write(address, data).err().unwrap_or(0)
    }

    /// Address, length and the remaining parameters.
    fn read_range<'a>(&self, parameters: &'a [u8]) -> Option<(u16, u16, &'a [u8])> {
        match (self.protocol, parameters) {
            (Protocol::Dynamixel, &[a, b, c, d, ref rest @ ..]) => {
                Some((u16::from_le_bytes([a, b]), u16::from_le_bytes([c, d]), rest))
            }
            (Protocol::Feetech, &[address, length, ref rest @ ..]) => {
                Some((u16::from(address), u16::from(length), rest))
            }
            _ => None,
        }
    }

    /// Address and data of a write.
    fn write_target<'a>(&self, parameters: &'a [u8]) -> (u16, &'a [u8]) {
        match (self.protocol, parameters) {
            (Protocol::Dynamixel, &[a, b, ref data @ ..]) => (u16::from_le_bytes([a, b]), data),
            (Protocol::Feetech, &[address, ref data @ ..]) => (u16::from(address), data),
            _ => (0, &[]),
        }
    }

    /// Those of the `listening` servos that have this id.
    fn with_id(&self, listening: &[usize], id: u8) -> Vec<usize> {
        listening.iter().copied().filter(|&i| self.servos[i].id() == id).collect()
    }

    /// `servos` with their ids, in the order of ids.
    fn by_id(&self, servos: &[usize]) -> Vec<(usize, u8)> {
        let mut all: Vec<_> = servos.iter().map(|&i| (i, self.servos[i].id())).collect();
        all.sort_by_key(|&(i, id)| (id, i));
        all
    }

    fn answer_as(&mut self, servos: Vec<usize>, id: u8, at: u64, baud: u32, error: u8) {
        // A write may have changed the id: the answer still has the addressed one.
        self.send(servos, Some(id), at, baud, error, |_, _| Vec::new());
    }

    fn answer(
        &mut self,
        servos: Vec<usize>,
        at: u64,
        baud: u32,
        error: u8,
        parameters: impl Fn(&mut EmulatedServo, &mut Rng) -> Vec<u8>,
    ) {
        self.send(servos, None, at, baud, error, parameters);
    }

    /// Sends an answer: of one servo, or of several with the same id at the same time.
    fn send(
        &mut self,
        servos: Vec<usize>,
        id: Option<u8>,
        at: u64,
        baud: u32,
        error: u8,
        parameters: impl Fn(&mut EmulatedServo, &mut Rng) -> Vec<u8>,
    ) {
        let mut wire: Option<(u64, Vec<u8>)> = None;
        let error = if self.protocol == Protocol::Dynamixel { error } else { 0 };
        for i in servos {
            let (settings, rng, servo) = (&self.settings, &mut self.rng, &mut self.servos[i]);
            let parameters = parameters(servo, rng);
            let id = id.unwrap_or_else(|| servo.id());
            self.answer_count += 1;
            let fault = self.faults.reply_fault(id, at, self.answer_count);
            let jitter = if settings.jitter_us > 0.0 { rng.random::<f64>() * settings.jitter_us } else { 0.0 };
            if fault.lost {
                continue;
            }
            let sent_id = if fault.wrong_id { id.wrapping_add(1) % BROADCAST } else { id };
            let mut bytes = packet::status(self.protocol, sent_id, error | servo.alert(), &parameters);
            if fault.bad_checksum
                && let Some(last) = bytes.last_mut()
            {
                *last ^= 0x55;
            }
            let delay = servo.table.get(servo.table.series.return_delay).max(0) as u64 * 2_000;
            let delay = delay + ((settings.latency_us + jitter) * 1e3) as u64 + fault.delay_ns;
            let due = at + delay + wire_ns(bytes.len(), baud);
            wire = Some(match wire {
                None => (due, bytes),
                Some((other_due, other)) => (due.max(other_due), collision(other, &bytes)),
            });
        }
        if let Some((due, bytes)) = wire {
            let due = self.answers.back().map_or(due, |(last, _)| due.max(*last));
            self.wire_free = self.wire_free.max(due);
            self.answers.push_back((due, bytes));
        }
    }
}

/// The parameters of an answer to a ping: model and firmware in protocol 2.0, none with Feetech.
fn ping(servo: &mut EmulatedServo, _: &mut Rng) -> Vec<u8> {
    match servo.table.series.protocol {
        Protocol::Dynamixel => {
            let number = servo.table.read(0, 2).unwrap_or_default();
            let firmware = servo.table.read(6, 1).unwrap_or_default();
            [number, firmware].concat()
        }
        Protocol::Feetech => Vec::new(),
    }
}

/// Two answers at the same time: the line is low where either servo pulls it down. Their clocks differ, so that
/// the checksum is always wrong.
fn collision(mut one: Vec<u8>, other: &[u8]) -> Vec<u8> {
    for (byte, pulled) in one.iter_mut().zip(other) {
        *byte &= pulled;
    }
    if let Some(last) = one.last_mut() {
        *last ^= 0x10;
    }
    one
}

/// Transmission time of `bytes` bytes at `baud`, ns: ten bits each.
fn wire_ns(bytes: usize, baud: u32) -> u64 {
    bytes as u64 * 10 * 1_000_000_000 / u64::from(baud.max(1))
}
