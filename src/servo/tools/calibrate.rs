//! Calibration by hand, without torque: the user moves each joint to its zero, in its positive direction, and
//! to its ends.

use std::fs;
use std::io::{BufRead, Write};
use std::path::Path;

use serde::{Deserialize, Serialize};

use super::{ToolError, identify, print_line, rad, shorter_way, torque_off};
use crate::scenario::JointConfig;
use crate::servo::bus::Bus;
use crate::servo::model::Protocol;

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
    /// Reads a file.
    ///
    /// # Errors
    /// When the file cannot be read, or is not a calibration.
    pub fn load(path: &Path) -> Result<Self, ToolError> {
        let text = fs::read_to_string(path).map_err(|error| ToolError::Io(path.display().to_string(), error))?;
        toml::from_str(&text).map_err(|error| {
            let why = error.message();
            ToolError::Refused(format!("{}: {why}; make one with `tectum-bridge calibrate`", path.display()))
        })
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

/// Guides the user through the calibration of the servos with these ids, from the base on. Answers are lines on
/// `input`.
///
/// The ends of a range must be within half a turn of the zero.
///
/// # Errors
/// When a servo does not answer, is of an unknown model, keeps its torque, or is moved to invalid positions.
/// Only torque was changed then: it is off.
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
    let mut joints = Vec::new();
    for (i, &id) in ids.iter().enumerate() {
        let mut ask = |what: &str| -> Result<(i32, String), ToolError> {
            print_line(out, &format!("Joint {} (servo {id}): {what}", i + 1))?;
            let mut line = String::new();
            let read = input.read_line(&mut line);
            match read.map_err(|error| ToolError::Io("standard input".into(), error))? {
                0 => Err(ToolError::Refused("the answers end before the calibration does; nothing was written".into())),
                _ => Ok((bus.read(id, bus.series().position)?, line.trim().to_owned())),
            }
        };
        let joint = calibrate_joint(id, max_speed, &mut ask)?;
        let JointConfig { zero, direction, range, .. } = joint;
        joints.push(joint);
        let text = format!("  zero {zero}, direction {direction}, range {:.3} to {:.3} rad", range[0], range[1]);
        print_line(out, &text)?;
    }
    Ok(Calibration { protocol: bus.series().protocol, joints })
}

/// Shows a request to the user; returns the position afterwards, steps, and the answer.
type Ask<'a> = dyn FnMut(&str) -> Result<(i32, String), ToolError> + 'a;

/// Calibrates one joint. `ask` shows a request to the user, and returns the position afterwards, steps, and the
/// answer.
fn calibrate_joint(id: u8, max_speed: f64, ask: &mut Ask) -> Result<JointConfig, ToolError> {
    let (zero, _) = ask("put it where its angle is 0.")?;
    let (at, _) = ask("turn it by at least 0.1 rad in the direction in which its angle grows.")?;
    let turned = shorter_way(zero, at);
    if turned.abs() < MIN_TURN {
        let text = format!("servo {id} was turned by {:.3} rad; that is too little to tell a direction", rad(turned));
        return Err(ToolError::Refused(text));
    }
    let direction = turned.signum();
    let (low, answer) = ask("turn it to its least angle; or say free if it turns without end.")?;
    if answer == "free" {
        let range = [-std::f64::consts::PI, std::f64::consts::PI];
        return Ok(JointConfig { id, direction, zero, range, max_speed });
    }
    let (high, _) = ask("turn it to its greatest angle.")?;
    let range = [low, high].map(|end| rad(shorter_way(zero, end) * direction));
    if !(range[0] <= 0.0 && 0.0 <= range[1] && range[1] - range[0] >= 0.1) {
        let text = format!(
            "servo {id}: from {:.3} to {:.3} rad is no range with the angle 0 in it; \
             show the least angle first, then the greatest",
            range[0], range[1]
        );
        return Err(ToolError::Refused(text));
    }
    Ok(JointConfig { id, direction, zero, range, max_speed })
}
