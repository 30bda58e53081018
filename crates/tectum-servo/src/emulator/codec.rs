//! The servos' end of both protocols: parses instructions and encodes answers.
//!
//! Dynamixel 2.0: `FF FF FD 00 id length(2) instruction parameters crc(2)`, with an `FD` stuffed in after every
//! `FF FF FD` of the body; <https://emanual.robotis.com/docs/en/dxl/protocol2/>. Feetech: `FF FF id length
//! instruction parameters checksum`, where the checksum is the complement of the sum from the id on. Bytes that
//! do not belong to a packet are skipped one by one, as by a servo that waits for a header.

use crate::model::Protocol;

/// The broadcast id, which addresses all servos.
pub const BROADCAST: u8 = 0xfe;

/// Longest packet that a servo accepts; a header with a greater length is not a packet.
const MAX_LENGTH: usize = 512;

/// An instruction packet of the host.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Request {
    /// The addressed servo; [`BROADCAST`] for all.
    pub id: u8,
    /// The number of the instruction, see [`instruction`].
    pub instruction: u8,
    /// The instruction's parameters, without stuffing.
    pub parameters: Vec<u8>,
    /// Whether the checksum is correct.
    pub checksum_ok: bool,
}

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

/// Collects bytes and parses them into requests.
#[derive(Debug, Clone)]
pub struct RequestParser {
    protocol: Protocol,
    bytes: Vec<u8>,
}

impl RequestParser {
    /// A parser without bytes.
    pub fn new(protocol: Protocol) -> Self {
        Self { protocol, bytes: Vec::new() }
    }

    /// Adds bytes.
    pub fn push(&mut self, bytes: &[u8]) {
        self.bytes.extend_from_slice(bytes);
    }

    /// Drops an incomplete packet.
    pub fn clear(&mut self) {
        self.bytes.clear();
    }

    /// The next complete request. Bytes before it that do not belong to a request are dropped.
    pub fn next_request(&mut self) -> Option<Request> {
        loop {
            let request = match self.protocol {
                Protocol::Dynamixel => dynamixel(&self.bytes),
                Protocol::Feetech => feetech(&self.bytes),
            };
            match request {
                ParseResult::Request(length, request) => {
                    self.bytes.drain(..length);
                    return Some(request);
                }
                ParseResult::Skip(length) => {
                    self.bytes.drain(..length);
                }
                ParseResult::Incomplete => return None,
            }
        }
    }
}

enum ParseResult {
    /// A request of so many bytes.
    Request(usize, Request),
    /// Number of bytes that do not begin a packet.
    Skip(usize),
    /// An incomplete packet.
    Incomplete,
}

fn dynamixel(bytes: &[u8]) -> ParseResult {
    const HEADER: [u8; 4] = [0xff, 0xff, 0xfd, 0x00];
    if bytes.iter().zip(HEADER).any(|(&byte, expected)| byte != expected) {
        return ParseResult::Skip(1);
    }
    let Some(&[_, _, _, _, id, low, high]) = bytes.get(..7) else { return ParseResult::Incomplete };
    let length = usize::from(u16::from_le_bytes([low, high]));
    if !(3..=MAX_LENGTH).contains(&length) || id > BROADCAST || id == 0xfd {
        return ParseResult::Skip(1);
    }
    let Some(packet) = bytes.get(..7 + length) else { return ParseResult::Incomplete };
    let (body, sum) = packet.split_at(packet.len() - 2);
    let request = Request {
        id,
        instruction: packet[7],
        parameters: unstuffed(&body[8..]),
        checksum_ok: crc(body).to_le_bytes() == sum,
    };
    ParseResult::Request(packet.len(), request)
}

fn feetech(bytes: &[u8]) -> ParseResult {
    if bytes.iter().take(2).any(|&byte| byte != 0xff) {
        return ParseResult::Skip(1);
    }
    let Some(&[_, _, id, length]) = bytes.get(..4) else { return ParseResult::Incomplete };
    // A third FF is not an id: the header begins one byte later.
    if id > BROADCAST || length < 2 {
        return ParseResult::Skip(1);
    }
    let Some(packet) = bytes.get(..4 + usize::from(length)) else { return ParseResult::Incomplete };
    let (body, sum) = packet.split_at(packet.len() - 1);
    let request = Request {
        id,
        instruction: packet[4],
        parameters: body[5..].to_vec(),
        checksum_ok: checksum(&body[2..]) == sum[0],
    };
    ParseResult::Request(packet.len(), request)
}

