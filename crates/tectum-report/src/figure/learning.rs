//! Learning curves: how the loss falls with experience, for several learners over several seeds, both axes
//! logarithmic.
//!
//! The first panel shows the learning from the beginning; below it stands one panel for what came after each
//! change. A line is the median over seeds, the band around it reaches from the best to the worst; a learner
//! has one colour in all panels. Dashed lines across are for scale.

use super::*;
use crate::stats::Spread;
use crate::text::thousands;

const WIDTH: u32 = 940;
const FIRST_HEIGHT: u32 = 400;
const LATER_HEIGHT: u32 = 270;
const LEGEND: u32 = 26;
const PANEL_TITLE: u32 = 24;
const LEFT: u32 = 62;
/// Width of a letter of a line's name.
const LETTER: u32 = 7;
const BOTTOM: u32 = 44;
/// Panels beside each other in a row below the first.
const IN_A_ROW: usize = 2;
/// The figure.
#[derive(Debug, Clone, PartialEq)]
pub struct LearningFigure {
    /// Title.
    pub title: String,
    /// Name of the axis of losses.
    pub y: &'static str,
    /// Losses above this are cut off: what a diverged learner does needs no room.
    pub highest: f64,
    /// The first is large; those after it stand below.
    pub panels: Vec<LearningPanel>,
}

/// One pair of axes.
#[derive(Debug, Clone, PartialEq)]
pub struct LearningPanel {
    /// Title.
    pub title: String,
    /// Name of the axis of ticks.
    pub x: String,
    /// One a learner.
    pub curves: Vec<LearnerCurve>,
    /// Dashed lines across.
    pub lines: Vec<ReferenceLine>,
}

/// A learner's curve.
#[derive(Debug, Clone, PartialEq)]
pub struct LearnerCurve {
    /// Name in the legend.
    pub name: String,
    /// Number of its colour; there are six, then ink, and grey for more.
    pub colour: usize,
    /// In the order of ticks.
    pub points: Vec<CurvePoint>,
}

/// What the seeds did at a tick.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CurvePoint {
    /// The tick.
    pub ticks: u64,
    /// Least loss.
    pub low: f64,
    /// The median.
    pub middle: f64,
    /// Largest.
    pub high: f64,
}

impl CurvePoint {
    /// What the seeds did at a tick; `None` without any.
    pub fn of(ticks: u64, losses: impl Iterator<Item = f64>) -> Option<Self> {
        let Spread { min, median, max } = Spread::of(losses)?;
        Some(Self { ticks, low: min, middle: median, high: max })
    }
}

/// A line across, with its name beside it.
#[derive(Debug, Clone, PartialEq)]
pub struct ReferenceLine {
    /// Name.
    pub name: String,
    /// Loss.
    pub value: f64,
}

/// Draws `learning` into a new file at `path`, in place of one that is there.
///
/// # Errors
///
/// [`ReportError`] if the file cannot be written.
pub fn draw(learning: &LearningFigure, path: &Path) -> Result<(), ReportError> {
    write(path, &svg(learning)?)
}

fn svg(learning: &LearningFigure) -> Result<String, ReportError> {
    let (first, later) = learning.panels.split_at(learning.panels.len().min(1));
    let rows: Vec<&[LearningPanel]> =
        if later.len() < IN_A_ROW { later.chunks(1).collect() } else { later.chunks(IN_A_ROW).collect() };
    let height = TITLE_HEIGHT + LEGEND + FIRST_HEIGHT + rows.len() as u32 * LATER_HEIGHT + 8;
    canvas((WIDTH, height), &learning.title, |_, rest| {
        let [first] = first else { return Ok(()) };
        let (strip, rest) = rest.split_vertically(px(LEGEND));
        legend(first, &strip)?;
        let (area, mut rest) = rest.split_vertically(px(FIRST_HEIGHT));
        let range = |panels| range(panels, learning.highest);
        panel(first, learning.y, range(std::slice::from_ref(first)), &area)?;
        for row in rows {
            let (area, below) = rest.split_vertically(px(LATER_HEIGHT));
            for (one, area) in row.iter().zip(area.split_evenly((1, row.len()))) {
                panel(one, learning.y, range(later), &area)?;
            }
            rest = below;
        }
        Ok(())
    })
}

