//! What is checked before anything is trusted: that the servos are those of the scenario, and that torque can
//! do no harm.

use std::path::Path;

use crate::scenario::{JointConfig, Plan, ServoGoal, check_joints};
use crate::servo::bus::{Bus, BusError, ServoReply};
use crate::servo::model::{Protocol, Register, RegisterBlock, STEP, UnknownModel};
use crate::servo::tools::Calibration;

/// Why the bridge does not start, or is not armed.
#[derive(Debug, thiserror::Error)]
pub enum BridgeError {
    /// The scenario's plant is another one.
    #[error("the scenario has no [plant.servos] with a [plant.arm]; add them, or start another plant")]
    NoServos,
    /// The port.
    #[error(transparent)]
    Bus(#[from] BusError),
    /// Nobody there.
    #[error("{0}; look at power, cable, baud rate and ids (`tectum-bridge scan`)")]
    Silent(String),
    /// Somebody else there.
    #[error(transparent)]
    Model(#[from] UnknownModel),
    /// The arm stands where it may not be.
    #[error(
        "servo {id} stands at {angle:.3} rad and its range is {low} to {high} rad; move the arm by hand, or correct zero, direction or range"
    )]
    Outside {
        /// The id.
        id: u8,
        /// rad.
        angle: f64,
        /// rad.
        low: f64,
        /// rad.
        high: f64,
    },
    /// A servo is in trouble already.
    #[error(
        "servo {id} reports an error (bits {bits:#04x}); find its cause, then take its power away and give it again"
    )]
    Trouble {
        /// The id.
        id: u8,
        /// Its errors.
        bits: i32,
    },
    /// A setting that was not taken.
    #[error("servo {id} does not keep {value} at address {address}; it is set to {found}")]
    Setting {
        /// The id.
        id: u8,
        /// What it should be.
        value: i32,
        /// Of the register.
        address: u8,
        /// What it is.
        found: i32,
    },
    /// The file of the joints.
    #[error("calibration {path}: {cause}; make one with `tectum-bridge calibrate`")]
    Calibration {
        /// The file.
        path: String,
        /// What is wrong.
        cause: String,
    },
}

/// The joints of a plan, from the scenario or from the file that it names.
///
/// # Errors
/// When there are none, or the file's do not fit the arm.
pub fn joints_of(plan: &Plan) -> Result<Vec<JointConfig>, BridgeError> {
    let plant = &plan.scenario.plant;
    let (Some(servos), Some(arm)) = (&plant.servos, &plant.arm) else { return Err(BridgeError::NoServos) };
    let Some(path) = &servos.calibration else { return Ok(servos.joints.clone()) };
    let bad = |cause: String| BridgeError::Calibration { path: path.clone(), cause };
    let text = std::fs::read_to_string(Path::new(path)).map_err(|error| bad(error.to_string()))?;
    let calibration: Calibration = toml::from_str(&text).map_err(|error| bad(error.message().to_owned()))?;
    if calibration.protocol != servos.protocol {
        let (theirs, ours) = (calibration.protocol.name(), servos.protocol.name());
        return Err(bad(format!(
            "it is for servos that speak {theirs} and plant.servos.protocol is {ours}: it is another arm's"
        )));
    }
    check_joints(&calibration.joints, arm.lengths.len(), servos.protocol, servos.goal).map_err(bad)?;
    Ok(calibration.joints)
}

/// Whether all servos are there and what they should be. Changes nothing.
pub(super) fn identify(bus: &mut Bus, joints: &[JointConfig]) -> Result<(), BridgeError> {
    let series = bus.series();
    for joint in joints {
        let (number, known) = bus.model(joint.id).map_err(|error| BridgeError::Silent(error.to_string()))?;
        if known.is_none() {
            return Err(UnknownModel { id: joint.id, number, series: series.name }.into());
        }
    }
    Ok(())
}

