//! One joint moves a little, slowly, and torque is off again.

use super::{Calibration, ServoReading, ToolError, identify, look, rad, way};
use crate::servo::bus::Bus;
use crate::servo::model::STEP;

/// How near the goal counts as there, steps.
const NEAR: i32 = 12;

/// Between two looks, ns.
const LOOK_EVERY: u64 = 20_000_000;

/// What is asked for.
#[derive(Debug, Clone, Copy)]
pub struct Jog<'a> {
    /// The servo.
    pub id: u8,
    /// By how much, rad; with a calibration in its direction.
    pub by: f64,
    /// How fast, rad/s.
    pub speed: f64,
    /// The joints, so that the motion stays in their range.
    pub calibration: Option<&'a Calibration>,
}

/// Torque that goes off however the motion ends.
struct TorqueGuard<'a> {
    bus: &'a mut Bus,
    id: u8,
}

impl Drop for TorqueGuard<'_> {
    fn drop(&mut self) {
        self.bus.torque_off(&[self.id]);
    }
}

/// Moves one joint; where it stands then. `nap` sleeps so many ns, `stop` says whether to end early.
///
/// # Errors
/// Before torque: when the servo is missing or in trouble, or the goal lies outside. Afterwards: when it does
/// not arrive. Torque is off then.
pub fn jog(
    bus: &mut Bus,
    what: Jog,
    mut nap: impl FnMut(u64),
    mut stop: impl FnMut() -> bool,
) -> Result<ServoReading, ToolError> {
    let Jog { id, by, speed, .. } = what;
    let series = bus.series();
    if !(by.abs() <= std::f64::consts::PI && (0.01..=2.0).contains(&speed)) {
        let text = format!("--by {by} --speed {speed}: give at most half a turn (3.14 rad), and 0.01 to 2 rad/s");
        return Err(ToolError::Refused(text));
    }
    identify(bus, &[id])?;
    let before = look(bus, id)?;
    if before.errors != 0 {
        let text = format!(
            "servo {id} reports an error (bits {:#04x}); find its cause, then take its power away and give it again",
            before.errors
        );
        return Err(ToolError::Refused(text));
    }
    let goal = goal(bus, what, &before)?;
    bus.torque_off(&[id]);
    bus.write(id, series.operating_mode, i32::from(series.position_mode))?;
    // With the mode positions of more than a turn become those within one.
    let start = bus.read(id, series.position)?;
    let goal = start + way(before.position, goal).clamp(-2047, 2047);
    if !(0..=4095).contains(&goal) {
        let text = format!("servo {id} would have to go to {goal}, past its own zero; it goes from 0 to 4095");
        return Err(ToolError::Refused(text));
    }
    let units = |value: f64, unit: f64| libm::ceil(value / unit).max(1.0) as i32;
    bus.write(id, series.profile_velocity, units(speed, series.speed_unit))?;
    let held = TorqueGuard { bus, id };
    // Its old goal would be where it goes first.
    held.bus.write(id, series.goal_position, start)?;
    held.bus.write(id, series.torque_enable, 1)?;
    held.bus.write(id, series.goal_position, goal)?;
    let until = held.bus.now() + ((by.abs() / speed + 2.0) * 1e9) as u64;
    let mut arrived = false;
    while !arrived && held.bus.now() < until && !stop() {
        nap(LOOK_EVERY);
        arrived = (held.bus.read(id, series.position)? - goal).abs() <= NEAR;
    }
    drop(held);
    let after = look(bus, id)?;
    if after.torque {
        return Err(ToolError::Refused(format!("servo {id} keeps its torque; take the power away")));
    }
    if !arrived {
        let moved = rad(way(start, after.position));
        return Err(ToolError::Refused(format!("servo {id} went {moved:.3} rad and did not arrive; torque is off")));
    }
    Ok(after)
}

/// The goal in steps, within the joint's range.
fn goal(bus: &Bus, what: Jog, before: &ServoReading) -> Result<i32, ToolError> {
    let steps = libm::round(what.by / STEP) as i32;
    let Some(calibration) = what.calibration else { return Ok(before.position + steps) };
    if calibration.protocol != bus.series().protocol {
        let text = "the calibration is for servos of the other protocol: it is another arm's".to_owned();
        return Err(ToolError::Refused(text));
    }
    let Some(joint) = calibration.joints.iter().find(|joint| joint.id == what.id) else {
        let ids: Vec<_> = calibration.joints.iter().map(|joint| joint.id.to_string()).collect();
        let text = format!("the calibration has no servo {} but {}: it is another arm's", what.id, ids.join(", "));
        return Err(ToolError::Refused(text));
    };
    let angle = rad(way(joint.zero, before.position) * joint.direction);
    let [low, high] = joint.range;
    if !joint.is_free() && !(low - STEP..=high + STEP).contains(&(angle + what.by)) {
        let text = format!(
            "servo {} stands at {angle:.3} rad and would go to {:.3}, outside its range of {low:.3} to {high:.3} rad",
            what.id,
            angle + what.by
        );
        return Err(ToolError::Refused(text));
    }
    Ok(before.position + steps * joint.direction)
}
