//! The emulated chain behind a pseudo-terminal, in real time: what opens its path finds a serial port with
//! servos at its end.
//!
//! The loop sleeps in `poll` until bytes come or an answer is due, and looks up ten times a second for signals.
//! The terminal is raw, and one descriptor of its far end stays open, so that hosts may come and go. A real
//! port forgets that a program wanted it for itself (TIOCEXCL) when the last descriptor is closed, which here
//! never happens: so the emulator takes that mark away, and locks (`flock`) alone keep others out.

use std::fs;
use std::io::{self, Write as _};
use std::os::unix::fs::symlink;
use std::path::{Path, PathBuf};

use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::fd::{AsFd as _, OwnedFd};
use rustix::fs::{Mode, OFlags, fcntl_setfl};
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use rustix::termios::{OptionalActions, ioctl_tiocnxcl, tcgetattr, tcsetattr};

use super::emulator::{EmulatedChain, ServoState};
use crate::clock::{ProcessHandle, TerminationSignals, monotonic_ns, precise_timers};

/// The longest sleep, ns: signals are looked for as often.
const NAP: u64 = 100_000_000;

/// A pseudo-terminal, and the link to it if one was asked for.
#[derive(Debug)]
pub struct PseudoTerminal {
    ours: OwnedFd,
    theirs: OwnedFd,
    path: PathBuf,
    link: Option<PathBuf>,
}

/// What the loop does besides answering.
#[derive(Debug, Default)]
pub struct EmulatorTasks {
    /// Takes commands from standard input: `hand ID STEPS`, `state`.
    pub control: bool,
    /// Says when a servo's torque goes on or off.
    pub trace: bool,
    /// Says everything as JSON, one object a line.
    pub json: bool,
    /// Ends when this process has ended.
    pub parent: Option<ProcessHandle>,
}

impl PseudoTerminal {
    /// A new terminal; `link` is a symbolic link to it, which is put in the place of an older link.
    ///
    /// # Errors
    /// When the system has no terminal left, or the link cannot be made; a file that is no link is left alone.
    pub fn open(link: Option<&Path>) -> io::Result<Self> {
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
        if let Some(link) = link {
            if fs::symlink_metadata(link).is_ok_and(|file| file.is_symlink()) {
                fs::remove_file(link)?;
            }
            symlink(&path, link)?;
        }
        Ok(Self { ours, theirs, path, link: link.map(Path::to_path_buf) })
    }

    /// What hosts open.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The baud rate that the host has set.
    fn baud(&self) -> u32 {
        tcgetattr(&self.theirs).map_or(0, |settings| settings.output_speed())
    }

    /// Answers hosts until a signal comes or the parent has ended.
    ///
    /// # Errors
    /// When the terminal fails.
    pub fn serve(
        &self,
        mut chain: EmulatedChain,
        signals: &TerminationSignals,
        duties: &EmulatorTasks,
    ) -> io::Result<()> {
        precise_timers();
        let began = monotonic_ns();
        let now = || monotonic_ns() - began;
        let mut commands = duties.control.then(Vec::new);
        let mut torque: Vec<bool> = Vec::new();
        let mut bytes = [0; 4096];
        while signals.received() == 0 && !duties.parent.as_ref().is_some_and(ProcessHandle::ended) {
            while let Some(answer) = chain.take(now()) {
                // A host that does not read loses what it is told, as on a wire.
                let _ = rustix::io::write(&self.ours, &answer);
            }
            if duties.trace {
                self.trace(&mut chain, now(), &mut torque, duties.json);
            }
            let wait = chain.next_answer().map_or(NAP, |due| due.saturating_sub(now()).min(NAP));
            let input = std::io::stdin();
            let mut fds = vec![PollFd::new(&self.ours, PollFlags::IN)];
            if commands.is_some() {
                fds.push(PollFd::from_borrowed_fd(input.as_fd(), PollFlags::IN));
            }
            let limit = Timespec { tv_sec: (wait / 1_000_000_000) as i64, tv_nsec: (wait % 1_000_000_000) as i64 };
            // A signal ends the wait early, and the loop looks at it.
            let _ = poll(&mut fds, Some(&limit));
            let asked = fds.get(1).is_some_and(|fd| !fd.revents().is_empty());
            let came = !fds[0].revents().is_empty();
            drop(fds);
            if came {
                match rustix::io::read(&self.ours, &mut bytes) {
                    Ok(n) => chain.receive(now(), self.baud(), &bytes[..n]),
                    Err(rustix::io::Errno::AGAIN | rustix::io::Errno::INTR) => {}
                    Err(error) => return Err(error.into()),
                }
            }
            let _ = ioctl_tiocnxcl(&self.theirs);
            if asked && let Some(line) = commands.as_mut() {
                let ended = !self.commands(line, &mut chain, now(), duties.json)?;
                if ended {
                    commands = None;
                }
            }
        }
        Ok(())
    }

    /// Reads what there is on standard input and obeys whole lines; whether more may come.
    fn commands(&self, line: &mut Vec<u8>, chain: &mut EmulatedChain, now: u64, json: bool) -> io::Result<bool> {
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
            obey(&text, chain, now, json);
        }
        Ok(n > 0)
    }

    fn trace(&self, chain: &mut EmulatedChain, now: u64, torque: &mut Vec<bool>, json: bool) {
        let state = chain.state(now);
        let first = torque.is_empty();
        for (i, servo) in state.iter().enumerate() {
            if first || torque[i] != servo.torque {
                say(std::slice::from_ref(servo), now, json);
            }
        }
        torque.clear();
        torque.extend(state.iter().map(|servo| servo.torque));
    }
}

impl Drop for PseudoTerminal {
    fn drop(&mut self) {
        // Only a link of one's own is taken away: a successor may have put its own there.
        if let Some(link) = &self.link
            && fs::read_link(link).is_ok_and(|to| to == self.path)
        {
            let _ = fs::remove_file(link);
        }
    }
}

fn obey(text: &str, chain: &mut EmulatedChain, now: u64, json: bool) {
    let words: Vec<_> = text.split_whitespace().collect();
    match words[..] {
        [] => {}
        ["state"] => say(&chain.state(now), now, json),
        ["hand", id, steps] => match (id.parse::<u8>(), steps.parse::<f64>()) {
            (Ok(id), Ok(steps)) if steps.is_finite() && steps.abs() < 1e6 => {
                if !chain.hand(now, id, steps) {
                    eprintln!("tectum-servo-emulator: there is no servo {id}");
                }
                say(&chain.state(now), now, json);
            }
            _ => eprintln!("tectum-servo-emulator: \"{text}\": give an id and a position in steps, as in hand 1 2048"),
        },
        _ => eprintln!("tectum-servo-emulator: \"{text}\": there are hand ID STEPS and state"),
    }
}

/// Says how servos are, on standard output; nobody who listens is no error.
fn say(servos: &[ServoState], now: u64, json: bool) {
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
