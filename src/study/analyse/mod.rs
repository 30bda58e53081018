//! How a run's movements look: duration and peak speed against distance (isochrony), the shape of speed profiles, straightness,
//! settling; at the beginning of the run and at its end. From a log alone.
//!
//! The paper (section 5) asks whether what is learned has the properties of human gestures, isochrony and bell-shaped
//! speed profiles (its references 12 and 13). *Isochrony* is that movements over larger distances are faster, so that their
//! duration depends little on distance (Viviani & Terzuolo 1982; Viviani & Schneider 1991): a straight line through
//! durations against distances has a small slope, one through peak speeds a large one. What is measured of a single movement is
//! said in [`movement`].
//!
//! Every movement is measured twice where that can be done: as it was, and as the policy of that moment would have made it
//! without exploration noise (see [`shadow`]). For a plant of your own there is only the former.

mod cutter;
mod error;
pub mod log_follower;
pub mod movement;
mod text;

use std::path::{Path, PathBuf};

use serde::{Serialize, Serializer};

pub use crate::stats::{Fit, Quartiles};
pub use cutter::{LeftOut, MovementCut, MovementCutter};
pub use error::AnalyseError;

use crate::log::{LogRecord, RunLog};
use crate::report::figure::{MovementDots, MovementsFigure, SpeedProfile};
use crate::report::thousands;
use crate::scenario::{Plan, Scenario};
use crate::supervise::RunProgress;
use log_follower::LogFollower;
use movement::{COLUMNS, Definitions, Measures, PROFILE, measure, minimum_jerk};

/// One movement of the run.
#[derive(Debug, Clone, PartialEq)]
pub struct MovementRow {
    /// The tick at which its target appeared.
    pub from: u64,
    /// Ticks until the next target did.
    pub ticks: u64,
    /// As it was.
    pub measured: Measures,
    /// As it would have been without exploration noise; `None` where that is not known.
    pub noiseless: Option<Measures>,
}

/// Isochrony: how duration and peak speed depend on the distance to the target.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Isochrony {
    /// Duration (s) against distance (m).
    pub duration: Option<Fit>,
    /// Peak speed (m/s) against distance (m).
    pub peak_speed: Option<Fit>,
}

/// What some movements say together.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct MovementGroup {
    /// Number of movements.
    pub n: usize,
    /// The tick at which the first began.
    pub from: u64,
    /// The tick at which the last began.
    pub to: u64,
    /// Quartiles by measure, in the order of [`COLUMNS`]; null for a measure that no movement has.
    #[serde(serialize_with = "by_name")]
    pub measures: Vec<Option<Quartiles>>,
    /// Share of the movements whose reach had ended when the next target appeared. The others have no duration and no profile.
    pub completed: f64,
    /// Share of the movements that settled within the fixed tolerance.
    pub settled: f64,
    /// Share of the movements that settled within the share of the distance.
    pub settled_share: f64,
    /// Duration and peak speed against distance.
    pub isochrony: Isochrony,
    /// Quartiles of speed over mean speed, at equally spaced instants of the reach.
    pub profile: Vec<Quartiles>,
}

fn by_name<S: Serializer>(measures: &[Option<Quartiles>], serializer: S) -> Result<S::Ok, S::Error> {
    serializer.collect_map(COLUMNS.iter().zip(measures).map(|((name, _), quartiles)| (name, quartiles)))
}

