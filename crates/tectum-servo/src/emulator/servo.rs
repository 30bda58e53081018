//! One emulated servo: registers, shaft, watchdog and protections.

use rand_distr::{Distribution as _, StandardNormal};

use super::config::EmulatorConfig;
use super::motion::{MotorGoal, Shaft};
use super::table::ControlTable;
use crate::model::{Protocol, STEP, ServoModel, error_bit};
use tectum_core::seed::Rng;

/// Duration of an overload before the protection trips, where no register specifies it, ns.
const OVERLOAD_TIME: u64 = 2_000_000_000;

/// Faults that affect a servo.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct ServoFaultState {
    /// No power and no signals.
    pub off: bool,
    /// The joint is held fixed.
    pub held: bool,
    /// Voltage below the limit.
    pub low_voltage: bool,
    /// Temperature above the limit.
    pub hot: bool,
}

/// One emulated servo.
#[derive(Debug, Clone)]
pub struct EmulatedServo {
    /// Its registers.
    pub table: ControlTable,
    /// Its shaft.
    pub shaft: Shaft,
    faults: ServoFaultState,
    /// Time up to which it was simulated, ns.
    now: u64,
    /// Start of the current overload, ns.
    overload_since: Option<u64>,
    /// Whether an error has turned torque off until a restart (Dynamixel).
    failed: bool,
    /// Time of the last instruction on the bus, ns.
    last_instruction: u64,
    /// Distance that the shaft has turned since then, steps.
    travel: f64,
    /// The longest such distance between two instructions, steps.
    unattended: f64,
    voltage: i32,
    speed: f64,
    acceleration: f64,
    noise: f64,
}

impl EmulatedServo {
    /// A servo of `model` with this id, at position `at`, steps.
    pub fn new(model: &ServoModel, id: u8, baud: u32, at: f64, settings: &EmulatorConfig) -> Self {
        let table = ControlTable::new(model, id, baud);
        let small = model.protocol == Protocol::Dynamixel && table.get(table.series.max_voltage) == 70;
        let voltage = if small { 50 } else { 120 };
        let steps = |rad: Option<f64>| rad.map_or(f64::INFINITY, |rad| rad / STEP);
        let mut servo = Self {
            table,
            shaft: Shaft { at, speed: 0.0 },
            faults: ServoFaultState::default(),
            now: 0,
            overload_since: None,
            failed: false,
            last_instruction: 0,
            travel: 0.0,
            unattended: 0.0,
            voltage,
            speed: steps(settings.speed),
            acceleration: steps(settings.acceleration),
            noise: settings.noise,
        };
        servo.power_up();
        servo
    }

    /// Its id.
    pub fn id(&self) -> u8 {
        self.table.get(self.table.series.id) as u8
    }

    /// Whether it has power and signals.
    pub fn is_powered(&self) -> bool {
        !self.faults.off
    }

    /// Restarts the bus watchdog: there was an instruction on the bus at `now`.
    pub fn note_instruction(&mut self, now: u64) {
        self.last_instruction = self.last_instruction.max(now);
        self.unattended = self.unattended();
        self.travel = 0.0;
    }

    /// The longest distance that the shaft has turned without an instruction on the bus, steps.
    pub fn unattended(&self) -> f64 {
        self.unattended.max(self.travel)
    }

    /// Restarts: registers outside the EEPROM have their initial values, torque is off, the goal is the current
    /// position.
    pub fn power_up(&mut self) {
        self.table.lose_power();
        self.failed = false;
        self.overload_since = None;
        self.shaft = Shaft { at: self.shaft.at.rem_euclid(4096.0), speed: 0.0 };
        self.table.set(self.table.series.goal_position, self.present(self.shaft.at) as i32);
        self.last_instruction = self.now;
    }

    /// 1, or -1 if the drive mode turns the direction round (Dynamixel).
    fn sign(&self) -> f64 {
        let reversed = self.table.series.protocol == Protocol::Dynamixel
            && self.table.read(10, 1).is_some_and(|mode| mode[0] & 1 != 0);
        if reversed { -1.0 } else { 1.0 }
    }

    /// The position that the servo reports for a position of its shaft, steps: with drive mode and homing offset.
    fn present(&self, at: f64) -> f64 {
        let series = self.table.series;
        let position = self.sign() * at + f64::from(series.homing_sign * self.table.get(series.homing_offset));
        match series.protocol {
            Protocol::Feetech => position.rem_euclid(4096.0),
            Protocol::Dynamixel => position,
        }
    }

    /// Moves the shaft by hand. With torque on, nothing happens.
    pub fn move_by_hand(&mut self, at: f64) {
        if !self.has_torque() {
            self.shaft = Shaft { at, speed: 0.0 };
            self.wrap();
        }
    }

