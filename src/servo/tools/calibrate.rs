//! Calibration by hand, without torque: the user moves each joint to its zero, in its positive direction, and
//! to its ends.

use std::collections::BTreeMap;
use std::fs;
use std::io::{BufRead, Write};
use std::path::Path;

use serde::{Deserialize, Serialize};

use super::lerobot::read_lerobot;
use super::{ToolError, again, identify, print_line, rad, shorter_way, torque_off};
use crate::scenario::JointConfig;
use crate::servo::bridge::{check_registers, read_kept};
use crate::servo::bus::{Bus, BusError};
use crate::servo::model::{Protocol, Register, STEPS_PER_TURN};

/// Smallest turn that determines a direction, steps: 0.1 rad.
const MIN_TURN: i32 = 65;

/// The contents of a calibration file, as the key `calibration` of a scenario names it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Calibration {
    /// The protocol of the servos.
    pub protocol: Protocol,
    /// The joints, from the base on.
    pub joints: Vec<JointConfig>,
}

impl Calibration {
    /// Reads a file: one that `tectum-bridge calibrate` has written, or, with the ending `.json`, one of LeRobot's, for
    /// servos of `protocol`.
    ///
    /// # Errors
    /// When the file cannot be read, or is not a calibration.
    pub fn load(path: &Path, protocol: Protocol) -> Result<Self, ToolError> {
        let text = fs::read_to_string(path).map_err(|error| ToolError::Io(path.display().to_string(), error))?;
        Self::parse(&text, path, protocol).map_err(|why| {
            ToolError::Refused(format!("{}: {why}; make one with `tectum-bridge calibrate`", path.display()))
        })
    }

    /// The calibration in the text of the file at `path`.
    ///
    /// # Errors
    /// Why it is none.
    pub fn parse(text: &str, path: &Path, protocol: Protocol) -> Result<Self, String> {
        if path.extension().is_some_and(|ending| ending == "json") {
            return read_lerobot(text, protocol);
        }
        toml::from_str(text).map_err(|error| error.message().to_owned())
    }

    /// Writes the file atomically.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn save(&self, path: &Path) -> Result<(), ToolError> {
        let wrong = |error| ToolError::Io(path.display().to_string(), error);
        let head = "# An arm's joints from the base on, as tectum-bridge calibrate found them. \
                    A scenario names this file:\n\
                    # [plant.servos] calibration = \"...\". \
                    zero in steps of 4096 a turn, range in rad, max_speed in rad/s.\n";
        let text = toml::to_string(self).map_err(|error| wrong(std::io::Error::other(error)))?;
        let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
        let mut file = tempfile::NamedTempFile::new_in(folder).map_err(wrong)?;
        file.write_all(head.as_bytes()).and_then(|()| file.write_all(text.as_bytes())).map_err(wrong)?;
        file.persist(path).map_err(|error| wrong(error.error))?;
        Ok(())
    }
}

/// Takes over the calibration in a file, of the servos with these ids or of all, after comparing the servos' registers
/// with it.
///
/// # Errors
/// When the file is no calibration, a servo does not answer, or a register differs.
pub fn import(bus: &mut Bus, path: &Path, ids: &[u8]) -> Result<Calibration, ToolError> {
    let series = bus.series();
    let mut calibration = Calibration::load(path, series.protocol)?;
    let bad = |text: String| ToolError::Refused(format!("{}: {text}", path.display()));
    if calibration.protocol != series.protocol {
        return Err(bad("it is for servos of the other protocol: it is another arm's".to_owned()));
    }
    if !ids.is_empty() {
        let find = |id: &u8| {
            let found = calibration.joints.iter().find(|joint| joint.id == *id).cloned();
            found.ok_or_else(|| bad(format!("it has no servo {id}")))
        };
        calibration.joints = ids.iter().map(find).collect::<Result<Vec<_>, _>>()?;
    }
    identify(bus, &calibration.joints.iter().map(|joint| joint.id).collect::<Vec<_>>())?;
    for joint in &mut calibration.joints {
        joint.check_seam().map_err(|text| bad(format!("servo {}: {text}", joint.id)))?;
        check_registers(bus, joint.id, |kept| joint.registers.get(kept.name).copied())?;
        joint.registers = registers(bus, joint.id)?;
    }
    Ok(calibration)
}

