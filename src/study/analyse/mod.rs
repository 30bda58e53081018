//! Analyses the movements of a run from its log: duration and peak speed against distance (isochrony), shape
//! of the speed profiles, straightness, settling; at the beginning of the run and at its end.
//!
//! The paper (section 5) asks whether learned movements have the properties of human gestures, isochrony and
//! bell-shaped speed profiles (its references 12 and 13). *Isochrony* means that movements over larger
//! distances are faster, so that their duration depends little on distance (Viviani & Terzuolo 1982; Viviani
//! & Schneider 1991): a straight line through durations against distances has a small slope, one through peak
//! speeds a large one. `movement.rs` defines the measures of a single movement.
//!
//! Where possible, every movement is measured twice: as recorded, and as the policy of that moment would have
//! made it without exploration noise (see `log_follower.rs`). For a plant of your own, only the recorded
//! movement is known.

mod collector;
mod cutter;
mod error;
mod groups;
mod log_follower;
pub(crate) mod movement;
mod text;

use std::path::{Path, PathBuf};

use serde::Serialize;

use crate::stats::{Fit, Quartiles};
use cutter::LeftOut;
pub use error::AnalyseError;

use crate::log::{LogRecord, RunLog};
use crate::report::figure::{MovementDots, MovementsFigure, SpeedProfile};
use crate::scenario::{Plan, Scenario};
use crate::supervise::RunProgress;
use crate::text::thousands;
use collector::MovementCollector;
use groups::{Isochrony, MeasuredRow, MovementGroup, MovementGroups, MovementRow, edge_count};
use movement::{Definitions, Measures, measure, minimum_jerk};

/// The result of an analysis: the movements of a run.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Analysis {
    /// The log.
    log: PathBuf,
    /// The scenario's name.
    scenario: String,
    /// The run's seed.
    seed: u64,
    /// Period of a tick, s.
    period_s: f64,
    /// Ticks that the log holds.
    ticks: u64,
    /// The log was cut off, and was analysed as far as it goes.
    torn: bool,
    /// Number of movements.
    n: usize,
    /// Movements that were left out.
    left_out: LeftOut,
    /// Thresholds of the measures.
    definitions: Definitions,
    /// Without exploration noise; null where that is not known.
    noiseless: Option<MovementGroups>,
    /// Why all noiseless movements, or those from some tick on, are missing; null where none is missing.
    noiseless_missing: Option<String>,
    /// As recorded.
    measured: MovementGroups,
    /// The measures of a minimum-jerk movement with distance and duration of the median movement at the run's
    /// end.
    minimum_jerk: Measures,
    /// The movements, one by one.
    #[serde(skip)]
    rows: Vec<MovementRow>,
}

/// Analyses the movements in the log in `segments`, which belong to one run and stand in its order.
///
/// With `noiseless`, plant and controller are run again along the log to find the movements without
/// exploration noise. This takes as long as the learning took. With `progress`, a progress line is shown on
/// standard error, if that is a terminal.
///
/// # Errors
/// [`AnalyseError`] if it is not a log, does not hold every tick, or its plant does not measure error and
/// end-effector.
pub fn analyse(segments: &[PathBuf], noiseless: bool, progress: bool) -> Result<Analysis, AnalyseError> {
    let mut log = RunLog::open(segments)?;
    let path = log.path().to_owned();
    let plan = plan_of(&log, &path)?;
    let every = log.every();
    if every > 1 {
        return Err(AnalyseError::Thinned { path, every });
    }
    let mut collector = MovementCollector::new(&plan, noiseless)?;
    let mut progress = RunProgress::study(&plan.scenario.name, plan.scenario.ticks, progress);
    for record in log.by_ref() {
        let record = record.inspect_err(|_| progress.clear())?;
        collector.take(&record);
        if let LogRecord::Observation(observation) = &record
            && collector.follows()
            && observation.header.tick.is_multiple_of(64)
        {
            progress.show_study(observation.header.tick, (f32::NAN, f32::NAN));
        }
    }
    progress.clear();
    result(&plan, path, !log.finished(), collector)
}

