//! Learning from a tick: which of its values are believed, what they teach the models, and when these are fitted anew.

use super::super::alignment::RewardAssumption;
use super::super::belief::BeliefVerdict;
use super::super::ends::Movement;
use super::super::memory::{Entry, Lesson, RewardData};
use super::super::model::CONTACT;
use super::super::operations::RefitShare;
use super::super::world::CHANGE;
use super::ModelPredictive;
use crate::MAX_INPUTS;

/// A reward is judged so many ticks after it came: by then it is known whether a target or an episode began near it.
const WAIT: u64 = 3;
/// Squared errors from here on, in predictive variances, are strange near a new target or a new start.
const STRANGE: f64 = 9.0;
/// Where fewer of the ticks than this part begin with a new target, all rewards near one are left out.
const RARE: f64 = 0.1;
/// So many strange rewards in a row are left out at most.
const MOST_STRANGE: u32 = 12;
/// Ticks from one refit to the next: the least, the most, and by how much of the ticks so far they grow in between.
const REFIT_LEAST: u64 = 10;
const REFIT_MOST: f64 = 1000.0;
const REFIT_GROWTH: f64 = 0.25;
/// From so many ticks on since the beginning, or since the last alarm, refits take a smaller part of a tick, in inverse
/// proportion; they are far apart by then. It is at least the other part.
const YOUNG: f64 = 1000.0;
const LEAST_PART: f64 = 0.125;
/// After an alarm, every so many ticks it is asked whether older ones still teach.
const LOOK: u64 = 10;

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
        let mut alarmed = 0;
        self.look_for_ends(&changes[..n], &mut lesson);
        lesson.contact |= self.touches() || (self.memory.stored > 0 && self.memory.contact(self.memory.stored - 1));
        let following = self.dynamics.dependents.following;
        for i in (0..n).filter(|i| following >> i & 1 == 0) {
            self.judge_input(i, changes[i], &mut lesson);
        }
        self.dynamics.follow(&self.after);
        for i in (0..n).filter(|i| following >> i & 1 == 1) {
            self.judge_input(i, changes[i], &mut lesson);
        }
        for i in 0..n {
            self.dynamics.moving |= if self.beliefs[i].usual > 1e-9 { 1 << i } else { 0 };
        }
        self.budget.spent += self.dynamics.cost();
        self.budget.spent += self.rewards.iter().map(|model| model.fit.regression.cost()).sum::<u64>();
        self.dynamics.learn(&changes[..n], &self.after, lesson, &mut self.rng);
        for i in 0..n {
            if self.beliefs[i].alarmed(12.0) {
                self.dynamics.doubt(i);
                self.beliefs[i].calm();
                alarmed |= 1 << i;
            }
        }
        if alarmed != 0 {
            self.raise_alarm(alarmed);
        }
        let entry = Entry {
            before: &self.before,
            after: &self.after,
            changes: &changes[..n],
            reward: self.reward,
            lesson,
            tick: self.tick,
            boundary: self.boundary || self.tick <= self.began + 2,
        };
        self.memory.push(&entry);
        self.boundary_rate += 0.02 * (f64::from(u8::from(self.boundary)) - self.boundary_rate);
        if self.judged + WAIT < self.memory.stored {
            let tick = self.judged;
            self.judged += 1;
            if self.memory.reward(tick).is_finite() && self.learn_reward(tick) {
                self.memory.set_rewarded(tick, true);
            }
        }
    }

    /// Takes jumps for what they are, as [`learn`](Self::learn) does, without learning.
    pub(super) fn watch(&mut self) {
        if !self.teaches {
            return;
        }
        let n = self.places.inputs;
        self.dynamics.observe(&self.before);
        self.dynamics.follow(&self.state);
        for i in 0..n {
            let change = self.state[n + i];
            let error = self.ends_of(i).heed(i, self.dynamics.error(i, change));
            if self.beliefs[i].is_wild(self.dynamics.surprise(i, change), error) {
                self.state[n + i] = if self.boundary { 0.0 } else { self.dynamics.predicted(i) };
            }
        }
    }

    /// Whether an input that moves is at an end of its range.
    fn touches(&self) -> bool {
        (0..self.places.inputs).any(|i| self.dynamics.moves(i) && self.ranges.at_ends(i, self.state[i]) != [false; 2])
    }

    /// The ends at which input `i` is.
    fn ends_of(&self, i: usize) -> Lesson {
        let [lower_end, upper_end] = self.ranges.at_ends(i, self.state[i]).map(|at| u32::from(at) << i);
        Lesson { lower_end, upper_end, ..Lesson::default() }
    }

    /// Looks for ends of the inputs in what they did in this tick.
    fn look_for_ends(&mut self, changes: &[f64], lesson: &mut Lesson) {
        for (i, &change) in changes.iter().enumerate() {
            if self.boundary || !self.dynamics.is_fitted(i) {
                continue;
            }
            let movement = Movement {
                from: self.before[i],
                to: self.state[i],
                predicted: CHANGE * self.dynamics.predicted(i),
                surprise: self.dynamics.surprise(i, change),
            };
            let ([lower, upper], changed) = self.ends.take(i, &movement, &mut self.ranges);
            lesson.lower_end |= u32::from(lower) << i;
            lesson.upper_end |= u32::from(upper) << i;
            lesson.contact |= lower || upper;
            if changed {
                let ranges = &self.ranges;
                self.memory.mark_ends(i, ranges.wraps[i], |z| ranges.at_ends(i, z));
                self.dynamics.set_ends(ranges);
                self.counts.ends = self.ends.known();
                self.next_refit = self.tick;
            }
        }
    }

    /// Judges the change of an input: what it teaches, and what is believed of the next tick and of the state.
    fn judge_input(&mut self, i: usize, change: f64, lesson: &mut Lesson) {
        let n = self.places.inputs;
        let bit = 1 << i;
        let Lesson { upper_end, lower_end, .. } = self.ends_of(i);
        lesson.upper_end |= upper_end;
        lesson.lower_end |= lower_end;
        let error = lesson.heed(i, self.dynamics.error(i, change));
        let surprise = if error == 0.0 { 0.0 } else { self.dynamics.surprise(i, change) };
        let surprise = if lesson.contact { surprise / CONTACT } else { surprise };
        let predicted = self.dynamics.predicted(i);
        let outlier = if self.boundary {
            // Neither a jump nor a new start is a movement.
            lesson.missing |= bit;
            self.beliefs[i].is_wild(surprise, error)
        } else {
            match self.beliefs[i].judge(surprise, error, change, 0.1) {
                BeliefVerdict::Believed => false,
                BeliefVerdict::Both => {
                    self.believe_after_all(i);
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

    /// The change of an input in the tick before was no outlier after all: it teaches, and is what came of that tick.
    fn believe_after_all(&mut self, i: usize) {
        let (n, last) = (self.places.inputs, self.memory.stored - 1);
        let change = self.memory.believe(last, i, self.ranges.wraps[i]);
        if self.memory.follows(self.tick, last) {
            self.before[n + i] = change;
        }
    }

    /// Learns the reward that came with a tick of the memory. Returns whether it was believed.
    fn learn_reward(&mut self, tick: u64) -> bool {
        let reward = self.memory.reward(tick);
        if self.learned_rewards == 0 {
            // What comes first may belong to a tick before the run.
            if tick < WAIT {
                return false;
            }
            for model in &mut self.rewards {
                model.fit.center = reward;
            }
        }
        // The point would be the models' own invention.
        if self.memory.is_doubted(tick.saturating_sub(self.shift)) {
            return false;
        }
        let mut surprises = [0.0; 2];
        for (k, model) in self.rewards.iter_mut().enumerate() {
            let Some(point) = self.memory.rewarded_point(tick, self.shift, k == 1) else { return false };
            model.observe(point);
            surprises[k] = model.surprise(0, reward);
        }
        let better = self.better();
        let model = &self.rewards[better];
        let error = model.error(0, reward) * model.fit.scale;
        // A reward near a new target or a new start may belong to the one before, or to one that is not seen yet.
        if self.memory.near_boundary(tick, WAIT) {
            let strange = surprises[better] >= STRANGE && self.strange < MOST_STRANGE;
            self.strange = if strange { self.strange + 1 } else { 0 };
            if strange || self.boundary_rate < RARE {
                return false;
            }
        }
        let change = reward - self.last_reward;
        let verdict = self.reward_belief.judge(surprises[better], error, change, 0.1);
        self.last_reward = reward;
        if verdict == BeliefVerdict::Outlier {
            self.counts.reward_outliers += 1;
            return false;
        }
        if verdict == BeliefVerdict::Both {
            self.memory.set_rewarded(tick - 1, true);
        }
        self.learned_rewards += 1;
        self.best = self.best.max(reward);
        self.worst = self.worst.min(reward);
        let alarm = self.reward_belief.alarmed(14.0);
        for (k, model) in self.rewards.iter_mut().enumerate() {
            let spread = model.nu * model.fit.regression.scale(0) * model.fit.scale * model.fit.scale;
            let score = -0.5 * (surprises[k].min(100.0) + libm::log(spread));
            self.scores[k] += 0.01_f64.max(1.0 / self.learned_rewards as f64) * (score - self.scores[k]);
            model.learn(&[reward], Lesson::default(), &mut self.rng);
            if alarm {
                model.fit.regression.doubt(5.0, 2.0);
            }
        }
        if alarm {
            self.reward_belief.calm();
            self.raise_alarm(1 << self.places.inputs);
        }
        true
    }

    /// The reward model that predicts better: 0 before the tick, 1 after it.
    pub(super) fn better(&self) -> usize {
        usize::from(self.scores[1] > self.scores[0])
    }

    /// Weighs one of the assumptions about rewards. Returns whether all are weighed; where they then are others than
    /// before, the reward models begin anew.
    fn weigh_assumptions(&mut self) -> bool {
        let present = RewardAssumption { shift: self.shift, reading: self.reading };
        let operations = self.refit_operations();
        let weighed = self.alignment.weigh(&self.memory, present, self.config.noise_floor, operations);
        self.budget.spent += self.alignment.spent;
        if let Some(assumed) = weighed.filter(|assumed| *assumed != present) {
            self.shift = assumed.shift;
            self.reading = assumed.reading;
            self.reward_belief.calm();
            self.scores = [0.0; 2];
            let rng = &mut self.rng;
            for model in &mut self.rewards {
                self.alignment.read(&mut model.layout, assumed.reading);
                model.forget(rng);
            }
        }
        weighed.is_some()
    }

    /// Refits of single models that were completed.
    fn refits_completed(&self) -> u64 {
        self.rewards.iter().chain(&self.dynamics.models).map(|model| model.refit.completed).sum()
    }

    /// What refits may take of what is left of the tick.
    fn refit_operations(&self) -> u64 {
        let age = (self.memory.stored - self.alarms.began).max(1) as f64;
        let part = (YOUNG / age).clamp(LEAST_PART, 1.0);
        (part * self.budget.for_refits((self.config.refit_operations * 1e6) as u64) as f64) as u64
    }

    /// Works on refits.
    pub(super) fn refit(&mut self) {
        let busy = self.dynamics.busy() || self.rewards.iter().any(|r| r.refit.busy());
        // Models that have adapted show by themselves that the world is another one; they need not wait for a refit.
        if !busy && self.memory.stored % LOOK == self.alarms.began % LOOK && self.forget_another_world() {
            self.next_refit = self.tick;
        }
        if self.tick >= self.next_refit && !busy {
            if !self.weigh_assumptions() {
                return;
            }
            self.forget_another_world();
            self.dynamics.begin();
            // The reward model that predicts much worse is fitted anew in every third refit only.
            let clear = (self.scores[1] - self.scores[0]).abs() > 0.5;
            for (k, model) in self.rewards.iter_mut().enumerate() {
                if k == usize::from(self.scores[1] > self.scores[0]) || !clear || self.refits.is_multiple_of(3) {
                    model.refit.begin();
                }
            }
            self.refits += 1;
            self.next_refit = self.tick + (REFIT_GROWTH * self.tick as f64).min(REFIT_MOST) as u64 + REFIT_LEAST;
        }
        let mut share = RefitShare { most: self.refit_operations(), done: 0 };
        let (better, completed) = (self.better(), self.refits_completed());
        self.dynamics.work(&self.memory, &mut share, &mut self.rng);
        for k in [better, 1 - better] {
            let data = RewardData { memory: &self.memory, after: k == 1, shift: self.shift };
            self.rewards[k].work(&data, &mut share, &mut self.rng);
        }
        self.budget.spent += share.done;
        if self.refits_completed() != completed {
            self.rival_pace.hurry();
        }
    }
}
