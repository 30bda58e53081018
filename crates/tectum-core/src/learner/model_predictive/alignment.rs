//! How late rewards come: the marginal likelihood of a few rewards under each assumption.
//!
//! A reward may belong to the inputs after its tick or to those before it, or to a tick 1 to 3 earlier than the one
//! with which it came, where a camera or a computation takes its time. Before each refit, a Gaussian process with the
//! kernel of the reward model is fitted to the same 60 rewards with the points of each assumption, by a few steps of
//! ascent of its evidence (Rasmussen & Williams 2006, chapter 5). The evidences are added up over the refits, and old
//! ones fade.

use super::evidence::Evidence;
use super::layout::Layout;
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

/// Compares how late rewards may be.
#[derive(Debug, Clone)]
pub struct Alignment {
    evidence: Evidence,
    totals: [f64; CHOICES.len()],
    /// The next assumption to weigh.
    next: u32,
    q: Vec<f64>,
}

impl Alignment {
    /// For rewards of this layout.
    pub fn new(layout: &Layout) -> Self {
        Self {
            evidence: Evidence::new(layout, POINTS, 1),
            totals: [0.0; CHOICES.len()],
            next: 0,
            q: vec![0.0; layout.width],
        }
    }

    /// Weighs the next assumption. Returns the lateness once all are weighed, given the present one.
    pub fn weigh(&mut self, layout: &Layout, memory: &Memory, present: u64, noise_floor: f64) -> Option<u64> {
        let (shift, after) = CHOICES[self.next as usize];
        let (first, end) = (memory.first.max(memory.stored.saturating_sub(600)) + MOST_LATE, memory.stored);
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
            self.evidence.restart(&layout.prior);
            for tick in chosen() {
                if let Some(point) = memory.rewarded_point(tick, shift, after) {
                    self.q.copy_from_slice(point);
                    self.evidence.push(&self.q, &[(memory.reward(tick) - origin - mean) / deviation], 1.0);
                }
            }
            for _ in 0..STEPS {
                weight = self.evidence.step(layout, 2.5, 0.3, noise_floor).unwrap_or(weight);
            }
        }
        let total = &mut self.totals[self.next as usize];
        *total = 0.5 * *total + weight;
        self.next += 1;
        (self.next as usize == CHOICES.len()).then(|| {
            self.next = 0;
            self.decide(present)
        })
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
        visitor.number("next", &mut self.next);
        self.next = self.next.min(CHOICES.len() as u32 - 1);
    }
}
