//! The right part: the arm on its way to a target, light at first and dark at the end.

use super::*;
use crate::Reach;
use crate::text::thousands;

const LEGEND_HEIGHT: u32 = 26;
const LEFT_LABELS: u32 = 46;
const BOTTOM_LABELS: u32 = 38;
/// Shades in the legend.
const SHADES: u32 = 6;

/// Panels below each other, all to one scale, so that they can be compared.
pub(super) fn draw(history: &RunHistory, reaches: &[(&str, &Reach)], area: &Area) -> Result<(), ReportError> {
    let (centre, half) = frame(reaches);
    for ((name, reach), area) in reaches.iter().zip(area.split_evenly((2, 1))) {
        let (head, rest) = area.split_vertically(px(LEGEND_HEIGHT));
        let text = anchored(font(12.0, INK), HPos::Left, VPos::Center);
        let title = format!("{name}, from tick {}", thousands(reach.from));
        head.draw(&Text::new(title, (px(LEFT_LABELS), px(LEGEND_HEIGHT) * 3 / 5), text)).map_err(refused)?;
        panel(&history.unit, reach, centre, half, &rest)?;
    }
    Ok(())
}

/// What cross, coloured line and shades mean, for the strip above the panels that starts at `left`.
pub(super) fn legend(strip: &Area, left: i32) -> Result<(), ReportError> {
    let style = || anchored(font(12.0, INK), HPos::Left, VPos::Center);
    let (x, y) = (left + px(LEFT_LABELS), px(13));
    strip.draw(&Cross::new((x + px(11), y), fine(5.0), INK.stroke_width(fine(2.0)))).map_err(refused)?;
    strip.draw(&Text::new("target", (x + px(28), y), style())).map_err(refused)?;
    let line = [(x + px(84), y), (x + px(106), y)];
    strip.draw(&PathElement::new(line, VERMILION.stroke_width(fine(1.8)))).map_err(refused)?;
    strip.draw(&Text::new("path of the end-effector", (x + px(112), y), style())).map_err(refused)?;
    let y = px(32);
    for i in 0..SHADES {
        let at = x + px(i * 4);
        let age = f64::from(i) / f64::from(SHADES - 1);
        let shade = PathElement::new([(at, y - px(5)), (at, y + px(5))], faded(age).stroke_width(fine(1.6)));
        strip.draw(&shade).map_err(refused)?;
    }
    strip.draw(&Text::new("arm, tick by tick, from light to dark", (x + px(28), y), style())).map_err(refused)
}

/// Square axes around `centre`, on which a metre is as long across as it is upwards.
pub(super) fn square<'a>(
    unit: &str,
    (centre, half): ([f64; 2], f64),
    area: &Area<'a>,
) -> Result<Chart<'a>, ReportError> {
    // The plot is made square within what there is.
    let (width, height) = area.dim_in_pixel();
    let side = (width as i32 - px(LEFT_LABELS + 16)).min(height as i32 - px(BOTTOM_LABELS + 8));
    let mut chart = ChartBuilder::on(area)
        .margin_right(width as i32 - px(LEFT_LABELS) - side)
        .margin_bottom(height as i32 - px(BOTTOM_LABELS) - side)
        .set_label_area_size(LabelAreaPosition::Left, px(LEFT_LABELS))
        .set_label_area_size(LabelAreaPosition::Bottom, px(BOTTOM_LABELS))
        .build_cartesian_2d(centre[0] - half..centre[0] + half, centre[1] - half..centre[1] + half)
        .map_err(refused)?;
    chart
        .configure_mesh()
        .disable_mesh()
        .axis_style(GREY.stroke_width(fine(1.0)))
        .label_style(font(11.0, INK))
        .axis_desc_style(font(12.0, INK))
        .x_labels(5)
        .y_labels(5)
        .set_all_tick_mark_size(px(4))
        .x_label_formatter(&label)
        .y_label_formatter(&label)
        .x_desc(with_unit("x", unit))
        .y_desc(with_unit("y", unit))
        .draw()
        .map_err(refused)?;
    Ok(chart)
}

