//! The measures of one movement: the path of the end-effector, tick by tick, towards a target. Pure
//! functions.
//!
//! The measures and their sources:
//!
//! - *Speed* is the tangential speed of the end-effector, the distance between two ticks over the period. The
//!   *reach* lasts from the first to the last tick whose speed is at least [`Definitions::onset`] of the peak
//!   speed, the usual threshold of 5 %. A reach that has not ended when the next target appears has no
//!   duration, no mean speed and no profile.
//! - *Bell shape* (Morasso 1981; Flash & Hogan 1985, the paper's reference 13): the speed's peak lies in the
//!   middle of the reach, the profile is its own mirror image, has one peak, and peak speed over mean speed
//!   is 1.875 for the movement of minimum jerk from rest to rest; counted between thresholds of 5 % it is
//!   1.66. See [`minimum_jerk`].
//! - *Straightness* (Morasso 1981; Atkeson & Hollerbach 1985): the length of the path over the straight line
//!   between its ends, 1 for a straight one, and the largest distance of the path from that line over its
//!   length, 0 for a straight one.
//! - *Settling*: the time from the target's appearance to the first tick from which on the error stays within
//!   a tolerance: a fixed one, and a share of the distance to the target.
//!
//! A measure that does not exist (the ratio of speeds of an arm that never moved) is `None`, never NaN.

use serde::{Serialize, Serializer};

/// The thresholds of the measures.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub(crate) struct Definitions {
    /// A reach begins and ends at this share of its peak speed.
    pub onset: f64,
    /// A peak counts if the speed rises and falls by this share of the largest one around it.
    pub peak: f64,
    /// Fixed tolerance of settling, m.
    pub near_m: f64,
    /// Tolerance of settling as a share of the distance to the target.
    pub near_share: f64,
}

impl Default for Definitions {
    fn default() -> Self {
        Self { onset: 0.05, peak: 0.1, near_m: 0.1, near_share: 0.1 }
    }
}

/// Points of a time-normalised speed profile, from the beginning of the reach to its end.
pub(super) const PROFILE: usize = 41;

/// A recorded movement.
#[derive(Debug, Clone, PartialEq, Default)]
pub(crate) struct RecordedMovement {
    /// Positions of the end-effector, m: when the target appeared, and after every tick.
    pub points: Vec<[f64; 2]>,
    /// Distance from the target after every tick, m; one fewer than points.
    pub errors: Vec<f64>,
    /// Distance from the target when it appeared, m.
    pub distance: f64,
}

/// The measures of one movement.
#[derive(Debug, Clone, PartialEq, Default)]
pub(crate) struct Measures {
    /// Distance from the target when it appeared, m.
    pub distance_m: f64,
    /// From the target's appearance to the beginning of the reach, s.
    pub onset_s: Option<f64>,
    /// Duration of the reach, s; `None` if it had not ended when the next target appeared.
    pub duration_s: Option<f64>,
    /// Peak speed, m/s.
    pub peak_speed: Option<f64>,
    /// Mean speed of the reach, m/s.
    pub mean_speed: Option<f64>,
    /// Peak speed over mean speed.
    pub peak_to_mean: Option<f64>,
    /// Position of the peak in the reach: 0 at its beginning, 1 at its end.
    pub peak_position: Option<f64>,
    /// 1 if the speed profile equals its mirror image, 0 if the two do not overlap.
    pub symmetry: Option<f64>,
    /// Number of peaks of the speed: sub-movements.
    pub peaks: Option<f64>,
    /// Length of the reach's path over the straight line between its ends.
    pub straightness: Option<f64>,
    /// Largest distance of the reach's path from that line over the line's length.
    pub deviation: Option<f64>,
    /// From the target's appearance until the error stays within the fixed tolerance, s; `None` if it never
    /// does.
    pub settled_s: Option<f64>,
    /// The same for the tolerance that is a share of the distance.
    pub settled_share_s: Option<f64>,
    /// Error when the next target appeared, m.
    pub end_error_m: Option<f64>,
    /// Speed over mean speed at [`PROFILE`] points of the reach; empty for a reach without a duration.
    pub profile: Vec<f32>,
}

