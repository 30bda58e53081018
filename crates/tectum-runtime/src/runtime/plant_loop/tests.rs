use std::panic::resume_unwind;
use std::path::Path;
use std::time::{Duration, Instant};

use super::*;
use crate::channel::{ControllerPorts, DomainName, RunServices};
use crate::plant::{Outcome, SimulatedPlant};
use crate::runtime::{Mode, RunManifest, identity};
use crate::scenario::{Plan, Scenario};
use crate::wire::{Control, Phase};

/// The scenario's plant. Its process dies when the state is to be kept for the `dies_at`-th time.
struct MortalPlant {
    plant: SimulatedPlant,
    visits: u64,
    dies_at: u64,
}

impl Persist for MortalPlant {
    fn visit_state(&mut self, visitor: &mut dyn StateVisitor) {
        // The first visit asks for the state's size.
        if self.visits == self.dies_at {
            resume_unwind(Box::new("killed"));
        }
        self.visits += 1;
        self.plant.visit_state(visitor);
    }
}

impl Plant for MortalPlant {
    fn sense(&mut self, tick: u64, inputs: &mut [f32]) -> bool {
        self.plant.sense(tick, inputs)
    }

    fn advance(&mut self, tick: u64, applied: &[f32]) -> Outcome {
        self.plant.advance(tick, applied)
    }
}

/// A lockstep run of six ticks whose launcher and controller are the test.
struct Run {
    folder: tempfile::TempDir,
    plan: Plan,
    controller: ControllerPorts,
    commands: u64,
    // Dropped last: it removes the domain.
    services: RunServices,
}

impl Run {
    fn begin(id: u64) -> Self {
        let plan = Scenario { ticks: 6, ..Scenario::built_in("paper").unwrap() }.plan().unwrap();
        let domain = DomainName::of(u64::from(std::process::id()) << 32 ^ 0x91a7 ^ id);
        let (identity, channels) = (identity(&plan), &plan.scenario.channels);
        let services = RunServices::create(&domain, &identity, channels, None, false).unwrap();
        services.control.put(Control { phase: Phase::Run as u32, ..Control::default() });
        let (controller, _board) = ControllerPorts::open(&domain, &identity, channels).unwrap();
        let folder = tempfile::tempdir().unwrap();
        let manifest: RunManifest = serde_json::from_value(serde_json::json!({
            "run": "00000000000000aa", "mode": Mode::Lockstep, "domain": domain, "launcher": std::process::id(),
        }))
        .unwrap();
        std::fs::write(RunManifest::path(folder.path()), serde_json::to_vec(&manifest).unwrap()).unwrap();
        std::fs::write(RunManifest::scenario_path(folder.path()), plan.scenario.to_toml()).unwrap();
        Self { folder, plan, controller, commands: 0, services }
    }

    /// Starts the plant's process, as the `incarnation`-th.
    fn start(&mut self, incarnation: u32, dies_at: u64) -> std::thread::JoinHandle<u64> {
        self.services.set_incarnation(Role::Plant, incarnation).unwrap();
        let mut control = Control { phase: Phase::Run as u32, ..Control::default() };
        control.incarnations[Role::Plant as usize] = incarnation;
        self.services.control.put(control);
        let (folder, plant) = (self.folder.path().to_owned(), self.plan.described_plant().unwrap());
        std::thread::spawn(move || {
            let participant = Participant::take(Path::new(&folder), Role::Plant, None).unwrap();
            run_plant(participant, MortalPlant { plant, visits: 0, dies_at }).unwrap().ticks
        })
    }

    /// The next observation, without what says which process sent it.
    fn observe(&self) -> Observation {
        let until = Instant::now() + Duration::from_secs(60);
        loop {
            if let Some(mut observation) = self.controller.observation.receive().unwrap() {
                observation.header.incarnation = 0;
                return observation;
            }
            assert!(Instant::now() < until, "no observation");
            std::thread::yield_now();
        }
    }

    /// Answers `observation`, or sends the last answer again if it was answered before, as a controller does.
    fn answer(&mut self, observation: &Observation) {
        self.commands = self.commands.max(observation.header.sequence + 1);
        let mut command = Command::default();
        command.header.sequence = self.commands - 1;
        command.header.tick = self.commands - 1;
        command.drawn[0] = 1e-4 * self.commands as f32;
        self.controller.command.send(&command).unwrap();
    }
}

/// The observations of a run in which nothing happens.
fn undisturbed() -> Vec<Observation> {
    let mut run = Run::begin(0);
    let plant = run.start(0, u64::MAX);
    let observations = (0..6).map(|_| {
        let observation = run.observe();
        run.answer(&observation);
        observation
    });
    let observations = observations.collect();
    assert_eq!(plant.join().unwrap(), 6);
    observations
}

/// A plant that dies after it has sent an observation, and before it has kept its state, repeats the tick with the
/// command that it had received. Whether the controller has answered already makes no difference.
#[test]
fn a_plant_that_dies_between_sending_and_keeping_repeats_the_tick() {
    let whole = undisturbed();
    for answered in [false, true] {
        let mut run = Run::begin(1 + u64::from(answered));
        // The state is kept after observations 0 and 1, not after 2.
        let plant = run.start(0, 3);
        for expected in &whole[..3] {
            let observation = run.observe();
            assert_eq!(&observation, expected);
            if observation.header.sequence < 2 || answered {
                run.answer(&observation);
            }
        }
        assert!(plant.join().is_err(), "it has died");
        let plant = run.start(1, u64::MAX);
        for expected in &whole[1..] {
            let observation = run.observe();
            assert_eq!(&observation, expected, "answered: {answered}");
            run.answer(&observation);
        }
        assert_eq!(plant.join().unwrap(), 6);
    }
}