/// The statistics over what was collected from the log at `path`.
fn result(plan: &Plan, path: PathBuf, torn: bool, mut collector: MovementCollector) -> Result<Analysis, AnalyseError> {
    let left_out = collector.finish();
    let noiseless_missing = collector.noiseless_missing();
    let MovementCollector { definitions, period_s, rows, ticks, .. } = collector;
    let noiseless = MovementGroups::of(&noiseless_rows(&rows));
    let measured = MovementGroups::of(&measured_rows(&rows)).ok_or_else(|| AnalyseError::NoMovement {
        path: path.clone(),
        why: format!("{ticks} ticks, {} movements left out", left_out.total()),
    })?;
    Ok(Analysis {
        log: path,
        scenario: plan.scenario.name.clone(),
        seed: plan.scenario.seed,
        period_s,
        ticks,
        torn,
        n: rows.len(),
        left_out,
        definitions,
        minimum_jerk: matching_minimum_jerk(noiseless.as_ref().unwrap_or(&measured), period_s, &definitions),
        noiseless,
        noiseless_missing,
        measured,
        rows,
    })
}

fn measured_rows(rows: &[MovementRow]) -> Vec<MeasuredRow<'_>> {
    rows.iter().map(|row| (row, &row.measured)).collect()
}

fn noiseless_rows(rows: &[MovementRow]) -> Vec<MeasuredRow<'_>> {
    rows.iter().filter_map(|row| Some((row, row.noiseless.as_ref()?))).collect()
}

fn plan_of(log: &RunLog, path: &Path) -> Result<Plan, AnalyseError> {
    Scenario::parse(log.scenario(), "scenario.toml")
        .and_then(Scenario::plan)
        .map_err(|error| AnalyseError::Scenario { path: path.to_owned(), error: Box::new(error) })
}

/// A minimum-jerk movement to compare with. It has the distance of the median movement at the run's end, and
/// between the thresholds its duration, rounded to whole ticks.
fn matching_minimum_jerk(groups: &MovementGroups, period_s: f64, definitions: &Definitions) -> Measures {
    /// Share of the whole minimum-jerk movement between thresholds of 5 % of its peak speed.
    const BETWEEN: f64 = 0.881;
    let late = |name: &str| groups.late.get(name).map(|q| q.median);
    let ticks = late("duration_s").map_or(20.0, |duration| duration / BETWEEN / period_s);
    let movement = minimum_jerk(late("distance_m").unwrap_or(1.0), (ticks.round() as usize).max(4));
    measure(&movement, period_s, definitions)
}

impl Analysis {
    /// The noiseless movements, or the recorded ones where the former are not known.
    fn best(&self) -> &MovementGroups {
        self.noiseless.as_ref().unwrap_or(&self.measured)
    }

    /// The contents of the figure.
    pub fn figure(&self) -> MovementsFigure {
        let rows = match self.noiseless {
            Some(_) => noiseless_rows(&self.rows),
            None => measured_rows(&self.rows),
        };
        let count = edge_count(rows.len());
        let groups = self.best();
        let dots = |rows: &[MeasuredRow], group: &MovementGroup| MovementDots {
            duration: rows.iter().filter_map(|(_, m)| Some((m.distance_m, m.duration_s?))).collect(),
            peak_speed: rows.iter().filter_map(|(_, m)| Some((m.distance_m, m.peak_speed?))).collect(),
            settled: rows.iter().map(|(_, m)| m.settled_s).collect(),
            profile: group.profile.iter().map(|q| [q.q25, q.median, q.q75]).collect(),
        };
        let lines = |of: fn(&Isochrony) -> Option<Fit>| {
            [&groups.all, &groups.late].map(|group| of(&group.isochrony).map(|fit| (fit.intercept, fit.slope)))
        };
        MovementsFigure {
            title: format!(
                "{}, seed {}: {} movements{}",
                self.scenario,
                self.seed,
                thousands(rows.len() as u64),
                if self.noiseless.is_some() { ", without exploration noise" } else { ", as measured" }
            ),
            early: dots(&rows[..count], &groups.early),
            middle: dots(rows.get(count..rows.len() - count).unwrap_or_default(), &groups.all),
            late: dots(&rows[rows.len() - count..], &groups.late),
            duration_lines: lines(|i| i.duration),
            peak_speed_lines: lines(|i| i.peak_speed),
            wake: SpeedProfile { profile: self.minimum_jerk.profile.iter().map(|&x| f64::from(x)).collect() },
            near_m: self.definitions.near_m,
        }
    }
}
