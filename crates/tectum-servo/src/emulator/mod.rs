//! An emulated chain of serial-bus servos: bytes in at an instant, bytes out at an instant.
//!
//! Pure: no clock, no files, no threads. What comes out is a function of seed, settings, and the bytes with
//! their instants. [`EmulatedPort`] puts it behind `serialport`'s trait with a stepped clock;
//! `tectum-servo-emulator` puts it behind a terminal in real time.
//!
//! *As the real ones*: packets, checksums, stuffing, error bytes; control tables with what is EEPROM and what
//! refuses writes; the time that bytes take on the wire, the return delay; answers to a synchronous read one
//! after the other, where those behind one that is missing stay silent; two servos with one id that talk at
//! once; a wrong baud rate, at which nobody answers; speed and acceleration from registers; Dynamixel's bus
//! watchdog and its errors that hold until a reboot; a start without torque after a loss of power.
//!
//! *Where the makers are not clear the worse is taken*: goals are kept while torque is off, so that turning it
//! on moves the shaft to an old goal; with Feetech a goal position turns torque on by itself.
//!
//! *Not emulated*: mass, gravity and friction (without torque a shaft stays where it is); the controllers'
//! gains; current and PWM modes; homing offsets, drive mode, indirect addresses; register writes that wait for
//! an action; bulk and fast reads; Feetech's step mode, its middle position by writing 128 to torque, and the
//! residual torque after an overload (it is turned off whole).

pub mod codec;
mod config;
mod faults;
mod motion;
mod port;
mod servo;
mod table;

use std::collections::VecDeque;

use rand::RngExt as _;

pub use config::{EmulatorConfig, ServoFault, ServoFaultKind};
pub use port::{EmulatedPort, SteppedClock};

use crate::model::{MODELS, Protocol, ServoModel};
use codec::{BROADCAST, Request, RequestParser, instruction};
use faults::ChainFaults;
use servo::{EmulatedServo, ServoFaultState};
use table::refusal;
use tectum_core::seed::{self, Rng};

/// After so long a silence a packet that has only begun is forgotten, ns.
const SILENCE: u64 = 20_000_000;

/// Between the answers to a broadcast ping, ns.
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
    /// Until when the chain has lived, ns.
    now: u64,
    /// When the last byte came in, and when the last one has left the wire, ns.
    received: u64,
    wire_free: u64,
    /// Answers, each with the instant at which its last byte is out.
    answers: VecDeque<(u64, Vec<u8>)>,
    count: u64,
}

/// How a servo is, for whoever looks at the emulator and not at the bus.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub struct ServoState {
    /// Its id.
    pub id: u8,
    /// Where its shaft is, steps.
    pub position: f64,
    /// How fast it turns, steps/s.
    pub speed: f64,
    /// Whether the motor holds or moves it.
    pub torque: bool,
    /// Its errors' bits.
    pub errors: u8,
}

impl EmulatedChain {
    /// Servos with these ids, in the order in which they hang on the wire, all in their middle position; ids
    /// that stand twice make two servos that talk at once. They listen at `baud`.
    pub fn new(protocol: Protocol, ids: &[u8], baud: u32, settings: &EmulatorConfig, seed: u64) -> Self {
        let named = settings.model.as_ref().and_then(|name| MODELS.iter().find(|model| model.name == name));
        let usual = MODELS.iter().find(|model| model.protocol == protocol);
        let model: &ServoModel =
            named.filter(|model| model.protocol == protocol).or(usual).expect("a model of each protocol");
        Self::of(model, ids, baud, settings, seed)
    }

