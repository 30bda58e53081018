//! The ways from one process to another and back that Tectum is measured against: the same 184 bytes there and 120 bytes
//! back, over iceoryx2 by itself and over what the operating system has.
//!
//! The other end is a child process, this program started again, never a thread. It gets what it needs through its standard
//! input and output, has a process group of its own, and ends when its parent does, whatever the parent's death: a stream
//! then ends, and where there is none it looks at the parent's pidfd.

use std::fs::File;
use std::os::fd::OwnedFd;
use std::os::unix::process::CommandExt as _;
use std::process::{Child, Command as Program, Stdio};

use rustix::net::{AddressFamily, SocketFlags, SocketType, socketpair};
use rustix::thread::sched_yield;

use super::transport::{DONE, STAMPED, Transport, TransportEnd, TransportError};
use super::{BenchError, Latencies, TickTimes};
use crate::channel::{BareExchange, DomainName, SharedPage};
use crate::clock::{ProcessHandle, TerminationSignals, monotonic_ns, precise_timers, sleep_until};
use crate::wire::{Command, Observation};

/// How long the other process may take to be there.
const SET_UP_NS: u64 = 20_000_000_000;

/// A set-up with another process that answers.
pub struct PeerExchange {
    way: Transport,
    line: TransportEnd<Observation, Command>,
    peer: PeerProcess,
    observation: Observation,
    signals: TerminationSignals,
}

/// The child; it does not outlive this.
struct PeerProcess {
    way: Transport,
    child: Child,
    life: Option<ProcessHandle>,
    signals: TerminationSignals,
}

impl PeerProcess {
    /// Whether to go on waiting for it.
    fn look(&self) -> Result<(), BenchError> {
        match self.signals.received() {
            0 if self.life.as_ref().is_none_or(ProcessHandle::ended) => Err(failed(self.way, "it has ended")),
            0 => Ok(()),
            number => Err(BenchError::Signal(number)),
        }
    }
}

impl Drop for PeerProcess {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

fn failed(way: Transport, cause: impl ToString) -> BenchError {
    BenchError::Peer { way: way.name(), cause: cause.to_string() }
}

/// What may end a wait.
enum WaitEnd {
    Line(TransportError),
    Bench(BenchError),
}

impl From<TransportError> for WaitEnd {
    fn from(error: TransportError) -> Self {
        Self::Line(error)
    }
}

impl PeerExchange {
    /// Sets `way` up and waits until the other process answers.
    ///
    /// # Errors
    /// [`BenchError::Channel`] and [`BenchError::Peer`] when that fails, [`BenchError::Signal`] when a signal comes.
    pub fn start(way: Transport, signals: &TerminationSignals) -> Result<Self, BenchError> {
        let (line, child) = set_up(way)?;
        let life = ProcessHandle::of(child.id());
        let peer = PeerProcess { way, child, life, signals: signals.clone() };
        let mut exchange = Self { way, line, peer, observation: Observation::default(), signals: signals.clone() };
        exchange.observation.header.flags = STAMPED;
        exchange.connect()?;
        precise_timers();
        // The first ones find everything cold, and pages to be mapped.
        for _ in 0..3 {
            exchange.ask(0, 0)?;
        }
        Ok(exchange)
    }

    fn connect(&self) -> Result<(), BenchError> {
        let began = monotonic_ns();
        while let TransportEnd::Bare { ends, .. } = &self.line
            && !ends.connected()?
        {
            self.peer.look()?;
            if monotonic_ns() - began > SET_UP_NS {
                return Err(failed(self.way, "it does not get ready"));
            }
            sched_yield();
        }
        Ok(())
    }

    /// One exchange for `tick`, which was scheduled for `scheduled`.
    #[inline]
    fn ask(&mut self, tick: u64, scheduled: u64) -> Result<TickTimes, BenchError> {
        let sensed = monotonic_ns();
        self.observation.header.tick = tick;
        let command = self.there_and_back()?;
        let applied = monotonic_ns();
        Ok(TickTimes { tick, scheduled, sensed, answered: Some(command.header.published_ns), applied: Some(applied) })
    }

    #[inline]
    fn there_and_back(&mut self) -> Result<Command, BenchError> {
        let Self { way, line, peer, observation, signals } = self;
        let answer = line.send(observation).map_err(WaitEnd::from);
        let answer = answer.and_then(|()| line.receive(|| peer.look().map_err(WaitEnd::Bench)));
        answer.map_err(|ended| match ended {
            // The other process's end shows as an error of the line, and a signal may be why.
            WaitEnd::Line(_) if signals.received() != 0 => BenchError::Signal(signals.received()),
            WaitEnd::Line(error) => failed(*way, error),
            WaitEnd::Bench(error) => error,
        })
    }

