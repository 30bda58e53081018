//! Whatever has a memory lists all of it: plant and controller go on from a saved state as if they had never stopped.

use super::Controller;
use crate::plant::SimulatedPlant;
use crate::runtime::PlantSide;
use crate::scenario::{Plan, Scenario};
use crate::state::{Persist, load, save, size};
use crate::wire::{Command, Observation};

/// Plant and controller of a scenario, and what they say.
struct PlantAndController {
    plant: PlantSide<SimulatedPlant>,
    controller: Controller,
    observation: Observation,
    command: Command,
}

impl PlantAndController {
    fn of(plan: &Plan) -> Self {
        Self {
            plant: PlantSide::new(plan.simulated_plant().unwrap(), plan),
            controller: Controller::new(plan),
            observation: Observation::default(),
            command: Command::default(),
        }
    }

    fn step(&mut self, ticks: std::ops::Range<u64>) {
        for tick in ticks {
            self.plant.observe(tick, 0, 0, &mut self.observation);
            self.controller.respond(&self.observation, &mut self.command);
            self.controller.after_command(&self.observation);
            // Now and then nothing comes: gate and trace have a memory of that.
            self.plant.step(tick, (tick % 97 != 96).then_some(&self.command));
        }
    }
}

fn saved(part: &mut dyn Persist) -> Vec<u8> {
    let mut bytes = vec![0; size(part)];
    assert_eq!(save(part, &mut bytes), Some(bytes.len()));
    bytes
}

/// Whatever has a memory and does not list it shows here: after the same ticks both must be in the same state, to the
/// last bit, and that state is all that they list and all that they say.
#[test]
fn what_is_restored_goes_on_as_if_it_had_never_stopped() {
    for (scenario, rule) in [
        ("paper", "paper"),
        ("paper", "baseline"),
        ("paper", "actor-critic"),
        ("paper", "natural-actor-critic"),
        ("arm", "learned-reward"),
        ("eye", "paper"),
        ("laplace", "paper"),
        ("office", "paper"),
        ("office", "learned-reward"),
        ("pendulum", "paper"),
        ("cart-pole", "actor-critic"),
        ("so101", "learned-reward"),
        ("arm", "model-predictive"),
        ("office", "model-predictive"),
        ("pendulum", "model-predictive"),
    ] {
        let mut plan = Scenario::find(scenario).unwrap();
        plan.learner = toml::from_str(&format!("rule = \"{rule}\"")).unwrap();
        if rule == "model-predictive" {
            plan.learner = super::learner_tests::small_planner();
        }
        let plan = plan.plan().unwrap();
        let mut whole = PlantAndController::of(&plan);
        // Across a challenger's birth, a new target, and a saving in the middle of a movement.
        whole.step(0..333);
        let (plant, controller) = (saved(&mut whole.plant), saved(&mut whole.controller));
        let mut back = PlantAndController::of(&plan);
        assert!(load(&mut back.plant, &plant) && load(&mut back.controller, &controller), "{scenario} {rule}");
        whole.step(333..500);
        back.step(333..500);
        assert_eq!(whole.command, back.command, "{scenario} {rule}");
        assert!(saved(&mut whole.plant) == saved(&mut back.plant), "{scenario} {rule}");
        assert!(saved(&mut whole.controller) == saved(&mut back.controller), "{scenario} {rule}");
        assert_eq!(whole.controller.finish(), back.controller.finish(), "{scenario} {rule}");
        assert_eq!(whole.plant.report(), back.plant.report());
    }
}

#[test]
fn another_parts_state_is_refused() {
    let plan = Scenario::find("paper").unwrap().plan().unwrap();
    let mut controller = Controller::new(&plan);
    let bytes = saved(&mut controller);
    assert!(!load(&mut Controller::new(&plan), &bytes[1..]));
    assert!(!load(&mut PlantSide::new(plan.simulated_plant().unwrap(), &plan), &bytes));
    assert_eq!(save(&mut controller, &mut vec![0; bytes.len() - 1]), None);
}
