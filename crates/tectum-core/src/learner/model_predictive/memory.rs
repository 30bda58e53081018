//! The ticks that were seen: what the models are fitted to anew.

use super::layout::Places;
use super::world::{CHANGE, wrap};
use crate::state::{Persist, StateVisitor};

/// What one tick of the memory teaches.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Lesson {
    /// Outputs (bits) that teach nothing.
    pub missing: u32,
    /// Outputs (bits) of which only a lower limit is known: the input came to the upper end of its range.
    pub upper_end: u32,
    /// The same for an upper limit and the lower end.
    pub lower_end: u32,
    /// Whether an input was at an end of its range before or after the tick: what a stop does to the others is hard to
    /// predict, and counts less.
    pub contact: bool,
}

/// A model's view of the memory: points with outputs.
pub trait Data {
    /// The oldest tick that is left, and the tick after the newest.
    fn range(&self) -> (u64, u64);
    /// Writes the point and outputs of `tick`; `None` if it teaches this model nothing.
    fn get(&self, tick: u64, q: &mut [f64], y: &mut [f64]) -> Option<Lesson>;
}

/// A ring of ticks.
#[derive(Debug, Clone)]
pub struct Memory {
    places: Places,
    capacity: usize,
    /// Number of ticks ever stored.
    pub stored: u64,
    /// The oldest tick that is left.
    pub first: u64,
    /// The first tick that still teaches: how each input moves, and then the reward.
    from: Vec<u64>,
    before: Vec<f64>,
    after: Vec<f64>,
    changes: Vec<f64>,
    rewards: Vec<f64>,
    /// `missing`, `upper_end`, `lower_end`, and whether the reward teaches.
    masks: Vec<[u32; 4]>,
    /// The tick of each entry, times 2, and 1 more if a target or an episode began with it or after it.
    stamps: Vec<u64>,
}

/// One tick to store.
#[derive(Debug, Clone, Copy)]
pub struct Entry<'a> {
    /// `q` of the tick.
    pub before: &'a [f64],
    /// The believed inputs and changes of the next tick, with the command of this one.
    pub after: &'a [f64],
    /// The change of each input to the next tick.
    pub changes: &'a [f64],
    /// The reward.
    pub reward: f64,
    /// What the changes teach.
    pub lesson: Lesson,
    /// The tick.
    pub tick: u64,
    /// Whether a target or an episode begins with this tick or after it.
    pub boundary: bool,
}

impl Memory {
    /// Room for `capacity` ticks.
    pub fn new(places: Places, capacity: usize) -> Self {
        Self {
            places,
            capacity,
            stored: 0,
            first: 0,
            from: vec![0; places.inputs + 1],
            before: vec![0.0; capacity * places.len()],
            after: vec![0.0; capacity * places.len()],
            changes: vec![0.0; capacity * places.inputs],
            rewards: vec![0.0; capacity],
            masks: vec![[0; 4]; capacity],
            stamps: vec![0; capacity],
        }
    }

    /// Stores a tick in place of the oldest. Its reward teaches nothing until [`set_rewarded`](Self::set_rewarded).
    pub fn push(&mut self, entry: &Entry) {
        let at = (self.stored % self.capacity as u64) as usize;
        let (width, n) = (self.places.len(), self.places.inputs);
        self.before[at * width..][..width].copy_from_slice(entry.before);
        self.after[at * width..][..width].copy_from_slice(entry.after);
        self.changes[at * n..][..n].copy_from_slice(entry.changes);
        self.rewards[at] = entry.reward;
        let Lesson { missing, upper_end, lower_end, .. } = entry.lesson;
        self.masks[at] = [missing, upper_end, lower_end, 0];
        self.stamps[at] = 2 * entry.tick + u64::from(entry.boundary);
        self.stored += 1;
        self.first = self.first.max(self.stored.saturating_sub(self.capacity as u64));
    }

    /// The first tick that still teaches how an input moves; or the reward, whose number is that of the inputs.
    pub fn from(&self, part: usize) -> u64 {
        self.from[part].max(self.first)
    }

