//! I6: in a tick our code allocates nothing. The allocations of iceoryx2 are counted separately and pinned.

#[path = "support/counting_allocator.rs"]
mod counting_allocator;

use counting_allocator::allocations;
use tectum::channel::{ControllerPorts, DomainName, LoggerPorts, PlantPorts, RunServices};
use tectum::plant::SimulatedPlant;
use tectum::runtime::{Controller, PlantSide, identity};
use tectum::scenario::Scenario;
use tectum::wire::{Command, Learning, Observation, Status};

/// Plant and controller of a run, and the samples that they exchange in a tick.
struct ControlLoop {
    plant: PlantSide<SimulatedPlant>,
    controller: Controller,
    observation: Observation,
    command: Command,
    learning: Learning,
}

impl ControlLoop {
    fn new(name: &str) -> Self {
        Self::of(Scenario::find(name).unwrap())
    }

    fn of(mut scenario: Scenario) -> Self {
        // Short windows, so that the report closes many of them.
        scenario.ticks = 10_000;
        let plan = scenario.plan().unwrap();
        Self {
            plant: PlantSide::new(plan.simulated_plant().unwrap(), &plan),
            controller: Controller::new(&plan),
            observation: Observation::default(),
            command: Command::default(),
            learning: Learning::default(),
        }
    }

    fn tick(&mut self, tick: u64) {
        self.plant.observe(tick, 0, 0, &mut self.observation);
        self.controller.respond(&self.observation, &mut self.command);
        self.controller.after_command(&self.observation);
        self.controller.record(&self.observation, &mut self.learning);
        // Every kind of tick: with a command, without one, out of range, not a number.
        match tick % 97 {
            13 => self.plant.step(tick, None),
            29 => {
                self.command.drawn[0] = 1e9;
                self.plant.step(tick, Some(&self.command));
            }
            31 => {
                self.command.drawn[0] = f32::NAN;
                self.plant.step(tick, Some(&self.command));
            }
            _ => self.plant.step(tick, Some(&self.command)),
        }
    }
}

#[test]
fn a_tick_allocates_nothing() {
    // A tick of `arm` takes a thousand times longer: its learner improves the policy from the 20th tick on.
    for (name, ticks) in
        [("paper", 10_000), ("eye", 10_000), ("arm", 60), ("office", 300), ("pendulum", 60), ("so101", 60)]
    {
        let mut control_loop = ControlLoop::new(name);
        let before = allocations();
        for tick in 0..ticks {
            control_loop.tick(tick);
        }
        assert_eq!(allocations() - before, 0, "{name}");
    }
}

/// The planner from its first tick on: refits, plans and rivals take memory that they have.
#[test]
fn a_planners_tick_allocates_nothing() {
    for name in ["pendulum", "arm"] {
        let mut scenario = Scenario::find(name).unwrap();
        let learner = "rule = \"model-predictive\"\n[plan]\nhorizon = 6\nmemory = 200\npoints = 30\n\
            reward_features = 100\ndynamics_features = 100\nrival_iterations = 1\nrefit_operations = 2.0";
        scenario.learner = toml::from_str(learner).unwrap();
        let mut control_loop = ControlLoop::of(scenario);
        let before = allocations();
        for tick in 0..260 {
            control_loop.tick(tick);
        }
        assert_eq!(allocations() - before, 0, "{name}");
    }
}

/// The same with the channels. iceoryx2 0.10 allocates once in the writer of a sample and not in its readers; boards
/// allocate nothing, nor does the wake-up word. This test shows when that changes.
#[test]
fn the_transport_allocates_twice_a_tick() {
    let plan = Scenario::find("paper").unwrap().plan().unwrap();
    let (channels, identity) = (&plan.scenario.channels, identity(&plan));
    let name = DomainName::of(u64::from(std::process::id()) << 32 | 0xa110c);
    let _services = RunServices::create(&name, &identity, channels, None, false).unwrap();
    let (mut plant, _board) = PlantPorts::open(&name, &identity, channels).unwrap();
    let (mut controller, board) = ControllerPorts::open(&name, &identity, channels).unwrap();
    let (mut logger, _board) = LoggerPorts::open(&name, &identity, channels).unwrap();
    let mut control_loop = ControlLoop::new("paper");
    let mut status = Status::default();
    let (mut before, ticks) = (0, 2000);
    for tick in 0..2 * ticks {
        if tick == ticks {
            before = allocations();
        }
        plant.observation.send(&control_loop.observation).unwrap();
        plant.wake.notify();
        plant.log.append(&control_loop.observation);
        let received = controller.observation.receive().unwrap().unwrap();
        assert_eq!(received, control_loop.observation);
        controller.command.send(&control_loop.command).unwrap();
        controller.learning.send_if_read(&control_loop.learning).unwrap();
        controller.command_log.append(&control_loop.command);
        controller.learning_log.append(&control_loop.learning);
        status.ticks = tick;
        board.status.put(status);
        assert!(plant.command.receive().unwrap().is_some());
        assert!(logger.observation.receive().is_some());
        assert!(logger.command.receive().is_some());
        assert!(logger.learning.receive().is_some());
        control_loop.tick(tick);
    }
    let per_tick = (allocations() - before) as f64 / ticks as f64;
    println!("iceoryx2 allocates {per_tick} times a tick: two samples sent and received");
    assert_eq!(per_tick, TRANSPORT);
}

const TRANSPORT: f64 = 2.0;
