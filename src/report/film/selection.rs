//! Which three reaches of a run the film shows.
//!
//! The reaches come one by one and only those that can still be chosen are kept, so that a log of any length fits.

use std::collections::VecDeque;

use crate::report::Reach;

/// The third reach is the typical one of so many at the end of the run.
pub const LATE_REACHES: usize = 10;

/// The second reach is the first whose target appears at this time of the run or later, s.
const EARLY_S: f64 = 10.0;

/// A reach with the distance that was left at its end.
#[derive(Debug, Clone, PartialEq)]
pub struct RecordedReach {
    /// Target and postures: one at the beginning of each tick, and one at the end of the last tick.
    pub reach: Reach,
    /// Distance between end-effector and target when the next target appeared, as measured, m.
    pub end_error_m: f64,
}

impl RecordedReach {
    /// Length of the reach, ticks.
    pub fn ticks(&self) -> u64 {
        self.reach.postures.len().saturating_sub(1) as u64
    }
}

/// The reaches of the three panels.
#[derive(Debug, Clone, PartialEq)]
pub struct SelectedReaches {
    /// The first of the run.
    pub first: RecordedReach,
    /// The first whose target appeared after ten seconds or later.
    pub early: RecordedReach,
    /// The one with the median end error of the late ones.
    pub late: RecordedReach,
    /// How many late ones there are.
    pub late_count: usize,
    /// The tick of the last change of the body before the late ones, if there was one.
    pub changed: Option<u64>,
}

/// Chooses three reaches while all reaches of a run pass by in their order.
#[derive(Debug, Clone)]
pub struct ReachSelector {
    early_tick: u64,
    /// The ticks at which the body changes, in their order.
    changes: Vec<u64>,
    first: Option<RecordedReach>,
    early: Option<RecordedReach>,
    late: VecDeque<RecordedReach>,
    count: u64,
}

impl ReachSelector {
    /// For a run with ticks of `period_s` seconds whose body changes at the ticks in `changes`.
    pub fn new(period_s: f64, mut changes: Vec<u64>) -> Self {
        changes.sort_unstable();
        Self {
            early_tick: (EARLY_S / period_s).round() as u64,
            changes,
            first: None,
            early: None,
            late: VecDeque::new(),
            count: 0,
        }
    }

    /// Takes the next reach.
    pub fn add(&mut self, reach: RecordedReach) {
        self.count += 1;
        if self.first.is_none() {
            self.first = Some(reach);
        } else if self.early.is_none() {
            if reach.reach.from >= self.early_tick {
                self.early = Some(reach);
            }
        } else {
            self.add_late(reach);
        }
    }

    fn add_late(&mut self, reach: RecordedReach) {
        let from = reach.reach.from;
        let changed = |last: &RecordedReach| self.last_change(last.reach.from) != self.last_change(from);
        if self.late.back().is_some_and(changed) {
            self.late.clear();
        }
        if self.late.len() == LATE_REACHES {
            self.late.pop_front();
        }
        self.late.push_back(reach);
    }

    fn last_change(&self, tick: u64) -> Option<u64> {
        self.changes.iter().copied().rfind(|&change| change <= tick)
    }

    /// How many reaches have passed by.
    pub fn count(&self) -> u64 {
        self.count
    }

    /// The three reaches; `None` if the run was too short.
    pub fn select(self) -> Option<SelectedReaches> {
        let changed = self.last_change(self.late.front()?.reach.from);
        let late_count = self.late.len();
        let mut late: Vec<_> = self.late.into();
        // The sort is stable: of equal end errors the earlier one comes first.
        late.sort_by(|a, b| a.end_error_m.total_cmp(&b.end_error_m));
        let late = late.swap_remove((late_count - 1) / 2);
        Some(SelectedReaches { first: self.first?, early: self.early?, late, late_count, changed })
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::reach;
    use super::*;

    /// Reaches of 80 ticks with these end errors, cm.
    fn select(changes: &[u64], errors: impl IntoIterator<Item = u64>) -> Option<SelectedReaches> {
        let mut selector = ReachSelector::new(0.05, changes.to_vec());
        for (i, error) in errors.into_iter().enumerate() {
            selector.add(reach(80 * i as u64, 80, error as f64 / 100.0));
        }
        selector.select()
    }

    fn from(selected: &SelectedReaches) -> [u64; 3] {
        [&selected.first, &selected.early, &selected.late].map(|reach| reach.reach.from)
    }

    #[test]
    fn the_first_one_after_ten_seconds_and_a_typical_late_one_are_chosen() {
        // The last ten are numbers 20 to 29, with errors 9 down to 0: the lower median is 4, number 25.
        let selected = select(&[], (0..30).map(|i| 29 - i)).unwrap();
        assert_eq!(from(&selected), [0, 240, 25 * 80]);
        assert_eq!((selected.late_count, selected.changed), (10, None));
    }

    #[test]
    fn late_ones_begin_after_the_last_change_of_the_body() {
        // A reach that begins with the change counts, the one before does not.
        let selected = select(&[1600, 800], [50; 20].into_iter().chain([7, 3, 9])).unwrap();
        assert_eq!(from(&selected), [0, 240, 1600]);
        assert_eq!((selected.late_count, selected.changed), (3, Some(1600)));
        // The last reach began before the change.
        let selected = select(&[1601], [50; 20].into_iter().chain([7])).unwrap();
        assert_eq!((selected.late_count, selected.changed), (10, None));
    }

    #[test]
    fn more_than_ten_after_a_change_are_the_last_ten() {
        let selected = select(&[800], (0..40).map(|i| i % 20)).unwrap();
        assert_eq!((selected.late_count, selected.changed), (10, Some(800)));
        assert_eq!(from(&selected)[2], 34 * 80);
    }

    #[test]
    fn three_different_reaches_are_needed() {
        assert_eq!(select(&[], []), None);
        assert_eq!(select(&[], [1, 2, 3, 4]), None);
        let selected = select(&[], [1, 2, 3, 4, 5]).unwrap();
        assert_eq!((from(&selected), selected.late_count), ([0, 240, 320], 1));
    }
}