/// The bytes of an answer from `id` with this error byte and these parameters.
pub fn status(protocol: Protocol, id: u8, error: u8, parameters: &[u8]) -> Vec<u8> {
    match protocol {
        Protocol::Dynamixel => {
            let mut body = vec![error];
            body.extend_from_slice(parameters);
            let body = stuffed(&body);
            let mut bytes = vec![0xff, 0xff, 0xfd, 0x00, id];
            bytes.extend((body.len() as u16 + 3).to_le_bytes());
            bytes.push(instruction::STATUS);
            bytes.extend(body);
            bytes.extend(crc(&bytes).to_le_bytes());
            bytes
        }
        Protocol::Feetech => {
            let mut bytes = vec![0xff, 0xff, id, parameters.len() as u8 + 2, error];
            bytes.extend_from_slice(parameters);
            bytes.push(checksum(&bytes[2..]));
            bytes
        }
    }
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
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn all(protocol: Protocol, bytes: &[u8]) -> Vec<Request> {
        let mut parser = RequestParser::new(protocol);
        parser.push(bytes);
        std::iter::from_fn(|| parser.next_request()).collect()
    }

    #[test]
    fn the_examples_of_the_manuals_are_parsed_and_encoded() {
        let ping = [0xff, 0xff, 0xfd, 0, 1, 3, 0, 1, 0x19, 0x4e];
        let request = Request { id: 1, instruction: instruction::PING, parameters: vec![], checksum_ok: true };
        assert_eq!(all(Protocol::Dynamixel, &ping), [request]);
        let answer = [0xff, 0xff, 0xfd, 0, 1, 8, 0, 0x55, 0, 0xa6, 0, 0, 0, 0x8c, 0xc0];
        assert_eq!(status(Protocol::Dynamixel, 1, 0, &[0xa6, 0, 0, 0]), answer);
        let ping = [0xff, 0xff, 1, 2, 1, 0xfb];
        let request = Request { id: 1, instruction: instruction::PING, parameters: vec![], checksum_ok: true };
        assert_eq!(all(Protocol::Feetech, &ping), [request]);
        assert_eq!(status(Protocol::Feetech, 1, 0, &[0x20]), [0xff, 0xff, 1, 3, 0, 0x20, 0xdb]);
    }

    #[test]
    fn a_packet_is_found_after_noise_and_a_broken_packet() {
        let good = [0xff, 0xff, 1, 2, 1, 0xfb];
        let mut bytes = vec![0, 0xff, 7, 0xff];
        bytes.extend([0xff, 0xff, 2, 2, 1, 0]);
        bytes.extend(good);
        let found = all(Protocol::Feetech, &bytes);
        assert_eq!(found.iter().map(|request| request.checksum_ok).collect::<Vec<_>>(), [false, true]);
    }

    proptest! {
        #[test]
        fn requests_do_not_depend_on_how_bytes_are_split(
            bytes in prop::collection::vec(any::<u8>(), 0..600), cut in 1_usize..50,
        ) {
            for protocol in [Protocol::Dynamixel, Protocol::Feetech] {
                let mut parser = RequestParser::new(protocol);
                let mut found = Vec::new();
                for piece in bytes.chunks(cut) {
                    parser.push(piece);
                    found.extend(std::iter::from_fn(|| parser.next_request()));
                }
                prop_assert_eq!(found, all(protocol, &bytes));
            }
        }

        #[test]
        fn unstuffing_inverts_stuffing(
            body in prop::collection::vec(prop_oneof![Just(0xff_u8), Just(0xfd), any::<u8>()], 0..64),
        ) {
            let wire = stuffed(&body);
            prop_assert_eq!(unstuffed(&wire), body);
            // A stuffed body never contains a header.
            prop_assert!(!wire.windows(4).any(|four| four == [0xff, 0xff, 0xfd, 0x00]));
        }
    }
}
