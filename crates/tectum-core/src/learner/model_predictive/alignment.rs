//! How late rewards come, and how angles are to be read: the marginal likelihood of some rewards under each
//! assumption.
//!
//! A reward may belong to the inputs after its tick or to those before it, or to a tick 1 to 3 earlier than the one
//! with which it came, where a camera or a computation takes its time. Before each refit, a Gaussian process with the
//! kernel of the reward model is fitted to the same 120 rewards with the points of each assumption, by a few steps of
//! ascent of its evidence (Rasmussen & Williams 2006, chapter 5). The evidences are added up over the refits, and old
//! ones fade.
//!
//! Where angles follow each other in the inputs, they may be directions of bodies, or each be measured from the body
//! before, as the joints of most arms are. The reward of the second arm is that of the first in running sums of the
//! angles ([`AngleReading`]), and others have joints of both kinds: a base that turns about the vertical, then joints
//! in a plane. Which it is follows from the evidence in the same way ([`Readings`]). When an assumption changes, both
//! reward models begin anew.
//!
//! The rewards are those of remembered ticks that lie far from each other. At equal intervals they are mostly those of
//! an arm that stands at its target, which fit any assumption: then the evidence of a reading had the wrong sign on
//! three of six arms after 643 ticks, and models that were exact were thrown away. The steps of ascent are shared out
//! over some ticks.

mod readings;

use super::config::InputRange;
use super::evidence::Evidence;
use super::functions::exp;
use super::layout::{Layout, ScaleKind};
use super::layouts::{AngleReading, read_angles};
use super::memory::Memory;
use super::spread::spread_out;
use crate::MAX_INPUTS;
use crate::state::{Persist, StateVisitor};
use readings::{MOST_READINGS, Readings};

/// Assumptions: ticks that a reward comes late, and whether it depends on the inputs after the tick. A reward of the
/// inputs before its tick, without their command, is the same as one of the inputs after the tick before.
const CHOICES: [(u64, bool); 5] = [(0, true), (0, false), (1, true), (2, true), (3, true)];
/// Largest lateness, ticks.
pub const MOST_LATE: u64 = 3;
/// Rewards that are compared.
const POINTS: usize = 120;
/// Fewer say nothing.
const LEAST_POINTS: usize = 12;
/// Steps of ascent.
const STEPS: u32 = 8;
/// Advantage of rewards that are in time, and by what another lateness must be better, in units of evidence: so much
/// for each of the rewards, and not less than for 60 of them.
const BONUS: f64 = 1.0 / 3.0;

/// Steps of ascent for a reading of the angles.
const READING_STEPS: u32 = 10;

/// The oldest ticks of a full memory, which will be forgotten before all assumptions are weighed, are left out.
const SOON_FORGOTTEN: u64 = 32;

/// What is assumed about rewards.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RewardAssumption {
    /// They come so many ticks late.
    pub shift: u64,
    /// How the angles are read that they depend on.
    pub reading: AngleReading,
}

/// Compares assumptions about rewards.
#[derive(Debug, Clone)]
pub struct Alignment {
    /// That of the reward models, in the reading that is weighed.
    layout: Layout,
    ranges: Vec<InputRange>,
    evidence: Evidence,
    totals: [f64; CHOICES.len()],
    readings: Readings,
    /// The assumption that is weighed: how late rewards are, then each reading.
    next: u32,
    /// Steps that were made for it, and the evidence before the last of them.
    steps: u32,
    weight: f64,
    /// The remembered ticks of the rewards that are compared, and their number.
    ticks: [u64; POINTS],
    count: u32,
    /// Operations of this tick.
    pub spent: u64,
    // Scratch memory: components of each remembered tick, and its squared distance from the ticks chosen so far.
    looks: Vec<f64>,
    least: Vec<f64>,
}