/// All that must be right before torque: models, errors, posture; then modes and limits, with torque off.
pub(super) fn prepare(
    bus: &mut Bus,
    joints: &[JointConfig],
    goal: ServoGoal,
    motors: &[f64],
) -> Result<(), BridgeError> {
    identify(bus, joints)?;
    let series = bus.series();
    for (joint, &angle) in joints.iter().zip(motors) {
        let [low, high] = joint.range;
        // A step to either side is the reading's.
        if !joint.is_free() && !(low - STEP..=high + STEP).contains(&angle) {
            return Err(BridgeError::Outside { id: joint.id, angle, low, high });
        }
        let bits = bus.read(joint.id, series.hardware_error)?;
        if bits != 0 {
            return Err(BridgeError::Trouble { id: joint.id, bits });
        }
    }
    for joint in joints {
        bus.write(joint.id, series.torque_enable, 0)?;
        let mode = if goal == ServoGoal::Speed { series.velocity_mode } else { series.position_mode };
        set(bus, joint.id, series.operating_mode, i32::from(mode))?;
        let speed = libm::ceil(joint.max_speed / series.speed_unit) as i32;
        if let Some(register) = series.velocity_limit {
            set(bus, joint.id, register, speed.min(1023))?;
        }
        if goal == ServoGoal::Position {
            set(bus, joint.id, series.profile_velocity, speed)?;
        }
        if series.protocol == Protocol::Feetech {
            // As fast as it goes: what limits acceleration is the gate.
            set(bus, joint.id, series.profile_acceleration, 0)?;
        }
    }
    limit(bus, joints)
}

/// The positions between which the servos are to stay, steps. With speed goals neither series heeds them, and
/// the bridge alone keeps the range; they are written all the same, so that whoever moves a servo to a position
/// afterwards stays within it.
fn limit(bus: &mut Bus, joints: &[JointConfig]) -> Result<(), BridgeError> {
    let series = bus.series();
    let ids: Vec<_> = joints.iter().map(|joint| joint.id).collect();
    let registers = [series.min_position, series.max_position];
    // Neighbours in both series, in one order or the other: one instruction reads both of all servos.
    let block = RegisterBlock {
        address: registers[0].address.min(registers[1].address),
        length: registers[0].width + registers[1].width,
    };
    let ends = |joint: &JointConfig| {
        if joint.is_free() {
            return [0, 4095];
        }
        let [a, b] = joint.range.map(|end| joint.zero + (f64::from(joint.direction) * end / STEP) as i32);
        [a.min(b).clamp(0, 4095), a.max(b).clamp(0, 4095)]
    };
    let wanted: Vec<_> = joints
        .iter()
        .map(|joint| {
            let mut bytes = vec![0; usize::from(block.length)];
            for (register, end) in registers.into_iter().zip(ends(joint)) {
                block.encode(register, end, &mut bytes);
            }
            bytes
        })
        .collect();
    // One instruction for all servos, as arming has no more time than a tick; and none where nothing differs,
    // as EEPROM wears out.
    let other =
        |answers: &[ServoReply]| answers.iter().zip(&wanted).position(|(answer, wanted)| answer.bytes != *wanted);
    if other(&bus.sync_read(&ids, block).0?).is_none() {
        return Ok(());
    }
    bus.sync_write(&ids, block.address, &wanted).0?;
    let answers = bus.sync_read(&ids, block).0?;
    let Some(i) = other(&answers) else { return Ok(()) };
    let found = block.decode(registers[0], &answers[i].bytes).unwrap_or(0);
    Err(BridgeError::Setting { id: ids[i], value: ends(&joints[i])[0], address: registers[0].address, found })
}

/// Sets a register that has another value, and looks whether it was taken: EEPROM wears out.
fn set(bus: &mut Bus, id: u8, register: Register, value: i32) -> Result<(), BridgeError> {
    if bus.read(id, register)? == value {
        return Ok(());
    }
    bus.write(id, register, value)?;
    let found = bus.read(id, register)?;
    if found == value { Ok(()) } else { Err(BridgeError::Setting { id, value, address: register.address, found }) }
}
