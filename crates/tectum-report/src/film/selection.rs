//! Which three reaches of a run the film shows.
//!
//! The reaches come one by one and only those that can still be chosen are kept, so that a log of any length fits.

use std::collections::VecDeque;

use crate::Reach;

/// The second reach is the typical one of so many from ten seconds on.
pub const EARLY_REACHES: usize = 3;
/// The third reach is the typical one of so many at the end of the run.
pub const LATE_REACHES: usize = 10;

/// The early reaches are the first whose targets appear at this time of the run or later, s.
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
    /// The one with the median end error of the first ones from ten seconds on.
    pub early: RecordedReach,
    /// How many early ones there are: fewer than [`EARLY_REACHES`] if the body changed soon.
    pub early_count: usize,
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
    early: Vec<RecordedReach>,
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
            early: Vec::new(),
            late: VecDeque::new(),
            count: 0,
        }
    }

    /// Takes the next reach.
    pub fn add(&mut self, reach: RecordedReach) {
        self.count += 1;
        if self.first.is_none() {
            self.first = Some(reach);
        } else if reach.reach.from >= self.early_tick {
            self.add_early_or_late(reach);
        }
    }

    fn add_early_or_late(&mut self, reach: RecordedReach) {
        let from = reach.reach.from;
        let changed = |last: &RecordedReach| self.last_change(last.reach.from) != self.last_change(from);
        let early_over = self.early.len() == EARLY_REACHES || self.early.last().is_some_and(changed);
        if !early_over && self.late.is_empty() {
            self.early.push(reach);
            return;
        }
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
        let (early_count, late_count) = (self.early.len(), self.late.len());
        Some(SelectedReaches {
            first: self.first?,
            early: typical(self.early)?,
            early_count,
            late: typical(self.late.into())?,
            late_count,
            changed,
        })
    }
}

/// The reach with the median end error, the lower one of two; `None` of none.
fn typical(mut reaches: Vec<RecordedReach>) -> Option<RecordedReach> {
    // The sort is stable: of equal end errors the earlier reach comes first.
    reaches.sort_by(|a, b| a.end_error_m.total_cmp(&b.end_error_m));
    let middle = reaches.len().checked_sub(1)? / 2;
    Some(reaches.swap_remove(middle))
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
    fn the_first_and_typical_early_and_late_ones_are_chosen() {
        // The early ones are numbers 3 to 5. The last ten are numbers 20 to 29, with errors 9 down to 0: the lower
        // median is 4, number 25.
        let selected = select(&[], (0..30).map(|i| 29 - i)).unwrap();
        assert_eq!(from(&selected), [0, 320, 25 * 80]);
        assert_eq!((selected.early_count, selected.late_count, selected.changed), (3, 10, None));
        let selected = select(&[], [0, 0, 0, 8, 29, 6, 1]).unwrap();
        assert_eq!(from(&selected), [0, 240, 480]);
    }

    #[test]
    fn late_ones_begin_after_the_last_change_of_the_body() {
        // A reach that begins with the change counts, the one before does not.
        let selected = select(&[1600, 800], [50; 20].into_iter().chain([7, 3, 9])).unwrap();
        // Errors 7, 3 and 9: the median is the first.
        assert_eq!(from(&selected), [0, 320, 1600]);
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
        assert_eq!(select(&[], [1, 2, 3, 4, 5, 6]), None);
        let selected = select(&[], [1, 2, 3, 4, 4, 4, 7]).unwrap();
        assert_eq!((from(&selected), selected.late_count), ([0, 320, 480], 1));
    }

    #[test]
    fn early_ones_end_where_the_body_changes() {
        let selected = select(&[320], [1, 2, 3, 4, 5, 6]).unwrap();
        assert_eq!(from(&selected), [0, 240, 320]);
        assert_eq!((selected.early_count, selected.late_count, selected.changed), (1, 2, Some(320)));
        // The change comes before ten seconds: it counts, since late ones begin after it.
        let selected = select(&[80], [1, 2, 3, 4, 5, 6, 7, 8]).unwrap();
        assert_eq!((selected.early_count, selected.late_count, selected.changed), (3, 2, Some(80)));
    }
}
