//! What single targets cost: mean loss and last error of each whole one, kept around the ticks that a summary
//! looks at.
//!
//! Means over a window say little where it holds two targets, one of them near and one far. So the results of
//! the last [`WINDOW_TARGETS`] targets before, and of as many after, each of these ticks are kept one by one,
//! for medians: the tick [`FIRST_LOOK_S`] seconds after the beginning, each change of the arm, and the end of
//! the run. A target is whole if the controller saw all of its ticks. A target during which the arm changes
//! is neither before nor after the change.
//!
//! All memory is taken at the start.

use serde::{Deserialize, Serialize};

use super::policy_snapshots::{FIRST_LOOK_S, change_ticks, ticks_in};
use crate::scenario::Plan;
use crate::state::{Persist, StateVisitor};
use crate::stats::number_or_nan;

/// Targets kept before, and after, a tick.
const WINDOW_TARGETS: usize = 10;
/// Changes of the arm that are looked at; those beyond are not.
const MOST_CHANGES: usize = 8;

/// What one target cost.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TargetResult {
    /// Its first tick.
    pub from: u64,
    /// Its number of ticks.
    pub ticks: u64,
    /// Mean loss (reward with its sign turned) a tick; not a number if a reward was none.
    #[serde(deserialize_with = "number_or_nan")]
    pub loss: f64,
    /// The error of its last tick; not a number if the plant measures none.
    #[serde(deserialize_with = "number_or_nan")]
    pub end_error: f64,
}

/// The targets around one tick.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TargetsAround {
    /// The tick; of the end of the run, the ticks done.
    pub tick: u64,
    /// The last whole targets that were over by then, in order.
    pub before: Vec<TargetResult>,
    /// The first whole targets that began then or later, in order.
    pub after: Vec<TargetResult>,
}

/// A result as numbers of one type, for the state: first tick, ticks, loss, error.
type Row = [f64; 4];

/// The last [`WINDOW_TARGETS`] results: a ring.
#[derive(Debug, Clone, Copy, Default)]
struct Results {
    rows: [Row; WINDOW_TARGETS],
    /// Results that were ever put in.
    count: u64,
}

impl Results {
    fn is_full(&self) -> bool {
        self.count as usize >= WINDOW_TARGETS
    }

    /// Puts a result in; the oldest makes room for it.
    fn push(&mut self, row: Row) {
        self.rows[self.count as usize % WINDOW_TARGETS] = row;
        self.count += 1;
    }

    /// The results, not in order.
    fn rows(&self) -> &[Row] {
        &self.rows[..(self.count as usize).min(WINDOW_TARGETS)]
    }

    /// The results in order.
    fn to_list(self) -> Vec<TargetResult> {
        let result = |&[from, ticks, loss, end_error]: &Row| TargetResult {
            from: from as u64,
            ticks: ticks as u64,
            loss,
            end_error,
        };
        let mut list: Vec<TargetResult> = self.rows().iter().map(result).collect();
        list.sort_by_key(|result| result.from);
        list
    }
}

/// A tick that the summary looks at.
#[derive(Debug, Clone, Copy)]
struct LookedAt {
    tick: u64,
    before: Results,
    after: Results,
}

/// Collects the targets' results while a run goes on.
#[derive(Debug, Clone)]
pub(super) struct TargetStatistics {
    /// In the order of ticks.
    looked_at: Vec<LookedAt>,
    /// How many of these ticks are behind.
    passed: u64,
    recent: Results,
    /// The target in progress: first tick, ticks seen, sum of their losses.
    from: u64,
    ticks: u64,
    loss: f64,
}

impl TargetStatistics {
    /// For a run of `plan`; `None` for a plant without an arm.
    pub fn new(plan: &Plan) -> Option<Self> {
        let arm = plan.scenario.plant.arm.as_ref().filter(|arm| !arm.open_loop)?;
        let mut ticks = vec![ticks_in(plan, FIRST_LOOK_S)];
        // Those beyond the run's end, too: a run that is resumed may have more ticks than the part before.
        ticks.extend(change_ticks(arm, u64::MAX).into_iter().take(MOST_CHANGES));
        ticks.sort_unstable();
        ticks.dedup();
        let none = Results::default();
        let looked_at = ticks.into_iter().map(|tick| LookedAt { tick, before: none, after: none }).collect();
        // No target has begun: the first tick seen must be a target's first.
        Some(Self { looked_at, passed: 0, recent: none, from: u64::MAX, ticks: 0, loss: 0.0 })
    }

    /// Takes in the loss of one tick.
    #[inline]
    pub fn observe(&mut self, loss: f64) {
        self.ticks += 1;
        self.loss += loss;
    }

    /// A new target begins with `tick`; `error` is the error of the tick before. Gives the end error of the
    /// target that is over, if that was whole.
    pub fn begin(&mut self, tick: u64, error: f64) -> Option<f64> {
        let whole = self.ticks > 0 && tick.checked_sub(self.from) == Some(self.ticks);
        if whole {
            let row = [self.from as f64, self.ticks as f64, self.loss / self.ticks as f64, error];
            self.pass(tick);
            for look in self.looked_at.iter_mut().take(self.passed as usize) {
                if self.from >= look.tick && !look.after.is_full() {
                    look.after.push(row);
                }
            }
            self.recent.push(row);
        }
        (self.from, self.ticks, self.loss) = (tick, 0, 0.0);
        whole.then_some(error)
    }

