//! What a page shows of a log: loss and error over time, how an arm moved, and histograms of latency.
//!
//! One pass, in bounded memory: curves are means over a fixed number of stretches of the run, and postures are kept of
//! some hundred ticks at the beginning, after each change of the arm, and at the end.

use std::collections::{BTreeMap, VecDeque};

use hdrhistogram::Histogram;
use serde_json::{Value, json};

use crate::log::{LatencyHistograms, LogRecord, RunLog};
use crate::plant::posture;
use crate::scenario::{ArmConfig, Plan};
use crate::supervise::body_changes;
use crate::wire::{Observation, flag};

/// Points of a curve.
const POINTS: usize = 240;
/// Ticks of a movement that is shown.
const MOVEMENT_TICKS: usize = 240;
/// Most changes of the arm that are shown.
const MOST_CHANGES: usize = 6;
/// Bins of a histogram in a factor of ten.
const BINS_A_DECADE: f64 = 8.0;
/// What the histograms are of, in the order of [`LatencyHistograms`].
const LATENCIES: [&str; 3] = ["wake-up lateness", "observation to command", "command to applied"];

/// What is taken from a log.
pub(super) struct LogDigest {
    /// The log's description of its run.
    pub description: BTreeMap<String, String>,
    period_s: f64,
    curves: Curves,
    movements: Movements,
    latencies: Option<LatencyHistograms>,
}

impl LogDigest {
    /// Reads `log` to its end, or as far as that goes. `ticks` is the length of the run, if it is known. What is wrong
    /// with the log is added to `notes`.
    pub fn of(mut log: RunLog, plan: Option<&Plan>, ticks: Option<u64>, notes: &mut Vec<String>) -> Self {
        let number = |key: &str| log.run(key).and_then(|text| text.parse::<u64>().ok());
        let period_ns = number("period_ns").unwrap_or(0);
        let ticks = ticks.or_else(|| number("ticks")).unwrap_or(0);
        let mut digest = Self {
            description: log.description().clone(),
            period_s: period_ns as f64 / 1e9,
            curves: Curves::new(ticks, plan.and_then(|plan| plan.error)),
            movements: Movements::new(plan),
            latencies: (log.run("clock") == Some("CLOCK_MONOTONIC")).then(|| LatencyHistograms::new(period_ns)),
        };
        for record in log.by_ref() {
            match record {
                Ok(record) => digest.take(&record),
                Err(error) => notes.push(format!("The log is shown as far as it can be read: {error}.")),
            }
        }
        if !log.finished() {
            notes.push("The log has no end: its logger was killed, or is still writing.".to_owned());
        }
        digest
    }

    fn take(&mut self, record: &LogRecord) {
        if let Some(latencies) = &mut self.latencies {
            latencies.take(record);
        }
        if let LogRecord::Observation(observation) = record {
            self.curves.take(observation);
            self.movements.take(observation);
        }
    }

    /// The digest as the page takes it. Instants are in seconds from tick 0, lengths in mm.
    pub fn to_json(&self) -> Value {
        let latencies = self.latencies.as_ref().map(|latencies| {
            let of = LATENCIES.iter().zip(latencies.histograms());
            of.map(|(name, histogram)| json!({"name": name, "bins": bins(histogram)})).collect::<Vec<_>>()
        });
        json!({
            "period_s": self.period_s,
            "curves": self.curves.to_json(self.period_s),
            "movements": self.movements.to_json(),
            "latencies": latencies,
        })
    }
}

/// Lower end of each bin, us, and its count; from the first that is not empty to the last.
fn bins(histogram: &Histogram<u64>) -> Vec<(f64, u64)> {
    let mut counts: BTreeMap<i32, u64> = BTreeMap::new();
    for value in histogram.iter_recorded() {
        let us = (value.value_iterated_to() as f64 / 1e3).max(0.1);
        *counts.entry((us.log10() * BINS_A_DECADE).floor() as i32).or_default() += value.count_at_value();
    }
    let (Some(first), Some(last)) = (counts.keys().next(), counts.keys().last()) else { return Vec::new() };
    let low = |bin: i32| 10_f64.powf(f64::from(bin) / BINS_A_DECADE);
    (*first..=*last).map(|bin| (low(bin), counts.get(&bin).copied().unwrap_or(0))).collect()
}

