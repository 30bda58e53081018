//! How the controller of a real-time run spends its ticks: the answer that the plant waits for, the learner after it, and
//! what is left until the next tick.
//!
//! It is for people alone and touches nothing that is learned. All memory is taken at the start. In lockstep there is no
//! time to spend, and no budget.

use hdrhistogram::Histogram;
use serde::{Deserialize, Serialize};

use super::reports::{Percentiles, histogram};

/// What is left of a tick, us.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct SlackPercentiles {
    /// Median.
    pub p50: f64,
    /// First percentile: 99 ticks in a hundred leave more.
    pub p1: f64,
    /// Least; 0 where a tick was overrun.
    pub min: f64,
}

/// The tick budget of a real-time run.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct TickBudget {
    /// The tick's period, us.
    pub period_us: f64,
    /// The plant: from its waking up to its observation's being sent. Its own account; null where it left none.
    pub plant_us: Option<Percentiles>,
    /// From the observation's arrival at the controller to the sending of the command: encode, learn, draw, send.
    pub answer_us: Option<Percentiles>,
    /// What the learner took to improve the policy, after the command had gone out.
    pub learner_us: Option<Percentiles>,
    /// The learner's mean share of the period.
    pub learner_share: f64,
    /// Ticks in which the learner was still at work when the next tick was due. The command of the next tick is then
    /// late by the rest, and missed if that takes longer than a period.
    pub learner_overruns: u64,
    /// From the end of the controller's work, learning record and account included, to the next tick.
    pub slack_us: Option<SlackPercentiles>,
}

/// The instants of one tick of the controller, ns.
#[derive(Debug, Clone, Copy)]
pub(super) struct TickInstants {
    /// For which the tick was scheduled.
    pub scheduled: u64,
    /// The observation was there.
    pub seen: u64,
    /// The command was out.
    pub answered: u64,
    /// The learner had done.
    pub improved: u64,
    /// Nothing was left to do.
    pub done: u64,
}

/// Collects the budget tick by tick.
#[derive(Debug)]
pub(super) struct BudgetMeter {
    period: u64,
    answer: Histogram<u64>,
    learner: Histogram<u64>,
    slack: Histogram<u64>,
    /// All that the learner has taken, ns.
    pub learner_ns: u64,
    overruns: u64,
}

impl BudgetMeter {
    /// A meter for ticks of `period` ns.
    pub fn new(period: u64) -> Self {
        Self { period, answer: histogram(), learner: histogram(), slack: histogram(), learner_ns: 0, overruns: 0 }
    }

    /// Takes a tick into the account.
    pub fn record(&mut self, at: TickInstants) {
        let next = at.scheduled + self.period;
        let learner = at.improved.saturating_sub(at.answered);
        self.answer.saturating_record(at.answered.saturating_sub(at.seen));
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
    /// Two lines for people, without a line's end; `label` columns are left free in front of the second.
    pub fn to_text(&self, label: usize) -> String {
        let ms = |us: f64| {
            let ms = us / 1000.0;
            // As exact as it is short: 0.08, 4.0, 48.5.
            if ms < 0.995 { format!("{ms:.2} ms") } else { format!("{ms:.1} ms") }
        };
        let both = |name: &str, p: &Option<Percentiles>| {
            p.as_ref().map_or(String::new(), |p| format!("{name} p50 {}  p99 {}", ms(p.p50), ms(p.p99)))
        };
        let period = self.period_us / 1000.0;
        let mut text = format!("{period} ms: ");
        if self.plant_us.is_some() {
            text += &format!("{}, ", both("plant", &self.plant_us));
        }
        text += &format!("{},\n{:label$}", both("answer", &self.answer_us), "");
        text += &format!("{} ({:.1} % of the tick)", both("learner", &self.learner_us), 100.0 * self.learner_share);
        if let Some(slack) = &self.slack_us {
            text += &format!(", slack p50 {}  p1 {}", ms(slack.p50), ms(slack.p1));
        }
        match self.learner_overruns {
            0 => {}
            1 => text += ", learner overran 1 tick",
            n => text += &format!(", learner overran {} ticks", crate::report::thousands(n)),
        }
        text
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: u64 = 1_000_000;

    fn at(scheduled: u64, seen: u64, answered: u64, improved: u64, done: u64) -> TickInstants {
        TickInstants { scheduled, seen, answered, improved, done }
    }

    #[test]
    fn a_budget_adds_up() {
        let mut meter = BudgetMeter::new(50 * MS);
        assert_eq!(meter.finish(), None);
        for tick in 0..100 {
            let t = tick * 50 * MS;
            meter.record(at(t, t + MS, t + 2 * MS, t + 7 * MS, t + 8 * MS));
        }
        let budget = meter.finish().unwrap();
        assert_eq!((budget.period_us, budget.learner_overruns), (50_000.0, 0));
        assert!((budget.learner_share - 0.1).abs() < 1e-12);
        // A histogram keeps three digits.
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
    fn a_learner_that_is_still_at_work_when_the_next_tick_is_due_is_counted() {
        let mut meter = BudgetMeter::new(50 * MS);
        meter.record(at(0, MS, 2 * MS, 50 * MS, 51 * MS));
        assert_eq!(meter.finish().unwrap().learner_overruns, 0);
        meter.record(at(0, MS, 2 * MS, 50 * MS + 1, 51 * MS));
        let budget = meter.finish().unwrap();
        assert_eq!((budget.learner_overruns, budget.slack_us.unwrap().min), (1, 0.0));
        assert!(budget.to_text(0).ends_with("learner overran 1 tick"), "{}", budget.to_text(0));
    }
}
