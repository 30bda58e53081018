//! A servo's control table: what it holds after power-up, and who may write what when.
//!
//! Dynamixel refuses with an error number (result fail 1, data range 4, data limit 6, access 7); Feetech
//! answers every write alike and takes what it can.

use crate::model::{Protocol, Register, ServoModel, ServoSeries};

/// Error numbers of protocol 2.0.
pub mod refusal {
    /// An instruction that the servo does not know.
    pub const INSTRUCTION: u8 = 2;
    /// The checksum does not fit.
    pub const CRC: u8 = 3;
    /// A value that the register does not take, or an address that is none.
    pub const RANGE: u8 = 4;
    /// Parameters that are too short.
    pub const LENGTH: u8 = 5;
    /// A value beyond a limit that stands in the table.
    pub const LIMIT: u8 = 6;
    /// Read only, EEPROM while torque is on, or torque while an error holds.
    pub const ACCESS: u8 = 7;
}

/// Registers of a servo: what holds now, and what outlives a loss of power.
#[derive(Debug, Clone)]
pub struct ControlTable {
    /// The series that it follows.
    pub series: &'static ServoSeries,
    now: [u8; 256],
    kept: [u8; 256],
}

impl ControlTable {
    /// A servo of `model` as it leaves the factory, but for its id and for its baud rate, which is `baud`.
    pub fn new(model: &ServoModel, id: u8, baud: u32) -> Self {
        let series = model.protocol.series();
        let mut table = Self { series, now: [0; 256], kept: [0; 256] };
        let index = series.bauds.iter().find(|(rate, _)| *rate == baud).map_or(0, |&(_, index)| index);
        table.set(series.model, i32::from(model.number));
        table.set(series.id, i32::from(id));
        table.set(series.baud, i32::from(index));
        table.set(series.operating_mode, i32::from(series.position_mode));
        table.set(series.max_position, 4095);
        match series.protocol {
            Protocol::Dynamixel => {
                // A small one runs on 5 V, the others on 12.
                let small = model.name.starts_with("XL330") || model.name.starts_with("XC330-M");
                table.set(Register { address: 6, ..series.id }, 52);
                table.set(series.return_delay, 250);
                table.set(series.temperature_limit, if small { 70 } else { 72 });
                table.set(series.max_voltage, if small { 70 } else { 140 });
                table.set(series.min_voltage, if small { 35 } else { 60 });
                table.set(series.shutdown, if small { 53 } else { 52 });
                if let Some(limit) = series.velocity_limit {
                    table.set(limit, 1023);
                }
                // Status return level: answers to everything.
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
                table.set(Register { address: 35, ..series.id }, 200);
                if let Some(lock) = series.lock {
                    table.set(lock, 1);
                }
            }
        }
        table.kept = table.now;
        table
    }

    /// What `register` holds.
    pub fn get(&self, register: Register) -> i32 {
        register.decode(&self.now[usize::from(register.address)..])
    }

    /// Puts `value` into `register`, as the servo itself does.
    pub fn set(&mut self, register: Register, value: i32) {
        let (from, width) = (usize::from(register.address), usize::from(register.width));
        self.now[from..from + width].copy_from_slice(&register.encode(value)[..width]);
    }

    /// `length` bytes from `address`, or nothing if there are not so many.
    pub fn read(&self, address: u16, length: u16) -> Option<&[u8]> {
        let from = usize::from(address);
        self.now.get(from..from + usize::from(length)).filter(|bytes| !bytes.is_empty())
    }

    /// Back to what outlives a loss of power.
    pub fn lose_power(&mut self) {
        self.now = self.kept;
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

    /// Writes `bytes` from `address` on as a host asks for it: all of them or, refused, none. `failed` is
    /// whether an error has turned the servo off.
    ///
    /// # Errors
    /// Protocol 2.0's error number.
    pub fn write(&mut self, address: u16, bytes: &[u8], failed: bool) -> Result<(), u8> {
        let from = usize::from(address);
        if bytes.is_empty() {
            return Err(refusal::LENGTH);
        }
        if self.now.get(from..from + bytes.len()).is_none() {
            return Err(refusal::RANGE);
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
            return Err(refusal::ACCESS);
        }
        let mut next = self.clone();
        next.now[from..from + bytes.len()].copy_from_slice(bytes);
        let touched = |register: Register| {
            let (first, end) = (usize::from(register.address), usize::from(register.address + register.width));
            first < from + bytes.len() && from < end
        };
        let value = |register: Register| next.get(register);
        let limit = series.velocity_limit.map_or(i32::MAX, value);
        let watchdog = series.bus_watchdog.expect("a watchdog");
        if (100..120).any(|goal| (from..from + bytes.len()).contains(&goal)) && self.get(watchdog) == 255 {
            return Err(refusal::RANGE);
        }
        if touched(series.torque_enable) {
            match value(series.torque_enable) {
                1 if failed => return Err(refusal::ACCESS),
                0 | 1 => {}
                _ => return Err(refusal::RANGE),
            }
        }
        let range = (touched(series.id) && value(series.id) > i32::from(series.max_id))
            || (touched(series.baud) && value(series.baud) > 6)
            || (touched(series.operating_mode) && !matches!(value(series.operating_mode), 0 | 1 | 3 | 4 | 5 | 16))
            || (touched(watchdog) && value(watchdog) > 127);
        if range {
            return Err(refusal::RANGE);
        }
        let single_turn = value(series.operating_mode) == i32::from(series.position_mode);
        let inside = value(series.min_position)..=value(series.max_position);
        let beyond = (touched(series.goal_velocity) && value(series.goal_velocity).abs() > limit)
            || (touched(series.goal_position) && single_turn && !inside.contains(&value(series.goal_position)))
            || ((touched(series.min_position) || touched(series.max_position)) && value(series.max_position) > 4095);
        if beyond {
            return Err(refusal::LIMIT);
        }
        next.kept[..eeprom].copy_from_slice(&next.now[..eeprom]);
        *self = next;
        Ok(())
    }

    fn write_feetech(&mut self, from: usize, bytes: &[u8]) {
        let lock = self.series.lock.expect("a lock");
        for (at, &byte) in (from..).zip(bytes) {
            // Below 5 and from 56 on it is read only.
            if (5..usize::from(self.series.position.address)).contains(&at) {
                self.now[at] = byte;
                if at < usize::from(self.series.eeprom.1) && self.get(lock) == 0 {
                    self.kept[at] = byte;
                }
            }
        }
    }
}
