//! Statistics over groups of movements: all of a run, the first, and the last.

use serde::{Serialize, Serializer};

use super::movement::{COLUMNS, Measures, PROFILE};
use super::{Fit, Quartiles};

/// One movement of the run.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct MovementRow {
    /// The tick at which its target appeared.
    pub from: u64,
    /// Ticks until the next target appeared.
    pub ticks: u64,
    /// The movement as recorded.
    pub measured: Measures,
    /// The movement without exploration noise; `None` where it is not known.
    pub noiseless: Option<Measures>,
}

/// A movement's row, and those of its measures that the statistics use.
pub(super) type MeasuredRow<'a> = (&'a MovementRow, &'a Measures);

/// Isochrony: how duration and peak speed depend on the distance to the target.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub(super) struct Isochrony {
    /// Duration (s) against distance (m).
    pub duration: Option<Fit>,
    /// Peak speed (m/s) against distance (m).
    pub peak_speed: Option<Fit>,
}

/// Statistics of a group of movements.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(super) struct MovementGroup {
    /// Number of movements.
    pub n: usize,
    /// The tick at which the first began.
    pub from: u64,
    /// The tick at which the last began.
    pub to: u64,
    /// Quartiles by measure, in the order of [`COLUMNS`]; null for a measure that no movement has.
    #[serde(serialize_with = "by_name")]
    pub measures: Vec<Option<Quartiles>>,
    /// Share of the movements whose reach had ended when the next target appeared. The others have no
    /// duration and no profile.
    pub completed: f64,
    /// Share of the movements that settled within the fixed tolerance.
    pub settled: f64,
    /// Share of the movements that settled within the share of the distance.
    pub settled_share: f64,
    /// Duration and peak speed against distance.
    pub isochrony: Isochrony,
    /// Quartiles of speed over mean speed, at equally spaced times of the reach.
    pub profile: Vec<Quartiles>,
}

fn by_name<S: Serializer>(measures: &[Option<Quartiles>], serializer: S) -> Result<S::Ok, S::Error> {
    serializer.collect_map(COLUMNS.iter().zip(measures).map(|((name, _), quartiles)| (name, quartiles)))
}

impl MovementGroup {
    fn of(rows: &[MeasuredRow]) -> Option<Self> {
        let quartiles = |value: fn(&Measures) -> Option<f64>| Quartiles::of(rows.iter().filter_map(|(_, m)| value(m)));
        let share = |value: fn(&Measures) -> Option<f64>| {
            rows.iter().filter(|(_, m)| value(m).is_some()).count() as f64 / rows.len() as f64
        };
        let against_distance = |value: fn(&Measures) -> Option<f64>| {
            let points: Vec<_> = rows.iter().filter_map(|(_, m)| Some((m.distance_m, value(m)?))).collect();
            Fit::of(&points)
        };
        let speed = |i: usize| Quartiles::of(rows.iter().filter_map(|(_, m)| m.profile.get(i)).map(|&x| f64::from(x)));
        Some(Self {
            n: rows.len(),
            from: rows.first()?.0.from,
            to: rows.last()?.0.from,
            measures: COLUMNS.iter().map(|(_, value)| quartiles(*value)).collect(),
            completed: share(|m| m.duration_s),
            settled: share(|m| m.settled_s),
            settled_share: share(|m| m.settled_share_s),
            isochrony: Isochrony {
                duration: against_distance(|m| m.duration_s),
                peak_speed: against_distance(|m| m.peak_speed),
            },
            profile: (0..PROFILE).filter_map(speed).collect(),
        })
    }

    /// The quartiles of the measure with this name in [`COLUMNS`].
    pub fn get(&self, name: &str) -> Option<&Quartiles> {
        self.measures.get(COLUMNS.iter().position(|(column, _)| *column == name)?)?.as_ref()
    }
}

/// All movements of a run, those at its beginning, and those at its end.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(super) struct MovementGroups {
    /// All movements.
    pub all: MovementGroup,
    /// The first tenth, but at least ten, and no more than half of all.
    pub early: MovementGroup,
    /// The last tenth, with the same limits.
    pub late: MovementGroup,
}

impl MovementGroups {
    pub fn of(rows: &[MeasuredRow]) -> Option<Self> {
        let count = edge_count(rows.len());
        Some(Self {
            all: MovementGroup::of(rows)?,
            early: MovementGroup::of(&rows[..count])?,
            late: MovementGroup::of(&rows[rows.len() - count..])?,
        })
    }
}

/// How many of `n` movements are the first ones, and as many the last ones.
pub(super) fn edge_count(n: usize) -> usize {
    (n / 10).max(10).min(n / 2).max(n.min(1))
}

#[cfg(test)]
mod tests {
    use super::super::movement::{Definitions, measure, minimum_jerk};
    use super::*;

    /// Twelve minimum-jerk movements over different distances, all of the same duration: perfect isochrony.
    #[test]
    fn isochrony_is_found() {
        let rows: Vec<MovementRow> = (1..=12)
            .map(|i| {
                let movement = minimum_jerk(0.1 * f64::from(i), 20);
                let measured = measure(&movement, 0.05, &Definitions { onset: 0.0, ..Definitions::default() });
                MovementRow { from: u64::from(i as u32 * 80), ticks: 40, measured, noiseless: None }
            })
            .collect();
        let rows: Vec<_> = rows.iter().map(|row| (row, &row.measured)).collect();
        let MovementGroups { all, early, late } = MovementGroups::of(&rows).unwrap();
        assert_eq!((all.n, early.n, late.n), (12, 6, 6));
        assert_eq!((all.from, all.to, early.to, late.from), (80, 960, 480, 560));
        assert_eq!((all.completed, all.settled), (1.0, 1.0));
        let (duration, speed) = (all.isochrony.duration.unwrap(), all.isochrony.peak_speed.unwrap());
        assert!(duration.slope.abs() < 1e-9 && (duration.intercept - 1.0).abs() < 1e-9, "{duration:?}");
        assert!((speed.slope - 1.875).abs() < 0.005 && speed.r > Some(0.9999), "{speed:?}");
        assert_eq!(all.profile.len(), PROFILE);
        assert!((all.get("peak_to_mean").unwrap().median - 1.875).abs() < 0.005);
        assert!(late.get("distance_m").unwrap().q25 > early.get("distance_m").unwrap().q75);
    }

    #[test]
    fn first_and_last_do_not_overlap() {
        assert_eq!([0, 1, 2, 5, 15, 20, 74, 100, 1000].map(edge_count), [0, 1, 1, 2, 7, 10, 10, 10, 100]);
    }
}
