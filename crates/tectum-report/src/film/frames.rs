//! The film frame by frame, as pixels: the same picture as the SVG, for files that hold pixels.

use super::drawing::{distances, interval, mean_distance, speed};
use super::keyframes::Timeline;
use super::layout::{
    CURVE_BOTTOM, CURVE_LEFT, CURVE_RIGHT, CURVE_TOP, CurveAxes, DOTS_M, FOOTER, HEIGHT, PADDING, PANEL_HEIGHT,
    PANEL_WIDTH, Pixel, SCENE_BOTTOM, View, WIDTH, panel_corner,
};
use super::raster::{CoverageMask, Raster, Rgb};
use super::{Film, FilmPanel, centimetres, seconds};

pub(super) const PAGE: Rgb = [0x0b, 0x10, 0x16];
pub(super) const PANEL: Rgb = [0x13, 0x1a, 0x22];
const TEXT: Rgb = [0xe6, 0xed, 0xf3];
const MUTED: Rgb = [0x9f, 0xb0, 0xc0];
const START: Rgb = [0x33, 0x41, 0x4f];
const ARM: Rgb = [0xdf, 0xe7, 0xee];
const END: Rgb = [0x56, 0xb4, 0xe9];
const TARGET: Rgb = [0xf0, 0xa3, 0x0a];
const BLOCKED: Rgb = [0xe5, 0x8f, 0xc0];
const AXIS: Rgb = [0x3d, 0x4c, 0x5c];
const DOTS: Rgb = [0x36, 0x45, 0x54];
/// What is drawn on the page and on the panels.
pub(super) const COLOURS: [Rgb; 9] = [TEXT, MUTED, START, ARM, END, TARGET, BLOCKED, AXIS, DOTS];
/// What moves over what.
pub(super) const CROSSINGS: [[Rgb; 2]; 4] = [[END, ARM], [TARGET, ARM], [TARGET, END], [BLOCKED, ARM]];

/// Characters of a line of the footer, and the distance of its lines, px.
const FOOTER_CHARACTERS: usize = 130;
const LINE_HEIGHT: f64 = 18.0;

/// The frames of a film, in order.
#[derive(Debug)]
pub struct FilmFrames<'a> {
    timeline: Timeline,
    panels: Vec<PanelFrames<'a>>,
    page: Raster,
    next: u64,
}

/// A panel, as far as the film has come.
#[derive(Debug)]
struct PanelFrames<'a> {
    panel: &'a FilmPanel,
    view: View,
    /// What does not move.
    still: Raster,
    /// Places of the distance's curve, one a tick.
    curve: Vec<Pixel>,
    /// The ways of end-effector and curve up to the tick `drawn`.
    trails: [CoverageMask; 2],
    drawn: usize,
}

impl<'a> FilmFrames<'a> {
    pub(super) fn new(film: &'a Film) -> Self {
        let longest = film.panels.iter().map(|panel| panel.reach.ticks()).max().unwrap_or(1);
        let timeline = Timeline::new(longest, film.period_s);
        let farthest = film.panels.iter().flat_map(distances).fold(0.0, f64::max);
        let (view, axes) = (View::of(film), CurveAxes::new(longest, farthest));
        let panels = film.panels.iter().map(|panel| PanelFrames::new(film, panel, view, &axes));
        Self { panels: panels.collect(), page: page(film, &timeline), timeline, next: 0 }
    }

    /// Width and height, px.
    pub fn size(&self) -> [usize; 2] {
        self.page.size()
    }

    /// How many frames there are.
    pub fn count(&self) -> u64 {
        self.timeline.frames()
    }

    /// How long a frame is shown, s.
    pub fn frame_s(&self) -> f64 {
        self.timeline.loop_s / self.count() as f64
    }

    /// Draws the next frame: its pixels, red, green and blue, row by row from the upper left corner. `None` after the
    /// last one.
    pub fn draw_next(&mut self) -> Option<&[[u8; 3]]> {
        if self.next == self.count() {
            return None;
        }
        for (i, panel) in self.panels.iter_mut().enumerate() {
            let ticks = panel.panel.reach.ticks();
            let picture = panel.draw(self.timeline.tick(self.next, ticks));
            self.page.paste(&picture, panel_corner(i).map(|x| x as usize));
        }
        self.next += 1;
        Some(self.page.pixels())
    }
}

