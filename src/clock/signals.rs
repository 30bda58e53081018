//! SIGINT and SIGTERM as a flag that loops look at, so that every ending is an orderly one.

use std::sync::{
    Arc,
    atomic::{AtomicUsize, Ordering},
};

use signal_hook::consts::{SIGINT, SIGTERM, SIGXFSZ};

/// The last termination signal that came, if any.
#[derive(Debug, Clone, Default)]
pub struct Signals {
    number: Arc<AtomicUsize>,
}

impl Signals {
    /// Takes over SIGINT and SIGTERM for this process. SIGXFSZ is taken too, so that a file-size limit shows as an
    /// error of the write instead of killing the logger.
    ///
    /// # Errors
    /// When the operating system refuses the registration.
    pub fn install() -> std::io::Result<Self> {
        let signals = Self::default();
        for signal in [SIGINT, SIGTERM] {
            signal_hook::flag::register_usize(signal, Arc::clone(&signals.number), signal as usize)?;
        }
        signal_hook::flag::register_usize(SIGXFSZ, Arc::new(AtomicUsize::new(0)), 0)?;
        Ok(signals)
    }

    /// The number of the termination signal that came, or 0.
    pub fn received(&self) -> u32 {
        self.number.load(Ordering::Relaxed) as u32
    }
}
