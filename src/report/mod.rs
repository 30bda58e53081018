//! What a run's end shows: a figure and a table of how the controller learned.
//!
//! A [`RunHistory`] is plain numbers, collected window by window by whoever watches the run, and handed on as JSON if that is
//! another process. [`figure::draw`] makes one SVG of it, [`table`] a few lines of text. Both depend on the history alone: they
//! give the same bytes for the same numbers, on every machine.

pub mod figure;
pub mod film;

use serde::{Deserialize, Deserializer, Serialize};
use std::fmt::Write as _;
use std::path::PathBuf;

/// Means over some ticks in a row. Errors are in the history's [`unit`](RunHistory::unit).
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Window {
    /// First tick.
    pub from: u64,
    /// Number of ticks.
    pub ticks: u64,
    /// Mean loss (reward with its sign turned) per tick; not a number if a reward was none.
    #[serde(deserialize_with = "number")]
    pub loss: f64,
    /// What exploration noise alone costs a tick, part of the loss; 0 if unknown.
    pub noise_share: f64,
    /// Mean squared error, in squared units; `None` for a plant that measures none.
    pub mean_squared_error: Option<f64>,
    /// Mean error at the end of the targets that ended here; `None` if none did.
    pub end_error: Option<f64>,
    /// Number of targets that ended here.
    pub ends: u64,
}

/// A movement towards one target, posture by posture.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Reach {
    /// First tick.
    pub from: u64,
    /// The target's place.
    pub target: [f64; 2],
    /// One polyline a tick, from the base over the joints to the end-effector.
    #[serde(deserialize_with = "points")]
    pub postures: Vec<Vec<[f64; 2]>>,
}

/// How a run went.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RunHistory {
    /// Title of the figure.
    pub title: String,
    /// Unit of errors and places, `m` for the arm; may be empty.
    pub unit: String,
    /// Period of a tick, s.
    pub period_s: f64,
    /// In the order of time.
    pub windows: Vec<Window>,
    /// What happened at which tick, for example `joint 3 blocked`.
    pub marks: Vec<(u64, String)>,
    /// A reach from the run's beginning, if the plant has postures.
    pub first_reach: Option<Reach>,
    /// A reach from its end.
    pub last_reach: Option<Reach>,
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

/// JSON has no "not a number" and says null for it; a run that diverged must still get its report.
fn number<'de, D: Deserializer<'de>>(from: D) -> Result<f64, D::Error> {
    Ok(Option::<f64>::deserialize(from)?.unwrap_or(f64::NAN))
}

fn points<'de, D: Deserializer<'de>>(from: D) -> Result<Vec<Vec<[f64; 2]>>, D::Error> {
    let lines = Vec::<Vec<[Option<f64>; 2]>>::deserialize(from)?;
    let point = |p: [Option<f64>; 2]| p.map(|x| x.unwrap_or(f64::NAN));
    Ok(lines.into_iter().map(|line| line.into_iter().map(point).collect()).collect())
}

impl Window {
    /// Mean loss a tick without what exploration noise alone costs.
    pub fn loss_without_noise(&self) -> f64 {
        self.loss - self.noise_share
    }

    /// Square root of the mean squared error, in the story's unit.
    pub fn rms_error(&self) -> Option<f64> {
        self.mean_squared_error.map(f64::sqrt)
    }

    /// Two windows as one.
    pub fn and(&self, other: &Self) -> Self {
        let (a, b) = (self, other);
        let mean = |x: f64, n: u64, y: f64, m: u64| (x * n as f64 + y * m as f64) / (n + m) as f64;
        Self {
            from: a.from.min(b.from),
            ticks: a.ticks + b.ticks,
            noise_share: mean(a.noise_share, a.ticks, b.noise_share, b.ticks),
            loss: mean(a.loss, a.ticks, b.loss, b.ticks),
            mean_squared_error: a
                .mean_squared_error
                .zip(b.mean_squared_error)
                .map(|(x, y)| mean(x, a.ticks, y, b.ticks)),
            end_error: match (a.end_error, b.end_error) {
                (Some(x), Some(y)) => Some(mean(x, a.ends, y, b.ends)),
                (x, y) => x.or(y),
            },
            ends: a.ends + b.ends,
        }
    }
}

