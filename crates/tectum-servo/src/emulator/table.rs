//! A servo's control table: initial values, and the rules for writing.
//!
//! Dynamixel refuses a write with an error number (result fail 1, data range 4, data limit 6, access 7).
//! Feetech acknowledges every write and ignores the bytes that cannot be written.

use crate::model::{Protocol, Register, ServoModel, ServoSeries};

/// Error numbers of protocol 2.0.
pub mod instruction_error {
    /// Unknown instruction.
    pub const INSTRUCTION: u8 = 2;
    /// Wrong checksum.
    pub const CRC: u8 = 3;
    /// Invalid value or address.
    pub const RANGE: u8 = 4;
    /// Too few parameters.
    pub const LENGTH: u8 = 5;
    /// A value beyond a limit of the control table.
    pub const LIMIT: u8 = 6;
    /// A read-only register, EEPROM while torque is on, or torque while an error is active.
    pub const ACCESS: u8 = 7;
}

/// Registers of a servo: current values, and the values after a loss of power.
#[derive(Debug, Clone)]
pub struct ControlTable {
    /// The series whose layout it has.
    pub series: &'static ServoSeries,
    current: [u8; 256],
    persistent: [u8; 256],
}

impl ControlTable {
    /// The factory settings of `model`, except for id and baud rate.
    pub fn new(model: &ServoModel, id: u8, baud: u32) -> Self {
        let series = model.protocol.series();
        let mut table = Self { series, current: [0; 256], persistent: [0; 256] };
        let index = series.bauds.iter().find(|(rate, _)| *rate == baud).map_or(0, |&(_, index)| index);
        table.set(series.model, i32::from(model.number));
        table.set(series.id, i32::from(id));
        table.set(series.baud, i32::from(index));
        table.set(series.operating_mode, i32::from(series.position_mode));
        table.set(series.max_position, 4095);
        match series.protocol {
            Protocol::Dynamixel => {
                // Small models run on 5 V, the others on 12 V.
                let small = model.name.starts_with("XL330") || model.name.starts_with("XC330-M");
                table.set(Register { address: 6, ..series.id }, 52);
                // Secondary id: none.
                table.set(Register { address: 12, ..series.id }, 255);
                table.set(Register { address: 36, width: 2, ..series.id }, 885);
                table.set(Register { address: 38, width: 2, ..series.id }, 1750);
                table.set(series.return_delay, 250);
                table.set(series.temperature_limit, if small { 70 } else { 72 });
                table.set(series.max_voltage, if small { 70 } else { 140 });
                table.set(series.min_voltage, if small { 35 } else { 60 });
                table.set(series.shutdown, if small { 53 } else { 52 });
                if let Some(limit) = series.velocity_limit {
                    table.set(limit, 1023);
                }
                // Status return level: answer all instructions.
                table.set(Register { address: 68, ..series.id }, 2);
            }
            Protocol::Feetech => {
                table.set(Register { address: 0, ..series.id }, 3);
                table.set(Register { address: 1, ..series.id }, 10);
                table.set(Register { address: 8, ..series.id }, 1);
                table.set(series.temperature_limit, 70);
                table.set(series.max_voltage, 140);
                table.set(series.min_voltage, 40);
                table.set(series.shutdown, 44);
                // Angular resolution, protection time, greatest torque and the gains of the position loop.
                table.set(Register { address: 30, ..series.id }, 1);
                table.set(Register { address: 35, ..series.id }, 200);
                table.set(Register { address: 16, width: 2, ..series.id }, 1000);
                table.set(Register { address: 21, ..series.id }, 32);
                table.set(Register { address: 22, ..series.id }, 32);
                if let Some(lock) = series.lock {
                    table.set(lock, 1);
                }
            }
        }
        table.persistent = table.current;
        table
    }

    /// The value of `register`.
    pub fn get(&self, register: Register) -> i32 {
        register.decode(&self.current[usize::from(register.address)..])
    }

    /// Sets `register` to `value` without checks, as the servo itself does.
    pub fn set(&mut self, register: Register, value: i32) {
        let (from, width) = (usize::from(register.address), usize::from(register.width));
        self.current[from..from + width].copy_from_slice(&register.encode(value)[..width]);
    }

    /// Overwrites bytes from `address` on, for good, as another program may have done. Bytes beyond the table
    /// are ignored.
    pub fn overwrite(&mut self, address: u8, bytes: &[u8]) {
        for (at, &byte) in (usize::from(address)..256).zip(bytes) {
            (self.current[at], self.persistent[at]) = (byte, byte);
        }
    }

