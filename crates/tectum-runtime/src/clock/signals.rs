//! Signals as flags that the loops check: SIGINT, SIGTERM, SIGHUP and SIGQUIT end a process in good order, and
//! SIGUSR1 requests a checkpoint.

use std::io::Read as _;
use std::os::fd::{AsFd as _, BorrowedFd};
use std::os::unix::net::UnixStream;
use std::sync::{
    Arc, OnceLock,
    atomic::{AtomicBool, AtomicUsize, Ordering},
};

use signal_hook::consts::{SIGHUP, SIGINT, SIGQUIT, SIGTERM, SIGUSR1, SIGXFSZ};

/// The last termination signal received, if any, and whether a checkpoint was requested.
#[derive(Debug, Clone, Default)]
pub struct TerminationSignals {
    number: Arc<AtomicUsize>,
    checkpoint_requested: Arc<AtomicBool>,
    /// Can be read after a signal. `None` for signals that only flags tell.
    pipe: Option<&'static UnixStream>,
}

/// The reading end of the process's signal pipe: handlers cannot be taken back, so there is one for all calls.
static PIPE: OnceLock<Option<UnixStream>> = OnceLock::new();

impl TerminationSignals {
    /// Handles SIGINT, SIGTERM, SIGHUP (a closed terminal, a lost connection), SIGQUIT and SIGUSR1 for this
    /// process. A SIGHUP that the process was started to ignore, as by `nohup`, stays ignored. SIGXFSZ is handled
    /// too, so that a file-size limit shows as a write error instead of killing the logger.
    ///
    /// # Errors
    /// When the operating system refuses the registration.
    pub fn install() -> std::io::Result<Self> {
        let signals = Self::default();
        let hangup = if ignored(SIGHUP) { None } else { Some(SIGHUP) };
        for signal in [SIGINT, SIGTERM, SIGQUIT].into_iter().chain(hangup) {
            signal_hook::flag::register_usize(signal, Arc::clone(&signals.number), signal as usize)?;
        }
        signal_hook::flag::register(SIGUSR1, Arc::clone(&signals.checkpoint_requested))?;
        signal_hook::flag::register_usize(SIGXFSZ, Arc::new(AtomicUsize::new(0)), 0)?;
        Ok(signals)
    }

    /// The same for a loop that sleeps for long in `poll`. A signal ends such a sleep, but not one that begins just
    /// after the loop has looked at the flags; the [pipe](Self::pipe) does.
    ///
    /// # Errors
    /// As for [`install`](Self::install).
    pub fn install_with_pipe() -> std::io::Result<Self> {
        // The flags come first: whoever is woken finds them set.
        let signals = Self::install()?;
        Ok(Self { pipe: PIPE.get_or_init(|| signal_pipe().ok()).as_ref(), ..signals })
    }

    /// What can be read from the arrival of a signal until [`drain_pipe`](Self::drain_pipe).
    pub fn pipe(&self) -> Option<BorrowedFd<'_>> {
        self.pipe.map(|pipe| pipe.as_fd())
    }

    /// Empties the pipe, for the next signal.
    pub fn drain_pipe(&self) {
        let mut bytes = [0; 64];
        while self.pipe.is_some_and(|mut pipe| matches!(pipe.read(&mut bytes), Ok(1..))) {}
    }

    /// The number of the termination signal received; 0 if there was none.
    pub fn received(&self) -> u32 {
        self.number.load(Ordering::Relaxed) as u32
    }

    /// Ends whoever follows these signals in good order, as SIGTERM does.
    pub fn ask_stop(&self) {
        let _ = self.number.compare_exchange(0, SIGTERM as usize, Ordering::Relaxed, Ordering::Relaxed);
    }

    /// Requests a checkpoint, as SIGUSR1 does.
    pub fn ask_checkpoint(&self) {
        self.checkpoint_requested.store(true, Ordering::Relaxed);
    }

    /// Whether a checkpoint was requested since the last call.
    pub fn checkpoint_asked(&self) -> bool {
        self.checkpoint_requested.swap(false, Ordering::Relaxed)
    }
}

/// A socket into which the handlers of all signals write a byte; its reading end, which does not block.
fn signal_pipe() -> std::io::Result<UnixStream> {
    let (reader, writer) = UnixStream::pair()?;
    reader.set_nonblocking(true)?;
    let hangup = if ignored(SIGHUP) { None } else { Some(SIGHUP) };
    for signal in [SIGINT, SIGTERM, SIGQUIT, SIGUSR1].into_iter().chain(hangup) {
        signal_hook::low_level::pipe::register(signal, writer.try_clone()?)?;
    }
    Ok(reader)
}

/// Lets the programs that this process starts hear SIGHUP, even if `nohup` started it: an ignored signal stays ignored
/// in a started program, a handled one does not. For tests of what a SIGHUP does.
pub fn let_children_hear_hangup() {
    if ignored(SIGHUP) {
        let _ = signal_hook::flag::register(SIGHUP, Arc::default());
    }
}

/// Whether this process ignores `signal`. It inherits that from the program that started it.
fn ignored(signal: i32) -> bool {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let mask = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    let mask = mask.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok()).unwrap_or(0);
    mask >> (signal - 1) & 1 == 1
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::clock::ProcessHandle;

    /// Without the pipe a signal that comes before the wait would be noticed after an hour.
    #[test]
    fn a_signal_before_a_wait_ends_it() {
        let signals = TerminationSignals::install_with_pipe().unwrap();
        let wait = |ns| ProcessHandle::await_any_or(std::iter::empty(), signals.pipe().into_iter(), ns);
        assert!(!wait(1));
        signal_hook::low_level::raise(SIGUSR1).unwrap();
        assert!(wait(3_600_000_000_000) && signals.checkpoint_asked());
        signals.drain_pipe();
        assert!(!wait(1));
    }
}