/// The losses that these panels show, so that they can be compared.
fn range(panels: &[LearningPanel], highest: f64) -> (f64, f64) {
    let curves = panels.iter().flat_map(|p| &p.curves);
    let points = curves.flat_map(|c| &c.points).flat_map(|p| [p.low, p.middle, p.high]);
    let all = points.chain(panels.iter().flat_map(|p| &p.lines).map(|line| line.value));
    let (low, high) = all
        .filter(|&y| y.is_finite() && y > 0.0)
        .fold((f64::INFINITY, 0.0), |(low, high): (f64, f64), y| (low.min(y), high.max(y)));
    // Nothing to show still needs an axis.
    if high <= 0.0 { (0.01, 1.0) } else { (0.88 * low, (1.12 * high).min(highest).max(2.0 * low)) }
}

fn legend(panel: &LearningPanel, strip: &Area) -> Result<(), ReportError> {
    let mut x = px(LEFT);
    let y = px(LEGEND) / 2;
    for curve in &panel.curves {
        strip
            .draw(&Rectangle::new([(x, y - px(5)), (x + px(24), y + px(5))], colour(curve).mix(0.2).filled()))
            .map_err(refused)?;
        strip
            .draw(&PathElement::new([(x, y), (x + px(24), y)], colour(curve).stroke_width(fine(2.4))))
            .map_err(refused)?;
        let text = anchored(font(13.0, INK), HPos::Left, VPos::Center);
        strip.draw(&Text::new(curve.name.clone(), (x + px(30), y), text)).map_err(refused)?;
        x += px(30 + 24) + px(curve.name.chars().count() as u32 * 7);
    }
    Ok(())
}

fn colour(curve: &LearnerCurve) -> RGBColor {
    SERIES.iter().chain([&INK]).nth(curve.colour).copied().unwrap_or(GREY)
}

/// The axes of a panel in an area: logarithms along and up, labelled by hand, because the library's own
/// logarithmic labels leave out too much.
struct PanelAxes<'a> {
    chart: Chart<'a>,
    area: Area<'a>,
    /// First and last tick.
    ticks: (f64, f64),
    /// Least and largest loss.
    losses: (f64, f64),
    /// The plot's edges.
    left: i32,
    right: i32,
    top: i32,
    bottom: i32,
}

fn panel(panel: &LearningPanel, y: &str, losses: (f64, f64), area: &Area) -> Result<(), ReportError> {
    let (title, area) = area.split_vertically(px(PANEL_TITLE));
    let text = anchored(font(13.0, INK), HPos::Left, VPos::Center);
    title.draw(&Text::new(panel.title.clone(), (px(LEFT), px(PANEL_TITLE) / 2), text)).map_err(refused)?;
    let mut axes = PanelAxes::new(panel, losses, area)?;
    axes.draw_grid()?;
    axes.draw_frame(&panel.x, y)?;
    axes.draw_lines(&panel.lines)?;
    axes.draw_bands(&panel.curves)?;
    axes.draw_curves(&panel.curves)
}

/// What stands beside a line.
fn words(line: &ReferenceLine) -> String {
    format!("{} {}", line.name, label(&line.value))
}

impl<'a> PanelAxes<'a> {
    fn new(panel: &LearningPanel, (low, high): (f64, f64), area: Area<'a>) -> Result<Self, ReportError> {
        let ticks = || panel.curves.iter().flat_map(|c| &c.points).map(|p| p.ticks.max(1));
        let first = ticks().min().unwrap_or(1) as f64;
        let last = (ticks().max().unwrap_or(10) as f64).max(1.5 * first);
        let names = panel.lines.iter().map(|line| words(line).chars().count()).max().unwrap_or(0);
        let chart = ChartBuilder::on(&area)
            .margin_left(px(LEFT))
            .margin_right(px(18 + LETTER * names as u32))
            .margin_bottom(px(BOTTOM))
            .margin_top(px(4))
            .build_cartesian_2d(first.log10()..last.log10(), low.log10()..high.log10())
            .map_err(refused)?;
        let mut axes =
            Self { chart, area, ticks: (first, last), losses: (low, high), left: 0, right: 0, top: 0, bottom: 0 };
        (axes.left, axes.bottom) = axes.place(first.log10(), low.log10());
        (axes.right, axes.top) = axes.place(last.log10(), high.log10());
        Ok(axes)
    }

    /// Where logarithms of a tick and of a loss lie in the area.
    fn place(&self, x: f64, y: f64) -> (i32, i32) {
        let corner = self.area.get_pixel_range();
        let (right, down) = self.chart.plotting_area().map_coordinate(&(x, y));
        (right - corner.0.start, down - corner.1.start)
    }

