//! How the controller of a real-time run spends the time of its ticks: the command that the plant waits for,
//! the learner after it, and the slack until the next tick.
//!
//! The budget is for reports only and does not influence learning. All memory is allocated at the start. A
//! lockstep run has no budget.

use crate::stats::{Percentiles, histogram};
use hdrhistogram::Histogram;
use serde::{Deserialize, Serialize};

/// Percentiles of the slack: the time from the end of the controller's work to the next tick, us.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct SlackPercentiles {
    /// Median.
    pub p50: f64,
    /// First percentile: 99 of 100 ticks have more slack.
    pub p1: f64,
    /// Minimum; 0 where a tick was overrun.
    pub min: f64,
}

/// The tick budget of a real-time run.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct TickBudget {
    /// The tick's period, us.
    pub period_us: f64,
    /// The plant, from waking up to having sent its observation, as in its report; null where it left no
    /// report.
    pub plant_us: Option<Percentiles>,
    /// From the arrival of the observation at the controller to the sending of the command: encode, learn,
    /// draw, send.
    pub answer_us: Option<Percentiles>,
    /// The time that the learner took to improve the policy, after the command had been sent.
    pub learner_us: Option<Percentiles>,
    /// The learner's mean share of the period.
    pub learner_share: f64,
    /// Ticks in which the learner still worked when the next tick was due. The command of the next tick is then
    /// late by the remaining time, and missed if the learner takes more than another period.
    pub learner_overruns: u64,
    /// From the end of the controller's work, including learning record and statistics, to the next tick.
    pub slack_us: Option<SlackPercentiles>,
}

/// The instants of one tick of the controller, ns.
#[derive(Debug, Clone, Copy)]
pub(super) struct TickInstants {
    /// The instant for which the tick was scheduled.
    pub scheduled: u64,
    /// The observation had arrived.
    pub arrived: u64,
    /// The command was sent.
    pub answered: u64,
    /// The learner had finished.
    pub improved: u64,
    /// All work of the tick was done.
    pub done: u64,
}

/// Collects the budget tick by tick.
#[derive(Debug)]
pub(super) struct BudgetMeter {
    period: u64,
    answer: Histogram<u64>,
    learner: Histogram<u64>,
    slack: Histogram<u64>,
    /// Total time of the learner, ns.
    pub learner_ns: u64,
    overruns: u64,
}

impl BudgetMeter {
    /// A meter for ticks of `period` ns.
    pub fn new(period: u64) -> Self {
        Self { period, answer: histogram(), learner: histogram(), slack: histogram(), learner_ns: 0, overruns: 0 }
    }

    /// Adds a tick.
    pub fn record(&mut self, at: TickInstants) {
        let next = at.scheduled + self.period;
        let learner = at.improved.saturating_sub(at.answered);
        self.answer.saturating_record(at.answered.saturating_sub(at.arrived));
        self.learner.saturating_record(learner);
        self.learner_ns += learner;
        self.overruns += u64::from(at.improved > next);
        self.slack.saturating_record(next.saturating_sub(at.done));
    }

    /// The budget; `None` before the first tick.
    pub fn finish(&self) -> Option<TickBudget> {
        let us = |ns: u64| ns as f64 / 1000.0;
        let ticks = self.learner.len();
        (ticks > 0).then(|| TickBudget {
            period_us: us(self.period),
            plant_us: None,
            answer_us: Percentiles::of(&self.answer),
            learner_us: Percentiles::of(&self.learner),
            learner_share: self.learner_ns as f64 / (ticks as f64 * self.period as f64),
            learner_overruns: self.overruns,
            slack_us: Some(SlackPercentiles {
                p50: us(self.slack.value_at_quantile(0.5)),
                p1: us(self.slack.value_at_quantile(0.01)),
                min: us(self.slack.min()),
            }),
        })
    }
}

impl TickBudget {
    /// Two lines for the summary, without a newline at the end. The second line is indented by `label` columns.
    pub fn to_text(&self, label: usize) -> String {
        let ms = |us: f64| {
            let ms = us / 1000.0;
            // Two or three significant digits: 0.08, 4.0, 48.5.
            if ms < 0.995 { format!("{ms:.2} ms") } else { format!("{ms:.1} ms") }
        };
        let p50_and_p99 = |name: &str, p: &Option<Percentiles>| {
            p.as_ref().map_or(String::new(), |p| format!("{name} p50 {}  p99 {}", ms(p.p50), ms(p.p99)))
        };
        let period = self.period_us / 1000.0;
        let mut text = format!("{period} ms: ");
        if self.plant_us.is_some() {
            text += &format!("{}, ", p50_and_p99("plant", &self.plant_us));
        }
        text += &format!("{},\n{:label$}", p50_and_p99("answer", &self.answer_us), "");
        text +=
            &format!("{} ({:.1} % of the tick)", p50_and_p99("learner", &self.learner_us), 100.0 * self.learner_share);
        if let Some(slack) = &self.slack_us {
            text += &format!(", slack p50 {}  p1 {}", ms(slack.p50), ms(slack.p1));
        }
        match self.learner_overruns {
            0 => {}
            1 => text += ", learner overran 1 tick",
            n => text += &format!(", learner overran {} ticks", crate::text::thousands(n)),
        }
        text
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: u64 = 1_000_000;

    fn at(scheduled: u64, arrived: u64, answered: u64, improved: u64, done: u64) -> TickInstants {
        TickInstants { scheduled, arrived, answered, improved, done }
    }

    #[test]
    fn a_budget_sums_up_its_ticks() {
        let mut meter = BudgetMeter::new(50 * MS);
        assert_eq!(meter.finish(), None);
        for tick in 0..100 {
            let t = tick * 50 * MS;
            meter.record(at(t, t + MS, t + 2 * MS, t + 7 * MS, t + 8 * MS));
        }
        let budget = meter.finish().unwrap();
        assert_eq!((budget.period_us, budget.learner_overruns), (50_000.0, 0));
        assert!((budget.learner_share - 0.1).abs() < 1e-12);
        // A histogram keeps three significant digits.
        for (found, expected) in [
            (budget.answer_us.unwrap().p50, 1000.0),
            (budget.learner_us.unwrap().p99, 5000.0),
            (budget.slack_us.unwrap().min, 42_000.0),
        ] {
            assert!((found / expected - 1.0).abs() < 2e-3, "{found} for {expected}");
        }
        let text = budget.to_text(8);
        assert_eq!(
            text,
            "50 ms: answer p50 1.0 ms  p99 1.0 ms,\n        learner p50 5.0 ms  p99 5.0 ms (10.0 % of the tick), \
             slack p50 42.0 ms  p1 42.0 ms"
        );
    }

    #[test]
    fn a_learner_that_overruns_the_next_tick_is_counted() {
        let mut meter = BudgetMeter::new(50 * MS);
        meter.record(at(0, MS, 2 * MS, 50 * MS, 51 * MS));
        assert_eq!(meter.finish().unwrap().learner_overruns, 0);
        meter.record(at(0, MS, 2 * MS, 50 * MS + 1, 51 * MS));
        let budget = meter.finish().unwrap();
        assert_eq!((budget.learner_overruns, budget.slack_us.unwrap().min), (1, 0.0));
        assert!(budget.to_text(0).ends_with("learner overran 1 tick"), "{}", budget.to_text(0));
    }
}
