//! One SVG of a run: how error and loss fell, and how the arm moved at the beginning and late in the run.
//!
//! The drawing library only knows whole pixels, too coarse for postures a hundred pixels tall; so everything
//! is drawn on a canvas four times as fine, and the file says how large it is meant. Text stays text, in
//! whatever sans-serif font the viewer has. Colours are those of Okabe and Ito, which colour-blind readers
//! can tell apart; lines differ in weight too.

mod bands;
mod curves;
mod errors;
pub mod learning;
mod loss;
mod movements;
mod panel;
mod postures;
mod scales;
mod seed_postures;
mod sweep;

pub use errors::{ErrorFigure, ErrorPanel, draw_miss};
pub use loss::{LossFigure, draw_loss};
pub use movements::{MovementDots, MovementsFigure, SpeedProfile, draw as draw_movements};
pub use scales::{AxisScales, draw_scales};
pub use seed_postures::{PosturesFigure, PosturesRow, SeedPostures, draw_ways};
pub use sweep::{SweepFigure, SweepFigureRow, draw_sweep};

use super::{OptimumSpan, ReportError, RunHistory};
use plotters::coord::Shift;
use plotters::coord::types::RangedCoordf64;
use plotters::element::DashedPathElement;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};
use std::path::Path;

/// Canvas units to a pixel.
const FINE: u32 = 4;
/// Size of the figure, pixels; without postures it is as wide as its curves.
const HEIGHT: u32 = 640;
const CURVES_WIDTH: u32 = 700;
const POSTURES_WIDTH: u32 = 310;
const TITLE_HEIGHT: u32 = 44;

const BLUE: RGBColor = RGBColor(0, 114, 178);
const SKY: RGBColor = RGBColor(86, 180, 233);
const VERMILION: RGBColor = RGBColor(213, 94, 0);
const GREY: RGBColor = RGBColor(140, 140, 140);
const INK: RGBColor = RGBColor(40, 40, 40);
const FAINT: RGBColor = RGBColor(228, 228, 228);
const GREEN: RGBColor = RGBColor(0, 158, 115);
const ORANGE: RGBColor = RGBColor(230, 159, 0);
const PURPLE: RGBColor = RGBColor(204, 121, 167);
/// Of things that are compared in one figure, in their order.
const SERIES: [RGBColor; 6] = [VERMILION, ORANGE, SKY, GREEN, BLUE, PURPLE];

/// Points of a curve, x and y.
pub type Polyline = Vec<(f64, f64)>;

type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;
/// A chart with two axes of numbers.
type Chart<'a> = ChartContext<'a, SVGBackend<'a>, Cartesian2d<RangedCoordf64, RangedCoordf64>>;

/// Draws `history` into a new file at `path`, in place of one that is there.
///
/// # Errors
///
/// [`ReportError`] if the file cannot be written.
pub fn draw(history: &RunHistory, path: &Path) -> Result<(), ReportError> {
    write(path, &svg(history)?)
}

fn write(path: &Path, svg: &str) -> Result<(), ReportError> {
    std::fs::write(path, svg).map_err(|error| ReportError::Write { path: path.to_owned(), error })
}

/// The figure's text.
fn svg(history: &RunHistory) -> Result<String, ReportError> {
    let reaches: Vec<_> = [("first reach", &history.first_reach), ("typical late reach", &history.last_reach)]
        .into_iter()
        .filter_map(|(name, reach)| Some((name, reach.as_ref()?)))
        .filter(|(_, reach)| reach.postures.iter().any(|line| line.iter().flatten().all(|&x| drawable(x))))
        .collect();
    let width = CURVES_WIDTH + if reaches.is_empty() { 0 } else { POSTURES_WIDTH };
    canvas((width, HEIGHT), &history.title, |title, rest| {
        let (left, right) = rest.split_horizontally(px(CURVES_WIDTH));
        curves::draw(history, &left)?;
        if !reaches.is_empty() {
            postures::legend(title, px(CURVES_WIDTH))?;
            postures::draw(history, &reaches, &right)?;
        }
        Ok(())
    })
}

