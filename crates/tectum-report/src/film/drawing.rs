//! The film as SVG text: a dark card with three panels, readable on light and dark pages alike.
//!
//! Colours are those of Okabe and Ito, which colour-blind readers can tell apart. Target, end-effector and blocked
//! joint differ in shape too.

use std::fmt::Write as _;

use super::keyframes::{Timeline, Trail, coordinate, point, points};
use super::layout::{
    CURVE_BOTTOM, CURVE_LEFT, CURVE_RIGHT, CURVE_TOP, CurveAxes, DOTS_M, FOOTER, HEIGHT, PADDING, PANEL_HEIGHT,
    PANEL_WIDTH, Pixel, SCENE_BOTTOM, View, WIDTH, panel_corner,
};
use super::{Film, FilmPanel, centimetres, seconds};

const STYLE: &str = "\
text{font-family:system-ui,-apple-system,'Segoe UI',Roboto,'Helvetica Neue',Arial,sans-serif}\
text{fill:#e6edf3;font-size:13px}\
.caption{font-size:18px;font-weight:600}\
.muted{fill:#9fb0c0}\
.small{fill:#9fb0c0;font-size:12px}\
.error{font-size:18px;font-weight:600;fill:#e6edf3}\
.end{text-anchor:end}\
.start{fill:none;stroke:#33414f;stroke-width:5;stroke-linecap:round;stroke-linejoin:round}\
.arm{fill:none;stroke:#dfe7ee;stroke-width:6;stroke-linecap:round;stroke-linejoin:round}\
.trail{fill:none;stroke:#56b4e9;stroke-width:2;stroke-opacity:.6;stroke-linecap:round;stroke-linejoin:round}\
.target{fill:none;stroke:#f0a30a;stroke-width:3}\
.curve{fill:none;stroke:#56b4e9;stroke-width:2;stroke-linejoin:round}\
.axis{fill:none;stroke:#3d4c5c;stroke-width:1}\
.still{display:none}\
@media (prefers-reduced-motion:reduce){.still{display:inline}.moving{display:none}}";

/// Shapes that are drawn more than once: joints and base are markers of the arm's line, so that they move with it.
const SHAPES: &str = "\
<marker id=\"joint\" markerUnits=\"userSpaceOnUse\" markerWidth=\"14\" markerHeight=\"14\" refX=\"7\" refY=\"7\">\
<circle cx=\"7\" cy=\"7\" r=\"4.5\" fill=\"#131a22\" stroke=\"#dfe7ee\" stroke-width=\"2.5\"/></marker>\
<marker id=\"base\" markerUnits=\"userSpaceOnUse\" markerWidth=\"36\" markerHeight=\"24\" refX=\"18\" refY=\"8\">\
<path d=\"M3 20H33\" stroke=\"#9fb0c0\" stroke-width=\"3\" stroke-linecap=\"round\"/>\
<path d=\"M18 8L8 20H28Z\" fill=\"#9fb0c0\"/>\
<circle cx=\"18\" cy=\"8\" r=\"5\" fill=\"#131a22\" stroke=\"#dfe7ee\" stroke-width=\"2.5\"/></marker>\
<marker id=\"end\" markerUnits=\"userSpaceOnUse\" markerWidth=\"16\" markerHeight=\"16\" refX=\"8\" refY=\"8\">\
<circle cx=\"8\" cy=\"8\" r=\"5.5\" fill=\"#56b4e9\" stroke=\"#131a22\" stroke-width=\"1.5\"/></marker>";

/// A blocked joint: a square with a cross around the origin.
const BLOCKED: &str = "\
<rect x=\"-8\" y=\"-8\" width=\"16\" height=\"16\" rx=\"2\" fill=\"#131a22\" stroke=\"#e58fc0\" stroke-width=\"2.5\"/>\
<path d=\"M-4 -4L4 4M4 -4L-4 4\" stroke=\"#e58fc0\" stroke-width=\"2.5\" stroke-linecap=\"round\"/>";

