//! The motors themselves: what is read of them, and what is written to them.

use super::{Bridge, TripCause, chain};
use crate::scenario::ServoGoal;
use crate::servo::model::{RegisterBlock, STEP, error_bit};
use crate::wire::MAX_OUTPUTS;

/// Dynamixel's bus watchdog counts in 20 ms; the servo stops when it hears nothing for so long.
const WATCHDOG: i32 = 10;

impl Bridge {
    /// Reads all servos; what they say of themselves, and the time that it took, ns.
    pub(super) fn measure(&mut self) -> (Result<Result<(), TripCause>, ()>, u64) {
        let (state, series) = (self.bus.series().state, self.bus.series());
        let (answers, took) = self.bus.sync_read(&self.ids, state);
        let Ok(answers) = answers else { return (Err(()), took) };
        let mut health = Ok(());
        for (i, answer) in answers.iter().enumerate() {
            let get = |register| state.decode(register, &answer.bytes).unwrap_or(0);
            self.raw[i] = get(series.position);
            let joint = &self.joints[i];
            self.motors[i] = chain::angle(joint, self.raw[i]);
            let volts = f64::from(get(series.voltage)) * 0.1;
            if f64::from(get(series.temperature)) > self.table.max_temperature {
                health = Err(TripCause::Heat);
            } else if volts < self.table.min_voltage {
                health = Err(TripCause::Voltage);
            } else if answer.error != 0 {
                health = Err(self.trouble(self.ids[i], answer.error));
            }
        }
        chain::outputs(self.angles, &self.motors[..self.ids.len()], &mut self.theta);
        (Ok(health), took)
    }

    /// What a servo's error means. Dynamixel only says that there is one.
    fn trouble(&mut self, id: u8, error: u8) -> TripCause {
        let register = self.bus.series().hardware_error;
        let bits = self.bus.read(id, register).map_or(error, |bits| bits as u8);
        match bits {
            bits if bits & error_bit::HEAT != 0 => TripCause::Heat,
            bits if bits & error_bit::OVERLOAD != 0 => TripCause::Overload,
            bits if bits & error_bit::VOLTAGE != 0 => TripCause::Voltage,
            _ => TripCause::TorqueLost,
        }
    }

    /// Writes the motors' goals.
    pub(super) fn drive(&mut self, rates: &[f64; MAX_OUTPUTS]) -> bool {
        let (series, period) = (self.bus.series(), f64::from(self.period));
        let goal = match self.table.goal {
            ServoGoal::Speed => series.goal_velocity,
            ServoGoal::Position => series.goal_position,
        };
        // An arm that stands still stays where it began to, and does not follow what pulls at it.
        let from = self.rest.unwrap_or(self.raw);
        let value = |i: usize| {
            let (joint, rate) = (&self.joints[i], rates[i]);
            match self.table.goal {
                ServoGoal::Speed => f64::from(joint.direction) * rate / series.speed_unit,
                ServoGoal::Position => f64::from(from[i]) + f64::from(joint.direction) * rate * period / STEP,
            }
        };
        let width = usize::from(goal.width);
        let data: Vec<_> =
            (0..self.ids.len()).map(|i| goal.encode(libm::rint(value(i)) as i32)[..width].to_vec()).collect();
        let (result, took) = self.bus.sync_write(&self.ids, goal.address, &data);
        self.write_ns += took;
        result.is_ok()
    }

    /// Torque on, at a standstill: the goals first, since a servo goes to an old one when its torque comes on.
    pub(super) fn rise(&mut self) -> bool {
        if self.table.goal == ServoGoal::Speed && self.bus.series().bus_watchdog.is_some() {
            let register = self.bus.series().bus_watchdog.expect("there is one");
            // One that has bitten takes nothing else before it is cleared.
            if self.bus.sync_set(&self.ids, register, |_| 0).is_err()
                || self.bus.sync_set(&self.ids, register, |_| WATCHDOG).is_err()
            {
                return false;
            }
        }
        let still = self.drive(&[0.0; MAX_OUTPUTS]);
        let torque = self.bus.series().torque_enable;
        // Some servos keep a goal only while they have torque: said once more.
        still && self.bus.sync_set(&self.ids, torque, |_| 1).is_ok() && self.drive(&[0.0; MAX_OUTPUTS])
    }

    pub(super) fn off(&mut self) {
        let began = self.bus.now();
        let torque = self.bus.series().torque_enable;
        let _ = self.bus.sync_set(&self.ids, torque, |_| 0);
        self.write_ns += self.bus.now() - began;
    }

    /// Whether all have torque, where that can be read.
    pub(super) fn has_torque(&mut self) -> bool {
        let torque = self.bus.series().torque_enable;
        let block = RegisterBlock { address: torque.address, length: torque.width };
        match self.bus.sync_read(&self.ids, block).0 {
            Ok(answers) => answers.iter().all(|answer| torque.decode(&answer.bytes) == 1),
            Err(_) => true,
        }
    }
}
