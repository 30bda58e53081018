//! A process's end of a way to another process and back: what the asking and the answering side have in common.

use std::fs::File;
use std::io::{Read as _, Write as _};
use std::time::Duration;

use rustix::thread::sched_yield;

use crate::channel::{BareExchange, ChannelError, Payload, SharedPage};

/// A way there and back.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Transport {
    /// iceoryx2, both sides asleep until a bell rings.
    Event,
    /// iceoryx2, both sides looking again and again, with a `sched_yield` between.
    Poll,
    /// A pair of Unix-domain sockets of type SEQPACKET, blocking.
    Socket,
    /// Two pipes, blocking.
    Pipe,
    /// Shared memory and a futex a direction.
    Futex,
}

impl Transport {
    /// All of them.
    pub const ALL: [Self; 5] = [Self::Event, Self::Poll, Self::Socket, Self::Pipe, Self::Futex];

    /// Its name, in tables, files and on the other process's command line.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Event => "iceoryx2-event",
            Self::Poll => "iceoryx2-poll",
            Self::Socket => "unix-socket",
            Self::Pipe => "pipe",
            Self::Futex => "futex",
        }
    }

    /// The way of this name.
    pub fn of(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|way| way.name() == name)
    }
}

/// The tick with which the asking side says that it is done.
pub(super) const DONE: u64 = u64::MAX;
/// A flag by which the asking side wants to be told when the command was sent.
pub(super) const STAMPED: u32 = 1;
/// How long a sleeping side sleeps before it looks around.
const LOOK: Duration = Duration::from_millis(100);
/// Turns of a looking side before it looks around: some milliseconds.
const TURNS: u32 = 4096;

/// One end: it sends `S` and receives `R`.
pub(super) enum TransportEnd<S: Payload, R: Payload> {
    /// iceoryx2, asleep between samples or not.
    Bare { ends: Box<BareExchange<S, R>>, asleep: bool },
    /// Descriptors that block.
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

impl<S: Payload, R: Payload> TransportEnd<S, R> {
    #[inline]
    pub fn send(&mut self, sample: &S) -> Result<(), TransportError> {
        match self {
            Self::Bare { ends, asleep } => {
                ends.to.send(sample)?;
                if *asleep {
                    ends.notify();
                }
            }
            Self::Stream { to, .. } => to.write_all(bytemuck::bytes_of(sample))?,
            Self::Page(page) => page.send(bytemuck::cast_slice(bytemuck::bytes_of(sample))),
        }
        Ok(())
    }

    /// Waits for the next sample. `look` is asked now and then, and ends the wait by an error.
    #[inline]
    pub fn receive<E: From<TransportError>>(&mut self, mut look: impl FnMut() -> Result<(), E>) -> Result<R, E> {
        let mut sample = R::zeroed();
        match self {
            Self::Bare { ends, asleep } => {
                let mut turns = 0_u32;
                loop {
                    if let Some(sample) = ends.from.receive().map_err(TransportError::from)? {
                        return Ok(sample);
                    }
                    turns += 1;
                    if *asleep {
                        if turns > 1 {
                            look()?;
                        }
                        ends.wait(LOOK);
                    } else {
                        if turns.is_multiple_of(TURNS) {
                            look()?;
                        }
                        sched_yield();
                    }
                }
            }
            // The end of the other process ends the stream.
            Self::Stream { from, .. } => {
                from.read_exact(bytemuck::bytes_of_mut(&mut sample)).map_err(TransportError::from)?;
            }
            Self::Page(page) => {
                while !page.receive(bytemuck::cast_slice_mut(bytemuck::bytes_of_mut(&mut sample)), LOOK) {
                    look()?;
                }
            }
        }
        Ok(sample)
    }
}
