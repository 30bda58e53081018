//! Checks before torque is turned on: that the servos are those of the scenario, and that torque is safe.

use crate::scenario::{JointConfig, Plan, ServoGoal, check_joints};
use crate::servo::bus::{Bus, BusError, ServoReply};
use crate::servo::model::{KeptSetting, Protocol, Register, RegisterBlock, STEP, STEPS_PER_TURN, UnknownModel};
use crate::servo::tools::Calibration;

/// Reasons why the bridge does not start or cannot be armed.
#[derive(Debug, thiserror::Error)]
pub enum BridgeError {
    /// The scenario has no servos.
    #[error(
        "the scenario has no [plant.servos] with the model of an arm or a leader; add them, or start another plant"
    )]
    NoServos,
    /// An error of the bus.
    #[error(transparent)]
    Bus(#[from] BusError),
    /// A servo does not answer.
    #[error("{0}; look at power, cable, baud rate and ids (`tectum-bridge scan`)")]
    NoAnswer(String),
    /// A servo is of an unknown model.
    #[error(transparent)]
    Model(#[from] UnknownModel),
    /// A joint is outside its range.
    #[error(
        "servo {id} stands at {angle:.3} rad and its range is {low} to {high} rad; \
         move the arm by hand, or correct zero, direction or range"
    )]
    OutOfRange {
        /// The id.
        id: u8,
        /// Its angle, rad.
        angle: f64,
        /// Lower end of its range, rad.
        low: f64,
        /// Upper end of its range, rad.
        high: f64,
    },
    /// A servo already reports an error.
    #[error(
        "servo {id} reports an error (bits {bits:#04x}); find its cause, then take its power away and give it again"
    )]
    HardwareError {
        /// The id.
        id: u8,
        /// Its error bits.
        bits: i32,
    },
    /// A servo does not keep a setting.
    #[error("servo {id} does not keep {value} at address {address}; it is set to {found}")]
    Setting {
        /// The id.
        id: u8,
        /// The written value.
        value: i32,
        /// Address of the register.
        address: u8,
        /// The value that was read back.
        found: i32,
    },
    /// A register that changes the meaning of positions, or how goals are followed, has another value than at the
    /// calibration.
    #[error(
        "servo {id}: {name} (address {address}) is {found} and should be {expected}, {source_of}: another program has \
         changed it; calibrate the arm again (`tectum-bridge calibrate`), or write {expected} there"
    )]
    Register {
        /// The id.
        id: u8,
        /// Name of the register.
        name: &'static str,
        /// Its address.
        address: u8,
        /// The value that was read.
        found: i32,
        /// The required value.
        expected: i32,
        /// Where the required value comes from.
        source_of: &'static str,
    },
    /// A register has a value with which the bridge cannot work.
    #[error(
        "servo {id}: {name} (address {address}) is {found:#x}, with which positions, speeds or torque mean something \
         else than this program takes them for; write {remedy} there, and calibrate the arm again"
    )]
    Forbidden {
        /// The id.
        id: u8,
        /// Name of the register.
        name: &'static str,
        /// Its address.
        address: u8,
        /// The value that was read.
        found: i32,
        /// The value without the offending bits.
        remedy: i32,
    },
    /// A Dynamixel's range goes across the 0 of its encoder, which a homing offset does not move.
    #[error(
        "servo {id}: its range of {low} to {high} steps lies across the 0 of its encoder, which is at {offset} steps: \
         a Dynamixel's homing offset is added to what the encoder says and does not move it; take its horn off, turn \
         it by half a turn, and calibrate again"
    )]
    Offset {
        /// The id.
        id: u8,
        /// The homing offset, steps.
        offset: i32,
        /// Lower end of its range, steps.
        low: i32,
        /// Upper end of its range, steps.
        high: i32,
    },
    /// The calibration file is not there, or cannot be read.
    #[error(
        "the calibration cannot be read ({cause}); looked for {places}; a relative path in plant.servos.calibration \
         begins at the scenario's folder; `tectum-bridge calibrate` makes one"
    )]
    NoCalibration {
        /// Where it was looked for.
        places: String,
        /// What is wrong.
        cause: String,
    },
    /// The calibration file is invalid.
    #[error("calibration {path}: {cause}; make one with `tectum-bridge calibrate`")]
    Calibration {
        /// The file.
        path: String,
        /// The cause.
        cause: String,
    },
}

