//! The plan of the next tick: the old one, some steps better, or a rival.

use super::super::rivals;
use super::super::world::{LearnedWorld, World as _};
use super::ModelPredictive;

/// Standard deviations by which a predicted reward counts less while learning: what a posture promises wrongly is found
/// out there.
const CAUTION: f64 = 1.0;
/// The same without learning, where a wrong promise would hold for good.
const CAUTION_AT_REST: f64 = 3.0;

impl ModelPredictive {
    /// Makes the plan for the state after the command that has just gone out.
    pub(super) fn make_plan(&mut self) {
        let (n, nx, m) = (self.places.inputs, self.places.state(), self.places.commands);
        let better = self.better();
        let sampled = if self.resting { 0.0 } else { self.config.sampled };
        self.dynamics.take(sampled);
        let reward = &mut self.rewards[better];
        reward.take(sampled);
        self.scratch.active.clear();
        let moving = self.dynamics.moving;
        for i in (0..n).filter(|i| moving & (1 << i) != 0) {
            self.scratch.active.extend([i, n + i]);
        }
        self.scratch.active.sort_unstable();
        self.scratch.active.extend((0..m).map(|j| self.places.command(j, 0)));
        let best = (self.best - reward.fit.center) / reward.fit.scale;
        let aim = (self.best - reward.fit.center) / reward.fit.scale * self.plan.horizon as f64;
        let mut world = LearnedWorld {
            places: self.places,
            dynamics: &mut self.dynamics,
            reward,
            after: better == 1,
            best,
            caution: if self.resting { CAUTION_AT_REST } else { CAUTION },
            ranges: &self.ranges,
            scratch: &mut self.scratch,
        };
        // The state after the command that has just gone out.
        self.after[..nx].copy_from_slice(&self.state);
        self.after[nx..].copy_from_slice(&self.command[..m]);
        world.step(&self.after, &mut self.start);
        self.plan.shift();
        self.planner.roll_out(&mut world, &mut self.plan, &self.start);
        for _ in 0..self.config.iterations {
            self.planner.improve(&mut world, &mut self.plan);
        }
        for _ in 0..self.rivals {
            self.rival_kind = (self.rival_kind + 1) % rivals::KINDS;
            rivals::draw(
                self.rival_kind,
                &mut self.rng,
                &mut world,
                (&self.memory, moving),
                &self.plan,
                &mut self.rival,
            );
            self.planner.roll_out(&mut world, &mut self.rival, &self.start);
            for _ in 0..self.config.rival_iterations {
                self.planner.improve(&mut world, &mut self.rival);
            }
            let gap = (aim - self.plan.value).max(0.0);
            if self.rival.value > self.plan.value + self.config.rival_gain * gap + 1e-9 {
                self.counts.rivals += 1;
                self.plan.copy_from(&self.rival);
            }
        }
        self.planned = true;
    }
}
