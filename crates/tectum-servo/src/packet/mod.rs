//! Packets of both protocols, for the host's end and the servos' end.
//!
//! Dynamixel 2.0: `FF FF FD 00 id length(2) code parameters crc(2)`, with an `FD` stuffed in after every `FF FF FD`
//! of the parameters; <https://emanual.robotis.com/docs/en/dxl/protocol2/>. Feetech: `FF FF id length code parameters
//! checksum`, where the checksum is the complement of the sum from the id on. The *code* of an instruction is its
//! number. The code of an answer is [`instruction::STATUS`] with Dynamixel, whose first parameter is the error byte;
//! with Feetech it is the error byte itself.

use crate::model::{Protocol, RegisterBlock};

/// The broadcast id, which addresses all servos.
pub const BROADCAST: u8 = 0xfe;

/// Longest packet that either end accepts; a header with a greater length is not a packet.
const MAX_LENGTH: usize = 512;

/// Numbers of the instructions, which are the same in both protocols.
pub mod instruction {
    /// Ping.
    pub const PING: u8 = 0x01;
    /// Read registers.
    pub const READ: u8 = 0x02;
    /// Write registers.
    pub const WRITE: u8 = 0x03;
    /// Reboot.
    pub const REBOOT: u8 = 0x08;
    /// Read the same registers of several servos.
    pub const SYNC_READ: u8 = 0x82;
    /// Write the same registers of several servos.
    pub const SYNC_WRITE: u8 = 0x83;
    /// Status packet: the number that an answer of protocol 2.0 has in place of an instruction.
    pub const STATUS: u8 = 0x55;
}

/// A packet as it was received.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Packet {
    /// The addressed servo, [`BROADCAST`] for all; of an answer, the servo that sent it.
    pub id: u8,
    /// Number of the instruction, or what an answer has in its place.
    pub code: u8,
    /// The parameters, without stuffing.
    pub parameters: Vec<u8>,
    /// Whether the checksum is correct.
    pub checksum_ok: bool,
}

/// The beginning of received bytes.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Parsed {
    /// A packet of so many bytes.
    Packet(usize, Packet),
    /// The first byte does not begin a packet.
    Noise,
    /// An incomplete packet.
    Incomplete,
}

/// What the bytes begin with.
pub fn parse(protocol: Protocol, bytes: &[u8]) -> Parsed {
    match protocol {
        Protocol::Dynamixel => parse_dynamixel(bytes),
        Protocol::Feetech => parse_feetech(bytes),
    }
}

fn parse_dynamixel(bytes: &[u8]) -> Parsed {
    const HEADER: [u8; 4] = [0xff, 0xff, 0xfd, 0x00];
    if bytes.iter().zip(HEADER).any(|(&byte, expected)| byte != expected) {
        return Parsed::Noise;
    }
    let Some(&[_, _, _, _, id, low, high]) = bytes.get(..7) else { return Parsed::Incomplete };
    let length = usize::from(u16::from_le_bytes([low, high]));
    if !(3..=MAX_LENGTH).contains(&length) || id > BROADCAST || id == 0xfd {
        return Parsed::Noise;
    }
    let Some(packet) = bytes.get(..7 + length) else { return Parsed::Incomplete };
    let (body, sum) = packet.split_at(packet.len() - 2);
    let checksum_ok = crc(body).to_le_bytes() == sum;
    Parsed::Packet(packet.len(), Packet { id, code: packet[7], parameters: unstuffed(&body[8..]), checksum_ok })
}

fn parse_feetech(bytes: &[u8]) -> Parsed {
    if bytes.iter().take(2).any(|&byte| byte != 0xff) {
        return Parsed::Noise;
    }
    let Some(&[_, _, id, length]) = bytes.get(..4) else { return Parsed::Incomplete };
    // A third FF is not an id: the header begins one byte later.
    if id > BROADCAST || length < 2 {
        return Parsed::Noise;
    }
    let Some(packet) = bytes.get(..4 + usize::from(length)) else { return Parsed::Incomplete };
    let (body, sum) = packet.split_at(packet.len() - 1);
    let checksum_ok = checksum(&body[2..]) == sum[0];
    Parsed::Packet(packet.len(), Packet { id, code: packet[4], parameters: body[5..].to_vec(), checksum_ok })
}