impl BridgeError {
    /// Whether the cause is what the user has set up, so that another start would end the same way. Otherwise it is a
    /// cable, a servo, the posture of the arm or another program.
    pub fn is_configuration(&self) -> bool {
        match self {
            Self::Bus(error) => error.is_configuration(),
            Self::NoServos | Self::Model(_) | Self::Register { .. } | Self::Forbidden { .. } | Self::Offset { .. } => {
                true
            }
            Self::Calibration { .. } | Self::NoCalibration { .. } => true,
            Self::NoAnswer(_) | Self::OutOfRange { .. } | Self::HardwareError { .. } | Self::Setting { .. } => false,
        }
    }

    /// Whether a servo did not answer, which refuses nothing.
    pub fn is_silence(&self) -> bool {
        matches!(self, Self::NoAnswer(_) | Self::Bus(BusError::NoAnswer { .. } | BusError::NotSent(_)))
    }
}

/// The joints of a plan, from the scenario or from the file that it names: those that commands move, then those that
/// are held.
///
/// # Errors
/// When the plan has no servos, or the joints of the file do not fit the arm.
pub fn joints_of(plan: &Plan) -> Result<Vec<JointConfig>, BridgeError> {
    let plant = &plan.scenario.plant;
    let Some(servos) = &plant.servos else { return Err(BridgeError::NoServos) };
    let Some(named) = &servos.calibration else { return Ok(servos.moving_first(&servos.joints)) };
    let source = &plan.scenario.source;
    let path = source.resolve(named);
    let text = std::fs::read_to_string(&path)
        .map_err(|error| BridgeError::NoCalibration { places: source.places(named), cause: error.to_string() })?;
    let bad = |cause: String| BridgeError::Calibration { path: path.display().to_string(), cause };
    let calibration: Calibration = Calibration::parse(&text, &path, servos.protocol).map_err(bad)?;
    if calibration.protocol != servos.protocol {
        let (theirs, ours) = (calibration.protocol.name(), servos.protocol.name());
        return Err(bad(format!(
            "it is for servos that speak {theirs} and plant.servos.protocol is {ours}: it is another arm's"
        )));
    }
    check_joints(&calibration.joints, plant).map_err(bad)?;
    Ok(servos.moving_first(&calibration.joints))
}

/// Time for which a step before the first tick is done again while servos are silent, ns.
pub(super) const PATIENCE: u64 = 1_000_000_000;

/// Does a step again while servos are silent, for a second at most: a loaded machine may be late with single answers.
pub(super) fn patiently<T>(
    bus: &mut Bus,
    mut step: impl FnMut(&mut Bus) -> Result<T, BridgeError>,
) -> Result<T, BridgeError> {
    let until = bus.now() + PATIENCE;
    loop {
        match step(bus) {
            Err(error) if error.is_silence() && bus.now() < until => {}
            result => return result,
        }
    }
}

/// Checks that all servos answer and are of known models. Changes nothing.
pub(super) fn identify(bus: &mut Bus, joints: &[JointConfig]) -> Result<(), BridgeError> {
    let series = bus.series();
    let (mut answering, mut missing) = (Vec::new(), Vec::new());
    for joint in joints {
        match bus.model(joint.id) {
            Ok((_, Some(_))) => answering.push(joint.id.to_string()),
            Ok((number, None)) => return Err(UnknownModel { id: joint.id, number, protocol: series.protocol }.into()),
            Err(error @ BusError::NoAnswer { .. }) => missing.push(error.to_string()),
            Err(error) => return Err(error.into()),
        }
    }
    match (missing.is_empty(), answering.is_empty()) {
        (true, _) => Ok(()),
        (false, true) => Err(BridgeError::NoAnswer(format!("no servo of the arm answers ({})", missing.join("; ")))),
        (false, false) => {
            let text = format!("{}; with an answer: servo {}", missing.join("; "), answering.join(", "));
            Err(BridgeError::NoAnswer(text))
        }
    }
}

/// All checks and settings before torque: checks models, errors and posture; then sets modes and limits with
/// torque off.
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
        // One step to either side is within the resolution of the reading.
        if !joint.is_free() && !(low - STEP..=high + STEP).contains(&angle) {
            return Err(BridgeError::OutOfRange { id: joint.id, angle, low, high });
        }
        check_registers(bus, joint.id, |kept| joint.registers.get(kept.name).copied())?;
        check_offset(series.protocol, joint)?;
        let bits = bus.read(joint.id, series.hardware_error)?;
        if bits != 0 {
            return Err(BridgeError::HardwareError { id: joint.id, bits });
        }
    }
    if let Some(watchdog) = series.bus_watchdog {
        // One that has stopped a servo, after the death of another bridge, refuses goals until it is cleared.
        let ids: Vec<_> = joints.iter().map(|joint| joint.id).collect();
        bus.sync_set(&ids, watchdog, |_| 0)?;
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
            // No limit: the gate limits acceleration.
            set(bus, joint.id, series.profile_acceleration, 0)?;
        }
    }
    set_position_limits(bus, joints)
}