impl Alignment {
    /// For at most `memory` remembered rewards of this layout for these inputs.
    pub fn new(layout: Layout, ranges: &[InputRange], memory: usize) -> Self {
        Self {
            evidence: Evidence::new(&layout, POINTS, 1),
            totals: [0.0; CHOICES.len()],
            readings: Readings::new(ranges),
            ranges: ranges.to_vec(),
            next: 0,
            steps: 0,
            weight: 0.0,
            ticks: [0; POINTS],
            count: 0,
            spent: 0,
            looks: vec![0.0; memory * layout.components],
            least: vec![0.0; memory],
            layout,
        }
    }

    /// Weighs assumptions, one after the other, as far as a tick's `operations` go, and a step at least. Returns what
    /// is assumed from now on once all are weighed, given what is `present`.
    pub fn weigh(
        &mut self,
        memory: &Memory,
        present: RewardAssumption,
        noise_floor: f64,
        operations: u64,
    ) -> Option<RewardAssumption> {
        self.spent = 0;
        if self.next == 0 && self.steps == 0 {
            self.choose_ticks(memory, present.shift);
        }
        loop {
            let Some((reading, choice, steps)) = self.next_assumption(present) else {
                self.next = 0;
                return Some(RewardAssumption {
                    shift: self.decide(present.shift),
                    reading: self.readings.decide(present.reading),
                });
            };
            read_angles(&mut self.layout, &self.ranges, reading);
            if self.steps == 0 {
                self.take_points(memory, choice);
            }
            let cost = self.evidence.cost(&self.layout);
            if self.evidence.len >= LEAST_POINTS {
                self.weight = self.evidence.step(&self.layout, 2.5, 0.3, noise_floor).unwrap_or(self.weight);
                self.spent += cost;
                self.steps += 1;
            }
            if self.steps >= steps || self.evidence.len < LEAST_POINTS {
                self.conclude();
            }
            if self.spent + cost > operations {
                return None;
            }
        }
    }

    /// The assumption that is weighed next, and its steps of ascent; `None` after the last of them.
    fn next_assumption(&self, present: RewardAssumption) -> Option<(AngleReading, (u64, bool), u32)> {
        let next = self.next as usize;
        if let Some(choice) = CHOICES.get(next) {
            return Some((present.reading, *choice, STEPS));
        }
        let reading = self.readings.candidate(present.reading, next - CHOICES.len())?;
        Some((reading, self.best_of(present.shift), READING_STEPS))
    }

    /// Adds the evidence of an assumption to what was known of it, and goes on to the next one.
    fn conclude(&mut self) {
        let next = self.next as usize;
        match self.totals.get_mut(next) {
            Some(total) => *total = 0.5 * *total + self.weight,
            None => self.readings.note(next - CHOICES.len(), self.weight),
        }
        self.steps = 0;
        self.next += 1;
    }

    /// Has a layout of the reward models read angles so.
    pub fn read(&self, layout: &mut Layout, reading: AngleReading) {
        read_angles(layout, &self.ranges, reading);
    }

    /// The reading of these bits, as far as angles can be read so.
    pub fn reading_of(&self, bits: u32) -> AngleReading {
        AngleReading::of_bits(bits, self.readings.chain())
    }

