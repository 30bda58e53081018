//! The emulated chain behind a pseudo-terminal, in real time: for other programs it is a serial port with servos.
//!
//! The loop sleeps in `poll` until bytes arrive or an answer is due, and checks for signals ten times a second.
//! The terminal is in raw mode, and one descriptor of its other end stays open, so that hosts can connect and
//! disconnect. A real port clears its exclusive mode (TIOCEXCL) when the last descriptor is closed, which never
//! happens here. The emulator therefore clears it, and only locks (`flock`) keep other programs out.

use std::fs;
use std::io::{self, Write as _};
use std::os::unix::fs::symlink;
use std::path::{Path, PathBuf};

use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::fd::{AsFd as _, OwnedFd};
use rustix::fs::{Mode, OFlags, fcntl_setfl};
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use rustix::termios::{OptionalActions, ioctl_tiocnxcl, tcgetattr, tcsetattr};

use super::emulator::{EmulatedChain, ServoFault, ServoState};
use crate::clock::{ProcessHandle, TerminationSignals, monotonic_ns, precise_timers};

/// Longest sleep, ns, and so the interval between checks for signals.
const MAX_SLEEP: u64 = 100_000_000;

/// A pseudo-terminal, with an optional symbolic link to it.
#[derive(Debug)]
pub struct PseudoTerminal {
    /// `None` while the cable is out.
    ends: Option<TerminalEnds>,
    link: Option<PathBuf>,
}

/// Both ends of an open terminal.
#[derive(Debug)]
struct TerminalEnds {
    /// The emulator's end.
    ours: OwnedFd,
    /// The hosts' end.
    theirs: OwnedFd,
    path: PathBuf,
}

/// Options of the emulator's loop.
#[derive(Debug, Default)]
pub struct EmulatorTasks {
    /// Reads commands from standard input: `hand ID STEPS`, `state`, `unplug`, `plug`, `fault FAULT`.
    pub control: bool,
    /// Prints a line when a servo's torque goes on or off.
    pub trace: bool,
    /// Prints JSON, one object per line.
    pub json: bool,
    /// Ends when this process has ended.
    pub parent: Option<ProcessHandle>,
}

impl PseudoTerminal {
    /// Opens a new terminal. `link` is a symbolic link to it, which replaces an older link.
    ///
    /// # Errors
    /// When no terminal is available, or the link cannot be created; a file that is not a link is not replaced.
    pub fn open(link: Option<&Path>) -> io::Result<Self> {
        let mut terminal = Self { ends: None, link: link.map(Path::to_path_buf) };
        terminal.plug()?;
        Ok(terminal)
    }

    /// Opens a terminal in the place of the one that was unplugged.
    fn plug(&mut self) -> io::Result<()> {
        if self.ends.is_some() {
            return Ok(());
        }
        let ours = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC)?;
        grantpt(&ours)?;
        unlockpt(&ours)?;
        let name = ptsname(&ours, Vec::new())?;
        let path = PathBuf::from(name.to_string_lossy().into_owned());
        let flags = OFlags::RDWR | OFlags::NOCTTY | OFlags::CLOEXEC;
        let theirs = rustix::fs::open(&path, flags, Mode::empty())?;
        let mut settings = tcgetattr(&theirs)?;
        settings.make_raw();
        tcsetattr(&theirs, OptionalActions::Now, &settings)?;
        fcntl_setfl(&ours, OFlags::RDWR | OFlags::NONBLOCK)?;
        if let Some(link) = &self.link {
            if fs::symlink_metadata(link).is_ok_and(|file| file.is_symlink()) {
                fs::remove_file(link)?;
            }
            symlink(&path, link)?;
        }
        self.ends = Some(TerminalEnds { ours, theirs, path });
        Ok(())
    }

    /// Closes the terminal, as when an adapter is pulled out. The servos keep their power.
    fn unplug(&mut self) {
        let Some(ends) = self.ends.take() else { return };
        // Only the own link is removed: another emulator may have replaced it.
        if let Some(link) = &self.link
            && fs::read_link(link).is_ok_and(|to| to == ends.path)
        {
            let _ = fs::remove_file(link);
        }
    }

    /// The path that hosts open, unless it is unplugged.
    pub fn path(&self) -> Option<PathBuf> {
        self.ends.as_ref().map(|ends| ends.path.clone())
    }

    /// Answers hosts until a signal comes or the parent has ended.
    ///
    /// # Errors
    /// When the terminal fails.
    pub fn serve(
        &mut self,
        mut chain: EmulatedChain,
        signals: &TerminationSignals,
        tasks: &EmulatorTasks,
    ) -> io::Result<()> {
        precise_timers();
        let began = monotonic_ns();
        let now = || monotonic_ns() - began;
        let mut commands = tasks.control.then(Vec::new);
        let mut torque: Vec<bool> = Vec::new();
        while signals.received() == 0 && !tasks.parent.as_ref().is_some_and(ProcessHandle::ended) {
            while let Some(answer) = chain.take(now()) {
                // A host that does not read loses the answer, as on a real bus.
                let _ = self.ends.as_ref().map(|ends| rustix::io::write(&ends.ours, &answer));
            }
            if tasks.trace {
                trace(&mut chain, now(), &mut torque, tasks.json);
            }
            let wait = chain.next_answer().map_or(MAX_SLEEP, |due| due.saturating_sub(now()).min(MAX_SLEEP));
            let [has_bytes, has_command] = self.wait(wait, commands.is_some());
            if let Some(ends) = &self.ends {
                if has_bytes {
                    ends.receive(&mut chain, now())?;
                }
                let _ = ioctl_tiocnxcl(&ends.theirs);
            }
            if has_command && let Some(line) = commands.as_mut() {
                let ended = !self.read_commands(line, &mut chain, now(), tasks.json)?;
                if ended {
                    commands = None;
                }
            }
        }
        Ok(())
    }

    /// Waits for `wait` ns at most. Returns whether there are bytes of a host, and input of the user.
    fn wait(&self, wait: u64, commands: bool) -> [bool; 2] {
        let input = std::io::stdin();
        let mut fds = Vec::with_capacity(2);
        if let Some(ends) = &self.ends {
            fds.push(PollFd::new(&ends.ours, PollFlags::IN));
        }
        if commands {
            fds.push(PollFd::from_borrowed_fd(input.as_fd(), PollFlags::IN));
        }
        let limit = Timespec { tv_sec: (wait / 1_000_000_000) as i64, tv_nsec: (wait % 1_000_000_000) as i64 };
        // A signal interrupts the wait; the caller checks for it.
        let _ = poll(&mut fds, Some(&limit));
        let ready = |i: usize| fds.get(i).is_some_and(|fd| !fd.revents().is_empty());
        match self.ends.is_some() {
            true => [ready(0), ready(1)],
            false => [false, ready(0)],
        }
    }

    /// Reads standard input and executes complete lines. Returns whether there may be more input.
    fn read_commands(
        &mut self,
        line: &mut Vec<u8>,
        chain: &mut EmulatedChain,
        now: u64,
        json: bool,
    ) -> io::Result<bool> {
        let mut bytes = [0; 1024];
        let n = match rustix::io::read(std::io::stdin(), &mut bytes) {
            Ok(n) => n,
            Err(rustix::io::Errno::INTR | rustix::io::Errno::AGAIN) => return Ok(true),
            Err(error) => return Err(error.into()),
        };
        line.extend_from_slice(&bytes[..n]);
        while let Some(end) = line.iter().position(|&byte| byte == b'\n') {
            let text = String::from_utf8_lossy(&line[..end]).into_owned();
            line.drain(..=end);
            match text.trim() {
                "unplug" => self.unplug(),
                "plug" => self.plug()?,
                text => execute(text, chain, now, json),
            }
        }
        Ok(n > 0)
    }
}