/// A sheet of so many pixels with a title; `draw` gets the title's strip and the rest.
fn canvas(
    (width, height): (u32, u32),
    title: &str,
    draw: impl FnOnce(&Area, &Area) -> Result<(), ReportError>,
) -> Result<String, ReportError> {
    let mut svg = String::new();
    {
        let root = SVGBackend::with_string(&mut svg, (width * FINE, height * FINE)).into_drawing_area();
        root.fill(&WHITE).map_err(refused)?;
        let (strip, rest) = root.split_vertically(px(TITLE_HEIGHT));
        strip.draw(&Text::new(title.to_owned(), (px(16), px(14)), font(16.0, INK))).map_err(refused)?;
        draw(&strip, &rest)?;
        root.present().map_err(refused)?;
    }
    // The canvas keeps its fine coordinates as the view box, and is shown at its true size.
    let fine = format!("<svg width=\"{}\" height=\"{}\" ", width * FINE, height * FINE);
    Ok(svg.replacen(&fine, &format!("<svg width=\"{width}\" height=\"{height}\" "), 1))
}

/// Draws grid, axes and labels of a chart of curves: about so many labels along x, written by `label_x`.
fn mesh(
    chart: &mut Chart,
    labels: usize,
    label_x: &dyn Fn(&f64) -> String,
    x: impl Into<String>,
    y: impl Into<String>,
) -> Result<(), ReportError> {
    chart
        .configure_mesh()
        .light_line_style(WHITE)
        .bold_line_style(FAINT.stroke_width(fine(0.8)))
        .axis_style(GREY.stroke_width(fine(1.0)))
        .label_style(font(12.0, INK))
        .axis_desc_style(font(13.0, INK))
        .x_labels(labels)
        .y_labels(6)
        .set_all_tick_mark_size(px(4))
        .x_label_formatter(&label_x)
        .y_label_formatter(&label)
        .x_desc(x)
        .y_desc(y)
        .draw()
        .map_err(refused)
}

fn px(pixels: u32) -> i32 {
    (pixels * FINE) as i32
}

/// A line's width or a dot's radius in pixels.
fn fine(pixels: f64) -> u32 {
    (pixels * f64::from(FINE)).round() as u32
}

/// A font of so many pixels. The SVG backend divides the size that it is given by 1.24.
fn font(pixels: f64, colour: RGBColor) -> TextStyle<'static> {
    ("sans-serif", pixels * 1.24 * f64::from(FINE)).into_font().color(&colour)
}