impl MovementGroup {
    fn of(rows: &[(&MovementRow, &Measures)]) -> Option<Self> {
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

/// All movements, those at the run's beginning, and those at its end.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct MovementGroups {
    /// All of them.
    pub all: MovementGroup,
    /// The first tenth, but at least ten, and no more than half of them.
    pub early: MovementGroup,
    /// The last tenth, likewise.
    pub late: MovementGroup,
}

impl MovementGroups {
    fn of(rows: &[(&MovementRow, &Measures)]) -> Option<Self> {
        let part = part(rows.len());
        Some(Self {
            all: MovementGroup::of(rows)?,
            early: MovementGroup::of(&rows[..part])?,
            late: MovementGroup::of(&rows[rows.len() - part..])?,
        })
    }
}

/// How many of `n` movements are the first, and how many the last.
fn part(n: usize) -> usize {
    (n / 10).max(10).min(n / 2).max(n.min(1))
}

/// The movements of a run.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Analysis {
    /// The log.
    pub log: PathBuf,
    /// The scenario's name.
    pub scenario: String,
    /// The run's seed.
    pub seed: u64,
    /// The tick's period, s.
    pub period_s: f64,
    /// Ticks that the log holds.
    pub ticks: u64,
    /// The log was cut off, and was analysed as far as it goes.
    pub torn: bool,
    /// The movements' number.
    pub n: usize,
    /// Movements that were left out.
    pub left_out: LeftOut,
    /// Thresholds of the measures.
    pub definitions: Definitions,
    /// Without exploration noise; null where that is not known.
    pub noiseless: Option<MovementGroups>,
    /// Why there are no movements without noise, or from when on not; null where nothing is amiss.
    pub noiseless_missing: Option<String>,
    /// As they were.
    pub measured: MovementGroups,
    /// The measures of a minimum-jerk movement as far and as long as the median one at the run's end, to compare with.
    pub minimum_jerk: Measures,
    /// The movements, one by one.
    #[serde(skip)]
    pub rows: Vec<MovementRow>,
}

/// Analyses the movements in the log in `segments`, of one run and in their order. With `noiseless`, plant and controller are followed through the log to
/// tell how the movements would have been without exploration noise, which takes as long as the learning took; with
/// `progress`, a line on standard error shows how far it is, if that is a terminal.
///
/// # Errors
/// [`AnalyseError`] if it is no log, is thinned, or its plant does not measure what movements are made of.
pub fn analyse(segments: &[PathBuf], noiseless: bool, progress: bool) -> Result<Analysis, AnalyseError> {
    let mut log = RunLog::open(segments)?;
    let path = log.path().to_owned();
    let path = path.as_path();
    let plan = plan_of(&log, path)?;
    let every = log.every();
    if every > 1 {
        return Err(AnalyseError::Thinned { path: path.to_owned(), every });
    }
    let (definitions, period_s) = (Definitions::default(), plan.period_ns as f64 / 1e9);
    let mut cutter = MovementCutter::new(&plan)?;
    let mut shadow = if noiseless { LogFollower::new(&plan) } else { None };
    let mut without_noise = None;
    let mut rows: Vec<MovementRow> = Vec::new();
    let mut ticks = 0;
    let mut progress = RunProgress::study(&plan.scenario.name, plan.scenario.ticks, progress);
    for record in log.by_ref() {
        match record.inspect_err(|_| progress.clear())? {
            LogRecord::Observation(observation) => {
                let tick = observation.header.tick;
                ticks = tick + 1;
                if let Some(shadow) = &mut shadow {
                    shadow.observe(&observation);
                    if tick.is_multiple_of(64) {
                        progress.show_study(tick, (f32::NAN, f32::NAN));
                    }
                }
                if let Some(MovementCut { from, track }) = cutter.take(&observation) {
                    rows.push(MovementRow {
                        from,
                        ticks: track.errors.len() as u64,
                        measured: measure(&track, period_s, &definitions),
                        noiseless: without_noise.take_if(|(tick, _)| *tick == from).map(|(_, noiseless)| noiseless),
                    });
                }
            }
            LogRecord::Command(command) => {
                let movement = shadow.as_mut().and_then(|shadow| shadow.command(&command, &cutter));
                if let Some((tick, mut track)) = movement {
                    // Where the target's place is not known, the first error stands for the distance.
                    track.distance = cutter.distance().unwrap_or(track.errors[0]);
                    without_noise = Some((tick, measure(&track, period_s, &definitions)));
                }
            }
            LogRecord::Learning(_) | LogRecord::Gap(_) => {}
        }
    }
    progress.clear();
    cutter.finish();
    let noiseless_missing = match &shadow {
        _ if !noiseless => Some("not asked for".to_owned()),
        None => Some("the plant is not the simulator's".to_owned()),
        Some(shadow) => shadow.lost_at().map(|tick| {
            format!("from tick {tick} on the log is not what this build makes of it: ticks were missed or lost, or another build wrote it")
        }),
    };
    let measured: Vec<_> = rows.iter().map(|row| (row, &row.measured)).collect();
    let clean: Vec<_> = rows.iter().filter_map(|row| Some((row, row.noiseless.as_ref()?))).collect();
    let noiseless = MovementGroups::of(&clean);
    let measured = MovementGroups::of(&measured).ok_or_else(|| AnalyseError::NoMovement {
        path: path.to_owned(),
        why: format!("{ticks} ticks, {} movements left out", cutter.left_out.total()),
    })?;
    Ok(Analysis {
        log: path.to_owned(),
        scenario: plan.scenario.name.clone(),
        seed: plan.scenario.seed,
        period_s,
        ticks,
        torn: !log.finished(),
        n: rows.len(),
        left_out: cutter.left_out,
        definitions,
        minimum_jerk: reference(noiseless.as_ref().unwrap_or(&measured), period_s, &definitions),
        noiseless,
        noiseless_missing,
        measured,
        rows,
    })
}

