//! Learning from a tick: which of its values are believed, what they teach the models, and when these are fitted anew.

use super::super::belief::{Belief, BeliefVerdict};
use super::super::memory::{ChangeData, Data, Entry, Lesson, RewardData};
use super::super::model::Model;
use super::super::world::CHANGE;
use super::ModelPredictive;
use crate::MAX_INPUTS;

impl ModelPredictive {
    /// Learns from the last tick.
    pub(super) fn learn(&mut self) {
        let n = self.places.inputs;
        let mut changes = [0.0; MAX_INPUTS];
        changes[..n].copy_from_slice(&self.state[n..2 * n]);
        self.dynamics.observe(&self.before);
        let mut lesson = Lesson::default();
        self.after.copy_from_slice(&self.before);
        self.after[..2 * n].copy_from_slice(&self.state[..2 * n]);
        let mut alarm = false;
        for i in 0..n {
            self.judge_input(i, changes[i], &mut lesson);
            alarm |= self.beliefs[i].alarmed(12.0);
        }
        if self.frozen {
            return;
        }
        self.budget.spent += self.dynamics.fit.regression.cost();
        self.budget.spent += self.rewards.iter().map(|model| model.fit.regression.cost()).sum::<u64>();
        self.dynamics.learn(&changes[..n], lesson, &mut self.rng);
        if alarm {
            self.dynamics.fit.regression.doubt(10.0, 3.0);
            self.beliefs.iter_mut().for_each(Belief::calm);
            self.alarm();
        }
        let rewarded = self.reward.is_finite() && self.learn_reward();
        let entry = Entry {
            before: &self.before,
            after: &self.after,
            changes: &changes[..n],
            reward: if self.reward.is_finite() { self.reward } else { 0.0 },
            lesson,
            rewarded,
        };
        self.memory.push(&entry);
    }

    /// Judges the change of an input: what it teaches, and what is believed of the next tick and of the state.
    fn judge_input(&mut self, i: usize, change: f64, lesson: &mut Lesson) {
        let n = self.places.inputs;
        let bit = 1 << i;
        let z = self.state[i];
        if !self.ranges.wraps[i] {
            lesson.upper_end |= if z >= self.ranges.high[i] - 1e-6 { bit } else { 0 };
            lesson.lower_end |= if z <= self.ranges.low[i] + 1e-6 { bit } else { 0 };
        }
        let error = lesson.heed(i, self.dynamics.error(i, change));
        let surprise = if error == 0.0 { 0.0 } else { self.dynamics.surprise(i, change) };
        let predicted = self.dynamics.predicted[i];
        let outlier = if self.boundary {
            // Neither a jump nor a new start is a movement.
            lesson.missing |= bit;
            self.beliefs[i].is_wild(surprise, error)
        } else {
            match self.beliefs[i].judge(surprise, error, change, 0.2) {
                BeliefVerdict::Believed => false,
                BeliefVerdict::Both if self.frozen => false,
                BeliefVerdict::Both => {
                    *self.memory.missing(self.memory.stored - 1) &= !bit;
                    false
                }
                BeliefVerdict::Outlier => {
                    lesson.missing |= bit;
                    self.counts.input_outliers += 1;
                    true
                }
            }
        };
        if outlier {
            // What the input would be without the jump, which is not a movement that goes on.
            self.after[n + i] = predicted;
            self.after[i] = self.ranges.bring_in(i, self.before[i] + CHANGE * predicted);
            self.state[n + i] = if self.boundary { 0.0 } else { predicted };
        }
    }

    fn alarm(&mut self) {
        self.counts.alarms += 1;
        if self.memory.stored >= self.changed_at + 100 {
            self.changed_at = self.memory.stored;
        }
        self.next_refit = self.next_refit.min(self.tick + 40);
    }

