//! Exchanges with a peer process over a bare transport: the same 184 bytes there and 120 bytes back as in a
//! run, over iceoryx2 alone and over the transports of the operating system.
//!
//! The peer is a child process, this program started again, never a thread. It gets its descriptors through its
//! standard input and output, and has a process group of its own. It ends when its parent does, however the
//! parent ends: a stream then ends, and where there is none the peer checks the parent's pidfd.

use std::fs::File;
use std::os::fd::OwnedFd;
use std::os::unix::process::CommandExt as _;
use std::process::{Child, Command as Program, Stdio};

use rustix::net::{AddressFamily, SocketFlags, SocketType, socketpair};
use rustix::thread::sched_yield;

use super::transport::{DONE, STAMPED, Transport, TransportEnd, TransportError};
use super::{Latencies, TickTimes, TimingError, check_signals};
use crate::channel::{BareExchange, DomainName, SharedPage};
use crate::clock::{ProcessHandle, TerminationSignals, monotonic_ns, precise_timers, sleep_until};
use crate::wire::{Command, Observation};

/// How long the peer may take to connect, ns.
const SET_UP_NS: u64 = 20_000_000_000;

/// The asking side of a transport, and its peer.
pub struct PeerExchange {
    transport: Transport,
    end: TransportEnd<Observation, Command>,
    peer: PeerProcess,
    observation: Observation,
    signals: TerminationSignals,
}

/// The peer; it is killed when this is dropped.
struct PeerProcess {
    transport: Transport,
    child: Child,
    process: Option<ProcessHandle>,
    signals: TerminationSignals,
}

impl PeerProcess {
    /// An error if the peer has ended or a signal has come, so that there is nothing to wait for.
    fn check(&self) -> Result<(), TimingError> {
        check_signals(&self.signals)?;
        if self.process.as_ref().is_none_or(ProcessHandle::ended) {
            return Err(failed(self.transport, "it has ended"));
        }
        Ok(())
    }
}

impl Drop for PeerProcess {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

fn failed(transport: Transport, cause: impl ToString) -> TimingError {
    TimingError::Peer { transport: transport.name(), cause: cause.to_string() }
}

/// Why the asking side stops waiting for a command.
enum WaitEnd {
    Transport(TransportError),
    Bench(TimingError),
}

impl From<TransportError> for WaitEnd {
    fn from(error: TransportError) -> Self {
        Self::Transport(error)
    }
}

impl PeerExchange {
    /// Sets `transport` up and waits until the peer answers.
    ///
    /// # Errors
    /// [`TimingError::Channel`] and [`TimingError::Peer`] when that fails, [`TimingError::Signal`] when a signal
    /// comes.
    pub fn start(transport: Transport, signals: &TerminationSignals) -> Result<Self, TimingError> {
        let (end, child) = set_up(transport)?;
        let process = ProcessHandle::of(child.id());
        let peer = PeerProcess { transport, child, process, signals: signals.clone() };
        let mut exchange = Self { transport, end, peer, observation: Observation::default(), signals: signals.clone() };
        exchange.observation.header.flags = STAMPED;
        exchange.connect()?;
        precise_timers();
        // The first exchanges find caches cold and pages not yet mapped.
        for _ in 0..3 {
            exchange.ask(0, 0)?;
        }
        Ok(exchange)
    }

    fn connect(&self) -> Result<(), TimingError> {
        let began = monotonic_ns();
        while let TransportEnd::Bare { ends, .. } = &self.end
            && !ends.connected()?
        {
            self.peer.check()?;
            if monotonic_ns() - began > SET_UP_NS {
                return Err(failed(self.transport, "it does not get ready"));
            }
            sched_yield();
        }
        Ok(())
    }

    /// One exchange for `tick`, which is scheduled for `scheduled_ns`.
    #[inline]
    fn ask(&mut self, tick: u64, scheduled_ns: u64) -> Result<TickTimes, TimingError> {
        let sensed_ns = monotonic_ns();
        self.observation.header.tick = tick;
        let command = self.round_trip()?;
        let applied_ns = Some(monotonic_ns());
        Ok(TickTimes { tick, scheduled_ns, sensed_ns, sent_ns: Some(command.header.published_ns), applied_ns })
    }

    #[inline]
    fn round_trip(&mut self) -> Result<Command, TimingError> {
        let Self { transport, end, peer, observation, signals } = self;
        let command = end.send(observation).map_err(WaitEnd::from);
        let command = command.and_then(|()| end.receive(|| peer.check().map_err(WaitEnd::Bench)));
        command.map_err(|wait_end| match wait_end {
            // When the peer ends, the transport fails. A signal may be the reason.
            WaitEnd::Transport(_) if signals.received() != 0 => TimingError::Signal(signals.received()),
            WaitEnd::Transport(error) => failed(*transport, error),
            WaitEnd::Bench(error) => error,
        })
    }