    /// Keeps the last targets for the ticks that lie before `tick`: those targets were over by then.
    fn pass(&mut self, tick: u64) {
        while let Some(look) = self.looked_at.get_mut(self.passed as usize).filter(|look| look.tick < tick) {
            look.before = self.recent;
            self.passed += 1;
        }
    }

    /// The median end error of the last targets; not a number where there is none.
    pub fn median_end_error(&self) -> f64 {
        let mut sorted = [0.0; WINDOW_TARGETS];
        let rows = self.recent.rows();
        // By insertion: shorter than the general way for so few.
        for (count, row) in rows.iter().enumerate() {
            let mut at = count;
            while at > 0 && sorted[at - 1] > row[3] {
                sorted[at] = sorted[at - 1];
                at -= 1;
            }
            sorted[at] = row[3];
        }
        if rows.is_empty() { f64::NAN } else { sorted[(rows.len() - 1) / 2] }
    }

    /// Whether the target that began with `from` is one of the last.
    pub fn is_recent(&self, from: u64) -> bool {
        self.recent.rows().iter().any(|row| row[0] as u64 == from)
    }

    /// What was kept, in the order of ticks; the end of the run, after `done` ticks, comes last.
    pub fn finish(mut self, done: u64) -> Vec<TargetsAround> {
        self.pass(done);
        let around = |look: LookedAt| TargetsAround {
            tick: look.tick,
            before: look.before.to_list(),
            after: look.after.to_list(),
        };
        let end = TargetsAround { tick: done, before: self.recent.to_list(), after: Vec::new() };
        let reached = self.looked_at.into_iter().filter(|look| look.tick < done);
        reached.map(around).chain([end]).collect()
    }
}

impl Persist for TargetStatistics {
    fn visit_state(&mut self, visitor: &mut dyn StateVisitor) {
        let looked_at = self.looked_at.iter_mut().flat_map(|look| [&mut look.before, &mut look.after]);
        for results in looked_at.chain([&mut self.recent]) {
            visitor.numbers("results", &mut results.rows);
            visitor.number("result_counts", &mut results.count);
        }
        let mut counts = [self.from, self.ticks, self.passed];
        visitor.numbers("target_counts", &mut counts);
        [self.from, self.ticks, self.passed] = counts;
        visitor.number("target_loss", &mut self.loss);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scenario::Scenario;

    fn plan(ticks: u64) -> Plan {
        let mut scenario = Scenario::find("arm").unwrap();
        scenario.ticks = ticks;
        scenario.plan().unwrap()
    }

    /// Targets of 80 ticks, the loss of each its number; `missing` ticks are not seen.
    fn run(plan: &Plan, missing: &[u64]) -> Vec<TargetsAround> {
        let mut statistics = TargetStatistics::new(plan).unwrap();
        for tick in 0..=plan.scenario.ticks {
            if tick > 0 && !missing.contains(&(tick - 1)) {
                statistics.observe(((tick - 1) / 80) as f64);
            }
            if tick.is_multiple_of(80) {
                statistics.begin(tick, tick as f64);
            }
        }
        statistics.finish(plan.scenario.ticks)
    }

    fn numbers(results: &[TargetResult]) -> Vec<u64> {
        results.iter().map(|result| result.from / 80).collect()
    }

    #[test]
    fn ten_targets_are_kept_on_each_side_of_a_tick() {
        let around = run(&plan(3600), &[]);
        assert_eq!(around.iter().map(|a| a.tick).collect::<Vec<_>>(), [200, 2400, 3600]);
        assert_eq!(numbers(&around[0].before), [0, 1]);
        assert_eq!(numbers(&around[0].after), (3..13).collect::<Vec<_>>(), "target 2 goes over tick 200");
        assert_eq!(numbers(&around[1].before), (20..30).collect::<Vec<_>>());
        assert_eq!(numbers(&around[1].after), (30..40).collect::<Vec<_>>());
        assert_eq!(numbers(&around[2].before), (35..45).collect::<Vec<_>>());
        let result = around[1].after[0];
        assert_eq!((result.ticks, result.loss, result.end_error), (80, 30.0, 2480.0));
    }

    #[test]
    fn short_runs_keep_what_there_is() {
        let around = run(&plan(170), &[]);
        assert_eq!(around.len(), 1);
        assert_eq!(numbers(&around[0].before), [0, 1]);
        assert!(run(&plan(70), &[])[0].before.is_empty());
    }

    #[test]
    fn a_target_with_a_gap_is_left_out() {
        assert_eq!(numbers(&run(&plan(800), &[165, 400])[1].before), [0, 1, 3, 4, 6, 7, 8, 9]);
    }

    #[test]
    fn results_travel_as_json() {
        let mut around = run(&plan(3600), &[]);
        around[0].after[0].loss = f64::NAN;
        let back: Vec<TargetsAround> = serde_json::from_str(&serde_json::to_string(&around).unwrap()).unwrap();
        assert!(back[0].after[0].loss.is_nan() && back[1..] == around[1..]);
    }
}