    /// Simulates until `now`, with these faults.
    pub fn advance(&mut self, now: u64, faults: ServoFaultState) {
        if faults != self.faults {
            let power_returned = (self.faults.off && !faults.off) || (self.faults.low_voltage && !faults.low_voltage);
            self.faults = faults;
            if power_returned {
                self.power_up();
            }
        }
        self.check_protections();
        while self.now < now {
            let events = [self.watchdog_deadline(), self.overload_deadline(), Some(now)];
            let next = events.into_iter().flatten().filter(|&at| at > self.now).min().unwrap_or(now).min(now);
            let seconds = (next - self.now) as f64 / 1e9;
            let acceleration = self.acceleration_limit();
            let from = self.shaft.at;
            self.shaft.advance(self.goal(), acceleration, seconds);
            self.travel += (self.shaft.at - from).abs();
            self.wrap();
            self.now = next;
            self.check_protections();
        }
    }

    /// Whether torque is on and the servo has power.
    pub fn has_torque(&self) -> bool {
        self.table.torque() && !self.faults.off
    }

    /// Executes a write of the host.
    ///
    /// # Errors
    /// Protocol 2.0's error number.
    pub fn write(&mut self, address: u16, bytes: &[u8]) -> Result<(), u8> {
        let series = self.table.series;
        let (mode, had_torque) = (self.table.get(series.operating_mode), self.table.torque());
        let goal = u16::from(series.goal_position.address);
        self.table.write(address, bytes, self.failed)?;
        if self.table.get(series.operating_mode) != mode && series.protocol == Protocol::Dynamixel {
            self.shaft.at = self.shaft.at.rem_euclid(4096.0);
            self.table.set(series.goal_position, self.present(self.shaft.at) as i32);
            self.table.set(series.goal_velocity, 0);
        }
        if self.table.torque()
            && !had_torque
            && self.table.get(series.operating_mode) == i32::from(series.position_mode)
        {
            // Within one turn from here on; Feetech's positions always are.
            self.shaft.at = self.shaft.at.rem_euclid(4096.0);
        }
        let goal_written = (address..address + bytes.len() as u16).contains(&goal);
        if series.protocol == Protocol::Feetech && goal_written && self.in_position_mode() && self.errors() == 0 {
            self.table.set(series.torque_enable, 1);
        }
        if !self.has_torque() {
            self.overload_since = None;
        }
        Ok(())
    }

    /// The registers, updated with the current measurements.
    pub fn measured(&mut self, rng: &mut Rng) -> &ControlTable {
        let series = self.table.series;
        let noise: f64 = if self.noise > 0.0 { StandardNormal.sample(rng) } else { 0.0 };
        let mut at = self.present(self.shaft.at + noise * self.noise).round() as i32;
        if series.protocol == Protocol::Feetech {
            at = at.rem_euclid(4096);
        }
        let speed = (self.sign() * self.shaft.speed * STEP / series.speed_unit).round() as i32;
        let load = self.load();
        let hot = self.table.get(series.temperature_limit) + 5;
        let low = self.table.get(series.min_voltage) - 5;
        for (register, value) in [
            (series.position, at),
            (series.velocity, speed),
            (series.load, load),
            (series.moving, i32::from(speed != 0)),
            (series.voltage, if self.faults.low_voltage { low } else { self.voltage }),
            (series.temperature, if self.faults.hot { hot } else { 32 }),
        ] {
            self.table.set(register, value);
        }
        &self.table
    }

    /// The part of the error byte that reports the servo's condition.
    pub fn alert(&self) -> u8 {
        match self.table.series.protocol {
            Protocol::Dynamixel if self.errors() != 0 => 0x80,
            Protocol::Dynamixel => 0,
            Protocol::Feetech => self.errors(),
        }
    }

    fn errors(&self) -> u8 {
        self.table.get(self.table.series.hardware_error) as u8
    }

    fn in_position_mode(&self) -> bool {
        let mode = self.table.get(self.table.series.operating_mode);
        match self.table.series.protocol {
            Protocol::Dynamixel => matches!(mode, 3..=5),
            Protocol::Feetech => mode == 0,
        }
    }

    /// The goal in the registers.
    fn requested_goal(&self) -> MotorGoal {
        let series = self.table.series;
        let unit = series.speed_unit / STEP;
        let speed = |raw: i32| f64::from(raw) * unit;
        if !self.has_torque() {
            return MotorGoal::Rest;
        }
        if self.in_position_mode() {
            let mut at = self.table.get(series.goal_position);
            let (low, high) = (self.table.get(series.min_position), self.table.get(series.max_position));
            if series.protocol == Protocol::Feetech && low < high {
                at = at.clamp(low, high);
            }
            let profile = self.table.get(series.profile_velocity).abs();
            let profile = if profile == 0 { f64::INFINITY } else { speed(profile) };
            let limit = series.velocity_limit.map_or(f64::INFINITY, |limit| speed(self.table.get(limit)));
            let at = self.shaft.at + self.sign() * (f64::from(at) - self.present(self.shaft.at));
            return MotorGoal::Position { at, speed: profile.min(limit).min(self.speed) };
        }
        if self.table.get(series.operating_mode) == i32::from(series.velocity_mode) {
            let goal = self.sign() * speed(self.table.get(series.goal_velocity));
            return MotorGoal::Speed(goal.clamp(-self.speed, self.speed));
        }
        MotorGoal::Rest
    }

