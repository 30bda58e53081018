//! A progress line on standard error: one line that is overwritten in place, shown only on a terminal. What does not
//! fit into the terminal's width is left out, because a line that is broken cannot be overwritten.

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

    /// Replaces the line by as many of `parts` as fit into the terminal's width, two spaces apart.
    pub fn show_parts(&mut self, parts: &[String]) {
        if self.enabled {
            let width = rustix::termios::tcgetwinsize(std::io::stderr()).map_or(0, |size| usize::from(size.ws_col));
            self.show(&fit(parts, if width == 0 { 80 } else { width }));
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

/// As many of the first `parts` as fit into one column less than `width`, so that the cursor stays in the line.
fn fit(parts: &[String], width: usize) -> String {
    let mut line = String::new();
    for part in parts.iter().filter(|part| !part.is_empty()) {
        let gap = if line.is_empty() { "" } else { "  " };
        if line.chars().count() + gap.len() + part.chars().count() >= width {
            break;
        }
        line += gap;
        line += part;
    }
    line
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_narrow_terminal_gets_fewer_parts() {
        let parts = ["arm", "34 %", "", "1,234 of 3,600 ticks", "loss 0.02"].map(str::to_owned);
        assert_eq!(fit(&parts, 80), "arm  34 %  1,234 of 3,600 ticks  loss 0.02");
        assert_eq!(fit(&parts, 40), "arm  34 %  1,234 of 3,600 ticks");
        assert_eq!(fit(&parts, 10), "arm  34 %");
        assert_eq!(fit(&parts, 9), "arm");
        assert_eq!(fit(&parts, 3), "");
    }
}
