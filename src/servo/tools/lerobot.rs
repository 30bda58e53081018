//! LeRobot's calibration files, which owners of SO-100 and SO-101 arms already have.
//!
//! There are two generations. The newer one has an object for each joint:
//!
//! ```json
//! { "shoulder_pan": { "id": 1, "drive_mode": 0, "homing_offset": -12, "range_min": 900, "range_max": 3100 } }
//! ```
//!
//! LeRobot has written the homing offset into the servo, so positions and ends of the range contain it already, and
//! it is compared before torque comes on. The angle is 0 in the middle of the range; a drive mode of 1 turns its sign
//! round. The older generation has lists (`motor_names`, `homing_offset`, `drive_mode`, `start_pos`, `end_pos`,
//! `calib_mode`). Its offset is one of LeRobot's own, in steps, and is not in the servo; and a joint with the mode
//! `DEGREE` has no range, so that it cannot be used without a calibration of its own.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::Calibration;
use crate::scenario::JointConfig;
use crate::servo::model::{Protocol, STEP, SignEncoding};

/// Names of the joints of an SO-100 or SO-101, from the base on.
const SO_101: [&str; 6] = ["shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper"];

/// Highest speed of a joint, rad/s, as in a scenario that states none; LeRobot's files have none.
const MAX_SPEED: f64 = 6.0;

/// A joint in a file of the newer generation.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct LerobotJoint {
    id: u8,
    drive_mode: i32,
    homing_offset: i32,
    range_min: i32,
    range_max: i32,
}

/// A file of the older generation. Servos have the ids 1, 2, 3, ... in the order of the lists.
#[derive(Debug, Clone, PartialEq, Deserialize)]
struct LerobotLists {
    motor_names: Vec<String>,
    drive_mode: Vec<i32>,
    start_pos: Vec<i32>,
    end_pos: Vec<i32>,
    calib_mode: Vec<String>,
}

/// The joints of a LeRobot file, in the order of their ids.
///
/// # Errors
/// One sentence that tells what is wrong with the file.
pub fn read_lerobot(text: &str, protocol: Protocol) -> Result<Calibration, String> {
    let mut joints = match serde_json::from_str::<BTreeMap<String, LerobotJoint>>(text) {
        Ok(named) => {
            named.iter().map(|(name, joint)| joint_of(name, joint, protocol)).collect::<Result<Vec<_>, _>>()?
        }
        Err(error) => match serde_json::from_str::<LerobotLists>(text) {
            Ok(lists) => joints_of_lists(&lists)?,
            Err(_) => return Err(format!("it is no calibration file of LeRobot's: {error}")),
        },
    };
    joints.sort_by_key(|joint| joint.id);
    Ok(Calibration { protocol, joints })
}

fn joint_of(name: &str, joint: &LerobotJoint, protocol: Protocol) -> Result<JointConfig, String> {
    let &LerobotJoint { id, drive_mode, homing_offset, range_min, range_max } = joint;
    if !(0 <= range_min && range_min < range_max && range_max <= 4095) {
        return Err(format!("{name}: its range is {range_min} to {range_max}; give 0 to 4095, the lower end first"));
    }
    // Some files have the register's own bits, others the number that they mean.
    let register = protocol.series().homing_offset;
    let homing = match register.sign {
        SignEncoding::Magnitude(bit) if homing_offset >= 1 << bit => register.decode(&homing_offset.to_le_bytes()),
        _ => homing_offset,
    };
    let mut joint = between(id, drive_mode, range_min, range_max);
    joint.name = Some(name.to_owned());
    joint.registers.insert("homing_offset".to_owned(), homing);
    Ok(joint)
}

/// A joint whose angle is 0 in the middle between two positions.
fn between(id: u8, drive_mode: i32, low: i32, high: i32) -> JointConfig {
    let (zero, direction) = ((low + high) / 2, if drive_mode == 0 { 1 } else { -1 });
    let ends = [low - zero, high - zero].map(|end| f64::from(end * direction) * STEP);
    let range = [ends[0].min(ends[1]), ends[0].max(ends[1])];
    JointConfig { id, name: None, direction, zero, range, max_speed: MAX_SPEED, registers: BTreeMap::new() }
}

