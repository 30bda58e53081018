//! Which reading of the angles ([`AngleReading`]) the rewards speak for.
//!
//! The readings are too many to weigh them all. In every round these are: all angles apart; all as one chain; the
//! present reading, if it is neither; and the present one with one angle read in the other way, for up to four angles
//! in turn, where there are several to choose from. What a round finds counts half in the next one.

use super::super::config::InputRange;
use super::super::layouts::AngleReading;
use crate::MAX_INPUTS;
use crate::state::{Persist, StateVisitor};

/// By how much evidence the chain must be better than angles apart, or those than the chain.
const GAIN: f64 = 3.0;
/// By how much it must be better to read a single angle in the other way: there are several such, of which one may seem
/// better by chance.
const FLIP_GAIN: f64 = 10.0;

/// Most angles that are read in the other way in a round.
const MOST_FLIPS: usize = 4;
/// Most readings of a round.
pub const MOST_READINGS: usize = 3 + MOST_FLIPS;

/// What is known of the readings.
#[derive(Debug, Clone)]
pub struct Readings {
    chain: AngleReading,
    /// Evidence of the readings of this round.
    evidence: [f64; MOST_READINGS],
    /// By how much the evidence of the chain is larger than that of angles apart, over the rounds.
    chained: f64,
    /// By how much that of a present reading that is neither is larger than that of both.
    mixed: f64,
    /// By how much that of the present reading with input `i` read in the other way is larger than that of the present
    /// one.
    flipped: [f64; MAX_INPUTS],
    /// Angles whose turn is over.
    turn: u32,
}

impl Readings {
    /// For these inputs.
    pub fn new(ranges: &[InputRange]) -> Self {
        Self {
            chain: AngleReading::chain(ranges),
            evidence: [0.0; MOST_READINGS],
            chained: 0.0,
            mixed: 0.0,
            flipped: [0.0; MAX_INPUTS],
            turn: 0,
        }
    }

    /// The reading in which all angles that follow each other are a chain.
    pub fn chain(&self) -> AngleReading {
        self.chain
    }

    fn is_mixed(&self, reading: AngleReading) -> bool {
        reading != AngleReading::APART && reading != self.chain
    }

    /// Number of angles that can be read in the other way, one at a time: none where that gives no other reading.
    fn flips(&self) -> usize {
        match self.chain.bits().count_ones() {
            0 | 1 => 0,
            count => count as usize,
        }
    }

    /// The inputs that are read in the other way in this round.
    fn choices(&self) -> impl Iterator<Item = usize> + use<> {
        let (bits, count) = (self.chain.bits(), self.flips());
        let all = (0..MAX_INPUTS).filter(move |i| bits >> i & 1 == 1);
        all.cycle().skip(self.turn as usize).take(count.min(MOST_FLIPS))
    }

    /// Reading `k` of a round; `None` after the last.
    pub fn candidate(&self, present: AngleReading, k: usize) -> Option<AngleReading> {
        match k {
            _ if self.chain == AngleReading::APART => None,
            0 => Some(AngleReading::APART),
            1 => Some(self.chain),
            2 if self.is_mixed(present) => Some(present),
            _ => self.choices().nth(k - self.first_choice(present)).map(|i| present.with_flipped(i)),
        }
    }

    fn first_choice(&self, present: AngleReading) -> usize {
        if self.is_mixed(present) { 3 } else { 2 }
    }

    /// Notes the evidence of reading `k`.
    pub fn note(&mut self, k: usize, evidence: f64) {
        self.evidence[k] = evidence;
    }

    /// The reading from now on, after a round.
    pub fn decide(&mut self, present: AngleReading) -> AngleReading {
        let (is_mixed, [apart, chain, own, ..]) = (self.is_mixed(present), self.evidence);
        self.chained = 0.5 * self.chained + chain - apart;
        let better = if self.chained > 0.0 { self.chain } else { AngleReading::APART };
        let own = match present {
            _ if is_mixed => own,
            AngleReading::APART => apart,
            _ => chain,
        };
        self.mixed = if is_mixed { 0.5 * self.mixed + own - apart.max(chain) } else { 0.0 };
        let first = self.first_choice(present);
        let mut flip = (FLIP_GAIN, None);
        for (k, i) in (first..).zip(self.choices()) {
            self.flipped[i] = 0.5 * self.flipped[i] + self.evidence[k] - own;
            if self.flipped[i] > flip.0 {
                flip = (self.flipped[i], Some(i));
            }
        }
        let keeps = if is_mixed { self.mixed > -GAIN } else { better == present || self.chained.abs() < GAIN };
        let next = match flip.1 {
            _ if !keeps => better,
            Some(i) => present.with_flipped(i),
            None => present,
        };
        if self.flips() > MOST_FLIPS {
            self.turn = (self.turn + MOST_FLIPS as u32) % self.flips() as u32;
        }
        if next != present {
            self.mixed = 0.0;
            self.flipped.fill(0.0);
        }
        next
    }
}

impl Persist for Readings {
    fn visit_state(&mut self, visitor: &mut dyn StateVisitor) {
        visitor.numbers("evidence", &mut self.evidence);
        visitor.number("chained", &mut self.chained);
        visitor.number("mixed", &mut self.mixed);
        visitor.numbers("flipped", &mut self.flipped);
        visitor.number("turn", &mut self.turn);
        self.turn %= self.flips().max(1) as u32;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The reading after so many rounds, if the evidence falls by 20 with each angle that is read wrongly.
    fn found(angles: usize, right: u32, rounds: usize) -> u32 {
        let angle = InputRange { min: -2.0, max: 2.0, wraps: false, radians: Some(1.0) };
        let mut readings = Readings::new(&vec![angle; angles]);
        let mut present = AngleReading::APART;
        for _ in 0..rounds {
            for k in 0.. {
                let Some(reading) = readings.candidate(present, k) else { break };
                readings.note(k, -20.0 * f64::from((reading.bits() ^ right).count_ones()));
            }
            present = readings.decide(present);
        }
        present.bits()
    }

    #[test]
    fn each_angle_is_read_as_it_is_in_the_end() {
        for right in [0, 0b110, 0b010, 0b100] {
            assert_eq!(found(3, right, 3), right);
        }
        // Of the seven angles of an arm with eight joints that follow another one, four have their turn in a round.
        for right in [0, 0b1111_1110, 0b1110_1110, 0b0110_1010] {
            assert_eq!(found(8, right, 12), right);
        }
        assert_eq!([found(2, 0b10, 1), found(1, 0, 1), found(0, 0, 1)], [0b10, 0, 0]);
    }
}
