//! One SVG of a run's movements: duration and peak speed against distance, speed profiles beside the
//! minimum-jerk bell, and how soon the arm settled; the first movements beside the last.

use super::*;
use crate::text::thousands;

const WIDTH: u32 = 1010;
const LEGEND_HEIGHT: u32 = 26;
const MARGIN: u32 = 16;
const LEFT_LABELS: u32 = 52;
const BOTTOM_LABELS: u32 = 42;
const BETWEEN: RGBColor = RGBColor(190, 190, 190);
const EARLY: RGBColor = VERMILION;
const LATE: RGBColor = BLUE;
/// Most dots that a group has in a scatter; of more, every n-th is drawn.
const DOTS: usize = 300;
/// Most bars that a histogram has.
const BARS: f64 = 16.0;

/// What is drawn of some movements.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct MovementDots {
    /// Distance (m) and duration (s) of each reach.
    pub duration: Vec<(f64, f64)>,
    /// Distance (m) and peak speed (m/s).
    pub peak_speed: Vec<(f64, f64)>,
    /// When each settled, s; `None` for those that did not.
    pub settled: Vec<Option<f64>>,
    /// Quartiles of speed over mean speed at equally spaced instants of the reach.
    pub profile: Vec<[f64; 3]>,
}

/// The speed profile to compare with: speed over mean speed at equally spaced instants.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct SpeedProfile {
    /// The minimum-jerk movement's.
    pub profile: Vec<f64>,
}

/// A run's movements as they are drawn.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct MovementsFigure {
    /// Title of the figure.
    pub title: String,
    /// The run's first movements.
    pub early: MovementDots,
    /// Those between; their profile is not drawn.
    pub middle: MovementDots,
    /// The run's last movements.
    pub late: MovementDots,
    /// Value at 0 and slope of the line through all durations, and of that through the last.
    pub duration_lines: [Option<(f64, f64)>; 2],
    /// The same of the peak speeds.
    pub peak_speed_lines: [Option<(f64, f64)>; 2],
    /// The bell.
    pub wake: SpeedProfile,
    /// Within how much of the target a movement has settled, m.
    pub near_m: f64,
}

/// Draws `movements` into a new file at `path`, in place of one that is there.
///
/// # Errors
///
/// [`ReportError`] if the file cannot be written.
pub fn draw(movements: &MovementsFigure, path: &Path) -> Result<(), ReportError> {
    let svg = svg(movements)?;
    std::fs::write(path, svg).map_err(|error| ReportError::Write { path: path.to_owned(), error })
}

fn svg(movements: &MovementsFigure) -> Result<String, ReportError> {
    let mut svg = String::new();
    {
        let root = SVGBackend::with_string(&mut svg, (WIDTH * FINE, HEIGHT * FINE)).into_drawing_area();
        root.fill(&WHITE).map_err(refused)?;
        let (title, rest) = root.split_vertically(px(TITLE_HEIGHT));
        title.draw(&Text::new(movements.title.clone(), (px(16), px(14)), font(16.0, INK))).map_err(refused)?;
        legend(&title, movements)?;
        let (left, right) = rest.split_horizontally(px(WIDTH / 2));
        let ([upper_left, lower_left], [upper_right, lower_right]) = (halves(&left), halves(&right));
        let m = movements;
        scatter(&upper_left, m, "duration of the reach (s)", |d| &d.duration, m.duration_lines)?;
        scatter(&lower_left, m, "peak speed (m/s)", |d| &d.peak_speed, m.peak_speed_lines)?;
        profiles(&upper_right, m)?;
        settling(&lower_right, m)?;
        root.present().map_err(refused)?;
    }
    let fine = format!("<svg width=\"{}\" height=\"{}\" ", WIDTH * FINE, HEIGHT * FINE);
    Ok(svg.replacen(&fine, &format!("<svg width=\"{WIDTH}\" height=\"{HEIGHT}\" "), 1))
}

fn halves<'a>(area: &Area<'a>) -> [Area<'a>; 2] {
    let (upper, lower) = area.split_vertically(px((HEIGHT - TITLE_HEIGHT) / 2));
    [upper, lower]
}

