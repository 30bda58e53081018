//! Series of servos: registers, units, signs, models.
//!
//! Two series are supported: Dynamixel X (XL, XC, XM, XH, XD and XW with three digits, such as XL330; protocol 2.0)
//! and Feetech STS (STS3215 and similar models, as in the SO-100 and SO-101 arms). Addresses and widths are
//! those of the manufacturers' manuals (<https://emanual.robotis.com/docs/en/dxl/x/xl330-m288/>, `xl430-w250`,
//! `xm430-w350`; Feetech's memory table of the STS series), and a test compares them with rustypot's tables.
//!
//! *Positions* have 4096 steps per turn in both series. *Signs*: Dynamixel uses two's complement; Feetech uses
//! a magnitude with a sign bit, bit 15 for positions and speeds, bit 10 for the load. *EEPROM*: Dynamixel
//! refuses writes below address 64 (access error) while torque is on. Feetech accepts them at any time; the
//! values survive a loss of power only if `lock` is 0.

mod models;
mod register;
mod settings;

pub use models::{MODELS, ServoModel, UnknownModel, foreign_model, model};
pub use register::{Register, RegisterBlock, SignEncoding};
pub use settings::KeptSetting;

use std::f64::consts::TAU;

use serde::{Deserialize, Serialize};

/// Steps of position per turn, in both series.
pub const STEPS_PER_TURN: i32 = 4096;

/// One step of position, rad.
pub const STEP: f64 = TAU / STEPS_PER_TURN as f64;

/// The protocol of the servos on a bus.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Protocol {
    /// Dynamixel protocol 2.0, X series.
    Dynamixel,
    /// Feetech's form of protocol 1.0, STS series.
    Feetech,
}

/// A series of servos: registers, units and modes.
#[derive(Debug, Clone, Copy)]
pub struct ServoSeries {
    /// Its protocol.
    pub protocol: Protocol,
    /// Name for messages.
    pub name: &'static str,
    /// Model number, read only.
    pub model: Register,
    /// The servo's id. EEPROM.
    pub id: Register,
    /// Baud rate, as an index into [`ServoSeries::bauds`]. EEPROM.
    pub baud: Register,
    /// Return delay of answers, in units of 2 us. EEPROM.
    pub return_delay: Register,
    /// Position or velocity, see [`ServoSeries::position_mode`]. EEPROM.
    pub operating_mode: Register,
    /// Limit of temperature, degrees Celsius. EEPROM.
    pub temperature_limit: Register,
    /// Highest voltage, 0.1 V. EEPROM.
    pub max_voltage: Register,
    /// Lowest voltage, 0.1 V. EEPROM.
    pub min_voltage: Register,
    /// Limit of speed, in units of speed, where there is one. EEPROM.
    pub velocity_limit: Option<Register>,
    /// Lowest goal position, steps. EEPROM. Both series ignore it in velocity mode.
    pub min_position: Register,
    /// Highest goal position, steps. EEPROM.
    pub max_position: Register,
    /// Offset of all positions, steps. EEPROM.
    pub homing_offset: Register,
    /// Sign with which the offset is added to what the encoder says.
    pub homing_sign: i32,
    /// Largest offset that position mode takes, steps.
    pub homing_limit: i32,
    /// Registers that are compared before torque comes on.
    pub kept: &'static [KeptSetting],
    /// Which errors turn torque off, as bits of [`ServoSeries::hardware_error`]. EEPROM.
    pub shutdown: Register,
    /// Torque: 1 on, 0 off.
    pub torque_enable: Register,
    /// Active errors: bit 0 voltage, bit 2 heat, bit 5 overload in both series.
    pub hardware_error: Register,
    /// Bus watchdog: stops the servo when there is no instruction for this many times 20 ms; 0 disables it, 255
    /// means that it has stopped the servo. Only Dynamixel.
    pub bus_watchdog: Option<Register>,
    /// Goal speed in velocity mode.
    pub goal_velocity: Register,
    /// Acceleration of motions; 0 for no limit.
    pub profile_acceleration: Register,
    /// Speed of motions in position mode; 0 for no limit. With Feetech it is the register of the goal speed.
    pub profile_velocity: Register,
    /// Goal position in position mode.
    pub goal_position: Register,
    /// What the servo answers: 0 pings only, 1 reads too, 2 everything. With Feetech 0 reads too, 1 everything.
    pub response_level: Register,
    /// EEPROM lock: 0 open, 1 locked. Only Feetech.
    pub lock: Option<Register>,
    /// Present load, in 0.1 % of the greatest load (current, if the model measures it).
    pub load: Register,
    /// Present speed.
    pub velocity: Register,
    /// Present position, steps.
    pub position: Register,
    /// Present voltage, 0.1 V.
    pub voltage: Register,
    /// Present temperature, degrees Celsius.
    pub temperature: Register,
    /// 1 while the shaft moves.
    pub moving: Register,
    /// Block with position, speed and load.
    pub motion: RegisterBlock,
    /// [`ServoSeries::motion`] with voltage and temperature, which the bridge reads in every tick.
    pub state: RegisterBlock,
    /// One unit of speed, rad/s.
    pub speed_unit: f64,
    /// One unit of acceleration, rad/s^2.
    pub acceleration_unit: f64,
    /// The operating mode in which goals are positions.
    pub position_mode: u8,
    /// The operating mode in which goals are speeds.
    pub velocity_mode: u8,
    /// Baud rates with their register values.
    pub bauds: &'static [(u32, u8)],
    /// Baud rate of the factory settings.
    pub factory_baud: u32,
    /// Highest id.
    pub max_id: u8,
    /// EEPROM addresses: the first one, and the first one after them.
    pub eeprom: (u8, u8),
}

