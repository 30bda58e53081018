//! One set of axes over time, drawn by hand: the drawing library's own axes choose poor labels on logarithmic
//! scales, and know no bands.

use super::*;

const MARGIN: u32 = 16;
const LEFT_LABELS: u32 = 66;
const LEGEND_HEIGHT: u32 = 28;
/// Room below the axes of a panel.
const GAP: u32 = 6;
/// The curves of few points have a dot at each.
const FEW_POINTS: usize = 30;
/// Colours of the phases' bands, from the beginning again when they end.
const BANDS: [RGBColor; 3] = [RGBColor(255, 255, 255), RGBColor(253, 242, 226), RGBColor(232, 243, 250)];
/// The same for the strip that names them.
const STRIPS: [RGBColor; 3] = [RGBColor(238, 238, 238), RGBColor(250, 222, 180), RGBColor(200, 226, 243)];

/// A stretch of time in which the plant does not change.
pub(super) struct FigurePhase {
    pub from: f64,
    pub until: f64,
    pub name: String,
}

/// How a curve is drawn.
#[derive(Clone, Copy, PartialEq)]
pub(super) enum CurveStyle {
    /// A line so many pixels wide.
    Line(f64),
    Dashes,
    /// A dot at each point.
    Dots,
}

/// A curve with its name in the legend. A value that is none breaks the line instead of bending it.
pub(super) struct NamedCurve {
    pub name: String,
    pub colour: RGBColor,
    pub style: CurveStyle,
    pub points: Polyline,
}

/// The scale of the y axis.
#[derive(Clone, Copy, PartialEq)]
pub(super) enum Scale {
    Linear,
    /// Linear all the same where a value is not above 0.
    Logarithmic,
}

/// One set of axes with its curves.
pub(super) struct Panel {
    /// Name of the y axis.
    pub name: String,
    pub scale: Scale,
    pub curves: Vec<NamedCurve>,
}

/// The place of the axes in an area, and what they show.
struct Axes {
    left: i32,
    right: i32,
    top: i32,
    bottom: i32,
    end: f64,
    low: f64,
    high: f64,
    scale: Scale,
}

impl Axes {
    fn x(&self, x: f64) -> i32 {
        self.left + (f64::from(self.right - self.left) * (x / self.end).clamp(0.0, 1.0)).round() as i32
    }

    fn y(&self, y: f64) -> i32 {
        let share = match self.scale {
            Scale::Linear => (y - self.low) / (self.high - self.low),
            Scale::Logarithmic => (y / self.low).ln() / (self.high / self.low).ln(),
        };
        self.bottom - (f64::from(self.bottom - self.top) * share.clamp(0.0, 1.0)).round() as i32
    }
}

/// Left and right end of all axes in an area of so many units.
fn sides(area: &Area) -> (i32, i32) {
    (px(MARGIN + LEFT_LABELS), area.dim_in_pixel().0 as i32 - px(MARGIN + 4))
}

/// Draws a panel over the times from 0 to `end`, with its legend above.
pub(super) fn draw(panel: &Panel, phases: &[FigurePhase], end: f64, area: &Area) -> Result<(), ReportError> {
    let values = || panel.curves.iter().flat_map(|c| &c.points).map(|p| p.1).filter(|&y| drawable(y));
    let (low, high, scale) = range(values, panel.scale);
    let (left, right) = sides(area);
    let bottom = area.dim_in_pixel().1 as i32 - px(GAP);
    let axes = Axes { left, right, top: px(LEGEND_HEIGHT), bottom, end, low, high, scale };
    for (i, phase) in phases.iter().enumerate().skip(1) {
        let corners = [(axes.x(phase.from), axes.top), (axes.x(phase.until), axes.bottom)];
        area.draw(&Rectangle::new(corners, band_colour(&BANDS, i).filled())).map_err(refused)?;
    }
    grid(panel, &axes, area)?;
    for phase in phases.iter().skip(1) {
        let x = axes.x(phase.from);
        let style = INK.mix(0.6).stroke_width(fine(1.1));
        let line = DashedPathElement::new([(x, axes.top), (x, axes.bottom)], fine(4.0), fine(3.0), style);
        area.draw(&line).map_err(refused)?;
    }
    for curve in &panel.curves {
        draw_curve(curve, &axes, area)?;
    }
    legend(&panel.curves, axes.left, area)
}

