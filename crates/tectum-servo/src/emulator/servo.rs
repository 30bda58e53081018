//! One servo of the chain: registers, shaft, protections.

use rand_distr::{Distribution as _, StandardNormal};

use super::config::EmulatorConfig;
use super::motion::{MotorGoal, Shaft};
use super::table::ControlTable;
use crate::model::{Protocol, STEP, ServoModel, error_bit};
use tectum_core::seed::Rng;

/// How long an overload is borne before the protection trips, where no register says it, ns.
const PATIENCE: u64 = 2_000_000_000;

/// What befalls a servo at the moment.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct ServoFaultState {
    /// No power and no signals.
    pub off: bool,
    /// Held fast.
    pub held: bool,
    /// Voltage below the limit.
    pub low: bool,
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
    plight: ServoFaultState,
    /// Until when it has lived, ns.
    now: u64,
    /// Since when it strains against what holds it, ns.
    straining: Option<u64>,
    /// Whether an error has turned it off until it starts anew (Dynamixel).
    failed: bool,
    /// When it last heard an instruction, ns.
    heard: u64,
    voltage: i32,
    speed: f64,
    acceleration: f64,
    noise: f64,
}

impl EmulatedServo {
    /// A servo of `model` with this id, standing at `at` steps.
    pub fn new(model: &ServoModel, id: u8, baud: u32, at: f64, settings: &EmulatorConfig) -> Self {
        let table = ControlTable::new(model, id, baud);
        let small = model.protocol == Protocol::Dynamixel && table.get(table.series.max_voltage) == 70;
        let voltage = if small { 50 } else { 120 };
        let steps = |rad: Option<f64>| rad.map_or(f64::INFINITY, |rad| rad / STEP);
        let mut servo = Self {
            table,
            shaft: Shaft { at, speed: 0.0 },
            plight: ServoFaultState::default(),
            now: 0,
            straining: None,
            failed: false,
            heard: 0,
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

    /// Whether it has power and hears.
    pub fn hears(&self) -> bool {
        !self.plight.off
    }

    /// Notes that an instruction was heard on the bus at `now`.
    pub fn hear(&mut self, now: u64) {
        self.heard = self.heard.max(now);
    }

    /// Starts anew: registers outside the EEPROM are what they are after power-up, torque is off, the goal is
    /// the posture.
    pub fn power_up(&mut self) {
        self.table.lose_power();
        self.failed = false;
        self.straining = None;
        self.shaft = Shaft { at: self.shaft.at.rem_euclid(4096.0), speed: 0.0 };
        self.table.set(self.table.series.goal_position, self.shaft.at as i32);
        self.heard = self.now;
    }

    /// Moves the shaft as a hand does. With torque on the motor is stronger and nothing happens.
    pub fn hand(&mut self, at: f64) {
        if !self.driven() {
            self.shaft = Shaft { at, speed: 0.0 };
            self.wrap();
        }
    }

    /// Lets time pass until `now`, in `plight`.
    pub fn advance(&mut self, now: u64, plight: ServoFaultState) {
        if plight != self.plight {
            let returned = (self.plight.off && !plight.off) || (self.plight.low && !plight.low);
            self.plight = plight;
            if returned {
                self.power_up();
            }
        }
        self.look_after_itself();
        while self.now < now {
            let events = [self.watchdog_bites(), self.protection_trips(), Some(now)];
            let next = events.into_iter().flatten().filter(|&at| at > self.now).min().unwrap_or(now).min(now);
            let seconds = (next - self.now) as f64 / 1e9;
            let acceleration = self.acceleration_limit();
            self.shaft.advance(self.aim(), acceleration, seconds);
            self.wrap();
            self.now = next;
            self.look_after_itself();
        }
    }

    /// Whether the motor holds or moves the shaft.
    pub fn driven(&self) -> bool {
        self.table.torque() && !self.plight.off
    }

    /// Writes as a host asks for it.
    ///
    /// # Errors
    /// Protocol 2.0's error number.
    pub fn write(&mut self, address: u16, bytes: &[u8]) -> Result<(), u8> {
        let series = self.table.series;
        let mode = self.table.get(series.operating_mode);
        let goal = u16::from(series.goal_position.address);
        self.table.write(address, bytes, self.failed)?;
        if self.table.get(series.operating_mode) != mode && series.protocol == Protocol::Dynamixel {
            self.shaft.at = self.shaft.at.rem_euclid(4096.0);
            self.table.set(series.goal_position, self.shaft.at as i32);
            self.table.set(series.goal_velocity, 0);
        }
        let goal_written = (address..address + bytes.len() as u16).contains(&goal);
        if series.protocol == Protocol::Feetech && goal_written && self.positions() && self.errors() == 0 {
            self.table.set(series.torque_enable, 1);
        }
        if !self.driven() {
            self.straining = None;
        }
        Ok(())
    }

    /// The registers with what is measured now in them.
    pub fn measured(&mut self, rng: &mut Rng) -> &ControlTable {
        let series = self.table.series;
        let noise: f64 = if self.noise > 0.0 { StandardNormal.sample(rng) } else { 0.0 };
        let mut at = (self.shaft.at + noise * self.noise).round() as i32;
        if series.protocol == Protocol::Feetech {
            at = at.rem_euclid(4096);
        }
        let speed = (self.shaft.speed * STEP / series.speed_unit).round() as i32;
        let load = self.load();
        let hot = self.table.get(series.temperature_limit) + 5;
        let low = self.table.get(series.min_voltage) - 5;
        for (register, value) in [
            (series.position, at),
            (series.velocity, speed),
            (series.load, load),
            (series.moving, i32::from(speed != 0)),
            (series.voltage, if self.plight.low { low } else { self.voltage }),
            (series.temperature, if self.plight.hot { hot } else { 32 }),
        ] {
            self.table.set(register, value);
        }
        &self.table
    }

    /// The error byte's part that says how the servo is.
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

    fn positions(&self) -> bool {
        let mode = self.table.get(self.table.series.operating_mode);
        match self.table.series.protocol {
            Protocol::Dynamixel => matches!(mode, 3..=5),
            Protocol::Feetech => mode == 0,
        }
    }

    /// What the registers ask for.
    fn wish(&self) -> MotorGoal {
        let series = self.table.series;
        let unit = series.speed_unit / STEP;
        let speed = |raw: i32| f64::from(raw) * unit;
        if !self.driven() {
            return MotorGoal::Rest;
        }
        if self.positions() {
            let mut at = self.table.get(series.goal_position);
            let (low, high) = (self.table.get(series.min_position), self.table.get(series.max_position));
            if series.protocol == Protocol::Feetech && low < high {
                at = at.clamp(low, high);
            }
            let most = self.table.get(series.profile_velocity).abs();
            let most = if most == 0 { f64::INFINITY } else { speed(most) };
            let limit = series.velocity_limit.map_or(f64::INFINITY, |limit| speed(self.table.get(limit)));
            return MotorGoal::Position { at: f64::from(at), speed: most.min(limit).min(self.speed) };
        }
        if self.table.get(series.operating_mode) == i32::from(series.velocity_mode) {
            return MotorGoal::Speed(speed(self.table.get(series.goal_velocity)).clamp(-self.speed, self.speed));
        }
        MotorGoal::Rest
    }

    fn aim(&self) -> MotorGoal {
        if self.plight.held { MotorGoal::Rest } else { self.wish() }
    }

    /// How hard the motor strains against what holds it: 1, -1, or 0.
    fn strain(&self) -> i32 {
        if !self.plight.held {
            return 0;
        }
        match self.wish() {
            MotorGoal::Rest => 0,
            MotorGoal::Speed(speed) => i32::from(speed > 0.0) - i32::from(speed < 0.0),
            MotorGoal::Position { at, .. } => {
                let way = at - self.shaft.at;
                i32::from(way > 1.0) - i32::from(way < -1.0)
            }
        }
    }

    /// Load in units of 0.1 %: all there is when held fast, a twentieth while it turns.
    fn load(&self) -> i32 {
        match self.strain() {
            0 if self.driven() && self.shaft.speed != 0.0 => 50 * if self.shaft.speed > 0.0 { 1 } else { -1 },
            strain => 1000 * strain,
        }
    }

    fn acceleration_limit(&self) -> f64 {
        let series = self.table.series;
        let profile = f64::from(self.table.get(series.profile_acceleration)) * series.acceleration_unit / STEP;
        if profile > 0.0 { profile.min(self.acceleration) } else { self.acceleration }
    }

    /// Feetech's positions are those within a turn.
    fn wrap(&mut self) {
        if self.table.series.protocol == Protocol::Feetech && !(0.0..4096.0).contains(&self.shaft.at) {
            self.shaft.at = self.shaft.at.rem_euclid(4096.0);
        }
    }

    fn watchdog_bites(&self) -> Option<u64> {
        let wait = self.table.get(self.table.series.bus_watchdog?);
        (self.driven() && (1..=127).contains(&wait)).then(|| self.heard + wait as u64 * 20_000_000)
    }

    fn protection_trips(&self) -> Option<u64> {
        let patience = match self.table.series.protocol {
            Protocol::Dynamixel => PATIENCE,
            Protocol::Feetech => u64::from(self.table.read(35, 1)?[0]) * 10_000_000,
        };
        self.straining.map(|since| since + patience)
    }

    /// Watchdog and protections, at `self.now`.
    fn look_after_itself(&mut self) {
        let series = self.table.series;
        if let Some(watchdog) = series.bus_watchdog
            && self.watchdog_bites().is_some_and(|at| self.now >= at)
        {
            self.table.set(watchdog, 255);
            self.table.set(series.goal_velocity, 0);
            self.table.set(series.goal_position, self.shaft.at.round() as i32);
            self.shaft.speed = 0.0;
        }
        if self.strain() == 0 {
            self.straining = None;
        } else if self.straining.is_none() {
            self.straining = Some(self.now);
        }
        let overloaded = self.protection_trips().is_some_and(|at| self.now >= at);
        let bits = [
            (overloaded, error_bit::OVERLOAD),
            (self.plight.hot, error_bit::HEAT),
            (self.plight.low, error_bit::VOLTAGE),
        ];
        let now = bits.iter().filter(|(holds, _)| *holds).fold(0, |all, (_, bit)| all | bit);
        // A Dynamixel keeps its errors until it starts anew; a Feetech forgets heat and voltage when they are
        // over, and an overload when nothing holds it any more.
        let kept = match series.protocol {
            Protocol::Dynamixel => self.errors(),
            Protocol::Feetech if self.plight.held => self.errors() & error_bit::OVERLOAD,
            Protocol::Feetech => 0,
        };
        let errors = now | kept;
        if errors != self.errors() {
            self.table.set(series.hardware_error, i32::from(errors));
        }
        if errors & self.table.get(series.shutdown) as u8 != 0 {
            self.failed = series.protocol == Protocol::Dynamixel;
            self.table.set(series.torque_enable, 0);
            self.shaft.speed = 0.0;
            self.straining = None;
        }
    }
}
