//! The left half: loss over time, and below it the errors, if there are any.

use super::*;
use crate::report::Window;

const MARGIN: u32 = 16;
const LEFT_LABELS: u32 = 62;
const BOTTOM_LABELS: u32 = 44;
const LEGEND_HEIGHT: u32 = 26;

/// A curve with its name in the legend.
struct NamedCurve {
    name: String,
    colour: RGBColor,
    /// Pixels.
    width: f64,
    points: Vec<(f64, f64)>,
}

pub(super) fn draw(history: &RunHistory, area: &Area) -> Result<(), ReportError> {
    let clock = TimeAxis::of(history);
    let curve = |name: &str, colour, width, value: &dyn Fn(&Window) -> Option<f64>| NamedCurve {
        name: name.to_owned(),
        colour,
        width,
        points: history.windows.iter().map(|w| (clock.middle(w), value(w).unwrap_or(f64::NAN))).collect(),
    };
    let losses = if history.windows.iter().any(|w| w.noise_share > 0.0) {
        vec![
            curve("loss", GREY, 1.4, &|w| Some(w.loss)),
            curve("without exploration noise", BLUE, 2.2, &|w| Some(w.loss_without_noise())),
        ]
    } else {
        vec![curve("loss", BLUE, 2.2, &|w| Some(w.loss))]
    };
    let mut errors = vec![
        curve("root mean square", SKY, 1.4, &Window::rms_error),
        curve("at the end of a target", VERMILION, 2.2, &|w| w.end_error),
    ];
    errors.retain(|curve| curve.points.iter().any(|p| drawable(p.1)));
    if errors.is_empty() {
        return panel(history, area, &clock, "loss per tick", &losses, Some(clock.label()));
    }
    let height = (HEIGHT - TITLE_HEIGHT) * 11 / 20;
    let (upper, lower) = area.split_vertically(px(height));
    panel(history, &upper, &clock, "loss per tick", &losses, None)?;
    panel(history, &lower, &clock, &with_unit("error", &history.unit), &errors, Some(clock.label()))
}

/// One set of axes with its legend above and the marks across; the time axis is only labelled if `time` names it.
fn panel(
    history: &RunHistory,
    area: &Area,
    clock: &TimeAxis,
    name: &str,
    curves: &[NamedCurve],
    time: Option<String>,
) -> Result<(), ReportError> {
    let (legend, rest) = area.split_vertically(px(LEGEND_HEIGHT));
    let values = || curves.iter().flat_map(|c| &c.points).map(|p| p.1).filter(|&y| drawable(y));
    let top = values().fold(0.0, f64::max);
    let bottom = values().fold(0.0, f64::min);
    // Nothing, or a flat line at 0, still needs an axis.
    let span = if top > bottom { top - bottom } else { 1.0 };
    let low = if bottom < 0.0 { bottom - 0.06 * span } else { 0.0 };
    let mut chart = ChartBuilder::on(&rest)
        .margin_left(px(MARGIN))
        .margin_right(px(MARGIN + 4))
        .margin_bottom(px(if time.is_some() { 6 } else { 2 }))
        .set_label_area_size(LabelAreaPosition::Left, px(LEFT_LABELS))
        .set_label_area_size(LabelAreaPosition::Bottom, px(if time.is_some() { BOTTOM_LABELS } else { 12 }))
        .build_cartesian_2d(0.0..clock.end, low..bottom + 1.06 * span)
        .map_err(refused)?;
    let bare = |_: &f64| String::new();
    let (label_x, time): (&dyn Fn(&f64) -> String, _) = match time {
        Some(time) => (&label, time),
        None => (&bare, String::new()),
    };
    mesh(&mut chart, 9, label_x, time, name)?;
    for (i, (tick, what)) in history.marks.iter().enumerate() {
        let x = clock.at(*tick);
        if !(0.0..=clock.end).contains(&x) {
            continue;
        }
        let line = DashedPathElement::new(
            [(x, low), (x, bottom + 1.06 * span)],
            fine(4.0),
            fine(3.0),
            INK.mix(0.6).stroke_width(fine(1.1)),
        );
        chart.draw_series([line]).map_err(refused)?;
        // Its name once, beside the loss, on the side that has room, and not on top of its neighbour's.
        if name.starts_with("loss") {
            let (h, shift) = if x > 0.5 * clock.end { (HPos::Right, -px(5)) } else { (HPos::Left, px(5)) };
            let text =
                Text::new(what.clone(), (shift, px(3 + 15 * (i as u32 % 4))), anchored(font(12.0, INK), h, VPos::Top));
            let here = EmptyElement::at((x, bottom + 1.06 * span)) + text;
            chart.draw_series([here]).map_err(refused)?;
        }
    }
    let mut x = px(MARGIN + LEFT_LABELS + 6);
    for curve in curves {
        let style = curve.colour.stroke_width(fine(curve.width));
        // A value that is none breaks the line instead of bending it.
        for piece in curve.points.split(|p| !drawable(p.1)).filter(|piece| !piece.is_empty()) {
            chart.draw_series(LineSeries::new(piece.iter().copied(), style)).map_err(refused)?;
            if history.windows.len() <= 40 || piece.len() == 1 {
                let dots = piece.iter().map(|&p| Circle::new(p, fine(2.2), curve.colour.filled()));
                chart.draw_series(dots).map_err(refused)?;
            }
        }
        let y = px(LEGEND_HEIGHT) * 3 / 5;
        legend.draw(&PathElement::new([(x, y), (x + px(22), y)], style)).map_err(refused)?;
        let text = anchored(font(12.0, INK), HPos::Left, VPos::Center);
        legend.draw(&Text::new(curve.name.clone(), (x + px(28), y), text)).map_err(refused)?;
        // Letters are about half as wide as they are tall.
        x += px(28 + 26) + px(curve.name.chars().count() as u32 * 13 / 2);
    }
    if history.windows.is_empty() {
        let text = anchored(font(13.0, GREY), HPos::Center, VPos::Center);
        let (width, height) = rest.dim_in_pixel();
        let middle = (width as i32 / 2, height as i32 / 2);
        rest.draw(&Text::new("no window was completed", middle, text)).map_err(refused)?;
    }
    Ok(())
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
        Self::new(ticks, history.period_s)
    }

    /// The axis of `ticks` ticks of `period_s` seconds.
    pub fn new(ticks: u64, period_s: f64) -> TimeAxis {
        let ticks = ticks.max(1) as f64;
        let seconds = ticks * period_s;
        // A story without a sensible period is told in ticks.
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
    use crate::report::tests::arm_history;

    #[test]
    fn time_is_told_in_what_people_count_in() {
        for (ticks, unit, end) in [(2_000, "s", 100.0), (40_000, "min", 33.333), (1_000_000, "h", 13.888)] {
            let mut history = arm_history();
            history.windows.truncate(1);
            history.windows[0].ticks = ticks;
            let axis = TimeAxis::of(&history);
            assert_eq!(axis.unit, unit);
            assert!((axis.end - end).abs() < 1e-2, "{}", axis.end);
            assert!((axis.middle(&history.windows[0]) - end / 2.0).abs() < 1e-2);
        }
    }
}
