//! One line that shows how far a bench is, on standard error, and only when that is a terminal.

use std::io::{IsTerminal as _, Write as _};

/// The line; it goes when this is dropped.
#[derive(Debug)]
pub struct BenchProgress(bool);

impl BenchProgress {
    /// A line, silent unless it is wanted and standard error is a terminal.
    pub fn new(wanted: bool) -> Self {
        Self(wanted && std::io::stderr().is_terminal())
    }

    /// Shows `text`.
    pub fn show(&self, text: &str) {
        if self.0 {
            // A line that cannot be drawn is no reason to end.
            let _ = write!(std::io::stderr(), "\r{text}\x1b[K");
        }
    }
}

impl Drop for BenchProgress {
    fn drop(&mut self) {
        if self.0 {
            let _ = std::io::stderr().write_all(b"\r\x1b[K");
        }
    }
}
