//! The face for Foxglove, Lichtblick and PlotJuggler: a server of the Foxglove WebSocket protocol, with the channels
//! and schemas of the run's log.
//!
//! One thread does all of it, and waits for nobody. Each client has a queue of its own, bounded in size, from which the
//! oldest messages are dropped when it reads too slowly; it is told how many. Who may connect is decided as for the
//! page of the browser's face, but a page of any origin on this machine may, because the viewers are such pages.

mod client;
mod feed;
mod handshake;
mod protocol;

use super::socket_server::{SocketFace, SocketServer, run_face};
use super::{FaceEnd, Follower, WatchError};
use crate::clock::{TerminationSignals, monotonic_ns};
use client::Client;
use feed::SampleFeed;

/// The port that the viewers propose.
const PORT: u16 = 8765;
/// Time between two looks at the run, ns.
const LOOK_NS: u64 = 20_000_000;
/// Most clients at a time.
const MOST_CLIENTS: usize = 32;

/// Serves the protocol at `address` (`ADDR:PORT`, a port alone, or nothing) until a signal comes. `announce` gets the
/// address when clients can connect.
///
/// # Errors
/// [`WatchError::Address`] if the address cannot be listened on, [`WatchError::Output`] if `announce` fails.
pub fn watch_by_foxglove(
    follower: &mut Follower,
    address: &str,
    signals: &TerminationSignals,
    announce: impl FnOnce(&str) -> std::io::Result<()>,
) -> Result<FaceEnd, WatchError> {
    let server = SocketServer::open(address, PORT)?;
    announce(&server.link("ws", "")).map_err(WatchError::Output)?;
    follower.keep_samples();
    let mut face = FoxgloveFace { server, clients: Vec::new(), feed: None, generation: 0 };
    Ok(run_face(&mut face, follower, signals, LOOK_NS))
}

struct FoxgloveFace {
    server: SocketServer,
    clients: Vec<Client>,
    /// The channels of the run that is watched.
    feed: Option<SampleFeed>,
    /// Which run that is; 0 before the first.
    generation: u64,
}

impl SocketFace for FoxgloveFace {
    fn serve(&mut self, _follower: &Follower, until: u64) {
        let sockets = self.clients.iter().map(|client| (client.stream(), client.has_output()));
        let ready = self.server.wait(sockets, until);
        let now = monotonic_ns();
        for (client, _) in self.clients.iter_mut().zip(ready).filter(|(_, ready)| *ready) {
            if client.serve(self.server.local, self.server.token.as_deref()) {
                client.welcome(self.feed.as_ref(), self.generation);
            }
        }
        self.clients.retain(|client| client.is_open(now));
        self.server.accept(&mut self.clients, MOST_CLIENTS, |stream| Client::new(stream, now));
    }

    fn update(&mut self, follower: &mut Follower, now: u64, _seconds: f64) {
        if self.generation != follower.generation()
            && let Some((facts, channels)) = follower.view_facts()
        {
            self.generation = follower.generation();
            let name = follower.view().map_or(String::new(), |view| view.facts.name.clone());
            self.feed = Some(SampleFeed::new(facts, &channels, self.generation, &name));
            self.clients.iter_mut().for_each(|client| client.welcome(self.feed.as_ref(), self.generation));
        }
        let Some(feed) = &mut self.feed else {
            self.clients.iter_mut().for_each(|client| client.say(follower.waits_for()));
            return;
        };
        for sample in follower.take_samples() {
            feed.take(&sample, |channel, ns, data| {
                self.clients.iter_mut().for_each(|client| client.send(channel, ns, data));
            });
        }
        let ended = follower.view().and_then(|view| view.ended.clone());
        for client in &mut self.clients {
            ended.iter().for_each(|how| client.say(how));
            client.update(now);
        }
    }
}
