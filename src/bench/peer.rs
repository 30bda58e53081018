//! The other process of a way: answers every observation with a command, until it is told that it was the last, or its
//! parent ends.

use std::fs::File;
use std::os::fd::AsFd as _;

use super::BenchError;
use super::transport::{DONE, STAMPED, Transport, TransportEnd, TransportError};
use crate::channel::{BareExchange, DomainName, SharedPage};
use crate::clock::{ProcessHandle, monotonic_ns, precise_timers};
use crate::wire::{Command, Observation};

/// What ends the other process.
enum PeerEnd {
    Line(TransportError),
    Orphaned,
}

impl From<TransportError> for PeerEnd {
    fn from(error: TransportError) -> Self {
        Self::Line(error)
    }
}

/// Answers over `way`. Everything but iceoryx2, which needs the number of the domain, comes through standard input and output.
///
/// # Errors
/// [`BenchError::Peer`] when the way cannot be set up or fails, as it does when this was not started by a bench.
pub fn serve(way: Transport, domain: Option<u64>) -> Result<(), BenchError> {
    let failed = |cause: String| BenchError::Peer { way: way.name(), cause };
    let parent = rustix::process::getppid().and_then(|parent| ProcessHandle::of(parent.as_raw_pid() as u32));
    let parent = parent.ok_or_else(|| failed("it has no parent".to_owned()))?;
    let mut line = open(way, domain).map_err(|error| failed(error.to_string()))?;
    precise_timers();
    let mut command = Command::default();
    loop {
        let asked = line.receive(|| if parent.ended() { Err(PeerEnd::Orphaned) } else { Ok(()) });
        let observation: Observation = match asked {
            Ok(observation) => observation,
            Err(PeerEnd::Orphaned) => return Ok(()),
            // The asking side is gone.
            Err(PeerEnd::Line(TransportError::System(error))) if error.kind() == std::io::ErrorKind::UnexpectedEof => {
                return Ok(());
            }
            Err(PeerEnd::Line(error)) => return Err(failed(error.to_string())),
        };
        if observation.header.tick == DONE {
            return Ok(());
        }
        command.header.tick = observation.header.tick;
        if observation.header.flags & STAMPED != 0 {
            command.header.published_ns = monotonic_ns();
        }
        line.send(&command).map_err(|error| failed(error.to_string()))?;
    }
}

fn open(way: Transport, domain: Option<u64>) -> Result<TransportEnd<Command, Observation>, TransportError> {
    let (stdin, stdout) = (std::io::stdin(), std::io::stdout());
    let file = |fd: std::os::fd::BorrowedFd| fd.try_clone_to_owned().map(File::from);
    Ok(match way {
        Transport::Event | Transport::Poll => {
            let ends = Box::new(BareExchange::open(&DomainName::of(domain.unwrap_or_default()))?);
            TransportEnd::Bare { ends, asleep: way == Transport::Event }
        }
        Transport::Socket => TransportEnd::Stream { to: file(stdin.as_fd())?, from: file(stdin.as_fd())? },
        Transport::Pipe => TransportEnd::Stream { to: file(stdout.as_fd())?, from: file(stdin.as_fd())? },
        Transport::Futex => TransportEnd::Page(SharedPage::open(stdin)?),
    })
}
