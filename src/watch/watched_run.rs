//! A run that is launched and watched by one command: the launcher is a child of the watcher, because the two cannot
//! share a terminal. What the launcher prints is kept until the terminal is free again.

use std::ffi::OsString;
use std::fs::File;
use std::io::{Read as _, Seek as _, SeekFrom};
use std::path::Path;
use std::process::{Child, Command, ExitStatus, Stdio};

use rustix::process::{Pid, Signal, getppid, kill_process, set_parent_process_death_signal};

use super::screen_session::ScreenSession;
use super::{FaceEnd, Follower, WatchError, WatchTarget, watch_in_terminal};
use crate::clock::{TerminationSignals, pause};
use crate::process::print_error_line;
use crate::runtime::exit;

/// How often it looks whether the launcher has ended, ns.
const POLL_NS: u64 = 20_000_000;

/// What a launcher that was watched has left.
#[derive(Debug)]
pub struct WatchedRun {
    /// Its exit code; 128 plus the number of the signal that killed it.
    pub code: u8,
    /// What it wrote to its standard output.
    pub stdout: String,
    /// What it wrote to its standard error.
    pub stderr: String,
}

/// Starts `program` with `arguments`, a launcher, and watches its run in the terminal until it has ended. When the user
/// quits, the run goes on; Ctrl-C and signals end it.
///
/// # Errors
/// [`WatchError`] if there is no terminal, or it fails.
pub fn launch_and_watch(program: &Path, arguments: &[OsString]) -> Result<WatchedRun, WatchError> {
    if !ScreenSession::has_terminal() {
        return Err(WatchError::NoTerminal);
    }
    let signals = TerminationSignals::install().map_err(WatchError::Signals)?;
    let failed = WatchError::Launcher;
    let [mut stdout, mut stderr] = [tempfile::tempfile().map_err(failed)?, tempfile::tempfile().map_err(failed)?];
    let [out, error] = [stdout.try_clone().map_err(failed)?, stderr.try_clone().map_err(failed)?];
    let mut command = Command::new(program);
    command.args(arguments).stdin(Stdio::null()).stdout(out).stderr(error);
    let mut child = command.spawn().map_err(failed)?;
    let mut follower = Follower::open(WatchTarget::LaunchedBy(child.id()), true)?;
    let end = watch_in_terminal(&mut follower, &signals, || !matches!(child.try_wait(), Ok(None)));
    drop(follower);
    match &end {
        Ok(FaceEnd::Over) => {}
        Ok(FaceEnd::Quit) => print_error_line("tectum: the run goes on; Ctrl-C ends it"),
        Ok(FaceEnd::Interrupted) => send(&child, Signal::INT),
        Ok(FaceEnd::HungUp) => send(&child, Signal::HUP),
        Ok(FaceEnd::Signal(number)) => forward(&child, *number),
        Err(_) => send(&child, Signal::TERM),
    }
    let status = wait(&mut child, &signals).map_err(failed)?;
    end?;
    Ok(WatchedRun { code: code(status), stdout: text(&mut stdout), stderr: text(&mut stderr) })
}

/// For the launcher that [`launch_and_watch`] has started: ends its run in good order when the watcher, its parent,
/// dies. Returns false if that is dead already.
pub fn end_with_parent(parent: u32) -> bool {
    let _ = set_parent_process_death_signal(Some(Signal::TERM));
    getppid().is_some_and(|pid| u32::try_from(pid.as_raw_nonzero().get()) == Ok(parent))
}

/// Waits for the launcher's end. A signal that comes meanwhile is the launcher's, too.
fn wait(child: &mut Child, signals: &TerminationSignals) -> std::io::Result<ExitStatus> {
    let mut forwarded = signals.received();
    loop {
        if let Some(status) = child.try_wait()? {
            return Ok(status);
        }
        if signals.received() != forwarded {
            forwarded = signals.received();
            forward(child, forwarded);
        }
        pause(POLL_NS);
    }
}

fn forward(child: &Child, number: u32) {
    let signal =
        [Signal::INT, Signal::TERM, Signal::HUP, Signal::QUIT].into_iter().find(|s| s.as_raw() == number as i32);
    send(child, signal.unwrap_or(Signal::TERM));
}

/// Signals the launcher, which this process has not collected yet: no other process can have its id.
fn send(child: &Child, signal: Signal) {
    if let Some(pid) = i32::try_from(child.id()).ok().and_then(Pid::from_raw) {
        let _ = kill_process(pid, signal);
    }
}

fn code(status: ExitStatus) -> u8 {
    use std::os::unix::process::ExitStatusExt as _;
    let by_signal = status.signal().map(|number| exit::by_signal(number as u32));
    by_signal.or(status.code().and_then(|code| u8::try_from(code).ok())).unwrap_or(exit::ERROR)
}

fn text(file: &mut File) -> String {
    let mut bytes = Vec::new();
    let read = file.seek(SeekFrom::Start(0)).and_then(|_| file.read_to_end(&mut bytes));
    if read.is_ok() { String::from_utf8_lossy(&bytes).into_owned() } else { String::new() }
}
