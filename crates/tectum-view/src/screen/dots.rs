//! Drawing with braille characters: two by four dots in each cell.

use ratatui_core::buffer::Buffer;
use ratatui_core::layout::Rect;
use ratatui_core::style::Style;

/// Bits of the dots in a braille character, by row and column.
const BITS: [[u8; 2]; 4] = [[0x01, 0x08], [0x02, 0x10], [0x04, 0x20], [0x40, 0x80]];

/// A field of dots over an area of cells. The origin is at the lower left.
pub(super) struct Dots {
    area: Rect,
    cells: Vec<u8>,
}

impl Dots {
    pub fn new(area: Rect) -> Self {
        Self { area, cells: vec![0; usize::from(area.width) * usize::from(area.height)] }
    }

    /// Width and height, dots.
    pub fn size(&self) -> [f64; 2] {
        [f64::from(self.area.width) * 2.0, f64::from(self.area.height) * 4.0]
    }

    /// Sets the dot at `x` from the left and `y` from below, if it is on the field.
    pub fn set(&mut self, x: f64, y: f64) {
        let [width, height] = self.size();
        if !(0.0..width).contains(&x) || !(0.0..height).contains(&y) {
            return;
        }
        let (x, y) = (x as usize, (height - 1.0 - y.floor()) as usize);
        self.cells[y / 4 * usize::from(self.area.width) + x / 2] |= BITS[y % 4][x % 2];
    }

    /// A straight line between two points.
    pub fn line(&mut self, [from_x, from_y]: [f64; 2], [to_x, to_y]: [f64; 2]) {
        let [dx, dy] = [to_x - from_x, to_y - from_y];
        let length = dx.abs().max(dy.abs());
        if !length.is_finite() {
            return;
        }
        // What is far outside is not walked through dot by dot.
        let steps = (length.ceil() as usize).clamp(1, 2000);
        for i in 0..=steps {
            let share = i as f64 / steps as f64;
            self.set(from_x + share * dx, from_y + share * dy);
        }
    }

    /// Puts the dots into the cells of `buffer`, over what is there.
    pub fn draw(&self, buffer: &mut Buffer, style: Style) {
        for (i, &bits) in self.cells.iter().enumerate().filter(|(_, bits)| **bits != 0) {
            let (column, row) = (i % usize::from(self.area.width), i / usize::from(self.area.width));
            let (x, y) = (self.area.x + column as u16, self.area.y + row as u16);
            if let Some(cell) = buffer.cell_mut((x, y)) {
                cell.set_char(char::from_u32(0x2800 + u32::from(bits)).unwrap_or(' ')).set_style(style);
            }
        }
    }
}