    /// The goal of the shaft, which rests while it is held fixed.
    fn goal(&self) -> MotorGoal {
        if self.faults.held { MotorGoal::Rest } else { self.requested_goal() }
    }

    /// Direction in which the motor pushes while the joint is held fixed: 1, -1, or 0.
    fn blocked_direction(&self) -> i32 {
        if !self.faults.held {
            return 0;
        }
        match self.requested_goal() {
            MotorGoal::Rest => 0,
            MotorGoal::Speed(speed) => i32::from(speed > 0.0) - i32::from(speed < 0.0),
            MotorGoal::Position { at, .. } => {
                let distance = at - self.shaft.at;
                i32::from(distance > 1.0) - i32::from(distance < -1.0)
            }
        }
    }

    /// Load in units of 0.1 %: 100 % while the joint is held fixed, 5 % while it turns.
    fn load(&self) -> i32 {
        match self.blocked_direction() {
            0 if self.has_torque() && self.shaft.speed != 0.0 => 50 * if self.shaft.speed > 0.0 { 1 } else { -1 },
            direction => 1000 * direction,
        }
    }

    fn acceleration_limit(&self) -> f64 {
        let series = self.table.series;
        let profile = f64::from(self.table.get(series.profile_acceleration)) * series.acceleration_unit / STEP;
        if profile > 0.0 { profile.min(self.acceleration) } else { self.acceleration }
    }

    /// Feetech positions are within one turn.
    fn wrap(&mut self) {
        if self.table.series.protocol == Protocol::Feetech && !(0.0..4096.0).contains(&self.shaft.at) {
            self.shaft.at = self.shaft.at.rem_euclid(4096.0);
        }
    }

    /// When the bus watchdog stops the servo, ns.
    fn watchdog_deadline(&self) -> Option<u64> {
        let wait = self.table.get(self.table.series.bus_watchdog?);
        (self.has_torque() && (1..=127).contains(&wait)).then(|| self.last_instruction + wait as u64 * 20_000_000)
    }

    /// When the overload protection trips, ns.
    fn overload_deadline(&self) -> Option<u64> {
        let duration = match self.table.series.protocol {
            Protocol::Dynamixel => OVERLOAD_TIME,
            Protocol::Feetech => u64::from(self.table.read(35, 1)?[0]) * 10_000_000,
        };
        self.overload_since.map(|since| since + duration)
    }

    /// Applies watchdog and protections at `self.now`.
    fn check_protections(&mut self) {
        let series = self.table.series;
        if let Some(watchdog) = series.bus_watchdog
            && self.watchdog_deadline().is_some_and(|at| self.now >= at)
        {
            self.table.set(watchdog, 255);
            self.table.set(series.goal_velocity, 0);
            self.table.set(series.goal_position, self.shaft.at.round() as i32);
            self.shaft.speed = 0.0;
        }
        if self.blocked_direction() == 0 {
            self.overload_since = None;
        } else if self.overload_since.is_none() {
            self.overload_since = Some(self.now);
        }
        let overloaded = self.overload_deadline().is_some_and(|at| self.now >= at);
        let bits = [
            (overloaded, error_bit::OVERLOAD),
            (self.faults.hot, error_bit::HEAT),
            (self.faults.low_voltage, error_bit::VOLTAGE),
        ];
        let current = bits.iter().filter(|(active, _)| *active).fold(0, |all, (_, bit)| all | bit);
        // A Dynamixel keeps its errors until a restart. A Feetech clears heat and voltage errors when their
        // cause ends, and an overload when the joint is no longer held.
        let kept = match series.protocol {
            Protocol::Dynamixel => self.errors(),
            Protocol::Feetech if self.faults.held => self.errors() & error_bit::OVERLOAD,
            Protocol::Feetech => 0,
        };
        let errors = current | kept;
        if errors != self.errors() {
            self.table.set(series.hardware_error, i32::from(errors));
        }
        if errors & self.table.get(series.shutdown) as u8 != 0 {
            self.failed = series.protocol == Protocol::Dynamixel;
            self.table.set(series.torque_enable, 0);
            self.shaft.speed = 0.0;
            self.overload_since = None;
        }
    }
}
