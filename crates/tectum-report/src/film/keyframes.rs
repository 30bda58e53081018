//! From a reach to the values of its animation: one keyframe a tick, then the last one held.

use std::fmt::Write as _;

use super::layout::Pixel;

/// More keyframes than this are thinned: the file would grow, and a screen shows no more.
const MOST_KEYFRAMES: u64 = 160;

/// Ticks of the film, common to all panels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Timeline {
    /// Ticks of the longest reach.
    ticks: u64,
    /// Keyframes of the movement, and of all the film with the held posture at its end.
    moving: u64,
    all: u64,
    /// Length of one loop as it is shown, s.
    pub loop_s: f64,
    /// Speed of the film, 1 in real time.
    pub speed: f64,
}

impl Timeline {
    /// The timeline of reaches of up to `ticks` ticks.
    pub fn new(ticks: u64, period_s: f64) -> Self {
        let ticks = ticks.max(1);
        let moving = ticks.min(MOST_KEYFRAMES);
        let held = (moving / 4).max(1);
        let real_s = ticks as f64 * period_s;
        // A reach that is too fast to follow, or too slow to wait for, is shown in four seconds.
        let speed = if (1.0..=10.0).contains(&real_s) { 1.0 } else { real_s / 4.0 };
        let loop_s = real_s / speed * (moving + held) as f64 / moving as f64;
        Self { ticks, moving, all: moving + held, loop_s, speed }
    }

    /// The tick that each keyframe shows, within a reach of `ticks` ticks.
    fn shown(&self, ticks: u64) -> impl Iterator<Item = usize> {
        (0..=self.all).map(move |frame| self.tick(frame, ticks))
    }

    /// The tick that a keyframe shows, within a reach of `ticks` ticks.
    pub fn tick(&self, frame: u64, ticks: u64) -> usize {
        let tick = (frame.min(self.moving) as f64 * self.ticks as f64 / self.moving as f64).round() as u64;
        tick.min(ticks) as usize
    }

    /// How many frames a loop has, each shown for the same time.
    pub fn frames(&self) -> u64 {
        self.all
    }

    /// A list of values for an animation: `write` writes the value of a tick.
    pub fn values(&self, ticks: u64, mut write: impl FnMut(&mut String, usize)) -> String {
        let mut values = String::new();
        for (i, tick) in self.shown(ticks).enumerate() {
            if i > 0 {
                values.push(';');
            }
            write(&mut values, tick);
        }
        values
    }

    /// The ticks of the keyframes without repetition: what a still line passes through.
    pub fn ticks(&self, ticks: u64) -> Vec<usize> {
        let mut shown: Vec<usize> = self.shown(ticks).collect();
        shown.dedup();
        shown
    }
}

/// A coordinate with one decimal at most: a tenth of a pixel.
pub(super) fn coordinate(text: &mut String, x: f64) {
    let tenths = (10.0 * x).round() as i64;
    let (sign, tenths) = (if tenths < 0 { "-" } else { "" }, tenths.abs());
    let _ = match tenths % 10 {
        0 => write!(text, "{sign}{}", tenths / 10),
        tenth => write!(text, "{sign}{}.{tenth}", tenths / 10),
    };
}

/// `x,y`.
pub(super) fn point(text: &mut String, [x, y]: Pixel) {
    coordinate(text, x);
    text.push(',');
    coordinate(text, y);
}

/// `x,y x,y`.
pub(super) fn points(text: &mut String, points: impl IntoIterator<Item = Pixel>) {
    for (i, p) in points.into_iter().enumerate() {
        if i > 0 {
            text.push(' ');
        }
        point(text, p);
    }
}

/// A line through the places of the keyframes, with the length of the way to each tick.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Trail {
    /// The line's points, as an attribute.
    pub points: String,
    /// Length of the way until a tick, px.
    lengths: Vec<f64>,
}

impl Trail {
    /// The line of `places`, one a tick, at the ticks in `shown`.
    pub fn new(places: &[Pixel], shown: &[usize]) -> Self {
        let (mut text, mut lengths, mut length) = (String::new(), vec![0.0; places.len()], 0.0);
        points(&mut text, shown.iter().map(|&tick| places[tick]));
        for pair in shown.windows(2) {
            let [[x0, y0], [x1, y1]] = [places[pair[0]], places[pair[1]]];
            length += (x1 - x0).hypot(y1 - y0);
            lengths[pair[1]] = length;
        }
        Self { points: text, lengths }
    }

    /// Length of the whole line, rounded up, px: the dash that covers it.
    pub fn dash(&self) -> f64 {
        self.lengths.last().copied().unwrap_or(0.0).ceil() + 1.0
    }

    /// How far the dash is shifted back so that the line ends at the place of a tick.
    pub fn offset(&self, tick: usize) -> f64 {
        self.dash() - self.lengths[tick]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_reach_plays_in_real_time_and_is_held_at_its_end() {
        let timeline = Timeline::new(80, 0.05);
        assert_eq!((timeline.speed, timeline.loop_s), (1.0, 5.0));
        let values = timeline.values(80, |text, tick| *text += &tick.to_string());
        let values: Vec<&str> = values.split(';').collect();
        assert_eq!(values.len(), 101);
        assert_eq!((values[0], values[1], values[80], values[100]), ("0", "1", "80", "80"));
        // A shorter reach stands at its end.
        assert_eq!(timeline.ticks(3), [0, 1, 2, 3]);
    }

    #[test]
    fn what_is_too_quick_or_too_slow_is_shown_in_four_seconds() {
        let timeline = Timeline::new(80, 0.001);
        assert_eq!((timeline.speed, timeline.loop_s), (0.02, 5.0));
        let timeline = Timeline::new(800, 0.05);
        assert_eq!((timeline.speed, timeline.loop_s), (10.0, 5.0));
        assert_eq!(timeline.ticks(800).len(), 161);
        assert_eq!(timeline.ticks(800).last(), Some(&800));
    }

    #[test]
    fn coordinates_are_short() {
        let short = |x: f64| {
            let mut text = String::new();
            coordinate(&mut text, x);
            text
        };
        assert_eq!([0.0, -0.04, 12.04, 12.06, -3.5, -0.26].map(short), ["0", "0", "12", "12.1", "-3.5", "-0.3"]);
    }

    #[test]
    fn a_trail_knows_how_far_it_has_come() {
        let trail = Trail::new(&[[0.0, 0.0], [3.0, 4.0], [3.0, 10.0]], &[0, 1, 2]);
        assert_eq!(trail.points, "0,0 3,4 3,10");
        assert_eq!((trail.dash(), trail.offset(0), trail.offset(1), trail.offset(2)), (12.0, 12.0, 7.0, 1.0));
    }
}