    fn draw_grid(&self) -> Result<(), ReportError> {
        let (x, y) = (self.ticks.0.log10(), self.losses.0.log10());
        for (value, bold) in losses(self.losses.0, self.losses.1) {
            let at = self.place(x, value.log10()).1;
            let style = FAINT.mix(if bold { 1.0 } else { 0.55 }).stroke_width(fine(0.8));
            self.area.draw(&PathElement::new([(self.left, at), (self.right, at)], style)).map_err(refused)?;
            if bold {
                let text = anchored(font(12.0, INK), HPos::Right, VPos::Center);
                self.area.draw(&Text::new(label(&value), (self.left - px(7), at), text)).map_err(refused)?;
            }
        }
        let values =
            (0..=12).flat_map(|power| (1..=9).map(move |digit| (f64::from(digit) * 10_f64.powi(power), digit)));
        for (value, digit) in values.filter(|(value, _)| (self.ticks.0..=self.ticks.1).contains(value)) {
            let at = self.place(value.log10(), y).0;
            let bold = digit == 1;
            let style = FAINT.mix(if bold { 1.0 } else { 0.55 }).stroke_width(fine(0.8));
            self.area.draw(&PathElement::new([(at, self.top), (at, self.bottom)], style)).map_err(refused)?;
            if bold {
                let text = anchored(font(12.0, INK), HPos::Center, VPos::Top);
                let number = Text::new(thousands(value as u64), (at, self.bottom + px(7)), text);
                self.area.draw(&number).map_err(refused)?;
            }
        }
        Ok(())
    }

    /// The axes' lines and names.
    fn draw_frame(&self, x: &str, y: &str) -> Result<(), ReportError> {
        let Self { left, right, top, bottom, .. } = *self;
        let frame = GREY.stroke_width(fine(1.0));
        self.area.draw(&PathElement::new([(left, top), (left, bottom), (right, bottom)], frame)).map_err(refused)?;
        let text = anchored(font(13.0, INK), HPos::Center, VPos::Top);
        self.area.draw(&Text::new(x.to_owned(), ((left + right) / 2, bottom + px(24)), text)).map_err(refused)?;
        let text = anchored(font(13.0, INK), HPos::Center, VPos::Top).transform(FontTransform::Rotate270);
        self.area.draw(&Text::new(y.to_owned(), (px(10), (top + bottom) / 2), text)).map_err(refused)
    }

    /// Reference lines with their names beside them, as near as those can stand without standing on each
    /// other; the uppermost first.
    fn draw_lines(&self, lines: &[ReferenceLine]) -> Result<(), ReportError> {
        let (low, high) = self.losses;
        let x = self.ticks.1.log10();
        let mut lines: Vec<&ReferenceLine> = lines.iter().filter(|l| (low..=high).contains(&l.value)).collect();
        lines.sort_by(|a, b| b.value.total_cmp(&a.value));
        let mut names: Vec<i32> = lines.iter().map(|line| self.place(x, line.value.log10()).1).collect();
        for i in (0..names.len().saturating_sub(1)).rev() {
            names[i] = names[i].min(names[i + 1] - px(15));
        }
        for (line, name) in lines.iter().zip(names) {
            let at = self.place(x, line.value.log10()).1;
            let ends = [(self.left, at), (self.right, at)];
            let style = INK.mix(0.75).stroke_width(fine(1.0));
            self.area.draw(&DashedPathElement::new(ends, fine(5.0), fine(4.0), style)).map_err(refused)?;
            let text = anchored(font(12.0, INK), HPos::Left, VPos::Center);
            self.area.draw(&Text::new(words(line), (self.right + px(7), name), text)).map_err(refused)?;
        }
        Ok(())
    }

    /// A point of the plot; losses beyond the axis lie on its end.
    fn at(&self, p: &CurvePoint, loss: f64) -> (f64, f64) {
        ((p.ticks.max(1) as f64).log10(), loss.clamp(self.losses.0, self.losses.1).log10())
    }

    fn draw_bands(&mut self, curves: &[LearnerCurve]) -> Result<(), ReportError> {
        for curve in curves {
            let points: Vec<&CurvePoint> = curve.points.iter().filter(shown).collect();
            // A worst that is no number reaches beyond the top.
            let high_of = |p: &CurvePoint| if p.high.is_finite() { p.high } else { f64::MAX };
            let lower = points.iter().map(|p| self.at(p, p.low));
            let upper = points.iter().rev().map(|p| self.at(p, high_of(p)));
            let band: Vec<_> = lower.chain(upper).collect();
            if points.len() > 1 {
                self.chart.draw_series([Polygon::new(band, colour(curve).mix(0.2))]).map_err(refused)?;
            }
        }
        Ok(())
    }