    /// `ticks` exchanges at whole multiples of `period` ns on the clock. One that is not back when others are due passes those
    /// over, as a run does.
    ///
    /// # Errors
    /// [`BenchError::Peer`] when the other process fails, [`BenchError::Signal`] when a signal comes.
    pub fn cadence(&mut self, ticks: u64, period: u64) -> Result<Vec<TickTimes>, BenchError> {
        let mut tick_times = Vec::with_capacity(ticks as usize);
        let start = (monotonic_ns() + period / 2).next_multiple_of(period);
        let mut tick = 0;
        while tick < ticks {
            let scheduled = start + tick * period;
            while monotonic_ns() < scheduled {
                sleep_until(scheduled);
                if self.signals.received() != 0 {
                    return Err(BenchError::Signal(self.signals.received()));
                }
            }
            // Those that are over already are passed over, but for the last.
            tick = tick.max((monotonic_ns() - start) / period).min(ticks - 1);
            tick_times.push(self.ask(tick, start + tick * period)?);
            tick += 1;
        }
        Ok(tick_times)
    }

    /// Exchanges back to back for `ns` nanoseconds: each is due when the one before is over. Returns the nanoseconds that they
    /// took.
    ///
    /// # Errors
    /// As for [`cadence`](Self::cadence).
    pub fn saturated(&mut self, ns: u64, into: &mut Latencies) -> Result<u64, BenchError> {
        let began = monotonic_ns();
        let (mut tick, mut due) = (0, began);
        while due < began + ns {
            let lap = self.ask(tick, due)?;
            into.record(&[lap], 0, 0);
            due = lap.applied.unwrap_or(due);
            tick += 1;
            if tick.is_multiple_of(256) {
                self.peer.look()?;
            }
        }
        Ok(due - began)
    }

    /// `rounds` exchanges back to back, and nothing else: neither side looks at a clock. Returns the nanoseconds that they
    /// took.
    ///
    /// # Errors
    /// As for [`cadence`](Self::cadence).
    pub fn rounds(&mut self, rounds: u64) -> Result<u64, BenchError> {
        self.observation.header.flags = 0;
        let began = monotonic_ns();
        for round in 0..rounds {
            self.observation.header.tick = round;
            self.there_and_back()?;
            if round.is_multiple_of(4096) {
                self.peer.look()?;
            }
        }
        self.observation.header.flags = STAMPED;
        Ok(monotonic_ns() - began)
    }

    /// The other process's id.
    pub fn peer(&self) -> u32 {
        self.peer.child.id()
    }
}

impl Drop for PeerExchange {
    fn drop(&mut self) {
        // In good order, so that it takes away what it holds in shared memory. Killed after that in any case.
        self.observation.header.tick = DONE;
        if self.line.send(&self.observation).is_ok()
            && let Some(life) = &self.peer.life
        {
            ProcessHandle::await_any(std::iter::once(life), 200_000_000);
        }
    }
}

/// Our end of a way, and the process at the other.
fn set_up(way: Transport) -> Result<(TransportEnd<Observation, Command>, Child), BenchError> {
    let io = |cause: std::io::Error| failed(way, cause);
    let mut program = Program::new(std::env::current_exe().map_err(io)?);
    program.args(["bench", "peer", "--over", way.name()]).process_group(0).stdin(Stdio::null()).stdout(Stdio::null());
    match way {
        Transport::Event | Transport::Poll => {
            // The low half alone makes the domain's name, and runs hash theirs.
            let id = u64::from(std::process::id()) << 32 | monotonic_ns() & 0xffff_ffff;
            let ends = Box::new(BareExchange::create(&DomainName::of(id))?);
            let child = program.args(["--domain", &id.to_string()]).spawn().map_err(io)?;
            Ok((TransportEnd::Bare { ends, asleep: way == Transport::Event }, child))
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
                _ => Err(failed(way, "it has no pipes")),
            }
        }
        Transport::Futex => {
            let (page, file) = SharedPage::create().map_err(io)?;
            let child = program.stdin(Stdio::from(file)).spawn().map_err(io)?;
            Ok((TransportEnd::Page(page), child))
        }
    }
}