/// Which colour is which part of the run.
fn legend(strip: &Area, m: &MovementsFigure) -> Result<(), ReportError> {
    let mut x = px(WIDTH / 2 + MARGIN + LEFT_LABELS);
    for (colour, name) in [
        (EARLY, format!("first {}", thousands(m.early.settled.len() as u64))),
        (BETWEEN, "between".to_owned()),
        (LATE, format!("last {}", thousands(m.late.settled.len() as u64))),
    ] {
        strip.draw(&Circle::new((x, px(23)), fine(4.0), colour.filled())).map_err(refused)?;
        let text = anchored(font(12.0, INK), HPos::Left, VPos::Center);
        strip.draw(&Text::new(name, (x + px(10), px(23)), text)).map_err(refused)?;
        x += px(110);
    }
    Ok(())
}

/// A head with `name`, and axes below it.
fn axes<'a>(
    area: &Area<'a>,
    name: &str,
    (x_end, y_end): (f64, f64),
    (x_desc, y_desc): (&str, &str),
    x_label: &dyn Fn(&f64) -> String,
) -> Result<Chart<'a>, ReportError> {
    let head = anchored(font(12.0, INK), HPos::Left, VPos::Center);
    let place = (px(MARGIN + LEFT_LABELS), px(LEGEND_HEIGHT) * 3 / 5);
    area.draw(&Text::new(name.to_owned(), place, head)).map_err(refused)?;
    let mut chart = ChartBuilder::on(area)
        .margin_top(px(LEGEND_HEIGHT))
        .margin_left(px(MARGIN))
        .margin_right(px(MARGIN + 4))
        .margin_bottom(px(6))
        .set_label_area_size(LabelAreaPosition::Left, px(LEFT_LABELS))
        .set_label_area_size(LabelAreaPosition::Bottom, px(BOTTOM_LABELS))
        .build_cartesian_2d(0.0..x_end, 0.0..y_end)
        .map_err(refused)?;
    mesh(&mut chart, 7, x_label, x_desc, y_desc)?;
    Ok(chart)
}

/// An end for an axis with room above `largest`.
fn end(values: impl Iterator<Item = f64>) -> f64 {
    let largest = values.filter(|&x| drawable(x)).fold(0.0, f64::max);
    if largest > 0.0 { 1.06 * largest } else { 1.0 }
}

fn scatter(
    area: &Area,
    m: &MovementsFigure,
    y_desc: &str,
    points: impl Fn(&MovementDots) -> &Vec<(f64, f64)>,
    lines: [Option<(f64, f64)>; 2],
) -> Result<(), ReportError> {
    let groups = [(&m.middle, BETWEEN, 2.0), (&m.early, EARLY, 2.8), (&m.late, LATE, 2.8)];
    let step = |dots: &MovementDots| points(dots).len().div_ceil(DOTS).max(1);
    let all = || groups.iter().flat_map(|(dots, ..)| points(dots).iter().step_by(step(dots))).copied();
    let (x_end, y_end) = (end(all().map(|p| p.0)), end(all().map(|p| p.1)));
    let name = match lines {
        [Some((_, all)), Some((_, last))] => {
            format!("a metre further: {} (all, grey), {} (last)", signed(all, y_desc), signed(last, y_desc))
        }
        [Some((_, all)), None] => format!("a metre further: {}", signed(all, y_desc)),
        _ => String::new(),
    };
    let x_desc = if groups.iter().any(|(dots, ..)| step(dots) > 1) {
        "distance to the target (m), some of the movements"
    } else {
        "distance to the target (m)"
    };
    let mut chart = axes(area, &name, (x_end, y_end), (x_desc, y_desc), &label)?;
    for (dots, colour, radius) in groups {
        let seen = points(dots).iter().step_by(step(dots)).filter(|p| drawable(p.0) && drawable(p.1));
        let circles = seen.map(|&p| Circle::new(p, fine(radius), colour.mix(0.75).filled()));
        chart.draw_series(circles).map_err(refused)?;
    }
    for (line, colour, groups) in [(lines[0], GREY, &groups[..]), (lines[1], LATE, &groups[2..])] {
        let Some((intercept, slope)) = line else { continue };
        // Where there are dots, and no further.
        let shown = || groups.iter().flat_map(|(dots, ..)| points(dots).iter().step_by(step(dots)));
        let xs = || shown().map(|p| p.0).filter(|&x| drawable(x));
        let (from, to) = (xs().fold(f64::INFINITY, f64::min), xs().fold(0.0, f64::max));
        let ends = [from, to].map(|x| (x, (intercept + slope * x).clamp(0.0, y_end)));
        if ends.iter().all(|p| drawable(p.0) && drawable(p.1)) {
            chart.draw_series(LineSeries::new(ends, colour.stroke_width(fine(2.0)))).map_err(refused)?;
        }
    }
    Ok(())
}