/// The film as an SVG document.
pub(super) fn svg(film: &Film) -> String {
    let longest = film.panels.iter().map(|panel| panel.reach.ticks()).max().unwrap_or(1);
    let timeline = Timeline::new(longest, film.period_s);
    let view = View::of(film);
    let farthest = film.panels.iter().flat_map(distances).fold(0.0, f64::max);
    let axes = CurveAxes::new(longest, farthest);
    let mut svg = String::new();
    let _ = write!(
        svg,
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{WIDTH}\" height=\"{HEIGHT}\" \
         viewBox=\"0 0 {WIDTH} {HEIGHT}\" \
         role=\"img\">\n<title>{}</title>\n<desc>{}</desc>\n<style>{STYLE}</style>\n<defs>{SHAPES}{}</defs>\n\
         <rect width=\"{WIDTH}\" height=\"{HEIGHT}\" rx=\"12\" fill=\"#0b1016\"/>\n",
        escaped(&title(film)),
        escaped(&description(film)),
        dots(&view),
    );
    for (i, panel) in film.panels.iter().enumerate() {
        let picture = PanelPicture { film, panel, timeline: &timeline, view: &view, axes: &axes };
        let [x, y] = panel_corner(i);
        let _ = write!(svg, "<g transform=\"translate({x} {y})\">\n{}</g>\n", picture.draw());
    }
    svg + &footer(film, &timeline) + "</svg>\n"
}

fn title(film: &Film) -> String {
    format!("Three reaches of the arm in the run {}, seed {}", film.scenario, film.seed)
}

/// The film in words, for those who cannot see it.
fn description(film: &Film) -> String {
    let panel = |panel: &FilmPanel| {
        let error = centimetres(panel.reach.end_error_m);
        let mean = centimetres(mean_distance(panel));
        let when = interval(film, panel);
        format!(
            "{} ({when}): the end-effector is {mean} from the target on average, {error} at the end.",
            panel.caption
        )
    };
    film.panels.iter().map(panel).collect::<Vec<_>>().join(" ")
}

/// `12 to 16 s`.
pub(super) fn interval(film: &Film, panel: &FilmPanel) -> String {
    let [from, to] = panel.seconds(film.period_s).map(seconds);
    format!("{} to {to}", from.trim_end_matches(" s"))
}

/// The pattern of dots behind the arms, with a dot at the origin.
fn dots(view: &View) -> String {
    let side = DOTS_M * view.scale;
    let [x, y] = view.pixel([0.0, 0.0]).map(|x| x - side / 2.0);
    format!(
        "<pattern id=\"dots\" patternUnits=\"userSpaceOnUse\" x=\"{x:.2}\" y=\"{y:.2}\" width=\"{side:.3}\" \
         height=\"{side:.3}\"><circle cx=\"{0:.2}\" cy=\"{0:.2}\" r=\"1.3\" fill=\"#364554\"/></pattern>",
        side / 2.0
    )
}

/// What the shapes mean, and where the film comes from.
fn footer(film: &Film, timeline: &Timeline) -> String {
    let [legend, source] = FOOTER;
    let mut text = format!("<g transform=\"translate(22 {})\">", legend - 4.5);
    let blocked = film.panels.iter().any(|panel| !panel.blocked.is_empty());
    let mut x = 0.0;
    let mut item = |shape: &str, name: &str, width: f64| {
        let _ = write!(text, "<g transform=\"translate({x} 0)\">{shape}<text x=\"16\" y=\"4.5\">{name}</text></g>");
        x += width;
    };
    item("<circle r=\"6\" class=\"target\"/>", "target", 80.0);
    item("<circle r=\"5.5\" fill=\"#56b4e9\"/>", "end-effector", 116.0);
    if blocked {
        item(&format!("<g transform=\"scale(.85)\">{BLOCKED}</g>"), "blocked joint", 120.0);
    }
    item("<path d=\"M-6 4L6 -4\" class=\"start\"/>", "posture at the start", 156.0);
    item("<circle r=\"1.6\" fill=\"#9fb0c0\"/>", "dots 0.5 m apart", 0.0);
    let right = WIDTH - 22.0;
    let _ = write!(
        text,
        "</g>\n<text class=\"muted end\" x=\"{right}\" y=\"{legend}\">{}</text>\n\
         <text class=\"muted\" x=\"16\" y=\"{source}\">{}</text>\n",
        escaped(&format!("{}, seed {}, {}", film.scenario, film.seed, speed(timeline.speed))),
        escaped(&film.choice),
    );
    text
}

