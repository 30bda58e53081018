//! Figure and tables of how a controller learned, for the end of a run.
//!
//! A [`RunHistory`] is plain numbers, and travels as JSON between processes. [`figure::draw`] makes one SVG
//! of it, [`table`] a few lines of text. Both depend on these numbers alone: equal numbers give equal bytes
//! on every machine. [`progress_table`] and [`sentence`] are for runs whose policies were tested without
//! exploration noise. [`film`] shows the movements of a log, [`stats`] has the statistics behind all of it.
//!
//! ```
//! use tectum_report::stats::Spread;
//! use tectum_report::text::thousands;
//!
//! let ticks = Spread::of([300.0, 340.0, 1200.0]).unwrap();
//! assert_eq!((ticks.median, thousands(ticks.max as u64).as_str()), (340.0, "1,200"));
//! ```

#![warn(missing_docs)]

pub mod figure;
pub mod film;
mod progress;
pub mod stats;
pub mod text;

pub use progress::{ProgressRow, REACHES_M, Reached, progress_table, sentence};

use serde::{Deserialize, Deserializer, Serialize};
use std::path::PathBuf;

use crate::stats::{Window, number_or_nan};
use crate::text::{columns, figures, thousands};

/// A movement towards one target, posture by posture.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Reach {
    /// First tick.
    pub from: u64,
    /// Position of the target.
    pub target: [f64; 2],
    /// One polyline a tick, from the base over the joints to the end-effector.
    #[serde(deserialize_with = "points")]
    pub postures: Vec<Vec<[f64; 2]>>,
}

/// The numbers behind a run's figure and tables.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RunHistory {
    /// Title of the figure.
    pub title: String,
    /// Unit of errors and positions, `m` for the arm; may be empty.
    pub unit: String,
    /// Period of a tick, s.
    pub period_s: f64,
    /// In the order of time.
    pub windows: Vec<Window>,
    /// What happened at which tick, for example `joint 3 blocked`.
    pub marks: Vec<(u64, String)>,
    /// A reach from the run's beginning, if the plant has postures.
    pub first_reach: Option<Reach>,
    /// A typical reach from its end.
    pub last_reach: Option<Reach>,
    /// Tests of the policy without exploration noise, in the order of ticks; empty where there were none.
    #[serde(default)]
    pub tests: Vec<TestPoint>,
    /// What the best movements reach in the test, span by span; empty where that is unknown.
    #[serde(default)]
    pub optimum: Vec<OptimumSpan>,
}

/// A test of a policy.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TestPoint {
    /// Ticks done before it.
    pub tick: u64,
    /// Median error at a target's end; not a number if the policy was none.
    #[serde(deserialize_with = "number_or_nan")]
    pub error: f64,
}

/// The optimum of the test in a stretch of the run in which the plant did not change.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct OptimumSpan {
    /// First tick.
    pub from: u64,
    /// Tick after the last.
    pub until: u64,
    /// Median error at a target's end.
    pub error: f64,
    /// Median loss a tick.
    pub loss: f64,
}

/// Why a report cannot be made.
#[derive(Debug, thiserror::Error)]
pub enum ReportError {
    /// The drawing library refused.
    #[error("the figure cannot be drawn: {0}")]
    Draw(String),
    /// The file cannot be written.
    #[error("the figure {} cannot be written: {error}; choose another --out", path.display())]
    Write {
        /// The figure's file.
        path: PathBuf,
        /// What the operating system said.
        error: std::io::Error,
    },
}

fn points<'de, D: Deserializer<'de>>(from: D) -> Result<Vec<Vec<[f64; 2]>>, D::Error> {
    let lines = Vec::<Vec<[Option<f64>; 2]>>::deserialize(from)?;
    let point = |p: [Option<f64>; 2]| p.map(|x| x.unwrap_or(f64::NAN));
    Ok(lines.into_iter().map(|line| line.into_iter().map(point).collect()).collect())
}

