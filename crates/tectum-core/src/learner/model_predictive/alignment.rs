//! How late rewards come, and how angles are to be read: the marginal likelihood of a few rewards under each
//! assumption.
//!
//! A reward may belong to the inputs after its tick or to those before it, or to a tick 1 to 3 earlier than the one
//! with which it came, where a camera or a computation takes its time. Before each refit, a Gaussian process with the
//! kernel of the reward model is fitted to the same 60 rewards with the points of each assumption, by a few steps of
//! ascent of its evidence (Rasmussen & Williams 2006, chapter 5). The evidences are added up over the refits, and old
//! ones fade.
//!
//! Where angles follow each other in the inputs, they may be directions of bodies, or each be measured from the body
//! before, as the joints of most arms are. The reward of the second arm is that of the first in running sums of the
//! angles ([`AngleReading`]). Which of the two it is follows from the evidence in the same way, and then both reward
//! models are fitted anew in that reading.

use super::evidence::Evidence;
use super::layout::{Layout, Unit};
use super::layouts::AngleReading;
use super::memory::Memory;
use crate::state::{Persist, StateVisitor};

/// Assumptions: ticks that a reward comes late, and whether it depends on the inputs after the tick. A reward of the
/// inputs before its tick, without their command, is the same as one of the inputs after the tick before.
const CHOICES: [(u64, bool); 5] = [(0, true), (0, false), (1, true), (2, true), (3, true)];
/// Largest lateness, ticks.
pub const MOST_LATE: u64 = 3;
/// Rewards that are compared.
const POINTS: usize = 60;
/// Steps of ascent.
const STEPS: usize = 8;
/// Advantage of rewards that are in time, and by what another lateness must be better, in units of evidence: that of a
/// third of a nat for each of the rewards.
const BONUS: f64 = 20.0;

/// Steps of ascent for a reading of the angles.
const READING_STEPS: usize = 20;
/// By how much evidence another reading must be better.
const READING_GAIN: f64 = 3.0;

/// What is assumed about rewards.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RewardAssumption {
    /// They come so many ticks late.
    pub shift: u64,
    /// How the angles are read that they depend on.
    pub reading: AngleReading,
}

/// Compares how late rewards may be.
#[derive(Debug, Clone)]
pub struct Alignment {
    /// Those of the readings of angles, by [`AngleReading`], or one where there is one reading only.
    layouts: Vec<Layout>,
    evidence: Evidence,
    totals: [f64; CHOICES.len()],
    /// By how much the evidence of a chain is larger than that of angles apart.
    chain: f64,
    /// The next assumption to weigh.
    next: u32,
    q: Vec<f64>,
}

impl Alignment {
    /// For rewards of these layouts, which have units of the same number and kind.
    pub fn new(layouts: Vec<Layout>) -> Self {
        Self {
            evidence: Evidence::new(&layouts[0], POINTS, 1),
            totals: [0.0; CHOICES.len()],
            chain: 0.0,
            next: 0,
            q: vec![0.0; layouts[0].width],
            layouts,
        }
    }

    /// Weighs the next assumption. Returns what is assumed from now on once all are weighed, given what is `present`.
    pub fn weigh(&mut self, memory: &Memory, present: RewardAssumption, noise_floor: f64) -> Option<RewardAssumption> {
        let next = self.next as usize;
        if let Some(choice) = CHOICES.get(next) {
            let weight = self.evidence_of(present.reading, memory, *choice, (STEPS, noise_floor));
            self.totals[next] = 0.5 * self.totals[next] + weight;
        } else {
            let chain = next > CHOICES.len();
            let reading = if chain { AngleReading::Chain } else { AngleReading::Apart };
            let choice = self.best_of(present.shift);
            let weight = self.evidence_of(reading, memory, choice, (READING_STEPS, noise_floor));
            self.chain = if chain { self.chain + weight } else { 0.5 * self.chain - weight };
        }
        self.next += 1;
        let count = CHOICES.len() + if self.layouts.len() > 1 { 2 } else { 0 };
        (self.next as usize >= count).then(|| {
            self.next = 0;
            RewardAssumption { shift: self.decide(present.shift), reading: self.read(present.reading) }
        })
    }

