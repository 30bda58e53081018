//! Calibration by hand: torque off, and each joint is shown its zero, the way in which its angle grows, and its
//! ends.

use std::fs;
use std::io::{BufRead, Write};
use std::path::Path;

use serde::{Deserialize, Serialize};

use super::{ToolError, identify, rad, tell, torque_off, way};
use crate::scenario::JointConfig;
use crate::servo::bus::Bus;
use crate::servo::model::Protocol;

/// The least turn that tells a direction, steps: 0.1 rad.
const LEAST_TURN: i32 = 65;

/// What `calibration =` of a scenario reads.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Calibration {
    /// What the servos speak.
    pub protocol: Protocol,
    /// The joints, from the base on.
    pub joints: Vec<JointConfig>,
}

impl Calibration {
    /// Reads a file.
    ///
    /// # Errors
    /// When there is none, or it is no calibration.
    pub fn load(path: &Path) -> Result<Self, ToolError> {
        let text = fs::read_to_string(path).map_err(|error| ToolError::Io(path.display().to_string(), error))?;
        toml::from_str(&text).map_err(|error| {
            let why = error.message();
            ToolError::Refused(format!("{}: {why}; make one with `tectum-bridge calibrate`", path.display()))
        })
    }

    /// Writes the file whole or not at all.
    ///
    /// # Errors
    /// When the folder does not take it.
    pub fn save(&self, path: &Path) -> Result<(), ToolError> {
        let wrong = |error| ToolError::Io(path.display().to_string(), error);
        let head = "# An arm's joints from the base on, as tectum-bridge calibrate found them. A scenario names this file:\n\
                    # [plant.servos] calibration = \"...\". zero in steps of 4096 a turn, range in rad, max_speed in rad/s.\n";
        let text = toml::to_string(self).map_err(|error| wrong(std::io::Error::other(error)))?;
        let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
        let mut file = tempfile::NamedTempFile::new_in(folder).map_err(wrong)?;
        file.write_all(head.as_bytes()).and_then(|()| file.write_all(text.as_bytes())).map_err(wrong)?;
        file.persist(path).map_err(|error| wrong(error.error))?;
        Ok(())
    }
}

/// Leads through the calibration of the servos with these ids, from the base on. Answers are lines on `input`.
///
/// Ends are looked for within half a turn of the zero.
///
/// # Errors
/// When a servo is missing or another's, keeps its torque, or what it is shown cannot be; nothing was changed
/// then but torque, which is off.
pub fn calibrate(
    bus: &mut Bus,
    ids: &[u8],
    max_speed: f64,
    input: &mut dyn BufRead,
    out: &mut dyn Write,
) -> Result<Calibration, ToolError> {
    identify(bus, ids)?;
    torque_off(bus, ids)?;
    tell(out, "Torque is off: hold the arm, and move it by hand. Each step ends with Enter.")?;
    let mut joints = Vec::new();
    for (i, &id) in ids.iter().enumerate() {
        let mut show = |what: &str| -> Result<(i32, String), ToolError> {
            tell(out, &format!("Joint {} (servo {id}): {what}", i + 1))?;
            let mut line = String::new();
            let read = input.read_line(&mut line);
            match read.map_err(|error| ToolError::Io("standard input".into(), error))? {
                0 => Err(ToolError::Refused("the answers end before the calibration does; nothing was written".into())),
                _ => Ok((bus.read(id, bus.series().position)?, line.trim().to_owned())),
            }
        };
        let (zero, _) = show("put it where its angle is 0.")?;
        let (at, _) = show("turn it by at least 0.1 rad in the direction in which its angle grows.")?;
        let turned = way(zero, at);
        if turned.abs() < LEAST_TURN {
            let text =
                format!("servo {id} was turned by {:.3} rad; that is too little to tell a direction", rad(turned));
            return Err(ToolError::Refused(text));
        }
        let direction = turned.signum();
        let (low, answer) = show("turn it to its least angle; or say free if it turns without end.")?;
        let range = if answer == "free" {
            [-std::f64::consts::PI, std::f64::consts::PI]
        } else {
            let (high, _) = show("turn it to its greatest angle.")?;
            let range = [low, high].map(|end| rad(way(zero, end) * direction));
            if !(range[0] <= 0.0 && 0.0 <= range[1] && range[1] - range[0] >= 0.1) {
                let text = format!(
                    "servo {id}: from {:.3} to {:.3} rad is no range with the angle 0 in it; show the least angle first, then the greatest",
                    range[0], range[1]
                );
                return Err(ToolError::Refused(text));
            }
            range
        };
        joints.push(JointConfig { id, direction, zero, range, max_speed });
        tell(out, &format!("  zero {zero}, direction {direction}, range {:.3} to {:.3} rad", range[0], range[1]))?;
    }
    Ok(Calibration { protocol: bus.series().protocol, joints })
}
