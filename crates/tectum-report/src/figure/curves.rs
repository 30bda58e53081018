//! The left part: errors and loss over time, with the phases between changes of the plant as bands.
//!
//! A run whose policies were tested shows the test's error first, because that is what the run was for: it
//! has neither exploration noise nor the luck of single targets in it. What the run itself observed is beside
//! it as dots.

use super::panel::{CurveStyle, FigurePhase, NamedCurve, Panel, Scale};
use super::*;
use crate::stats::Window;

/// Height of the strip that names the phases.
const PHASES_HEIGHT: u32 = 20;
/// Height of the room below the last panel, for the axis of time.
const TIME_HEIGHT: u32 = 40;

pub(super) fn draw(history: &RunHistory, area: &Area) -> Result<(), ReportError> {
    let clock = TimeAxis::of(history);
    let phases = phases(history, &clock);
    let (strip, rest) = area.split_vertically(px(if phases.len() > 1 { PHASES_HEIGHT } else { 0 }));
    if phases.len() > 1 {
        panel::phase_names(&phases, clock.end, &strip)?;
    }
    let mut panels = vec![loss_panel(history, &clock)];
    if history.tests.iter().any(|test| drawable(test.error)) {
        panels.insert(0, test_panel(history, &clock));
    } else {
        panels.extend(error_panel(history, &clock));
    }
    let (upper, time) = rest.split_vertically(rest.dim_in_pixel().1 as i32 - px(TIME_HEIGHT));
    for (panel, area) in panels.iter().zip(upper.split_evenly((panels.len(), 1))) {
        panel::draw(panel, &phases, clock.end, &area)?;
    }
    panel::time_axis(clock.end, &clock.label(), &time)?;
    if history.windows.is_empty() {
        let text = anchored(font(13.0, GREY), HPos::Center, VPos::Center);
        let (width, height) = rest.dim_in_pixel();
        let middle = (width as i32 / 2, height as i32 / 2);
        rest.draw(&Text::new("no window was completed", middle, text)).map_err(refused)?;
    }
    Ok(())
}

/// The stretches between changes of the plant.
fn phases(history: &RunHistory, clock: &TimeAxis) -> Vec<FigurePhase> {
    let mut phases = vec![FigurePhase { from: 0.0, until: clock.end, name: "before".to_owned() }];
    for (tick, what) in &history.marks {
        let at = clock.at(*tick);
        if !(0.0..clock.end).contains(&at) {
            continue;
        }
        let last = phases.len() - 1;
        if phases[last].from == at {
            // Two changes at once, or one at the very beginning.
            let name = &mut phases[last].name;
            *name = if name == "before" { what.clone() } else { format!("{name}, {what}") };
            continue;
        }
        phases[last].until = at;
        phases.push(FigurePhase { from: at, until: clock.end, name: format!("after: {what}") });
    }
    phases
}

fn loss_panel(history: &RunHistory, clock: &TimeAxis) -> Panel {
    let windows = by_target(&history.windows);
    let curve = |name: &str, colour, width, value: &dyn Fn(&Window) -> f64| NamedCurve {
        name: name.to_owned(),
        colour,
        style: CurveStyle::Line(width),
        points: windows.iter().map(|w| (clock.middle(w), value(w))).collect(),
    };
    let mut curves = if windows.iter().any(|w| w.noise_share > 0.0) {
        vec![
            curve("observed", GREY, 1.4, &|w| w.loss),
            curve("without exploration noise", BLUE, 2.0, &Window::loss_without_noise),
        ]
    } else {
        vec![curve("observed", BLUE, 2.0, &|w| w.loss)]
    };
    curves.extend(optimum(history, clock, |span| span.loss));
    Panel { name: "loss per tick".to_owned(), scale: Scale::Logarithmic, curves }
}

/// The test's error, the observed errors and the optimum.
fn test_panel(history: &RunHistory, clock: &TimeAxis) -> Panel {
    let ends = history.windows.iter().filter_map(|w| Some((clock.middle(w), w.end_error?)));
    let single = history.windows.iter().all(|w| w.ends <= 1);
    let observed = if single { "observed targets" } else { "observed means" };
    let mut curves = vec![
        NamedCurve { name: observed.into(), colour: SKY, style: CurveStyle::Dots, points: ends.collect() },
        NamedCurve {
            name: "test without noise (median)".into(),
            colour: VERMILION,
            style: CurveStyle::Line(2.2),
            points: history.tests.iter().map(|test| (clock.at(test.tick), test.error)).collect(),
        },
    ];
    curves.extend(optimum(history, clock, |span| span.error));
    Panel { name: with_unit("error at a target's end", &history.unit), scale: Scale::Logarithmic, curves }
}

/// The observed errors of a run without tests; `None` where the plant measures none.
fn error_panel(history: &RunHistory, clock: &TimeAxis) -> Option<Panel> {
    let curve = |name: &str, colour, width, value: &dyn Fn(&Window) -> Option<f64>| NamedCurve {
        name: name.to_owned(),
        colour,
        style: CurveStyle::Line(width),
        points: history.windows.iter().map(|w| (clock.middle(w), value(w).unwrap_or(f64::NAN))).collect(),
    };
    let mut curves = vec![
        curve("root mean square", SKY, 1.4, &Window::rms_error),
        curve("at the end of a target", VERMILION, 2.2, &|w| w.end_error),
    ];
    curves.retain(|curve| curve.points.iter().any(|p| drawable(p.1)));
    let panel = Panel { name: with_unit("error", &history.unit), scale: Scale::Linear, curves };
    (!panel.curves.is_empty()).then_some(panel)
}

