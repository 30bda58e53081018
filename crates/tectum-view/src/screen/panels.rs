//! The panels of the screen. Each has a title in its first row.

use ratatui_core::buffer::Buffer;
use ratatui_core::layout::Rect;
use ratatui_core::style::{Color, Style};

use super::ScreenOptions;
use super::dots::Dots;
use crate::run_view::ROLES;
use crate::text::{micros, short};
use crate::{Curve, RunEventKind, RunView, Stage, duration, thousands};

/// Rows of the panel of processes: title, three processes, two rows of counts.
pub(super) const PROCESS_ROWS: u16 = 6;
/// Records whose end-effectors are drawn as a path.
const PATH: usize = 60;

/// Writes `text` into a row of `area`, cut off at its right end.
pub(super) fn put(buffer: &mut Buffer, area: Rect, row: u16, text: &str, style: Style) {
    put_at(buffer, area, [0, row], text, style);
}

/// The same from a column on. Returns the column after it.
fn put_at(buffer: &mut Buffer, area: Rect, [column, row]: [u16; 2], text: &str, style: Style) -> u16 {
    if row >= area.height || column >= area.width {
        return column;
    }
    let width = usize::from(area.width - column);
    let (after, _) = buffer.set_stringn(area.x + column, area.y + row, text, width, style);
    after - area.x
}

/// Breaks a text at spaces into lines of at most `width` characters.
pub(super) fn wrapped(text: &str, width: usize) -> Vec<String> {
    let mut lines: Vec<String> = Vec::new();
    for word in text.split_whitespace() {
        match lines.last_mut() {
            Some(line) if line.chars().count() + 1 + word.chars().count() <= width => {
                line.push(' ');
                line.push_str(word);
            }
            _ => lines.push(word.to_owned()),
        }
    }
    lines
}

/// What the run is and how far it is. Returns the rows that it took.
pub(super) fn title(view: &RunView, options: ScreenOptions, area: Rect, buffer: &mut Buffer) -> u16 {
    let facts = &view.facts;
    let mode = if facts.realtime { "real time" } else { "lockstep" };
    let name = format!("{}  {mode}, seed {}", facts.name, facts.seed);
    let (done, total) = (view.ticks_done().min(facts.ticks), facts.ticks);
    let share = 100.0 * done as f64 / total.max(1) as f64;
    let mut progress = format!("tick {} of {}  {share:.0} %", thousands(done), thousands(total));
    if let Some(how) = &view.ended {
        progress += &format!("  {how}");
    } else if let Some(left) = view.seconds_left() {
        progress += &format!("  {} left", duration(left));
    }
    let style = if view.ended.is_some() { options.colour(Color::Yellow) } else { Style::new() };
    put(buffer, area, 0, &name, options.strong());
    let (used, width) = (name.chars().count() as u16 + 2, progress.chars().count() as u16);
    if used + width <= area.width {
        put_at(buffer, area, [area.width - width, 0], &progress, style);
        1
    } else {
        put(buffer, area, 1, &progress, style);
        2
    }
}

/// The last row: keys, and whether the display stands still.
pub(super) fn keys(view: &RunView, options: ScreenOptions, area: Rect, buffer: &mut Buffer) {
    let pause = if options.paused { "space go on" } else { "space pause" };
    let mut column = put_at(buffer, area, [0, 0], &format!("q quit  {pause}  ? help"), options.weak());
    if options.paused {
        column = put_at(buffer, area, [column + 2, 0], "paused", options.colour(Color::Yellow));
    }
    if view.passed_over > 0 {
        let all = view.passed_over + view.taken;
        let text = format!("shown {} of {} ticks", thousands(view.taken), thousands(all));
        let width = text.chars().count() as u16;
        if column + 2 + width <= area.width {
            put_at(buffer, area, [area.width - width, 0], &text, options.weak());
        }
    }
}

