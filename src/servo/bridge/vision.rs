//! What trackers say of target and end-effector: the newest picture counts, if it is new enough when the tick begins.
//!
//! Pure bookkeeping: samples and instants are handed in.

use hdrhistogram::Histogram;
use serde::{Deserialize, Serialize};

use crate::scenario::ServosConfig;
use crate::stats::{Percentiles, histogram};
use crate::wire::Vision;

/// What the bridge reports of the trackers.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub struct VisionReport {
    /// Samples that came.
    pub samples: u64,
    /// Those of them that were dropped: values that are not finite, or an instant in the future.
    pub dropped: u64,
    /// Ticks at whose beginning nothing new enough was there.
    pub unseen: u64,
    /// Times that it began to be so, that of the start among them.
    pub spells: u64,
    /// Age of what was used, us.
    pub age: Option<Percentiles>,
}

/// The newest sample, and what was made of it.
#[derive(Debug, Clone)]
pub(super) struct VisionInput {
    /// ns.
    age: u64,
    period: u64,
    /// Square of the distance from which a target is a new one, m^2.
    jump: f32,
    newest: Option<Vision>,
    /// Where the target was when it was taken up, m.
    taken: Option<[f32; 2]>,
    /// Whether anything new enough was there at the last look.
    pub sees: bool,
    /// How old the newest sample was at the last look, ns.
    pub aged: Option<u64>,
    ages: Histogram<u64>,
    /// The report so far.
    pub report: VisionReport,
}

impl VisionInput {
    /// Of a validated table, for ticks of `period` ns.
    pub fn new(table: &ServosConfig, period: u64) -> Self {
        Self {
            age: table.vision_age_ns(),
            period,
            jump: table.vision_jump() * table.vision_jump(),
            newest: None,
            taken: None,
            sees: false,
            aged: None,
            ages: histogram(),
            report: VisionReport { spells: 1, ..VisionReport::default() },
        }
    }

    /// Takes a sample that came by `now`. Of several trackers' samples the newest picture stays.
    pub fn take(&mut self, sample: &Vision, now: u64) {
        self.report.samples += 1;
        let finite = sample.target.iter().chain(&sample.end).all(|x| x.is_finite());
        if !finite || sample.header.sensed_ns > now + self.period {
            self.report.dropped += 1;
        } else if self.newest.is_none_or(|newest| newest.header.sensed_ns <= sample.header.sensed_ns) {
            self.newest = Some(*sample);
        }
    }

    /// A tick begins at `now`: whether anything is seen, and whether that has changed.
    pub fn look(&mut self, now: u64) -> bool {
        let before = self.sees;
        let age = self.newest.map(|newest| now.saturating_sub(newest.header.sensed_ns));
        self.aged = age;
        self.sees = age.is_some_and(|age| age <= self.age);
        match age {
            Some(age) if self.sees => self.ages.saturating_record(age),
            _ => self.report.unseen += 1,
        }
        self.report.spells += u64::from(before && !self.sees);
        self.sees != before
    }

    /// Where the end-effector was seen last, m.
    pub fn end(&self) -> [f32; 2] {
        self.newest.map_or([0.0; 2], |newest| newest.end)
    }

    /// Where the target is, m, and whether it is a new one; asked when something is seen, after which it counts as taken up.
    pub fn target(&mut self) -> Option<([f32; 2], bool)> {
        let target = self.newest.filter(|_| self.sees)?.target;
        let far = |[x, y]: [f32; 2]| (target[0] - x) * (target[0] - x) + (target[1] - y) * (target[1] - y) > self.jump;
        let fresh = self.taken.is_none_or(far);
        if fresh {
            self.taken = Some(target);
        }
        Some((target, fresh))
    }

    /// The report, with the percentiles of the ages.
    pub fn report(&self) -> VisionReport {
        VisionReport { age: Percentiles::of(&self.ages), ..self.report.clone() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: u64 = 1_000_000;

    fn sight() -> VisionInput {
        let table = "port = \"x\"\nprotocol = \"feetech\"\nsight = \"vision\"";
        VisionInput::new(&toml::from_str(table).unwrap(), 50 * MS)
    }

    fn seen(sensed: u64, x: f32) -> Vision {
        let mut sample = Vision { target: [x, 0.5], end: [0.1, -x], ..Vision::default() };
        sample.header.sensed_ns = sensed;
        sample
    }

    #[test]
    fn what_is_too_old_is_not_seen() {
        let mut sight = sight();
        assert!(!sight.look(1000 * MS) && !sight.sees && sight.target().is_none());
        sight.take(&seen(1000 * MS, 0.2), 1010 * MS);
        assert!(sight.look(1100 * MS) && sight.sees, "100 ms are new enough");
        assert!(sight.look(1100 * MS + 1) && !sight.sees && sight.target().is_none());
        // An older picture that comes later does not count, and a newer one does.
        sight.take(&seen(900 * MS, 0.9), 1100 * MS);
        assert_eq!(sight.end(), [0.1, -0.2]);
        sight.take(&seen(1090 * MS, 0.3), 1110 * MS);
        assert!(sight.look(1110 * MS) && sight.sees);
        assert_eq!(sight.end(), [0.1, -0.3]);
        let report = sight.report();
        assert_eq!((report.samples, report.dropped, report.unseen, report.spells), (3, 0, 2, 2));
        assert_eq!(report.age.unwrap().count, 2);
    }

    #[test]
    fn a_target_that_jumps_is_a_new_one_and_one_that_creeps_is_not_until_it_is_far() {
        let mut sight = sight();
        let mut at = |x: f32| {
            sight.take(&seen(MS, x), MS);
            sight.look(MS);
            sight.target().unwrap()
        };
        assert_eq!(at(0.2), ([0.2, 0.5], true));
        assert_eq!(at(0.24), ([0.24, 0.5], false));
        assert_eq!(at(0.26), ([0.26, 0.5], true), "counted from where it was taken up");
        assert_eq!(at(0.22), ([0.22, 0.5], false));
    }

    #[test]
    fn what_cannot_be_is_dropped_and_counted() {
        let mut sight = sight();
        let now = 1000 * MS;
        for value in [f32::NAN, f32::INFINITY] {
            sight.take(&seen(now, value), now);
        }
        sight.take(&seen(now + 50 * MS + 1, 0.0), now);
        assert!(!sight.look(now) && !sight.sees);
        assert_eq!((sight.report.samples, sight.report.dropped), (3, 3));
        sight.take(&seen(now + 50 * MS, 0.0), now);
        assert!(sight.look(now) && sight.sees, "clocks may be a little apart");
    }
}
