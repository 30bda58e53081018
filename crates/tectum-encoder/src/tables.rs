//! The encoder's tables: everything that depends on the maps but not on the inputs, computed once.
//!
//! The SIMD kernel and the scalar implementation read the same tables, so that they can differ only in arithmetic.
//! Constants are computed in double precision and rounded once.

use super::exponential::{FLOOR, VANISH};
use super::features::{BLOCK, Features, GROUP};
use super::{Axis, Map};

/// The input and the scale of a group of units.
#[derive(Debug, Clone)]
pub(super) struct UnitGroup {
    /// Index of the input that the line encodes.
    pub input: usize,
    /// `sqrt(log2(e) / 2) / radius`. With lengths scaled by it, an activation is 2 to the negative squared
    /// distance.
    pub scale: f32,
}

/// A plane: the outer product of a slow and a fast line.
#[derive(Debug, Clone)]
pub(super) struct PlaneTables {
    /// First group of the slow line in the tables.
    pub slow: usize,
    /// First group of the fast line, directly after the last group of the slow line.
    pub fast: usize,
    /// First group after the plane.
    pub end: usize,
    /// Number of units of the slow line, which is the number of rows in memory.
    pub rows: usize,
    /// Padded length of a row in memory.
    pub stride: usize,
    /// First feature in memory.
    pub start: usize,
}

/// Units of lines that are contiguous both in the tables and in the features: they are scaled and copied together.
#[derive(Debug, Clone)]
pub(super) struct CopyRange {
    /// First unit in the tables.
    pub from: usize,
    /// First feature in memory.
    pub to: usize,
    /// Number of units, including padding.
    pub len: usize,
}

/// Position and shape of one map's features in memory.
#[derive(Debug, Clone)]
pub(super) struct MapLayout {
    /// Position of the first feature.
    pub start: usize,
    /// Rows along the slow axis; 1 for a line.
    pub rows: usize,
    /// Units in a row, without padding.
    pub units: usize,
}

impl MapLayout {
    /// Padded length of a row.
    pub fn stride(&self) -> usize {
        self.units.next_multiple_of(BLOCK)
    }
}

/// The tables of all maps.
#[derive(Debug, Clone)]
pub(super) struct EncoderTables {
    /// The groups of all lines: first those of planes, then those of maps that are lines.
    pub groups: Vec<UnitGroup>,
    /// Centres of the units, group after group, scaled like the inputs; infinity for padding.
    pub centres: Features,
    /// Upper limits of the negated binary exponents: [`FLOOR`] for a unit, [`VANISH`] for padding.
    pub floors: Features,
    /// The planes.
    pub planes: Vec<PlaneTables>,
    /// The first group that does not belong to a plane.
    pub lines: usize,
    /// Where the maps that are lines are, in contiguous ranges.
    pub line_ranges: Vec<CopyRange>,
    /// Layout of each map's features, in the order of the maps.
    pub layouts: Vec<MapLayout>,
    /// Whether the features are scaled to unit Euclidean norm.
    pub normalise: bool,
    /// Number of features, including padding.
    pub len: usize,
}

impl EncoderTables {
    /// Computes the tables.
    pub fn new(maps: &[Map], normalise: bool) -> Self {
        let mut len = 0;
        let layout = |map: &Map| {
            let (rows, units) = match map {
                Map::Line(axis) => (1, axis.units),
                Map::Plane(slow, fast) => (slow.units, fast.units),
            };
            let layout = MapLayout { start: len, rows, units };
            len += rows * layout.stride();
            layout
        };
        let layouts: Vec<MapLayout> = maps.iter().map(layout).collect();

        let mut tables = TablesBuilder::default();
        let mut planes = Vec::new();
        for (map, layout) in maps.iter().zip(&layouts) {
            if let Map::Plane(slow, fast) = map {
                let (slow, fast) = (tables.line(slow), tables.line(fast));
                let (end, rows) = (tables.groups.len(), layout.rows);
                planes.push(PlaneTables { slow, fast, end, rows, stride: layout.stride(), start: layout.start });
            }
        }
        let lines = tables.groups.len();
        let mut line_ranges: Vec<CopyRange> = Vec::new();
        for (map, layout) in maps.iter().zip(&layouts) {
            if let Map::Line(axis) = map {
                let range = CopyRange { from: tables.line(axis) * GROUP, to: layout.start, len: layout.stride() };
                match line_ranges.last_mut() {
                    Some(last) if last.from + last.len == range.from && last.to + last.len == range.to => {
                        last.len += range.len;
                    }
                    _ => line_ranges.push(range),
                }
            }
        }
        let (centres, floors) = (Features::from_slice(&tables.centres), Features::from_slice(&tables.floors));
        Self { groups: tables.groups, centres, floors, planes, lines, line_ranges, layouts, normalise, len }
    }
}

/// The tables under construction.
#[derive(Default)]
struct TablesBuilder {
    groups: Vec<UnitGroup>,
    centres: Vec<f32>,
    floors: Vec<f32>,
}

impl TablesBuilder {
    /// Adds a line; returns its first group.
    fn line(&mut self, axis: &Axis) -> usize {
        debug_assert!(axis.units >= 2 && axis.radius > 0.0 && axis.max > axis.min, "unchecked axis {axis:?}");
        // Limits for extreme radii: a unit whose centre equals the input must not become 0 * infinity.
        let scale = ((std::f64::consts::LOG2_E / 2.0).sqrt() / axis.radius) as f32;
        let group = UnitGroup { input: axis.input, scale: scale.clamp(f32::MIN_POSITIVE, f32::MAX) };
        // The rounded scale, not the exact one: inputs are multiplied by the same value, so its error cancels
        // in the distance.
        let scale = f64::from(group.scale);
        let spacing = (axis.max - axis.min) / (axis.units - 1) as f64;
        self.centres.extend((0..axis.units).map(|unit| ((axis.min + spacing * unit as f64) * scale) as f32));
        self.floors.resize(self.centres.len(), FLOOR);

        let start = self.groups.len();
        self.groups.resize(start + axis.units.div_ceil(GROUP), group);
        self.centres.resize(self.groups.len() * GROUP, f32::INFINITY);
        self.floors.resize(self.centres.len(), VANISH);
        start
    }
}
