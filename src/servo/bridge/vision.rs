//! Target and end-effector from trackers: the sample with the newest image is used if it is recent enough at
//! the beginning of a tick.
//!
//! Independent of transport and clock: samples and times are arguments.

use hdrhistogram::Histogram;
use serde::{Deserialize, Serialize};

use crate::scenario::ServosConfig;
use crate::stats::{Percentiles, histogram};
use crate::wire::Vision;

/// The part of the bridge's report about trackers.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub struct VisionReport {
    /// Number of received samples.
    pub samples: u64,
    /// Number of dropped samples: values that are not finite, or a time in the future.
    pub dropped: u64,
    /// Number of ticks without a recent sample at their beginning.
    pub unseen: u64,
    /// Number of periods without a recent sample, including that at the start.
    pub spells: u64,
    /// Age of the samples that were used, us.
    pub age: Option<Percentiles>,
}

/// The newest sample, and whether it can be used.
#[derive(Debug, Clone)]
pub(super) struct VisionInput {
    /// Greatest age of a usable sample, ns.
    max_age: u64,
    /// Length of a tick, ns.
    period: u64,
    /// Square of the distance beyond which a target counts as a new one, m^2.
    jump_squared: f32,
    newest: Option<Vision>,
    /// Position at which the current target was first reported, m.
    target_start: Option<[f32; 2]>,
    /// Whether there was a recent sample at the beginning of the tick.
    pub sees: bool,
    /// Age of the newest sample at the beginning of the tick, ns.
    pub latest_age: Option<u64>,
    ages: Histogram<u64>,
    /// Counts so far.
    pub report: VisionReport,
}

impl VisionInput {
    /// Vision for a validated configuration and ticks of `period` ns.
    pub fn new(config: &ServosConfig, period: u64) -> Self {
        Self {
            max_age: config.vision_age_ns(),
            period,
            jump_squared: config.vision_jump() * config.vision_jump(),
            newest: None,
            target_start: None,
            sees: false,
            latest_age: None,
            ages: histogram(),
            report: VisionReport { spells: 1, ..VisionReport::default() },
        }
    }

    /// Receives a sample at `now`. Of all trackers' samples, the one with the newest image is kept.
    pub fn receive(&mut self, sample: &Vision, now: u64) {
        self.report.samples += 1;
        let finite = sample.target.iter().chain(&sample.end).all(|x| x.is_finite());
        if !finite || sample.header.sensed_ns > now + self.period {
            self.report.dropped += 1;
        } else if self.newest.is_none_or(|newest| newest.header.sensed_ns <= sample.header.sensed_ns) {
            self.newest = Some(*sample);
        }
    }

    /// Begins a tick at `now`: updates [`sees`](Self::sees), and returns whether it has changed.
    pub fn begin_tick(&mut self, now: u64) -> bool {
        let before = self.sees;
        let age = self.newest.map(|newest| now.saturating_sub(newest.header.sensed_ns));
        self.latest_age = age;
        self.sees = age.is_some_and(|age| age <= self.max_age);
        match age {
            Some(age) if self.sees => self.ages.saturating_record(age),
            _ => self.report.unseen += 1,
        }
        self.report.spells += u64::from(before && !self.sees);
        self.sees != before
    }

    /// The newest position of the end-effector, m.
    pub fn end(&self) -> [f32; 2] {
        self.newest.map_or([0.0; 2], |newest| newest.end)
    }

    /// The position of the target, m, and whether it is a new target; `None` without a recent sample.
    pub fn target(&mut self) -> Option<([f32; 2], bool)> {
        let target = self.newest.filter(|_| self.sees)?.target;
        let far = |[x, y]: [f32; 2]| {
            (target[0] - x) * (target[0] - x) + (target[1] - y) * (target[1] - y) > self.jump_squared
        };
        let new_target = self.target_start.is_none_or(far);
        if new_target {
            self.target_start = Some(target);
        }
        Some((target, new_target))
    }

    /// The report, with the ages.
    pub fn final_report(&self) -> VisionReport {
        VisionReport { age: Percentiles::of(&self.ages), ..self.report.clone() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: u64 = 1_000_000;

    fn vision() -> VisionInput {
        let config = "port = \"x\"\nprotocol = \"feetech\"\nsight = \"vision\"";
        VisionInput::new(&toml::from_str(config).unwrap(), 50 * MS)
    }

    fn sample(sensed: u64, x: f32) -> Vision {
        let mut vision = Vision { target: [x, 0.5], end: [0.1, -x], ..Vision::default() };
        vision.header.sensed_ns = sensed;
        vision
    }

    #[test]
    fn samples_that_are_too_old_are_not_used() {
        let mut vision = vision();
        assert!(!vision.begin_tick(1000 * MS) && !vision.sees && vision.target().is_none());
        vision.receive(&sample(1000 * MS, 0.2), 1010 * MS);
        assert!(vision.begin_tick(1100 * MS) && vision.sees, "100 ms is recent enough");
        assert!(vision.begin_tick(1100 * MS + 1) && !vision.sees && vision.target().is_none());
        // An older image that arrives later is ignored, and a newer one is used.
        vision.receive(&sample(900 * MS, 0.9), 1100 * MS);
        assert_eq!(vision.end(), [0.1, -0.2]);
        vision.receive(&sample(1090 * MS, 0.3), 1110 * MS);
        assert!(vision.begin_tick(1110 * MS) && vision.sees);
        assert_eq!(vision.end(), [0.1, -0.3]);
        let report = vision.final_report();
        assert_eq!((report.samples, report.dropped, report.unseen, report.spells), (3, 0, 2, 2));
        assert_eq!(report.age.unwrap().count, 2);
    }

    #[test]
    fn a_target_is_new_when_it_is_far_from_where_it_was_first_reported() {
        let mut vision = vision();
        let mut at = |x: f32| {
            vision.receive(&sample(MS, x), MS);
            vision.begin_tick(MS);
            vision.target().unwrap()
        };
        assert_eq!(at(0.2), ([0.2, 0.5], true));
        assert_eq!(at(0.24), ([0.24, 0.5], false));
        assert_eq!(at(0.26), ([0.26, 0.5], true), "measured from its first position");
        assert_eq!(at(0.22), ([0.22, 0.5], false));
    }

    #[test]
    fn invalid_samples_are_dropped_and_counted() {
        let mut vision = vision();
        let now = 1000 * MS;
        for value in [f32::NAN, f32::INFINITY] {
            vision.receive(&sample(now, value), now);
        }
        vision.receive(&sample(now + 50 * MS + 1, 0.0), now);
        assert!(!vision.begin_tick(now) && !vision.sees);
        assert_eq!((vision.report.samples, vision.report.dropped), (3, 3));
        vision.receive(&sample(now + 50 * MS, 0.0), now);
        assert!(vision.begin_tick(now) && vision.sees, "clocks may differ by a tick");
    }
}