/// Keys and words.
pub(super) fn help(options: ScreenOptions, area: Rect, buffer: &mut Buffer) {
    const LINES: [&str; 14] = [
        "q, Ctrl-C   quit; the run goes on",
        "space       pause the display",
        "?           this help",
        "",
        "sensing   from the scheduled instant until the observation was sent",
        "answer    from then until the command was sent",
        "learning  from then until the learner was done",
        "slack     from then until the next tick",
        "",
        "missed   ticks whose command had not come in time",
        "late     commands that came after their tick",
        "skipped  ticks that the plant passed over",
        "lost     samples that the logger or the controller never got",
        "shown    a watcher never waits: what is too much, it leaves out",
    ];
    for (row, line) in LINES.iter().enumerate() {
        put(buffer, area, row as u16, line, if row < 3 { options.strong() } else { Style::new() });
    }
}

/// The arm, or bars of the inputs if there is none to draw.
pub(super) fn plant(view: &RunView, options: ScreenOptions, area: Rect, buffer: &mut Buffer) {
    if area.height < 3 {
        return;
    }
    let body = Rect { y: area.y + 1, height: area.height - 1, ..area };
    let arm = view.facts.arm.filter(|_| view.newest().is_some_and(|record| !record.posture.is_empty()));
    match arm {
        Some(_) if body.height >= 4 => {
            put(buffer, area, 0, "arm", options.strong());
            let column = put_at(buffer, area, [5, 0], "+", options.colour(Color::Green));
            let column = put_at(buffer, area, [column + 1, 0], "target  ", options.weak());
            put_at(buffer, area, [column, 0], "path of its end", options.colour(Color::Blue));
            draw_arm(view, options, body, buffer);
        }
        _ => {
            put(buffer, area, 0, "inputs, and commands applied", options.strong());
            draw_bars(view, options, body, buffer);
        }
    }
}

fn draw_arm(view: &RunView, options: ScreenOptions, area: Rect, buffer: &mut Buffer) {
    let (Some(frame), Some(newest)) = (view.facts.arm, view.newest()) else { return };
    let mut dots = Dots::new(area);
    // A cell is about twice as high as wide, so that its dots form a square grid.
    let [width, height] = dots.size();
    let scale = width.min(height) / (2.0 * f64::from(frame.half));
    let place = |[x, y]: [f32; 2]| {
        let x = width / 2.0 + f64::from(x - frame.centre[0]) * scale;
        [x, height / 2.0 + f64::from(y - frame.centre[1]) * scale]
    };
    let path: Vec<_> = view.records().rev().take(PATH).filter_map(|record| record.posture.last().copied()).collect();
    for pair in path.windows(2) {
        dots.line(place(pair[0]), place(pair[1]));
    }
    dots.draw(buffer, options.colour(Color::Blue));
    let mut dots = Dots::new(area);
    for pair in newest.posture.windows(2) {
        dots.line(place(pair[0]), place(pair[1]));
        // A joint is a small square.
        let [x, y] = place(pair[0]);
        (0..4).for_each(|i| dots.set(x + f64::from(i % 2), y + f64::from(i / 2)));
    }
    dots.draw(buffer, options.colour(Color::Yellow));
    if let Some([x, y]) = newest.target.map(place).filter(|at| at.iter().all(|x| *x >= 0.0)) {
        let (column, row) = ((x / 2.0) as u16, ((height - y) / 4.0) as u16);
        put_at(buffer, area, [column, row], "+", options.colour(Color::Green).patch(options.strong()));
    }
}

