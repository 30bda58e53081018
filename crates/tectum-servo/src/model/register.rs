//! Registers of a control table: address, width and number format.

/// The format of signed numbers in a register.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SignEncoding {
    /// No sign: all bits are the magnitude.
    Unsigned,
    /// Two's complement over the register's width.
    TwosComplement,
    /// A magnitude, and this bit as the sign.
    Magnitude(u8),
}

/// A register of the control table.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Register {
    /// Address of its first byte; numbers are little-endian in both series.
    pub address: u8,
    /// Width, bytes: 1, 2 or 4.
    pub width: u8,
    /// Its format of signed numbers.
    pub sign: SignEncoding,
}

impl Register {
    pub(super) const fn new(address: u8, width: u8, sign: SignEncoding) -> Self {
        Self { address, width, sign }
    }

    pub(super) const fn unsigned(address: u8, width: u8) -> Self {
        Self::new(address, width, SignEncoding::Unsigned)
    }

    /// The register's bytes for `value`; only the first [`Register::width`] bytes are used. A value that does
    /// not fit is limited to the nearest one that does.
    pub fn encode(self, value: i32) -> [u8; 4] {
        let bits = u32::from(self.width) * 8;
        let raw = match self.sign {
            SignEncoding::Unsigned => {
                let max = if bits == 32 { i64::from(u32::MAX) } else { (1_i64 << bits) - 1 };
                i64::from(value).clamp(0, max) as u32
            }
            SignEncoding::TwosComplement => {
                let max = (1_i64 << (bits - 1)) - 1;
                i64::from(value).clamp(-max - 1, max) as u32
            }
            SignEncoding::Magnitude(bit) => {
                let magnitude = value.unsigned_abs().min((1 << bit) - 1);
                magnitude | if value < 0 { 1 << bit } else { 0 }
            }
        };
        raw.to_le_bytes()
    }

    /// The value of the register's bytes. Missing bytes count as zero, and bytes beyond the width are ignored.
    /// An unsigned register of four bytes is limited to `i32::MAX`.
    pub fn decode(self, bytes: &[u8]) -> i32 {
        let mut raw = [0; 4];
        let width = usize::from(self.width).min(bytes.len());
        raw[..width].copy_from_slice(&bytes[..width]);
        let raw = u32::from_le_bytes(raw);
        match self.sign {
            SignEncoding::Unsigned => raw.min(i32::MAX as u32) as i32,
            SignEncoding::TwosComplement => {
                let unused = 32 - u32::from(self.width) * 8;
                ((raw << unused) as i32) >> unused
            }
            SignEncoding::Magnitude(bit) => {
                let magnitude = (raw & ((1 << bit) - 1)) as i32;
                if raw >> bit & 1 == 1 { -magnitude } else { magnitude }
            }
        }
    }
}

/// A contiguous block of registers, read with one instruction.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RegisterBlock {
    /// Address of its first byte.
    pub address: u8,
    /// Length, bytes.
    pub length: u8,
}

impl RegisterBlock {
    /// Writes the value of `register`, which is within this block, to the block's bytes.
    pub fn encode(self, register: Register, value: i32, bytes: &mut [u8]) {
        let (from, width) = (usize::from(register.address - self.address), usize::from(register.width));
        bytes[from..from + width].copy_from_slice(&register.encode(value)[..width]);
    }

    /// The value of `register` in the bytes of this block; `None` if it is not within the block.
    pub fn decode(self, register: Register, bytes: &[u8]) -> Option<i32> {
        let from = usize::from(register.address.checked_sub(self.address)?);
        let slice = bytes.get(from..from + usize::from(register.width))?;
        Some(register.decode(slice))
    }
}