fn plan_of(log: &RunLog, path: &Path) -> Result<Plan, AnalyseError> {
    Scenario::parse(log.scenario(), "scenario.toml")
        .and_then(Scenario::plan)
        .map_err(|error| AnalyseError::Scenario { path: path.to_owned(), error: Box::new(error) })
}

/// The minimum-jerk movement to compare with: as far as the median movement at the run's end, and between thresholds as
/// long, as far as whole ticks allow.
fn reference(view: &MovementGroups, period_s: f64, definitions: &Definitions) -> Measures {
    /// Share of the whole minimum-jerk movement between thresholds of 5 % of its peak speed.
    const BETWEEN: f64 = 0.881;
    let late = |name: &str| view.late.get(name).map(|q| q.median);
    let ticks = late("duration_s").map_or(20.0, |duration| duration / BETWEEN / period_s);
    let track = minimum_jerk(late("distance_m").unwrap_or(1.0), (ticks.round() as usize).max(4));
    measure(&track, period_s, definitions)
}

impl Analysis {
    /// The movements without noise, or as they were where the former are not known.
    pub fn best(&self) -> &MovementGroups {
        self.noiseless.as_ref().unwrap_or(&self.measured)
    }

    /// What the figure shows.
    pub fn figure(&self) -> MovementsFigure {
        let rows: Vec<(&MovementRow, &Measures)> = match self.noiseless {
            Some(_) => self.rows.iter().filter_map(|row| Some((row, row.noiseless.as_ref()?))).collect(),
            None => self.rows.iter().map(|row| (row, &row.measured)).collect(),
        };
        let part = part(rows.len());
        let view = self.best();
        let dots = |rows: &[(&MovementRow, &Measures)], group: &MovementGroup| MovementDots {
            duration: rows.iter().filter_map(|(_, m)| Some((m.distance_m, m.duration_s?))).collect(),
            peak_speed: rows.iter().filter_map(|(_, m)| Some((m.distance_m, m.peak_speed?))).collect(),
            settled: rows.iter().map(|(_, m)| m.settled_s).collect(),
            profile: group.profile.iter().map(|q| [q.q25, q.median, q.q75]).collect(),
        };
        let lines = |of: fn(&Isochrony) -> Option<Fit>| {
            [&view.all, &view.late].map(|group| of(&group.isochrony).map(|fit| (fit.intercept, fit.slope)))
        };
        MovementsFigure {
            title: format!(
                "{}, seed {}: {} movements{}",
                self.scenario,
                self.seed,
                thousands(rows.len() as u64),
                if self.noiseless.is_some() { ", without exploration noise" } else { ", as measured" }
            ),
            early: dots(&rows[..part], &view.early),
            middle: dots(rows.get(part..rows.len() - part).unwrap_or_default(), &view.all),
            late: dots(&rows[rows.len() - part..], &view.late),
            duration_lines: lines(|i| i.duration),
            peak_speed_lines: lines(|i| i.peak_speed),
            wake: SpeedProfile { profile: self.minimum_jerk.profile.iter().map(|&x| f64::from(x)).collect() },
            near_m: self.definitions.near_m,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Twelve minimum-jerk movements over different distances, all equally long: perfect isochrony.
    #[test]
    fn isochrony_is_found() {
        let rows: Vec<MovementRow> = (1..=12)
            .map(|i| {
                let track = minimum_jerk(0.1 * f64::from(i), 20);
                let measured = measure(&track, 0.05, &Definitions { onset: 0.0, ..Definitions::default() });
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
        assert_eq!([0, 1, 2, 5, 15, 20, 74, 100, 1000].map(part), [0, 1, 1, 2, 7, 10, 10, 10, 100]);
    }
}
