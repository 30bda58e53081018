//! The terminal's face: looks at the run twenty times a second and draws what it finds.

use tectum_view::ratatui::buffer::Buffer;
use tectum_view::ratatui::layout::Rect;
use tectum_view::{RunView, ScreenOptions, draw_notice, draw_screen};

use super::screen_session::{Key, ScreenSession};
use super::{Follower, WatchError};
use crate::clock::{TerminationSignals, monotonic_ns};

/// Time between two screens, ns.
const FRAME_NS: u64 = 50_000_000;

/// How the terminal's face ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FaceEnd {
    /// The user quit.
    Quit,
    /// The user pressed Ctrl-C.
    Interrupted,
    /// A signal came, with this number.
    Signal(u32),
    /// The terminal is gone.
    HungUp,
    /// `over` returned true.
    Over,
}

/// Shows what `follower` finds until the user quits, a signal comes, or `over` returns true.
///
/// # Errors
/// [`WatchError`] if there is no terminal, or it fails. The terminal is as it was in any case.
pub fn watch_in_terminal(
    follower: &mut Follower,
    signals: &TerminationSignals,
    mut over: impl FnMut() -> bool,
) -> Result<FaceEnd, WatchError> {
    let plain = std::env::var_os("NO_COLOR").is_some_and(|value| !value.is_empty());
    let mut face = Face { options: ScreenOptions { plain, ..ScreenOptions::default() }, frozen: None };
    let mut session = ScreenSession::begin()?;
    let began = monotonic_ns();
    let mut next = began;
    loop {
        if signals.received() != 0 {
            return Ok(FaceEnd::Signal(signals.received()));
        }
        let now = monotonic_ns();
        if now >= next {
            next = now + FRAME_NS;
            follower.look((now - began) as f64 / 1e9);
            if let Err(error) = session.draw(|area, buffer| face.draw(follower, area, buffer)) {
                // The terminal closes before the signal of its end comes.
                let gone = matches!(&error, WatchError::Terminal(cause) if cause.raw_os_error() == Some(EIO));
                return if gone { Ok(FaceEnd::HungUp) } else { Err(error) };
            }
            if over() {
                return Ok(FaceEnd::Over);
            }
        }
        for key in session.keys(next.saturating_sub(monotonic_ns())) {
            match key {
                Key::Quit => return Ok(FaceEnd::Quit),
                Key::Interrupt => return Ok(FaceEnd::Interrupted),
                Key::HungUp => return Ok(FaceEnd::HungUp),
                Key::Pause => face.pause(follower),
                Key::Help => face.options.help = !face.options.help,
            }
            next = monotonic_ns();
        }
    }
}

/// The error of a terminal that is gone.
const EIO: i32 = 5;

/// What is shown, and how.
struct Face {
    options: ScreenOptions,
    /// While the display stands still: what it shows.
    frozen: Option<Box<RunView>>,
}

impl Face {
    fn pause(&mut self, follower: &Follower) {
        self.frozen = match self.frozen.take() {
            Some(_) => None,
            None => follower.view().map(|view| Box::new(view.clone())),
        };
        self.options.paused = self.frozen.is_some();
    }

    fn draw(&self, follower: &Follower, area: Rect, buffer: &mut Buffer) {
        match self.frozen.as_deref().or(follower.view()) {
            Some(view) => draw_screen(view, self.options, area, buffer),
            None => draw_notice(follower.waits_for(), self.options, area, buffer),
        }
    }
}
