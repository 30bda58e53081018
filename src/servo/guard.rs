//! The guard: a process that turns torque off when the process that drives servos has died or fallen silent.
//!
//! A program cannot react to SIGKILL, and does nothing while it is stopped: by Ctrl-Z, by a debugger, by a bus
//! that blocks. A Feetech servo then keeps its last speed, because it has no watchdog; a Dynamixel's watchdog
//! stops it with torque still on. The driving process therefore starts a guard, and sends it a *heartbeat* in
//! every tick, one byte through a pipe: whether torque is on. The guard acts
//!
//! - when the pipe ends without a farewell: the driving process is dead;
//! - when torque is on and [`SILENT_PERIODS`] periods pass without a heartbeat, on the guard's own clock. It
//!   then kills the driving process, which would otherwise keep the port and might wake up later.
//!
//! Either way it opens the port and turns torque off. A cable that is out is awaited. If a restarted bridge has
//! the port, the guard leaves it alone: a bridge turns torque off before anything else.
//!
//! The guard has a session of its own, and takes no signal but SIGKILL, so that neither a terminal that closes
//! nor a key pressed there ends both processes. A driving process whose guard has died turns torque off itself.

use std::io::{self, Read as _, Write as _};
use std::process::{Child, ChildStdin, Command, ExitCode, Stdio};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::fs::{OFlags, fcntl_setfl};
use rustix::process::setsid;
use signal_hook::consts::{SIGHUP, SIGINT, SIGPIPE, SIGQUIT, SIGTERM, SIGTSTP, SIGTTIN, SIGTTOU, SIGUSR1, SIGUSR2};

use super::bus::{Bus, BusBudget, BusError, stable_name};
use super::model::Protocol;
use crate::clock::{ProcessHandle, monotonic_ns, pause, precise_timers};

/// Number of periods without a heartbeat after which a driving process with torque counts as silent.
pub const SILENT_PERIODS: u64 = 4;

/// Heartbeats: torque is on, torque is off, the end in good order.
const ON: u8 = b'1';
const OFF: u8 = b'0';
const FAREWELL: u8 = b'q';

/// Time for which the guard waits for a cable that is out, ns.
const CABLE_WAIT: u64 = 600_000_000_000;
/// Time for which it waits for a port that another program has, ns.
const BUSY_WAIT: u64 = 2_000_000_000;
/// Interval between two attempts to open the port, ns.
const RETRY: u64 = 5_000_000;

/// What a guard needs to know.
#[derive(Debug, Clone)]
pub struct GuardSettings {
    /// The serial port.
    pub port: String,
    /// The servos' protocol.
    pub protocol: Protocol,
    /// Baud rate, bit/s.
    pub baud: u32,
    /// The servos.
    pub ids: Vec<u8>,
    /// The period of heartbeats, ns.
    pub period_ns: u64,
}

/// The driving process's end: the running guard. It ends, without touching the port, when this is dropped.
#[derive(Debug)]
pub struct Guard {
    child: Child,
    pipe: ChildStdin,
}

impl Guard {
    /// Starts `command`, which must call [`watch`], as the guard of this process. Returns when it has its own
    /// session and takes no more signals.
    ///
    /// # Errors
    /// When it cannot be started, or ends at once.
    pub fn start(command: &mut Command) -> Result<Self, String> {
        command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::inherit());
        let failed = |error: io::Error| format!("the guard cannot be started: {error}; torque stays off without one");
        let mut child = command.spawn().map_err(failed)?;
        let (pipe, answer) = (child.stdin.take(), child.stdout.take());
        let (Some(pipe), Some(mut answer)) = (pipe, answer) else { return Err(failed(io::Error::other("no pipe"))) };
        // A guard that does not read must not block a tick.
        let unblocked = fcntl_setfl(&pipe, OFlags::WRONLY | OFlags::NONBLOCK).map_err(io::Error::from);
        let ready = unblocked.and_then(|()| answer.read_exact(&mut [0]));
        let guard = Self { child, pipe };
        ready.map_err(failed)?;
        Ok(guard)
    }

    /// A heartbeat: whether torque is on, or about to come on. Returns false when the guard has died.
    pub fn beat(&mut self, torque: bool) -> bool {
        let sent = self.pipe.write(&[if torque { ON } else { OFF }]);
        // A full pipe: the guard does not get to run, and has died if it never does.
        sent.is_ok() || matches!(self.child.try_wait(), Ok(None))
    }
}