/// The bytes of an instruction to servo `id`, or to all with [`BROADCAST`]. Of more parameters than fit into a packet
/// (250 bytes in either protocol) the surplus is left out; no instruction of this library has as many.
pub fn encode(protocol: Protocol, id: u8, code: u8, parameters: &[u8]) -> Vec<u8> {
    let parameters = &parameters[..parameters.len().min(250)];
    match protocol {
        Protocol::Dynamixel => {
            let body = stuffed(parameters);
            let mut bytes = vec![0xff, 0xff, 0xfd, 0x00, id];
            bytes.extend((body.len() as u16 + 3).to_le_bytes());
            bytes.push(code);
            bytes.extend(body);
            bytes.extend(crc(&bytes).to_le_bytes());
            bytes
        }
        Protocol::Feetech => {
            let mut bytes = vec![0xff, 0xff, id, parameters.len() as u8 + 2, code];
            bytes.extend_from_slice(parameters);
            bytes.push(checksum(&bytes[2..]));
            bytes
        }
    }
}

/// The bytes of an answer from `id` with this error byte and these parameters.
pub fn status(protocol: Protocol, id: u8, error: u8, parameters: &[u8]) -> Vec<u8> {
    match protocol {
        Protocol::Dynamixel => encode(protocol, id, instruction::STATUS, &[&[error], parameters].concat()),
        Protocol::Feetech => encode(protocol, id, error, parameters),
    }
}

/// An address or a length, as the instructions of the protocol have it: two bytes with Dynamixel, one with Feetech.
fn number(protocol: Protocol, number: u8) -> impl Iterator<Item = u8> {
    let width = if protocol == Protocol::Dynamixel { 2 } else { 1 };
    u16::from(number).to_le_bytes().into_iter().take(width)
}

/// The instruction that asks whether servo `id` is there.
pub fn ping(protocol: Protocol, id: u8) -> Vec<u8> {
    encode(protocol, id, instruction::PING, &[])
}

/// The instruction that reads `block` of servo `id`.
pub fn read(protocol: Protocol, id: u8, block: RegisterBlock) -> Vec<u8> {
    let range = number(protocol, block.address).chain(number(protocol, block.length));
    encode(protocol, id, instruction::READ, &range.collect::<Vec<_>>())
}

/// The instruction that writes `data` to servo `id`, from `address` on.
pub fn write(protocol: Protocol, id: u8, address: u8, data: &[u8]) -> Vec<u8> {
    let parameters: Vec<_> = number(protocol, address).chain(data.iter().copied()).collect();
    encode(protocol, id, instruction::WRITE, &parameters)
}

/// The instruction that reads `block` of several servos, which answer one after the other.
pub fn sync_read(protocol: Protocol, ids: &[u8], block: RegisterBlock) -> Vec<u8> {
    let range = number(protocol, block.address).chain(number(protocol, block.length));
    encode(protocol, BROADCAST, instruction::SYNC_READ, &range.chain(ids.iter().copied()).collect::<Vec<_>>())
}

/// The instruction that writes `data`, one piece for each of `ids` and all of one length, from `address` on.
pub fn sync_write(protocol: Protocol, ids: &[u8], address: u8, data: &[Vec<u8>]) -> Vec<u8> {
    let length = data.first().map_or(0, Vec::len) as u8;
    let mut parameters: Vec<_> = number(protocol, address).chain(number(protocol, length)).collect();
    for (&id, data) in ids.iter().zip(data) {
        parameters.push(id);
        parameters.extend(data);
    }
    encode(protocol, BROADCAST, instruction::SYNC_WRITE, &parameters)
}

/// A servo's answer.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ServoReply {
    /// The requested bytes.
    pub bytes: Vec<u8>,
    /// The error byte of its status packet.
    pub error: u8,
}

