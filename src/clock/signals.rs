//! Signals as flags that the loops check: SIGINT and SIGTERM end a process in good order, and SIGUSR1 requests
//! a checkpoint.

use std::sync::{
    Arc,
    atomic::{AtomicBool, AtomicUsize, Ordering},
};

use signal_hook::consts::{SIGINT, SIGTERM, SIGUSR1, SIGXFSZ};

/// The last termination signal received, if any, and whether a checkpoint was requested.
#[derive(Debug, Clone, Default)]
pub struct TerminationSignals {
    number: Arc<AtomicUsize>,
    checkpoint_requested: Arc<AtomicBool>,
}

impl TerminationSignals {
    /// Handles SIGINT, SIGTERM and SIGUSR1 for this process. SIGXFSZ is handled too, so that a file-size limit
    /// shows as a write error instead of killing the logger.
    ///
    /// # Errors
    /// When the operating system refuses the registration.
    pub fn install() -> std::io::Result<Self> {
        let signals = Self::default();
        for signal in [SIGINT, SIGTERM] {
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

    /// Whether a checkpoint was requested since the last call.
    pub(crate) fn checkpoint_asked(&self) -> bool {
        self.checkpoint_requested.swap(false, Ordering::Relaxed)
    }
}