    /// The first reward that still teaches.
    pub fn rewards_from(&self) -> u64 {
        self.from(self.places.inputs)
    }

    /// What came before `tick` no longer teaches that part.
    pub fn forget(&mut self, part: usize, tick: u64) {
        self.from[part] = tick;
    }

    /// The reward of `tick` no longer teaches, or does so after all.
    pub fn set_rewarded(&mut self, tick: u64, rewarded: bool) {
        self.masks[(tick % self.capacity as u64) as usize][3] = u32::from(rewarded);
    }

    /// Whether some input after `tick` was not believed, though nothing began there: what is stored of it is what was
    /// predicted.
    pub fn is_doubted(&self, tick: u64) -> bool {
        let at = (tick % self.capacity as u64) as usize;
        self.masks[at][0] != 0 && self.stamps[at].is_multiple_of(2)
    }

    /// Whether `next` is the tick right after a stored one.
    pub fn follows(&self, next: u64, tick: u64) -> bool {
        self.stamps[(tick % self.capacity as u64) as usize] / 2 + 1 == next
    }

    /// The change of `input` in `tick` is believed after all. Returns it.
    pub fn believe(&mut self, tick: u64, input: usize, wraps: bool) -> f64 {
        let (width, n) = (self.places.len(), self.places.inputs);
        let at = (tick % self.capacity as u64) as usize;
        let change = self.changes[at * n + input];
        let z = self.before[at * width + input] + CHANGE * change;
        let after = &mut self.after[at * width..][..width];
        after[input] = if wraps { wrap(z) } else { z };
        after[n + input] = change;
        self.masks[at][0] &= !(1 << input);
        change
    }

    /// What was stored of `input` is seen anew by `at_ends`, which tells whether a value is at the lower and the upper
    /// end: an end was found. The changes that led there were no outliers.
    pub fn mark_ends(&mut self, input: usize, wraps: bool, at_ends: impl Fn(f64) -> [bool; 2]) {
        let (width, n) = (self.places.len(), self.places.inputs);
        for tick in self.first..self.stored {
            let at = (tick % self.capacity as u64) as usize;
            let z = self.before[at * width + input] + CHANGE * self.changes[at * n + input];
            let [lower, upper] = at_ends(if wraps { wrap(z) } else { z });
            let begins = !self.stamps[at].is_multiple_of(2);
            if (lower || upper) && !begins {
                self.believe(tick, input, wraps);
                self.masks[at][if upper { 1 } else { 2 }] |= 1 << input;
            }
        }
    }

    /// Whether an input was at an end of its range after a stored tick or the one before.
    pub fn contact(&self, tick: u64) -> bool {
        let ends = |tick: u64| {
            let [_, upper, lower, _] = self.masks[(tick % self.capacity as u64) as usize];
            upper | lower != 0
        };
        ends(tick) || (tick > self.first && ends(tick - 1))
    }

    /// The reward that came with a stored tick.
    pub fn reward(&self, tick: u64) -> f64 {
        self.rewards[(tick % self.capacity as u64) as usize]
    }

    /// Whether the reward that came with a stored tick teaches.
    pub fn is_rewarded(&self, tick: u64) -> bool {
        self.masks[(tick % self.capacity as u64) as usize][3] != 0
    }

    /// Whether a target or an episode began within `reach` ticks of a stored one.
    pub fn near_boundary(&self, tick: u64, reach: u64) -> bool {
        let stamp = |tick: u64| self.stamps[(tick % self.capacity as u64) as usize];
        (tick.saturating_sub(reach).max(self.first)..(tick + reach + 1).min(self.stored))
            .any(|other| stamp(other) % 2 == 1 && (stamp(other) / 2).abs_diff(stamp(tick) / 2) <= reach)
    }

