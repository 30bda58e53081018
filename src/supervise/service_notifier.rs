//! Tells a service manager how the run is (systemd's `sd_notify`): ready, alive, stopping, and one line of status.
//!
//! Messages go to the datagram socket that `NOTIFY_SOCKET` names. `WATCHDOG=1` is sent every half of `WATCHDOG_USEC`,
//! but only if the plant has done a tick since the last one: a launcher that lives while its run stands still is no
//! service. Nothing here ever waits; a message that finds the socket full is lost.

use std::os::linux::net::SocketAddrExt as _;
use std::os::unix::net::{SocketAddr, UnixDatagram};

use crate::channel::BoardsCopy;
use crate::text::thousands;
use crate::wire::{Phase, ProcessState, Role};

/// The environment variables of the protocol. The processes of the run do not get them.
pub(super) const VARIABLES: [&str; 3] = ["NOTIFY_SOCKET", "WATCHDOG_USEC", "WATCHDOG_PID"];
/// Shortest time between two lines of status, ns.
const STATUS_NS: u64 = 1_000_000_000;

/// The way to the service manager; without one, nothing is sent.
#[derive(Debug, Default)]
pub(super) struct ServiceNotifier {
    to: Option<(UnixDatagram, SocketAddr)>,
    /// Time between two signs of life, ns; 0: none are wanted.
    beat_every_ns: u64,
    ready: bool,
    stopping: bool,
    /// When the last sign of life was sent, ns, and the plant's ticks by then.
    beaten: (u64, u64),
    /// The last status, and when it was sent, ns.
    status: (u64, String),
}

impl ServiceNotifier {
    /// The manager that this process's environment names.
    ///
    /// # Errors
    /// One sentence if its address cannot be used.
    pub fn from_environment() -> Result<Self, String> {
        let [socket, watchdog, pid] = VARIABLES.map(|name| std::env::var(name).ok());
        let Some(name) = socket.filter(|name| !name.is_empty()) else { return Ok(Self::default()) };
        let watchdog = watchdog.filter(|_| pid.is_none_or(|pid| pid == std::process::id().to_string()));
        let beat_every_ns = watchdog.and_then(|us| us.parse::<u64>().ok()).map_or(0, |us| us.saturating_mul(500));
        Self::to(&name, beat_every_ns)
            .map_err(|cause| format!("NOTIFY_SOCKET is {name}, which cannot be used: {cause}"))
    }

    fn to(name: &str, beat_every_ns: u64) -> Result<Self, String> {
        let address = match name.strip_prefix('@') {
            Some(abstract_name) => SocketAddr::from_abstract_name(abstract_name),
            None if name.starts_with('/') => SocketAddr::from_pathname(name),
            None => return Err("it is neither a path that begins with / nor a name that begins with @".to_owned()),
        };
        let socket = UnixDatagram::unbound().and_then(|socket| socket.set_nonblocking(true).map(|()| socket));
        let to = address.and_then(|address| socket.map(|socket| (socket, address))).map_err(|e| e.to_string())?;
        Ok(Self { to: Some(to), beat_every_ns, ..Self::default() })
    }

    /// Whether a service manager waits for what this sends.
    pub fn has_manager(&self) -> bool {
        self.to.is_some()
    }

    fn send(&self, message: &str) {
        if let Some((socket, address)) = &self.to {
            let _ = socket.send_to_addr(message.as_bytes(), address);
        }
    }

    /// Asks for more time to get ready: `set_up_s` for the processes' ports, and again for their connections.
    pub fn extend_set_up(&self, set_up_s: f64) {
        self.send(&format!("STATUS=setting up\nEXTEND_TIMEOUT_USEC={}", (2e6 * set_up_s) as u64));
    }

