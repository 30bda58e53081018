//! What people do with an arm before it is a plant: find its servos, calibrate it by hand, move one joint, look.
//!
//! Nothing here turns torque on but `jog`, which turns it off again however it ends. Ports and clocks are handed in, so that the same
//! code runs on hardware, on the emulated chain and in a test.

mod calibrate;
mod jog;

use std::io::{self, Write};

use serde::Serialize;

pub use calibrate::{Calibration, calibrate};
pub use jog::{Jog, jog};

use super::bus::{Bus, BusBudget, BusError};
use super::model::{STEP, UnknownModel};

/// What an instruction of a tool may cost, ns: slow adapters hold an answer for 16 ms.
pub const BUDGET: BusBudget = BusBudget { read_ns: 50_000_000, write_ns: 20_000_000 };

/// The same where most ids are nobody's, and each costs its whole budget.
pub const SEARCH: BusBudget = BusBudget { read_ns: 12_000_000, write_ns: 20_000_000 };

/// Why a tool stops.
#[derive(Debug, thiserror::Error)]
pub enum ToolError {
    /// The port, or an instruction without an answer.
    #[error(transparent)]
    Bus(#[from] BusError),
    /// Nobody there.
    #[error(
        "no servo answers{0}; look at power and cable, and try other protocols and baud rates (`tectum-bridge scan`)"
    )]
    Nobody(String),
    /// Answers that cannot be read.
    #[error(
        "something answers as servo {0} and cannot be read: most likely two servos have this id; connect them one at a time and give them different ids"
    )]
    Twins(u8),
    /// Somebody else there.
    #[error(transparent)]
    Model(#[from] UnknownModel),
    /// What was asked for cannot be done.
    #[error("{0}")]
    Refused(String),
    /// Standard input or output, or a file.
    #[error("{0}: {1}")]
    Io(String, io::Error),
}

/// A servo that answered.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct FoundServo {
    /// Its id.
    pub id: u8,
    /// What its model register says; nothing if it cannot be read.
    pub number: Option<i32>,
    /// The model, if it is one of the series.
    pub model: Option<&'static str>,
    /// Whether what answers cannot be read, as when two servos have this id.
    pub garbled: bool,
}

/// How a servo is.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ServoReading {
    /// Its id.
    pub id: u8,
    /// Position, steps.
    pub position: i32,
    /// Speed, rad/s.
    pub speed: f64,
    /// Load, as a share of the most there is.
    pub load: f64,
    /// Voltage, V.
    pub voltage: f64,
    /// Temperature, degrees Celsius.
    pub temperature: i32,
    /// Whether torque is on.
    pub torque: bool,
    /// Errors, as bits.
    pub errors: i32,
}

/// Asks each of `ids` on a bus for its model; who answers.
pub fn scan(bus: &mut Bus, ids: impl Iterator<Item = u8>, mut stop: impl FnMut() -> bool) -> Vec<FoundServo> {
    let mut found = Vec::new();
    for id in ids {
        if stop() {
            break;
        }
        match bus.model(id) {
            Ok((number, known)) => {
                let name = known.map(|model| model.name);
                found.push(FoundServo { id, number: Some(number), model: name, garbled: false });
            }
            Err(error) if is_garbled(&error) => found.push(FoundServo { id, number: None, model: None, garbled: true }),
            Err(_) => {}
        }
    }
    found
}

/// Whether something came that was no answer.
fn is_garbled(error: &BusError) -> bool {
    let text = error.to_string();
    text.contains("Checksum") || text.contains("Parsing") || text.contains("Incorrect id")
}

/// Whether `ids` are all there, once each, and of the bus's series.
///
/// # Errors
/// In the order of the ids, the first that is not.
pub fn identify(bus: &mut Bus, ids: &[u8]) -> Result<(), ToolError> {
    let series = bus.series();
    for (i, &id) in ids.iter().enumerate() {
        if ids[..i].contains(&id) {
            return Err(ToolError::Refused(format!("id {id} is given twice; every servo has an id of its own")));
        }
        let (number, known) = match bus.model(id) {
            Ok(answer) => answer,
            Err(error) if is_garbled(&error) => return Err(ToolError::Twins(id)),
            Err(_) => return Err(ToolError::Nobody(format!(" at id {id}"))),
        };
        if known.is_none() {
            return Err(UnknownModel { id, number, series: series.name }.into());
        }
    }
    Ok(())
}

/// How the servo with this id is.
///
/// # Errors
/// When it does not answer.
pub fn look(bus: &mut Bus, id: u8) -> Result<ServoReading, ToolError> {
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
    /// One line for people.
    pub fn line(&self) -> String {
        let Self { id, position, speed, load, voltage, temperature, errors, .. } = self;
        let torque = if self.torque { "on" } else { "off" };
        format!(
            "servo {id:3}  position {position:5}  speed {speed:6.2} rad/s  load {:4.0} %  {voltage:4.1} V  {temperature:3} C  \
             torque {torque:3}  errors {errors:#04x}",
            load * 100.0
        )
    }
}

/// Turns torque off and looks whether it is.
///
/// # Errors
/// When a servo cannot be heard, or keeps its torque.
pub fn torque_off(bus: &mut Bus, ids: &[u8]) -> Result<(), ToolError> {
    bus.torque_off(ids);
    for &id in ids {
        if bus.read(id, bus.series().torque_enable)? == 1 {
            let text = format!("servo {id} keeps its torque; take the power away");
            return Err(ToolError::Refused(text));
        }
    }
    Ok(())
}

/// The way from `zero` to `at` in steps, the shorter one around the turn.
fn way(zero: i32, at: i32) -> i32 {
    (at - zero + 2048).rem_euclid(4096) - 2048
}

/// Steps as rad.
fn rad(steps: i32) -> f64 {
    f64::from(steps) * STEP
}

fn tell(out: &mut dyn Write, text: &str) -> Result<(), ToolError> {
    writeln!(out, "{text}").and_then(|()| out.flush()).map_err(|error| ToolError::Io("standard output".into(), error))
}
