//! What a sweep over settings found: one row for each combination, a dot for each seed, a bar at their median.
//!
//! Up to six combinations have a colour each, and below the rows stand loss and error over time in these colours: a
//! line is the median over seeds, the band around it reaches from the least to the largest.

use super::bands::{Axes, Band};
use super::curves::{TimeAxis, by_target};
use super::*;
use crate::stats::{Spread, Window};

const WIDTH: u32 = 860;
const ROW: u32 = 26;
const RIGHT: u32 = 24;
const BOTTOM: u32 = 46;
/// Width of a letter.
const LETTER: u32 = 7;
/// The names of the combinations take at most this part of the width.
const MOST_NAMES: u32 = 460;

/// Height of the panels over time, and of the gap above them.
const PANEL: u32 = 300;
const GAP: u32 = 22;

/// What the figure shows.
#[derive(Debug, Clone, PartialEq)]
pub struct SweepFigure {
    /// Title.
    pub title: String,
    /// Unit of errors, may be empty.
    pub unit: String,
    /// Period of a tick, s; 0 draws over ticks.
    pub period_s: f64,
    /// From top to bottom.
    pub rows: Vec<SweepFigureRow>,
}

/// One combination of settings.
#[derive(Debug, Clone, PartialEq)]
pub struct SweepFigureRow {
    /// The settings.
    pub name: String,
    /// Loss a tick over the last twentieth, one for each seed. What is not a number is left out.
    pub values: Vec<f64>,
    /// The windows of each seed's run.
    pub runs: Vec<Vec<Window>>,
}

/// Draws `figure` into a new file at `path`, in place of one that is there.
///
/// # Errors
///
/// [`ReportError`] if the file cannot be written.
pub fn draw_sweep(figure: &SweepFigure, path: &Path) -> Result<(), ReportError> {
    let rows_height = ROW * figure.rows.len() as u32 + BOTTOM;
    let panels = if figure.rows.len() <= SERIES.len() { panels(figure) } else { Vec::new() };
    let height = TITLE_HEIGHT + rows_height + if panels.is_empty() { 0 } else { GAP + PANEL };
    let svg = canvas((WIDTH, height), &figure.title, |_, rest| {
        let (upper, lower) = rest.split_vertically(px(rows_height));
        rows(&figure.rows, !panels.is_empty(), &upper)?;
        let (_, lower) = lower.split_vertically(px(if panels.is_empty() { 0 } else { GAP }));
        for ((bands, axes), area) in panels.iter().zip(lower.split_evenly((1, panels.len().max(1)))) {
            bands::draw_axes(bands, axes, &area)?;
        }
        Ok(())
    })?;
    write(path, &svg)
}

/// The rows with their dots; each in its own colour if panels below have them.
fn rows(rows: &[SweepFigureRow], coloured: bool, area: &Area) -> Result<(), ReportError> {
    let longest = rows.iter().map(|row| row.name.chars().count()).max().unwrap_or(0) as u32;
    let names = (30 + LETTER * longest).min(MOST_NAMES);
    let all = Spread::of(rows.iter().flat_map(|row| &row.values).copied().filter(|&x| drawable(x)));
    let (low, high) = all.map_or((0.0, 1.0), |all| (all.min, all.max));
    let margin = if high > low { 0.04 * (high - low) } else { low.abs().max(1.0) * 0.1 };
    let mut chart = ChartBuilder::on(area)
        .margin_left(px(names))
        .margin_right(px(RIGHT))
        .x_label_area_size(px(BOTTOM))
        .build_cartesian_2d(low - margin..high + margin, rows.len() as f64..0.0)
        .map_err(refused)?;
    chart
        .configure_mesh()
        .disable_y_mesh()
        .disable_y_axis()
        .light_line_style(WHITE)
        .bold_line_style(FAINT.stroke_width(fine(0.8)))
        .axis_style(GREY.stroke_width(fine(1.0)))
        .label_style(font(12.0, INK))
        .axis_desc_style(font(13.0, INK))
        .x_labels(6)
        .x_label_formatter(&label)
        .x_desc("loss a tick over the last twentieth of the run")
        .draw()
        .map_err(refused)?;
    for (i, row) in rows.iter().enumerate() {
        let (dot, bar) = if coloured { (SERIES[i], SERIES[i]) } else { (SKY, VERMILION) };
        let (y, middle) = (i as f64 + 0.5, px(ROW * i as u32 + ROW / 2));
        let text = anchored(font(12.0, INK), HPos::Right, VPos::Center);
        area.draw(&Text::new(row.name.clone(), (px(names - 10), middle), text)).map_err(refused)?;
        let values = || row.values.iter().copied().filter(|&x| drawable(x));
        let dots = values().map(|x| Circle::new((x, y), px(3), dot.mix(0.6).filled()));
        chart.draw_series(dots).map_err(refused)?;
        if let Some(spread) = Spread::of(values()) {
            let line = vec![(spread.median, y - 0.35), (spread.median, y + 0.35)];
            let line = PathElement::new(line, bar.stroke_width(fine(2.4)));
            chart.draw_series(std::iter::once(line)).map_err(refused)?;
        }
    }
    Ok(())
}