/// Bits of [`ServoSeries::hardware_error`] and [`ServoSeries::shutdown`] that both series have in common.
pub mod error_bit {
    /// Voltage outside its limits.
    pub const VOLTAGE: u8 = 1 << 0;
    /// Temperature above its limit.
    pub const HEAT: u8 = 1 << 2;
    /// Load above what the servo can sustain.
    pub const OVERLOAD: u8 = 1 << 5;
}

/// Dynamixel X: protocol 2.0. The unit of speed is 0.229 rpm, that of acceleration 214.577 revolutions per
/// minute squared.
pub const DYNAMIXEL_X: ServoSeries = ServoSeries {
    protocol: Protocol::Dynamixel,
    name: "Dynamixel X",
    model: Register::unsigned(0, 2),
    id: Register::unsigned(7, 1),
    baud: Register::unsigned(8, 1),
    return_delay: Register::unsigned(9, 1),
    operating_mode: Register::unsigned(11, 1),
    temperature_limit: Register::unsigned(31, 1),
    max_voltage: Register::unsigned(32, 2),
    min_voltage: Register::unsigned(34, 2),
    velocity_limit: Some(Register::unsigned(44, 4)),
    max_position: Register::unsigned(48, 4),
    min_position: Register::unsigned(52, 4),
    homing_offset: settings::DYNAMIXEL_HOMING,
    homing_sign: 1,
    homing_limit: 1024,
    kept: settings::DYNAMIXEL,
    shutdown: Register::unsigned(63, 1),
    torque_enable: Register::unsigned(64, 1),
    response_level: Register::unsigned(68, 1),
    hardware_error: Register::unsigned(70, 1),
    bus_watchdog: Some(Register::unsigned(98, 1)),
    goal_velocity: Register::new(104, 4, SignEncoding::TwosComplement),
    profile_acceleration: Register::unsigned(108, 4),
    profile_velocity: Register::unsigned(112, 4),
    goal_position: Register::new(116, 4, SignEncoding::TwosComplement),
    lock: None,
    moving: Register::unsigned(122, 1),
    load: Register::new(126, 2, SignEncoding::TwosComplement),
    velocity: Register::new(128, 4, SignEncoding::TwosComplement),
    position: Register::new(132, 4, SignEncoding::TwosComplement),
    voltage: Register::unsigned(144, 2),
    temperature: Register::unsigned(146, 1),
    motion: RegisterBlock { address: 126, length: 10 },
    state: RegisterBlock { address: 126, length: 21 },
    speed_unit: 0.229 * TAU / 60.0,
    acceleration_unit: 214.577 * TAU / 3600.0,
    position_mode: 3,
    velocity_mode: 1,
    bauds: &[(9_600, 0), (57_600, 1), (115_200, 2), (1_000_000, 3), (2_000_000, 4), (3_000_000, 5), (4_000_000, 6)],
    factory_baud: 57_600,
    max_id: 252,
    eeprom: (0, 64),
};