/// The y axis for some values: from, to, and on which scale.
fn range<I: Iterator<Item = f64>>(values: impl Fn() -> I, scale: Scale) -> (f64, f64, Scale) {
    let (least, most) = (values().fold(f64::INFINITY, f64::min), values().fold(f64::NEG_INFINITY, f64::max));
    if scale == Scale::Logarithmic && least > 1e-12 && most / least < 1e9 && most > 1.5 * least {
        return (0.8 * least, 1.2 * most, scale);
    }
    let (least, most) = (least.min(0.0), most.max(0.0));
    // Nothing, or a flat line at 0, still needs an axis.
    let span = if most > least { most - least } else { 1.0 };
    (if least < 0.0 { least - 0.06 * span } else { 0.0 }, least + 1.06 * span, Scale::Linear)
}

/// Lines across with their values, lines up at the times of [`time_axis`], the axes, and the name of the y axis.
fn grid(panel: &Panel, axes: &Axes, area: &Area) -> Result<(), ReportError> {
    let style = FAINT.stroke_width(fine(0.8));
    for time in even_steps(0.0, axes.end, 9) {
        let x = axes.x(time);
        area.draw(&PathElement::new([(x, axes.top), (x, axes.bottom)], style)).map_err(refused)?;
    }
    let lines = match axes.scale {
        Scale::Linear => even_steps(axes.low, axes.high, 6),
        Scale::Logarithmic => decade_steps(axes.low, axes.high),
    };
    for value in lines {
        let y = axes.y(value);
        area.draw(&PathElement::new([(axes.left, y), (axes.right, y)], style)).map_err(refused)?;
        let text = anchored(font(12.0, INK), HPos::Right, VPos::Center);
        area.draw(&Text::new(label(&value), (axes.left - px(7), y), text)).map_err(refused)?;
    }
    let frame = [(axes.left, axes.top), (axes.left, axes.bottom), (axes.right, axes.bottom)];
    area.draw(&PathElement::new(frame, GREY.stroke_width(fine(1.0)))).map_err(refused)?;
    let text = anchored(font(13.0, INK), HPos::Center, VPos::Top).transform(FontTransform::Rotate270);
    let middle = (px(12), (axes.top + axes.bottom) / 2);
    area.draw(&Text::new(panel.name.clone(), middle, text)).map_err(refused)
}

fn draw_curve(curve: &NamedCurve, axes: &Axes, area: &Area) -> Result<(), ReportError> {
    let at = |p: &(f64, f64)| (axes.x(p.0), axes.y(p.1));
    let drawn = |p: &(f64, f64)| drawable(p.1) && drawable(p.0);
    let few = curve.points.len() <= FEW_POINTS;
    for piece in curve.points.split(|p| !drawn(p)).filter(|piece| !piece.is_empty()) {
        let points: Vec<(i32, i32)> = piece.iter().map(at).collect();
        let dots = |radius: f64| {
            let dot = move |&p| Circle::new(p, fine(radius), curve.colour.filled());
            points.iter().try_for_each(|p| area.draw(&dot(p)).map_err(refused))
        };
        match curve.style {
            CurveStyle::Dots => dots(2.0)?,
            CurveStyle::Dashes => {
                let style = curve.colour.stroke_width(fine(1.3));
                area.draw(&DashedPathElement::new(points, fine(6.0), fine(4.0), style)).map_err(refused)?;
            }
            CurveStyle::Line(width) => {
                if few || points.len() == 1 {
                    dots(2.2)?;
                }
                area.draw(&PathElement::new(points, curve.colour.stroke_width(fine(width)))).map_err(refused)?;
            }
        }
    }
    Ok(())
}

/// The curves' names above the axes, each beside a piece of its line.
fn legend(curves: &[NamedCurve], left: i32, area: &Area) -> Result<(), ReportError> {
    let (mut x, y) = (left + px(4), px(LEGEND_HEIGHT) / 2);
    for curve in curves {
        let line = [(x, y), (x + px(24), y)];
        match curve.style {
            CurveStyle::Dots => {
                let dots = [4, 12, 20].map(|i| Circle::new((x + px(i), y), fine(2.0), curve.colour.filled()));
                dots.iter().try_for_each(|dot| area.draw(dot).map_err(refused))?;
            }
            CurveStyle::Dashes => {
                let style = curve.colour.stroke_width(fine(1.3));
                area.draw(&DashedPathElement::new(line, fine(6.0), fine(4.0), style)).map_err(refused)?;
            }
            CurveStyle::Line(width) => {
                area.draw(&PathElement::new(line, curve.colour.stroke_width(fine(width)))).map_err(refused)?;
            }
        }
        let text = anchored(font(12.0, INK), HPos::Left, VPos::Center);
        area.draw(&Text::new(curve.name.clone(), (x + px(30), y), text)).map_err(refused)?;
        // Letters are about half as wide as they are tall.
        x += px(30 + 24) + px(curve.name.chars().count() as u32 * 13 / 2);
    }
    Ok(())
}

