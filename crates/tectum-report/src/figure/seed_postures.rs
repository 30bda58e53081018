//! How runs differ: the learning curves of several seeds, and the posture that each has found for the same
//! targets.

use super::bands::{Axes, Band};
use super::*;

/// Size of a row, pixels.
const ROW: (u32, u32) = (1240, 300);
const CURVE: u32 = 380;
const CAPTION: u32 = 22;

/// What the figure shows.
#[derive(Debug, Clone)]
pub struct PosturesFigure {
    /// Title.
    pub title: String,
    /// Rows from top to bottom.
    pub rows: Vec<PosturesRow>,
}

/// One row: a curve with its band, then targets.
#[derive(Debug, Clone)]
pub struct PosturesRow {
    /// Title above it.
    pub name: String,
    /// Seed by seed: millions of trials, and the mean error in m.
    pub curves: Vec<Polyline>,
    /// Targets.
    pub ways: Vec<SeedPostures>,
}

/// A target, and the posture of each seed: from the base over the joints to the end-effector, m.
#[derive(Debug, Clone)]
pub struct SeedPostures {
    /// The target, m.
    pub target: [f64; 2],
    /// Seed by seed.
    pub postures: Vec<Vec<[f64; 2]>>,
}

/// Colours of the seeds, from the beginning again when they end.
const SEEDS: [RGBColor; 7] =
    [BLUE, VERMILION, RGBColor(0, 158, 115), RGBColor(204, 121, 167), RGBColor(230, 159, 0), SKY, RGBColor(90, 90, 90)];

/// Draws it into a file.
///
/// # Errors
/// When the file cannot be written.
pub fn draw_ways(figure: &PosturesFigure, path: &Path) -> Result<(), ReportError> {
    let rows = figure.rows.len().max(1);
    let svg = canvas((ROW.0, TITLE_HEIGHT + ROW.1 * rows as u32), &figure.title, |_, rest| {
        for (row, area) in figure.rows.iter().zip(rest.split_evenly((rows, 1))) {
            let (head, area) = area.split_vertically(px(CAPTION));
            let style = anchored(font(13.5, INK), HPos::Left, VPos::Center);
            head.draw(&Text::new(row.name.clone(), (px(84), px(CAPTION) / 2), style)).map_err(refused)?;
            let (left, right) = area.split_horizontally(px(CURVE));
            let end = row.curves.iter().flatten().map(|p| p.0).fold(0.0, f64::max);
            let axes = Axes {
                end: if end > 0.0 { end } else { 1.0 },
                x: Some("trials (millions)".to_owned()),
                top: 0.0,
                y: "mean error (m)".to_owned(),
                mark: None,
                levels: &[],
            };
            bands::draw(&[Band::of("with exploration noise", BLUE, &row.curves)], &axes, &left)?;
            for (way, area) in row.ways.iter().zip(right.split_evenly((1, row.ways.len().max(1)))) {
                panel(way, &area)?;
            }
        }
        Ok(())
    })?;
    write(path, &svg)
}

fn panel(way: &SeedPostures, area: &Area) -> Result<(), ReportError> {
    let mut chart = postures::square("m", ([0.0, 0.0], 1.6), area)?;
    for (posture, colour) in way.postures.iter().zip(SEEDS.iter().cycle()) {
        if !posture.iter().flatten().all(|&x| drawable(x)) {
            continue;
        }
        let points = posture.iter().map(|p| (p[0], p[1]));
        let line = PathElement::new(points.clone().collect::<Vec<_>>(), colour.stroke_width(fine(1.8)));
        chart.draw_series([line]).map_err(refused)?;
        chart.draw_series(points.map(|p| Circle::new(p, fine(2.4), colour.filled()))).map_err(refused)?;
    }
    let target = (way.target[0], way.target[1]);
    chart.draw_series([Cross::new(target, fine(6.0), INK.stroke_width(fine(2.2)))]).map_err(refused)?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_seed_has_its_line() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("figure.svg");
        let way = SeedPostures {
            target: [0.5, 0.5],
            postures: vec![vec![[0.0, -1.0], [0.3, 0.0]], vec![[0.0, -1.0], [f64::NAN, 0.0]]],
        };
        let row =
            PosturesRow { name: "3 segments".into(), curves: vec![vec![(0.1, 1.0), (0.2, 0.5)]], ways: vec![way] };
        draw_ways(&PosturesFigure { title: "Open loop".into(), rows: vec![row] }, &path).unwrap();
        let svg = std::fs::read_to_string(&path).unwrap();
        for words in ["Open loop", "3 segments", "mean error (m)", "x (m)"] {
            assert!(svg.contains(words), "{words}");
        }
    }
}
