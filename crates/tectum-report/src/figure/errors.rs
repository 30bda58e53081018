//! The paper's figure 2: how the mean error of saccades falls, for scalar and topographic inputs side by side.

use super::bands::{Axes, Band};
use super::*;

/// Size of a panel, pixels.
const PANEL: (u32, u32) = (470, 380);

/// What the figure shows.
#[derive(Debug, Clone)]
pub struct ErrorFigure {
    /// Title.
    pub title: String,
    /// Panels from left to right.
    pub panels: Vec<ErrorPanel>,
    /// Named levels, in all panels.
    pub levels: Vec<(f64, String)>,
    /// Name of the y axis.
    pub y: String,
}

/// One panel.
#[derive(Debug, Clone)]
pub struct ErrorPanel {
    /// Title above it.
    pub name: String,
    /// Curves with their names: run by run, points of millions of trials and mean error. The first is drawn
    /// in red, the second in blue, as in the paper.
    pub curves: Vec<(String, Vec<Polyline>)>,
}

/// Draws it into a file.
///
/// # Errors
/// When the file cannot be written.
pub fn draw_miss(figure: &ErrorFigure, path: &Path) -> Result<(), ReportError> {
    let size = (PANEL.0 * figure.panels.len().max(1) as u32, TITLE_HEIGHT + PANEL.1);
    let svg = canvas(size, &figure.title, |_, rest| {
        let points = || figure.panels.iter().flat_map(|p| &p.curves).flat_map(|c| &c.1).flatten();
        let end = points().map(|p| p.0).fold(0.0, f64::max);
        // To one scale, so that panels can be compared.
        let top = points().map(|p| p.1).filter(|&y| drawable(y)).fold(0.0, f64::max);
        for (panel, area) in figure.panels.iter().zip(rest.split_evenly((1, figure.panels.len().max(1)))) {
            let (head, area) = area.split_vertically(px(22));
            let style = anchored(font(13.5, INK), HPos::Left, VPos::Center);
            head.draw(&Text::new(panel.name.clone(), (px(84), px(11)), style)).map_err(refused)?;
            let colours = [VERMILION, BLUE, GREY, SKY];
            let band = |((name, runs), colour): (&(String, Vec<_>), RGBColor)| Band::of(name, colour, runs);
            let bands: Vec<Band> = panel.curves.iter().zip(colours).map(band).collect();
            let axes = Axes {
                end: if end > 0.0 { end } else { 1.0 },
                top,
                x: Some("trials (millions)".to_owned()),
                y: figure.y.clone(),
                mark: None,
                levels: &figure.levels,
            };
            bands::draw(&bands, &axes, &area)?;
        }
        Ok(())
    })?;
    write(path, &svg)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn panels_stand_side_by_side() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("figure.svg");
        let curve = |y: f64| vec![vec![(0.1, y), (0.2, y / 2.0)], vec![(0.1, y), (0.2, y / 3.0)]];
        let panel = |name: &str| ErrorPanel {
            name: name.to_owned(),
            curves: vec![("scalar".to_owned(), curve(0.4)), ("topographic".to_owned(), curve(0.3))],
        };
        let figure = ErrorFigure {
            title: "Saccades".to_owned(),
            panels: vec![panel("linear retina"), panel("log-polar retina")],
            levels: vec![(0.05, "noise alone".to_owned())],
            y: "mean error".to_owned(),
        };
        draw_miss(&figure, &path).unwrap();
        let svg = std::fs::read_to_string(&path).unwrap();
        for words in
            ["Saccades", "linear retina", "log-polar retina", "topographic", "noise alone", "trials (millions)"]
        {
            assert!(svg.contains(words), "{words}");
        }
        draw_miss(&ErrorFigure { panels: Vec::new(), ..figure }, &path).unwrap();
    }
}
