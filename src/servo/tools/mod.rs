//! Tools for an arm that is not part of a run: find its servos, calibrate it by hand, move one joint, show its
//! state.
//!
//! Only [`jog()`] turns torque on, and it always turns it off again. Ports and clocks are arguments, so that the
//! same code runs on hardware, on the emulated chain and in tests.

mod calibrate;
mod jog;
mod lerobot;
mod teleop;

use std::io::{self, Write};

use serde::Serialize;

pub use calibrate::{Calibration, calibrate, import};
pub use jog::{Jog, JogContext, jog};
pub use lerobot::write_lerobot;
pub use teleop::{Teleop, TeleopArm, pair_joints, teleop_scenario};

use super::bridge::BridgeError;
use super::bus::{AnswerFault, Bus, BusBudget, BusError};
use super::model::{STEP, UnknownModel};

/// Bus budget of the tools, ns: slow adapters delay an answer by 16 ms.
pub const BUDGET: BusBudget = BusBudget { read_ns: 50_000_000, write_ns: 20_000_000 };

/// Bus budget of [`scan`], where most ids do not answer and each of them takes the whole budget; for an adapter that
/// holds an answer for `latency_ms`.
pub fn search_budget(latency_ms: u32) -> BusBudget {
    BusBudget { read_ns: 12_000_000 + 2_000_000 * u64::from(latency_ms), write_ns: 20_000_000 }
}

/// Reasons why a tool stops.
#[derive(Debug, thiserror::Error)]
pub enum ToolError {
    /// An error of the port, or an instruction without an answer.
    #[error(transparent)]
    Bus(#[from] BusError),
    /// No servo answers.
    #[error(
        "no servo answers{0}; look at power and cable, and try other protocols and baud rates (`tectum-bridge scan`)"
    )]
    NoServo(String),
    /// Answers that cannot be decoded.
    #[error(
        "something answers as servo {0} and cannot be read: most likely two servos have this id; \
         connect them one at a time and give them different ids"
    )]
    DuplicateId(u8),
    /// A servo is of an unknown model.
    #[error(transparent)]
    Model(#[from] UnknownModel),
    /// A register has another value than it should.
    #[error(transparent)]
    Register(#[from] BridgeError),
    /// The request cannot be fulfilled.
    #[error("{0}")]
    Refused(String),
    /// A servo did not do what it was told.
    #[error("{0}")]
    Failed(String),
    /// An error of standard input, standard output or a file.
    #[error("{0}: {1}")]
    Io(String, io::Error),
}

impl ToolError {
    /// Whether the cause is what the user has asked for or set up, rather than a cable, a servo or another program.
    pub fn is_bad_input(&self) -> bool {
        match self {
            Self::Bus(error) => error.is_configuration(),
            Self::Register(error) => error.is_configuration(),
            Self::NoServo(_) | Self::Failed(_) => false,
            Self::DuplicateId(_) | Self::Model(_) | Self::Refused(_) | Self::Io(..) => true,
        }
    }
}

/// A servo that answered.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct FoundServo {
    /// Its id.
    pub id: u8,
    /// The model number; `None` if it cannot be read.
    pub number: Option<i32>,
    /// The model, if it is known.
    pub model: Option<&'static str>,
    /// Whether the answer cannot be decoded, as when two servos have this id.
    pub garbled: bool,
    /// Whether it answers pings alone: its response level is too low.
    pub mute: bool,
}

/// The state of a servo.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ServoReading {
    /// Its id.
    pub id: u8,
    /// Position, steps.
    pub position: i32,
    /// Speed, rad/s.
    pub speed: f64,
    /// Load, as a fraction of the greatest load.
    pub load: f64,
    /// Voltage, V.
    pub voltage: f64,
    /// Temperature, degrees Celsius.
    pub temperature: i32,
    /// Whether torque is on.
    pub torque: bool,
    /// Error bits.
    pub errors: i32,
}

/// Asks each of `ids` for its model. Returns the servos that answered, and whether an answer came so late that another
/// servo was being asked.
pub fn scan(bus: &mut Bus, ids: impl Iterator<Item = u8>, mut stop: impl FnMut() -> bool) -> (Vec<FoundServo>, bool) {
    let silent = |id, garbled| FoundServo { id, number: None, model: None, garbled, mute: !garbled };
    let (mut found, mut late) = (Vec::new(), false);
    for id in ids {
        if stop() {
            break;
        }
        match bus.model(id) {
            Ok((number, known)) => {
                let name = known.map(|model| model.name);
                found.push(FoundServo { id, number: Some(number), model: name, garbled: false, mute: false });
            }
            Err(BusError::Mute { .. }) => found.push(silent(id, false)),
            Err(BusError::NoAnswer { fault: AnswerFault::WrongId(_), .. }) => late = true,
            Err(error) if is_garbled(&error) => found.push(silent(id, true)),
            Err(_) => {}
        }
    }
    (found, late)
}