/// A slope with its sign and the unit of what it is a slope of.
fn signed(slope: f64, of: &str) -> String {
    let unit = of.split(['(', ')']).nth(1).unwrap_or_default();
    format!("{slope:+.2} {unit}").replace('-', "\u{2212}")
}

fn profiles(area: &Area, m: &MovementsFigure) -> Result<(), ReportError> {
    let wake = m.wake.profile.iter().copied();
    let highest = m.early.profile.iter().chain(&m.late.profile).map(|q| q[2]).chain(wake);
    let desc = ("part of the reach", "speed / mean speed");
    let name = "speed profile: median, middle half; dashed: minimum jerk";
    let mut chart = axes(area, name, (1.0, end(highest)), desc, &label)?;
    for (dots, colour) in [(&m.early, EARLY), (&m.late, LATE)] {
        let curve = |which: usize| {
            let last = dots.profile.len().saturating_sub(1).max(1) as f64;
            let points = dots.profile.iter().enumerate().map(move |(i, q)| (i as f64 / last, q[which]));
            points.filter(|p| drawable(p.1)).collect::<Vec<_>>()
        };
        let outline: Vec<_> = curve(0).into_iter().chain(curve(2).into_iter().rev()).collect();
        if outline.len() < 3 {
            continue;
        }
        chart.draw_series([Polygon::new(outline, colour.mix(0.16).filled())]).map_err(refused)?;
        chart.draw_series(LineSeries::new(curve(1), colour.stroke_width(fine(2.2)))).map_err(refused)?;
    }
    let last = m.wake.profile.len().saturating_sub(1).max(1) as f64;
    let wake: Vec<_> = m.wake.profile.iter().enumerate().map(|(i, &v)| (i as f64 / last, v)).collect();
    if wake.len() > 1 && wake.iter().all(|p| drawable(p.1)) {
        let dashes = DashedPathElement::new(wake, fine(5.0), fine(4.0), INK.stroke_width(fine(1.6)));
        chart.draw_series([dashes]).map_err(refused)?;
    }
    Ok(())
}

fn settling(area: &Area, m: &MovementsFigure) -> Result<(), ReportError> {
    let times =
        |dots: &MovementDots| dots.settled.iter().flatten().copied().filter(|&t| drawable(t)).collect::<Vec<_>>();
    let (early, late) = (times(&m.early), times(&m.late));
    let bin = nice(early.iter().chain(&late).copied().fold(0.0, f64::max) / BARS);
    let bins = early.iter().chain(&late).map(|t| (t / bin).floor() as usize + 1).max().unwrap_or(1);
    let settled_end = bins as f64 * bin;
    // Behind the last bar a gap, and then those that did not settle.
    let never = settled_end + 1.5 * bin;
    let shares = |dots: &MovementDots, times: &[f64]| -> Vec<(f64, f64)> {
        let all = dots.settled.len().max(1) as f64;
        let count = |i: usize| times.iter().filter(|&&t| (t / bin).floor() as usize == i).count() as f64;
        let not = dots.settled.len() as f64 - times.len() as f64;
        (0..bins)
            .map(|i| ((i as f64 + 0.5) * bin, 100.0 * count(i) / all))
            .chain([(never, 100.0 * not / all)])
            .collect()
    };
    let groups = [(shares(&m.early, &early), EARLY, -0.42), (shares(&m.late, &late), LATE, 0.02)];
    let y_end = end(groups.iter().flat_map(|(bars, ..)| bars).map(|b| b.1));
    let name = format!("from the target's appearance until within {} m for good", label(&m.near_m));
    let time = |x: &f64| if *x <= settled_end + 1e-9 { label(x) } else { String::new() };
    let mut chart = axes(area, &name, (never + bin, y_end), ("settled after (s)", "movements (%)"), &time)?;
    for (bars, colour, side) in groups {
        let tall = bars.into_iter().filter(|bar| bar.1 > 0.0);
        let boxes = tall.map(|(x, share)| {
            let left = x + side * bin;
            Rectangle::new([(left, 0.0), (left + 0.4 * bin, share)], colour.mix(0.85).filled())
        });
        chart.draw_series(boxes).map_err(refused)?;
    }
    let text = Text::new("never", (0, px(9)), anchored(font(12.0, INK), HPos::Center, VPos::Top));
    chart.draw_series([EmptyElement::at((never, 0.0)) + text]).map_err(refused)?;
    Ok(())
}