fn joints_of_lists(lists: &LerobotLists) -> Result<Vec<JointConfig>, String> {
    let LerobotLists { motor_names, drive_mode, start_pos, end_pos, calib_mode } = lists;
    let n = motor_names.len();
    if [drive_mode.len(), start_pos.len(), end_pos.len(), calib_mode.len()].iter().any(|&length| length != n) {
        return Err("its lists are of different lengths".to_owned());
    }
    let joint = |i: usize| {
        if calib_mode[i] != "LINEAR" {
            return Err(format!(
                "{}: an old file states no range for it; calibrate the arm anew, with `tectum-bridge calibrate` or \
                 LeRobot",
                motor_names[i]
            ));
        }
        let (low, high) = (start_pos[i].min(end_pos[i]), start_pos[i].max(end_pos[i]));
        let joint = LerobotJoint {
            id: i as u8 + 1,
            drive_mode: drive_mode[i],
            homing_offset: 0,
            range_min: low,
            range_max: high,
        };
        joint_of(&motor_names[i], &joint, Protocol::Feetech)
    };
    (0..n).map(joint).collect()
}

/// A calibration as a LeRobot file of the newer generation. LeRobot puts the angle 0 into the middle of the range.
pub fn write_lerobot(calibration: &Calibration) -> String {
    let n = calibration.joints.len();
    let name = |i: usize| match &calibration.joints[i].name {
        None if n == SO_101.len() => SO_101[i].to_owned(),
        _ => calibration.joints[i].name_at(i),
    };
    let joint = |joint: &JointConfig| {
        let [range_min, range_max] = joint.raw_ends().unwrap_or([0, 4095]);
        LerobotJoint {
            id: joint.id,
            drive_mode: i32::from(joint.direction < 0),
            homing_offset: joint.registers.get("homing_offset").copied().unwrap_or(0),
            range_min,
            range_max,
        }
    };
    let named: BTreeMap<_, _> = calibration.joints.iter().enumerate().map(|(i, one)| (name(i), joint(one))).collect();
    serde_json::to_string_pretty(&named).unwrap_or_default() + "\n"
}

#[cfg(test)]
mod tests {
    use super::*;

    const NEW: &str = r#"{ "a": {"id": 2, "drive_mode": 1, "homing_offset": 44, "range_min": 800, "range_max": 3200},
        "b": {"id": 1, "drive_mode": 0, "homing_offset": 2348, "range_min": 900, "range_max": 3100} }"#;

    #[test]
    fn a_file_of_the_newer_generation_is_read_and_written() {
        let read = read_lerobot(NEW, Protocol::Feetech).unwrap();
        let [one, two] = &read.joints[..] else { panic!("{read:?}") };
        // 2348 is the register's way to write -300.
        assert_eq!((one.id, one.zero, one.direction, one.registers["homing_offset"]), (1, 2000, 1, -300));
        assert_eq!((two.id, two.zero, two.direction, two.registers["homing_offset"]), (2, 2000, -1, 44));
        assert_eq!((one.raw_ends(), two.raw_ends()), (Some([900, 3100]), Some([800, 3200])));
        assert_eq!(read_lerobot(&write_lerobot(&read), Protocol::Feetech).unwrap(), read);
    }

    #[test]
    fn a_file_of_the_older_generation_is_read_where_it_states_ranges() {
        let file = |mode: &str| {
            format!(
                r#"{{"homing_offset": [5], "drive_mode": [0], "start_pos": [3000], "end_pos": [1000],
                    "calib_mode": ["{mode}"], "motor_names": ["gripper"]}}"#
            )
        };
        let read = read_lerobot(&file("LINEAR"), Protocol::Feetech).unwrap();
        assert_eq!((read.joints[0].id, read.joints[0].raw_ends()), (1, Some([1000, 3000])));
        assert!(read_lerobot(&file("DEGREE"), Protocol::Feetech).unwrap_err().contains("gripper"));
    }

    #[test]
    fn anything_else_is_named() {
        for (text, why) in [
            ("x", "no calibration file"),
            (r#"{"a": {"id": 1}}"#, "missing field"),
            (&NEW.replace("3100", "5000"), "900 to 5000"),
        ] {
            let error = read_lerobot(text, Protocol::Feetech).unwrap_err();
            assert!(error.contains(why), "{why}: {error}");
        }
    }
}
