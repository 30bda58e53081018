//! What the faces that serve over sockets share: the address, who may connect, and one loop that waits for nobody.

use std::io::ErrorKind;
use std::net::{SocketAddr, TcpListener, TcpStream};

use rustix::event::{PollFd, PollFlags, Timespec, poll};

use super::address::{WebAddress, token};
use super::{FaceEnd, Follower, WatchError};
use crate::clock::{TerminationSignals, monotonic_ns};

/// A socket that is listened on.
#[derive(Debug)]
pub(super) struct SocketServer {
    listener: TcpListener,
    /// Where it is.
    pub local: SocketAddr,
    /// What a client of another machine has to know; `None` where only this machine can connect.
    pub token: Option<String>,
}

impl SocketServer {
    /// Listens at `address` (`ADDR:PORT`, a port alone, or nothing: `usual_port`, or another that is free).
    ///
    /// # Errors
    /// [`WatchError::Address`].
    pub fn open(address: &str, usual_port: u16) -> Result<Self, WatchError> {
        let address = WebAddress::parse(address, usual_port)?;
        let listener = address.listen()?;
        let failed =
            |cause: std::io::Error| WatchError::Address { address: address.to_string(), cause: cause.to_string() };
        listener.set_nonblocking(true).map_err(failed)?;
        let local = listener.local_addr().map_err(failed)?;
        let token = if local.ip().is_loopback() { None } else { Some(token().map_err(failed)?) };
        Ok(Self { listener, local, token })
    }

    /// The link to `path`, with the token.
    pub fn link(&self, scheme: &str, path: &str) -> String {
        let query = self.token.as_ref().map_or(String::new(), |token| format!("?token={token}"));
        format!("{scheme}://{}/{path}{query}", self.local)
    }

    /// Waits until the instant `until`, ns, for somebody who connects, or for one of `clients` (socket, and whether
    /// something is still to be written to it). Gives which of them can be served.
    pub fn wait<'a>(&self, clients: impl Iterator<Item = (&'a TcpStream, bool)>, until: u64) -> Vec<bool> {
        let wait = until.saturating_sub(monotonic_ns());
        let limit = Timespec { tv_sec: (wait / 1_000_000_000) as i64, tv_nsec: (wait % 1_000_000_000) as i64 };
        let mut fds = vec![PollFd::new(&self.listener, PollFlags::IN)];
        fds.extend(clients.map(|(stream, has_output)| {
            let writes = if has_output { PollFlags::OUT } else { PollFlags::empty() };
            PollFd::new(stream, PollFlags::IN | writes)
        }));
        let _ = poll(&mut fds, Some(&limit));
        fds[1..].iter().map(|fd| !fd.revents().is_empty()).collect()
    }

    /// Adds who has connected to `clients`, up to `most` in all. `new` makes a client of a socket, unless it is gone.
    pub fn accept<C>(&self, clients: &mut Vec<C>, most: usize, new: impl Fn(TcpStream) -> Option<C>) {
        // More wait in the listener's queue until there is room.
        while clients.len() < most {
            match self.listener.accept() {
                Ok((stream, _)) => clients.extend(new(stream)),
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(_) => return,
            }
        }
    }
}

/// A face that serves over sockets.
pub(super) trait SocketFace {
    /// Takes what comes, and writes what can be written, until the instant `until`, ns.
    fn serve(&mut self, follower: &Follower, until: u64);

    /// Hands every client what is new at `now`, ns, which is `seconds` after the beginning.
    fn update(&mut self, follower: &mut Follower, now: u64, seconds: f64);
}

/// Looks at the run every `interval` ns and serves, until a signal comes.
pub(super) fn run_face(
    face: &mut dyn SocketFace,
    follower: &mut Follower,
    signals: &TerminationSignals,
    interval: u64,
) -> FaceEnd {
    let began = monotonic_ns();
    let mut next = began;
    while signals.received() == 0 {
        face.serve(follower, next);
        let now = monotonic_ns();
        if now >= next {
            next = now + interval;
            let seconds = (now - began) as f64 / 1e9;
            follower.look(seconds);
            face.update(follower, now, seconds);
        }
    }
    FaceEnd::Signal(signals.received())
}