/// First and last window as text, one line each under a head with the units. `-` is a value that there is not.
pub fn table(history: &RunHistory) -> String {
    let unit = match history.unit.as_str() {
        "" => String::new(),
        unit => format!(" ({unit})"),
    };
    let mut rows = vec![[
        "ticks".to_owned(),
        "loss a tick".to_owned(),
        "without noise".to_owned(),
        format!("RMS error{unit}"),
        format!("error at a target's end{unit}"),
    ]];
    let last = history.windows.len().saturating_sub(1);
    for (_, w) in history.windows.iter().enumerate().filter(|(i, _)| *i == 0 || *i == last) {
        rows.push([
            format!("{} to {}", thousands(w.from), thousands(w.from.saturating_add(w.ticks).saturating_sub(1))),
            figures(Some(w.loss)),
            figures(Some(w.loss_without_noise())),
            figures(w.rms_error()),
            figures(w.end_error),
        ]);
    }
    if history.windows.is_empty() {
        rows.push(std::array::from_fn(|_| "-".to_owned()));
    }
    columns(&rows)
}

/// Rows of cells as text: the first column to the left, the others to the right, each as wide as its widest cell.
pub fn columns<R: AsRef<[String]>>(rows: &[R]) -> String {
    let count = rows.iter().map(|row| row.as_ref().len()).max().unwrap_or(0);
    let width = |column: usize| rows.iter().filter_map(|row| row.as_ref().get(column)).map(|c| c.chars().count()).max();
    let widths: Vec<usize> = (0..count).map(|column| width(column).unwrap_or(0)).collect();
    let mut text = String::new();
    for row in rows {
        let mut line = String::new();
        for (i, (cell, &width)) in row.as_ref().iter().zip(&widths).enumerate() {
            let _ = if i == 0 { write!(line, "{cell:<width$}") } else { write!(line, "  {cell:>width$}") };
        }
        text.push_str(line.trim_end());
        text.push('\n');
    }
    text
}

/// A whole number with its thousands set apart: 11,999,920 instead of 11999920.
pub fn thousands(n: u64) -> String {
    let digits = n.to_string();
    let mut text = String::new();
    for (i, digit) in digits.chars().enumerate() {
        if i > 0 && (digits.len() - i).is_multiple_of(3) {
            text.push(',');
        }
        text.push(digit);
    }
    text
}

/// Three significant figures, which is what a mean over a window is good for; `-` for none.
pub fn figures(value: Option<f64>) -> String {
    let Some(x) = value.filter(|x| x.is_finite()) else { return "-".into() };
    if x == 0.0 {
        return "0".into();
    }
    let magnitude = x.abs().log10().floor();
    if !(-5.0..6.0).contains(&magnitude) {
        return format!("{x:.2e}");
    }
    format!("{x:.*}", (2.0 - magnitude).max(0.0) as usize)
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    #[test]
    fn thousands_are_set_apart() {
        assert_eq!([0, 80, 999, 1000, 11_999_920].map(thousands), ["0", "80", "999", "1,000", "11,999,920"]);
    }

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
        }
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
ticks           loss a tick  without noise  RMS error (m)  error at a target's end (m)
0 to 999              0.166          0.130           1.10                        0.877
2,000 to 2,499       0.0728         0.0373              -                            -
";
        assert_eq!(table(&history), expected);
        history.windows.truncate(1);
        assert_eq!(table(&history).lines().count(), 2);
        history.windows.clear();
        assert!(table(&history).lines().last().unwrap().starts_with("-  "));
    }

    #[test]
    fn three_figures_whatever_the_size() {
        let all = [12.3456, 0.0, 1234.0, 0.00123456, 1e9, -0.5, f64::NAN].map(|x| figures(Some(x)));
        assert_eq!(all, ["12.3", "0", "1234", "0.00123", "1.00e9", "-0.500", "-"]);
    }

    #[test]
    fn a_story_travels_as_json() {
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