/// Why there is no usable answer.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum AnswerFault {
    /// Nothing came.
    #[error("no answer in time")]
    Silent,
    /// The answer ended before it was complete.
    #[error("only part of an answer in time")]
    Incomplete,
    /// The checksum does not fit the bytes.
    #[error("an answer with a wrong checksum")]
    Checksum,
    /// The bytes are not a status packet.
    #[error("bytes that are no answer")]
    Malformed,
    /// Another servo answered.
    #[error("an answer of servo {0}")]
    WrongId(u8),
    /// The answer has more or fewer bytes than were asked for.
    #[error("an answer of the wrong length")]
    Length,
    /// The port took the instruction not at all, or not in time.
    #[error("the port does not take the instruction")]
    NotSent,
    /// The operating system has closed the port.
    #[error("the port is gone")]
    Gone,
}

impl AnswerFault {
    /// Whether something answered, although not with a valid packet, as when two servos have one id.
    pub fn is_garbled(self) -> bool {
        matches!(self, Self::Checksum | Self::Malformed | Self::WrongId(_) | Self::Length)
    }
}

/// The answer of servo `id` with `length` bytes at the beginning of `bytes`, and the length of its packet; `None`
/// while it is incomplete.
///
/// # Errors
/// When the bytes are not this answer. A host skips nothing: what does not belong to the answer is a reason to ask
/// again.
pub fn answer(
    protocol: Protocol,
    id: u8,
    length: usize,
    bytes: &[u8],
) -> Result<Option<(usize, ServoReply)>, AnswerFault> {
    let (taken, packet) = match parse(protocol, bytes) {
        Parsed::Incomplete => return Ok(None),
        Parsed::Noise => return Err(AnswerFault::Malformed),
        Parsed::Packet(taken, packet) => (taken, packet),
    };
    if !packet.checksum_ok {
        return Err(AnswerFault::Checksum);
    }
    if packet.id != id {
        return Err(AnswerFault::WrongId(packet.id));
    }
    let (error, data) = match protocol {
        Protocol::Feetech => (packet.code, packet.parameters.as_slice()),
        Protocol::Dynamixel => match packet.parameters.split_first() {
            Some((&error, data)) if packet.code == instruction::STATUS => (error, data),
            _ => return Err(AnswerFault::Malformed),
        },
    };
    if data.len() != length {
        return Err(AnswerFault::Length);
    }
    Ok(Some((taken, ServoReply { bytes: data.to_vec(), error })))
}

/// `body` with an `FD` inserted after every `FF FF FD`.
fn stuffed(body: &[u8]) -> Vec<u8> {
    let mut out = Vec::with_capacity(body.len() + 2);
    let mut since = 0;
    for (i, &byte) in body.iter().enumerate() {
        out.push(byte);
        if i + 1 >= since + 3 && body[i - 2..=i] == [0xff, 0xff, 0xfd] {
            out.push(0xfd);
            since = i + 1;
        }
    }
    out
}

/// `body` without the inserted bytes.
fn unstuffed(body: &[u8]) -> Vec<u8> {
    let mut out: Vec<u8> = Vec::with_capacity(body.len());
    let mut since = 0;
    let mut due = false;
    for &byte in body {
        if std::mem::take(&mut due) {
            since = out.len();
            if byte == 0xfd {
                continue;
            }
        }
        out.push(byte);
        due = out.len() >= since + 3 && out.ends_with(&[0xff, 0xff, 0xfd]);
    }
    out
}

/// Feetech's checksum over id, length, instruction and parameters.
fn checksum(bytes: &[u8]) -> u8 {
    !bytes.iter().fold(0_u8, |sum, &byte| sum.wrapping_add(byte))
}

/// Protocol 2.0's CRC: polynomial 0x8005, from 0, highest bit first.
fn crc(bytes: &[u8]) -> u16 {
    bytes.iter().fold(0, |crc: u16, &byte| {
        (0..8).fold(crc ^ u16::from(byte) << 8, |crc, _| if crc & 0x8000 == 0 { crc << 1 } else { crc << 1 ^ 0x8005 })
    })
}

#[cfg(test)]
mod tests;