    /// Learns the reward of the last tick. Returns whether it was believed.
    fn learn_reward(&mut self) -> bool {
        let reward = self.reward;
        if self.memory.stored == 0 {
            for model in &mut self.rewards {
                model.fit.center = reward;
            }
        }
        let mut surprises = [0.0; 2];
        for (k, model) in self.rewards.iter_mut().enumerate() {
            model.observe(if k == 0 { &self.before } else { &self.after });
            surprises[k] = model.surprise(0, reward);
        }
        let better = self.better();
        let model = &self.rewards[better];
        let error = model.error(0, reward) * model.fit.scale;
        let change = reward - self.last_reward;
        let verdict = self.reward_belief.judge(surprises[better], error, change, 0.1);
        if verdict == BeliefVerdict::Outlier {
            self.counts.reward_outliers += 1;
            return false;
        }
        if verdict == BeliefVerdict::Both {
            self.memory.set_rewarded(self.memory.stored - 1, true);
        }
        self.best = self.best.max(reward);
        self.worst = self.worst.min(reward);
        let alarm = self.reward_belief.alarmed(14.0);
        for (k, model) in self.rewards.iter_mut().enumerate() {
            let spread = model.nu * model.fit.regression.scale(0) * model.fit.scale * model.fit.scale;
            let score = -0.5 * (surprises[k].min(100.0) + libm::log(spread));
            self.scores[k] += 0.01_f64.max(1.0 / (self.tick as f64)) * (score - self.scores[k]);
            model.learn(&[reward], Lesson::default(), &mut self.rng);
            if alarm {
                model.fit.regression.doubt(5.0, 2.0);
            }
        }
        if alarm {
            self.reward_belief.calm();
            self.alarm();
        }
        true
    }

    /// The reward model that predicts better: 0 before the tick, 1 after it.
    pub(super) fn better(&self) -> usize {
        usize::from(self.scores[1] > self.scores[0])
    }

    /// Works on refits.
    pub(super) fn refit(&mut self) {
        if self.tick >= self.next_refit && !self.dynamics.refit.busy() && !self.rewards.iter().any(|r| r.refit.busy()) {
            self.forget_another_world();
            self.dynamics.refit.begin();
            // The reward model that predicts much worse is fitted anew in every third refit only.
            let clear = (self.scores[1] - self.scores[0]).abs() > 0.5;
            for (k, model) in self.rewards.iter_mut().enumerate() {
                if k == usize::from(self.scores[1] > self.scores[0]) || !clear || self.refits.is_multiple_of(3) {
                    model.refit.begin();
                }
            }
            self.refits += 1;
            self.next_refit = self.tick + (0.35 * self.tick as f64).min(1000.0) as u64 + 5;
        }
        let mut left = self.budget.for_refits((self.config.refit_operations * 1e6) as u64);
        let better = self.better();
        let (used, _) = self.dynamics.work(&ChangeData(&self.memory), left, &mut self.rng);
        self.budget.spent += used;
        left = left.saturating_sub(used);
        for k in [better, 1 - better] {
            let data = RewardData { memory: &self.memory, after: k == 1 };
            let (used, _) = self.rewards[k].work(&data, left, &mut self.rng);
            self.budget.spent += used;
            left = left.saturating_sub(used);
        }
    }

    /// After an alarm: ticks from before it are left out from now on, if the models have adapted to those since the
    /// alarm, and now leave much of the older ones unexplained.
    fn forget_another_world(&mut self) {
        let (first, change, end) = (self.memory.first, self.changed_at, self.memory.stored);
        if change <= first || end < change + 30 || end > change + 300 {
            return;
        }
        let better = self.better();
        let memory = &self.memory;
        let rewards = RewardData { memory, after: better == 1 };
        let q = &mut self.after;
        let mut another = |model: &mut Model, data: &dyn Data| {
            let new = model.unexplained(data, change, end, q).unwrap_or(1.0);
            let old = model.unexplained(data, first, change, q).unwrap_or(0.0);
            new < 0.1 && old > 0.3
        };
        if another(&mut self.dynamics, &ChangeData(memory)) | another(&mut self.rewards[better], &rewards) {
            self.memory.first = change;
            self.counts.worlds += 1;
        }
    }
}