    /// The units of the reward models' layout in a reading that is known ([`knows`](Self::knows)).
    pub fn units(&self, reading: AngleReading) -> &[Unit] {
        &self.layouts[reading as usize].units
    }

    /// Whether there is such a reading.
    pub fn knows(&self, reading: AngleReading) -> bool {
        (reading as usize) < self.layouts.len()
    }

    /// The evidence of some rewards under an assumption, after steps of ascent.
    fn evidence_of(
        &mut self,
        reading: AngleReading,
        memory: &Memory,
        (shift, after): (u64, bool),
        (steps, noise_floor): (usize, f64),
    ) -> f64 {
        let (first, end) = (memory.rewards_from().max(memory.stored.saturating_sub(600)) + MOST_LATE, memory.stored);
        let complete = |tick: &u64| {
            memory.is_rewarded(*tick)
                && !memory.near_boundary(*tick, MOST_LATE)
                && memory.rewarded_point(*tick, MOST_LATE, true).is_some()
        };
        let count = (first..end).filter(complete).count();
        let step = count.div_ceil(POINTS).max(1);
        let chosen = || (first..end).filter(complete).step_by(step);
        let (mut n, mut sum, mut squares) = (0.0, 0.0, 0.0);
        for tick in chosen() {
            let reward = memory.reward(tick) - memory.reward(chosen().next().unwrap_or(tick));
            (n, sum, squares) = (n + 1.0, sum + reward, squares + reward * reward);
        }
        let origin = chosen().next().map_or(0.0, |tick| memory.reward(tick));
        let mean = sum / f64::max(n, 1.0);
        let deviation = (squares / f64::max(n, 1.0) - mean * mean).max(0.0).sqrt();
        let mut weight = 0.0;
        if n >= 12.0 && deviation > 0.0 {
            let layout = &self.layouts[reading as usize];
            self.evidence.restart(&layout.prior);
            for tick in chosen() {
                if let Some(point) = memory.rewarded_point(tick, shift, after) {
                    self.q.copy_from_slice(point);
                    self.evidence.push(&self.q, &[(memory.reward(tick) - origin - mean) / deviation], 1.0);
                }
            }
            for _ in 0..steps {
                weight = self.evidence.step(layout, 2.5, 0.3, noise_floor).unwrap_or(weight);
            }
        }
        weight
    }

    /// The assumption of this lateness that is best so far.
    fn best_of(&self, shift: u64) -> (u64, bool) {
        let of = |k: &usize| self.totals[*k];
        let places = (0..CHOICES.len()).filter(|k| CHOICES[*k].0 == shift);
        places.max_by(|a, b| of(a).total_cmp(&of(b)).then(b.cmp(a))).map_or((0, true), |k| CHOICES[k])
    }

    /// How angles are read from now on.
    fn read(&self, present: AngleReading) -> AngleReading {
        if self.chain.abs() < READING_GAIN {
            present
        } else if self.chain > 0.0 {
            AngleReading::Chain
        } else {
            AngleReading::Apart
        }
    }

    fn decide(&self, present: u64) -> u64 {
        let of = |shift: u64| {
            let each = CHOICES.iter().zip(self.totals).filter(|((s, _), _)| *s == shift);
            each.map(|(_, total)| total).fold(f64::NEG_INFINITY, f64::max) + if shift == 0 { BONUS } else { 0.0 }
        };
        let best = (0..=MOST_LATE).max_by(|a, b| of(*a).total_cmp(&of(*b)).then(b.cmp(a))).unwrap_or(present);
        if of(best) > of(present) + BONUS { best } else { present }
    }
}

impl Persist for Alignment {
    fn visit_state(&mut self, visitor: &mut dyn StateVisitor) {
        visitor.numbers("totals", &mut self.totals);
        visitor.number("chain", &mut self.chain);
        visitor.number("next", &mut self.next);
        self.next = self.next.min(CHOICES.len() as u32 + 1);
    }
}