/// A measure: its name in JSON and CSV, and its value.
pub(super) type Column = (&'static str, fn(&Measures) -> Option<f64>);

/// All measures that are one number, in the order of reports.
pub(super) const COLUMNS: [Column; 14] = [
    ("distance_m", |m| Some(m.distance_m)),
    ("onset_s", |m| m.onset_s),
    ("duration_s", |m| m.duration_s),
    ("peak_speed_m_s", |m| m.peak_speed),
    ("mean_speed_m_s", |m| m.mean_speed),
    ("peak_to_mean", |m| m.peak_to_mean),
    ("peak_position", |m| m.peak_position),
    ("symmetry", |m| m.symmetry),
    ("peaks", |m| m.peaks),
    ("straightness", |m| m.straightness),
    ("deviation", |m| m.deviation),
    ("settled_s", |m| m.settled_s),
    ("settled_share_s", |m| m.settled_share_s),
    ("end_error_m", |m| m.end_error_m),
];

impl Serialize for Measures {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_map(COLUMNS.iter().map(|(name, value)| (name, value(self))))
    }
}

/// Measures a movement. `period_s` is the time between two points, s.
pub(crate) fn measure(movement: &RecordedMovement, period_s: f64, definitions: &Definitions) -> Measures {
    let mut measures = Measures {
        distance_m: movement.distance,
        settled_s: settled(&movement.errors, movement.distance, definitions.near_m, period_s),
        settled_share_s: settled(
            &movement.errors,
            movement.distance,
            definitions.near_share * movement.distance,
            period_s,
        ),
        end_error_m: movement.errors.last().copied(),
        ..Measures::default()
    };
    let speeds: Vec<f64> = movement.points.windows(2).map(|p| distance(p[0], p[1]) / period_s).collect();
    let Some((from, until)) = reach(&speeds, definitions.onset) else { return measures };
    let (reach, ticks) = (&speeds[from..until], (until - from) as f64);
    let (at, peak) = peak(&speeds);
    let sum: f64 = reach.iter().sum();
    measures.onset_s = Some(from as f64 * period_s);
    measures.peak_speed = Some(peak);
    measures.peaks = Some(peaks(reach, definitions.peak * peak) as f64);
    let (start, end) = (movement.points[from], movement.points[until]);
    let line = distance(start, end);
    measures.straightness = ratio(sum * period_s, line);
    let off = movement.points[from..=until].iter().map(|&p| off_line(p, start, end, line)).fold(0.0, f64::max);
    measures.deviation = ratio(off, line);
    if until == speeds.len() {
        return measures;
    }
    let mean = sum / ticks;
    measures.duration_s = Some(ticks * period_s);
    measures.mean_speed = Some(mean);
    measures.peak_to_mean = ratio(peak, mean);
    measures.peak_position = Some(((at - from as f64) / ticks).clamp(0.0, 1.0));
    let halves: f64 = reach.iter().zip(reach.iter().rev()).map(|(a, b)| (a - b).abs()).sum();
    measures.symmetry = ratio(halves, 2.0 * sum).map(|unlike| 1.0 - unlike);
    measures.profile = (0..PROFILE)
        .map(|i| (sample(&speeds, from as f64 + ticks * i as f64 / (PROFILE - 1) as f64) / mean) as f32)
        .collect();
    measures
}

/// The minimum-jerk movement over `distance_m` in `ticks` ticks, straight along x, followed by as many ticks
/// of rest (Flash & Hogan 1985, equation for a point-to-point movement from rest to rest).
pub(super) fn minimum_jerk(distance_m: f64, ticks: usize) -> RecordedMovement {
    let position = |tick: usize| {
        let t = (tick as f64 / ticks.max(1) as f64).min(1.0);
        distance_m * t * t * t * (10.0 - 15.0 * t + 6.0 * t * t)
    };
    let points: Vec<[f64; 2]> = (0..=2 * ticks).map(|tick| [position(tick), 0.0]).collect();
    let errors = points[1..].iter().map(|p| distance_m - p[0]).collect();
    RecordedMovement { points, errors, distance: distance_m }
}

