//! The bare transports that Tectum is measured against, and one end of such a transport: what the asking
//! process and its peer have in common.

use std::fs::File;
use std::io::{Read as _, Write as _};
use std::time::Duration;

use rustix::thread::sched_yield;

use crate::channel::{BareExchange, ChannelError, Exchange, Payload, SharedPage};

/// A means to send a sample to another process and receive one back.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Transport {
    /// iceoryx2; both sides sleep until an event wakes them.
    Event,
    /// iceoryx2; both sides poll, with a `sched_yield` between.
    Poll,
    /// A pair of Unix-domain sockets of type SEQPACKET, blocking.
    Socket,
    /// Two pipes, blocking.
    Pipe,
    /// Shared memory, and a futex in each direction.
    Futex,
}

impl Transport {
    /// All transports.
    pub const ALL: [Self; 5] = [Self::Event, Self::Poll, Self::Socket, Self::Pipe, Self::Futex];

    /// Its name in tables, in files and on the peer's command line.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Event => "iceoryx2-event",
            Self::Poll => "iceoryx2-poll",
            Self::Socket => "unix-socket",
            Self::Pipe => "pipe",
            Self::Futex => "futex",
        }
    }

    /// The transport of this name.
    pub fn of(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|transport| transport.name() == name)
    }
}

/// The tick of the observation with which the asking side ends the exchange.
pub(super) const DONE: u64 = u64::MAX;
/// The flag of an observation that asks the peer for the instant at which it sends the command.
pub(super) const STAMPED: u32 = 1;
/// How long a sleeping side waits before it checks whether to go on.
const CHECK_INTERVAL: Duration = Duration::from_millis(100);
/// How often a polling side polls before it checks whether to go on: some milliseconds.
const CHECK_POLLS: u32 = 4096;

/// One end: it sends `S` and receives `R`.
pub(super) enum TransportEnd<S: Payload, R: Payload> {
    /// iceoryx2, sleeping between samples or polling.
    Bare { ends: Box<BareExchange<S, R>>, asleep: bool },
    /// File descriptors that block.
    Stream { to: File, from: File },
    /// Shared memory and futexes.
    Page(SharedPage),
}

/// Why nothing was sent or received.
#[derive(Debug, thiserror::Error)]
pub(super) enum TransportError {
    #[error(transparent)]
    Channel(#[from] ChannelError),
    #[error(transparent)]
    System(#[from] std::io::Error),
}

impl<S: Payload, R: Payload> TransportEnd<S, R>
where
    BareExchange<S, R>: Exchange<S, R>,
{
    #[inline]
    pub fn send(&mut self, sample: &S) -> Result<(), TransportError> {
        match self {
            Self::Bare { ends, asleep } => {
                ends.send(sample)?;
                if *asleep {
                    ends.notify();
                }
            }
            Self::Stream { to, .. } => to.write_all(bytemuck::bytes_of(sample))?,
            Self::Page(page) => page.send(bytemuck::cast_slice(bytemuck::bytes_of(sample))),
        }
        Ok(())
    }

    /// Waits for the next sample. Calls `check` now and then; an error of `check` ends the wait.
    #[inline]
    pub fn receive<E: From<TransportError>>(&mut self, mut check: impl FnMut() -> Result<(), E>) -> Result<R, E> {
        let mut sample = R::zeroed();
        match self {
            Self::Bare { ends, asleep } => {
                let mut polls = 0_u32;
                loop {
                    if let Some(sample) = ends.receive().map_err(TransportError::from)? {
                        return Ok(sample);
                    }
                    polls += 1;
                    if *asleep {
                        if polls > 1 {
                            check()?;
                        }
                        ends.wait(CHECK_INTERVAL);
                    } else {
                        if polls.is_multiple_of(CHECK_POLLS) {
                            check()?;
                        }
                        sched_yield();
                    }
                }
            }
            // No check: the stream ends when the other process does.
            Self::Stream { from, .. } => {
                from.read_exact(bytemuck::bytes_of_mut(&mut sample)).map_err(TransportError::from)?;
            }
            Self::Page(page) => {
                while !page.receive(bytemuck::cast_slice_mut(bytemuck::bytes_of_mut(&mut sample)), CHECK_INTERVAL) {
                    check()?;
                }
            }
        }
        Ok(sample)
    }
}
