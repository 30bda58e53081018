//! Datagrams that only the holder of the shared key can make and read.
//!
//! A datagram begins with a header of 24 bytes, which is also the nonce of XChaCha20-Poly1305 and is authenticated with
//! the rest. It holds the sender's session (a random number, new with each start) and a count, so that no nonce comes
//! twice. Without a key the same datagrams travel in the open.

use std::io::Read as _;
use std::path::Path;

use chacha20poly1305::aead::{Aead, KeyInit as _, Payload};
use chacha20poly1305::{XChaCha20Poly1305, XNonce};

use crate::LinkError;

/// Bytes of the header.
pub const HEADER: usize = 24;
/// The first bytes of each datagram: what it is, and the version.
const MAGIC: [u8; 4] = *b"TLK1";

/// The two ends of a link.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum LinkSide {
    /// The machine that has the plant.
    Plant,
    /// The machine that has the controller.
    Controller,
}

impl LinkSide {
    /// The other end.
    pub fn other(self) -> Self {
        match self {
            Self::Plant => Self::Controller,
            Self::Controller => Self::Plant,
        }
    }

    /// The name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Plant => "plant",
            Self::Controller => "controller",
        }
    }
}

/// A key that both machines have.
#[derive(Clone)]
pub struct SharedKey(XChaCha20Poly1305);

impl SharedKey {
    /// Reads a file with 64 hexadecimal digits, as `tectum-link key` writes it.
    ///
    /// # Errors
    /// [`LinkError::Key`] when the file cannot be read or holds no key.
    pub fn read(path: &Path) -> Result<Self, LinkError> {
        let wrong = |cause: String| LinkError::Key { path: path.to_owned(), cause };
        let text = std::fs::read_to_string(path).map_err(|error| wrong(error.to_string()))?;
        let text = text.trim();
        let digits: Option<Vec<u8>> = (text.len() == 64 && text.is_ascii())
            .then(|| (0..32).map(|i| u8::from_str_radix(&text[2 * i..2 * i + 2], 16).ok()).collect())
            .flatten();
        let bytes = digits.ok_or_else(|| wrong("it does not hold 64 hexadecimal digits".to_owned()))?;
        Ok(Self(XChaCha20Poly1305::new(bytes.as_slice().into())))
    }
}

/// Random bytes of the operating system.
///
/// # Errors
/// [`LinkError::Random`] when it has none.
pub fn random<const N: usize>() -> Result<[u8; N], LinkError> {
    let mut bytes = [0; N];
    let read = std::fs::File::open("/dev/urandom").and_then(|mut file| file.read_exact(&mut bytes));
    read.map_err(LinkError::Random)?;
    Ok(bytes)
}

/// Whether a datagram is one of a link without a key.
pub fn is_open(datagram: &[u8]) -> bool {
    datagram.len() >= HEADER && datagram[..4] == MAGIC && datagram[5] == 0
}

/// Makes the datagrams of one session.
pub struct Sealer {
    key: Option<SharedKey>,
    side: LinkSide,
    session: u64,
    count: u64,
}

/// A datagram that was opened.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Opened {
    /// The sender's session.
    pub session: u64,
    /// Its number within the session, from 1.
    pub count: u64,
    /// What it carries.
    pub payload: Vec<u8>,
}

impl Sealer {
    /// A sealer for the session with this number.
    pub fn new(key: Option<SharedKey>, side: LinkSide, session: u64) -> Self {
        Self { key, side, session, count: 0 }
    }

    /// The session.
    pub fn session(&self) -> u64 {
        self.session
    }

    /// A datagram that carries `payload`.
    pub fn seal(&mut self, payload: &[u8]) -> Vec<u8> {
        self.count += 1;
        let mut header = [0; HEADER];
        header[..4].copy_from_slice(&MAGIC);
        (header[4], header[5]) = (self.side as u8, u8::from(self.key.is_some()));
        header[8..16].copy_from_slice(&self.session.to_le_bytes());
        header[16..].copy_from_slice(&self.count.to_le_bytes());
        let body = match &self.key {
            // It fails only for payloads of 256 GB.
            Some(key) => key.0.encrypt(XNonce::from_slice(&header), Payload { msg: payload, aad: &header }),
            None => Ok(payload.to_vec()),
        };
        let mut datagram = header.to_vec();
        datagram.extend(body.unwrap_or_default());
        datagram
    }

