//! What carries datagrams from one machine to the other: zenoh, or bare UDP.
//!
//! Both are best effort: nothing is sent twice and nothing waits for what was lost. zenoh's own declarations may be
//! lost as well, so that an end which hears nothing opens its session anew (`renew`).

use std::net::{IpAddr, SocketAddr, UdpSocket};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use tectum::scenario::LinkConfig;

#[cfg(feature = "zenoh")]
use crate::zenoh_carrier::ZenohCarrier;
use crate::{LinkError, LinkSide};

/// Where the two ends meet: one listens there, the other connects to it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Endpoint {
    /// As it was given.
    pub text: String,
    /// Address and port.
    pub address: SocketAddr,
    /// Bare UDP instead of zenoh.
    pub raw: bool,
    /// Whether this end listens.
    pub listens: bool,
}

/// Takes a datagram; true if it is one of the link.
pub type Receive = Arc<dyn Fn(&[u8]) -> bool + Send + Sync>;

/// Longest datagram, bytes.
const LONGEST: usize = 8192;
/// How often the receiving thread looks whether it should end.
const LOOK: Duration = Duration::from_millis(100);

impl Endpoint {
    /// Reads `udp/ADDRESS:PORT` (zenoh over UDP) or `raw/ADDRESS:PORT` (bare UDP).
    ///
    /// # Errors
    /// [`LinkError::Address`].
    pub fn parse(text: &str, listens: bool) -> Result<Self, LinkError> {
        let wrong = |cause: &str| LinkError::Address { text: text.to_owned(), cause: cause.to_owned() };
        let (raw, address) = match text.split_once('/') {
            Some(("udp", _)) if cfg!(not(feature = "zenoh")) => {
                return Err(wrong("this program was built without zenoh"));
            }
            Some(("udp", address)) => (false, address),
            Some(("raw", address)) => (true, address),
            _ => return Err(wrong("it begins neither with udp/ (zenoh) nor with raw/ (bare UDP)")),
        };
        let address: SocketAddr = address.parse().map_err(|_| wrong("it has no IP address with a port"))?;
        if address.ip().is_unspecified() || address.port() == 0 {
            return Err(wrong("it names no single address and port of this machine or the other"));
        }
        Ok(Self { text: text.to_owned(), address, raw, listens })
    }
}

/// Carries datagrams.
pub enum Carrier {
    /// Bare UDP.
    Raw(RawCarrier),
    /// zenoh over UDP.
    #[cfg(feature = "zenoh")]
    Zenoh(Box<ZenohCarrier>),
}

impl Carrier {
    /// Opens this end. `hosts` is whom the link may talk with, if that is limited: where there is no key.
    ///
    /// # Errors
    /// [`LinkError::Carrier`] when the address cannot be used.
    pub fn open(
        endpoint: &Endpoint,
        side: LinkSide,
        hosts: Option<LinkConfig>,
        receive: Receive,
    ) -> Result<Self, LinkError> {
        #[cfg(feature = "zenoh")]
        if !endpoint.raw {
            return ZenohCarrier::open(endpoint, side, hosts, receive).map(|zenoh| Self::Zenoh(Box::new(zenoh)));
        }
        let _ = side;
        RawCarrier::open(endpoint, hosts, receive).map(Self::Raw)
    }

    /// Sends a datagram, or loses it.
    pub fn send(&self, datagram: &[u8]) {
        match self {
            Self::Raw(raw) => raw.send(datagram),
            #[cfg(feature = "zenoh")]
            Self::Zenoh(zenoh) => zenoh.send(datagram),
        }
    }

    /// Opens the way to the other end anew, because nothing is heard of it.
    pub fn renew(&self) {
        #[cfg(feature = "zenoh")]
        if let Self::Zenoh(zenoh) = self {
            zenoh.renew();
        }
    }

    /// An address that takes part and may not, where that is limited.
    pub fn intruder(&self) -> Option<IpAddr> {
        match self {
            // It never hears datagrams of others.
            Self::Raw(_) => None,
            #[cfg(feature = "zenoh")]
            Self::Zenoh(zenoh) => zenoh.intruder(),
        }
    }
}

/// Datagrams over a socket.
pub struct RawCarrier {
    socket: UdpSocket,
    /// Where the other end was last heard.
    peer: Arc<Mutex<Option<SocketAddr>>>,
    ends: Arc<AtomicBool>,
}

impl RawCarrier {
    fn open(endpoint: &Endpoint, hosts: Option<LinkConfig>, receive: Receive) -> Result<Self, LinkError> {
        let failed =
            |cause: std::io::Error| LinkError::Carrier { address: endpoint.text.clone(), cause: cause.to_string() };
        let any = match endpoint.address {
            SocketAddr::V4(_) => SocketAddr::from(([0, 0, 0, 0], 0)),
            SocketAddr::V6(_) => SocketAddr::from(([0; 8], 0)),
        };
        let socket = UdpSocket::bind(if endpoint.listens { endpoint.address } else { any }).map_err(failed)?;
        socket.set_read_timeout(Some(LOOK)).map_err(failed)?;
        let peer = Arc::new(Mutex::new((!endpoint.listens).then_some(endpoint.address)));
        let ends = Arc::new(AtomicBool::new(false));
        let (own, known, stop) = (socket.try_clone().map_err(failed)?, Arc::clone(&peer), Arc::clone(&ends));
        let read = move || {
            let mut bytes = [0; LONGEST];
            while !stop.load(Ordering::Relaxed) {
                // Errors are time-outs, and what ICMP says of an end that is not there yet.
                let Ok((length, from)) = own.recv_from(&mut bytes) else { continue };
                if hosts.as_ref().is_none_or(|hosts| hosts.names(from.ip())) && receive(&bytes[..length]) {
                    *known.lock().unwrap_or_else(PoisonError::into_inner) = Some(from);
                }
            }
        };
        std::thread::Builder::new().name("link-receiver".to_owned()).spawn(read).map_err(LinkError::Thread)?;
        Ok(Self { socket, peer, ends })
    }

    fn send(&self, datagram: &[u8]) {
        let peer = *self.peer.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(peer) = peer {
            // Best effort: a network that is down loses it.
            let _ = self.socket.send_to(datagram, peer);
        }
    }
}

impl Drop for RawCarrier {
    fn drop(&mut self) {
        self.ends.store(true, Ordering::Relaxed);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_address_is_one_address_with_a_port() {
        let raw = Endpoint::parse("raw/127.0.0.1:7447", true).unwrap();
        assert!(raw.raw && raw.listens && raw.address.port() == 7447);
        for wrong in ["127.0.0.1:7447", "tcp/127.0.0.1:7447", "raw/robot:7447", "raw/127.0.0.1", "raw/0.0.0.0:7447", ""]
        {
            let error = Endpoint::parse(wrong, false).unwrap_err().to_string();
            assert!(error.contains("give one such as udp/"), "{error}");
        }
    }
}
