//! What a series of servos is like: registers, units, signs, models.
//!
//! Two series are known: Dynamixel X (XL330, XC330, XL430, XC430, XM430, XH430, XM540, XH540; protocol 2.0) and Feetech's STS3215 with
//! its kin (the SO-100 and SO-101 arms). Addresses and widths are those of the makers' manuals
//! (<https://emanual.robotis.com/docs/en/dxl/x/xl330-m288/>, `xl430-w250`, `xm430-w350`; Feetech's memory table of the STS series),
//! and a test holds every one of them to rustypot's tables.
//!
//! *Positions* count 4096 a turn in both series. *Signs*: Dynamixel has two's complement; Feetech has a magnitude with a
//! sign bit of its own, bit 15 for positions and speeds, bit 10 for the load.
//! *EEPROM*: Dynamixel refuses writes below address 64 (access error) while torque is on. Feetech takes them at any time; they outlive a
//! loss of power only if `lock` is 0.

use std::f64::consts::TAU;

use serde::{Deserialize, Serialize};

/// Positions a turn, of both series.
pub const STEPS_PER_TURN: i32 = 4096;

/// One step of position, rad.
pub const STEP: f64 = TAU / STEPS_PER_TURN as f64;

/// What the servos of a bus speak.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Protocol {
    /// Dynamixel protocol 2.0, X series.
    Dynamixel,
    /// Feetech's form of protocol 1.0, STS series.
    Feetech,
}

/// How a register carries a sign.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Sign {
    /// None: all bits count.
    Unsigned,
    /// Two's complement over the register's width.
    TwosComplement,
    /// A magnitude, and this bit for the sign.
    Magnitude(u8),
}

/// A register of the control table.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Register {
    /// Address of its first byte; the lowest byte comes first in both series.
    pub address: u8,
    /// Width, bytes: 1, 2 or 4.
    pub width: u8,
    /// How it carries a sign.
    pub sign: Sign,
}

impl Register {
    const fn new(address: u8, width: u8, sign: Sign) -> Self {
        Self { address, width, sign }
    }

    const fn unsigned(address: u8, width: u8) -> Self {
        Self::new(address, width, Sign::Unsigned)
    }

    /// The register's bytes for `value`; only the first [`Register::width`] of them count. A value that does not fit is cut to the largest one
    /// that does.
    pub fn encode(self, value: i32) -> [u8; 4] {
        let bits = u32::from(self.width) * 8;
        let raw = match self.sign {
            Sign::Unsigned => {
                let most = if bits == 32 { i64::from(u32::MAX) } else { (1_i64 << bits) - 1 };
                i64::from(value).clamp(0, most) as u32
            }
            Sign::TwosComplement => {
                let most = (1_i64 << (bits - 1)) - 1;
                i64::from(value).clamp(-most - 1, most) as u32
            }
            Sign::Magnitude(bit) => {
                let magnitude = value.unsigned_abs().min((1 << bit) - 1);
                magnitude | if value < 0 { 1 << bit } else { 0 }
            }
        };
        raw.to_le_bytes()
    }

    /// What the register's bytes say; bytes that are missing count as zero, those beyond its width are left alone. An unsigned register of
    /// four bytes stops at `i32::MAX`.
    pub fn decode(self, bytes: &[u8]) -> i32 {
        let mut raw = [0; 4];
        let width = usize::from(self.width).min(bytes.len());
        raw[..width].copy_from_slice(&bytes[..width]);
        let raw = u32::from_le_bytes(raw);
        match self.sign {
            Sign::Unsigned => raw.min(i32::MAX as u32) as i32,
            Sign::TwosComplement => {
                let unused = 32 - u32::from(self.width) * 8;
                ((raw << unused) as i32) >> unused
            }
            Sign::Magnitude(bit) => {
                let magnitude = (raw & ((1 << bit) - 1)) as i32;
                if raw >> bit & 1 == 1 { -magnitude } else { magnitude }
            }
        }
    }
}

/// A stretch of registers that one instruction reads.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Block {
    /// Address of its first byte.
    pub address: u8,
    /// Length, bytes.
    pub length: u8,
}