impl Drop for Guard {
    fn drop(&mut self) {
        let _ = self.pipe.write(&[FAREWELL]);
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Why the guard acts.
enum Alarm {
    Ended,
    Silent(u64),
}

/// The guard's whole life, with heartbeats on standard input: watches process `parent`, and turns torque off when
/// it has died or fallen silent.
pub fn watch(parent: u32, settings: &GuardSettings) -> ExitCode {
    // A session, and so a process group, of its own: the launcher kills a bridge with its whole group, and a terminal
    // that closes ends the programs of its session. The driving process waits until this is done.
    let _ = setsid();
    let ignored = Arc::new(AtomicBool::new(false));
    for signal in [SIGHUP, SIGINT, SIGQUIT, SIGTERM, SIGTSTP, SIGTTIN, SIGTTOU, SIGUSR1, SIGUSR2, SIGPIPE] {
        let _ = signal_hook::flag::register(signal, Arc::clone(&ignored));
    }
    precise_timers();
    let process = ProcessHandle::of(parent);
    let port = stable_name(&settings.port);
    let mut out = io::stdout();
    if out.write_all(b"\n").and_then(|()| out.flush()).is_err() {
        return ExitCode::FAILURE;
    }
    let Some(alarm) = await_alarm(settings.period_ns * SILENT_PERIODS) else { return ExitCode::SUCCESS };
    if let Some(process) = &process {
        if let Alarm::Silent(_) = &alarm {
            process.kill();
        }
        // A process that dies closes this pipe, and the port some time after it.
        ProcessHandle::await_any(std::iter::once(process), 200_000_000);
    }
    let first = Opened::once(&port, settings);
    tell(&alarm, &first);
    // The launcher reads on until nobody has this descriptor.
    if let Ok(null) = std::fs::File::options().write(true).open("/dev/null") {
        let _ = rustix::stdio::dup2_stderr(&null);
    }
    match first {
        Opened::Off(_) => ExitCode::SUCCESS,
        Opened::Failed(_) => insist(&port, settings),
    }
}

/// Waits for the driving process to die or fall silent for `limit` ns with torque on; `None` if it ends in good order.
fn await_alarm(limit: u64) -> Option<Alarm> {
    let stdin = io::stdin();
    let (mut torque, mut last, mut bytes) = (false, monotonic_ns(), [0; 256]);
    loop {
        let silence = monotonic_ns().saturating_sub(last);
        let wait = if torque { limit.saturating_sub(silence) } else { 60_000_000_000 };
        let limit_time = Timespec { tv_sec: (wait / 1_000_000_000) as i64, tv_nsec: (wait % 1_000_000_000) as i64 };
        let mut fds = [PollFd::new(&stdin, PollFlags::IN)];
        let ready = matches!(poll(&mut fds, Some(&limit_time)), Ok(1..));
        let silence = monotonic_ns().saturating_sub(last);
        if !ready {
            if torque && silence >= limit {
                return Some(Alarm::Silent(silence));
            }
            continue;
        }
        match rustix::io::read(&stdin, &mut bytes) {
            Ok(0) => return Some(Alarm::Ended),
            Ok(n) if bytes[..n].contains(&FAREWELL) => return None,
            Ok(n) => (torque, last) = (bytes[n - 1] == ON, monotonic_ns()),
            Err(rustix::io::Errno::INTR | rustix::io::Errno::AGAIN) => {}
            Err(_) => return Some(Alarm::Ended),
        }
    }
}

/// An attempt to turn torque off.
enum Opened {
    /// It was sent; these servos do not confirm that their torque is off.
    Off(Vec<u8>),
    Failed(BusError),
}

impl Opened {
    fn once(port: &str, settings: &GuardSettings) -> Self {
        let budget = BusBudget { read_ns: 50_000_000, write_ns: 20_000_000 };
        match Bus::open(port, settings.protocol, settings.baud, budget, Box::new(monotonic_ns)) {
            Ok(mut bus) => {
                bus.torque_off(&settings.ids);
                let torque = bus.series().torque_enable;
                let mut unconfirmed = settings.ids.clone();
                for _ in 0..5 {
                    unconfirmed.retain(|&id| !matches!(bus.read(id, torque), Ok(0)));
                }
                Self::Off(unconfirmed)
            }
            Err(error) => Self::Failed(error),
        }
    }
}

/// Tries to turn torque off until it succeeds, another program keeps the port, or the cable stays out.
fn insist(port: &str, settings: &GuardSettings) -> ExitCode {
    let began = monotonic_ns();
    loop {
        let limit = match Opened::once(port, settings) {
            Opened::Off(_) => return ExitCode::SUCCESS,
            Opened::Failed(BusError::Busy(_)) => BUSY_WAIT,
            Opened::Failed(_) => CABLE_WAIT,
        };
        if monotonic_ns() - began > limit {
            return ExitCode::FAILURE;
        }
        pause(RETRY);
    }
}

/// Says on standard error what happened. Nobody may be there to read it.
fn tell(alarm: &Alarm, result: &Opened) {
    let what = match alarm {
        Alarm::Silent(ns) => format!("nothing came for {} ms with torque on; the process was killed", ns / 1_000_000),
        Alarm::Ended => "the process ended without turning torque off".to_owned(),
    };
    let then = match result {
        Opened::Off(silent) if silent.is_empty() => "torque is off".to_owned(),
        Opened::Off(silent) => {
            let ids: Vec<_> = silent.iter().map(u8::to_string).collect();
            format!("torque was told to go off; not confirmed by servo {}", ids.join(", "))
        }
        Opened::Failed(error) => format!("torque may still be on: {error}"),
    };
    let _ = writeln!(io::stderr(), "tectum-bridge: guard: {what}; {then}");
}
