//! EEPROM registers that change the meaning of what is read or written, or how a goal is followed.
//!
//! They outlive a loss of power, and any program may have changed them. A calibration keeps their values, and
//! they are compared before torque comes on. The lists were made by going through the manufacturers' control
//! tables. Registers that the bridge itself writes (operating mode, limits of position and speed) are not
//! among them, nor are id and baud rate, without which there is no answer at all.

use super::register::{Register, SignEncoding};

/// A register that is compared before torque comes on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct KeptSetting {
    /// Its name in calibrations and messages: the manufacturer's, in lower case.
    pub name: &'static str,
    /// Where it is.
    pub register: Register,
    /// The value that is required when no calibration states another: the one that changes nothing. `None`
    /// where each model has its own, so that only a value from a calibration can be compared.
    pub neutral: Option<i32>,
    /// Bits that must not be set, whatever a calibration states: the bridge cannot work with them.
    pub forbidden: i32,
}

const fn kept(name: &'static str, register: Register, neutral: Option<i32>) -> KeptSetting {
    KeptSetting { name, register, neutral, forbidden: 0 }
}

impl KeptSetting {
    const fn without(self, forbidden: i32) -> Self {
        Self { forbidden, ..self }
    }
}

const fn byte(name: &'static str, address: u8, neutral: Option<i32>) -> KeptSetting {
    kept(name, Register::unsigned(address, 1), neutral)
}

const fn word(name: &'static str, address: u8) -> KeptSetting {
    kept(name, Register::unsigned(address, 2), None)
}

/// Dynamixel's offset of all positions, steps, added to what the encoder says.
pub(super) const DYNAMIXEL_HOMING: Register = Register::new(20, 4, SignEncoding::TwosComplement);

/// Feetech's offset of all positions, steps, taken from what the encoder says.
pub(super) const FEETECH_HOMING: Register = Register::new(31, 2, SignEncoding::Magnitude(11));

/// The kept settings of Dynamixel X.
pub(super) const DYNAMIXEL: &[KeptSetting] = &[
    // Bit 0 turns the direction round, bit 2 makes times of speeds, bit 3 lets a goal turn torque on.
    byte("drive_mode", 10, Some(0)).without(0b1100),
    // A second id at which the servo obeys too; 253 and more: none.
    byte("secondary_id", 12, None),
    kept("homing_offset", DYNAMIXEL_HOMING, Some(0)),
    word("pwm_limit", 36),
    word("current_limit", 38),
    // Bit 0 turns torque on when power comes, bit 1 keeps goals through a loss of power.
    byte("startup_configuration", 60, Some(0)).without(0b1),
    byte("shutdown", 63, None),
];

/// The kept settings of Feetech STS.
pub(super) const FEETECH: &[KeptSetting] = &[
    // 0: the servo answers only pings and reads.
    byte("response_level", 8, Some(1)).without(!1),
    word("max_torque", 16),
    byte("phase", 18, None),
    byte("unloading_condition", 19, None),
    byte("p_coefficient", 21, None),
    byte("d_coefficient", 22, None),
    byte("i_coefficient", 23, None),
    word("min_startup_force", 24),
    byte("cw_dead_zone", 26, None),
    byte("ccw_dead_zone", 27, None),
    word("protection_current", 28),
    // 2 and more: positions are multiples of so many steps.
    byte("angular_resolution", 30, None).without(!1),
    kept("homing_offset", FEETECH_HOMING, Some(0)),
    byte("protective_torque", 34, None),
    byte("protection_time", 35, None),
    byte("overload_torque", 36, None),
    byte("speed_p_coefficient", 37, None),
    byte("speed_i_coefficient", 39, None),
];