impl Block {
    /// What `register` says in the bytes of this block, or nothing if it does not lie in it.
    pub fn decode(self, register: Register, bytes: &[u8]) -> Option<i32> {
        let from = usize::from(register.address.checked_sub(self.address)?);
        let slice = bytes.get(from..from + usize::from(register.width))?;
        Some(register.decode(slice))
    }
}

/// The registers of a series and the units in which they count.
#[derive(Debug, Clone, Copy)]
pub struct Series {
    /// The protocol that it speaks.
    pub protocol: Protocol,
    /// As users call it.
    pub name: &'static str,
    /// Model number, read only.
    pub model: Register,
    /// The servo's id. EEPROM.
    pub id: Register,
    /// Baud rate, as an index into [`Series::bauds`]. EEPROM.
    pub baud: Register,
    /// How long an answer waits, in units of 2 us. EEPROM.
    pub return_delay: Register,
    /// Position or velocity, see [`Series::position_mode`]. EEPROM.
    pub operating_mode: Register,
    /// Limit of temperature, degrees Celsius. EEPROM.
    pub temperature_limit: Register,
    /// Highest voltage, 0.1 V. EEPROM.
    pub max_voltage: Register,
    /// Lowest voltage, 0.1 V. EEPROM.
    pub min_voltage: Register,
    /// Limit of speed, in units of speed, where there is one. EEPROM.
    pub velocity_limit: Option<Register>,
    /// Lowest goal position, steps. EEPROM. In velocity mode neither series heeds it.
    pub min_position: Register,
    /// Highest goal position, steps. EEPROM.
    pub max_position: Register,
    /// Which errors turn torque off, as bits of [`Series::hardware_error`]. EEPROM.
    pub shutdown: Register,
    /// Torque: 1 on, 0 off.
    pub torque_enable: Register,
    /// Errors that hold: bit 0 voltage, bit 2 heat, bit 5 overload in both series.
    pub hardware_error: Register,
    /// Stops the servo when no instruction comes for so many times 20 ms; 0 is off, 255 says that it has bitten. Dynamixel alone.
    pub bus_watchdog: Option<Register>,
    /// Goal speed in velocity mode.
    pub goal_velocity: Register,
    /// Acceleration of motions; 0 is as fast as it goes.
    pub profile_acceleration: Register,
    /// Speed of motions in position mode; 0 is as fast as it goes. With Feetech this is the goal speed's register.
    pub profile_velocity: Register,
    /// Goal position in position mode.
    pub goal_position: Register,
    /// EEPROM lock: 0 open, 1 locked. Feetech alone.
    pub lock: Option<Register>,
    /// Present load, 0.1 % of the most (current where the model measures it).
    pub load: Register,
    /// Present speed.
    pub velocity: Register,
    /// Present position, steps.
    pub position: Register,
    /// Present voltage, 0.1 V.
    pub voltage: Register,
    /// Present temperature, degrees Celsius.
    pub temperature: Register,
    /// 1 while it moves.
    pub moving: Register,
    /// Position, speed and load: what a tick reads.
    pub motion: Block,
    /// [`Series::motion`] with voltage and temperature.
    pub state: Block,
    /// One unit of speed, rad/s.
    pub speed_unit: f64,
    /// One unit of acceleration, rad/s^2.
    pub acceleration_unit: f64,
    /// The operating mode in which goals are positions.
    pub position_mode: u8,
    /// The operating mode in which goals are speeds.
    pub velocity_mode: u8,
    /// Baud rates with their index.
    pub bauds: &'static [(u32, u8)],
    /// Baud rate of a servo as it leaves the factory.
    pub factory_baud: u32,
    /// Highest id.
    pub max_id: u8,
    /// Addresses that are EEPROM: the first, and the first after them.
    pub eeprom: (u8, u8),
}

/// Bits of [`Series::hardware_error`] and [`Series::shutdown`] that both series have in common.
pub mod error_bit {
    /// Voltage outside its limits.
    pub const VOLTAGE: u8 = 1 << 0;
    /// Too hot.
    pub const HEAT: u8 = 1 << 2;
    /// A load that the servo cannot carry for long.
    pub const OVERLOAD: u8 = 1 << 5;
}

