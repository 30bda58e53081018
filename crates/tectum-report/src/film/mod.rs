//! The film of a run: one animated picture with three reaches of the arm side by side, at the beginning of the run,
//! after ten seconds, and at the end.
//!
//! A [`ReachSelector`] chooses the reaches from all reaches of a run, [`Film`] is what the picture shows, and
//! [`Film::to_svg`] draws it. [`Film::frames`] draws the same as pixels, and [`Film::to_gif`] puts those into a file,
//! for programs that do not animate an SVG. The SVG's animation is SMIL (`<animate>`) without any script, because code
//! hosts show SVG as an image and images run no script. A viewer that does not animate shows the last posture and the
//! whole path. So does one whose user asked for reduced motion. The same film gives the same bytes.

mod drawing;
mod frames;
mod gif;
mod keyframes;
mod layout;
mod raster;
mod selection;

use super::ReportError;

pub use frames::FilmFrames;
pub use selection::{EARLY_REACHES, LATE_REACHES, ReachSelector, RecordedReach, SelectedReaches};

/// What the film shows.
#[derive(Debug, Clone, PartialEq)]
pub struct Film {
    /// The scenario's name.
    pub scenario: String,
    /// The run's seed.
    pub seed: u64,
    /// Period of a tick, s.
    pub period_s: f64,
    /// From left to right.
    pub panels: [FilmPanel; 3],
    /// How the reaches were chosen, a line of text.
    pub choice: String,
}

/// One panel of the film: a reach and what is said of it.
#[derive(Debug, Clone, PartialEq)]
pub struct FilmPanel {
    /// The headline, for example `After ten seconds`.
    pub caption: String,
    /// What the body is like during the reach, for example `joint 3 blocked at 120 s`; may be empty.
    pub remark: String,
    /// The joints that are blocked during the reach, counted from 1 at the base.
    pub blocked: Vec<usize>,
    /// The reach.
    pub reach: RecordedReach,
}

impl FilmPanel {
    /// First and last instant of the reach, s from tick 0 of the run.
    pub fn seconds(&self, period_s: f64) -> [f64; 2] {
        let from = self.reach.reach.from;
        [from, from + self.reach.ticks()].map(|tick| tick as f64 * period_s)
    }
}

impl Film {
    /// The film as an SVG document.
    pub fn to_svg(&self) -> String {
        drawing::svg(self)
    }

    /// The film's frames as pixels.
    pub fn frames(&self) -> FilmFrames<'_> {
        FilmFrames::new(self)
    }

    /// The film as an animated GIF.
    ///
    /// # Errors
    ///
    /// [`ReportError::Draw`] if the film is larger than the format allows.
    pub fn to_gif(&self) -> Result<Vec<u8>, ReportError> {
        gif::gif(self.frames()).map_err(|error| ReportError::Draw(error.to_string()))
    }
}

/// An end error as people say it: 41 cm, 4.7 cm.
pub fn centimetres(metres: f64) -> String {
    let centimetres = 100.0 * metres;
    if centimetres < 9.95 { format!("{centimetres:.1} cm") } else { format!("{centimetres:.0} cm") }
}