    /// `length` bytes from `address`; `None` if the range is empty or outside the table.
    pub fn read(&self, address: u16, length: u16) -> Option<&[u8]> {
        let from = usize::from(address);
        self.current.get(from..from + usize::from(length)).filter(|bytes| !bytes.is_empty())
    }

    /// Resets all values to those after a loss of power.
    pub fn lose_power(&mut self) {
        self.current = self.persistent;
    }

    /// Whether torque is on.
    pub fn torque(&self) -> bool {
        self.get(self.series.torque_enable) == 1
    }

    /// The baud rate at which the servo listens.
    pub fn baud(&self) -> u32 {
        let index = self.get(self.series.baud);
        let known = self.series.bauds.iter().find(|&&(_, i)| i32::from(i) == index);
        known.map_or(self.series.factory_baud, |&(rate, _)| rate)
    }

    /// Executes a write of the host: writes all of `bytes` from `address` on, or none of them if it is refused.
    /// `failed` tells whether an error has turned the servo off.
    ///
    /// # Errors
    /// Protocol 2.0's error number.
    pub fn write(&mut self, address: u16, bytes: &[u8], failed: bool) -> Result<(), u8> {
        let from = usize::from(address);
        if bytes.is_empty() {
            return Err(instruction_error::LENGTH);
        }
        if self.current.get(from..from + bytes.len()).is_none() {
            return Err(instruction_error::RANGE);
        }
        match self.series.protocol {
            Protocol::Dynamixel => self.write_dynamixel(from, bytes, failed),
            Protocol::Feetech => {
                self.write_feetech(from, bytes);
                Ok(())
            }
        }
    }

    fn write_dynamixel(&mut self, from: usize, bytes: &[u8], failed: bool) -> Result<(), u8> {
        let series = self.series;
        let eeprom = usize::from(series.eeprom.1);
        let writable = |at: usize| matches!(at, 7..=63 | 64..=65 | 68 | 76..=91 | 98 | 100..=119 | 168..=229);
        let torque = self.torque();
        if !(from..from + bytes.len()).all(writable) || (torque && from < eeprom) {
            return Err(instruction_error::ACCESS);
        }
        let mut next = self.clone();
        next.current[from..from + bytes.len()].copy_from_slice(bytes);
        let touched = |register: Register| {
            let (first, end) = (usize::from(register.address), usize::from(register.address + register.width));
            first < from + bytes.len() && from < end
        };
        let value = |register: Register| next.get(register);
        let limit = series.velocity_limit.map_or(i32::MAX, value);
        let watchdog = series.bus_watchdog.expect("a watchdog");
        if (100..120).any(|goal| (from..from + bytes.len()).contains(&goal)) && self.get(watchdog) == 255 {
            return Err(instruction_error::RANGE);
        }
        if touched(series.torque_enable) {
            match value(series.torque_enable) {
                1 if failed => return Err(instruction_error::ACCESS),
                0 | 1 => {}
                _ => return Err(instruction_error::RANGE),
            }
        }
        let out_of_range = (touched(series.id) && value(series.id) > i32::from(series.max_id))
            || (touched(series.baud) && value(series.baud) > 6)
            || (touched(series.operating_mode) && !matches!(value(series.operating_mode), 0 | 1 | 3 | 4 | 5 | 16))
            || (touched(watchdog) && value(watchdog) > 127);
        if out_of_range {
            return Err(instruction_error::RANGE);
        }
        let single_turn = value(series.operating_mode) == i32::from(series.position_mode);
        let inside = value(series.min_position)..=value(series.max_position);
        let beyond_limit = (touched(series.goal_velocity) && value(series.goal_velocity).abs() > limit)
            || (touched(series.goal_position) && single_turn && !inside.contains(&value(series.goal_position)))
            || ((touched(series.min_position) || touched(series.max_position)) && value(series.max_position) > 4095);
        if beyond_limit {
            return Err(instruction_error::LIMIT);
        }
        next.persistent[..eeprom].copy_from_slice(&next.current[..eeprom]);
        *self = next;
        Ok(())
    }

    fn write_feetech(&mut self, from: usize, bytes: &[u8]) {
        let lock = self.series.lock.expect("a lock");
        for (at, &byte) in (from..).zip(bytes) {
            // Below 5 and from 56 on, registers are read-only.
            if (5..usize::from(self.series.position.address)).contains(&at) {
                self.current[at] = byte;
                if at < usize::from(self.series.eeprom.1) && self.get(lock) == 0 {
                    self.persistent[at] = byte;
                }
            }
        }
    }
}