/// Whether an error means that something answered, but not with a valid packet.
fn is_garbled(error: &BusError) -> bool {
    matches!(error, BusError::NoAnswer { fault, .. } if fault.is_garbled())
}

/// Checks that all `ids` answer, are given once, and are known models of the bus's series.
///
/// # Errors
/// When an id fails a check; all ids without a servo are named.
pub fn identify(bus: &mut Bus, ids: &[u8]) -> Result<(), ToolError> {
    let series = bus.series();
    let (mut answering, mut missing) = (Vec::new(), Vec::new());
    for (i, &id) in ids.iter().enumerate() {
        if ids[..i].contains(&id) {
            return Err(ToolError::Refused(format!("id {id} is given twice; every servo has an id of its own")));
        }
        let (number, known) = match bus.model(id) {
            Ok(answer) => answer,
            Err(error) if is_garbled(&error) => return Err(ToolError::DuplicateId(id)),
            Err(BusError::NoAnswer { .. }) => {
                missing.push(id.to_string());
                continue;
            }
            Err(error) => return Err(error.into()),
        };
        answering.push(id.to_string());
        if known.is_none() {
            return Err(UnknownModel { id, number, protocol: series.protocol }.into());
        }
    }
    match (missing.is_empty(), answering.is_empty()) {
        (true, _) => Ok(()),
        (false, true) => Err(ToolError::NoServo(format!(" at id {}", missing.join(", ")))),
        (false, false) => {
            let text = format!(" at id {}, and one does at {}", missing.join(", "), answering.join(", "));
            Err(ToolError::NoServo(text))
        }
    }
}

/// Asks again a few times while a servo is silent.
fn again<T>(mut ask: impl FnMut() -> Result<T, BusError>) -> Result<T, BusError> {
    for _ in 0..4 {
        match ask() {
            Err(BusError::NoAnswer { .. }) => {}
            answer => return answer,
        }
    }
    ask()
}

/// Reads the state of the servo with this id.
///
/// # Errors
/// When it does not answer.
pub fn read_state(bus: &mut Bus, id: u8) -> Result<ServoReading, ToolError> {
    let series = bus.series();
    let voltage = bus.read(id, series.voltage)?;
    let load = bus.read(id, series.load)?;
    let speed = bus.read(id, series.velocity)?;
    Ok(ServoReading {
        id,
        position: bus.read(id, series.position)?,
        speed: f64::from(speed) * series.speed_unit,
        load: f64::from(load) / 1000.0,
        voltage: f64::from(voltage) / 10.0,
        temperature: bus.read(id, series.temperature)?,
        torque: bus.read(id, series.torque_enable)? == 1,
        errors: bus.read(id, series.hardware_error)?,
    })
}

impl ServoReading {
    /// The state as one line of text.
    pub fn line(&self) -> String {
        let Self { id, position, speed, load, voltage, temperature, errors, .. } = self;
        let torque = if self.torque { "on" } else { "off" };
        format!(
            "servo {id:3}  position {position:5}  speed {speed:6.2} rad/s  load {:4.0} %  \
             {voltage:4.1} V  {temperature:3} C  torque {torque:3}  errors {errors:#04x}",
            load * 100.0
        )
    }
}

/// Turns torque off and checks that it is off.
///
/// # Errors
/// When a servo does not answer, or keeps its torque.
pub fn torque_off(bus: &mut Bus, ids: &[u8]) -> Result<(), ToolError> {
    bus.torque_off(ids);
    for &id in ids {
        if bus.read(id, bus.series().torque_enable)? == 1 {
            let text = format!("servo {id} keeps its torque; take the power away");
            return Err(ToolError::Failed(text));
        }
    }
    Ok(())
}

/// The signed distance from `zero` to `at`, steps, by the shorter way around the turn.
fn shorter_way(zero: i32, at: i32) -> i32 {
    (at - zero + 2048).rem_euclid(4096) - 2048
}

/// Converts steps to rad.
fn rad(steps: i32) -> f64 {
    f64::from(steps) * STEP
}

/// Prints a line at once.
fn print_line(out: &mut dyn Write, text: &str) -> Result<(), ToolError> {
    writeln!(out, "{text}").and_then(|()| out.flush()).map_err(|error| ToolError::Io("standard output".into(), error))
}