pub(super) fn panel(unit: &str, reach: &Reach, centre: [f64; 2], half: f64, area: &Area) -> Result<(), ReportError> {
    let mut chart = square(unit, (centre, half), area)?;
    let whole: Vec<&Vec<[f64; 2]>> =
        reach.postures.iter().filter(|line| !line.is_empty() && line.iter().flatten().all(|&x| drawable(x))).collect();
    let last = whole.len().saturating_sub(1);
    for (i, line) in whole.iter().enumerate() {
        let (age, points) = (i as f64 / last.max(1) as f64, line.iter().map(|p| (p[0], p[1])));
        let width = if i == last { 2.6 } else { 1.2 };
        let path = PathElement::new(points.clone().collect::<Vec<_>>(), faded(age).stroke_width(fine(width)));
        chart.draw_series([path]).map_err(refused)?;
        if i == last {
            let joints = points.map(|p| Circle::new(p, fine(3.0), faded(age).filled()));
            chart.draw_series(joints).map_err(refused)?;
        }
    }
    let path: Vec<_> = whole.iter().filter_map(|line| line.last()).map(|p| (p[0], p[1])).collect();
    if let Some(&end) = path.last() {
        chart.draw_series([PathElement::new(path, VERMILION.stroke_width(fine(1.8)))]).map_err(refused)?;
        chart.draw_series([Circle::new(end, fine(3.4), VERMILION.filled())]).map_err(refused)?;
    }
    if reach.target.iter().all(|&x| drawable(x)) {
        let target = (reach.target[0], reach.target[1]);
        chart.draw_series([Cross::new(target, fine(6.0), INK.stroke_width(fine(2.2)))]).map_err(refused)?;
    }
    Ok(())
}

/// From a light grey-blue to a dark one.
fn faded(age: f64) -> RGBColor {
    let mix = |light: f64, dark: f64| (light + age * (dark - light)).round() as u8;
    RGBColor(mix(214.0, 0.0), mix(226.0, 68.0), mix(238.0, 116.0))
}

/// Centre and half the side of a square that holds everything with a little room.
pub(super) fn frame(reaches: &[(&str, &Reach)]) -> ([f64; 2], f64) {
    let mut low = [f64::INFINITY; 2];
    let mut high = [f64::NEG_INFINITY; 2];
    let points = reaches.iter().flat_map(|(_, reach)| reach.postures.iter().flatten().chain([&reach.target]));
    for p in points.filter(|p| p.iter().all(|&x| drawable(x))) {
        for axis in 0..2 {
            low[axis] = low[axis].min(p[axis]);
            high[axis] = high[axis].max(p[axis]);
        }
    }
    let half = (0..2).map(|axis| (high[axis] - low[axis]) / 2.0).fold(0.0, f64::max);
    // A single point has no extent, and gets some.
    let half = if half > 0.0 { 1.06 * half } else { 1.0 };
    (std::array::from_fn(|axis| (low[axis] + high[axis]) / 2.0), half)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_frame_is_a_square_around_everything() {
        let reach = Reach { from: 0, target: [3.0, 0.0], postures: vec![vec![[-1.0, 0.0], [0.0, 1.0]]] };
        let (centre, half) = frame(&[("first", &reach)]);
        assert_eq!(centre, [1.0, 0.5]);
        assert!((half - 2.12).abs() < 1e-12);
        let point = Reach { from: 0, target: [3.0, 0.0], postures: vec![vec![[3.0, 0.0]]] };
        assert_eq!(frame(&[("first", &point)]), ([3.0, 0.0], 1.0));
    }

    #[test]
    fn later_postures_are_darker() {
        let [early, late] = [faded(0.0), faded(1.0)].map(|c| u32::from(c.0) + u32::from(c.1) + u32::from(c.2));
        assert!(early > 600 && late < 200);
    }
}
