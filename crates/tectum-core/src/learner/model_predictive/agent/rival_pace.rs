//! How often a rival plan is worked on, which takes most of a tick's operations: in every tick while something is new
//! or much is missing, and more and more rarely while the plan is near the best and no rival is adopted.

use super::super::rivals;
use crate::state::{Persist, StateVisitor};

/// The ticks from one rival to the next double after each of so many rounds, up to 8.
const LONGEST_ROUNDS: u64 = 3;
/// A plan is near the best if no more than this part of what rewards can differ by is missing.
const NEAR: f64 = 0.05;
/// It is worse than the one of the tick before if it promises less by more than this part of the same.
const WORSE: f64 = 0.005;

/// When the next rival is due. After each round of all kinds without a success the ticks in between double.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RivalPace {
    /// Ticks until the next.
    wait: u64,
    /// Rivals in a row that were not adopted.
    refused: u64,
    /// What the plan of the tick before promised.
    promised: f64,
}

/// What a plan promises, and what there is to compare it with; all sums of rewards over the horizon.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Promise {
    /// The predicted sum of the plan.
    pub value: f64,
    /// That of the best reward that was seen, in every tick.
    pub best: f64,
    /// That of the worst.
    pub worst: f64,
}

impl Promise {
    /// What is missing to the best.
    pub fn gap(&self) -> f64 {
        (self.best - self.value).max(0.0)
    }
}

impl RivalPace {
    /// A rival in the next tick.
    pub fn new() -> Self {
        Self { wait: 0, refused: 0, promised: f64::NEG_INFINITY }
    }

    /// Something is new: a rival in this tick and the next ones.
    pub fn hurry(&mut self) {
        (self.wait, self.refused) = (0, 0);
    }

    /// Whether a rival is due in this tick, in which the plan promises this.
    pub fn is_due(&mut self, plan: Promise) -> bool {
        let span = plan.best - plan.worst;
        if plan.gap() > NEAR * span || self.promised - plan.value > WORSE * span {
            self.hurry();
        }
        self.promised = plan.value;
        self.wait = self.wait.saturating_sub(1);
        self.wait == 0
    }

    /// A rival was worked on, and adopted or not.
    pub fn tried(&mut self, adopted: bool) {
        if adopted {
            self.hurry();
        } else {
            self.refused += 1;
        }
        let rounds = self.refused / u64::from(rivals::KINDS);
        self.wait = 1 << rounds.min(LONGEST_ROUNDS);
    }
}

impl Persist for RivalPace {
    fn visit_state(&mut self, visitor: &mut dyn StateVisitor) {
        visitor.number("wait", &mut self.wait);
        visitor.number("refused", &mut self.refused);
        visitor.number("promised", &mut self.promised);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const NEAR_THE_BEST: Promise = Promise { value: -0.4, best: 0.0, worst: -100.0 };

    /// The ticks of `ticks` in which a rival was due; none is adopted.
    fn due(pace: &mut RivalPace, ticks: u64, plan: impl Fn(u64) -> Promise) -> Vec<u64> {
        let mut due = Vec::new();
        for tick in 0..ticks {
            if pace.is_due(plan(tick)) {
                due.push(tick);
                pace.tried(false);
            }
        }
        due
    }

    #[test]
    fn rivals_become_rare_while_none_is_adopted() {
        let mut pace = RivalPace::new();
        let ticks = due(&mut pace, 60, |_| NEAR_THE_BEST);
        assert_eq!(ticks, [0, 1, 2, 3, 5, 7, 9, 11, 15, 19, 23, 27, 35, 43, 51, 59]);
        pace.tried(true);
        assert_eq!(due(&mut pace, 6, |_| NEAR_THE_BEST), [0, 1, 2, 3, 5]);
    }

    #[test]
    fn a_plan_that_promises_less_than_before_is_challenged_at_once() {
        let mut pace = RivalPace::new();
        due(&mut pace, 60, |_| NEAR_THE_BEST);
        assert!(due(&mut pace, 3, |_| Promise { value: -0.8, ..NEAR_THE_BEST }).is_empty(), "no more than noise does");
        assert_eq!(due(&mut pace, 3, |_| Promise { value: -1.4, ..NEAR_THE_BEST }), [0, 1, 2]);
    }

    #[test]
    fn a_plan_that_misses_much_is_challenged_in_every_tick() {
        let mut pace = RivalPace::new();
        let hanging = Promise { value: -60.0, ..NEAR_THE_BEST };
        assert_eq!(due(&mut pace, 40, |_| hanging).len(), 40);
    }
}
