//! Curves over several orders of magnitude: panels beside each other, both axes logarithmic.

use super::*;

const PANEL: (u32, u32) = (620, 430);
const CAPTION: u32 = 24;
const LEGEND: u32 = 20;
const LEFT: u32 = 70;
const BOTTOM: u32 = 46;
const COLOURS: [RGBColor; 8] = [VERMILION, BLUE, GREEN, ORANGE, PURPLE, SKY, RGBColor(90, 90, 90), GREY];

/// One pair of axes.
#[derive(Debug, Clone)]
pub struct AxisScales {
    /// Title above it.
    pub name: String,
    /// Name of the axis along.
    pub x: String,
    /// Name of the axis up.
    pub y: String,
    /// How a whole power of ten along is written; on an axis shorter than that, every digit.
    pub label_x: fn(f64) -> String,
    /// Curves with their names; of more than eight the colours begin again. Points that are not above 0 are
    /// left out.
    pub curves: Vec<(String, Polyline)>,
}

/// Draws `panels` beside each other into a file.
///
/// # Errors
/// When the file cannot be written.
pub fn draw_scales(title: &str, panels: &[AxisScales], path: &Path) -> Result<(), ReportError> {
    let rows = panels.iter().map(|panel| panel.curves.len()).max().unwrap_or(0).div_ceil(2) as u32;
    let height = TITLE_HEIGHT + CAPTION + PANEL.1 + rows * LEGEND + 8;
    let count = panels.len().max(1);
    let svg = canvas((PANEL.0 * count as u32, height), title, |_, rest| {
        for (panel, area) in panels.iter().zip(rest.split_evenly((1, count))) {
            let (head, area) = area.split_vertically(px(CAPTION + rows * LEGEND));
            caption(panel, &head)?;
            axes(panel, &area)?;
        }
        Ok(())
    })?;
    write(path, &svg)
}

/// The panel's name, and below it the curves' in two columns.
fn caption(panel: &AxisScales, head: &Area) -> Result<(), ReportError> {
    let text = |size, h| anchored(font(size, INK), h, VPos::Center);
    head.draw(&Text::new(panel.name.clone(), (px(LEFT), px(CAPTION) / 2), text(13.5, HPos::Left))).map_err(refused)?;
    for (i, (name, _)) in panel.curves.iter().enumerate() {
        let (row, column) = (i as u32 / 2, i as u32 % 2);
        let (x, y) = (px(LEFT + column * (PANEL.0 - LEFT) / 2), px(CAPTION + row * LEGEND + LEGEND / 2));
        let style = COLOURS[i % COLOURS.len()].stroke_width(fine(2.2));
        head.draw(&PathElement::new([(x, y), (x + px(22), y)], style)).map_err(refused)?;
        head.draw(&Text::new(name.clone(), (x + px(28), y), text(12.0, HPos::Left))).map_err(refused)?;
    }
    Ok(())
}

/// A range that holds some values, with a little room.
fn range(values: impl Iterator<Item = f64>) -> (f64, f64) {
    let (low, high) = values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| (low.min(v), high.max(v)));
    match low <= high {
        true => (low - 0.03 * (high - low).max(0.5), high + 0.03 * (high - low).max(0.5)),
        // Nothing to show still needs an axis.
        false => (0.0, 1.0),
    }
}

