//! A picture in memory: shapes with smooth edges, and text, for films whose frames are pixels.
//!
//! Each shape is known by the distance of a place from its edge. A pixel is covered by as much of the shape as that
//! distance says, so that lines of any direction have smooth edges.

use noto_sans_mono_bitmap::{FontWeight, RasterHeight, get_raster, get_raster_width};

use super::layout::Pixel;

/// A colour: red, green, blue.
pub(super) type Rgb = [u8; 3];

/// A picture.
#[derive(Debug, Clone)]
pub(super) struct Raster {
    width: usize,
    height: usize,
    pixels: Vec<Rgb>,
    /// For shapes that are drawn at once; empty between them.
    scratch: CoverageMask,
}

/// How much of each pixel of a picture a shape covers.
#[derive(Debug, Clone, Default)]
pub(super) struct CoverageMask {
    width: usize,
    height: usize,
    /// From 0 to 1, row by row.
    values: Vec<f32>,
    /// The shape lies between these pixels; nothing lies outside.
    low: [usize; 2],
    high: [usize; 2],
}

impl Raster {
    /// A picture of one colour.
    pub fn new([width, height]: [usize; 2], colour: Rgb) -> Self {
        Self { width, height, pixels: vec![colour; width * height], scratch: CoverageMask::new([width, height]) }
    }

    /// The pixels, row by row.
    pub fn pixels(&self) -> &[Rgb] {
        &self.pixels
    }

    /// Width and height, px.
    pub fn size(&self) -> [usize; 2] {
        [self.width, self.height]
    }

    /// Draws the shape that `add` describes.
    pub fn draw(&mut self, colour: Rgb, add: impl FnOnce(&mut CoverageMask)) {
        let mut shape = std::mem::take(&mut self.scratch);
        add(&mut shape);
        self.fill(&shape, colour, 1.0);
        shape.clear();
        self.scratch = shape;
    }

    /// Draws `shape`, which was made for a picture of this size.
    pub fn fill(&mut self, shape: &CoverageMask, colour: Rgb, opacity: f32) {
        for y in shape.low[1]..shape.high[1] {
            for i in y * self.width + shape.low[0]..y * self.width + shape.high[0] {
                blend(&mut self.pixels[i], colour, opacity * shape.values[i]);
            }
        }
    }

    /// Draws `text` from `x` on, or up to `x` with `to_the_left`; `y` is its base line. `large` is for headlines.
    /// Characters that the font does not have are question marks.
    pub fn text(&mut self, [x, y]: Pixel, text: &str, colour: Rgb, large: bool, to_the_left: bool) {
        let (size, ascent) = if large { (RasterHeight::Size20, 15) } else { (RasterHeight::Size16, 12) };
        let width = get_raster_width(FontWeight::Regular, size);
        let begin = if to_the_left { x - (width * text.chars().count()) as f64 } else { x };
        let [left, top] = [begin.round() as i64, y.round() as i64 - ascent];
        for (i, c) in text.chars().enumerate() {
            let raster = |c| get_raster(c, FontWeight::Regular, size);
            let Some(glyph) = raster(c).or_else(|| raster('?')) else { continue };
            for (row, line) in glyph.rows().enumerate() {
                for (column, coverage) in line.iter().enumerate() {
                    let [x, y] = [left + (i * width + column) as i64, top + row as i64];
                    if (0..self.width as i64).contains(&x) && (0..self.height as i64).contains(&y) {
                        let pixel = &mut self.pixels[y as usize * self.width + x as usize];
                        blend(pixel, colour, f32::from(*coverage) / 255.0);
                    }
                }
            }
        }
    }

    /// Puts `other` over this picture, with its upper left corner at the pixel `at`. It fits.
    pub fn paste(&mut self, other: &Raster, at: [usize; 2]) {
        for y in 0..other.height {
            let begin = (at[1] + y) * self.width + at[0];
            let row = &other.pixels[y * other.width..(y + 1) * other.width];
            self.pixels[begin..begin + other.width].copy_from_slice(row);
        }
    }
}

fn blend(pixel: &mut Rgb, colour: Rgb, coverage: f32) {
    for (channel, new) in pixel.iter_mut().zip(colour) {
        let old = f32::from(*channel);
        *channel = (old + coverage * (f32::from(new) - old)).round() as u8;
    }
}

impl CoverageMask {
    /// An empty mask for a picture of this size.
    pub fn new([width, height]: [usize; 2]) -> Self {
        Self { width, height, values: vec![0.0; width * height], low: [width, height], high: [0, 0] }
    }

    /// Takes all shapes away.
    pub fn clear(&mut self) {
        for y in self.low[1]..self.high[1] {
            self.values[y * self.width + self.low[0]..y * self.width + self.high[0]].fill(0.0);
        }
        (self.low, self.high) = ([self.width, self.height], [0, 0]);
    }

    /// Adds a line through `points`, `width` px wide, with round ends and corners.
    pub fn line(&mut self, points: &[Pixel], width: f64) {
        for pair in points.windows(2) {
            self.segment(pair[0], pair[1], width);
        }
    }

    /// Adds a straight line.
    pub fn segment(&mut self, a: Pixel, b: Pixel, width: f64) {
        let along = [b[0] - a[0], b[1] - a[1]];
        let length2 = along[0] * along[0] + along[1] * along[1];
        let distance = |[x, y]: Pixel| {
            let [dx, dy] = [x - a[0], y - a[1]];
            let t = if length2 > 0.0 { ((dx * along[0] + dy * along[1]) / length2).clamp(0.0, 1.0) } else { 0.0 };
            (dx - t * along[0]).hypot(dy - t * along[1]) - width / 2.0
        };
        let low = [a[0].min(b[0]) - width / 2.0, a[1].min(b[1]) - width / 2.0];
        let high = [a[0].max(b[0]) + width / 2.0, a[1].max(b[1]) + width / 2.0];
        self.add(low, high, distance);
    }

