//! The peer process of a bare transport: answers every observation with a command, until the asking side ends
//! the exchange or the parent process ends.

use std::fs::File;
use std::os::fd::AsFd as _;

use super::TimingError;
use super::transport::{DONE, STAMPED, Transport, TransportEnd, TransportError};
use crate::channel::{BareExchange, DomainName, SharedPage};
use crate::clock::{ProcessHandle, monotonic_ns, precise_timers};
use crate::wire::{Command, Observation};

/// Why the peer stops waiting for an observation.
enum PeerEnd {
    Transport(TransportError),
    ParentEnded,
}

impl From<TransportError> for PeerEnd {
    fn from(error: TransportError) -> Self {
        Self::Transport(error)
    }
}

/// Runs the peer over `transport` for the bench `parent`, a process id. The descriptors come through standard input and
/// output; iceoryx2 needs the number of its domain instead.
///
/// # Errors
/// [`TimingError::Peer`] when the transport cannot be set up or fails, as it does when no bench has started this
/// process.
pub fn serve(transport: Transport, domain: Option<u64>, parent: Option<u32>) -> Result<(), TimingError> {
    let failed = |cause: String| TimingError::Peer { transport: transport.name(), cause };
    let bench = parent.ok_or_else(|| failed("it is started by a bench only".to_owned()))?;
    // A bench that was killed meanwhile is the parent no more, and its number may be that of another process.
    let parent = ProcessHandle::of(bench);
    let is_ours = rustix::process::getppid().is_some_and(|pid| u32::try_from(pid.as_raw_pid()) == Ok(bench));
    let Some(parent) = parent.filter(|_| is_ours) else { return Ok(()) };
    let mut end = open(transport, domain).map_err(|error| failed(error.to_string()))?;
    precise_timers();
    let mut command = Command::default();
    loop {
        let received = end.receive(|| if parent.ended() { Err(PeerEnd::ParentEnded) } else { Ok(()) });
        let observation: Observation = match received {
            Ok(observation) => observation,
            Err(PeerEnd::ParentEnded) => return Ok(()),
            // The asking side has closed the stream.
            Err(PeerEnd::Transport(TransportError::System(error)))
                if error.kind() == std::io::ErrorKind::UnexpectedEof =>
            {
                return Ok(());
            }
            Err(PeerEnd::Transport(error)) => return Err(failed(error.to_string())),
        };
        if observation.header.tick == DONE {
            return Ok(());
        }
        command.header.tick = observation.header.tick;
        if observation.header.flags & STAMPED != 0 {
            command.header.published_ns = monotonic_ns();
        }
        end.send(&command).map_err(|error| failed(error.to_string()))?;
    }
}

fn open(transport: Transport, domain: Option<u64>) -> Result<TransportEnd<Command, Observation>, TransportError> {
    let (stdin, stdout) = (std::io::stdin(), std::io::stdout());
    let file = |fd: std::os::fd::BorrowedFd| fd.try_clone_to_owned().map(File::from);
    Ok(match transport {
        Transport::Event | Transport::Poll => {
            let ends = Box::new(BareExchange::open(&DomainName::of(domain.unwrap_or_default()))?);
            TransportEnd::Bare { ends, asleep: transport == Transport::Event }
        }
        Transport::Socket => TransportEnd::Stream { to: file(stdin.as_fd())?, from: file(stdin.as_fd())? },
        Transport::Pipe => TransportEnd::Stream { to: file(stdout.as_fd())?, from: file(stdin.as_fd())? },
        Transport::Futex => TransportEnd::Page(SharedPage::open(stdin)?),
    })
}
