//! The browser's face: serves the page and, to each reader, server-sent events; and metrics for Prometheus.
//!
//! One thread does all of it, and waits for nobody. A connection is read and written as far as that goes at once. A
//! reader gets its next update when it has taken the one before, so that a slow one gets fewer, and a connection that
//! asks for nothing is closed.
//!
//! Only this machine may read, unless the user names another address: then a token is needed, which the printed link
//! has. A request from this machine must name it as its host, so that a page of somebody else's cannot read a run
//! through a name that leads here.

pub(super) mod address;
mod connection;
pub(super) mod request;

use std::io::ErrorKind;
use std::net::{SocketAddr, TcpListener};

use rustix::event::{PollFd, PollFlags, Timespec, poll};
use tectum_view::{metrics, page};

use super::{FaceEnd, Follower, WatchError};
use crate::clock::{TerminationSignals, monotonic_ns};
use address::WebAddress;
use connection::{Connection, Served};

/// The port that is taken if it is free and the user named none.
const PORT: u16 = 8417;
/// Time between two updates, ns.
const UPDATE_NS: u64 = 50_000_000;
/// Most connections at a time.
const MOST_CONNECTIONS: usize = 64;

/// Serves the page at `address` (`ADDR:PORT`, a port alone, or nothing), and metrics beside it, until a signal comes.
/// `announce` gets the page's address when it can be read.
///
/// # Errors
/// [`WatchError::Address`] if the address cannot be listened on, [`WatchError::Output`] if `announce` fails.
pub fn watch_in_browser(
    follower: &mut Follower,
    address: &str,
    signals: &TerminationSignals,
    announce: impl FnOnce(&str) -> std::io::Result<()>,
) -> Result<FaceEnd, WatchError> {
    serve(follower, address, Some(page::page()), signals, announce)
}

/// Serves metrics for Prometheus, and no page, in the same way; they are at `/metrics`.
///
/// # Errors
/// As [`watch_in_browser`].
pub fn serve_metrics(
    follower: &mut Follower,
    address: &str,
    signals: &TerminationSignals,
    announce: impl FnOnce(&str) -> std::io::Result<()>,
) -> Result<FaceEnd, WatchError> {
    serve(follower, address, None, signals, announce)
}

/// Serves `page`, or metrics alone where there is none.
fn serve(
    follower: &mut Follower,
    address: &str,
    page: Option<String>,
    signals: &TerminationSignals,
    announce: impl FnOnce(&str) -> std::io::Result<()>,
) -> Result<FaceEnd, WatchError> {
    let address = WebAddress::parse(address, PORT)?;
    let listener = address.listen()?;
    let failed = |cause: std::io::Error| WatchError::Address { address: address.to_string(), cause: cause.to_string() };
    listener.set_nonblocking(true).map_err(failed)?;
    let local = listener.local_addr().map_err(failed)?;
    let token = if local.ip().is_loopback() { None } else { Some(address::token().map_err(failed)?) };
    let path = if page.is_some() { "" } else { "metrics" };
    announce(&link(local, path, token.as_deref())).map_err(WatchError::Output)?;
    let mut server = Server { listener, local, token, page, connections: Vec::new() };
    let began = monotonic_ns();
    let mut next = began;
    while signals.received() == 0 {
        server.serve(next, follower);
        let now = monotonic_ns();
        if now >= next {
            next = now + UPDATE_NS;
            let seconds = (now - began) as f64 / 1e9;
            follower.look(seconds);
            server.update(follower, seconds);
        }
    }
    Ok(FaceEnd::Signal(signals.received()))
}

fn link(local: SocketAddr, path: &str, token: Option<&str>) -> String {
    format!("http://{local}/{path}{}", token.map_or(String::new(), |token| format!("?token={token}")))
}

struct Server {
    listener: TcpListener,
    local: SocketAddr,
    token: Option<String>,
    page: Option<String>,
    connections: Vec<Connection>,
}

impl Server {
    /// Takes what comes, and writes what can be written, until the instant `until`, ns.
    fn serve(&mut self, until: u64, follower: &Follower) {
        let now = monotonic_ns();
        let wait = until.saturating_sub(now);
        let limit = Timespec { tv_sec: (wait / 1_000_000_000) as i64, tv_nsec: (wait % 1_000_000_000) as i64 };
        let mut fds = vec![PollFd::new(&self.listener, PollFlags::IN)];
        fds.extend(self.connections.iter().map(|connection| {
            let writes = if connection.has_output() { PollFlags::OUT } else { PollFlags::empty() };
            PollFd::new(connection.stream(), PollFlags::IN | writes)
        }));
        let _ = poll(&mut fds, Some(&limit));
        let ready: Vec<bool> = fds[1..].iter().map(|fd| !fd.revents().is_empty()).collect();
        drop(fds);
        let now = monotonic_ns();
        let (page, token) = (self.page.as_deref(), self.token.as_deref());
        let served = Served { page, metrics: &|| metrics(follower.view()), local: self.local, token };
        for (connection, _) in self.connections.iter_mut().zip(ready).filter(|(_, ready)| *ready) {
            connection.serve(&served);
        }
        self.connections.retain(|connection| connection.is_open(now));
        self.accept(now);
    }

    fn accept(&mut self, now: u64) {
        // More wait in the listener's queue until there is room.
        while self.connections.len() < MOST_CONNECTIONS {
            match self.listener.accept() {
                Ok((stream, _)) => self.connections.extend(Connection::new(stream, now)),
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(_) => return,
            }
        }
    }

    /// Sends every reader what is new.
    fn update(&mut self, follower: &Follower, now: f64) {
        for connection in &mut self.connections {
            match follower.view() {
                Some(view) => connection.update(view, follower.generation(), now),
                None => connection.notice(follower.waits_for(), now),
            }
        }
    }
}