    /// Adds a disc.
    pub fn disc(&mut self, centre: Pixel, radius: f64) {
        self.segment(centre, centre, 2.0 * radius);
    }

    /// Adds a ring, whose line is `width` px wide.
    pub fn ring(&mut self, [x, y]: Pixel, radius: f64, width: f64) {
        let outer = radius + width / 2.0;
        self.add([x - outer, y - outer], [x + outer, y + outer], |place| {
            ((place[0] - x).hypot(place[1] - y) - radius).abs() - width / 2.0
        });
    }

    /// Adds a rectangle with rounded corners.
    pub fn rectangle(&mut self, low: Pixel, high: Pixel, radius: f64) {
        self.add(low, high, |place| {
            // How far outside the rectangle of the corners' centres, along each axis.
            let [dx, dy] = [0, 1].map(|i| (low[i] + radius - place[i]).max(place[i] - high[i] + radius));
            dx.max(0.0).hypot(dy.max(0.0)) + dx.max(dy).min(0.0) - radius
        });
    }

    /// Adds a triangle, whose corners go clockwise as one sees them.
    pub fn triangle(&mut self, corners: [Pixel; 3]) {
        let [mut low, mut high] = [corners[0], corners[0]];
        for corner in corners {
            low = [low[0].min(corner[0]), low[1].min(corner[1])];
            high = [high[0].max(corner[0]), high[1].max(corner[1])];
        }
        self.add(low, high, |[x, y]| {
            let edge = |i: usize| {
                let ([x0, y0], [x1, y1]) = (corners[i], corners[(i + 1) % 3]);
                let [dx, dy] = [x1 - x0, y1 - y0];
                ((x - x0) * dy - (y - y0) * dx) / dx.hypot(dy)
            };
            edge(0).max(edge(1)).max(edge(2))
        });
    }

    /// Adds the shape within `low` and `high` whose edge is at `distance` from a place, px, negative inside.
    fn add(&mut self, low: Pixel, high: Pixel, distance: impl Fn(Pixel) -> f64) {
        let sides = [self.width, self.height];
        let within = |x: f64, side: usize| x.clamp(0.0, side as f64) as usize;
        let low = [0, 1].map(|i| within((low[i] - 1.0).floor(), sides[i]));
        let high = [0, 1].map(|i| within((high[i] + 1.0).ceil(), sides[i]));
        for y in low[1]..high[1] {
            for x in low[0]..high[0] {
                let coverage = (0.5 - distance([x as f64 + 0.5, y as f64 + 0.5])).clamp(0.0, 1.0) as f32;
                let value = &mut self.values[y * self.width + x];
                *value = value.max(coverage);
            }
        }
        for i in 0..2 {
            self.low[i] = self.low[i].min(low[i]);
            self.high[i] = self.high[i].max(high[i]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const BLACK: Rgb = [0; 3];
    const WHITE: Rgb = [255; 3];

    /// The area of what `add` draws, px.
    fn area(add: impl FnOnce(&mut CoverageMask)) -> f64 {
        let mut raster = Raster::new([60, 50], BLACK);
        raster.draw(WHITE, add);
        raster.pixels().iter().map(|pixel| f64::from(pixel[0]) / 255.0).sum()
    }

    #[test]
    fn shapes_cover_their_area() {
        use std::f64::consts::PI;
        let about = |measured: f64, expected: f64| assert!((measured / expected - 1.0).abs() < 0.02, "{measured}");
        about(area(|shape| shape.disc([30.3, 20.8], 12.0)), PI * 144.0);
        about(area(|shape| shape.ring([30.0, 25.5], 15.0, 3.0)), 2.0 * PI * 15.0 * 3.0);
        about(area(|shape| shape.rectangle([10.0, 10.0], [40.0, 30.0], 0.0)), 600.0);
        about(area(|shape| shape.rectangle([10.0, 10.0], [40.0, 30.0], 8.0)), 600.0 - (4.0 - PI) * 64.0);
        about(area(|shape| shape.line(&[[10.0, 10.0], [40.0, 10.0], [40.0, 40.0]], 4.0)), 241.0 + PI * 5.0);
        about(area(|shape| shape.triangle([[30.0, 5.0], [50.0, 45.0], [10.0, 45.0]])), 800.0);
        // What lies outside is cut off, a shape that lies outside altogether is nothing.
        about(area(|shape| shape.rectangle([-30.0, -30.0], [10.0, 10.0], 0.0)), 100.0);
        assert_eq!(area(|shape| shape.disc([-30.0, 300.0], 12.0)), 0.0);
        assert_eq!(area(|shape| shape.disc([f64::NAN, 10.0], 12.0)), 0.0);
    }

    #[test]
    fn text_stands_on_its_base_line_and_ends_where_it_is_told() {
        let mut raster = Raster::new([60, 50], BLACK);
        raster.text([50.0, 30.0], "Ab", WHITE, false, true);
        let lit: Vec<usize> = (0..3000).filter(|&i| raster.pixels()[i][0] > 60).collect();
        let rows = (lit[0] / 60, lit[lit.len() - 1] / 60);
        assert!(rows.0 >= 17 && (28..=30).contains(&rows.1), "{rows:?}");
        assert!(lit.iter().all(|i| (34..50).contains(&(i % 60))), "{lit:?}");
        // A character that the font does not have, and one beside the picture.
        raster.text([-3.0, 2.0], "\u{1f600}\n", WHITE, true, false);
    }
}
