//! Signals as flags that the loops check: SIGINT, SIGTERM, SIGHUP and SIGQUIT end a process in good order, and
//! SIGUSR1 requests a checkpoint.

use std::sync::{
    Arc,
    atomic::{AtomicBool, AtomicUsize, Ordering},
};

use signal_hook::consts::{SIGHUP, SIGINT, SIGQUIT, SIGTERM, SIGUSR1, SIGXFSZ};

/// The last termination signal received, if any, and whether a checkpoint was requested.
#[derive(Debug, Clone, Default)]
pub struct TerminationSignals {
    number: Arc<AtomicUsize>,
    checkpoint_requested: Arc<AtomicBool>,
}

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