    /// The point to which the reward that came with `tick` belongs, if rewards come `shift` ticks late: inputs before
    /// it, or after it, and the command of the tick.
    pub fn rewarded_point(&self, tick: u64, shift: u64, after: bool) -> Option<&[f64]> {
        let at = tick.checked_sub(shift).filter(|at| *at >= self.first)?;
        let stamp = |tick: u64| self.stamps[(tick % self.capacity as u64) as usize] / 2;
        if stamp(tick) - stamp(at) != shift {
            return None;
        }
        let at = (at % self.capacity as u64) as usize * self.places.len();
        Some(&(if after { &self.after } else { &self.before })[at..at + self.places.len()])
    }

    /// `q` of a stored tick.
    pub fn q(&self, tick: u64) -> &[f64] {
        let at = (tick % self.capacity as u64) as usize * self.places.len();
        &self.before[at..at + self.places.len()]
    }
}

/// The memory as data of an input's model of movement. What was limited by the end of a range teaches nothing.
#[derive(Debug, Clone, Copy)]
pub struct ChangeData<'a> {
    /// The memory.
    pub memory: &'a Memory,
    /// The input.
    pub input: usize,
}

impl Data for ChangeData<'_> {
    fn range(&self) -> (u64, u64) {
        (self.memory.from(self.input), self.memory.stored)
    }

    fn get(&self, tick: u64, q: &mut [f64], y: &mut [f64]) -> Option<Lesson> {
        let Self { memory, input } = *self;
        let at = (tick % memory.capacity as u64) as usize;
        let [missing, upper_end, lower_end, _] = memory.masks[at];
        if (missing | upper_end | lower_end) & (1 << input) != 0 {
            return None;
        }
        q.copy_from_slice(memory.q(tick));
        y[0] = memory.changes[at * memory.places.inputs + input];
        Some(Lesson { contact: memory.contact(tick), ..Lesson::default() })
    }
}

/// The memory as data of an input that follows from others: what they were together after a tick.
#[derive(Debug, Clone, Copy)]
pub struct DependentData<'a> {
    /// The memory.
    pub memory: &'a Memory,
    /// The input.
    pub input: usize,
}

impl Data for DependentData<'_> {
    fn range(&self) -> (u64, u64) {
        (self.memory.from(self.input), self.memory.stored)
    }

    fn get(&self, tick: u64, q: &mut [f64], y: &mut [f64]) -> Option<Lesson> {
        let Self { memory, input } = *self;
        let at = (tick % memory.capacity as u64) as usize;
        if memory.masks[at][0] != 0 {
            return None;
        }
        let width = memory.places.len();
        q.copy_from_slice(&memory.after[at * width..][..width]);
        y[0] = q[input];
        Some(Lesson::default())
    }
}

/// The memory as data of a reward model.
#[derive(Debug, Clone, Copy)]
pub struct RewardData<'a> {
    /// The memory.
    pub memory: &'a Memory,
    /// Whether the reward depends on the inputs after the tick.
    pub after: bool,
    /// So many ticks late it comes.
    pub shift: u64,
}

impl Data for RewardData<'_> {
    fn range(&self) -> (u64, u64) {
        (self.memory.rewards_from(), self.memory.stored)
    }

    fn get(&self, tick: u64, q: &mut [f64], y: &mut [f64]) -> Option<Lesson> {
        let memory = self.memory;
        let at = (tick % memory.capacity as u64) as usize;
        if memory.masks[at][3] == 0 {
            return None;
        }
        q.copy_from_slice(memory.rewarded_point(tick, self.shift, self.after)?);
        y[0] = memory.rewards[at];
        Some(Lesson::default())
    }
}

impl Persist for Memory {
    fn visit_state(&mut self, visitor: &mut dyn StateVisitor) {
        visitor.number("stored", &mut self.stored);
        visitor.number("first", &mut self.first);
        visitor.numbers("from", &mut self.from);
        visitor.numbers("before", &mut self.before);
        visitor.numbers("after", &mut self.after);
        visitor.numbers("changes", &mut self.changes);
        visitor.numbers("rewards", &mut self.rewards);
        visitor.numbers("masks", &mut self.masks);
        visitor.numbers("stamps", &mut self.stamps);
    }
}