/// Dynamixel X: protocol 2.0. A unit of speed is 0.229 rpm, one of acceleration 214.577 revolutions a minute squared.
pub const DYNAMIXEL_X: Series = Series {
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
    shutdown: Register::unsigned(63, 1),
    torque_enable: Register::unsigned(64, 1),
    hardware_error: Register::unsigned(70, 1),
    bus_watchdog: Some(Register::unsigned(98, 1)),
    goal_velocity: Register::new(104, 4, Sign::TwosComplement),
    profile_acceleration: Register::unsigned(108, 4),
    profile_velocity: Register::unsigned(112, 4),
    goal_position: Register::new(116, 4, Sign::TwosComplement),
    lock: None,
    moving: Register::unsigned(122, 1),
    load: Register::new(126, 2, Sign::TwosComplement),
    velocity: Register::new(128, 4, Sign::TwosComplement),
    position: Register::new(132, 4, Sign::TwosComplement),
    voltage: Register::unsigned(144, 2),
    temperature: Register::unsigned(146, 1),
    motion: Block { address: 126, length: 10 },
    state: Block { address: 126, length: 21 },
    speed_unit: 0.229 * TAU / 60.0,
    acceleration_unit: 214.577 * TAU / 3600.0,
    position_mode: 3,
    velocity_mode: 1,
    bauds: &[(9_600, 0), (57_600, 1), (115_200, 2), (1_000_000, 3), (2_000_000, 4), (3_000_000, 5), (4_000_000, 6)],
    factory_baud: 57_600,
    max_id: 252,
    eeprom: (0, 64),
};

/// Feetech STS3215 and its kin. A unit of speed is a step a second, one of acceleration a hundred steps a second squared.
pub const FEETECH_STS: Series = Series {
    protocol: Protocol::Feetech,
    name: "Feetech STS",
    model: Register::unsigned(3, 2),
    id: Register::unsigned(5, 1),
    baud: Register::unsigned(6, 1),
    return_delay: Register::unsigned(7, 1),
    min_position: Register::unsigned(9, 2),
    max_position: Register::unsigned(11, 2),
    temperature_limit: Register::unsigned(13, 1),
    max_voltage: Register::unsigned(14, 1),
    min_voltage: Register::unsigned(15, 1),
    velocity_limit: None,
    shutdown: Register::unsigned(19, 1),
    operating_mode: Register::unsigned(33, 1),
    torque_enable: Register::unsigned(40, 1),
    profile_acceleration: Register::unsigned(41, 1),
    goal_position: Register::new(42, 2, Sign::Magnitude(15)),
    goal_velocity: Register::new(46, 2, Sign::Magnitude(15)),
    profile_velocity: Register::new(46, 2, Sign::Magnitude(15)),
    lock: Some(Register::unsigned(55, 1)),
    bus_watchdog: None,
    position: Register::new(56, 2, Sign::Magnitude(15)),
    velocity: Register::new(58, 2, Sign::Magnitude(15)),
    load: Register::new(60, 2, Sign::Magnitude(10)),
    voltage: Register::unsigned(62, 1),
    temperature: Register::unsigned(63, 1),
    hardware_error: Register::unsigned(65, 1),
    moving: Register::unsigned(66, 1),
    motion: Block { address: 56, length: 6 },
    state: Block { address: 56, length: 8 },
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
    /// The names by which files and command lines call them.
    pub const NAMES: [&'static str; 2] = ["dynamixel", "feetech"];

    /// The name of this one.
    pub fn name(self) -> &'static str {
        Self::NAMES[self as usize]
    }

    /// The one of this name; a name that there is not reads as the first, since command lines take [`NAMES`](Self::NAMES) alone.
    pub fn named(name: &str) -> Self {
        if name == Self::Feetech.name() { Self::Feetech } else { Self::Dynamixel }
    }

    /// The series that speaks it.
    pub fn series(self) -> &'static Series {
        match self {
            Protocol::Dynamixel => &DYNAMIXEL_X,
            Protocol::Feetech => &FEETECH_STS,
        }
    }
}