/// First and last window as text, one line each under a head with the units. `-` is a missing value. For
/// plants without a test: all values are means over the ticks of the window, as observed.
pub fn table(history: &RunHistory) -> String {
    let with_unit =
        |name: &str| if history.unit.is_empty() { name.to_owned() } else { format!("{name} ({})", history.unit) };
    let mut rows = vec![[
        "means over ticks".to_owned(),
        "loss a tick".to_owned(),
        "without noise".to_owned(),
        with_unit("RMS error"),
        with_unit("error at a target's end"),
        "targets".to_owned(),
    ]];
    let (first, last) = (history.windows.first(), history.windows.last());
    let ends = match (first, last) {
        (Some(first), Some(last)) if first == last => vec![("", first)],
        (Some(first), Some(last)) => vec![("first ", first), ("last ", last)],
        _ => Vec::new(),
    };
    for (which, w) in ends {
        let last_tick = w.from.saturating_add(w.ticks).saturating_sub(1);
        rows.push([
            format!("{which}{} to {}", thousands(w.from), thousands(last_tick)),
            figures(Some(w.loss)),
            figures(Some(w.loss_without_noise())),
            figures(w.rms_error()),
            figures(w.end_error),
            thousands(w.ends),
        ]);
    }
    if history.windows.is_empty() {
        rows.push(std::array::from_fn(|_| "-".to_owned()));
    }
    columns(&rows)
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    /// The shape of the paper's run: 120 windows, a joint blocked at the 93rd.
    pub fn arm_history() -> RunHistory {
        let window = |i: u64| {
            let t = i as f64 / 20.0;
            let hurt = if i >= 93 { 0.012 * (-(i as f64 - 93.0) / 8.0).exp() + 0.004 } else { 0.0 };
            let wiggle = 0.0015 * (i as f64 * 2.3).sin();
            let error = 0.42 + 0.75 * (-t).exp() + 5.0 * hurt + 3.0 * wiggle;
            Window {
                from: i * 100_000,
                ticks: 100_000,
                noise_share: 0.0355,
                loss: 0.071 + 0.14 * (-t).exp() + hurt + wiggle,
                mean_squared_error: Some(error * error),
                end_error: Some(error - 0.16),
                ends: 1250,
            }
        };
        RunHistory {
            title: "Closed-loop arm, the paper's rule, seed 1".into(),
            unit: "m".into(),
            period_s: 0.05,
            windows: (0..120).map(window).collect(),
            marks: vec![(9_300_000, "joint 3 blocked".into())],
            first_reach: Some(reach(80, [0.6, 0.5], 0.15)),
            last_reach: Some(reach(11_999_920, [-0.55, 0.35], 1.0)),
            tests: tests(),
            optimum: vec![
                OptimumSpan { from: 0, until: 9_300_000, error: 0.035, loss: 0.0172 },
                OptimumSpan { from: 9_300_000, until: 12_000_000, error: 0.05, loss: 0.022 },
            ],
        }
    }

    fn tests() -> Vec<TestPoint> {
        let before = (0..=31).map(|i| (i * 300_000, 0.05 + 1.1 * (-(i as f64) / 4.0).exp()));
        let after = (31..=40).map(|i| (i * 300_000, 0.07 + 0.3 * (-(i as f64 - 31.0) / 2.0).exp()));
        before.chain(after).map(|(tick, error)| TestPoint { tick, error }).collect()
    }

    fn reach(from: u64, target: [f64; 2], skill: f64) -> Reach {
        let start = [0.3, 0.9, 1.3, 0.4];
        let end = [2.6, 2.0, 1.6, 1.9];
        let posture = |k: usize| {
            let s = skill * (1.0 - (-(k as f64) / 6.0).exp());
            let mut at = [0.0, -1.0];
            let mut line = vec![at];
            for d in 0..4 {
                let shake = 0.05 * ((k * (d + 2)) as f64).sin();
                let angle: f64 = start[d] + s * (end[d] - start[d]) + shake;
                at = [at[0] + 0.5 * angle.cos(), at[1] + 0.5 * angle.sin()];
                line.push(at);
            }
            line
        };
        Reach { from, target, postures: (0..30).map(posture).collect() }
    }

    #[test]
    fn the_table_has_first_and_last_window_under_units() {
        let mut history = arm_history();
        history.windows.truncate(3);
        history.windows[0] = Window {
            from: 0,
            ticks: 1000,
            loss: 0.1655,
            noise_share: 0.0355,
            mean_squared_error: Some(1.21),
            end_error: Some(0.87654),
            ends: 12,
        };
        history.windows[2] = Window {
            from: 2000,
            ticks: 500,
            loss: 0.0728,
            noise_share: 0.0355,
            mean_squared_error: None,
            end_error: None,
            ends: 0,
        };
        let expected = "\
means over ticks     loss a tick  without noise  RMS error (m)  error at a target's end (m)  targets
first 0 to 999             0.166          0.130           1.10                        0.877       12
last 2,000 to 2,499       0.0728         0.0373              -                            -        0
";
        assert_eq!(table(&history), expected);
        history.windows.truncate(1);
        assert_eq!(table(&history).lines().count(), 2);
        history.windows.clear();
        assert!(table(&history).lines().last().unwrap().starts_with("-  "));
    }

    #[test]
    fn a_history_travels_as_json() {
        let history = arm_history();
        let back: RunHistory = serde_json::from_str(&serde_json::to_string(&history).unwrap()).unwrap();
        assert!(back == history, "to the last bit");
        let mut diverged = arm_history();
        diverged.windows[7].loss = f64::NAN;
        diverged.windows[7].end_error = Some(f64::INFINITY);
        diverged.last_reach.as_mut().unwrap().postures[3][2] = [f64::NAN; 2];
        let back: RunHistory = serde_json::from_str(&serde_json::to_string(&diverged).unwrap()).unwrap();
        assert!(back.windows[7].loss.is_nan() && back.windows[7].end_error.is_none());
        assert!(back.last_reach.unwrap().postures[3][2][0].is_nan());
        assert!(table(&RunHistory { windows: back.windows[7..8].to_vec(), ..history }).contains(" - "));
    }
}