    /// Chooses the ticks whose rewards are compared, far from each other if rewards come `shift` ticks late.
    fn choose_ticks(&mut self, memory: &Memory, shift: u64) {
        // How far ticks are from each other is measured in one reading for all.
        read_angles(&mut self.layout, &self.ranges, AngleReading::APART);
        let layout = &self.layout;
        let forgotten = if memory.first > 0 { memory.first + SOON_FORGOTTEN } else { 0 };
        let (first, end) = (memory.rewards_from().max(forgotten), memory.stored);
        let (width, least) = (layout.components, &mut self.least[..end.saturating_sub(first) as usize]);
        let mut frequencies = [0.0; MAX_INPUTS];
        for (u, frequency) in frequencies.iter_mut().enumerate().take(layout.circles) {
            *frequency = exp(layout.prior[Layout::scale(u, ScaleKind::Frequency)]);
        }
        for (k, least) in least.iter_mut().enumerate() {
            let tick = first + k as u64;
            *least = 0.0;
            if is_complete(memory, tick)
                && let Some(q) = memory.rewarded_point(tick, shift, true)
            {
                *least = f64::INFINITY;
                layout.components(&frequencies, q, &mut self.looks[k * width..(k + 1) * width], None);
            }
        }
        spread_out(&self.looks, width, least, POINTS as u64);
        self.spent += (least.len() * POINTS * width) as u64;
        self.count = 0;
        for (tick, _) in (first..).zip(&*least).filter(|(_, least)| **least < 0.0) {
            self.ticks[self.count as usize] = tick;
            self.count += 1;
        }
    }

    /// Begins to compare: the chosen rewards with their points under an assumption.
    fn take_points(&mut self, memory: &Memory, (shift, after): (u64, bool)) {
        self.weight = 0.0;
        self.evidence.restart(&self.layout.prior);
        let ticks = &self.ticks[..self.count as usize];
        let [origin, mean, deviation] = moments(memory, ticks);
        if deviation > 0.0 {
            for tick in ticks {
                if let Some(point) = memory.rewarded_point(*tick, shift, after) {
                    self.evidence.push(point, &[(memory.reward(*tick) - origin - mean) / deviation], 1.0);
                }
            }
        }
    }

    /// The assumption of this lateness that is best so far.
    fn best_of(&self, shift: u64) -> (u64, bool) {
        let of = |k: &usize| self.totals[*k];
        let places = (0..CHOICES.len()).filter(|k| CHOICES[*k].0 == shift);
        places.max_by(|a, b| of(a).total_cmp(&of(b)).then(b.cmp(a))).map_or((0, true), |k| CHOICES[k])
    }

    fn decide(&self, present: u64) -> u64 {
        let bonus = BONUS * f64::from(self.count.max(60));
        let of = |shift: u64| {
            let each = CHOICES.iter().zip(self.totals).filter(|((s, _), _)| *s == shift);
            each.map(|(_, total)| total).fold(f64::NEG_INFINITY, f64::max) + if shift == 0 { bonus } else { 0.0 }
        };
        let best = (0..=MOST_LATE).max_by(|a, b| of(*a).total_cmp(&of(*b)).then(b.cmp(a))).unwrap_or(present);
        if of(best) > of(present) + bonus { best } else { present }
    }
}

/// Whether a remembered reward has a point under each assumption about its lateness.
fn is_complete(memory: &Memory, tick: u64) -> bool {
    memory.is_rewarded(tick)
        && !memory.near_boundary(tick, MOST_LATE)
        && memory.rewarded_point(tick, MOST_LATE, true).is_some()
}

/// The rewards of some ticks: the first of them, the mean of what they differ from it, and their standard deviation.
fn moments(memory: &Memory, ticks: &[u64]) -> [f64; 3] {
    let origin = ticks.first().map_or(0.0, |tick| memory.reward(*tick));
    let (mut sum, mut squares) = (0.0, 0.0);
    for tick in ticks {
        let reward = memory.reward(*tick) - origin;
        (sum, squares) = (sum + reward, squares + reward * reward);
    }
    let n = (ticks.len() as f64).max(1.0);
    let mean = sum / n;
    [origin, mean, (squares / n - mean * mean).max(0.0).sqrt()]
}