/// The film's speed in words.
pub(super) fn speed(speed: f64) -> String {
    match speed {
        1.0 => "in real time".to_owned(),
        fast if fast > 1.0 => format!("{fast:.1} times real speed"),
        slow => format!("1/{:.0} of real speed", 1.0 / slow),
    }
}

/// Distance from the end-effector to the target at the beginning of each tick and at the end of the last, m.
pub(super) fn distances(panel: &FilmPanel) -> impl Iterator<Item = f64> {
    let target = panel.reach.reach.target;
    let ends = panel.reach.reach.postures.iter().filter_map(|posture| posture.last());
    ends.map(move |end| (end[0] - target[0]).hypot(end[1] - target[1]))
}

/// Mean of the distances at the ends of the reach's ticks, m.
pub(super) fn mean_distance(panel: &FilmPanel) -> f64 {
    distances(panel).skip(1).sum::<f64>() / panel.reach.ticks().max(1) as f64
}

/// All that one panel is drawn from.
struct PanelPicture<'a> {
    film: &'a Film,
    panel: &'a FilmPanel,
    timeline: &'a Timeline,
    view: &'a View,
    axes: &'a CurveAxes,
}

impl PanelPicture<'_> {
    fn draw(&self) -> String {
        let mut text = self.heading();
        text += &self.scene();
        text += &self.curve();
        text
    }

    fn heading(&self) -> String {
        let remark = match self.panel.remark.as_str() {
            "" => String::new(),
            remark => format!(", {remark}"),
        };
        format!(
            "<rect width=\"{PANEL_WIDTH}\" height=\"{PANEL_HEIGHT}\" rx=\"8\" fill=\"#131a22\"/>\n\
             <text class=\"caption\" x=\"{PADDING}\" y=\"30\">{}</text>\n\
             <text class=\"muted\" x=\"{PADDING}\" y=\"51\">{}</text>\n\
             <rect y=\"60\" width=\"{PANEL_WIDTH}\" height=\"{}\" fill=\"url(#dots)\"/>\n",
            escaped(&self.panel.caption),
            escaped(&(interval(self.film, self.panel) + &remark)),
            SCENE_BOTTOM - 60.0,
        )
    }

    /// The arm: where it begins, faintly, then the target, the path and the arm itself.
    fn scene(&self) -> String {
        let reach = &self.panel.reach.reach;
        let pixels = |tick: usize| reach.postures[tick].iter().map(|&place| self.view.pixel(place));
        let line = |tick: usize| {
            let mut text = String::new();
            points(&mut text, pixels(tick));
            text
        };
        let last = self.panel.reach.ticks() as usize;
        let ends: Vec<Pixel> = (0..=last).filter_map(|tick| pixels(tick).next_back()).collect();
        let [x, y] = self.view.pixel(reach.target);
        let mut text = format!(
            "<polyline class=\"start\" points=\"{}\"/>\n\
             <circle class=\"target\" cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"10\"/>\n",
            line(0)
        );
        let arm = format!(
            "<polyline class=\"arm\" marker-start=\"url(#base)\" marker-mid=\"url(#joint)\" marker-end=\"url(#end)\" \
             points=\"{}\"",
            line(last)
        );
        let moved = self.animate("points", |text, tick| points(text, pixels(tick)));
        let (still_trail, moving_trail) = self.trail("trail", &ends);
        let _ = writeln!(text, "<g class=\"still\">{still_trail}{arm}/>{}</g>", self.blocked_joints(false));
        let _ = write!(
            text,
            "<g class=\"moving\">{}{moving_trail}\n{arm}>{moved}</polyline>\n{}</g>\n",
            self.fade(),
            self.blocked_joints(true)
        );
        text
    }

    /// Marks on the blocked joints, on the last posture or moving with the arm.
    fn blocked_joints(&self, moving: bool) -> String {
        let postures = &self.panel.reach.reach.postures;
        let last = self.panel.reach.ticks() as usize;
        let mut text = String::new();
        for &joint in &self.panel.blocked {
            let place = |tick: usize| self.view.pixel(postures[tick][joint - 1]);
            text += &self.shifted(BLOCKED, last, moving, place);
        }
        text
    }

    /// `shape` at its place in tick `last`, or moving along its places.
    fn shifted(&self, shape: &str, last: usize, moving: bool, place: impl Fn(usize) -> Pixel) -> String {
        let mut text = "<g transform=\"translate(".to_owned();
        point(&mut text, place(last));
        text += ")\">";
        if moving {
            let ticks = self.panel.reach.ticks();
            let values = self.timeline.values(ticks, |text, tick| point(text, place(tick)));
            let _ = write!(
                text,
                "<animateTransform attributeName=\"transform\" type=\"translate\" dur=\"{}s\" \
                 repeatCount=\"indefinite\" values=\"{values}\"/>",
                self.timeline.loop_s
            );
        }
        text + shape + "</g>"
    }

    /// An animation of an attribute of the element that it stands in.
    fn animate(&self, attribute: &str, write: impl FnMut(&mut String, usize)) -> String {
        let values = self.timeline.values(self.panel.reach.ticks(), write);
        format!(
            "<animate attributeName=\"{attribute}\" dur=\"{}s\" repeatCount=\"indefinite\" values=\"{values}\"/>",
            self.timeline.loop_s
        )
    }

    /// Hides the jump from the end of the reach to its beginning.
    fn fade(&self) -> String {
        format!(
            "<animate attributeName=\"opacity\" dur=\"{}s\" repeatCount=\"indefinite\" values=\"0;1;1;0\" \
             keyTimes=\"0;.03;.97;1\"/>",
            self.timeline.loop_s
        )
    }

    /// A line through `places`, whole and growing. It grows as a dash that is shifted along the line.
    fn trail(&self, class: &str, places: &[Pixel]) -> (String, String) {
        let trail = Trail::new(places, &self.timeline.ticks(self.panel.reach.ticks()));
        let line = format!("<polyline class=\"{class}\" points=\"{}\"", trail.points);
        let dash = trail.dash();
        let grown = self.animate("stroke-dashoffset", |text, tick| coordinate(text, trail.offset(tick)));
        (format!("{line}/>"), format!("{line} stroke-dasharray=\"{dash} {dash}\">{grown}</polyline>"))
    }

    /// The distance to the target over time, and in figures at the end.
    fn curve(&self) -> String {
        let places: Vec<Pixel> = distances(self.panel).enumerate().map(|(i, d)| self.axes.pixel(i, d)).collect();
        let (still, moving) = self.trail("curve", &places);
        let last = self.panel.reach.ticks() as usize;
        let dot = |moving| self.shifted("<circle r=\"4\" fill=\"#56b4e9\"/>", last, moving, |tick| places[tick]);
        let (left, right, top, bottom) = (CURVE_LEFT, CURVE_RIGHT, CURVE_TOP, CURVE_BOTTOM);
        let (above, below, beside) = (top - 14.0, bottom + 17.0, left - 7.0);
        format!(
            "<text class=\"muted\" x=\"{PADDING}\" y=\"{above}\">distance: mean {mean}</text>\n\
             <text class=\"muted end\" x=\"{right}\" y=\"{above}\">end <tspan class=\"error\">{error}</tspan></text>\n\
             <path class=\"axis\" d=\"M{left} {top}V{bottom}H{right}\"/>\n\
             <text class=\"small end\" x=\"{beside}\" y=\"{top_text}\">{top_m} m</text>\n\
             <text class=\"small end\" x=\"{beside}\" y=\"{bottom}\">0</text>\n\
             <text class=\"small\" x=\"{left}\" y=\"{below}\">0 s</text>\n\
             <text class=\"small end\" x=\"{right}\" y=\"{below}\">{end_s}</text>\n\
             <g class=\"still\">{still}{}</g>\n<g class=\"moving\">{}{moving}\n{}</g>\n",
            dot(false),
            self.fade(),
            dot(true),
            mean = centimetres(mean_distance(self.panel)),
            error = centimetres(self.panel.reach.end_error_m),
            top_text = top + 9.0,
            top_m = (self.axes.top_m * 1e4).round() / 1e4,
            end_s = seconds(self.axes.ticks as f64 * self.film.period_s),
        )
    }
}

/// Text with what XML takes for its own written as entities.
fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}