fn distance(a: [f64; 2], b: [f64; 2]) -> f64 {
    (a[0] - b[0]).hypot(a[1] - b[1])
}

/// A quotient; `None` if it is not a finite number.
fn ratio(a: f64, b: f64) -> Option<f64> {
    let ratio = a / b;
    ratio.is_finite().then_some(ratio)
}

/// The range of ticks, its end exclusive, from the first to the last speed of at least `share` of the peak
/// speed. `None` if nothing moved.
fn reach(speeds: &[f64], share: f64) -> Option<(usize, usize)> {
    let peak = speeds.iter().copied().fold(0.0, f64::max);
    let moving = |&speed: &f64| speed > 0.0 && speed >= share * peak;
    let from = speeds.iter().position(moving)?;
    Some((from, speeds.iter().rposition(moving)? + 1))
}

/// Position (in ticks) and size of the speed's peak: the vertex of a parabola through the largest speed and
/// its two neighbours, because the true peak lies between ticks.
fn peak(speeds: &[f64]) -> (f64, f64) {
    let at = (0..speeds.len()).fold(0, |best, i| if speeds[i] > speeds[best] { i } else { best });
    let middle = at as f64 + 0.5;
    if at == 0 || at + 1 == speeds.len() {
        return (middle, speeds[at]);
    }
    let (before, here, after) = (speeds[at - 1], speeds[at], speeds[at + 1]);
    let bend = before - 2.0 * here + after;
    let shift = ratio(0.5 * (before - after), bend).unwrap_or(0.0).clamp(-0.5, 0.5);
    (middle + shift, here - 0.25 * (before - after) * shift)
}

/// Number of peaks whose speed rises and falls by at least `height`. The speed is 0 before and after.
fn peaks(speeds: &[f64], height: f64) -> usize {
    let (mut count, mut rising, mut low, mut high) = (0, true, 0.0, 0.0_f64);
    for &speed in speeds.iter().chain([&0.0]) {
        high = high.max(speed);
        low = speed.min(low);
        if rising && speed <= high - height && high >= low + height {
            count += 1;
            (rising, low) = (false, speed);
        } else if !rising && speed >= low + height {
            (rising, high) = (true, speed);
        }
    }
    count
}

/// Distance of `p` from the straight line through `start` and `end`, which lie `line` apart.
fn off_line(p: [f64; 2], start: [f64; 2], end: [f64; 2], line: f64) -> f64 {
    let along = [(end[0] - start[0]) / line, (end[1] - start[1]) / line];
    (along[0] * (p[1] - start[1]) - along[1] * (p[0] - start[0])).abs()
}

/// The speed `at` ticks after the target's appearance, interpolated between the middles of the ticks.
fn sample(speeds: &[f64], at: f64) -> f64 {
    let x = (at - 0.5).clamp(0.0, (speeds.len() - 1) as f64);
    let (i, part) = (x.floor() as usize, x.fract());
    let next = speeds[(i + 1).min(speeds.len() - 1)];
    speeds[i] + part * (next - speeds[i])
}

/// The time until the error stays within `tolerance`, s; `None` if the last error is not within it.
fn settled(errors: &[f64], distance: f64, tolerance: f64, period_s: f64) -> Option<f64> {
    let within = |&error: &f64| error <= tolerance;
    if !errors.last().is_some_and(within) {
        return None;
    }
    match errors.iter().rposition(|error| !within(error)) {
        Some(last_out) => Some((last_out + 2) as f64 * period_s),
        None if within(&distance) => Some(0.0),
        None => Some(period_s),
    }
}

#[cfg(test)]
#[path = "movement_tests.rs"]
mod tests;
