//! A progress line on standard error: one line that is overwritten in place, shown only on a terminal.

use std::io::{IsTerminal as _, Write as _};

/// The line. It is erased when this is dropped.
#[derive(Debug)]
pub(crate) struct ProgressLine {
    enabled: bool,
    drawn: bool,
}

impl ProgressLine {
    /// A line that stays silent unless it is `wanted` and standard error is a terminal.
    pub fn new(wanted: bool) -> Self {
        Self { enabled: wanted && std::io::stderr().is_terminal(), drawn: false }
    }

    /// Whether the line is shown at all. Callers need not compute its text otherwise.
    pub fn enabled(&self) -> bool {
        self.enabled
    }

    /// Replaces the line by `text`.
    pub fn show(&mut self, text: &str) {
        if self.enabled {
            // A progress line that cannot be drawn is no reason to end.
            let _ = std::io::stderr().write_all(format!("\r{text}\x1b[K").as_bytes());
            self.drawn = true;
        }
    }

    /// Erases the line.
    pub fn clear(&mut self) {
        if self.drawn {
            let _ = std::io::stderr().write_all(b"\r\x1b[K");
            self.drawn = false;
        }
    }
}

impl Drop for ProgressLine {
    fn drop(&mut self) {
        self.clear();
    }
}
