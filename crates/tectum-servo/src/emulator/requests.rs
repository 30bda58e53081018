//! Finds the host's instructions in the bytes on the wire. Bytes that do not belong to a packet are skipped one by
//! one, as by a servo that waits for a header.

use crate::model::Protocol;
use crate::packet::{Packet, Parsed, parse};

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
    pub fn next_request(&mut self) -> Option<Packet> {
        let mut skipped = 0;
        let found = loop {
            match parse(self.protocol, &self.bytes[skipped..]) {
                Parsed::Packet(length, request) => {
                    skipped += length;
                    break Some(request);
                }
                Parsed::Noise => skipped += 1,
                Parsed::Incomplete => break None,
            }
        };
        self.bytes.drain(..skipped);
        found
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn all(protocol: Protocol, bytes: &[u8]) -> Vec<Packet> {
        let mut parser = RequestParser::new(protocol);
        parser.push(bytes);
        std::iter::from_fn(|| parser.next_request()).collect()
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
    }
}
