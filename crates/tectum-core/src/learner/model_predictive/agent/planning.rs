//! The plan of the next tick: the old one, some steps better, or a rival.

use super::super::operations::{OperationBudget, StepCost};
use super::super::planner::{CommandPlan, FIRST_MU, Planner};
use super::super::rivals;
use super::super::world::{LearnedWorld, World as _};
use super::ModelPredictive;
use super::rival_pace::Promise;

/// Standard deviations by which a predicted reward counts less while learning: what a posture promises wrongly is found
/// out there.
const CAUTION: f64 = 1.0;
/// The same without learning, where a wrong promise would hold for good.
const CAUTION_AT_REST: f64 = 3.0;

/// Where a plan begins.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum PlanStart {
    /// In the state after the command that has just gone out, with the commands of the plan before.
    Commanded,
    /// In the state that was observed, which no plan has foreseen, with commands of 0.
    Observed,
}

impl ModelPredictive {
    /// Makes the plan for the state after the command that has just gone out.
    pub(super) fn make_plan(&mut self) {
        if self.boundary {
            self.rival_pace.hurry();
        }
        self.plan_from(PlanStart::Commanded, [1, self.config.iterations]);
        self.planned = true;
        self.counts.plans += 1;
    }

    /// Makes another plan, for the state that was observed, before its command goes out.
    pub(super) fn make_plan_anew(&mut self) {
        self.rival_pace.hurry();
        let most = self.budget.most;
        self.budget.most = self.budget.before_command();
        self.plan_from(PlanStart::Observed, [1, self.config.rival_iterations]);
        self.budget.most = most;
    }

    /// Has the models ready to be planned through. Returns the best and the worst reward that was seen, in the reward
    /// model's units.
    fn prepare(&mut self) -> [f64; 2] {
        self.find_active();
        let sampled = if self.frozen { 0.0 } else { self.config.sampled };
        self.dynamics.take(sampled);
        let better = self.better();
        let reward = &mut self.rewards[better];
        reward.take(sampled);
        let active = (self.scratch.active.len(), self.scratch.moving);
        self.budget.cost = StepCost::of(self.places, &self.dynamics, reward, active);
        [self.best, self.worst].map(|extreme| (extreme - reward.fit.center) / reward.fit.scale)
    }

    /// Makes a plan, with so many iterations at least and so many at most, and lets a rival compete with it.
    fn plan_from(&mut self, from: PlanStart, iterations: [usize; 2]) {
        let (nx, m) = (self.places.state(), self.places.commands);
        let [best, worst] = self.prepare();
        let (better, moving) = (self.better(), self.dynamics.moving);
        let mut world = LearnedWorld {
            places: self.places,
            dynamics: &mut self.dynamics,
            reward: &mut self.rewards[better],
            after: better == 1,
            best,
            caution: if self.frozen { CAUTION_AT_REST } else { CAUTION },
            idle: 0,
            ranges: &self.ranges,
            scratch: &mut self.scratch,
        };
        self.after[..nx].copy_from_slice(&self.state);
        match from {
            PlanStart::Commanded => {
                self.after[nx..].copy_from_slice(&self.command[..m]);
                world.step(&self.after, &mut self.start);
                self.plan.shift();
            }
            PlanStart::Observed => {
                self.after[nx..].fill(0.0);
                self.start.copy_from_slice(&self.state);
                self.plan.commands.fill(0.0);
            }
        }
        world.find_idle(&self.after);
        // A plan that cannot become better has raised this: its gains would vanish, and with them the answer to what
        // was not foreseen.
        self.plan.mu = self.plan.mu.min(FIRST_MU);
        self.budget.spent += self.budget.cost.first();
        // The first iteration is always made: it has the gains, with which the next observation is answered.
        work_on((&mut self.planner, &mut self.budget), &mut world, (&mut self.plan, &self.start), iterations);
        let horizon = self.plan.horizon as f64;
        let promise = |plan: &CommandPlan| Promise { value: plan.value, best: best * horizon, worst: worst * horizon };
        if !self.rival_pace.is_due(promise(&self.plan)) || !self.budget.has_iteration(self.plan.horizon) {
            return;
        }
        self.rival_kind = (self.rival_kind + 1) % rivals::KINDS;
        let known = (&self.memory, moving);
        self.budget.spent += rivals::cost(self.rival_kind, &self.budget.cost, self.plan.horizon);
        rivals::draw(self.rival_kind, &mut self.rng, &mut world, known, &self.plan, &mut self.rival);
        let iterations = [0, self.config.rival_iterations];
        work_on((&mut self.planner, &mut self.budget), &mut world, (&mut self.rival, &self.start), iterations);
        let adopted = self.rival.value > self.plan.value + self.config.rival_gain * promise(&self.plan).gap() + 1e-9;
        self.rival_pace.tried(adopted);
        if adopted {
            self.counts.rivals += 1;
            self.plan.copy_from(&self.rival);
        }
    }

    /// The places over which the reward's Hessian is taken: inputs that move, their changes, and the commands; then the
    /// inputs that do not move, as targets: the gains need them for the answer to one that jumps.
    fn find_active(&mut self) {
        let (n, m) = (self.places.inputs, self.places.commands);
        self.scratch.active.clear();
        for i in (0..n).filter(|&i| self.dynamics.moves(i)) {
            self.scratch.active.extend([i, n + i]);
        }
        self.scratch.active.sort_unstable();
        self.scratch.active.extend((0..m).map(|j| self.places.command(j, 0)));
        self.scratch.moving = self.scratch.active.len();
        self.scratch.active.extend((0..n).filter(|&i| !self.dynamics.moves(i)));
    }
}

/// Improves a plan from `start`: so many iterations at least, and up to so many as far as the budget goes.
fn work_on(
    (planner, budget): (&mut Planner, &mut OperationBudget),
    world: &mut LearnedWorld,
    (plan, start): (&mut CommandPlan, &[f64]),
    [least, most]: [usize; 2],
) {
    let mut began = planner.work;
    planner.roll_out(world, plan, start);
    for iteration in 0..most {
        budget.spend_work(began, planner.work);
        began = planner.work;
        if iteration >= least && !budget.has_iteration(plan.horizon) {
            break;
        }
        if !planner.improve(world, plan) {
            break;
        }
    }
    budget.spend_work(began, planner.work);
}
