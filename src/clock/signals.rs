//! SIGINT and SIGTERM as a flag that loops look at, so that every ending is an orderly one; and SIGUSR1, which asks for a
//! checkpoint.

use std::sync::{
    Arc,
    atomic::{AtomicBool, AtomicUsize, Ordering},
};

use signal_hook::consts::{SIGINT, SIGTERM, SIGUSR1, SIGXFSZ};

/// The last termination signal that came, if any, and whether a checkpoint was asked for.
#[derive(Debug, Clone, Default)]
pub struct TerminationSignals {
    number: Arc<AtomicUsize>,
    asked: Arc<AtomicBool>,
}

impl TerminationSignals {
    /// Takes over SIGINT, SIGTERM and SIGUSR1 for this process. SIGXFSZ is taken too, so that a file-size limit shows as an
    /// error of the write instead of killing the logger.
    ///
    /// # Errors
    /// When the operating system refuses the registration.
    pub fn install() -> std::io::Result<Self> {
        let signals = Self::default();
        for signal in [SIGINT, SIGTERM] {
            signal_hook::flag::register_usize(signal, Arc::clone(&signals.number), signal as usize)?;
        }
        signal_hook::flag::register(SIGUSR1, Arc::clone(&signals.asked))?;
        signal_hook::flag::register_usize(SIGXFSZ, Arc::new(AtomicUsize::new(0)), 0)?;
        Ok(signals)
    }

    /// The number of the termination signal that came, or 0.
    pub fn received(&self) -> u32 {
        self.number.load(Ordering::Relaxed) as u32
    }

    /// Whether a checkpoint was asked for since the last call.
    pub fn checkpoint_asked(&self) -> bool {
        self.asked.swap(false, Ordering::Relaxed)
    }
}
