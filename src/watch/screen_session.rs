//! The terminal while a screen is drawn on it: raw mode, the alternate screen and no cursor. Whatever ends the session,
//! the terminal is as it was: the end of its owner, an error, a panic, or a signal, which its owner's loop notices.
//!
//! The screen is drawn by differences: only the cells that have changed are written.

use std::io::{IsTerminal as _, Write as _};
use std::sync::{Mutex, Once, PoisonError};

use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::termios::{OptionalActions, Termios, tcgetattr, tcgetwinsize, tcsetattr};
use tectum_view::ratatui::buffer::Buffer;
use tectum_view::ratatui::layout::Rect;
use tectum_view::ratatui::style::{Color, Modifier};

use super::WatchError;

/// The alternate screen, without a cursor and empty.
const ENTER: &[u8] = b"\x1b[?1049h\x1b[?25l\x1b[2J";
/// The opposite.
const LEAVE: &[u8] = b"\x1b[0m\x1b[?25h\x1b[?1049l";

/// The settings to restore, while a session lasts.
static SAVED: Mutex<Option<Termios>> = Mutex::new(None);

/// Restores the terminal, if there is a session. It may be called at any time and more than once.
fn restore() {
    if let Some(settings) = SAVED.lock().unwrap_or_else(PoisonError::into_inner).take() {
        // A terminal that is gone needs nothing.
        let mut out = std::io::stdout();
        let _ = out.write_all(LEAVE).and_then(|()| out.flush());
        let _ = tcsetattr(std::io::stdin(), OptionalActions::Now, &settings);
    }
}

/// A key that a session knows.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Key {
    /// `q`.
    Quit,
    /// Ctrl-C.
    Interrupt,
    /// The space bar.
    Pause,
    /// `?` or `h`.
    Help,
    /// The terminal is gone.
    HungUp,
}

/// The terminal, as long as this lives.
pub(super) struct ScreenSession {
    /// What the terminal shows.
    shown: Buffer,
}

impl ScreenSession {
    /// Whether there is a terminal to draw on.
    pub fn has_terminal() -> bool {
        let dumb = std::env::var_os("TERM").is_none_or(|term| term.is_empty() || term == "dumb");
        std::io::stdin().is_terminal() && std::io::stdout().is_terminal() && !dumb
    }

    /// Takes the terminal.
    ///
    /// # Errors
    /// [`WatchError::NoTerminal`] if there is none, [`WatchError::Terminal`] if it fails.
    pub fn begin() -> Result<Self, WatchError> {
        static HOOK: Once = Once::new();
        if !Self::has_terminal() {
            return Err(WatchError::NoTerminal);
        }
        HOOK.call_once(|| {
            // Before the message of a panic, which would vanish with the alternate screen.
            let before = std::panic::take_hook();
            std::panic::set_hook(Box::new(move |panic| {
                restore();
                before(panic);
            }));
        });
        let failed = |cause: rustix::io::Errno| WatchError::Terminal(cause.into());
        let settings = tcgetattr(std::io::stdin()).map_err(failed)?;
        let mut raw = settings.clone();
        raw.make_raw();
        *SAVED.lock().unwrap_or_else(PoisonError::into_inner) = Some(settings);
        let session = Self { shown: Buffer::empty(Rect::default()) };
        tcsetattr(std::io::stdin(), OptionalActions::Now, &raw).map_err(failed)?;
        let mut out = std::io::stdout();
        out.write_all(ENTER).and_then(|()| out.flush()).map_err(WatchError::Terminal)?;
        Ok(session)
    }

    /// Draws a screen of the terminal's present size.
    ///
    /// # Errors
    /// [`WatchError::Terminal`] if it cannot be written.
    pub fn draw(&mut self, draw: impl FnOnce(Rect, &mut Buffer)) -> Result<(), WatchError> {
        let size = tcgetwinsize(std::io::stdout()).map_err(|e| WatchError::Terminal(e.into()))?;
        // A terminal without a size is taken for an ordinary one. No real one has more cells than this.
        let [width, height] = match (size.ws_col, size.ws_row) {
            (0, _) | (_, 0) => [80, 24],
            (width, height) => [width.min(500), height.min(300)],
        };
        let area = Rect::new(0, 0, width, height);
        let mut next = Buffer::empty(area);
        draw(area, &mut next);
        let mut bytes = Vec::new();
        if self.shown.area != area {
            self.shown = Buffer::empty(area);
            bytes.extend(b"\x1b[0m\x1b[2J");
        }
        write_changes(&self.shown, &next, &mut bytes);
        let mut out = std::io::stdout();
        let written = out.write_all(&bytes).and_then(|()| out.flush());
        self.shown = next;
        match written {
            // A signal that ends the program, or a new size: the next screen is whole.
            Err(error) if error.kind() == std::io::ErrorKind::Interrupted => {
                self.shown = Buffer::empty(Rect::default());
                Ok(())
            }
            written => written.map_err(WatchError::Terminal),
        }
    }

