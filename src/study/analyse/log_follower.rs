//! The movements that the policy would have made without exploration noise.
//!
//! Noise of the paper's size moves the end-effector by a tenth of a metre per tick, so speeds that include it
//! say little about the policy. A log holds everything that plant and controller received, so both can be run
//! again along it: the plant advances with the applied commands, and the controller learns from the
//! observations. Their output must equal the log to the last bit. When a target appears, a copy of the plant,
//! in the same posture, is moved towards it with the mean of the current policy (or by the plans of an agent that
//! plans), through the gate, until the next target.

use super::cutter::MovementCutter;
use super::movement::RecordedMovement;
use crate::plant::{Plant as _, SimulatedPlant};
use crate::reference::{FrozenAgent, Rollout};
use crate::runtime::Controller;
use crate::scenario::Plan;
use crate::wire::{Command, MAX_INPUTS, Observation, flag};

/// Plant and controller of a run, run again along its log.
#[derive(Debug, Clone)]
pub(super) struct LogFollower {
    plan: Plan,
    plant: SimulatedPlant,
    controller: Controller,
    /// The observation that the next command answers.
    unanswered: Option<Observation>,
    last: Option<u64>,
    answer: Command,
    /// The first tick in which the log differs.
    lost_at: Option<u64>,
}

impl LogFollower {
    /// The beginning of a run of `plan`; `None` if its plant is not simulated, or its controller is another
    /// program.
    pub fn new(plan: &Plan) -> Option<Self> {
        if !plan.scenario.controller.is_shipped() {
            return None;
        }
        Some(Self {
            plant: plan.simulated_plant()?,
            controller: Controller::new(plan),
            plan: plan.clone(),
            unanswered: None,
            last: None,
            answer: Command::default(),
            lost_at: None,
        })
    }

    /// The first tick in which the log differs from what this build computes; `None` while it does not.
    pub fn lost_at(&self) -> Option<u64> {
        self.lost_at
    }

    /// Advances the plant through the tick before `observation`, and compares what it senses.
    pub fn observe(&mut self, observation: &Observation) {
        if self.lost_at.is_some() {
            return;
        }
        let tick = observation.header.tick;
        let consecutive = self.last.map_or(0, |last| last + 1) == tick;
        if !consecutive {
            self.lost_at = Some(tick);
            return;
        }
        if tick > 0 {
            self.plant.advance(tick - 1, &observation.applied[..self.plan.outputs.len()]);
        }
        let mut inputs = [0.0; MAX_INPUTS];
        let fresh = self.plant.sense(tick, &mut inputs);
        let same = inputs.map(f32::to_bits) == observation.inputs.map(f32::to_bits);
        if same && fresh == (observation.header.flags & flag::NEW_TARGET != 0) {
            self.last = Some(tick);
            self.unanswered = Some(*observation);
        } else {
            self.lost_at = Some(tick);
        }
    }

    /// Runs the controller's tick of `command`, and compares its answer. Gives the noiseless movement if a
    /// target appeared in this tick. `cutter` knows the places of the measures.
    pub fn command(&mut self, command: &Command, cutter: &MovementCutter) -> Option<(u64, RecordedMovement)> {
        let tick = command.header.tick;
        if self.lost_at.is_some() {
            return None;
        }
        let Some(observation) = self.unanswered.take().filter(|observation| observation.header.tick == tick) else {
            self.lost_at = Some(tick);
            return None;
        };
        self.controller.respond(&observation, &mut self.answer);
        if self.answer.drawn.map(f32::to_bits) != command.drawn.map(f32::to_bits) {
            self.lost_at = Some(tick);
            return None;
        }
        let fresh = observation.header.flags & flag::NEW_TARGET != 0;
        let movement = fresh.then(|| (tick, self.noiseless_movement(&observation, cutter)));
        self.controller.after_command(&observation);
        movement
    }

    /// The movement to the target of `observation` by what the agent knows now.
    fn noiseless_movement(&mut self, observation: &Observation, cutter: &MovementCutter) -> RecordedMovement {
        let mut rollout = Rollout::sensed(self.plant.clone(), &self.plan, observation.inputs);
        let mut agent = FrozenAgent::of(self.controller.agent(), &self.plan);
        let mut tick = observation.header.tick;
        let mut movement =
            RecordedMovement { points: vec![cutter.end(&observation.measures)], ..RecordedMovement::default() };
        loop {
            let outcome = rollout.advance(tick, |seen| agent.command(seen));
            movement.points.push(cutter.end(&outcome.measures));
            movement.errors.push(f64::from(outcome.measures[cutter.error]));
            tick += 1;
            if tick >= self.plan.scenario.ticks || rollout.sense(tick) {
                return movement;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::runtime::PlantSide;
    use crate::scenario::Scenario;

    /// The observations and commands of a run of `plan`, as its log holds them.
    fn log(plan: &Plan) -> Vec<(Observation, Command)> {
        let mut side = PlantSide::new(plan.simulated_plant().unwrap(), plan);
        let mut controller = Controller::new(plan);
        let (mut observation, mut command) = (Observation::default(), Command::default());
        (0..plan.scenario.ticks)
            .map(|tick| {
                side.observe(tick, 0, 0, &mut observation);
                controller.respond(&observation, &mut command);
                controller.after_command(&observation);
                side.step(tick, Some(&command));
                (observation, command)
            })
            .collect()
    }

    type LogChange = fn(&mut Vec<(Observation, Command)>);

    fn plan() -> Plan {
        let mut scenario = Scenario::find("paper").unwrap();
        scenario.ticks = 400;
        scenario.plan().unwrap()
    }

    fn follow(
        follower: &mut LogFollower,
        cutter: &MovementCutter,
        log: &[(Observation, Command)],
    ) -> Vec<(u64, RecordedMovement)> {
        log.iter()
            .filter_map(|(observation, command)| {
                follower.observe(observation);
                follower.command(command, cutter)
            })
            .collect()
    }

    #[test]
    fn a_run_is_followed_to_the_last_bit() {
        let plan = plan();
        let cutter = MovementCutter::new(&plan).unwrap();
        let mut follower = LogFollower::new(&plan).unwrap();
        let movements = follow(&mut follower, &cutter, &log(&plan));
        assert_eq!(follower.lost_at(), None);
        assert_eq!(movements.iter().map(|t| t.0).collect::<Vec<_>>(), [0, 80, 160, 240, 320]);
        for (_, movement) in &movements {
            assert_eq!((movement.points.len(), movement.errors.len()), (81, 80));
        }
        // The weights are 0 at first, so nothing moves without noise.
        let still = &movements[0].1.points;
        assert!(still[1..].iter().all(|p| p == &still[1]));
    }

    #[test]
    fn a_log_that_differs_is_noticed() {
        let plan = plan();
        let cutter = MovementCutter::new(&plan).unwrap();
        let whole = log(&plan);
        let changes: [LogChange; 4] = [
            |log| log[100].1.drawn[2] += 1e-7,
            |log| log[100].0.inputs[3] += 1e-6,
            |log| log[100].0.reward *= 1.5,
            |log| {
                log.remove(100);
            },
        ];
        for (i, change) in changes.iter().enumerate() {
            let mut log = whole.clone();
            change(&mut log);
            let mut follower = LogFollower::new(&plan).unwrap();
            let movements = follow(&mut follower, &cutter, &log);
            // A changed reward changes the weights, and with them the next answer.
            assert!((100..=101).contains(&follower.lost_at().unwrap()), "{i}: {:?}", follower.lost_at());
            assert_eq!(movements.len(), 2, "{i}");
        }
    }
}