/// The next of 1, 2, 2.5, 5, 10 and their tenfolds from `x` up; 0.1 for none.
fn nice(x: f64) -> f64 {
    if !(x > 0.0 && drawable(x)) {
        return 0.1;
    }
    let decade = 10_f64.powf(x.log10().floor());
    let step = [1.0, 2.0, 2.5, 5.0].into_iter().find(|step| step * decade >= x).unwrap_or(10.0);
    step * decade
}

#[cfg(test)]
mod tests {
    use super::*;

    fn dots(n: usize, shift: f64) -> MovementDots {
        let x = |i: usize| 0.2 + 1.5 * i as f64 / n as f64;
        MovementDots {
            duration: (0..n).map(|i| (x(i), shift + 0.3 * x(i))).collect(),
            peak_speed: (0..n).map(|i| (x(i), shift * 3.0 * x(i))).collect(),
            settled: (0..n).map(|i| (i % 3 > 0).then_some(shift + 0.05 * i as f64)).collect(),
            profile: (0..41).map(|i| [0.8, 1.0, 1.3].map(|f| f * 0.06 * f64::from(i * (40 - i)) / 15.0)).collect(),
        }
    }

    fn movements() -> MovementsFigure {
        MovementsFigure {
            title: "live, seed 1: 74 movements".into(),
            early: dots(10, 1.5),
            middle: dots(54, 1.0),
            late: dots(10, 0.6),
            duration_lines: [Some((0.6, -0.3)); 2],
            peak_speed_lines: [Some((0.0, 1.8)), None],
            wake: SpeedProfile {
                profile: (0..41).map(|i| 30.0 * (f64::from(i * (40 - i)) / 1600.0).powi(2)).collect(),
            },
            near_m: 0.1,
        }
    }

    #[test]
    fn the_figure_says_what_it_shows() {
        let one = svg(&movements()).unwrap();
        assert!(one.starts_with("<svg width=\"1010\" height=\"640\" viewBox=\"0 0 4040 2560\""));
        assert_eq!(one, svg(&movements()).unwrap(), "the same bytes for the same numbers");
        for words in [
            "live, seed 1: 74 movements",
            "first 10",
            "last 10",
            "duration of the reach (s)",
            "peak speed (m/s)",
            "distance to the target (m)",
            "speed / mean speed",
            "minimum jerk",
            "until within 0.1 m for good",
            "never",
            "a metre further: \u{2212}0.30 s (all, grey), \u{2212}0.30 s (last)",
            "a metre further: +1.80 m/s\n",
        ] {
            assert!(one.contains(words), "{words}");
        }
    }

    #[test]
    fn nothing_and_extreme_numbers_are_drawn() {
        svg(&MovementsFigure::default()).unwrap();
        for x in [f64::NAN, f64::INFINITY, 1e300, 1e25, 1e-300, 0.0] {
            let mut all = movements();
            all.late.duration = vec![(x, x); 3];
            all.late.peak_speed = vec![(0.5, x)];
            all.early.settled = vec![Some(x), None];
            all.late.profile[7] = [x; 3];
            all.wake.profile[3] = x;
            all.duration_lines = [Some((x, x)); 2];
            svg(&all).unwrap();
        }
    }

    #[test]
    fn bars_have_round_widths() {
        let found = [0.0, 0.013, 0.2, 0.21, 0.3, 0.7, f64::NAN].map(nice);
        for (found, expected) in found.into_iter().zip([0.1, 0.02, 0.2, 0.25, 0.5, 1.0, 0.1]) {
            assert!((found - expected).abs() < 1e-12, "{found} for {expected}");
        }
    }
}
