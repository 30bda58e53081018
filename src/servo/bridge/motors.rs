//! Reading from and writing to the motors.

use super::{Bridge, TripCause, chain};
use crate::scenario::ServoGoal;
use crate::servo::guard::SILENT_PERIODS;
use crate::servo::model::{RegisterBlock, STEP, error_bit};
use crate::wire::MAX_OUTPUTS;

/// Value of Dynamixel's bus watchdog, in units of 20 ms: without instructions for this time the servo stops, and takes
/// no goals any more. That is as long as the guard waits, so that a bridge that goes on after a shorter pause moves the
/// arm, and after a longer one arms it again.
fn watchdog(period_ns: u64) -> i32 {
    const UNIT_NS: u64 = 20_000_000;
    // Values above 127 have another meaning; below 10 a pause of the machine would stop the arm.
    (period_ns * SILENT_PERIODS).div_ceil(UNIT_NS).clamp(10, 127) as i32
}

impl Bridge {
    /// Reads all servos. Returns their health, or `None` if not all of them answered, and the duration, ns.
    pub(super) fn measure(&mut self) -> (Option<Result<(), TripCause>>, u64) {
        let (state, series) = (self.bus.series().state, self.bus.series());
        let (answers, took) = self.bus.sync_read(&self.ids, state);
        let answers = match answers {
            Ok(answers) => {
                self.silence = None;
                answers
            }
            Err(error) => {
                // What failed first is the cause; what follows may be late answers.
                self.silence.get_or_insert(error);
                return (None, took);
            }
        };
        let mut health = Ok(());
        for (i, answer) in answers.iter().enumerate() {
            let get = |register| state.decode(register, &answer.bytes).unwrap_or(0);
            self.raw[i] = get(series.position);
            let joint = &self.joints[i];
            self.motors[i] = chain::angle(joint, self.raw[i]);
            if !joint.is_free() {
                // A reading beyond the encoder's 0 stands at the other end of the turn. Goals begin on this side.
                self.raw[i] = chain::raw(joint, self.motors[i]);
            }
            let volts = f64::from(get(series.voltage)) * 0.1;
            if f64::from(get(series.temperature)) > self.config.max_temperature {
                health = Err(TripCause::Heat);
            } else if volts < self.config.min_voltage {
                health = Err(TripCause::Voltage);
            } else if answer.error != 0 {
                health = Err(self.error_cause(self.ids[i], answer.error));
            }
        }
        chain::outputs(self.angles, &self.motors[..self.moving], &mut self.theta);
        (Some(health), took)
    }

    /// The cause of a servo's error. Dynamixel only reports that there is one, so the error register is read.
    fn error_cause(&mut self, id: u8, error: u8) -> TripCause {
        let register = self.bus.series().hardware_error;
        let bits = self.bus.read(id, register).map_or(error, |bits| bits as u8);
        match bits {
            bits if bits & error_bit::HEAT != 0 => TripCause::Heat,
            bits if bits & error_bit::OVERLOAD != 0 => TripCause::Overload,
            bits if bits & error_bit::VOLTAGE != 0 => TripCause::Voltage,
            _ => TripCause::TorqueLost,
        }
    }

    /// Writes the motors' goals for these rates. Returns whether that succeeded.
    pub(super) fn write_goals(&mut self, rates: &[f64; MAX_OUTPUTS]) -> bool {
        let (series, period) = (self.bus.series(), f64::from(self.period));
        let goal = match self.config.goal() {
            ServoGoal::Speed => series.goal_velocity,
            ServoGoal::Position => series.goal_position,
        };
        // An arm that holds its position keeps the one at which it began to hold, even if it is pulled away.
        let mut from = self.hold_position.unwrap_or(self.raw);
        // So do joints that no command moves.
        let held_at = self.held_at.unwrap_or(from);
        from[self.moving..].copy_from_slice(&held_at[self.moving..]);
        let value = |i: usize| {
            let (joint, rate) = (&self.joints[i], rates[i]);
            match self.config.goal() {
                ServoGoal::Speed => f64::from(joint.direction) * rate / series.speed_unit,
                ServoGoal::Position => {
                    let goal = f64::from(from[i]) + f64::from(joint.direction) * rate * period / STEP;
                    joint.raw_ends().map_or(goal, |[low, high]| goal.clamp(f64::from(low), f64::from(high)))
                }
            }
        };
        let width = usize::from(goal.width);
        let data: Vec<_> =
            (0..self.ids.len()).map(|i| goal.encode(libm::rint(value(i)) as i32)[..width].to_vec()).collect();
        let (result, took) = self.bus.sync_write(&self.ids, goal.address, &data);
        self.write_ns += took;
        if let Err(error) = result {
            self.silence.get_or_insert(error);
            return false;
        }
        true
    }

    /// Turns torque on at standstill. Goals are written first, because a servo moves to its old goal when
    /// torque comes on. Returns whether that succeeded.
    pub(super) fn turn_torque_on(&mut self) -> bool {
        if self.config.goal() == ServoGoal::Speed && self.bus.series().bus_watchdog.is_some() {
            let register = self.bus.series().bus_watchdog.expect("there is one");
            let watchdog = watchdog(self.presence.period());
            // A watchdog that has stopped the servo refuses goals until it is cleared.
            if self.bus.sync_set(&self.ids, register, |_| 0).is_err()
                || self.bus.sync_set(&self.ids, register, |_| watchdog).is_err()
            {
                return false;
            }
        }
        self.held_at = Some(self.raw);
        let written = self.write_goals(&[0.0; MAX_OUTPUTS]);
        let torque = self.bus.series().torque_enable;
        // Some servos keep a goal only while torque is on, so it is written again.
        written && self.bus.sync_set(&self.ids, torque, |_| 1).is_ok() && self.write_goals(&[0.0; MAX_OUTPUTS])
    }

    /// Turns torque off.
    pub(super) fn turn_torque_off(&mut self) {
        let began = self.bus.now();
        let torque = self.bus.series().torque_enable;
        let _ = self.bus.sync_set(&self.ids, torque, |_| 0);
        self.write_ns += self.bus.now() - began;
    }

    /// Whether torque is on in all servos; true if that cannot be read.
    pub(super) fn has_torque(&mut self) -> bool {
        let torque = self.bus.series().torque_enable;
        let block = RegisterBlock { address: torque.address, length: torque.width };
        match self.bus.sync_read(&self.ids, block).0 {
            Ok(answers) => answers.iter().all(|answer| torque.decode(&answer.bytes) == 1),
            Err(_) => true,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_watchdog_waits_as_long_as_the_guard() {
        let ms = |period_ms: u64| 20 * watchdog(period_ms * 1_000_000);
        assert_eq!([10, 50, 100, 200, 1000].map(ms), [200, 200, 400, 800, 2540]);
    }
}
