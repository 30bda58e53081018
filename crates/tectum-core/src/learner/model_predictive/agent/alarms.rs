//! Alarms: errors that stay large. They ask whether the world is another one, and what no longer teaches if it is.

use super::super::memory::{ChangeData, Data, RewardData};
use super::super::model::{Model, SAMPLE};
use super::super::operations::of_model;
use super::ModelPredictive;
use crate::state::{Persist, StateVisitor};

/// An alarm so many ticks after the last one begins a question of its own.
const APART: u64 = 100;
/// The question is asked from so many ticks after an alarm on, and until so many.
const ASKED: [u64; 2] = [30, 300];
/// A refit begins no later than so many ticks after an alarm.
const REFIT_WITHIN: u64 = 40;

/// The alarms that one question is about.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Alarms {
    /// The first of them: a number of ticks of the memory; 0 before any.
    pub began: u64,
    /// What was in alarm (bits): the inputs, and after them the reward.
    pub parts: u64,
}

impl Alarms {
    /// An alarm of these parts, when so many ticks were stored.
    fn raise(&mut self, parts: u64, stored: u64) {
        if stored >= self.began + APART {
            *self = Self { began: stored, parts: 0 };
        }
        self.parts |= parts;
    }
}

impl Persist for Alarms {
    fn visit_state(&mut self, visitor: &mut dyn StateVisitor) {
        visitor.number("began", &mut self.began);
        visitor.number("parts", &mut self.parts);
    }
}

impl ModelPredictive {
    /// An alarm of these parts (bits).
    pub(super) fn raise_alarm(&mut self, parts: u64) {
        self.counts.alarms += 1;
        self.alarms.raise(parts, self.memory.stored);
        self.next_refit = self.next_refit.min(self.tick + REFIT_WITHIN);
        self.rival_pace.hurry();
    }

    /// After an alarm: ticks from before it no longer teach how an input moves, or the reward, where the model leaves
    /// them behind (`Accuracy::leaves_behind`). Returns whether it does anywhere.
    pub(super) fn forget_another_world(&mut self) -> bool {
        let (change, end) = (self.alarms.began, self.memory.stored);
        let [from, until] = ASKED.map(|ticks| change + ticks);
        if change == 0 || end < from || end > until {
            return false;
        }
        let (n, better, shift) = (self.places.inputs, self.better(), self.shift);
        let mut changed = false;
        for part in 0..=n {
            let (memory, first) = (&self.memory, self.memory.from(part));
            let moves = ChangeData { memory, input: part };
            let rewards = RewardData { memory, after: better == 1, shift };
            let (model, data): (&mut Model, &dyn Data) = match part {
                _ if part == n => (&mut self.rewards[better], &rewards),
                _ if self.dynamics.moves(part) => (&mut self.dynamics.models[part], &moves),
                _ => continue,
            };
            let [older, newer] =
                [(first, change), (change, end)].map(|(a, b)| model.accuracy(data, a, b, &mut self.after));
            self.budget.spent += 2 * SAMPLE * of_model(model, 0)[0];
            let alarmed = self.alarms.parts >> part & 1 == 1;
            if newer.zip(older).is_some_and(|(newer, older)| newer.leaves_behind(&older, alarmed)) {
                self.memory.forget(part, change);
                changed = true;
            }
        }
        self.counts.worlds += u64::from(changed);
        changed
    }
}