fn draw_bars(view: &RunView, options: ScreenOptions, area: Rect, buffer: &mut Buffer) {
    let Some(newest) = view.newest() else { return };
    let facts = &view.facts;
    let inputs = facts.inputs.iter().zip(&newest.inputs).map(|pair| (pair, Color::Cyan));
    let outputs = facts.outputs.iter().zip(&newest.applied).map(|pair| (pair, Color::Magenta));
    let names = facts.inputs.iter().chain(&facts.outputs).map(|signal| signal.name.chars().count());
    let label = names.max().unwrap_or(0).min(usize::from(area.width) / 3);
    let value_width = 9;
    let bar = usize::from(area.width).saturating_sub(label + value_width + 3);
    for (row, ((signal, &value), colour)) in inputs.chain(outputs).enumerate() {
        let row = row as u16;
        let name: String = signal.name.chars().take(label).collect();
        put(buffer, area, row, &format!("{name:label$}"), options.weak());
        let share = (value - signal.min) / (signal.max - signal.min);
        if bar > 0 && share.is_finite() {
            let filled = (share.clamp(0.0, 1.0) * bar as f32).round() as usize;
            let text = format!("{}{}", "█".repeat(filled), "·".repeat(bar - filled));
            put_at(buffer, area, [label as u16 + 1, row], &text, options.colour(colour));
        }
        let text = format!("{:>value_width$} {}", short(f64::from(value)), signal.unit);
        put_at(buffer, area, [(label + bar + 2) as u16, row], &text, Style::new());
    }
}

/// Loss over the run.
pub(super) fn loss(view: &RunView, options: ScreenOptions, area: Rect, buffer: &mut Buffer) {
    curve(view, &view.loss, ["loss", ""], options.colour(Color::Cyan), options, area, buffer);
}

/// Error over the run.
pub(super) fn error(view: &RunView, options: ScreenOptions, area: Rect, buffer: &mut Buffer) {
    let unit = view.facts.error_unit.as_str();
    curve(view, &view.error, ["error", unit], options.colour(Color::Green), options, area, buffer);
}

/// A curve with its range and newest value. Its scale is logarithmic where the values differ much.
fn curve(
    view: &RunView,
    curve: &Curve,
    [name, unit]: [&str; 2],
    style: Style,
    options: ScreenOptions,
    area: Rect,
    buffer: &mut Buffer,
) {
    if area.height < 2 {
        return;
    }
    let points: Vec<_> = curve.points().collect();
    let after = put_at(buffer, area, [0, 0], name, options.strong());
    let Some((_, newest)) = points.last() else { return };
    let least = points.iter().map(|point| point.1).fold(f64::INFINITY, f64::min);
    let most = points.iter().map(|point| point.1).fold(f64::NEG_INFINITY, f64::max);
    let logarithmic = least > 0.0 && most / least > 30.0;
    let scale = if logarithmic { ", log" } else { "" };
    let unit = if unit.is_empty() { String::new() } else { format!(" {unit}") };
    let text = format!("{}{unit} now  {} to {}{scale}", short(*newest), short(least), short(most));
    put_at(buffer, area, [after + 1, 0], &text, options.weak());
    let of = |value: f64| if logarithmic { value.ln() } else { value };
    let (low, high) = (of(least), of(most));
    let mut dots = Dots::new(Rect { y: area.y + 1, height: area.height - 1, ..area });
    let [width, height] = dots.size();
    let end = view.ticks_done().max(1) as f64;
    let place = |(tick, value): (u64, f64)| {
        let share = if high > low { (of(value) - low) / (high - low) } else { 0.5 };
        [tick as f64 / end * (width - 1.0), share * (height - 1.0)]
    };
    for change in view.facts.changes.iter().filter(|change| change.0 < view.tick) {
        let mut mark = Dots::new(Rect { y: area.y + 1, height: area.height - 1, ..area });
        let [x, _] = place((change.0, least));
        (0..height as u32).step_by(3).for_each(|y| mark.set(x, f64::from(y)));
        mark.draw(buffer, options.weak());
    }
    let [x, y] = place(points[0]);
    dots.set(x, y);
    for pair in points.windows(2) {
        dots.line(place(pair[0]), place(pair[1]));
    }
    dots.draw(buffer, style);
}

/// Rows of the panel of the budget.
pub(super) fn budget_rows(view: &RunView) -> u16 {
    if view.facts.realtime { 6 } else { 3 }
}

