//! The film as an animated GIF. Its colours are those of the film and what lies between them, so that every frame has
//! the same table; a frame after the first holds what has changed.

use std::borrow::Cow;

use gif::{DisposalMethod, Encoder, EncodingError, Frame, Repeat};

use super::frames::{COLOURS, CROSSINGS, FilmFrames, PAGE, PANEL};
use super::raster::Rgb;

/// Steps of a colour from its ground to itself.
const STEPS: u16 = 11;
/// The index of a pixel that has not changed.
const UNCHANGED: u8 = 255;
/// A channel of a colour, in which the nearest entry is looked up, has so many bits.
const BITS: u32 = 6;

/// The GIF of these frames.
///
/// # Errors
/// [`EncodingError`] if a frame is larger than the format allows.
pub(super) fn gif(mut frames: FilmFrames) -> Result<Vec<u8>, EncodingError> {
    let [width, height] = frames.size().map(|side| side as u16);
    let delay = (100.0 * frames.frame_s()).round().clamp(2.0, 1000.0) as u16;
    let table = ColourTable::new();
    let mut bytes = Vec::new();
    let mut encoder = Encoder::new(&mut bytes, width, height, &table.colours.concat())?;
    encoder.set_repeat(Repeat::Infinite)?;
    let mut shown: Vec<u8> = Vec::new();
    while let Some(pixels) = frames.draw_next() {
        let next: Vec<u8> = pixels.iter().map(|pixel| table.index(*pixel)).collect();
        let frame = match shown.is_empty() {
            true => Frame { width, height, buffer: Cow::Borrowed(&next[..]), ..Frame::default() },
            false => changes(&shown, &next, width),
        };
        encoder.write_frame(&Frame { delay, dispose: DisposalMethod::Keep, ..frame })?;
        shown = next;
    }
    drop(encoder);
    Ok(bytes)
}

/// The rows of `next` in which it differs from `shown`; what is equal in them is transparent.
fn changes(shown: &[u8], next: &[u8], width: u16) -> Frame<'static> {
    let side = usize::from(width);
    let differs = |row: &usize| shown[row * side..(row + 1) * side] != next[row * side..(row + 1) * side];
    let rows = 0..next.len() / side;
    // A frame that changes nothing still takes its time: it has one row.
    let first = rows.clone().find(differs).unwrap_or(0);
    let last = rows.rev().find(differs).unwrap_or(first);
    let range = first * side..(last + 1) * side;
    let pixels = shown[range.clone()].iter().zip(&next[range]);
    let buffer: Vec<u8> = pixels.map(|(old, new)| if old == new { UNCHANGED } else { *new }).collect();
    Frame {
        top: first as u16,
        width,
        height: (last + 1 - first) as u16,
        transparent: Some(UNCHANGED),
        buffer: Cow::Owned(buffer),
        ..Frame::default()
    }
}

/// The film's colours, and the nearest of them to any other.
struct ColourTable {
    colours: Vec<Rgb>,
    nearest: Vec<u8>,
}

impl ColourTable {
    fn new() -> Self {
        let mut colours = vec![PAGE, PANEL];
        for ground in [PANEL, PAGE] {
            for colour in COLOURS {
                colours.extend((1..=STEPS).map(|step| mixed(ground, colour, step)));
            }
        }
        for [ground, colour] in CROSSINGS {
            colours.extend((1..STEPS).map(|step| mixed(ground, colour, step)));
        }
        colours.dedup();
        assert!(colours.len() <= usize::from(UNCHANGED), "{} colours", colours.len());
        let side = 1_u32 << BITS;
        let channel = |index: u32, i: u32| ((index >> (BITS * i)) % side * (256 / side) + 128 / side) as i32;
        let nearest = (0..side.pow(3)).map(|index| {
            let place = [channel(index, 2), channel(index, 1), channel(index, 0)];
            let distance = |colour: &Rgb| (0..3).map(|i| (i32::from(colour[i]) - place[i]).pow(2)).sum::<i32>();
            let least = colours.iter().enumerate().min_by_key(|(_, colour)| distance(colour));
            least.map_or(0, |(i, _)| i as u8)
        });
        Self { nearest: nearest.collect(), colours }
    }

    fn index(&self, [r, g, b]: Rgb) -> u8 {
        let [r, g, b] = [r, g, b].map(|channel| usize::from(channel >> (8 - BITS)));
        self.nearest[(r << (2 * BITS)) + (g << BITS) + b]
    }
}

/// The colour at a step from `ground` to `colour`.
fn mixed(ground: Rgb, colour: Rgb, step: u16) -> Rgb {
    [0, 1, 2].map(|i| {
        let sum = u16::from(ground[i]) * (STEPS - step) + u16::from(colour[i]) * step;
        (sum / STEPS) as u8
    })
}
