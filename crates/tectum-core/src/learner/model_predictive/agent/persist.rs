//! The state of the learner.

use super::{GuardCounts, ModelPredictive};
use crate::state::{Persist, StateVisitor};

impl Persist for ModelPredictive {
    fn visit_state(&mut self, visitor: &mut dyn StateVisitor) {
        visitor.nested("dynamics", &mut self.dynamics);
        let mut bits = self.reading.bits();
        visitor.number("reading", &mut bits);
        self.reading = self.alignment.reading_of(bits);
        let (alignment, reading) = (&self.alignment, self.reading);
        self.rewards.iter_mut().for_each(|model| alignment.read(&mut model.layout, reading));
        let [before, after] = &mut self.rewards;
        visitor.nested("reward_before", before);
        visitor.nested("reward_after", after);
        visitor.numbers("scores", &mut self.scores);
        visitor.nested("memory", &mut self.memory);
        visitor.nested("ends", &mut self.ends);
        self.ends.tell_all(&mut self.ranges);
        self.dynamics.set_ends(&self.ranges);
        for belief in &mut self.beliefs {
            belief.visit(visitor);
        }
        self.reward_belief.visit(visitor);
        visitor.nested("plan", &mut self.plan);
        visitor.nested("noise", &mut self.noise);
        visitor.nested("rng", &mut self.rng);
        visitor.number("tick", &mut self.tick);
        visitor.numbers("state", &mut self.state);
        visitor.numbers("before", &mut self.before);
        visitor.numbers("command", &mut self.command);
        visitor.numbers("mean", &mut self.mean);
        let mut numbers = [self.reward, self.last_reward, self.best, self.worst];
        visitor.numbers("rewards", &mut numbers);
        [self.reward, self.last_reward, self.best, self.worst] = numbers;
        let mut numbers = [self.began, self.judged, self.learned_rewards, self.shift];
        visitor.numbers("reward_ticks", &mut numbers);
        [self.began, self.judged, self.learned_rewards, self.shift] = numbers;
        visitor.nested("alignment", &mut self.alignment);
        visitor.number("boundary_rate", &mut self.boundary_rate);
        visitor.number("strange", &mut self.strange);
        visitor.boolean("teaches", &mut self.teaches);
        visitor.boolean("boundary", &mut self.boundary);
        visitor.boolean("planned", &mut self.planned);
        visitor.number("next_refit", &mut self.next_refit);
        visitor.number("refits", &mut self.refits);
        visitor.nested("alarms", &mut self.alarms);
        visitor.number("rival_kind", &mut self.rival_kind);
        visitor.nested("rival_pace", &mut self.rival_pace);
        visitor.nested("saturation", &mut self.saturation);
        visitor.number("operations", &mut self.budget.spent);
        visitor.nested("counts", &mut self.counts);
    }
}

impl Persist for GuardCounts {
    fn visit_state(&mut self, visitor: &mut dyn StateVisitor) {
        visitor.number("input_outliers", &mut self.input_outliers);
        visitor.number("reward_outliers", &mut self.reward_outliers);
        visitor.number("alarms", &mut self.alarms);
        visitor.number("worlds", &mut self.worlds);
        visitor.number("rivals", &mut self.rivals);
        visitor.number("clipped", &mut self.clipped);
        visitor.number("unusable", &mut self.unusable);
        visitor.number("ends", &mut self.ends);
        visitor.number("plans", &mut self.plans);
        visitor.number("saturations", &mut self.saturations);
    }
}