/// Where the time of a tick goes.
pub(super) fn budget(view: &RunView, options: ScreenOptions, area: Rect, buffer: &mut Buffer) {
    let period = view.facts.period_ns as f64 / 1e3;
    put(buffer, area, 0, &format!("tick of {}", micros(period)), options.strong());
    if !view.facts.realtime {
        put(buffer, area, 1, "lockstep: as fast as the processes go,", Style::new());
        put(buffer, area, 2, "so no budget", Style::new());
        return;
    }
    put(buffer, area, 1, &format!("{:9}{:>10}{:>10}{:>7}", "", "p50", "p99", "share"), options.weak());
    for (row, stage) in Stage::ALL.into_iter().enumerate() {
        // The budget is short where there is little slack.
        let tail = if stage == Stage::Slack { 0.01 } else { 0.99 };
        let times = view.stages[stage as usize].quantiles([0.5, tail]);
        let text = times.map_or_else(
            || format!("{:9}{:>10}", stage.name(), "-"),
            |[p50, p99]| {
                let share = 100.0 * p50 / period;
                format!("{:9}{:>10}{:>10}{share:>5.1} %", stage.name(), micros(p50), micros(p99))
            },
        );
        let overrun = stage == Stage::Slack && times.is_some_and(|[_, p1]| p1 <= 0.0);
        let style = if overrun { options.colour(Color::Red) } else { Style::new() };
        put(buffer, area, row as u16 + 2, &text, style);
    }
}

/// The processes and their counts.
pub(super) fn processes(view: &RunView, options: ScreenOptions, area: Rect, buffer: &mut Buffer) {
    put(buffer, area, 0, &format!("processes  {} ticks/s", rate(view.rate)), options.strong());
    for (row, (role, process)) in ROLES.iter().zip(&view.processes).enumerate() {
        let row = row as u16 + 1;
        let column = put_at(buffer, area, [0, row], &format!("{role:11}"), Style::new());
        let colour = if process.state.is_bad() { Color::Red } else { Color::Green };
        let column = put_at(buffer, area, [column, row], process.state.name(), options.colour(colour));
        let mut more = String::new();
        if process.restarts > 0 {
            more += &format!("  start {}", process.restarts + 1);
        }
        if process.pid > 0 {
            more += &format!("  pid {}", process.pid);
        }
        put_at(buffer, area, [column, row], &more, options.weak());
    }
    let [plant, controller, logger] = &view.processes;
    let counts = [
        [("missed", plant.missed), ("late", plant.late), ("skipped", plant.lost)],
        [("lost by logger", logger.lost), ("by controller", controller.lost), ("", 0)],
    ];
    for (row, counts) in counts.iter().enumerate() {
        let mut column = 0;
        for (name, count) in counts.iter().filter(|(name, _)| !name.is_empty()) {
            let style = if *count > 0 { options.colour(Color::Red) } else { Style::new() };
            column =
                put_at(buffer, area, [column, row as u16 + 4], &format!("{name} {}", thousands(*count)), style) + 2;
        }
    }
}

fn rate(rate: f64) -> String {
    if rate < 100.0 { format!("{rate:.1}") } else { thousands(rate as u64) }
}

/// What happened, the newest at the bottom.
pub(super) fn events(view: &RunView, options: ScreenOptions, area: Rect, buffer: &mut Buffer) {
    put(buffer, area, 0, "events", options.strong());
    let rows = usize::from(area.height.saturating_sub(1));
    let mut newest: Vec<_> = view.events.iter().rev().take(rows).collect();
    newest.reverse();
    for (row, event) in newest.into_iter().enumerate() {
        let row = row as u16 + 1;
        let column = put_at(buffer, area, [0, row], &format!("{:>9}  ", thousands(event.last_tick)), options.weak());
        let colour = match event.kind {
            RunEventKind::Flag | RunEventKind::Restart => Color::Red,
            RunEventKind::Change | RunEventKind::Run => Color::Yellow,
            RunEventKind::Message => Color::Reset,
        };
        put_at(buffer, area, [column, row], &event.line(), options.colour(colour));
    }
}