    /// The same of any model, with the control table of its protocol's series.
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
            count: 0,
        }
    }

    /// Takes what a host sends at `now` with `baud` (0: whatever the servos listen at). Instants never go back;
    /// the emulator starts at 0.
    pub fn receive(&mut self, now: u64, baud: u32, bytes: &[u8]) {
        if now.saturating_sub(self.received) > SILENCE {
            self.parser.clear();
        }
        self.received = now;
        let baud_in_use =
            if baud == 0 { self.servos.first().map_or(1_000_000, |servo| servo.table.baud()) } else { baud };
        self.wire_free = self.wire_free.max(now) + wire_ns(bytes.len(), baud_in_use);
        self.parser.push(bytes);
        while let Some(request) = self.parser.next_request() {
            let at = self.wire_free.max(self.now);
            self.live(at);
            self.obey(&request, at, baud, baud_in_use);
        }
    }

    /// The instant at which the next answer is out, if one is under way.
    pub fn next_answer(&self) -> Option<u64> {
        self.answers.front().map(|(due, _)| *due)
    }

    /// The bytes of the next answer that is out by `now`.
    pub fn take(&mut self, now: u64) -> Option<Vec<u8>> {
        let due = self.next_answer()?;
        if due <= now { self.answers.pop_front().map(|(_, bytes)| bytes) } else { None }
    }

    /// Lets time pass until `now` without an instruction.
    pub fn live(&mut self, now: u64) {
        while self.now < now {
            let until = self.faults.next_edge(self.now).min(now);
            self.advance_servos(until);
            self.now = until;
        }
        self.advance_servos(self.now);
    }

    /// Moves the shaft of the servo with this id to `at` steps as a hand does; a servo with torque is stronger.
    /// Whether there is such a servo.
    pub fn hand(&mut self, now: u64, id: u8, at: f64) -> bool {
        self.live(now.max(self.now));
        let mut found = false;
        for servo in self.servos.iter_mut().filter(|servo| servo.id() == id) {
            servo.hand(at);
            found = true;
        }
        found
    }

    /// How all servos are at `now`, in the order of the wire.
    pub fn state(&mut self, now: u64) -> Vec<ServoState> {
        self.live(now.max(self.now));
        let state = |servo: &EmulatedServo| ServoState {
            id: servo.id(),
            position: servo.shaft.at,
            speed: servo.shaft.speed,
            torque: servo.driven(),
            errors: servo.table.get(servo.table.series.hardware_error) as u8,
        };
        self.servos.iter().map(state).collect()
    }

    fn advance_servos(&mut self, until: u64) {
        // What befalls a servo up to `until` is what began at the edge before.
        let mut off = false;
        for servo in &mut self.servos {
            let (id, now, faults) = (servo.id(), self.now, &self.faults);
            off |= faults.holds(ServoFaultKind::CableOut, id, now);
            let plight = ServoFaultState {
                off,
                held: faults.holds(ServoFaultKind::Overload, id, now),
                low: faults.holds(ServoFaultKind::BrownOut, id, now),
                hot: faults.holds(ServoFaultKind::Hot, id, now),
            };
            servo.advance(until, plight);
        }
    }

    fn obey(&mut self, request: &Request, at: u64, baud: u32, wire_baud: u32) {
        let tuned = |servo: &EmulatedServo| servo.hears() && (baud == 0 || servo.table.baud() == baud);
        let listening: Vec<usize> = (0..self.servos.len()).filter(|&i| tuned(&self.servos[i])).collect();
        if !request.sound {
            // Nobody knows whom a broken packet was for. Dynamixel says so if the id is its own.
            if self.protocol == Protocol::Dynamixel {
                let own = listening.iter().copied().filter(|&i| self.servos[i].id() == request.id).collect();
                self.answer(own, at, wire_baud, refusal::CRC, |_, _| Vec::new());
            }
            return;
        }
        for &i in &listening {
            self.servos[i].hear(at);
        }
        let all = request.id == BROADCAST;
        let addressed: Vec<usize> =
            listening.iter().copied().filter(|&i| all || self.servos[i].id() == request.id).collect();
        match request.instruction {
            instruction::PING if all => {
                let mut slot = at;
                for (i, id) in self.by_id(&addressed) {
                    let twins = self.twins(&listening, id);
                    if twins.first() == Some(&i) {
                        self.answer(twins, slot, wire_baud, 0, ping);
                    }
                    slot += PING_SLOT;
                }
            }
            instruction::PING => self.answer(addressed, at, wire_baud, 0, ping),
            instruction::READ if !all => match self.span(&request.parameters) {
                Some((address, length, _)) => self.read(addressed, at, wire_baud, address, length),
                None => self.answer(addressed, at, wire_baud, refusal::LENGTH, |_, _| Vec::new()),
            },
            instruction::WRITE => {
                let (address, data) = self.target(&request.parameters);
                let results: Vec<_> = addressed.iter().map(|&i| self.write(i, address, data)).collect();
                if !all {
                    let error = results.iter().copied().find(|&error| error != 0).unwrap_or(0);
                    self.answer_as(addressed, request.id, at, wire_baud, error);
                }
                self.live(at);
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
            _ if !all => self.answer(addressed, at, wire_baud, refusal::INSTRUCTION, |_, _| Vec::new()),
            _ => {}
        }
    }

    fn read(&mut self, servos: Vec<usize>, at: u64, baud: u32, address: u16, length: u16) {
        if servos.iter().any(|&i| self.servos[i].table.read(address, length).is_none()) {
            return self.answer(servos, at, baud, refusal::RANGE, |_, _| Vec::new());
        }
        self.answer(servos, at, baud, 0, move |servo, rng| {
            servo.measured(rng).read(address, length).map(<[u8]>::to_vec).unwrap_or_default()
        });
    }

    fn sync_read(&mut self, listening: &[usize], at: u64, baud: u32, parameters: &[u8]) {
        let Some((address, length, ids)) = self.span(parameters) else { return };
        let ids = ids.to_vec();
        let mut slot = at;
        for id in ids {
            let twins = self.twins(listening, id);
            let before = self.answers.len();
            self.read(twins, slot, baud, address, length);
            // The next one waits for the answer before its own; without it, it stays silent.
            if self.answers.len() == before {
                return;
            }
            slot = self.answers.back().map_or(slot, |(due, _)| *due);
        }
    }

    fn sync_write(&mut self, listening: &[usize], at: u64, parameters: &[u8]) {
        let (address, length, rest) = match self.span(parameters) {
            Some(span) if span.1 > 0 => span,
            _ => return,
        };
        let rest = rest.to_vec();
        for entry in rest.chunks_exact(usize::from(length) + 1) {
            for i in self.twins(listening, entry[0]) {
                self.write(i, address, &entry[1..]);
            }
        }
        self.live(at);
    }

    fn write(&mut self, i: usize, address: u16, data: &[u8]) -> u8 {
        self.servos[i].write(address, data).err().unwrap_or(0)
    }

    /// Address, length and what follows.
    fn span<'a>(&self, parameters: &'a [u8]) -> Option<(u16, u16, &'a [u8])> {
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
    fn target<'a>(&self, parameters: &'a [u8]) -> (u16, &'a [u8]) {
        match (self.protocol, parameters) {
            (Protocol::Dynamixel, &[a, b, ref data @ ..]) => (u16::from_le_bytes([a, b]), data),
            (Protocol::Feetech, &[address, ref data @ ..]) => (u16::from(address), data),
            _ => (0, &[]),
        }
    }

    fn twins(&self, listening: &[usize], id: u8) -> Vec<usize> {
        listening.iter().copied().filter(|&i| self.servos[i].id() == id).collect()
    }

    fn by_id(&self, servos: &[usize]) -> Vec<(usize, u8)> {
        let mut all: Vec<_> = servos.iter().map(|&i| (i, self.servos[i].id())).collect();
        all.sort_by_key(|&(i, id)| (id, i));
        all
    }

    fn answer_as(&mut self, servos: Vec<usize>, id: u8, at: u64, baud: u32, error: u8) {
        // A write may just have changed the id: the answer still has the one that was asked.
        self.put(servos, Some(id), at, baud, error, |_, _| Vec::new());
    }

    fn answer(
        &mut self,
        servos: Vec<usize>,
        at: u64,
        baud: u32,
        error: u8,
        say: impl Fn(&mut EmulatedServo, &mut Rng) -> Vec<u8>,
    ) {
        self.put(servos, None, at, baud, error, say);
    }

    /// Puts an answer on the wire: of one servo, or of several with one id that talk at once.
    fn put(
        &mut self,
        servos: Vec<usize>,
        id: Option<u8>,
        at: u64,
        baud: u32,
        error: u8,
        say: impl Fn(&mut EmulatedServo, &mut Rng) -> Vec<u8>,
    ) {
        let mut wire: Option<(u64, Vec<u8>)> = None;
        let error = if self.protocol == Protocol::Dynamixel { error } else { 0 };
        for i in servos {
            let (settings, rng, servo) = (&self.settings, &mut self.rng, &mut self.servos[i]);
            let parameters = say(servo, rng);
            let id = id.unwrap_or_else(|| servo.id());
            self.count += 1;
            let mishap = self.faults.mishap(id, at, self.count);
            let jitter = if settings.jitter_us > 0.0 { rng.random::<f64>() * settings.jitter_us } else { 0.0 };
            if mishap.lost {
                continue;
            }
            let said = if mishap.stranger { id.wrapping_add(1) % BROADCAST } else { id };
            let mut bytes = codec::status(self.protocol, said, error | servo.alert(), &parameters);
            if mishap.broken
                && let Some(last) = bytes.last_mut()
            {
                *last ^= 0x55;
            }
            let delay = servo.table.get(servo.table.series.return_delay).max(0) as u64 * 2_000;
            let delay = delay + ((settings.latency_us + jitter) * 1e3) as u64 + mishap.late;
            let due = at + delay + wire_ns(bytes.len(), baud);
            wire = Some(match wire {
                None => (due, bytes),
                Some((other, said)) => (due.max(other), collision(said, &bytes)),
            });
        }
        if let Some((due, bytes)) = wire {
            let due = self.answers.back().map_or(due, |(last, _)| due.max(*last));
            self.wire_free = self.wire_free.max(due);
            self.answers.push_back((due, bytes));
        }
    }
}

/// What a ping is answered with: model and firmware in protocol 2.0, nothing with Feetech.
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

/// Two that talk at once: the line is low where either pulls it down, and since their clocks are not one the
/// last bytes never fit.
fn collision(mut one: Vec<u8>, other: &[u8]) -> Vec<u8> {
    for (byte, pulled) in one.iter_mut().zip(other) {
        *byte &= pulled;
    }
    if let Some(last) = one.last_mut() {
        *last ^= 0x10;
    }
    one
}

/// How long `bytes` bytes take on the wire at `baud`, ns: ten bits each.
fn wire_ns(bytes: usize, baud: u32) -> u64 {
    bytes as u64 * 10 * 1_000_000_000 / u64::from(baud.max(1))
}