/// Loss and error over time; a panel without values is left out.
fn panels(figure: &SweepFigure) -> Vec<(Vec<Band>, Axes<'static>)> {
    let windows = || figure.rows.iter().flat_map(|row| &row.runs).flatten();
    let ticks = windows().map(|w| w.from.saturating_add(w.ticks)).max().unwrap_or(0);
    let clock = TimeAxis::new(ticks, figure.period_s);
    let panel = |y: String, value: &dyn Fn(&Window) -> f64| {
        let curve = |run: &Vec<Window>| by_target(run).iter().map(|w| (clock.middle(w), value(w))).collect();
        let band = |(row, colour): (&SweepFigureRow, RGBColor)| {
            Band::of(&row.name, colour, &row.runs.iter().map(curve).collect::<Vec<Polyline>>())
        };
        let bands: Vec<Band> = figure.rows.iter().zip(SERIES).map(band).collect();
        let any = bands.iter().any(|band| band.points.iter().filter(|p| drawable(p.1[1])).count() > 1);
        let axes = Axes { end: clock.end, x: Some(clock.label()), top: 0.0, y, mark: None, levels: &[] };
        any.then_some((bands, axes))
    };
    let loss = panel("loss a tick".to_owned(), &|w| w.loss);
    let error = panel(with_unit("error at a target's end", &figure.unit), &|w| w.end_error.unwrap_or(f64::NAN));
    loss.into_iter().chain(error).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(name: &str, values: &[f64], runs: Vec<Vec<Window>>) -> SweepFigureRow {
        SweepFigureRow { name: name.to_owned(), values: values.to_vec(), runs }
    }

    fn drawn(rows: Vec<SweepFigureRow>) -> String {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("figure.svg");
        let figure = SweepFigure { title: "sweep".into(), unit: "m".into(), period_s: 0.05, rows };
        draw_sweep(&figure, &path).unwrap();
        std::fs::read_to_string(path).unwrap()
    }

    #[test]
    fn every_combination_has_its_name_and_its_seeds() {
        let none = Vec::new;
        let values: [&[f64]; 3] = [&[-1.0, -2.0, -1.5], &[f64::NAN, 4.0], &[f64::INFINITY, 1e300]];
        let names = ["a=1", "a=3", "a=10"];
        let svg = drawn(names.iter().zip(values).map(|(name, values)| row(name, values, none())).collect());
        assert!(["a=1", "a=3", "a=10", "loss"].iter().all(|text| svg.contains(text)), "{svg}");
        assert_eq!(svg.matches("<circle").count(), 4);
        assert!(!svg.contains("time ("));
        drawn(vec![row("a", &[], none())]);
    }

    #[test]
    fn few_combinations_have_curves_over_time_in_their_colours() {
        let run = |loss: f64, ends| -> Vec<Window> {
            let window =
                |i: u64| Window { from: 40 * i, ticks: 40, loss, end_error: Some(0.1), ends, ..Window::default() };
            (0..6).map(window).collect()
        };
        let two = |runs: u64| vec![run(0.5, runs), run(0.4, runs)];
        let svg = drawn(vec![row("a=1", &[0.5, 0.4], two(1)), row("a=3", &[0.5, 0.4], two(1))]);
        assert!(
            svg.contains("time (s)")
                && svg.lines().any(|line| line == "loss a tick")
                && svg.contains("target&apos;s end (m)")
        );
        assert!(svg.contains("#D55E00") && svg.contains("#E69F00") && svg.matches("<polygon").count() == 4, "{svg}");
        let many: Vec<_> = (0..7).map(|i| row(&format!("a={i}"), &[0.5], two(1))).collect();
        let many = drawn(many);
        assert!(!many.contains("time (s)") && !many.contains("<polygon"));
        // Without an error that the plant measures there is one panel.
        let mut bare = run(0.5, 0);
        bare.iter_mut().for_each(|w| w.end_error = None);
        let svg = drawn(vec![row("a=1", &[0.5], vec![bare])]);
        assert!(svg.contains("time (s)") && !svg.contains("end (m)"));
    }
}
