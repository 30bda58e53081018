//! The terminal's face: a run drawn into cells. A pure function of the state and the size, for any terminal.
//!
//! From 70 columns on, two columns of panels stand side by side; below, they stand one under the other, and those that
//! do not fit are left out, the last first.

mod dots;
mod panels;

use ratatui_core::buffer::Buffer;
use ratatui_core::layout::Rect;
use ratatui_core::style::{Color, Modifier, Style};

use crate::RunView;

/// Least width for two columns.
const WIDE: u16 = 70;

/// How to draw.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct ScreenOptions {
    /// Without colours (`NO_COLOR`).
    pub plain: bool,
    /// Show the help over the panels.
    pub help: bool,
    /// The display stands still.
    pub paused: bool,
}

impl ScreenOptions {
    fn colour(self, colour: Color) -> Style {
        if self.plain { Style::new() } else { Style::new().fg(colour) }
    }

    fn strong(self) -> Style {
        Style::new().add_modifier(Modifier::BOLD)
    }

    fn weak(self) -> Style {
        if self.plain { Style::new() } else { Style::new().fg(Color::DarkGray) }
    }
}

/// Draws the run into `area` of `buffer`.
pub fn draw_screen(view: &RunView, options: ScreenOptions, area: Rect, buffer: &mut Buffer) {
    if area.width < 2 || area.height < 2 {
        return;
    }
    let title_rows = panels::title(view, options, area, buffer);
    let rows = area.height.saturating_sub(title_rows + 1);
    let body = Rect { y: area.y + title_rows, height: rows, ..area };
    if options.help {
        panels::help(options, body, buffer);
    } else if area.width >= WIDE {
        wide(view, options, body, buffer);
    } else {
        narrow(view, options, body, buffer);
    }
    let bottom = Rect { y: area.bottom() - 1, height: 1, ..area };
    panels::keys(view, options, bottom, buffer);
}

/// Draws a sentence alone, when there is no run to show.
pub fn draw_notice(text: &str, options: ScreenOptions, area: Rect, buffer: &mut Buffer) {
    let rows = panels::wrapped(text, usize::from(area.width));
    for (row, line) in rows.iter().enumerate().take(usize::from(area.height.saturating_sub(1))) {
        panels::put(buffer, area, row as u16, line, Style::new());
    }
    if area.height > 1 {
        panels::put(buffer, area, area.height - 1, "q quit", options.weak());
    }
}

type Panel = fn(&RunView, ScreenOptions, Rect, &mut Buffer);

/// Two columns: where the plant is and what it cost on top, numbers below, and what happened at the bottom.
fn wide(view: &RunView, options: ScreenOptions, area: Rect, buffer: &mut Buffer) {
    let below = panels::budget_rows(view).max(panels::PROCESS_ROWS).min(area.height);
    let events = (area.height / 5).clamp(3, 12).min(area.height - below);
    let top = area.height - below - events;
    let left = Rect { width: area.width / 2 - 1, ..area };
    let right = Rect { x: area.x + area.width / 2, width: area.width - area.width / 2, ..area };
    panels::plant(view, options, Rect { height: top, ..left }, buffer);
    curves(view, options, Rect { height: top, ..right }, buffer);
    panels::budget(view, options, Rect { y: area.y + top, height: below, ..left }, buffer);
    panels::processes(view, options, Rect { y: area.y + top, height: below, ..right }, buffer);
    panels::events(view, options, Rect { y: area.y + top + below, height: events, ..area }, buffer);
}

/// Loss above error, or loss alone.
fn curves(view: &RunView, options: ScreenOptions, area: Rect, buffer: &mut Buffer) {
    if view.facts.error.is_some() && area.height >= 8 {
        let half = area.height / 2;
        panels::loss(view, options, Rect { height: half, ..area }, buffer);
        panels::error(view, options, Rect { y: area.y + half, height: area.height - half, ..area }, buffer);
    } else {
        panels::loss(view, options, area, buffer);
    }
}

/// One column.
fn narrow(view: &RunView, options: ScreenOptions, area: Rect, buffer: &mut Buffer) {
    let fixed = panels::budget_rows(view) + panels::PROCESS_ROWS + 3;
    let free = area.height.saturating_sub(fixed);
    let (plant, curve) = if free >= 9 { (free - 4, 4) } else { (free, 0) };
    let sized: [(Panel, u16); 5] = [
        (panels::plant, plant),
        (panels::loss, curve),
        (panels::budget, panels::budget_rows(view)),
        (panels::processes, panels::PROCESS_ROWS),
        (panels::events, u16::MAX),
    ];
    let mut y = area.y;
    for (panel, wanted) in sized {
        let height = wanted.min(area.bottom() - y);
        if height >= 2 {
            panel(view, options, Rect { y, height, ..area }, buffer);
            y += height;
        }
    }
}

#[cfg(test)]
mod tests;
