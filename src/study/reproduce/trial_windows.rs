//! Sums over windows of trials, for the experiments in which every tick is a trial of its own.

use serde::{Deserialize, Serialize};

use crate::report::figure::Polyline;
use crate::study::exact;
use crate::wire::Observation;

/// Sums over some trials in a row.
#[derive(Debug, Clone, Copy, Default, Serialize, Deserialize)]
pub(super) struct TrialWindow {
    /// Number of trials.
    pub trials: u64,
    /// Sum of the errors, in the plant's unit.
    #[serde(with = "exact")]
    pub error: f64,
    /// Sum of the losses (reward with its sign turned).
    #[serde(with = "exact")]
    pub loss: f64,
}

/// The windows of one run, all of the same length except the last.
#[derive(Debug, Default, Serialize, Deserialize)]
pub(super) struct TrialWindows {
    /// Trials of a window.
    length: u64,
    pub windows: Vec<TrialWindow>,
}

impl TrialWindows {
    /// At most `count` windows for a run of `trials` trials.
    pub fn new(trials: u64, count: u64) -> Self {
        Self { length: trials.div_ceil(count), windows: vec![TrialWindow::default()] }
    }

    /// Adds the trial whose outcome `observation` reports.
    pub fn observe(&mut self, observation: &Observation) {
        let tick = observation.header.tick;
        if tick == 0 {
            return;
        }
        if tick > 1 && (tick - 1).is_multiple_of(self.length) {
            self.windows.push(TrialWindow::default());
        }
        let last = self.windows.len() - 1;
        let window = &mut self.windows[last];
        window.trials += 1;
        window.error += f64::from(observation.measures[0]);
        window.loss -= f64::from(observation.reward);
    }

    /// Each window after the number of trials up to its end.
    pub fn with_ends(&self) -> impl Iterator<Item = (u64, &TrialWindow)> {
        self.windows.iter().scan(0, |upto, window| {
            *upto += window.trials;
            Some((*upto, window))
        })
    }

    /// The mean error over millions of trials, each point in the middle of its window.
    pub fn error_curve(&self) -> Polyline {
        self.with_ends()
            .map(|(upto, w)| ((upto as f64 - w.trials as f64 / 2.0) / 1e6, w.error / w.trials as f64))
            .collect()
    }
}

/// The mean of `value` per trial over `windows`.
pub(super) fn mean(windows: &[TrialWindow], value: impl Fn(&TrialWindow) -> f64) -> f64 {
    let trials: u64 = windows.iter().map(|w| w.trials).sum();
    windows.iter().map(value).sum::<f64>() / trials as f64
}