impl TerminalEnds {
    /// The baud rate that the host has set.
    fn baud(&self) -> u32 {
        tcgetattr(&self.theirs).map_or(0, |settings| settings.output_speed())
    }

    /// Passes the bytes that a host has sent to the chain.
    fn receive(&self, chain: &mut EmulatedChain, now: u64) -> io::Result<()> {
        let mut bytes = [0; 4096];
        match rustix::io::read(&self.ours, &mut bytes) {
            Ok(n) => chain.receive(now, self.baud(), &bytes[..n]),
            Err(rustix::io::Errno::AGAIN | rustix::io::Errno::INTR) => {}
            Err(error) => return Err(error.into()),
        }
        Ok(())
    }
}

/// Prints the servos whose torque has changed.
fn trace(chain: &mut EmulatedChain, now: u64, torque: &mut Vec<bool>, json: bool) {
    let state = chain.state(now);
    let first = torque.is_empty();
    for (i, servo) in state.iter().enumerate() {
        if first || torque[i] != servo.torque {
            print_state(std::slice::from_ref(servo), now, json);
        }
    }
    torque.clear();
    torque.extend(state.iter().map(|servo| servo.torque));
}

impl Drop for PseudoTerminal {
    fn drop(&mut self) {
        self.unplug();
    }
}

/// Executes one line of standard input.
fn execute(text: &str, chain: &mut EmulatedChain, now: u64, json: bool) {
    let words: Vec<_> = text.split_whitespace().collect();
    match words[..] {
        [] => {}
        ["state"] => print_state(&chain.state(now), now, json),
        ["hand", id, steps] => match (id.parse::<u8>(), steps.parse::<f64>()) {
            (Ok(id), Ok(steps)) if steps.is_finite() && steps.abs() < 1e6 => {
                if !chain.move_by_hand(now, id, steps) {
                    eprintln!("tectum-servo-emulator: there is no servo {id}");
                }
                print_state(&chain.state(now), now, json);
            }
            _ => eprintln!("tectum-servo-emulator: \"{text}\": give an id and a position in steps, as in hand 1 2048"),
        },
        ["fault", fault] => match ServoFault::parse(fault) {
            Ok(fault) => chain.add_fault(now, fault),
            Err(why) => eprintln!("tectum-servo-emulator: fault {fault}: {why}"),
        },
        _ => eprintln!(
            "tectum-servo-emulator: \"{text}\": there are hand ID STEPS, state, unplug, plug and fault \
             KIND[:SERVO[:FROM_S[:UNTIL_S]]]"
        ),
    }
}

/// Prints the state of servos on standard output; errors are ignored.
fn print_state(servos: &[ServoState], now: u64, json: bool) {
    let at = now as f64 / 1e9;
    let mut out = io::stdout().lock();
    if json {
        let text = serde_json::json!({ "at_s": at, "servos": servos });
        let _ = writeln!(out, "{text}");
    } else {
        for servo in servos {
            let torque = if servo.torque { "on" } else { "off" };
            let _ = writeln!(
                out,
                "{at:.3} s  servo {}: position {:.1}, speed {:.1} steps/s, torque {torque}, errors {}",
                servo.id, servo.position, servo.speed, servo.errors
            );
        }
    }
    let _ = out.flush();
}