/// The values of the registers that a calibration keeps, by name.
fn registers(bus: &mut Bus, id: u8) -> Result<BTreeMap<String, i32>, ToolError> {
    let kept = again(|| read_kept(bus, id))?;
    Ok(kept.into_iter().map(|(kept, value)| (kept.name.to_owned(), value)).collect())
}

/// Guides the user through the calibration of the servos with these ids, from the base on. Answers are lines on
/// `input`.
///
/// The ends of a range must be within half a turn of the zero.
///
/// # Errors
/// When a servo does not answer at the beginning, is of an unknown model, or keeps its torque, or the answers end.
/// A servo that falls silent later is asked again, and a joint that was moved to invalid positions is done again.
pub fn calibrate(
    bus: &mut Bus,
    ids: &[u8],
    max_speed: f64,
    input: &mut dyn BufRead,
    out: &mut dyn Write,
) -> Result<Calibration, ToolError> {
    identify(bus, ids)?;
    torque_off(bus, ids)?;
    print_line(out, "Torque is off: hold the arm, and move it by hand. Each step ends with Enter.")?;
    let (mut joints, protocol) = (Vec::new(), bus.series().protocol);
    for (i, &id) in ids.iter().enumerate() {
        let mut ask = |what: &str| -> Result<(i32, String), ToolError> {
            print_line(out, &format!("Joint {} (servo {id}): {what}", i + 1))?;
            let mut answer = String::new();
            loop {
                let mut line = String::new();
                let read = input.read_line(&mut line);
                if read.map_err(|error| ToolError::Io("standard input".into(), error))? == 0 {
                    let text = "the answers end before the calibration does; nothing was written";
                    return Err(ToolError::Refused(text.into()));
                }
                answer.push_str(line.trim());
                match bus.read(id, bus.series().position) {
                    Ok(position) => return Ok((position, answer)),
                    // The joints that are done are kept.
                    Err(error @ BusError::NoAnswer { .. }) => {
                        let text = format!("  {error}; look at its cable; Enter asks it again");
                        print_line(out, &text)?;
                    }
                    Err(error) => return Err(error.into()),
                }
            }
        };
        let mut joint = loop {
            match calibrate_joint(id, max_speed, &mut ask)? {
                Ok(joint) => break joint,
                Err(why) => ask(&format!("{why}. This joint again, after Enter; those before it are kept."))?,
            };
        };
        if let Err(why) = joint.check_seam() {
            seam_can_move(protocol, id, &why)?;
            let [low, high] = joint.raw_ends().unwrap_or_default();
            let (_, answer) = ask(&format!(
                "it would go from {low} to {high} steps, across the 0 of its encoder. Enter writes a homing offset \
                 into the servo, for good, which puts the 0 outside the range; or say no, and nothing is written."
            ))?;
            if !answer.is_empty() {
                return Err(ToolError::Refused(format!("servo {id}: {why}")));
            }
            move_seam(bus, &mut joint)?;
        }
        joint.registers = registers(bus, id)?;
        let JointConfig { zero, direction, range, .. } = joint;
        joints.push(joint);
        let text = format!("  zero {zero}, direction {direction}, range {:.3} to {:.3} rad", range[0], range[1]);
        print_line(out, &text)?;
    }
    Ok(Calibration { protocol, joints })
}

/// Refuses a range across the 0 of the encoder, for the reason `why`, where a homing offset does not move the 0.
fn seam_can_move(protocol: Protocol, id: u8, why: &str) -> Result<(), ToolError> {
    if protocol == Protocol::Feetech {
        return Ok(());
    }
    Err(ToolError::Refused(format!(
        "servo {id}: {why}; a Dynamixel's homing offset does not move the 0 of its encoder; take its horn off, turn it \
         by half a turn, and calibrate again"
    )))
}