impl Series {
    /// Whether it knows a baud rate; if not, those that it knows, as a list for people.
    ///
    /// # Errors
    /// The list.
    pub fn check_baud(&self, baud: u32) -> Result<(), String> {
        if self.bauds.iter().any(|&(known, _)| known == baud) {
            return Ok(());
        }
        let known: Vec<_> = self.bauds.iter().map(|(baud, _)| baud.to_string()).collect();
        Err(known.join(", "))
    }
}

/// A servo of a model that its series has not.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "servo {id} says that it is model {number}, which is none of the {series} that this program knows; give another protocol, or id"
)]
pub struct UnknownModel {
    /// The id.
    pub id: u8,
    /// What it says.
    pub number: i32,
    /// The series.
    pub series: &'static str,
}

/// A model of a series.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Model {
    /// As its maker writes it.
    pub name: &'static str,
    /// What its model register says.
    pub number: u16,
    /// What it speaks.
    pub protocol: Protocol,
}

const fn dynamixel(name: &'static str, number: u16) -> Model {
    Model { name, number, protocol: Protocol::Dynamixel }
}

const fn feetech(name: &'static str, number: u16) -> Model {
    Model { name, number, protocol: Protocol::Feetech }
}

/// The models whose control table is that of their series.
pub const MODELS: [Model; 21] = [
    dynamixel("XL330-M288", 1200),
    dynamixel("XL330-M077", 1190),
    dynamixel("XC330-T181", 1210),
    dynamixel("XC330-T288", 1220),
    dynamixel("XC330-M181", 1230),
    dynamixel("XC330-M288", 1240),
    dynamixel("XL430-W250", 1060),
    dynamixel("2XL430-W250", 1090),
    dynamixel("XC430-W150", 1070),
    dynamixel("XC430-W240", 1080),
    dynamixel("XM430-W350", 1020),
    dynamixel("XM430-W210", 1030),
    dynamixel("XH430-W350", 1000),
    dynamixel("XH430-W210", 1010),
    dynamixel("XM540-W270", 1120),
    dynamixel("XM540-W150", 1130),
    dynamixel("XH540-W150", 1110),
    feetech("STS3215", 777),
    feetech("STS3250", 2825),
    feetech("STS3036", 521),
    feetech("SM8512BL", 11272),
];

