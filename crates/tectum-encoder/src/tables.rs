//! The encoder's tables: everything about the maps that does not depend on the inputs, worked out once.
//!
//! The kernel and its scalar twin read the same tables, so what is left to differ between them is arithmetic alone.
//! All that can be done in double precision is done here and rounded once.

use super::exponential::{FLOOR, VANISH};
use super::features::{BLOCK, Features, GROUP};
use super::{Axis, Map};

/// What the kernel has to know about a group of units besides the tables.
#[derive(Debug, Clone)]
pub(super) struct UnitGroup {
    /// Index of the input that the line encodes.
    pub input: usize,
    /// `sqrt(log2(e) / 2) / radius`: in this unit of length an activation is 2 to the minus square of the distance.
    pub scale: f32,
}

/// A plane: the outer product of a slow and a fast line.
#[derive(Debug, Clone)]
pub(super) struct PlaneTables {
    /// First group of the slow line in the tables.
    pub slow: usize,
    /// First group of the fast line, directly after the slow one's last.
    pub fast: usize,
    /// First group after the plane.
    pub end: usize,
    /// Units of the slow line: rows in memory.
    pub rows: usize,
    /// Padded length of a row in memory.
    pub stride: usize,
    /// First feature in memory.
    pub start: usize,
}

/// Units of lines that are next to each other in the tables and in the features: they are only scaled and copied.
#[derive(Debug, Clone)]
pub(super) struct CopyRange {
    /// First unit in the tables.
    pub from: usize,
    /// First feature in memory.
    pub to: usize,
    /// Number of units, pads included.
    pub len: usize,
}

/// Where one map's features are.
#[derive(Debug, Clone)]
pub(super) struct MapLayout {
    /// Position of the first feature.
    pub start: usize,
    /// Rows along the slow axis; 1 for a line.
    pub rows: usize,
    /// Units in a row, without pads.
    pub units: usize,
}

impl MapLayout {
    /// Padded length of a row.
    pub fn stride(&self) -> usize {
        self.units.next_multiple_of(BLOCK)
    }
}

/// All maps.
#[derive(Debug, Clone)]
pub(super) struct EncoderTables {
    /// The groups of all lines: those of planes first, then those of maps that are lines.
    pub groups: Vec<UnitGroup>,
    /// Centres of the units, group after group, scaled as the inputs will be; infinity in the pads.
    pub centres: Features,
    /// Upper limits of the binary exponents: [`FLOOR`] for a unit, [`VANISH`] for a pad.
    pub floors: Features,
    /// The planes.
    pub planes: Vec<PlaneTables>,
    /// The first group that belongs to no plane.
    pub lines: usize,
    /// The lines.
    pub runs: Vec<CopyRange>,
    /// Where the maps' features are, in the order of the maps.
    pub places: Vec<MapLayout>,
    /// Whether the features are scaled to unit Euclidean norm.
    pub normalise: bool,
    /// Length of the features with the pads.
    pub len: usize,
}

impl EncoderTables {
    /// Works out the tables.
    pub fn new(maps: &[Map], normalise: bool) -> Self {
        let mut len = 0;
        let place = |map: &Map| {
            let (rows, units) = match map {
                Map::Line(axis) => (1, axis.units),
                Map::Plane(slow, fast) => (slow.units, fast.units),
            };
            let place = MapLayout { start: len, rows, units };
            len += rows * place.stride();
            place
        };
        let places: Vec<MapLayout> = maps.iter().map(place).collect();

        let mut tables = TablesBuilder::default();
        let mut planes = Vec::new();
        for (map, place) in maps.iter().zip(&places) {
            if let Map::Plane(slow, fast) = map {
                let (slow, fast) = (tables.line(slow), tables.line(fast));
                let (end, rows) = (tables.groups.len(), place.rows);
                planes.push(PlaneTables { slow, fast, end, rows, stride: place.stride(), start: place.start });
            }
        }
        let lines = tables.groups.len();
        let mut runs: Vec<CopyRange> = Vec::new();
        for (map, place) in maps.iter().zip(&places) {
            if let Map::Line(axis) = map {
                let run = CopyRange { from: tables.line(axis) * GROUP, to: place.start, len: place.stride() };
                match runs.last_mut() {
                    Some(last) if last.from + last.len == run.from && last.to + last.len == run.to => {
                        last.len += run.len;
                    }
                    _ => runs.push(run),
                }
            }
        }
        let (centres, floors) = (Features::from_slice(&tables.centres), Features::from_slice(&tables.floors));
        Self { groups: tables.groups, centres, floors, planes, lines, runs, places, normalise, len }
    }
}

/// The tables while they grow.
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
        // Two limits for absurd radii: a unit that is hit exactly must not become 0 * infinity.
        let scale = ((std::f64::consts::LOG2_E / 2.0).sqrt() / axis.radius) as f32;
        let group = UnitGroup { input: axis.input, scale: scale.clamp(f32::MIN_POSITIVE, f32::MAX) };
        // By the rounded scale, not the exact one: inputs meet the same, and its error cancels out of the distance.
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
