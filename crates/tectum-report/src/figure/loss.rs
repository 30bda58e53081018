//! The paper's figure 4: cumulative loss of several runs, and the arm at four target switches.

use super::bands::{Axes, Band};
use super::curves::TimeAxis;
use super::*;
use crate::Reach;
use crate::stats::Window;

/// Size, pixels.
const SIZE: (u32, u32) = (1240, 640);
const CURVES: u32 = 640;
const CAPTION: u32 = 24;

/// What the figure shows.
#[derive(Debug, Clone)]
pub struct LossFigure {
    /// Title.
    pub title: String,
    /// Period of a tick, s.
    pub period_s: f64,
    /// Windows of equal length, run by run.
    pub runs: Vec<Vec<Window>>,
    /// The same runs under another assumption, with its name; none, if there is nothing to compare with.
    pub other: Option<(String, Vec<Vec<Window>>)>,
    /// A tick at which something happened, and what.
    pub mark: Option<(u64, String)>,
    /// Target switches with their captions, in m; up to four.
    pub reaches: Vec<(String, Reach)>,
}

/// Draws it into a file.
///
/// # Errors
/// When the file cannot be written.
pub fn draw_loss(figure: &LossFigure, path: &Path) -> Result<(), ReportError> {
    let svg = canvas(SIZE, &figure.title, |strip, rest| {
        let (left, right) = rest.split_horizontally(px(CURVES));
        curves(figure, &left)?;
        if !figure.reaches.is_empty() {
            postures::legend(strip, px(CURVES))?;
        }
        let frame = postures::frame(&figure.reaches.iter().map(|(n, r)| (n.as_str(), r)).collect::<Vec<_>>());
        for ((name, reach), area) in figure.reaches.iter().zip(right.split_evenly((2, 2))) {
            let (head, panel) = area.split_vertically(px(CAPTION));
            let style = anchored(font(12.5, INK), HPos::Left, VPos::Center);
            let text = format!("{name}: from tick {}", crate::text::thousands(reach.from));
            head.draw(&Text::new(text, (px(46), px(CAPTION) / 2), style)).map_err(refused)?;
            postures::panel("m", reach, frame.0, frame.1, &panel)?;
        }
        Ok(())
    })?;
    write(path, &svg)
}

fn curves(figure: &LossFigure, area: &Area) -> Result<(), ReportError> {
    let ticks = figure.runs.iter().flatten().map(|w| w.from + w.ticks).max().unwrap_or(0);
    let clock = TimeAxis::new(ticks, figure.period_s);
    let cumulative = |run: &Vec<Window>| {
        let mut sum = 0.0;
        let mut points = vec![(0.0, 0.0)];
        points.extend(run.iter().map(|w| {
            sum += w.loss * w.ticks as f64;
            (clock.at(w.from + w.ticks), sum / 1000.0)
        }));
        points
    };
    let each = |runs: &[Vec<Window>], value: &dyn Fn(&Window) -> f64| -> Vec<Polyline> {
        runs.iter().map(|run| run.iter().map(|w| (clock.middle(w), value(w))).collect()).collect()
    };
    let mark = figure.mark.as_ref().map(|(tick, what)| (clock.at(*tick), what.as_str()));
    let (upper, lower) = area.split_vertically(px((SIZE.1 - TITLE_HEIGHT) / 2));
    let sums: Vec<_> = figure.runs.iter().map(cumulative).collect();
    let y = "cumulative loss (thousands)".to_owned();
    let axes = Axes { end: clock.end, x: None, top: 0.0, y, mark, levels: &[] };
    // The other curves first: up to where they part, they lie below.
    let other = figure.other.iter();
    let mut cumulatives: Vec<Band> = other
        .clone()
        .map(|(name, runs)| Band::of(name, ORANGE, &runs.iter().map(cumulative).collect::<Vec<_>>()))
        .collect();
    cumulatives.push(Band::of("cumulative loss", BLUE, &sums));
    bands::draw(&cumulatives, &axes, &upper)?;
    let mut losses: Vec<Band> = other.map(|(name, runs)| Band::of(name, ORANGE, &each(runs, &|w| w.loss))).collect();
    losses.push(Band::of("with exploration noise", GREY, &each(&figure.runs, &|w| w.loss)));
    losses.push(Band::of("without", BLUE, &each(&figure.runs, &Window::loss_without_noise)));
    let axes = Axes {
        x: Some(clock.label()),
        top: 0.0,
        y: "loss per tick".to_owned(),
        mark: mark.map(|(x, _)| (x, "")),
        end: clock.end,
        levels: &[],
    };
    bands::draw(&losses, &axes, &lower)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tests::arm_history;

    #[test]
    fn the_figure_shows_loss_mark_and_postures() {
        let history = arm_history();
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("figure.svg");
        let reach = history.first_reach.clone().unwrap();
        let figure = LossFigure {
            title: "Two seeds".into(),
            period_s: 0.05,
            runs: vec![history.windows.clone(), history.windows[..60].to_vec()],
            other: Some(("with a fine".into(), vec![history.windows.clone()])),
            mark: Some((9_300_000, "joint 3 blocked".into())),
            reaches: vec![("(a) at first".into(), reach)],
        };
        draw_loss(&figure, &path).unwrap();
        let svg = std::fs::read_to_string(&path).unwrap();
        for words in
            ["Two seeds", "with a fine", "cumulative loss (thousands)", "joint 3 blocked", "(a) at first: from tick 80"]
        {
            assert!(svg.contains(words), "{words}");
        }
        // Nothing to show is still a figure.
        draw_loss(&LossFigure { runs: Vec::new(), other: None, reaches: Vec::new(), ..figure }, &path).unwrap();
    }
}
