//! Moves one joint slowly by a small angle; torque is off before and after.

use super::{Calibration, ServoReading, ToolError, identify, rad, read_state, shorter_way};
use crate::scenario::JointConfig;
use crate::servo::bridge::check_registers;
use crate::servo::bus::Bus;
use crate::servo::model::STEP;

/// Distance from the goal at which the joint has arrived, steps.
const TOLERANCE: i32 = 12;

/// Interval between reads of the position, ns.
const READ_INTERVAL: u64 = 20_000_000;

/// A requested motion.
#[derive(Debug, Clone, Copy)]
pub struct Jog<'a> {
    /// The servo.
    pub id: u8,
    /// Angle of the motion, rad; with a calibration, in the joint's positive direction.
    pub by: f64,
    /// Speed, rad/s.
    pub speed: f64,
    /// The calibration, so that the motion stays in the joint's range.
    pub calibration: Option<&'a Calibration>,
}

/// Turns torque off when it is dropped, however the motion ends short of a kill; the guard is for those.
struct TorqueGuard<'a> {
    bus: &'a mut Bus,
    id: u8,
}

impl Drop for TorqueGuard<'_> {
    fn drop(&mut self) {
        self.bus.torque_off(&[self.id]);
    }
}

/// What a motion needs of the outside world.
pub struct JogContext<'a> {
    /// Sleeps for a number of ns.
    pub sleep: &'a mut dyn FnMut(u64),
    /// Whether to end early.
    pub stop: &'a mut dyn FnMut() -> bool,
    /// Passes a heartbeat to the guard, with whether torque is on. Returns false when the guard has died.
    pub beat: &'a mut dyn FnMut(bool) -> bool,
}

/// Moves one joint and returns its state afterwards.
///
/// # Errors
/// Before torque: when the servo does not answer or reports an error, or the goal is out of range. Afterwards:
/// when it does not arrive. Torque is off then.
pub fn jog(bus: &mut Bus, motion: Jog, context: &mut JogContext) -> Result<ServoReading, ToolError> {
    let Jog { id, by, speed, .. } = motion;
    let series = bus.series();
    let (start, goal) = prepare(bus, motion)?;
    let guarded = TorqueGuard { bus, id };
    // Otherwise the servo would first move to its old goal.
    if !(context.beat)(true) {
        return Err(ToolError::Failed("the guard process has died; torque stays off without one".to_owned()));
    }
    guarded.bus.write(id, series.goal_position, start)?;
    guarded.bus.write(id, series.torque_enable, 1)?;
    guarded.bus.write(id, series.goal_position, goal)?;
    let deadline = guarded.bus.now() + ((by.abs() / speed + 2.0) * 1e9) as u64;
    let mut arrived = false;
    while !arrived && guarded.bus.now() < deadline && !(context.stop)() && (context.beat)(true) {
        (context.sleep)(READ_INTERVAL);
        arrived = (guarded.bus.read(id, series.position)? - goal).abs() <= TOLERANCE;
    }
    drop(guarded);
    (context.beat)(false);
    let after = read_state(bus, id)?;
    if after.torque {
        return Err(ToolError::Failed(format!("servo {id} keeps its torque; take the power away")));
    }
    if !arrived {
        let moved = rad(shorter_way(start, after.position));
        return Err(ToolError::Failed(format!("servo {id} went {moved:.3} rad and did not arrive; torque is off")));
    }
    Ok(after)
}

/// All checks and settings before torque. Returns the position at which the servo stands and the goal, steps.
fn prepare(bus: &mut Bus, motion: Jog) -> Result<(i32, i32), ToolError> {
    let Jog { id, by, speed, .. } = motion;
    let series = bus.series();
    if !(by.abs() <= std::f64::consts::PI && (0.01..=2.0).contains(&speed)) {
        let text = format!("--by {by} --speed {speed}: give at most half a turn (3.14 rad), and 0.01 to 2 rad/s");
        return Err(ToolError::Refused(text));
    }
    identify(bus, &[id])?;
    let before = read_state(bus, id)?;
    let homing = Some(bus.read(id, series.homing_offset)?);
    if before.errors != 0 {
        let text = format!(
            "servo {id} reports an error (bits {:#04x}); find its cause, then take its power away and give it again",
            before.errors
        );
        return Err(ToolError::Refused(text));
    }
    let joint = joint_of(bus, motion)?;
    // Without a calibration the offset does not matter: the motion is relative.
    check_registers(bus, id, |kept| match joint {
        Some(joint) => joint.registers.get(kept.name).copied(),
        None => (kept.name == "homing_offset").then_some(()).and(homing),
    })?;
    let goal = goal(motion, joint, &before)?;
    bus.torque_off(&[id]);
    if let Some(watchdog) = series.bus_watchdog {
        // One that has stopped the servo, after the death of another program, refuses goals until it is cleared.
        bus.write(id, watchdog, 0)?;
    }
    bus.write(id, series.operating_mode, i32::from(series.position_mode))?;
    // The change of mode maps positions of more than a turn to those within one.
    let start = bus.read(id, series.position)?;
    let goal = start + shorter_way(before.position, goal).clamp(-2047, 2047);
    if !(0..=4095).contains(&goal) {
        let text = format!("servo {id} would have to go to {goal}, past its own zero; it goes from 0 to 4095");
        return Err(ToolError::Refused(text));
    }
    let ends = joint.and_then(JointConfig::raw_ends).unwrap_or([0, 4095]);
    // A joint at the very end of its range may stand a step beyond it.
    let (goal, hold) = (goal.clamp(ends[0], ends[1]), start.clamp(ends[0], ends[1]));
    bus.limit_goals(vec![(id, ends)]);
    let units = |value: f64, unit: f64| libm::ceil(value / unit).max(1.0) as i32;
    bus.write(id, series.profile_velocity, units(speed, series.speed_unit))?;
    Ok((hold, goal))
}

/// The joint of the calibration that the motion names.
fn joint_of<'a>(bus: &Bus, motion: Jog<'a>) -> Result<Option<&'a JointConfig>, ToolError> {
    let Some(calibration) = motion.calibration else { return Ok(None) };
    if calibration.protocol != bus.series().protocol {
        let text = "the calibration is for servos of the other protocol: it is another arm's".to_owned();
        return Err(ToolError::Refused(text));
    }
    let Some(joint) = calibration.joints.iter().find(|joint| joint.id == motion.id) else {
        let ids: Vec<_> = calibration.joints.iter().map(|joint| joint.id.to_string()).collect();
        let text = format!("the calibration has no servo {} but {}: it is another arm's", motion.id, ids.join(", "));
        return Err(ToolError::Refused(text));
    };
    joint.check_seam().map_err(|text| ToolError::Refused(format!("servo {}: {text}", motion.id)))?;
    Ok(Some(joint))
}

/// The goal in steps, within the joint's range.
fn goal(motion: Jog, joint: Option<&JointConfig>, before: &ServoReading) -> Result<i32, ToolError> {
    let steps = libm::round(motion.by / STEP) as i32;
    let Some(joint) = joint else { return Ok(before.position + steps) };
    let angle = rad(shorter_way(joint.zero, before.position) * joint.direction);
    let [low, high] = joint.range;
    if !joint.is_free() && !(low - STEP..=high + STEP).contains(&(angle + motion.by)) {
        let text = format!(
            "servo {} stands at {angle:.3} rad and would go to {:.3}, outside its range of {low:.3} to {high:.3} rad",
            motion.id,
            angle + motion.by
        );
        return Err(ToolError::Refused(text));
    }
    Ok(before.position + steps * joint.direction)
}