/// Writes the position limits of the servos, steps. With speed goals both series ignore them, and only the
/// bridge keeps the range. They are written anyway, so that a later program that uses position goals stays
/// within the range.
fn set_position_limits(bus: &mut Bus, joints: &[JointConfig]) -> Result<(), BridgeError> {
    let series = bus.series();
    let ids: Vec<_> = joints.iter().map(|joint| joint.id).collect();
    let registers = [series.min_position, series.max_position];
    // The two registers are adjacent in both series, in one order or the other, so one instruction reads both.
    let block = RegisterBlock {
        address: registers[0].address.min(registers[1].address),
        length: registers[0].width + registers[1].width,
    };
    // Whoever asks for a goal, it stays within what is written here.
    bus.limit_goals(joints.iter().filter_map(|joint| Some((joint.id, joint.raw_ends()?))).collect());
    let ends = |joint: &JointConfig| joint.raw_ends().unwrap_or([0, 4095]);
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
    // One instruction for all servos, because arming must not take longer than a tick. No write if nothing
    // differs, because EEPROM wears out.
    let first_difference =
        |answers: &[ServoReply]| answers.iter().zip(&wanted).position(|(answer, wanted)| answer.bytes != *wanted);
    if first_difference(&bus.sync_read(&ids, block).0?).is_none() {
        return Ok(());
    }
    bus.sync_write(&ids, block.address, &wanted).0?;
    let answers = bus.sync_read(&ids, block).0?;
    let Some(i) = first_difference(&answers) else { return Ok(()) };
    let found = block.decode(registers[0], &answers[i].bytes).unwrap_or(0);
    Err(BridgeError::Setting { id: ids[i], value: ends(&joints[i])[0], address: registers[0].address, found })
}

/// Sets a register and checks that the value was kept. A register that has the value already is not written,
/// because EEPROM wears out.
fn set(bus: &mut Bus, id: u8, register: Register, value: i32) -> Result<(), BridgeError> {
    if bus.read(id, register)? == value {
        return Ok(());
    }
    bus.write(id, register, value)?;
    let found = bus.read(id, register)?;
    if found == value { Ok(()) } else { Err(BridgeError::Setting { id, value, address: register.address, found }) }
}

/// The values of the registers that a calibration keeps, in the order of the series's list.
pub(crate) fn read_kept(bus: &mut Bus, id: u8) -> Result<Vec<(KeptSetting, i32)>, BusError> {
    let kept = bus.series().kept;
    let first = kept.iter().map(|kept| kept.register.address).min().unwrap_or(0);
    let end = kept.iter().map(|kept| kept.register.address + kept.register.width).max().unwrap_or(first);
    let block = RegisterBlock { address: first, length: end - first };
    let bytes = bus.read_block(id, block)?;
    Ok(kept.iter().map(|kept| (*kept, block.decode(kept.register, &bytes).unwrap_or(0))).collect())
}

/// Checks that a Dynamixel reads the whole range as numbers that follow each other: those from its homing offset on,
/// for a turn. (A Feetech takes its offset off within the turn.)
fn check_offset(protocol: Protocol, joint: &JointConfig) -> Result<(), BridgeError> {
    let offset = joint.registers.get("homing_offset").copied().unwrap_or(0);
    match joint.raw_ends() {
        Some([low, high])
            if protocol == Protocol::Dynamixel && (low < offset || high >= offset.saturating_add(STEPS_PER_TURN)) =>
        {
            Err(BridgeError::Offset { id: joint.id, offset, low, high })
        }
        _ => Ok(()),
    }
}

/// Compares the registers that a calibration keeps. `recorded` returns the value of a calibration, if it has one.
pub(crate) fn check_registers(
    bus: &mut Bus,
    id: u8,
    recorded: impl Fn(&KeptSetting) -> Option<i32>,
) -> Result<(), BridgeError> {
    for (kept, found) in read_kept(bus, id)? {
        let (name, address) = (kept.name, kept.register.address);
        let of_calibration = recorded(&kept);
        if let Some(expected) = of_calibration.or(kept.neutral).filter(|&expected| expected != found) {
            let source_of = match of_calibration {
                Some(_) => "as when the arm was calibrated",
                None => "the value that changes nothing, because the calibration states no other",
            };
            return Err(BridgeError::Register { id, name, address, found, expected, source_of });
        }
        if found & kept.forbidden != 0 {
            return Err(BridgeError::Forbidden { id, name, address, found, remedy: found & !kept.forbidden });
        }
    }
    Ok(())
}