    /// Looks at the boards at `now`, ns, and sends what is due.
    pub fn look(&mut self, boards: &BoardsCopy, now: u64) {
        if self.to.is_none() || self.stopping {
            return;
        }
        let plant = &boards.status[Role::Plant as usize];
        let closes = matches!(plant.state(), ProcessState::Closing | ProcessState::Finished);
        if boards.control.phase() >= Phase::Stop || closes {
            self.stopping = true;
            return self.send(&format!("STOPPING=1\nSTATUS=closing at tick {}", thousands(plant.ticks)));
        }
        if boards.control.phase() != Phase::Run {
            return;
        }
        if !self.ready {
            self.ready = true;
            self.beaten = (now, plant.ticks);
            self.send("READY=1");
        }
        let due = self.beat_every_ns > 0 && now.saturating_sub(self.beaten.0) >= self.beat_every_ns;
        if due && plant.ticks != self.beaten.1 {
            self.beaten = (now, plant.ticks);
            self.send("WATCHDOG=1");
        }
        if now.saturating_sub(self.status.0) >= STATUS_NS {
            let status = status(boards);
            if status != self.status.1 {
                self.send(&format!("STATUS={status}"));
            }
            self.status = (now, status);
        }
    }
}

/// One line about the run.
fn status(boards: &BoardsCopy) -> String {
    let plant = &boards.status[Role::Plant as usize];
    let lost = boards.status[Role::Logger as usize].lost;
    let restarts: u32 = boards.control.incarnations.iter().sum();
    format!(
        "tick {}, missed {}, lost {}, restarts {restarts}",
        thousands(plant.ticks),
        thousands(plant.missed),
        thousands(lost)
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::wire::{Control, Status};

    const SECOND: u64 = 1_000_000_000;

    fn boards(phase: Phase, state: ProcessState, ticks: u64) -> BoardsCopy {
        let control = Control { phase: phase as u32, ..Control::default() };
        BoardsCopy { control, status: [Status { state: state as u32, ticks, ..Status::default() }; 3] }
    }

    /// Under an abstract name; a path is used in tests/service.rs.
    #[test]
    fn a_beat_needs_a_tick_and_the_end_is_said_once() {
        let name = format!("tectum-notify-{}", std::process::id());
        let manager = UnixDatagram::bind_addr(&SocketAddr::from_abstract_name(&name).unwrap()).unwrap();
        manager.set_nonblocking(true).unwrap();
        let mut notifier = ServiceNotifier::to(&format!("@{name}"), SECOND).unwrap();
        let mut bytes = [0; 200];
        let mut sent = || {
            let next = || manager.recv(&mut bytes).ok().map(|n| String::from_utf8_lossy(&bytes[..n]).into_owned());
            std::iter::from_fn(next).filter(|text| !text.starts_with("STATUS")).collect::<Vec<_>>()
        };
        let running = |ticks| boards(Phase::Run, ProcessState::Running, ticks);
        notifier.look(&boards(Phase::Connect, ProcessState::Connected, 0), SECOND);
        assert!(sent().is_empty());
        notifier.look(&running(0), 2 * SECOND);
        assert_eq!(sent(), ["READY=1"]);
        notifier.look(&running(5), 2 * SECOND + SECOND / 2);
        assert!(sent().is_empty(), "it is not due");
        notifier.look(&running(5), 3 * SECOND);
        assert_eq!(sent(), ["WATCHDOG=1"]);
        (4..9).for_each(|second| notifier.look(&running(5), second * SECOND));
        assert!(sent().is_empty(), "no tick was done");
        notifier.look(&running(6), 9 * SECOND);
        assert_eq!(sent(), ["WATCHDOG=1"]);
        (0..2).for_each(|_| notifier.look(&boards(Phase::Run, ProcessState::Closing, 7), 10 * SECOND));
        assert_eq!(sent(), ["STOPPING=1\nSTATUS=closing at tick 7"]);
    }

    #[test]
    fn an_address_that_is_none_is_refused() {
        for name in ["vsock:2:1", "notify", &format!("/{}", "x".repeat(200))] {
            assert!(ServiceNotifier::to(name, 0).is_err(), "{name}");
        }
    }
}
