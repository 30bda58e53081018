//! Curves with a band: the middle of several runs, and the span from the least to the largest.

use super::*;

/// One curve of several runs.
pub(super) struct Band {
    /// Its name in the legend.
    pub name: String,
    pub colour: RGBColor,
    /// x, and the least, middle and largest y there.
    pub points: Vec<(f64, [f64; 3])>,
}

/// Where and how bands are drawn.
pub(super) struct Axes<'a> {
    /// End of the x axis, which begins at 0.
    pub end: f64,
    /// Names of the axes; the x axis is only labelled if it has one.
    pub x: Option<String>,
    /// The y axis goes at least so far.
    pub top: f64,
    pub y: String,
    /// A dashed line across at this x, with its name.
    pub mark: Option<(f64, &'a str)>,
    /// Dashed levels along, with their names.
    pub levels: &'a [(f64, String)],
}

const MARGIN: u32 = 16;
const LEFT_LABELS: u32 = 62;
const BOTTOM_LABELS: u32 = 44;
const LEGEND_HEIGHT: u32 = 26;

impl Band {
    /// The band of several runs' curves, which have their points at the same x. Runs that are shorter are
    /// left out where they have ended.
    pub fn of(name: &str, colour: RGBColor, curves: &[Polyline]) -> Self {
        let longest = curves.iter().max_by_key(|c| c.len()).map(Vec::as_slice).unwrap_or_default();
        let point = |(i, &(x, _)): (usize, &(f64, f64))| {
            let mut values: Vec<f64> = curves.iter().filter_map(|c| Some(c.get(i)?.1)).collect();
            values.sort_by(f64::total_cmp);
            (x, [values[0], values[(values.len() - 1) / 2], values[values.len() - 1]])
        };
        Self { name: name.to_owned(), colour, points: longest.iter().enumerate().map(point).collect() }
    }
}

/// Draws `bands` on one set of axes, with a legend above.
pub(super) fn draw(bands: &[Band], axes: &Axes, area: &Area) -> Result<(), ReportError> {
    let (strip, rest) = area.split_vertically(px(LEGEND_HEIGHT));
    legend(bands, &strip)?;
    draw_axes(bands, axes, &rest)
}

fn legend(bands: &[Band], strip: &Area) -> Result<(), ReportError> {
    let mut x = px(MARGIN + LEFT_LABELS + 6);
    let y = px(LEGEND_HEIGHT) * 3 / 5;
    for band in bands {
        let style = band.colour.stroke_width(fine(1.9));
        strip.draw(&PathElement::new([(x, y), (x + px(22), y)], style)).map_err(refused)?;
        let text = anchored(font(12.0, INK), HPos::Left, VPos::Center);
        strip.draw(&Text::new(band.name.clone(), (x + px(28), y), text)).map_err(refused)?;
        // Letters are about half as wide as they are tall.
        x += px(28 + 26) + px(band.name.chars().count() as u32 * 13 / 2);
    }
    Ok(())
}

/// Draws `bands` on one set of axes, for a figure that names their colours elsewhere.
pub(super) fn draw_axes(bands: &[Band], axes: &Axes, area: &Area) -> Result<(), ReportError> {
    let values = || bands.iter().flat_map(|b| &b.points).flat_map(|p| p.1).filter(|&y| drawable(y));
    let top = values().chain(axes.levels.iter().map(|l| l.0)).fold(axes.top, f64::max);
    let low = values().fold(0.0, f64::min);
    let high = low + 1.06 * if top > low { top - low } else { 1.0 };
    let mut chart = ChartBuilder::on(area)
        .margin_left(px(MARGIN))
        .margin_right(px(MARGIN + 4))
        .margin_bottom(px(if axes.x.is_some() { 6 } else { 2 }))
        .set_label_area_size(LabelAreaPosition::Left, px(LEFT_LABELS))
        .set_label_area_size(LabelAreaPosition::Bottom, px(if axes.x.is_some() { BOTTOM_LABELS } else { 12 }))
        .build_cartesian_2d(0.0..axes.end, low..high)
        .map_err(refused)?;
    let bare = |_: &f64| String::new();
    let label_x: &dyn Fn(&f64) -> String = if axes.x.is_some() { &label } else { &bare };
    mesh(&mut chart, 9, label_x, axes.x.clone().unwrap_or_default(), axes.y.clone())?;
    let dashed = |line: [(f64, f64); 2], weight: f64| {
        DashedPathElement::new(line, fine(4.0), fine(3.0), INK.mix(0.6).stroke_width(fine(weight)))
    };
    for (y, name) in axes.levels {
        chart.draw_series([dashed([(0.0, *y), (axes.end, *y)], 0.9)]).map_err(refused)?;
        let text = Text::new(name.clone(), (-px(4), px(2)), anchored(font(11.0, INK), HPos::Right, VPos::Top));
        chart.draw_series([EmptyElement::at((axes.end, *y)) + text]).map_err(refused)?;
    }
    if let Some((x, name)) = axes.mark.filter(|(x, _)| (0.0..=axes.end).contains(x)) {
        chart.draw_series([dashed([(x, low), (x, high)], 1.1)]).map_err(refused)?;
        let (h, shift) = if x > 0.5 * axes.end { (HPos::Right, -px(5)) } else { (HPos::Left, px(5)) };
        let text = Text::new(name.to_owned(), (shift, px(3)), anchored(font(12.0, INK), h, VPos::Top));
        chart.draw_series([EmptyElement::at((x, high)) + text]).map_err(refused)?;
    }
    for band in bands {
        let style = band.colour.stroke_width(fine(1.9));
        // A value that is none breaks the curve instead of bending it.
        let pieces = band.points.split(|p| !p.1.iter().all(|&y| drawable(y)));
        for piece in pieces.filter(|piece| piece.len() > 1) {
            let edge = |i: usize| piece.iter().map(move |(x, ys)| (*x, ys[i]));
            let outline: Vec<_> = edge(2).chain(edge(0).rev()).collect();
            chart.draw_series([Polygon::new(outline, band.colour.mix(0.22).filled())]).map_err(refused)?;
            chart.draw_series(LineSeries::new(edge(1), style)).map_err(refused)?;
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_band_goes_from_the_least_to_the_largest() {
        let curves = [vec![(0.0, 3.0), (1.0, 1.0)], vec![(0.0, 1.0)], vec![(0.0, 2.0), (1.0, 5.0)]];
        let band = Band::of("loss", BLUE, &curves);
        assert_eq!(band.points, [(0.0, [1.0, 2.0, 3.0]), (1.0, [1.0, 1.0, 5.0])]);
    }
}