/// The optimum as a line, broken where the plant changes.
fn optimum(history: &RunHistory, clock: &TimeAxis, value: fn(&OptimumSpan) -> f64) -> Option<NamedCurve> {
    let gap = (f64::NAN, f64::NAN);
    let line = |span: &OptimumSpan| [(clock.at(span.from), value(span)), (clock.at(span.until), value(span)), gap];
    let points: Polyline = history.optimum.iter().flat_map(line).collect();
    (!points.is_empty()).then(|| NamedCurve {
        name: "optimum (test median)".into(),
        colour: INK,
        style: CurveStyle::Dashes,
        points,
    })
}

/// Windows put together until each holds the end of a target, if there are such ends at all. A window that is
/// shorter than a target shows either its beginning, far away, or its end, and a curve of such windows shows
/// nothing else.
pub(super) fn by_target(windows: &[Window]) -> Vec<Window> {
    let mut joined: Vec<Window> = Vec::with_capacity(windows.len());
    if windows.iter().all(|w| w.ends == 0) {
        return windows.to_vec();
    }
    for window in windows {
        match joined.last_mut() {
            Some(last) if last.ends == 0 => *last = last.and(window),
            _ => joined.push(window.clone()),
        }
    }
    joined
}

/// From ticks to a time that people count in.
pub(super) struct TimeAxis {
    unit: &'static str,
    /// Of that unit in a tick.
    per_tick: f64,
    /// End of the axis.
    pub end: f64,
}

impl TimeAxis {
    fn of(history: &RunHistory) -> TimeAxis {
        let ticks = history.windows.iter().map(|w| w.from.saturating_add(w.ticks)).max().unwrap_or(0);
        let tested = history.tests.iter().map(|test| test.tick).max().unwrap_or(0);
        Self::new(ticks.max(tested), history.period_s)
    }

    /// The axis of `ticks` ticks of `period_s` seconds.
    pub fn new(ticks: u64, period_s: f64) -> TimeAxis {
        let ticks = ticks.max(1) as f64;
        let seconds = ticks * period_s;
        // A history without a sensible period is drawn over ticks.
        if !(drawable(seconds) && seconds > 0.0) {
            return TimeAxis { unit: "ticks", per_tick: 1.0, end: ticks };
        }
        let (unit, size) = match seconds {
            s if s <= 300.0 => ("s", 1.0),
            s if s <= 3.0 * 3600.0 => ("min", 60.0),
            s if s <= 3.0 * 86_400.0 => ("h", 3600.0),
            _ => ("days", 86_400.0),
        };
        TimeAxis { unit, per_tick: period_s / size, end: seconds / size }
    }

    pub fn at(&self, tick: u64) -> f64 {
        tick as f64 * self.per_tick
    }

    pub fn middle(&self, w: &Window) -> f64 {
        (w.from as f64 + w.ticks as f64 / 2.0) * self.per_tick
    }

    pub fn label(&self) -> String {
        format!("time ({})", self.unit)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tests::arm_history;

    #[test]
    fn time_is_shown_in_what_people_count_in() {
        for (ticks, unit, end) in [(2_000, "s", 100.0), (40_000, "min", 33.333), (1_000_000, "h", 13.888)] {
            let mut history = arm_history();
            history.tests.clear();
            history.windows.truncate(1);
            history.windows[0].ticks = ticks;
            let axis = TimeAxis::of(&history);
            assert_eq!(axis.unit, unit);
            assert!((axis.end - end).abs() < 1e-2, "{}", axis.end);
            assert!((axis.middle(&history.windows[0]) - end / 2.0).abs() < 1e-2);
        }
    }

    #[test]
    fn phases_lie_between_changes() {
        let mut history = arm_history();
        history.period_s = 1.0 / 86_400.0;
        let clock = TimeAxis { unit: "s", per_tick: 1.0, end: 12e6 };
        let told = |history: &RunHistory| -> Vec<(f64, f64, String)> {
            phases(history, &clock).into_iter().map(|p| (p.from, p.until, p.name)).collect()
        };
        assert_eq!(told(&history), [(0.0, 9.3e6, "before".into()), (9.3e6, 12e6, "after: joint 3 blocked".into())]);
        history.marks.push((9_300_000, "x mirrored".into()));
        assert_eq!(told(&history)[1].2, "after: joint 3 blocked, x mirrored");
        history.marks = vec![(0, "joint 1 blocked".into()), (20_000_000, "never".into())];
        assert_eq!(told(&history), [(0.0, 12e6, "joint 1 blocked".into())]);
    }

    #[test]
    fn windows_shorter_than_a_target_are_joined() {
        let window = |from: u64, ends| Window { from, ticks: 10, loss: 1.0, ends, ..Window::default() };
        let windows: Vec<_> = (0..7).map(|i| window(10 * i, u64::from(i % 3 == 2))).collect();
        let joined: Vec<_> = by_target(&windows).iter().map(|w| (w.from, w.ticks, w.ends)).collect();
        assert_eq!(joined, [(0, 30, 1), (30, 30, 1), (60, 10, 0)]);
        let none: Vec<_> = (0..7).map(|i| window(10 * i, 0)).collect();
        assert_eq!(by_target(&none).len(), 7);
    }
}
