//! What a sweep over settings found: one row for each combination, a dot for each seed, a bar at their median.

use super::*;
use crate::stats::Spread;

const WIDTH: u32 = 860;
const ROW: u32 = 26;
const RIGHT: u32 = 24;
const BOTTOM: u32 = 46;
/// Width of a letter.
const LETTER: u32 = 7;
/// The names of the combinations take at most this part of the width.
const MOST_NAMES: u32 = 460;

/// One combination of settings.
#[derive(Debug, Clone, PartialEq)]
pub struct SweepFigureRow {
    /// The settings.
    pub name: String,
    /// One value for each seed. What is not a number is left out.
    pub values: Vec<f64>,
}

/// Draws `rows` into a new file at `path`, in place of one that is there; `x` names the axis of their values.
///
/// # Errors
///
/// [`ReportError`] if the file cannot be written.
pub fn draw_sweep(title: &str, x: &str, rows: &[SweepFigureRow], path: &Path) -> Result<(), ReportError> {
    let height = TITLE_HEIGHT + ROW * rows.len() as u32 + BOTTOM;
    let longest = rows.iter().map(|row| row.name.chars().count()).max().unwrap_or(0) as u32;
    let names = (30 + LETTER * longest).min(MOST_NAMES);
    let svg = canvas((WIDTH, height), title, |_, rest| {
        let all = Spread::of(rows.iter().flat_map(|row| &row.values).copied().filter(|&x| drawable(x)));
        let (low, high) = all.map_or((0.0, 1.0), |all| (all.min, all.max));
        let margin = if high > low { 0.04 * (high - low) } else { low.abs().max(1.0) * 0.1 };
        let mut chart = ChartBuilder::on(rest)
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
            .x_desc(x)
            .draw()
            .map_err(refused)?;
        for (i, row) in rows.iter().enumerate() {
            let (y, middle) = (i as f64 + 0.5, px(ROW * i as u32 + ROW / 2));
            let text = anchored(font(12.0, INK), HPos::Right, VPos::Center);
            rest.draw(&Text::new(row.name.clone(), (px(names - 10), middle), text)).map_err(refused)?;
            let values = || row.values.iter().copied().filter(|&x| drawable(x));
            let dots = values().map(|x| Circle::new((x, y), px(3), SKY.mix(0.6).filled()));
            chart.draw_series(dots).map_err(refused)?;
            if let Some(spread) = Spread::of(values()) {
                let bar = vec![(spread.median, y - 0.35), (spread.median, y + 0.35)];
                let bar = PathElement::new(bar, VERMILION.stroke_width(fine(2.4)));
                chart.draw_series(std::iter::once(bar)).map_err(refused)?;
            }
        }
        Ok(())
    })?;
    write(path, &svg)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_combination_has_its_name_and_its_seeds() {
        let folder = std::env::temp_dir().join(format!("tectum-sweep-{}", std::process::id()));
        let row = |name: &str, values: &[f64]| SweepFigureRow { name: name.to_owned(), values: values.to_vec() };
        let rows =
            [row("a=1", &[-1.0, -2.0, -1.5]), row("a=3", &[f64::NAN, 4.0]), row("a=10", &[f64::INFINITY, 1e300])];
        draw_sweep("sweep", "loss", &rows, &folder).unwrap();
        let svg = std::fs::read_to_string(&folder).unwrap();
        std::fs::remove_file(&folder).unwrap();
        assert!(["a=1", "a=3", "a=10", "loss"].iter().all(|text| svg.contains(text)), "{svg}");
        assert_eq!(svg.matches("<circle").count(), 4);
        draw_sweep("none", "loss", &[row("a", &[])], &folder).unwrap();
        std::fs::remove_file(&folder).unwrap();
    }
}