/// The page around the panels: the legend, and where the film comes from.
fn page(film: &Film, timeline: &Timeline) -> Raster {
    let source = lines(&film.choice);
    // An even height, which video needs.
    let height = HEIGHT + LINE_HEIGHT * source.len().saturating_sub(1) as f64;
    let mut page = Raster::new([WIDTH as usize, height as usize], PAGE);
    let [legend, below] = FOOTER;
    let middle = legend - 4.5;
    let mut x = 22.0;
    let mut item = |page: &mut Raster, name: &str, draw: &dyn Fn(&mut Raster, Pixel)| {
        draw(page, [x, middle]);
        page.text([x + 14.0, legend], name, TEXT, false, false);
        x += 14.0 + 8.0 * name.len() as f64 + 18.0;
    };
    item(&mut page, "target", &|page, at| page.draw(TARGET, |shape| shape.ring(at, 6.0, 3.0)));
    item(&mut page, "end-effector", &|page, at| page.draw(END, |shape| shape.disc(at, 5.5)));
    if film.panels.iter().any(|panel| !panel.blocked.is_empty()) {
        item(&mut page, "blocked", &|page, at| blocked(page, at, PAGE));
    }
    let line = |[x, y]: Pixel| [[x - 6.0, y + 4.0], [x + 6.0, y - 4.0]];
    item(&mut page, "at the start", &|page, at| page.draw(START, |shape| shape.line(&line(at), 5.0)));
    item(&mut page, "0.5 m apart", &|page, at| page.draw(MUTED, |shape| shape.disc(at, 1.6)));
    let origin = format!("{}, seed {}, {}", film.scenario, film.seed, speed(timeline.speed));
    page.text([WIDTH - 22.0, legend], &origin, MUTED, false, true);
    for (i, line) in source.iter().enumerate() {
        page.text([16.0, below + LINE_HEIGHT * i as f64], line, MUTED, false, false);
    }
    page
}

/// A text in lines that fit the page.
fn lines(text: &str) -> Vec<String> {
    let mut lines = vec![String::new()];
    for word in text.split_whitespace() {
        let line = lines.last_mut().expect("there is a first line");
        if !line.is_empty() && line.chars().count() + 1 + word.chars().count() > FOOTER_CHARACTERS {
            lines.push(word.to_owned());
        } else {
            let space = if line.is_empty() { "" } else { " " };
            *line += &format!("{space}{word}");
        }
    }
    lines
}

/// The mark of a blocked joint, on a ground of this colour.
fn blocked(raster: &mut Raster, [x, y]: Pixel, ground: Rgb) {
    let square =
        |half: f64| move |shape: &mut CoverageMask| shape.rectangle([x - half, y - half], [x + half, y + half], 2.0);
    raster.draw(BLOCKED, square(9.2));
    raster.draw(ground, square(6.8));
    raster.draw(BLOCKED, |shape| {
        shape.segment([x - 4.0, y - 4.0], [x + 4.0, y + 4.0], 2.5);
        shape.segment([x + 4.0, y - 4.0], [x - 4.0, y + 4.0], 2.5);
    });
}

impl<'a> PanelFrames<'a> {
    fn new(film: &Film, panel: &'a FilmPanel, view: View, axes: &CurveAxes) -> Self {
        let size = [PANEL_WIDTH as usize, PANEL_HEIGHT as usize];
        let mut still = Raster::new(size, PAGE);
        still.draw(PANEL, |shape| shape.rectangle([0.0, 0.0], [PANEL_WIDTH, PANEL_HEIGHT], 8.0));
        heading(&mut still, film, panel);
        dots(&mut still, &view);
        let begin: Vec<Pixel> = panel.reach.reach.postures[0].iter().map(|&place| view.pixel(place)).collect();
        still.draw(START, |shape| shape.line(&begin, 5.0));
        still.draw(TARGET, |shape| shape.ring(view.pixel(panel.reach.reach.target), 10.0, 3.0));
        draw_axes(&mut still, film, panel, axes);
        let curve = distances(panel).enumerate().map(|(tick, distance)| axes.pixel(tick, distance)).collect();
        let trails = [CoverageMask::new(size), CoverageMask::new(size)];
        Self { panel, view, still, curve, trails, drawn: 0 }
    }