/// Names of the phases above the panels, each in its band's colour.
pub(super) fn phase_names(phases: &[FigurePhase], end: f64, area: &Area) -> Result<(), ReportError> {
    let (left, right) = sides(area);
    let at = |time: f64| left + (f64::from(right - left) * (time / end).clamp(0.0, 1.0)).round() as i32;
    let bottom = area.dim_in_pixel().1 as i32;
    for (i, phase) in phases.iter().enumerate() {
        let (from, until) = (at(phase.from), at(phase.until));
        let corners = [(from, 0), (until, bottom)];
        area.draw(&Rectangle::new(corners, band_colour(&STRIPS, i).filled())).map_err(refused)?;
        // Letters are about half as wide as they are tall; a name that has no room in its band is written to
        // the left.
        let wide = px(phase.name.chars().count() as u32 * 13 / 2 + 10);
        let (x, anchor) = if wide <= until - from {
            ((from + until) / 2, HPos::Center)
        } else if from - left > wide {
            (from - px(5), HPos::Right)
        } else {
            (from + px(5), HPos::Left)
        };
        let text = anchored(font(12.0, INK), anchor, VPos::Center);
        area.draw(&Text::new(phase.name.clone(), (x, bottom / 2), text)).map_err(refused)?;
    }
    Ok(())
}

/// Values and name of the axis of time, below the last panel.
pub(super) fn time_axis(end: f64, name: &str, area: &Area) -> Result<(), ReportError> {
    let (left, right) = sides(area);
    for time in even_steps(0.0, end, 9) {
        let x = left + (f64::from(right - left) * time / end).round() as i32;
        let text = anchored(font(12.0, INK), HPos::Center, VPos::Top);
        area.draw(&Text::new(label(&time), (x, 0), text)).map_err(refused)?;
    }
    let text = anchored(font(13.0, INK), HPos::Center, VPos::Top);
    area.draw(&Text::new(name.to_owned(), ((left + right) / 2, px(18)), text)).map_err(refused)
}

fn band_colour(colours: &[RGBColor; 3], phase: usize) -> RGBColor {
    if phase == 0 { colours[0] } else { colours[1 + (phase - 1) % 2] }
}

/// About `count` round values between two.
fn even_steps(low: f64, high: f64, count: usize) -> Vec<f64> {
    let rough = (high - low) / count as f64;
    let power = 10_f64.powf(rough.log10().floor());
    let step = [1.0, 2.0, 5.0, 10.0].map(|digit| digit * power).into_iter().find(|&step| step >= rough);
    let Some(step) = step.filter(|step| step.is_normal()) else { return Vec::new() };
    let first = (low / step).ceil();
    (0..=2 * count).map(|i| (first + i as f64) * step).take_while(|&value| value <= high * (1.0 + 1e-12)).collect()
}

/// 1, 2 and 5 times the powers of ten between two values; over many decades the powers alone.
fn decade_steps(low: f64, high: f64) -> Vec<f64> {
    let digits: &[f64] = if high / low < 2e3 { &[1.0, 2.0, 5.0] } else { &[1.0] };
    let powers = low.log10().floor() as i32..=high.log10().ceil() as i32;
    let all = powers.flat_map(|power| digits.iter().map(move |digit| digit * 10_f64.powi(power)));
    all.filter(|value| (low..=high).contains(value)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn axes_have_round_values() {
        assert_eq!(even_steps(0.0, 180.0, 9), [0.0, 20.0, 40.0, 60.0, 80.0, 100.0, 120.0, 140.0, 160.0, 180.0]);
        assert_eq!(even_steps(-0.3, 1.0, 6).len(), 3);
        assert!(even_steps(0.0, f64::NAN, 9).is_empty() && even_steps(0.0, 0.0, 9).is_empty());
        assert_eq!(decade_steps(0.03, 3.0).len(), 6);
        assert_eq!(decade_steps(0.001, 100.0).len(), 6);
    }

    #[test]
    fn a_logarithmic_axis_needs_values_above_zero() {
        let scale = |values: &[f64]| range(|| values.iter().copied(), Scale::Logarithmic);
        assert!(scale(&[0.02, 2.0]).2 == Scale::Logarithmic);
        for values in [&[0.0, 1.0][..], &[-1.0, 1.0], &[], &[0.5, 0.5]] {
            let (low, high, scale) = scale(values);
            assert!(scale == Scale::Linear && low < high && low <= 0.0, "{values:?}");
        }
    }
}