    /// Waits for keys, for `ns` nanoseconds at most.
    pub fn keys(&mut self, ns: u64) -> Vec<Key> {
        let stdin = std::io::stdin();
        let mut fds = [PollFd::new(&stdin, PollFlags::IN)];
        let limit = Timespec { tv_sec: (ns / 1_000_000_000) as i64, tv_nsec: (ns % 1_000_000_000) as i64 };
        // A signal ends the wait early; the caller's loop checks for it.
        if !matches!(poll(&mut fds, Some(&limit)), Ok(1)) {
            return Vec::new();
        }
        let mut bytes = [0; 64];
        match rustix::io::read(&stdin, &mut bytes) {
            Ok(0) | Err(rustix::io::Errno::IO) => vec![Key::HungUp],
            Ok(n) => keys_of(&bytes[..n]),
            Err(_) => Vec::new(),
        }
    }
}

impl Drop for ScreenSession {
    fn drop(&mut self) {
        restore();
    }
}

/// The keys that are known among what was typed. Arrows and other keys that send several bytes are passed over.
fn keys_of(bytes: &[u8]) -> Vec<Key> {
    let mut keys = Vec::new();
    let mut rest = bytes.iter().copied();
    while let Some(byte) = rest.next() {
        match byte {
            b'q' | b'Q' => keys.push(Key::Quit),
            0x03 => keys.push(Key::Interrupt),
            b' ' => keys.push(Key::Pause),
            b'?' | b'h' => keys.push(Key::Help),
            // A sequence ends with its first byte from @ on, after [ or O.
            0x1b if matches!(rest.next(), Some(b'[' | b'O')) => drop(rest.find(|byte| (0x40..0x7f).contains(byte))),
            _ => {}
        }
    }
    keys
}

/// Writes what turns the screen `before` into `after`.
fn write_changes(before: &Buffer, after: &Buffer, bytes: &mut Vec<u8>) {
    let mut style = (Color::Reset, Modifier::empty());
    let mut cursor = None;
    bytes.extend(b"\x1b[0m");
    for (x, y, cell) in before.diff(after) {
        if cursor != Some((x, y)) {
            bytes.extend(format!("\x1b[{};{}H", y + 1, x + 1).as_bytes());
        }
        if style != (cell.fg, cell.modifier) {
            style = (cell.fg, cell.modifier);
            let bold = if cell.modifier.contains(Modifier::BOLD) { ";1" } else { "" };
            bytes.extend(format!("\x1b[0{bold}{}m", colour_code(cell.fg)).as_bytes());
        }
        bytes.extend(cell.symbol().as_bytes());
        cursor = Some((x + 1, y));
    }
    bytes.extend(b"\x1b[0m");
}

/// The parameter that selects a colour; nothing for the terminal's own.
fn colour_code(colour: Color) -> &'static str {
    match colour {
        Color::Red => ";31",
        Color::Green => ";32",
        Color::Yellow => ";33",
        Color::Blue => ";34",
        Color::Magenta => ";35",
        Color::Cyan => ";36",
        Color::DarkGray => ";90",
        _ => "",
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tectum_view::ratatui::style::Style;

    #[test]
    fn only_what_changed_is_written() {
        let area = Rect::new(0, 0, 10, 2);
        let (before, mut after) = (Buffer::empty(area), Buffer::empty(area));
        after.set_string(3, 1, "ab", Style::new().fg(Color::Red).add_modifier(Modifier::BOLD));
        after.set_string(6, 1, "c", Style::new());
        let mut bytes = Vec::new();
        write_changes(&before, &after, &mut bytes);
        let text = String::from_utf8(bytes).unwrap();
        assert_eq!(text, "\x1b[0m\x1b[2;4H\x1b[0;1;31mab\x1b[2;7H\x1b[0mc\x1b[0m");
        let mut bytes = Vec::new();
        write_changes(&after, &after, &mut bytes);
        assert_eq!(bytes, b"\x1b[0m\x1b[0m");
    }

    #[test]
    fn keys_are_known_and_sequences_are_passed_over() {
        use Key::{Help, Interrupt, Pause, Quit};
        let keys =
            [b"q".as_slice(), b"\x03", b"x? ", b"\x1b[A\x1b[3~q", b"\x1bOPq", b"\x1bq", b"\x1b", b""].map(keys_of);
        let known = [vec![Quit], vec![Interrupt], vec![Help, Pause], vec![Quit], vec![Quit], vec![], vec![], vec![]];
        assert_eq!(keys, known);
    }
}