fn anchored(style: TextStyle<'static>, h: HPos, v: VPos) -> TextStyle<'static> {
    style.pos(Pos::new(h, v))
}

fn refused<E: std::error::Error + Send + Sync>(error: DrawingAreaErrorKind<E>) -> ReportError {
    ReportError::Draw(error.to_string())
}

/// A number that an axis can reach: what a diverged run leaves may be finite, and the end of the axis beyond
/// it no longer. The drawing library would look for its labels for ever.
fn drawable(x: f64) -> bool {
    x.abs() < 1e30
}

/// An axis label without needless digits: 0.1, 0.25, 3, 1e-5.
fn label(x: &f64) -> String {
    if x.abs() >= 1e6 {
        return format!("{x:e}");
    }
    let rounded = format!("{x:.4}");
    let short = rounded.trim_end_matches('0').trim_end_matches('.');
    match short {
        "-0" => "0".into(),
        "0" if x.abs() > 1e-12 => format!("{x:e}"),
        _ => short.to_owned(),
    }
}

/// `name (unit)`, or the name alone.
fn with_unit(name: &str, unit: &str) -> String {
    if unit.is_empty() { name.to_owned() } else { format!("{name} ({unit})") }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::TestPoint;
    use crate::tests::arm_history;

    #[test]
    fn equal_histories_give_equal_bytes_and_different_ones_do_not() {
        let one = svg(&arm_history()).unwrap();
        assert_eq!(one, svg(&arm_history()).unwrap());
        let mut other = arm_history();
        other.windows[60].loss *= 1.1;
        assert_ne!(one, svg(&other).unwrap());
    }

    #[test]
    fn the_noises_share_is_taken_out_of_one_curve() {
        let with = |noise_share| {
            let mut history = arm_history();
            history.windows.iter_mut().for_each(|w| w.noise_share = noise_share);
            let svg = svg(&history).unwrap();
            let curve = |stroke: &str| {
                let lines = svg.lines().filter(|l| l.contains("<polyline") && l.contains(stroke));
                lines.max_by_key(|l| l.len()).unwrap().to_owned()
            };
            (curve("#8C8C8C"), curve("#0072B2"))
        };
        let (few, many) = (with(0.01), with(0.03));
        assert_eq!(few.0, many.0);
        assert_ne!(few.1, many.1);
    }

    #[test]
    fn the_figure_names_what_it_shows() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("figure.svg");
        draw(&arm_history(), &path).unwrap();
        let svg = std::fs::read_to_string(&path).unwrap();
        assert!(svg.starts_with("<svg width=\"1010\" height=\"640\" viewBox=\"0 0 4040 2560\""), "{}", &svg[..80]);
        for words in [
            "the paper&apos;s rule",
            "loss per tick",
            "without exploration noise",
            "error at a target&apos;s end (m)",
            "test without noise",
            "optimum",
            "time (days)",
            "before",
            "joint 3 blocked",
            "first reach",
            "typical late reach",
            "from light to dark",
            "x (m)",
        ] {
            assert!(svg.contains(words), "{words}");
        }
    }

    #[test]
    fn parts_that_are_missing_are_left_out() {
        let history = arm_history();
        let bare = svg(&RunHistory { first_reach: None, last_reach: None, ..history.clone() }).unwrap();
        assert!(bare.starts_with("<svg width=\"700\"") && !bare.contains("reach"));
        let half = svg(&RunHistory { first_reach: None, ..history.clone() }).unwrap();
        assert!(half.contains("late reach") && !half.contains("first reach"));
        let untested = svg(&RunHistory { tests: Vec::new(), optimum: Vec::new(), ..history.clone() }).unwrap();
        assert!(untested.contains("error (m)") && untested.contains("at the end of a target"));
        assert!(!untested.contains("optimum") && !untested.contains("test without noise"));
        let mut blind = history.clone();
        (blind.tests, blind.optimum) = (Vec::new(), Vec::new());
        for w in &mut blind.windows {
            (w.mean_squared_error, w.end_error) = (None, None);
        }
        let blind = svg(&blind).unwrap();
        assert!(blind.contains("loss per tick") && !blind.contains("error (m)"));
        let mut silent = history.clone();
        silent.windows.iter_mut().for_each(|w| w.noise_share = 0.0);
        let silent = svg(&silent).unwrap();
        assert!(!silent.contains("without exploration noise"));
        assert!(svg(&RunHistory { windows: Vec::new(), ..history }).unwrap().contains("no window was completed"));
    }

    #[test]
    fn a_run_that_diverged_is_drawn_as_far_as_it_went() {
        let mut history = arm_history();
        for w in &mut history.windows[50..] {
            (w.loss, w.mean_squared_error, w.end_error) = (f64::NAN, Some(f64::INFINITY), Some(f64::NAN));
        }
        history.tests.iter_mut().skip(20).for_each(|test| test.error = f64::NAN);
        history.last_reach.as_mut().unwrap().postures[5][3] = [f64::NAN, 0.0];
        history.first_reach.as_mut().unwrap().postures.clear();
        let svg = svg(&history).unwrap();
        assert!(svg.contains("late reach") && !svg.contains("first reach"));
        for period_s in [f64::NAN, 0.0, 1e-300, 1e300] {
            super::svg(&RunHistory { period_s, ..history.clone() }).unwrap();
        }
    }

    #[test]
    fn extreme_numbers_are_drawn_in_finite_time() {
        for (loss, place) in [(f64::MAX, f64::MAX), (1e25, 1e25), (1e-300, 1e-300), (-1e20, 3.0), (0.0, 0.0)] {
            let mut history = arm_history();
            history.windows[3].loss = loss;
            history.windows.truncate(4);
            history.windows.drain(..3);
            history.windows[0].from = u64::MAX - 1;
            history.tests = vec![TestPoint { tick: 0, error: place }, TestPoint { tick: u64::MAX, error: loss }];
            let mut reach = history.last_reach.clone().unwrap();
            reach.target = [place; 2];
            reach.postures = vec![vec![[place, place * (1.0 + 1e-15)]; 3]; 2];
            (history.first_reach, history.last_reach) = (None, Some(reach));
            svg(&history).unwrap();
        }
    }

    #[test]
    fn a_place_that_cannot_be_written_is_named() {
        let error = draw(&arm_history(), Path::new("/no/such/figure.svg")).unwrap_err().to_string();
        assert!(error.contains("/no/such/figure.svg") && error.contains("--out"), "{error}");
    }

    #[test]
    fn labels_have_no_needless_digits() {
        let all = [0.0, -0.0, 0.1, 0.30000000000000004, 12.0, 0.25, 0.00001, 2e7].map(|x| label(&x));
        assert_eq!(all, ["0", "0", "0.1", "0.3", "12", "0.25", "1e-5", "2e7"]);
    }
}
