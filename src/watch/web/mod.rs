//! The browser's face: serves the page and, to each reader, server-sent events; and metrics for Prometheus.
//!
//! One thread does all of it, and waits for nobody. A connection is read and written as far as that goes at once. A
//! reader gets its next update when it has taken the one before, so that a slow one gets fewer, and a connection that
//! asks for nothing is closed.
//!
//! Only this machine may read, unless the user names another address: then a token is needed, which the printed link
//! has. A request from this machine must name it as its host, so that a page of somebody else's cannot read a run
//! through a name that leads here.

mod connection;
pub(super) mod request;

use tectum_view::{metrics, page};

use super::socket_server::{SocketFace, SocketServer, run_face};
use super::{FaceEnd, Follower, WatchError, WatchTarget};
use crate::clock::{TerminationSignals, monotonic_ns};
use crate::process::print_error_line;
use connection::{Connection, Served};

/// The port that is taken if it is free and the user named none.
const PORT: u16 = 8417;
/// Time between two updates, ns.
const UPDATE_NS: u64 = 50_000_000;
/// The same in a launcher that serves metrics of its own run, ns.
const OWN_UPDATE_NS: u64 = 200_000_000;
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

/// Serves metrics of the run that this process is about to launch, from a thread of its own that ends with the process.
/// Returns their address. The run is only read, as by any watcher, and as seldom as the launcher itself looks at it in
/// real time.
///
/// # Errors
/// [`WatchError::Address`] if the address cannot be listened on, [`WatchError::Thread`] if there can be no thread.
pub fn serve_metrics_of_own_run(address: &str) -> Result<String, WatchError> {
    let server = SocketServer::open(address, PORT)?;
    let link = server.link("http", "metrics");
    let mut face = WebFace { server, page: None, connections: Vec::new() };
    let thread = std::thread::Builder::new().name("metrics".to_owned());
    let serve = move || {
        match Follower::open(WatchTarget::LaunchedBy(std::process::id()), true) {
            // Signals are the launcher's.
            Ok(mut follower) => {
                run_face(&mut face, &mut follower, &TerminationSignals::default(), OWN_UPDATE_NS);
            }
            Err(error) => print_error_line(&format!("tectum: warning: no metrics are served: {error}")),
        }
    };
    thread.spawn(serve).map_err(WatchError::Thread)?;
    Ok(link)
}

/// Serves `page`, or metrics alone where there is none.
fn serve(
    follower: &mut Follower,
    address: &str,
    page: Option<String>,
    signals: &TerminationSignals,
    announce: impl FnOnce(&str) -> std::io::Result<()>,
) -> Result<FaceEnd, WatchError> {
    let server = SocketServer::open(address, PORT)?;
    let path = if page.is_some() { "" } else { "metrics" };
    announce(&server.link("http", path)).map_err(WatchError::Output)?;
    let mut face = WebFace { server, page, connections: Vec::new() };
    Ok(run_face(&mut face, follower, signals, UPDATE_NS))
}

struct WebFace {
    server: SocketServer,
    page: Option<String>,
    connections: Vec<Connection>,
}

impl SocketFace for WebFace {
    fn serve(&mut self, follower: &Follower, until: u64) {
        let sockets = self.connections.iter().map(|connection| (connection.stream(), connection.has_output()));
        let ready = self.server.wait(sockets, until);
        let now = monotonic_ns();
        let (page, token) = (self.page.as_deref(), self.server.token.as_deref());
        let served = Served { page, metrics: &|| metrics(follower.view()), local: self.server.local, token };
        for (connection, _) in self.connections.iter_mut().zip(ready).filter(|(_, ready)| *ready) {
            connection.serve(&served);
        }
        self.connections.retain(|connection| connection.is_open(now));
        self.server.accept(&mut self.connections, MOST_CONNECTIONS, |stream| Connection::new(stream, now));
    }

    fn update(&mut self, follower: &mut Follower, _now: u64, seconds: f64) {
        for connection in &mut self.connections {
            match follower.view() {
                Some(view) => connection.update(view, follower.generation(), seconds),
                None => connection.notice(follower.waits_for(), seconds),
            }
        }
    }
}
