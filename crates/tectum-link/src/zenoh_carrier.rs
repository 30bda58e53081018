//! Datagrams over zenoh: a session that talks with the other machine alone, without scouting.

use std::net::{IpAddr, SocketAddr};
use std::sync::{Mutex, PoisonError};

use tectum::scenario::LinkConfig;
use zenoh::Wait as _;
use zenoh::pubsub::{Publisher, Subscriber};
use zenoh::qos::{CongestionControl, Reliability};

use crate::carrier::{Endpoint, Receive};
use crate::{LinkError, LinkSide};

/// An open session. Fields are dropped in this order.
struct OpenSession {
    publisher: Publisher<'static>,
    _subscriber: Subscriber<()>,
    session: zenoh::Session,
}

/// A session, opened anew on demand.
pub struct ZenohCarrier {
    endpoint: Endpoint,
    side: LinkSide,
    hosts: Option<LinkConfig>,
    receive: Receive,
    open: Mutex<Option<OpenSession>>,
}

impl ZenohCarrier {
    /// Opens a session.
    ///
    /// # Errors
    /// [`LinkError::Carrier`] when the address cannot be used.
    pub fn open(
        endpoint: &Endpoint,
        side: LinkSide,
        hosts: Option<LinkConfig>,
        receive: Receive,
    ) -> Result<Self, LinkError> {
        let open = open_session(endpoint, side, &receive)
            .map_err(|cause| LinkError::Carrier { address: endpoint.text.clone(), cause: cause.to_string() })?;
        Ok(Self { endpoint: endpoint.clone(), side, hosts, receive, open: Mutex::new(Some(open)) })
    }

    /// Publishes a datagram.
    pub fn send(&self, datagram: &[u8]) {
        if let Some(open) = &*self.open.lock().unwrap_or_else(PoisonError::into_inner) {
            // Best effort: a session without the other machine loses it.
            let _ = open.publisher.put(datagram).wait();
        }
    }

    /// Closes the session and opens another one. Only the end that connects does so: the other one has no way to.
    pub fn renew(&self) {
        if self.endpoint.listens {
            return;
        }
        let old = self.open.lock().unwrap_or_else(PoisonError::into_inner).take();
        if let Some(old) = old {
            let _ = old.session.close().wait();
        }
        // A network that is down is tried again the next time.
        let new = open_session(&self.endpoint, self.side, &self.receive).ok();
        *self.open.lock().unwrap_or_else(PoisonError::into_inner) = new;
    }

    /// An address on the other end of a link of this session that may not take part.
    pub fn intruder(&self) -> Option<IpAddr> {
        let hosts = self.hosts.as_ref()?;
        let open = self.open.lock().unwrap_or_else(PoisonError::into_inner);
        let links = open.as_ref()?.session.info().links().wait();
        let address = |locator: &zenoh::config::Locator| locator.address().as_str().parse::<SocketAddr>().ok();
        links.filter_map(|link| address(link.dst())).map(|address| address.ip()).find(|&ip| !hosts.names(ip))
    }
}

fn open_session(endpoint: &Endpoint, side: LinkSide, receive: &Receive) -> zenoh::Result<OpenSession> {
    let locator = format!("[\"udp/{}\"]", endpoint.address);
    let (listen, connect) = if endpoint.listens { (locator.as_str(), "[]") } else { ("[]", locator.as_str()) };
    let mut config = zenoh::Config::default();
    for (key, value) in [
        ("mode", "\"peer\""),
        ("scouting/multicast/enabled", "false"),
        ("scouting/gossip/enabled", "false"),
        ("listen/endpoints", listen),
        ("connect/endpoints", connect),
        // The link itself tries again.
        ("connect/timeout_ms", "1000"),
        ("connect/exit_on_failure", "false"),
        ("transport/link/tx/lease", "3000"),
        // An opening whose datagram was lost would keep the end waiting for 10 s.
        ("transport/unicast/open_timeout", "1000"),
        ("transport/unicast/accept_timeout", "1000"),
    ] {
        config.insert_json5(key, value)?;
    }
    let session = zenoh::open(config).wait()?;
    let (from, to) = (side.other().name(), side.name());
    let receive = Receive::clone(receive);
    let subscriber = session
        .declare_subscriber(format!("tectum/link/{from}"))
        .callback(move |sample| {
            receive(&sample.payload().to_bytes());
        })
        .wait()?;
    let publisher = session
        .declare_publisher(format!("tectum/link/{to}"))
        .congestion_control(CongestionControl::Drop)
        .reliability(Reliability::BestEffort)
        .express(true)
        .wait()?;
    Ok(OpenSession { publisher, _subscriber: subscriber, session })
}