    /// The panel at a tick, not before the one that was drawn last.
    fn draw(&mut self, tick: usize) -> Raster {
        let reach = &self.panel.reach.reach;
        let arm: Vec<Pixel> = reach.postures[tick].iter().map(|&place| self.view.pixel(place)).collect();
        let end = |tick: usize| reach.postures[tick].last().map_or([0.0; 2], |&place| self.view.pixel(place));
        for next in self.drawn..tick {
            self.trails[0].segment(end(next), end(next + 1), 2.0);
            self.trails[1].segment(self.curve[next], self.curve[next + 1], 2.0);
        }
        self.drawn = self.drawn.max(tick);
        let mut picture = self.still.clone();
        picture.fill(&self.trails[0], END, 0.6);
        picture.fill(&self.trails[1], END, 1.0);
        picture.draw(ARM, |shape| shape.line(&arm, 6.0));
        if let [base, joints @ .., end] = &arm[..] {
            let [x, y] = *base;
            picture.draw(MUTED, |shape| {
                shape.triangle([[x, y], [x + 10.0, y + 12.0], [x - 10.0, y + 12.0]]);
                shape.segment([x - 15.0, y + 12.0], [x + 15.0, y + 12.0], 3.0);
            });
            for (joint, radius) in joints.iter().map(|joint| (joint, 4.5)).chain([(base, 5.0)]) {
                picture.draw(ARM, |shape| shape.disc(*joint, radius + 1.25));
                picture.draw(PANEL, |shape| shape.disc(*joint, radius - 1.25));
            }
            picture.draw(PANEL, |shape| shape.disc(*end, 6.2));
            picture.draw(END, |shape| shape.disc(*end, 5.0));
        }
        self.panel.blocked.iter().for_each(|&joint| blocked(&mut picture, arm[joint - 1], PANEL));
        picture.draw(END, |shape| shape.disc(self.curve[tick], 4.0));
        picture
    }
}

fn heading(still: &mut Raster, film: &Film, panel: &FilmPanel) {
    still.text([PADDING, 30.0], &panel.caption, TEXT, true, false);
    let remark = if panel.remark.is_empty() { String::new() } else { format!(", {}", panel.remark) };
    still.text([PADDING, 51.0], &(interval(film, panel) + &remark), MUTED, false, false);
}

/// Dots at round places, one of them at the origin.
fn dots(still: &mut Raster, view: &View) {
    let (side, origin) = (DOTS_M * view.scale, view.pixel([0.0, 0.0]));
    // A scene that is far too large for its dots has none.
    if side < 4.0 {
        return;
    }
    let places = |from: f64, to: f64, origin: f64| {
        let first = ((from - origin) / side).ceil();
        (0..).map(move |i| origin + side * (first + f64::from(i))).take_while(move |x| *x <= to)
    };
    for x in places(0.0, PANEL_WIDTH, origin[0]) {
        for y in places(60.0, SCENE_BOTTOM, origin[1]) {
            still.draw(DOTS, |shape| shape.disc([x, y], 1.3));
        }
    }
}

/// The axes of the curve and the words around it.
fn draw_axes(still: &mut Raster, film: &Film, panel: &FilmPanel, axes: &CurveAxes) {
    let (left, right, top, bottom) = (CURVE_LEFT, CURVE_RIGHT, CURVE_TOP, CURVE_BOTTOM);
    let (above, below) = (top - 14.0, bottom + 17.0);
    let mean = format!("distance: mean {}", centimetres(mean_distance(panel)));
    still.text([PADDING, above], &mean, MUTED, false, false);
    let end = format!("end {}", centimetres(panel.reach.end_error_m));
    still.text([right, above], &end, TEXT, false, true);
    still.draw(AXIS, |shape| shape.line(&[[left, top], [left, bottom], [right, bottom]], 1.0));
    let top_m = (axes.top_m * 1e4).round() / 1e4;
    still.text([left - 5.0, top + 9.0], &format!("{top_m} m"), MUTED, false, true);
    still.text([left - 5.0, bottom], "0", MUTED, false, true);
    still.text([left, below], "0 s", MUTED, false, false);
    still.text([right, below], &seconds(axes.ticks as f64 * film.period_s), MUTED, false, true);
}