    /// `ticks` exchanges at whole multiples of `period_ns` on the clock. If an exchange is not over when the
    /// next ones are due, those are skipped, as in a run.
    ///
    /// # Errors
    /// [`TimingError::Peer`] when the peer fails, [`TimingError::Signal`] when a signal comes.
    pub fn cadence(&mut self, ticks: u64, period_ns: u64) -> Result<Vec<TickTimes>, TimingError> {
        let mut tick_times = Vec::with_capacity(ticks as usize);
        let start = (monotonic_ns() + period_ns / 2).next_multiple_of(period_ns);
        let mut tick = 0;
        while tick < ticks {
            let scheduled = start + tick * period_ns;
            while monotonic_ns() < scheduled {
                sleep_until(scheduled);
                check_signals(&self.signals)?;
            }
            // Skips the ticks that are over already, but never the last one.
            tick = tick.max((monotonic_ns() - start) / period_ns).min(ticks - 1);
            tick_times.push(self.ask(tick, start + tick * period_ns)?);
            tick += 1;
        }
        Ok(tick_times)
    }

    /// Exchanges back to back for `ns` nanoseconds. Each is due when the one before is over. Returns the
    /// nanoseconds that they took.
    ///
    /// # Errors
    /// As for [`cadence`](Self::cadence).
    pub fn saturated(&mut self, ns: u64, into: &mut Latencies) -> Result<u64, TimingError> {
        let began = monotonic_ns();
        let (mut tick, mut due) = (0, began);
        while due < began + ns {
            let times = self.ask(tick, due)?;
            into.record(&[times], 0, 0);
            due = times.applied_ns.unwrap_or(due);
            tick += 1;
            if tick.is_multiple_of(256) {
                self.peer.check()?;
            }
        }
        Ok(due - began)
    }

    /// `rounds` exchanges back to back in which neither side reads a clock. Returns the nanoseconds that they took.
    ///
    /// # Errors
    /// As for [`cadence`](Self::cadence).
    pub fn rounds(&mut self, rounds: u64) -> Result<u64, TimingError> {
        self.observation.header.flags = 0;
        let began = monotonic_ns();
        for round in 0..rounds {
            self.observation.header.tick = round;
            self.round_trip()?;
            if round.is_multiple_of(4096) {
                self.peer.check()?;
            }
        }
        self.observation.header.flags = STAMPED;
        Ok(monotonic_ns() - began)
    }

    /// The peer's process id.
    pub fn peer(&self) -> u32 {
        self.peer.child.id()
    }
}

impl Drop for PeerExchange {
    fn drop(&mut self) {
        // Asks the peer to end, so that it removes its shared memory. In any case it is killed after this.
        self.observation.header.tick = DONE;
        if self.end.send(&self.observation).is_ok()
            && let Some(process) = &self.peer.process
        {
            ProcessHandle::await_any(std::iter::once(process), 200_000_000);
        }
    }
}

/// This side's end of a transport, and the peer at the other end.
fn set_up(transport: Transport) -> Result<(TransportEnd<Observation, Command>, Child), TimingError> {
    let io = |cause: std::io::Error| failed(transport, cause);
    let mut program = Program::new(std::env::current_exe().map_err(io)?);
    program.args(["bench", "peer", "--over", transport.name(), "--parent", &std::process::id().to_string()]);
    program.process_group(0).stdin(Stdio::null()).stdout(Stdio::null());
    match transport {
        Transport::Event | Transport::Poll => {
            // Only the low half goes into the domain's name. A run's id is a hash, so the two do not collide.
            let id = u64::from(std::process::id()) << 32 | monotonic_ns() & 0xffff_ffff;
            let ends = Box::new(BareExchange::create(&DomainName::of(id))?);
            let child = program.args(["--domain", &id.to_string()]).spawn().map_err(io)?;
            Ok((TransportEnd::Bare { ends, asleep: transport == Transport::Event }, child))
        }
        Transport::Socket => {
            let pair = socketpair(AddressFamily::UNIX, SocketType::SEQPACKET, SocketFlags::CLOEXEC, None);
            let (ours, theirs) = pair.map_err(|e| io(e.into()))?;
            let child = program.stdin(Stdio::from(theirs)).spawn().map_err(io)?;
            let to = File::from(ours);
            Ok((TransportEnd::Stream { from: to.try_clone().map_err(io)?, to }, child))
        }
        Transport::Pipe => {
            let mut child = program.stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().map_err(io)?;
            let to = child.stdin.take().map(|fd| File::from(OwnedFd::from(fd)));
            let from = child.stdout.take().map(|fd| File::from(OwnedFd::from(fd)));
            match (to, from) {
                (Some(to), Some(from)) => Ok((TransportEnd::Stream { to, from }, child)),
                _ => Err(failed(transport, "it has no pipes")),
            }
        }
        Transport::Futex => {
            let (page, file) = SharedPage::create().map_err(io)?;
            let child = program.stdin(Stdio::from(file)).spawn().map_err(io)?;
            Ok((TransportEnd::Page(page), child))
        }
    }
}