impl Persist for Alignment {
    fn visit_state(&mut self, visitor: &mut dyn StateVisitor) {
        visitor.numbers("totals", &mut self.totals);
        visitor.nested("readings", &mut self.readings);
        visitor.number("next", &mut self.next);
        self.next = self.next.min((CHOICES.len() + MOST_READINGS - 1) as u32);
        visitor.number("steps", &mut self.steps);
        visitor.number("weight", &mut self.weight);
        visitor.numbers("ticks", &mut self.ticks);
        visitor.number("points", &mut self.count);
        self.count = self.count.min(POINTS as u32);
        visitor.nested("evidence", &mut self.evidence);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::learner::model_predictive::config::InputRange;
    use crate::learner::model_predictive::layout::Places;
    use crate::learner::model_predictive::layouts::reward_layout;
    use crate::learner::model_predictive::memory::{Entry, Lesson};
    use crate::learner::model_predictive::model::normal;
    use crate::seed::stream;
    use rand::RngExt as _;
    use std::f64::consts::PI;

    const TRIAL: u64 = 80;

    /// What an arm of three segments remembers that has reached eight targets: it goes there within ten ticks, and then
    /// stands, but for noise. The bits say which angles are measured from the segment before.
    fn remembered(bits: u32, ranges: &[InputRange], places: Places) -> Memory {
        let rng = &mut stream(5, "test");
        let mut memory = Memory::new(places, 1000);
        let (mut angles, mut goal, mut target) = ([0.0_f64; 3], [0.0; 3], [0.0; 2]);
        let end = |angles: &[f64; 3]| {
            let mut direction = 0.0;
            angles.iter().zip(2..).fold([0.0, 0.0], |[x, y], (angle, i)| {
                direction = if bits >> i & 1 == 1 { direction + angle } else { *angle };
                [x + 0.5 * direction.cos(), y + 0.5 * direction.sin()]
            })
        };
        for tick in 0..8 * TRIAL {
            if tick.is_multiple_of(TRIAL) {
                goal = std::array::from_fn(|_| rng.random_range(-2.0..2.0));
                target = end(&goal).map(|x| x + 0.02 * normal(rng));
            }
            let mut after = vec![0.0; places.len()];
            let mut effort = 0.0;
            for (j, (angle, goal)) in angles.iter_mut().zip(&goal).enumerate() {
                let u = (0.3 * (goal - *angle) + 0.03 * normal(rng)).clamp(-1.0, 1.0);
                *angle += u;
                effort += u * u;
                (after[2 + j], after[places.state() + j]) = (*angle / PI, u);
            }
            (after[0], after[1]) = (target[0] / ranges[0].max, target[1] / ranges[0].max);
            let [x, y] = end(&angles);
            let reward = -(x - target[0]).powi(2) - (y - target[1]).powi(2) - 0.01 * effort;
            let changes = vec![0.0; places.inputs];
            let lesson = Lesson::default();
            let boundary = tick.is_multiple_of(TRIAL);
            memory.push(&Entry { before: &after, after: &after, changes: &changes, reward, lesson, tick, boundary });
            memory.set_rewarded(tick, true);
        }
        memory
    }

    #[test]
    fn the_reading_is_that_of_the_arm() {
        let places = Places { inputs: 5, commands: 3 };
        let length = InputRange { min: -2.0, max: 2.0, wraps: false, radians: Some(0.0) };
        let angle = InputRange { min: -PI, max: PI, wraps: false, radians: Some(1.0) };
        let ranges = [length, length, angle, angle, angle];
        assert_eq!(AngleReading::chain(&ranges).bits(), 0b11000);
        for right in [0, 0b11000, 0b10000] {
            let memory = remembered(right, &ranges, places);
            for present in [0, 0b11000] {
                let layout = reward_layout(places, &ranges);
                let mut alignment = Alignment::new(layout, &ranges, 1000);
                let mut assumed = RewardAssumption { shift: 0, reading: alignment.reading_of(present) };
                // An angle of its own beside a chain takes a second round.
                for _ in 0..2 {
                    let weighed = (0..40).find_map(|_| alignment.weigh(&memory, assumed, 1e-7, 20_000_000));
                    assumed = weighed.expect("weighed");
                }
                assert_eq!(assumed.reading.bits(), right, "{present:#b}, {:?}", alignment.readings);
            }
        }
    }
}
