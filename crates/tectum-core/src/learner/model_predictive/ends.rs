//! Ends of inputs that nobody declared, such as the stops of joints: learned from inputs that stand where they should
//! move on.
//!
//! An input is *held* in a tick if it was predicted to move on towards a side, and did not, at the farthest place where
//! it has been on that side. Such a tick teaches nothing about free movement, as one at a declared end. After [`HELD`]
//! of them at one place this is an end: from then on predictions are clamped there. An end is given up as soon
//! as the input is seen beyond it.
//!
//! Places are in units of half of the input's range. An end is soft, because a stop is: a joint that runs into it comes
//! to rest up to [`SLACK`] further or less far.

use super::world::Ranges;
use crate::state::{Persist, StateVisitor};

/// How far from an end an input may stand and be at it.
pub const SLACK: f64 = 0.02;
/// So many ticks in which an input is held make an end.
const HELD: u32 = 4;
/// The least movement that was predicted of an input that is held.
const LEAST: f64 = 0.005;
/// What is held moves by less than this part of what was predicted.
const STANDS: f64 = 0.25;
/// The least squared error, in predictive variances, of an input that is held.
const STRANGE: f64 = 9.0;
/// An input that moves further than predicted, with such an error, has jumped: it was not really there.
const JUMP: f64 = 25.0;

/// No input is so far out.
const BEYOND_ALL: f64 = 3.0;

/// An input's movement in a tick.
#[derive(Debug, Clone, Copy)]
pub struct Movement {
    /// Where it was.
    pub from: f64,
    /// Where it came to.
    pub to: f64,
    /// By how much it was predicted to move, without any end.
    pub predicted: f64,
    /// The squared error of this prediction, in predictive variances.
    pub surprise: f64,
}

/// What a movement tells of an end.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
struct Holding {
    /// The input was held.
    held: bool,
    /// The end was found, or given up.
    changed: bool,
}

/// What is known of one side of an input.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Side {
    /// The farthest place where the input has been.
    farthest: f64,
    /// Where it was held, and in how many ticks.
    at: f64,
    held: u32,
    known: bool,
}

impl Side {
    const NOTHING: Self = Self { farthest: -BEYOND_ALL, at: -BEYOND_ALL, held: 0, known: false };

    /// Takes a movement, seen so that this side is the upper one.
    fn take(&mut self, movement: &Movement) -> Holding {
        let Movement { from, to, predicted, surprise } = *movement;
        if surprise >= JUMP && (to - from).abs() > predicted.abs() {
            return Holding::default();
        }
        self.farthest = self.farthest.max(to);
        if to > self.at + 2.0 * SLACK && self.held > 0 {
            self.held = 0;
            return Holding { held: false, changed: std::mem::take(&mut self.known) };
        }
        let stands = predicted > LEAST && (to - from).abs() < STANDS * predicted;
        let elsewhere = to < self.farthest - SLACK || to > 1.0 - 2.0 * SLACK;
        if self.known || !stands || elsewhere || surprise < STRANGE {
            return Holding::default();
        }
        self.held += 1;
        let part = 1.0 / f64::from(self.held);
        self.at = if self.held == 1 { to } else { self.at + part * (to - self.at) };
        self.known = self.held == HELD;
        Holding { held: true, changed: self.known }
    }
}

/// The ends of all inputs.
#[derive(Debug, Clone)]
pub struct LearnedEnds {
    /// The lower and the upper side of each input.
    sides: Vec<[Side; 2]>,
}

impl LearnedEnds {
    /// Of so many inputs, of which nothing is known.
    pub fn new(inputs: usize) -> Self {
        Self { sides: vec![[Side::NOTHING; 2]; inputs] }
    }

    /// Takes the movement of input `i`. Returns whether it was held at the lower and at the upper side, and whether an
    /// end was found or given up, of which `ranges` then knows.
    pub fn take(&mut self, i: usize, movement: &Movement, ranges: &mut Ranges) -> ([bool; 2], bool) {
        let [low, high] = &mut self.sides[i];
        let Movement { from, to, predicted, surprise } = *movement;
        let mirrored = Movement { from: -from, to: -to, predicted: -predicted, surprise };
        let sides = [low.take(&mirrored), high.take(movement)];
        let changed = sides.iter().any(|side| side.changed);
        if changed {
            self.tell(i, ranges);
        }
        (sides.map(|side| side.held), changed)
    }

    /// Number of ends that are known.
    pub fn known(&self) -> u64 {
        self.sides.iter().flatten().filter(|side| side.known).count() as u64
    }

    /// Tells `ranges` of the ends of input `i`.
    fn tell(&self, i: usize, ranges: &mut Ranges) {
        let [low, high] = self.sides[i].map(|side| side.known.then_some(side.at));
        ranges.set_learned(i, [low.map(|at| -at), high]);
    }

    /// Tells `ranges` of all ends.
    pub fn tell_all(&self, ranges: &mut Ranges) {
        (0..self.sides.len()).for_each(|i| self.tell(i, ranges));
    }
}

impl Persist for LearnedEnds {
    fn visit_state(&mut self, visitor: &mut dyn StateVisitor) {
        for side in self.sides.iter_mut().flatten() {
            let mut numbers = [side.farthest, side.at];
            visitor.numbers("places", &mut numbers);
            [side.farthest, side.at] = numbers;
            visitor.number("held", &mut side.held);
            visitor.boolean("known", &mut side.known);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::config::InputRange;
    use super::*;

    const WRAPS: InputRange = InputRange { min: -1.0, max: 1.0, wraps: true, radians: Some(1.0) };

    fn held(from: f64, to: f64, predicted: f64) -> Movement {
        Movement { from, to, predicted, surprise: 100.0 }
    }

    #[test]
    fn an_input_that_is_held_has_an_end_there_until_it_is_seen_beyond() {
        for (side, place) in [(1.0, 0.6), (-1.0, 0.6), (1.0, 0.1)] {
            let (mut ends, mut ranges) = (LearnedEnds::new(1), Ranges::of(&[WRAPS]));
            let mut take = |from: f64, to: f64, predicted: f64| {
                let (_, changed) = ends.take(0, &held(side * from, side * to, side * predicted), &mut ranges);
                (changed, ends.known(), side * ranges.bring_in(0, side * 0.7))
            };
            for _ in 1..HELD {
                assert_eq!(take(place, place + 0.001, 0.1), (false, 0, 0.7));
            }
            let (changed, known, clamped) = take(place, place + 0.001, 0.1);
            assert!(changed && known == 1 && (clamped - place - 0.001).abs() < 1e-9, "{clamped}");
            // A jump is nothing, and a little further is still the end; much further is none.
            assert!(!take(place, place + 0.3, 0.1).0);
            assert!(!take(place, place + 0.02, 0.1).0);
            assert_eq!(take(place, place + 0.05, 0.1), (true, 0, 0.7));
        }
    }

    #[test]
    fn what_moves_as_predicted_or_is_held_elsewhere_has_no_end() {
        let (mut ends, mut ranges) = (LearnedEnds::new(1), Ranges::of(&[WRAPS]));
        let mut take = |movement| assert_eq!(ends.take(0, &movement, &mut ranges), ([false; 2], false), "{movement:?}");
        take(held(0.4, 0.5, 0.1));
        for _ in 0..20 {
            // Held inside of where it has been, as by a brake; moving further; slower than predicted; not surprising.
            take(held(0.2, 0.2, 0.1));
            take(held(0.4, 0.5, 0.2));
            take(Movement { surprise: 1.0, ..held(0.5, 0.5, 0.1) });
        }
        assert_eq!(ends.known(), 0);
    }
}
