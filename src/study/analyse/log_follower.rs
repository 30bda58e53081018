//! The movements that the policy would have made without exploration noise.
//!
//! Noise of the paper's size moves the end-effector by a tenth of a metre a tick: nothing that is measured of a speed
//! says much while it is in there. But a log tells everything that plant and controller were told, so both can be followed
//! through it: the body lives through the applied commands, the controller learns from the observations, and what they
//! say must be what the log says, to the last bit. When a target appears, a twin of the body, in the very posture, is
//! moved towards it with the mean of the policy of that moment, through the gate, until the next target.

use super::cutter::MovementCutter;
use super::movement::RecordedMovement;
use crate::encoder::{Encoder, Features};
use crate::plant::{Plant as _, SimulatedPlant};
use crate::runtime::{Controller, Gate};
use crate::scenario::Plan;
use crate::wire::{Command, MAX_INPUTS, Observation, flag};

/// Body and controller of a run, followed through its log.
#[derive(Debug, Clone)]
pub struct LogFollower {
    body: SimulatedPlant,
    controller: Controller,
    gate: Gate,
    encoder: Encoder,
    features: Features,
    inputs: usize,
    outputs: usize,
    ticks: u64,
    /// The observation that the next command answers.
    seen: Option<Observation>,
    last: Option<u64>,
    answer: Command,
    /// The first tick in which the log said something else.
    lost_at: Option<u64>,
}

impl LogFollower {
    /// The beginning of a run of `plan`; `None` if its plant is not one of the simulator's.
    pub fn new(plan: &Plan) -> Option<Self> {
        let encoder = Encoder::new(&plan.maps, plan.scenario.encoder.normalise);
        Some(Self {
            body: plan.simulated_plant()?,
            controller: Controller::new(plan),
            gate: Gate::new(&plan.scenario.gate, plan.outputs.len()),
            features: encoder.features(),
            encoder,
            inputs: plan.inputs.len(),
            outputs: plan.outputs.len(),
            ticks: plan.scenario.ticks,
            seen: None,
            last: None,
            answer: Command::default(),
            lost_at: None,
        })
    }

    /// The tick from which on the log is not what this build makes of it; `None` while it is.
    pub fn lost_at(&self) -> Option<u64> {
        self.lost_at
    }

    /// Follows the body through the tick before `observation`.
    pub fn observe(&mut self, observation: &Observation) {
        if self.lost_at.is_some() {
            return;
        }
        let tick = observation.header.tick;
        if tick > 0 {
            self.body.advance(tick - 1, &observation.applied[..self.outputs]);
        }
        let mut inputs = [0.0; MAX_INPUTS];
        let fresh = self.body.sense(tick, &mut inputs);
        let same = inputs.map(f32::to_bits) == observation.inputs.map(f32::to_bits);
        let in_a_row = self.last.map_or(0, |last| last + 1) == tick;
        if same && in_a_row && fresh == (observation.header.flags & flag::NEW_TARGET != 0) {
            self.last = Some(tick);
            self.seen = Some(*observation);
        } else {
            self.lost_at = Some(tick);
        }
    }

    /// Follows the controller through the tick of `command`. Gives the noiseless movement if a target appeared in it;
    /// `cutter` knows where its measures stand.
    pub fn command(&mut self, command: &Command, cutter: &MovementCutter) -> Option<(u64, RecordedMovement)> {
        let tick = command.header.tick;
        if self.lost_at.is_some() {
            return None;
        }
        let Some(observation) = self.seen.take().filter(|seen| seen.header.tick == tick) else {
            self.lost_at = Some(tick);
            return None;
        };
        self.controller.respond(&observation, &mut self.answer);
        if self.answer.drawn.map(f32::to_bits) != command.drawn.map(f32::to_bits) {
            self.lost_at = Some(tick);
            return None;
        }
        let fresh = observation.header.flags & flag::NEW_TARGET != 0;
        let movement = fresh.then(|| (tick, self.without_noise(&observation, cutter)));
        self.controller.after_command(&observation);
        movement
    }

    /// What the mean of the policy as it is now makes of `observation`'s target.
    fn without_noise(&mut self, observation: &Observation, cutter: &MovementCutter) -> RecordedMovement {
        let (mut twin, mut gate) = (self.body.clone(), self.gate.clone());
        let (mut inputs, mut tick) = (observation.inputs, observation.header.tick);
        let mut track =
            RecordedMovement { points: vec![cutter.end(&observation.measures)], ..RecordedMovement::default() };
        loop {
            self.encoder.encode(&inputs[..self.inputs], &mut self.features);
            let mean = self.controller.policy().mean(self.features.as_slice());
            let ranges = gate.command_ranges(|| twin.joints());
            let applied = gate.pass(Some(&mean), ranges.as_ref()).command;
            let outcome = twin.advance(tick, &applied[..self.outputs]);
            track.points.push(cutter.end(&outcome.measures));
            track.errors.push(f64::from(outcome.measures[cutter.error]));
            tick += 1;
            if tick >= self.ticks || twin.sense(tick, &mut inputs) {
                return track;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::runtime::PlantSide;
    use crate::scenario::Scenario;

    /// What a log of a run of `plan` holds.
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

    type Spoil = fn(&mut Vec<(Observation, Command)>);

    fn plan() -> Plan {
        let mut scenario = Scenario::find("paper").unwrap();
        scenario.ticks = 400;
        scenario.plan().unwrap()
    }

    fn follow(
        shadow: &mut LogFollower,
        cutter: &MovementCutter,
        log: &[(Observation, Command)],
    ) -> Vec<(u64, RecordedMovement)> {
        log.iter()
            .filter_map(|(observation, command)| {
                shadow.observe(observation);
                shadow.command(command, cutter)
            })
            .collect()
    }

    #[test]
    fn a_run_is_followed_to_the_last_bit() {
        let plan = plan();
        let cutter = MovementCutter::new(&plan).unwrap();
        let mut shadow = LogFollower::new(&plan).unwrap();
        let tracks = follow(&mut shadow, &cutter, &log(&plan));
        assert_eq!(shadow.lost_at(), None);
        assert_eq!(tracks.iter().map(|t| t.0).collect::<Vec<_>>(), [0, 80, 160, 240, 320]);
        for (_, track) in &tracks {
            assert_eq!((track.points.len(), track.errors.len()), (81, 80));
        }
        // Weights are 0 at first: without noise, nothing moves.
        let still = &tracks[0].1.points;
        assert!(still[1..].iter().all(|p| p == &still[1]));
    }

    #[test]
    fn a_log_that_says_something_else_is_noticed() {
        let plan = plan();
        let cutter = MovementCutter::new(&plan).unwrap();
        let whole = log(&plan);
        let spoils: [Spoil; 4] = [
            |log| log[100].1.drawn[2] += 1e-7,
            |log| log[100].0.inputs[3] += 1e-6,
            |log| log[100].0.reward *= 1.5,
            |log| {
                log.remove(100);
            },
        ];
        for (i, spoil) in spoils.iter().enumerate() {
            let mut log = whole.clone();
            spoil(&mut log);
            let mut shadow = LogFollower::new(&plan).unwrap();
            let tracks = follow(&mut shadow, &cutter, &log);
            // A reward shows in the weights, and so in the answer.
            assert!((100..=101).contains(&shadow.lost_at().unwrap()), "{i}: {:?}", shadow.lost_at());
            assert_eq!(tracks.len(), 2, "{i}");
        }
    }
}