/// The model with this number among those that speak `protocol`.
pub fn model(protocol: Protocol, number: u16) -> Option<&'static Model> {
    MODELS.iter().find(|model| model.protocol == protocol && model.number == number)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use rustypot::servo::dynamixel::{xl330, xl430};
    use rustypot::servo::feetech::sts3215;
    use rustypot::servo::{Encoding, RegisterInfo};

    fn names(series: &Series) -> Vec<(&'static str, Register)> {
        let mut all = vec![
            ("model_number", series.model),
            ("id", series.id),
            ("baud_rate", series.baud),
            ("return_delay_time", series.return_delay),
            ("operating_mode", series.operating_mode),
            ("min_voltage_limit", series.min_voltage),
            ("max_voltage_limit", series.max_voltage),
            ("min_position_limit", series.min_position),
            ("max_position_limit", series.max_position),
            ("torque_enable", series.torque_enable),
            ("goal_velocity", series.goal_velocity),
            ("goal_position", series.goal_position),
            ("present_velocity", series.velocity),
            ("present_position", series.position),
            ("present_temperature", series.temperature),
            ("moving", series.moving),
        ];
        all.extend(match series.protocol {
            Protocol::Dynamixel => vec![
                ("temperature_limit", series.temperature_limit),
                ("shutdown", series.shutdown),
                ("hardware_error_status", series.hardware_error),
                ("profile_acceleration", series.profile_acceleration),
                ("profile_velocity", series.profile_velocity),
                ("present_current", series.load),
                ("present_input_voltage", series.voltage),
                ("velocity_limit", series.velocity_limit.expect("a limit of speed")),
                ("bus_watchdog", series.bus_watchdog.expect("a watchdog")),
            ],
            Protocol::Feetech => vec![
                ("max_temperature_limit", series.temperature_limit),
                ("unloading_condition", series.shutdown),
                ("status", series.hardware_error),
                ("acceleration", series.profile_acceleration),
                ("goal_speed", series.profile_velocity),
                ("present_load", series.load),
                ("present_voltage", series.voltage),
                ("lock", series.lock.expect("a lock")),
            ],
        });
        all
    }

    fn agree(series: &Series, find: impl Fn(&str) -> Option<RegisterInfo>, signs: bool) {
        for (name, ours) in names(series) {
            let theirs = find(name).unwrap_or_else(|| panic!("rustypot has no {name}"));
            assert_eq!((ours.address, ours.width), (theirs.addr, theirs.size), "{}: {name}", series.name);
            let sign = match theirs.encoding {
                Encoding::TwosComplement => Sign::TwosComplement,
                Encoding::SignMagnitude { sign_bit } => Sign::Magnitude(sign_bit),
                _ => Sign::Unsigned,
            };
            // The XL330's limits are declared with a sign in rustypot and without one for the XL430; they are never negative.
            if signs && !name.ends_with("_limit") {
                assert_eq!(ours.sign, sign, "{}: {name}", series.name);
            }
        }
    }

    #[test]
    fn registers_are_rustypots() {
        agree(&DYNAMIXEL_X, xl330::register, true);
        agree(&DYNAMIXEL_X, xl430::register, true);
        agree(&FEETECH_STS, sts3215::register, true);
        for (series, info) in [(&DYNAMIXEL_X, xl330::INFO), (&DYNAMIXEL_X, xl430::INFO), (&FEETECH_STS, sts3215::INFO)]
        {
            assert_eq!(info.resolution, Some(4096));
            assert_eq!(info.baudrates, series.bauds, "{}", series.name);
            assert_eq!(info.factory_baudrate, Some(series.factory_baud));
            assert!(info.operating_modes.contains(&("position", series.position_mode)));
            assert!(info.operating_modes.contains(&("velocity", series.velocity_mode)));
        }
        for (name, number) in [("XL330-M288", 1200), ("XM430-W350", 1020), ("STS3215", 777)] {
            let (theirs, _) = rustypot::servo::find_model(name).expect("a model of rustypot's");
            assert_eq!(theirs, number);
            assert!(MODELS.iter().any(|model| model.name == name && model.number == number));
        }
    }

    #[test]
    fn what_a_tick_reads_lies_in_one_block() {
        for series in [&DYNAMIXEL_X, &FEETECH_STS] {
            let bytes = [0; 32];
            for register in [series.position, series.velocity, series.load] {
                let held = &bytes[..usize::from(series.motion.length)];
                assert_eq!(series.motion.decode(register, held), Some(0));
            }
            for register in [series.position, series.velocity, series.load, series.voltage, series.temperature] {
                let held = &bytes[..usize::from(series.state.length)];
                assert_eq!(series.state.decode(register, held), Some(0));
            }
            assert_eq!(series.motion.decode(series.temperature, &bytes[..usize::from(series.motion.length)]), None);
        }
    }

    #[test]
    fn signs_are_the_makers() {
        let position = FEETECH_STS.position;
        assert_eq!(position.encode(-100)[..2], [100, 0x80]);
        assert_eq!(position.decode(&[100, 0x80]), -100);
        assert_eq!(FEETECH_STS.load.decode(&[5, 0x04]), -5);
        assert_eq!(DYNAMIXEL_X.velocity.encode(-1), [255; 4]);
        assert_eq!(DYNAMIXEL_X.load.decode(&[0xff, 0xff]), -1);
        assert_eq!(FEETECH_STS.id.encode(1000)[0], 255);
    }

    proptest! {
        #[test]
        fn a_value_that_fits_comes_back(value in -1023_i32..1024) {
            for series in [&DYNAMIXEL_X, &FEETECH_STS] {
                for (_, register) in names(series) {
                    let fits = match register.sign {
                        Sign::Unsigned => value >= 0 && (register.width > 1 || value < 256),
                        _ => register.width > 1,
                    };
                    if fits {
                        prop_assert_eq!(register.decode(&register.encode(value)), value);
                    }
                }
            }
        }
    }
}