    /// What a datagram of the other side carries; `None` if it is not one, or was made with another key.
    pub fn open(&self, datagram: &[u8]) -> Option<Opened> {
        let header = datagram.get(..HEADER)?;
        let expected = [self.side.other() as u8, u8::from(self.key.is_some()), 0, 0];
        if header[..4] != MAGIC || header[4..8] != expected {
            return None;
        }
        let body = &datagram[HEADER..];
        let payload = match &self.key {
            Some(key) => key.0.decrypt(XNonce::from_slice(header), Payload { msg: body, aad: header }).ok()?,
            None => body.to_vec(),
        };
        let word = |at: usize| header[at..at + 8].try_into().map(u64::from_le_bytes).ok();
        Some(Opened { session: word(8)?, count: word(16)?, payload })
    }
}

/// Which datagrams of a session have come, so that none counts twice.
#[derive(Debug, Default)]
pub struct ReplayWindow {
    newest: u64,
    /// Bit i: datagram `newest - i` has come.
    seen: u64,
}

impl ReplayWindow {
    /// Whether datagram `count` is new. One that is 64 or more behind the newest never is.
    pub fn take(&mut self, count: u64) -> bool {
        if count > self.newest {
            self.seen = self.seen.checked_shl((count - self.newest).min(64) as u32).unwrap_or(0) | 1;
            self.newest = count;
            return true;
        }
        let behind = self.newest - count;
        let fresh = count > 0 && behind < 64 && self.seen >> behind & 1 == 0;
        if fresh {
            self.seen |= 1 << behind;
        }
        fresh
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn key(byte: u8) -> Option<SharedKey> {
        Some(SharedKey(XChaCha20Poly1305::new((&[byte; 32]).into())))
    }

    #[test]
    fn only_the_same_key_opens_and_no_byte_can_be_changed() {
        let mut plant = Sealer::new(key(1), LinkSide::Plant, 7);
        let controller = Sealer::new(key(1), LinkSide::Controller, 8);
        let datagram = plant.seal(b"observation");
        let opened = controller.open(&datagram).unwrap();
        assert_eq!((opened.session, opened.count, opened.payload.as_slice()), (7, 1, &b"observation"[..]));
        assert!(!datagram.windows(11).any(|part| part == b"observation"), "it can be read");
        for i in 0..datagram.len() {
            let mut changed = datagram.clone();
            changed[i] ^= 1;
            assert_eq!(controller.open(&changed), None, "byte {i}");
            assert_eq!(controller.open(&datagram[..i]), None, "cut to {i}");
        }
        for other in [key(2), None] {
            assert_eq!(Sealer::new(other, LinkSide::Controller, 8).open(&datagram), None);
        }
        assert_eq!(plant.open(&datagram), None, "sent back to its sender");
    }

    #[test]
    fn without_a_key_the_same_datagrams_are_open() {
        let mut plant = Sealer::new(None, LinkSide::Plant, 7);
        let datagram = plant.seal(b"x");
        assert_eq!(Sealer::new(None, LinkSide::Controller, 8).open(&datagram).unwrap().payload, b"x");
        assert_eq!(Sealer::new(key(1), LinkSide::Controller, 8).open(&datagram), None);
    }

    #[test]
    fn a_datagram_counts_once() {
        let mut window = ReplayWindow::default();
        let taken: Vec<bool> = [1, 1, 3, 2, 2, 3, 100, 37, 36, 99, 0].map(|count| window.take(count)).to_vec();
        assert_eq!(taken, [true, false, true, true, false, false, true, true, false, true, false]);
    }
}
