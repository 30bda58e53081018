//! The ticks that were seen: what the models are fitted to anew.

use super::layout::Places;
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
    /// The first tick that still counts.
    pub first: u64,
    before: Vec<f64>,
    after: Vec<f64>,
    changes: Vec<f64>,
    rewards: Vec<f64>,
    /// `missing`, `upper_end`, `lower_end`, and whether the reward teaches.
    masks: Vec<[u32; 4]>,
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
    /// Whether the reward teaches.
    pub rewarded: bool,
}

impl Memory {
    /// Room for `capacity` ticks.
    pub fn new(places: Places, capacity: usize) -> Self {
        Self {
            places,
            capacity,
            stored: 0,
            first: 0,
            before: vec![0.0; capacity * places.len()],
            after: vec![0.0; capacity * places.len()],
            changes: vec![0.0; capacity * places.inputs],
            rewards: vec![0.0; capacity],
            masks: vec![[0; 4]; capacity],
        }
    }

    /// Stores a tick in place of the oldest.
    pub fn push(&mut self, entry: &Entry) {
        let at = (self.stored % self.capacity as u64) as usize;
        let (width, n) = (self.places.len(), self.places.inputs);
        self.before[at * width..][..width].copy_from_slice(entry.before);
        self.after[at * width..][..width].copy_from_slice(entry.after);
        self.changes[at * n..][..n].copy_from_slice(entry.changes);
        self.rewards[at] = entry.reward;
        let Lesson { missing, upper_end, lower_end } = entry.lesson;
        self.masks[at] = [missing, upper_end, lower_end, u32::from(entry.rewarded)];
        self.stored += 1;
        self.first = self.first.max(self.stored.saturating_sub(self.capacity as u64));
    }

    /// The reward of `tick` no longer teaches, or does so after all.
    pub fn set_rewarded(&mut self, tick: u64, rewarded: bool) {
        self.masks[(tick % self.capacity as u64) as usize][3] = u32::from(rewarded);
    }

    /// Which outputs of `tick` teach nothing.
    pub fn missing(&mut self, tick: u64) -> &mut u32 {
        &mut self.masks[(tick % self.capacity as u64) as usize][0]
    }

    /// `q` of a stored tick.
    pub fn q(&self, tick: u64) -> &[f64] {
        let at = (tick % self.capacity as u64) as usize * self.places.len();
        &self.before[at..at + self.places.len()]
    }
}

/// The memory as data of the dynamics model.
#[derive(Debug, Clone, Copy)]
pub struct ChangeData<'a>(pub &'a Memory);

impl Data for ChangeData<'_> {
    fn range(&self) -> (u64, u64) {
        (self.0.first, self.0.stored)
    }

    fn get(&self, tick: u64, q: &mut [f64], y: &mut [f64]) -> Option<Lesson> {
        let memory = self.0;
        let at = (tick % memory.capacity as u64) as usize;
        q.copy_from_slice(memory.q(tick));
        y.copy_from_slice(&memory.changes[at * memory.places.inputs..][..memory.places.inputs]);
        let [missing, upper_end, lower_end, _] = memory.masks[at];
        let all = u32::MAX >> (32 - memory.places.inputs);
        (missing != all).then_some(Lesson { missing, upper_end, lower_end })
    }
}

/// The memory as data of a reward model.
#[derive(Debug, Clone, Copy)]
pub struct RewardData<'a> {
    /// The memory.
    pub memory: &'a Memory,
    /// Whether the reward depends on the inputs after the tick.
    pub after: bool,
}

impl Data for RewardData<'_> {
    fn range(&self) -> (u64, u64) {
        (self.memory.first, self.memory.stored)
    }

    fn get(&self, tick: u64, q: &mut [f64], y: &mut [f64]) -> Option<Lesson> {
        let memory = self.memory;
        let at = (tick % memory.capacity as u64) as usize;
        let from = if self.after { &memory.after } else { &memory.before };
        q.copy_from_slice(&from[at * memory.places.len()..][..memory.places.len()]);
        y[0] = memory.rewards[at];
        (memory.masks[at][3] != 0).then_some(Lesson::default())
    }
}

impl Persist for Memory {
    fn visit_state(&mut self, visitor: &mut dyn StateVisitor) {
        visitor.number("stored", &mut self.stored);
        visitor.number("first", &mut self.first);
        visitor.numbers("before", &mut self.before);
        visitor.numbers("after", &mut self.after);
        visitor.numbers("changes", &mut self.changes);
        visitor.numbers("rewards", &mut self.rewards);
        visitor.numbers("masks", &mut self.masks);
    }
}