    fn draw_curves(&mut self, curves: &[LearnerCurve]) -> Result<(), ReportError> {
        for curve in curves {
            let points: Polyline = curve.points.iter().filter(shown).map(|p| self.at(p, p.middle)).collect();
            self.chart.draw_series(LineSeries::new(points, colour(curve).stroke_width(fine(1.8)))).map_err(refused)?;
        }
        Ok(())
    }
}

/// Whether a point has a place on the axes.
fn shown(p: &&CurvePoint) -> bool {
    p.middle.is_finite() && p.low.is_finite()
}

/// Grid lines of the losses, and whether they have a label.
fn losses(low: f64, high: f64) -> Vec<(f64, bool)> {
    let mut lines = Vec::new();
    for power in -6..=1 {
        for digit in 1..=9 {
            let value = f64::from(digit) * 10_f64.powi(power);
            if (low..=high).contains(&value) {
                lines.push((value, matches!(digit, 1 | 2 | 5)));
            }
        }
    }
    lines
}

#[cfg(test)]
mod tests {
    use super::*;

    fn learning() -> LearningFigure {
        let point = |k: u64| {
            let middle = 0.02 + 0.5 / (1.0 + k as f64 / 200.0);
            CurvePoint { ticks: k, low: 0.9 * middle, middle, high: 1.2 * middle }
        };
        let curve = |name: &str, colour, slow: u64| LearnerCurve {
            name: name.into(),
            colour,
            points: (1..100).map(|k| CurvePoint { ticks: slow * 20 * k, ..point(20 * k) }).collect(),
        };
        let line = |name: &str, value| ReferenceLine { name: name.into(), value };
        let panel = |title: &str| LearningPanel {
            title: title.into(),
            x: "ticks".into(),
            curves: vec![curve("slow", 0, 1000), curve("quick", 4, 1)],
            lines: vec![line("level", 0.0375), line("trajectory optimum", 0.0193)],
        };
        LearningFigure {
            title: "Learning".into(),
            y: "loss a tick",
            highest: 2.0,
            panels: vec![panel("from the beginning"), panel("after the change")],
        }
    }

    #[test]
    fn the_figure_names_what_it_shows() {
        let svg = svg(&learning()).unwrap();
        assert!(svg.starts_with("<svg width=\"940\" height=\"748\" viewBox=\"0 0 3760 2992\""), "{}", &svg[..80]);
        for words in
            ["slow", "quick", "level 0.0375", "trajectory optimum 0.0193", "1,000,000", "after the change", "0.05"]
        {
            assert!(svg.contains(words), "{words}");
        }
        assert!(!svg.contains("NaN") && !svg.contains("inf"));
    }

    #[test]
    fn equal_curves_give_equal_bytes_and_different_ones_do_not() {
        let one = svg(&learning()).unwrap();
        assert_eq!(one, svg(&learning()).unwrap());
        let mut other = learning();
        other.panels[0].curves[1].points[50].middle *= 1.2;
        assert_ne!(one, svg(&other).unwrap());
    }

    #[test]
    fn losses_are_shown_up_to_the_highest_that_was_asked_for() {
        let panels = learning().panels;
        let (_, high) = range(&panels, 0.3);
        assert_eq!(high, 0.3);
        let (_, high) = range(&panels, 100.0);
        assert!((0.5..0.7).contains(&high), "{high}");
    }

    #[test]
    fn what_has_no_place_on_the_axes_is_left_out() {
        let mut odd = learning();
        let points = &mut odd.panels[0].curves[0].points;
        (points[3].middle, points[7].high, points[9].low) = (f64::NAN, f64::INFINITY, -1.0);
        points[11].high = 1e30;
        let svg = svg(&odd).unwrap();
        assert!(!svg.contains("NaN") && !svg.contains("inf"));
        let none = LearningFigure {
            title: "Nothing".into(),
            panels: vec![LearningPanel { curves: vec![], lines: vec![], ..odd.panels[0].clone() }],
            ..learning()
        };
        assert!(super::svg(&none).unwrap().contains("Nothing"));
        assert!(super::svg(&LearningFigure { panels: vec![], ..learning() }).is_ok());
    }
}
