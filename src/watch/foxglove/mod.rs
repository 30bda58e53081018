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

use std::io::ErrorKind;
use std::net::{SocketAddr, TcpListener};

use rustix::event::{PollFd, PollFlags, Timespec, poll};

use super::web::address::{WebAddress, token};
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
    let address = WebAddress::parse(address, PORT)?;
    let listener = address.listen()?;
    let failed = |cause: std::io::Error| WatchError::Address { address: address.to_string(), cause: cause.to_string() };
    listener.set_nonblocking(true).map_err(failed)?;
    let local = listener.local_addr().map_err(failed)?;
    let token = if local.ip().is_loopback() { None } else { Some(token().map_err(failed)?) };
    let query = token.as_ref().map_or(String::new(), |token| format!("?token={token}"));
    announce(&format!("ws://{local}/{query}")).map_err(WatchError::Output)?;
    follower.keep_samples();
    let mut server = FoxgloveServer { listener, local, token, clients: Vec::new(), feed: None, generation: 0 };
    let began = monotonic_ns();
    let mut next = began;
    while signals.received() == 0 {
        server.serve(next);
        let now = monotonic_ns();
        if now >= next {
            next = now + LOOK_NS;
            follower.look((now - began) as f64 / 1e9);
            server.update(follower, now);
        }
    }
    Ok(FaceEnd::Signal(signals.received()))
}

struct FoxgloveServer {
    listener: TcpListener,
    local: SocketAddr,
    token: Option<String>,
    clients: Vec<Client>,
    /// The channels of the run that is watched.
    feed: Option<SampleFeed>,
    /// Which run that is; 0 before the first.
    generation: u64,
}

impl FoxgloveServer {
    /// Takes what comes, and writes what can be written, until the instant `until`, ns.
    fn serve(&mut self, until: u64) {
        let wait = until.saturating_sub(monotonic_ns());
        let limit = Timespec { tv_sec: (wait / 1_000_000_000) as i64, tv_nsec: (wait % 1_000_000_000) as i64 };
        let mut fds = vec![PollFd::new(&self.listener, PollFlags::IN)];
        fds.extend(self.clients.iter().map(|client| {
            let writes = if client.has_output() { PollFlags::OUT } else { PollFlags::empty() };
            PollFd::new(client.stream(), PollFlags::IN | writes)
        }));
        let _ = poll(&mut fds, Some(&limit));
        let ready: Vec<bool> = fds[1..].iter().map(|fd| !fd.revents().is_empty()).collect();
        drop(fds);
        let now = monotonic_ns();
        for (client, _) in self.clients.iter_mut().zip(ready).filter(|(_, ready)| *ready) {
            if client.serve(self.local, self.token.as_deref()) {
                client.welcome(self.feed.as_ref(), self.generation);
            }
        }
        self.clients.retain(|client| client.is_open(now));
        while self.clients.len() < MOST_CLIENTS {
            match self.listener.accept() {
                Ok((stream, _)) => self.clients.extend(Client::new(stream, now)),
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(_) => return,
            }
        }
    }

    /// Hands every client what is new.
    fn update(&mut self, follower: &mut Follower, now: u64) {
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