/// Feetech STS3215 and similar models. The unit of speed is one step per second, that of acceleration a hundred
/// steps per second squared.
pub const FEETECH_STS: ServoSeries = ServoSeries {
    protocol: Protocol::Feetech,
    name: "Feetech STS",
    model: Register::unsigned(3, 2),
    response_level: Register::unsigned(8, 1),
    id: Register::unsigned(5, 1),
    baud: Register::unsigned(6, 1),
    return_delay: Register::unsigned(7, 1),
    min_position: Register::unsigned(9, 2),
    max_position: Register::unsigned(11, 2),
    temperature_limit: Register::unsigned(13, 1),
    max_voltage: Register::unsigned(14, 1),
    min_voltage: Register::unsigned(15, 1),
    velocity_limit: None,
    homing_offset: settings::FEETECH_HOMING,
    homing_sign: -1,
    homing_limit: 2047,
    kept: settings::FEETECH,
    shutdown: Register::unsigned(19, 1),
    operating_mode: Register::unsigned(33, 1),
    torque_enable: Register::unsigned(40, 1),
    profile_acceleration: Register::unsigned(41, 1),
    goal_position: Register::new(42, 2, SignEncoding::Magnitude(15)),
    goal_velocity: Register::new(46, 2, SignEncoding::Magnitude(15)),
    profile_velocity: Register::new(46, 2, SignEncoding::Magnitude(15)),
    lock: Some(Register::unsigned(55, 1)),
    bus_watchdog: None,
    position: Register::new(56, 2, SignEncoding::Magnitude(15)),
    velocity: Register::new(58, 2, SignEncoding::Magnitude(15)),
    load: Register::new(60, 2, SignEncoding::Magnitude(10)),
    voltage: Register::unsigned(62, 1),
    temperature: Register::unsigned(63, 1),
    hardware_error: Register::unsigned(65, 1),
    moving: Register::unsigned(66, 1),
    motion: RegisterBlock { address: 56, length: 6 },
    state: RegisterBlock { address: 56, length: 8 },
    speed_unit: STEP,
    acceleration_unit: 100.0 * STEP,
    position_mode: 0,
    velocity_mode: 1,
    bauds: &[
        (1_000_000, 0),
        (500_000, 1),
        (250_000, 2),
        (128_000, 3),
        (115_200, 4),
        (57_600, 5),
        (38_400, 6),
        (19_200, 7),
    ],
    factory_baud: 1_000_000,
    max_id: 253,
    eeprom: (0, 40),
};

impl Protocol {
    /// The names in files and on command lines.
    pub const NAMES: [&'static str; 2] = ["dynamixel", "feetech"];

    /// The name of this protocol.
    pub fn name(self) -> &'static str {
        Self::NAMES[self as usize]
    }

    /// The protocol with this name. Unknown names give Dynamixel; command lines accept only [`NAMES`](Self::NAMES).
    pub fn named(name: &str) -> Self {
        if name == Self::Feetech.name() { Self::Feetech } else { Self::Dynamixel }
    }

    /// The series with this protocol.
    pub fn series(self) -> &'static ServoSeries {
        match self {
            Protocol::Dynamixel => &DYNAMIXEL_X,
            Protocol::Feetech => &FEETECH_STS,
        }
    }
}

impl ServoSeries {
    /// Checks that the series supports a baud rate.
    ///
    /// # Errors
    /// The list of supported rates, for a message.
    pub fn check_baud(&self, baud: u32) -> Result<(), String> {
        if self.bauds.iter().any(|&(known, _)| known == baud) {
            return Ok(());
        }
        let known: Vec<_> = self.bauds.iter().map(|(baud, _)| baud.to_string()).collect();
        Err(known.join(", "))
    }
}

#[cfg(test)]
mod tests;