/// Means of loss and error over equal stretches of the run.
struct Curves {
    ticks_a_point: u64,
    error: Option<usize>,
    /// Count and sum of each, by stretch.
    sums: BTreeMap<u64, [(u64, f64); 2]>,
}

impl Curves {
    fn new(ticks: u64, error: Option<usize>) -> Self {
        Self { ticks_a_point: ticks.div_ceil(POINTS as u64).max(1), error, sums: BTreeMap::new() }
    }

    fn take(&mut self, observation: &Observation) {
        // The first reward belongs to no tick.
        let Some(tick) = observation.header.tick.checked_sub(1) else { return };
        if observation.header.flags & flag::FIRST != 0 {
            return;
        }
        let error = self.error.map_or(f32::NAN, |index| observation.measures[index]);
        let sums = self.sums.entry(tick / self.ticks_a_point).or_default();
        for ((count, sum), value) in sums.iter_mut().zip([-observation.reward, error]) {
            if value.is_finite() {
                *count += 1;
                *sum += f64::from(value);
            }
        }
    }

    fn to_json(&self, period_s: f64) -> Value {
        let middle = |point: &u64| (*point as f64 + 0.5) * self.ticks_a_point as f64 * period_s;
        let mean = |i: usize| {
            let of = |(count, sum): (u64, f64)| (count > 0).then(|| sum / count as f64);
            self.sums.values().map(|sums| of(sums[i])).collect::<Vec<_>>()
        };
        let error = self.error.map(|_| mean(1));
        json!({ "t": self.sums.keys().map(middle).collect::<Vec<_>>(), "loss": mean(0), "error": error })
    }
}

/// A posture of the arm, and its target.
struct Pose {
    tick: u64,
    /// Base, joints and end-effector, mm.
    points: Vec<[i32; 2]>,
    target: [i32; 2],
}

/// How an arm moved, in some stretches of the run.
struct Movements {
    arm: Option<ArmConfig>,
    /// First tick and label of each stretch but the last.
    beginnings: Vec<(u64, String)>,
    kept: Vec<Vec<Pose>>,
    last: VecDeque<Pose>,
}

impl Movements {
    fn new(plan: Option<&Plan>) -> Self {
        let arm = plan.and_then(Plan::drawable_arm).cloned();
        let changes = arm.as_ref().map_or_else(Vec::new, body_changes).into_iter().take(MOST_CHANGES);
        let mut beginnings = vec![(0, "at the beginning".to_owned())];
        beginnings.extend(changes.map(|change| (change.tick, format!("after: {}", change.label))));
        let kept = beginnings.iter().map(|_| Vec::new()).collect();
        Self { arm, beginnings, kept, last: VecDeque::new() }
    }

    fn take(&mut self, observation: &Observation) {
        let Some(arm) = &self.arm else { return };
        let (tick, inputs) = (observation.header.tick, &observation.inputs[..2 + arm.lengths.len()]);
        if !inputs.iter().all(|x| x.is_finite()) {
            return;
        }
        let millimetres = |x: f64| (1e3 * x).round() as i32;
        let pose = || {
            let target = arm.reported_target(tick, [inputs[0], inputs[1]]).map(f64::from);
            Pose {
                tick,
                points: posture(&arm.at(tick), &inputs[2..]).iter().map(|p| p.map(millimetres)).collect(),
                target: target.map(millimetres),
            }
        };
        for ((from, _), kept) in self.beginnings.iter().zip(&mut self.kept) {
            if tick >= *from && kept.len() < MOVEMENT_TICKS {
                kept.push(pose());
            }
        }
        if self.last.len() == MOVEMENT_TICKS {
            self.last.pop_front();
        }
        self.last.push_back(pose());
    }

    fn to_json(&self) -> Value {
        let pose = |pose: &Pose| json!([pose.tick, pose.points, pose.target]);
        let movement = |label: &str, poses: Vec<Value>| json!({"label": label, "poses": poses});
        let kept = self.beginnings.iter().zip(&self.kept).filter(|(_, kept)| kept.len() > 1);
        let mut movements: Vec<_> =
            kept.map(|((_, label), kept)| movement(label, kept.iter().map(pose).collect())).collect();
        // A run that is shorter than two stretches is shown whole by the first.
        if self.last.front().is_some_and(|first| first.tick >= MOVEMENT_TICKS as u64) {
            movements.push(movement("at the end", self.last.iter().map(pose).collect()));
        }
        movements.into()
    }
}
