//! What every bench needs around its measurement: signals, a folder, the machine's description and a progress line.

use std::path::Path;

use super::{BenchError, Machine};
use crate::clock::{TerminationSignals, monotonic_ns};
use crate::supervise::{LaunchError, ProgressLine, RunFolder};

/// A bench in progress. Its folder is removed again when this is dropped before `folder.keep()`.
pub(super) struct BenchContext {
    pub signals: TerminationSignals,
    pub folder: RunFolder,
    pub machine: Machine,
    pub progress: ProgressLine,
    began_ns: u64,
}

impl BenchContext {
    /// Begins a bench in the folder `out`, or in the first free `runs/<name>-<n>`.
    pub fn start(out: Option<&Path>, name: &str, progress: bool) -> Result<Self, BenchError> {
        let signals = TerminationSignals::install().map_err(LaunchError::Signals)?;
        let folder = RunFolder::create(out, None, name)?;
        let began_ns = monotonic_ns();
        let machine = Machine::now(folder.path());
        Ok(Self { signals, folder, machine, progress: ProgressLine::new(progress), began_ns })
    }

    /// Seconds since the bench began.
    pub fn seconds(&self) -> f64 {
        (monotonic_ns() - self.began_ns) as f64 / 1e9
    }
}

/// An error if a signal has come that ends the bench.
pub(super) fn check_signals(signals: &TerminationSignals) -> Result<(), BenchError> {
    match signals.received() {
        0 => Ok(()),
        number => Err(BenchError::Signal(number)),
    }
}

/// Writes a file of results.
pub(super) fn write_file(path: &Path, text: &str) -> Result<(), BenchError> {
    std::fs::write(path, text).map_err(|error| BenchError::Write { path: path.to_owned(), error })
}