fn axes(panel: &AxisScales, area: &Area) -> Result<(), ReportError> {
    let logarithm =
        |&(x, y): &(f64, f64)| (x > 0.0 && y > 0.0 && drawable(x) && drawable(y)).then(|| (x.log10(), y.log10()));
    let curves: Vec<Polyline> = panel.curves.iter().map(|(_, c)| c.iter().filter_map(logarithm).collect()).collect();
    let (x, y) = (range(curves.iter().flatten().map(|p| p.0)), range(curves.iter().flatten().map(|p| p.1)));
    // Axes in logarithms, labelled by hand: the library's own logarithmic labels leave out too much.
    let mut chart = ChartBuilder::on(area)
        .margin_left(px(LEFT))
        .margin_right(px(18))
        .margin_bottom(px(BOTTOM))
        .margin_top(px(4))
        .build_cartesian_2d(x.0..x.1, y.0..y.1)
        .map_err(refused)?;
    let corner = area.get_pixel_range();
    let place = |chart: &Chart, x: f64, y: f64| {
        let (right, down) = chart.plotting_area().map_coordinate(&(x, y));
        (right - corner.0.start, down - corner.1.start)
    };
    let ((left, bottom), (right, top)) = (place(&chart, x.0, y.0), place(&chart, x.1, y.1));
    let faint = |bold: bool| FAINT.mix(if bold { 1.0 } else { 0.5 }).stroke_width(fine(0.8));
    // An axis that is shorter than a power of ten is labelled at every digit.
    let short = x.1 - x.0 < 1.0;
    for (value, digit) in grid(x) {
        let at = place(&chart, value, y.0).0;
        area.draw(&PathElement::new([(at, top), (at, bottom)], faint(digit == 1))).map_err(refused)?;
        if digit == 1 || short {
            let text = anchored(font(12.0, INK), HPos::Center, VPos::Top);
            let label = (panel.label_x)(10_f64.powf(value));
            area.draw(&Text::new(label, (at, bottom + px(7)), text)).map_err(refused)?;
        }
    }
    // Few powers of ten have room for the numbers between them.
    let close = y.1 - y.0 < 2.5;
    for (value, digit) in grid(y) {
        let at = place(&chart, x.0, value).1;
        area.draw(&PathElement::new([(left, at), (right, at)], faint(digit == 1))).map_err(refused)?;
        if digit == 1 || close && matches!(digit, 2 | 5) {
            let text = anchored(font(12.0, INK), HPos::Right, VPos::Center);
            area.draw(&Text::new(label(&10_f64.powf(value)), (left - px(7), at), text)).map_err(refused)?;
        }
    }
    let frame = GREY.stroke_width(fine(1.0));
    area.draw(&PathElement::new([(left, top), (left, bottom), (right, bottom)], frame)).map_err(refused)?;
    let text = anchored(font(13.0, INK), HPos::Center, VPos::Top);
    area.draw(&Text::new(panel.x.clone(), ((left + right) / 2, bottom + px(26)), text)).map_err(refused)?;
    let text = anchored(font(13.0, INK), HPos::Center, VPos::Top).transform(FontTransform::Rotate270);
    area.draw(&Text::new(panel.y.clone(), (px(8), (top + bottom) / 2), text)).map_err(refused)?;
    for (i, curve) in curves.into_iter().enumerate() {
        let colour = COLOURS[i % COLOURS.len()];
        if curve.len() <= 40 {
            let dots = curve.iter().map(|&p| Circle::new(p, fine(2.4), colour.filled()));
            chart.draw_series(dots).map_err(refused)?;
        }
        chart.draw_series(LineSeries::new(curve, colour.stroke_width(fine(1.8)))).map_err(refused)?;
    }
    Ok(())
}

/// The logarithms of 1 to 9 times the powers of ten within a range of logarithms, with the digit.
fn grid((low, high): (f64, f64)) -> impl Iterator<Item = (f64, u32)> {
    let powers = low.floor() as i32..=high.ceil() as i32;
    let all = powers.flat_map(|power| (1..=9).map(move |digit| (f64::from(power) + f64::from(digit).log10(), digit)));
    all.filter(move |(value, _)| (low..=high).contains(value))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_figure_has_names_and_whole_powers() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("figure.svg");
        let panel = |curves| AxisScales {
            name: "growth".into(),
            x: "features".into(),
            y: "ns a call".into(),
            label_x: |x| format!("{x:.0} f"),
            curves,
        };
        let curve = vec![(8.0, 4.0), (20.0, 30.0), (2000.0, 4000.0), (0.0, 1.0), (f64::NAN, 3.0)];
        draw_scales("Costs", &[panel(vec![("a line".into(), curve)]), panel(Vec::new())], &path).unwrap();
        let svg = std::fs::read_to_string(&path).unwrap();
        for words in ["Costs", "growth", "a line", "features", "ns a call", "100 f", "1000 f"] {
            assert!(svg.contains(words), "{words}");
        }
    }

    #[test]
    fn the_grid_stays_within_its_range() {
        let values: Vec<_> = grid((0.9, 1.4)).map(|(_, digit)| digit).collect();
        assert_eq!(values, [8, 9, 1, 2]);
    }
}
