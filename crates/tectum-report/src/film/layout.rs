//! Where things stand in the film, in pixels, and how metres become pixels: the same way in all panels.

use super::Film;

/// A place in the film, px from its upper left corner or from that of its panel.
pub(super) type Pixel = [f64; 2];

pub(super) const WIDTH: f64 = 960.0;
pub(super) const HEIGHT: f64 = 500.0;
const MARGIN: f64 = 16.0;
const GAP: f64 = 14.0;
pub(super) const PANEL_WIDTH: f64 = 300.0;
pub(super) const PANEL_HEIGHT: f64 = 428.0;
/// Inner margin of a panel.
pub(super) const PADDING: f64 = 16.0;
/// Where the footer's lines stand.
pub(super) const FOOTER: [f64; 2] = [466.0, 486.0];

/// The arm is drawn between these heights of its panel.
const SCENE_TOP: f64 = 70.0;
pub(super) const SCENE_BOTTOM: f64 = 306.0;
/// The curve of the distance to the target lies in this box of its panel.
pub(super) const CURVE_LEFT: f64 = 46.0;
pub(super) const CURVE_RIGHT: f64 = PANEL_WIDTH - PADDING;
pub(super) const CURVE_TOP: f64 = 352.0;
pub(super) const CURVE_BOTTOM: f64 = 400.0;
/// Distance between the dots behind the arm, m.
pub(super) const DOTS_M: f64 = 0.5;
/// Room around the arm for the target's ring and the width of the segments, px.
const ROOM: f64 = 16.0;

/// The left upper corner of a panel.
pub(super) fn panel_corner(panel: usize) -> Pixel {
    [MARGIN + panel as f64 * (PANEL_WIDTH + GAP), MARGIN]
}

/// From metres to pixels of a panel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct View {
    /// px a metre.
    pub scale: f64,
    /// What stands in the middle of the scene, m.
    centre: [f64; 2],
}

impl View {
    /// A view that holds everything in the film's reaches.
    pub fn of(film: &Film) -> Self {
        let mut low = [f64::INFINITY; 2];
        let mut high = [f64::NEG_INFINITY; 2];
        let reaches = film.panels.iter().map(|panel| &panel.reach.reach);
        for p in reaches.flat_map(|reach| reach.postures.iter().flatten().chain([&reach.target])) {
            for axis in 0..2 {
                low[axis] = low[axis].min(p[axis]);
                high[axis] = high[axis].max(p[axis]);
            }
        }
        let room = [PANEL_WIDTH, SCENE_BOTTOM - SCENE_TOP].map(|side| side - 2.0 * ROOM);
        // A single point has no extent.
        let scale = (0..2).map(|axis| room[axis] / (high[axis] - low[axis]).max(1e-6)).fold(f64::INFINITY, f64::min);
        Self { scale, centre: [0, 1].map(|axis| (low[axis] + high[axis]) / 2.0) }
    }

    /// A place in a panel.
    pub fn pixel(&self, place: [f64; 2]) -> Pixel {
        [
            PANEL_WIDTH / 2.0 + self.scale * (place[0] - self.centre[0]),
            (SCENE_TOP + SCENE_BOTTOM) / 2.0 - self.scale * (place[1] - self.centre[1]),
        ]
    }
}

/// The axes of the curves of the distance to the target.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct CurveAxes {
    /// Ticks of the longest reach.
    pub ticks: u64,
    /// Distance at the upper end, m.
    pub top_m: f64,
}

impl CurveAxes {
    /// Axes for reaches of up to `ticks` ticks and distances of up to `farthest` metres.
    pub fn new(ticks: u64, farthest: f64) -> Self {
        let step = 10_f64.powf(farthest.max(1e-6).log10().floor()) / 2.0;
        // A round distance is its own top, however its quotient is rounded.
        Self { ticks: ticks.max(1), top_m: (farthest / step - 1e-9).ceil().max(1.0) * step }
    }

    /// Where a distance after so many ticks stands in a panel.
    pub fn pixel(&self, tick: usize, distance: f64) -> Pixel {
        [
            CURVE_LEFT + (CURVE_RIGHT - CURVE_LEFT) * tick as f64 / self.ticks as f64,
            CURVE_BOTTOM - (CURVE_BOTTOM - CURVE_TOP) * distance / self.top_m,
        ]
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::film;
    use super::*;

    #[test]
    fn everything_is_in_the_scene_and_a_metre_is_a_metre() {
        let film = film();
        let view = View::of(&film);
        for panel in &film.panels {
            for place in panel.reach.reach.postures.iter().flatten() {
                let [x, y] = view.pixel(*place);
                assert!((0.0..=PANEL_WIDTH).contains(&x) && (SCENE_TOP..=SCENE_BOTTOM).contains(&y));
            }
        }
        let [[x0, y0], [x1, y1]] = [[0.0, 0.0], [1.0, 1.0]].map(|place| view.pixel(place));
        assert!((x1 - x0 - view.scale).abs() < 1e-9 && (y0 - y1 - view.scale).abs() < 1e-9);
    }

    #[test]
    fn axes_end_at_a_round_number() {
        let top = |farthest| (1000.0 * CurveAxes::new(80, farthest).top_m).round();
        assert_eq!([0.0, 0.07, 0.42, 1.0, 1.31, 2.6].map(top), [0.0, 70.0, 450.0, 1000.0, 1500.0, 3000.0]);
    }
}