/// Writes a homing offset into the joint's servo that puts the middle of its range at the middle of the turn.
fn move_seam(bus: &mut Bus, joint: &mut JointConfig) -> Result<(), ToolError> {
    let (series, id) = (bus.series(), joint.id);
    let [low, high] = joint.raw_ends().unwrap_or_default();
    let shift = STEPS_PER_TURN / 2 - (low + high).div_euclid(2);
    let (before, old) = (bus.read(id, series.position)?, bus.read(id, series.homing_offset)?);
    let offset = shorter_way(0, old + series.homing_sign * shift);
    if offset.abs() > series.homing_limit {
        return Err(ToolError::Refused(format!(
            "servo {id} needs a homing offset of {offset} steps and takes at most {} in either direction; \
             take its horn off, turn it by half a turn, and calibrate again",
            series.homing_limit
        )));
    }
    write_for_good(bus, id, series.homing_offset, offset)?;
    let moved = series.homing_sign * (offset - old);
    let after = bus.read(id, series.position)?;
    if shorter_way(before + moved, after).abs() > 20 {
        let text =
            format!("servo {id} was at {before} and is at {after} with a homing offset of {offset}; was it moved?");
        return Err(ToolError::Failed(text));
    }
    joint.zero = (joint.zero + moved).rem_euclid(STEPS_PER_TURN);
    joint.check_seam().map_err(|text| ToolError::Refused(format!("servo {id}: {text}")))
}

/// Writes a register of the EEPROM so that it keeps its value without power, and checks that it has it.
fn write_for_good(bus: &mut Bus, id: u8, register: Register, value: i32) -> Result<(), ToolError> {
    let lock = bus.series().lock;
    if let Some(lock) = lock {
        bus.write(id, lock, 0)?;
    }
    let written = bus.write(id, register, value);
    if let Some(lock) = lock {
        bus.write(id, lock, 1)?;
    }
    written?;
    match bus.read(id, register)? {
        found if found == value => Ok(()),
        found => {
            let text = format!("servo {id} does not keep {value} at address {}; it has {found}", register.address);
            Err(BusError::Refused(text).into())
        }
    }
}

/// Shows a request to the user; returns the position afterwards, steps, and the answer.
type Ask<'a> = dyn FnMut(&str) -> Result<(i32, String), ToolError> + 'a;

/// Calibrates one joint. `ask` shows a request to the user, and returns the position afterwards, steps, and the
/// answer. A string is why the answers do not make a joint.
fn calibrate_joint(id: u8, max_speed: f64, ask: &mut Ask) -> Result<Result<JointConfig, String>, ToolError> {
    let (zero, _) = ask("put it where its angle is 0.")?;
    let (at, _) = ask("turn it by at least 0.1 rad in the direction in which its angle grows.")?;
    let turned = shorter_way(zero, at);
    if turned.abs() < MIN_TURN {
        let text = format!("servo {id} was turned by {:.3} rad; that is too little to tell a direction", rad(turned));
        return Ok(Err(text));
    }
    let direction = turned.signum();
    // A Dynamixel without torque counts on over whole turns.
    let zero = zero.rem_euclid(STEPS_PER_TURN);
    let (low, answer) = ask("turn it to its least angle; or say free if it turns without end.")?;
    if answer == "free" {
        let range = [-std::f64::consts::PI, std::f64::consts::PI];
        return Ok(Ok(JointConfig {
            id,
            name: None,
            direction,
            zero,
            range,
            max_speed,
            registers: Default::default(),
        }));
    }
    let (high, _) = ask("turn it to its greatest angle.")?;
    let range = [low, high].map(|end| rad(shorter_way(zero, end) * direction));
    if !(range[0] <= 0.0 && 0.0 <= range[1] && range[1] - range[0] >= 0.1) {
        let text = format!(
            "servo {id}: from {:.3} to {:.3} rad is no range with the angle 0 in it; \
             show the least angle first, then the greatest",
            range[0], range[1]
        );
        return Ok(Err(text));
    }
    Ok(Ok(JointConfig { id, name: None, direction, zero, range, max_speed, registers: Default::default() }))
}