/// A time without needless digits: 12 s, 0.4 s.
pub fn seconds(s: f64) -> String {
    let text = format!("{s:.1}");
    format!("{} s", text.strip_suffix(".0").unwrap_or(&text))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Reach;

    /// A reach of two segments that turns by 1.5 rad in `ticks` ticks.
    pub fn reach(from: u64, ticks: u64, end_error_m: f64) -> RecordedReach {
        let posture = |i: u64| {
            let angle = 1.5 * i as f64 / ticks as f64;
            vec![[0.0, -1.0], [angle.cos(), angle.sin() - 1.0], [2.0 * angle.cos(), 2.0 * angle.sin() - 1.0]]
        };
        let postures = (0..=ticks).map(posture).collect();
        RecordedReach { reach: Reach { from, target: [0.5, 0.5], postures }, end_error_m }
    }

    pub fn film() -> Film {
        let panel = |caption: &str, from| FilmPanel {
            caption: caption.into(),
            remark: String::new(),
            blocked: Vec::new(),
            reach: reach(from, 80, 0.047),
        };
        let mut panels = [panel("Before", 0), panel("Early", 240), panel("Late", 3360)];
        panels[2].blocked = vec![2];
        panels[2].remark = "joint 2 blocked at 120 s".into();
        Film { scenario: "arm".into(), seed: 1, period_s: 0.05, panels, choice: "a <typical> one".into() }
    }

    #[test]
    fn equal_films_give_equal_bytes() {
        let svg = film().to_svg();
        assert_eq!(svg, film().to_svg());
        let mut other = film();
        other.panels[1].reach.reach.postures[40][2][0] += 0.01;
        assert_ne!(svg, other.to_svg());
    }

    #[test]
    fn the_film_tells_captions_times_and_errors() {
        let svg = film().to_svg();
        for words in
            ["Before", "12 to 16 s", "168 to 172 s", "joint 2 blocked at 120 s", "4.7 cm", "a &lt;typical&gt; one"]
        {
            assert!(svg.contains(words), "{words}");
        }
        assert!(!svg.contains("<script") && !svg.contains("href"), "an image may run and load nothing");
        assert!(!svg.contains("NaN") && !svg.contains("inf"), "numbers only");
        assert!(svg.len() < 150_000, "{} bytes", svg.len());
    }

    /// The frames of a GIF as a reader that is no writer shows them.
    #[test]
    fn a_gif_shows_the_frames_one_after_the_other() {
        let film = film();
        let bytes = film.to_gif().unwrap();
        assert_eq!(bytes, film.to_gif().unwrap());
        let mut options = ::gif::DecodeOptions::new();
        options.set_color_output(::gif::ColorOutput::RGBA);
        let mut decoder = options.read_info(&bytes[..]).unwrap();
        let mut frames = film.frames();
        let [width, height] = frames.size();
        assert_eq!([decoder.width(), decoder.height()].map(usize::from), [width, height]);
        let (mut shown, mut count) = (vec![[0; 3]; width * height], 0);
        while let Some(frame) = decoder.read_next_frame().unwrap() {
            let side = usize::from(frame.width);
            assert_eq!(f64::from(frame.delay) / 100.0, (100.0 * frames.frame_s()).round() / 100.0);
            for (i, pixel) in frame.buffer.chunks_exact(4).enumerate().filter(|(_, pixel)| pixel[3] > 0) {
                let [x, y] = [usize::from(frame.left) + i % side, usize::from(frame.top) + i / side];
                shown[y * width + x].copy_from_slice(&pixel[..3]);
            }
            let drawn = frames.draw_next().unwrap();
            let off = |(a, b): (&[u8; 3], &[u8; 3])| (0..3).map(|i| a[i].abs_diff(b[i])).max().unwrap();
            let worst = shown.iter().zip(drawn).map(off).max().unwrap();
            assert!(worst <= 50, "frame {count}: a colour is {worst} of 255 off");
            count += 1;
        }
        assert!(frames.draw_next().is_none() && count == frames.count() && count > 20, "{count}");
    }

    #[test]
    fn pixels_have_the_colours_of_the_svg() {
        let svg = film().to_svg();
        for [r, g, b] in frames::COLOURS.into_iter().chain([frames::PAGE, frames::PANEL]) {
            let colour = format!("#{r:02x}{g:02x}{b:02x}");
            assert!(svg.contains(&colour), "{colour}");
        }
    }

    #[test]
    fn long_reaches_stay_small() {
        let mut long = film();
        long.panels.iter_mut().for_each(|panel| panel.reach = reach(0, 5000, 0.1));
        assert!(long.to_svg().len() < 150_000);
    }

    #[test]
    fn errors_and_times_have_no_needless_digits() {
        assert_eq!(
            [0.0, 0.047, 0.0994, 0.0996, 0.41, 2.3].map(centimetres),
            ["0.0 cm", "4.7 cm", "9.9 cm", "10 cm", "41 cm", "230 cm"]
        );
        assert_eq!([0.0, 0.25, 12.0, 12.04].map(seconds), ["0 s", "0.2 s", "12 s", "12 s"]);
    }
}
