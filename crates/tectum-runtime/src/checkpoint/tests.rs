use std::path::Path;

use super::*;
use crate::plant::SimulatedPlant;
use crate::runtime::{Controller, PlantSide};
use crate::scenario::{LearnerConfig, Plan, Rule, Scenario};
use crate::wire::{Command, Observation};

fn plan(name: &str) -> Plan {
    let mut scenario = Scenario::find(name).unwrap();
    if name == "arm" {
        scenario.learner = LearnerConfig::preset(Rule::LearnedReward);
    }
    scenario.plan().unwrap()
}

/// Plant and controller after `ticks` ticks.
fn after_ticks(plan: &Plan, ticks: u64) -> (PlantSide<SimulatedPlant>, Controller) {
    let mut plant = PlantSide::new(plan.simulated_plant().unwrap(), plan);
    let mut controller = Controller::new(plan);
    let (mut observation, mut command) = (Observation::default(), Command::default());
    for tick in 0..ticks {
        plant.observe(tick, 0, 0, &mut observation);
        controller.respond(&observation, &mut command);
        controller.after_command(&observation);
        plant.step(tick, Some(&command));
    }
    (plant, controller)
}

fn bytes(part: &mut dyn Persist) -> Vec<u8> {
    let mut bytes = vec![0; crate::state::size(part)];
    crate::state::save(part, &mut bytes).unwrap();
    bytes
}

fn facts(role: Role, plan: &Plan) -> CheckpointFacts {
    CheckpointFacts::new(role, 7, 300, 300, plan.hash)
}

#[test]
fn a_restored_state_is_equal_to_the_bit() {
    for name in ["paper", "arm", "eye"] {
        let plan = plan(name);
        let (mut plant, mut controller) = after_ticks(&plan, 300);
        let policy = controller.policy().unwrap().clone();
        for (role, part, policy) in
            [(Role::Plant, &mut plant as &mut dyn Persist, None), (Role::Controller, &mut controller, Some(&policy))]
        {
            let file = encode(&facts(role, &plan), part, policy);
            assert_eq!(file, encode(&facts(role, &plan), part, policy), "the same bytes each time");
            let checkpoint = Checkpoint::parse(Path::new("x"), &file).unwrap();
            checkpoint.fits(role, plan.hash).unwrap();
            let (mut new_plant, mut new_controller) = after_ticks(&plan, 0);
            let fresh: &mut dyn Persist = if role == Role::Plant { &mut new_plant } else { &mut new_controller };
            checkpoint.restore(fresh).unwrap();
            assert!(bytes(fresh) == bytes(part), "{name} {}", role.name());
        }
    }
}

#[test]
fn the_policy_is_stored_as_a_matrix() {
    let plan = plan("paper");
    let (_, mut controller) = after_ticks(&plan, 300);
    let policy = controller.policy().unwrap().clone();
    let file = encode(&facts(Role::Controller, &plan), &mut controller, Some(&policy));
    let file = SafeTensors::deserialize(&file).unwrap();
    let weights = file.tensor("weights").unwrap();
    assert_eq!(weights.shape(), [4, 320]);
    let first: f32 = bytemuck::pod_read_unaligned(&weights.data()[4 * (320 + 5)..][..4]);
    assert_eq!(first, policy.weight(1, 5));
}

/// Flips bits and cuts the file at many bytes.
#[test]
fn a_damaged_file_is_refused() {
    let plan = plan("eye");
    let (mut plant, mut controller) = after_ticks(&plan, 300);
    let plant = encode(&facts(Role::Plant, &plan), &mut plant, None);
    let whole = encode(&facts(Role::Controller, &plan), &mut controller, None);
    let header = 8 + u64::from_le_bytes(whole[..8].try_into().unwrap()) as usize;
    // All bytes of a small file; of a large one the header and every 97th byte.
    let offsets = (0..header).chain((header..whole.len()).step_by(97));
    for (file, offsets) in [(&plant, (0..plant.len()).collect::<Vec<_>>()), (&whole, offsets.collect())] {
        let mut file = file.clone();
        for offset in offsets {
            let bit = 1 << (offset % 8);
            file[offset] ^= bit;
            let error = Checkpoint::parse(Path::new("7.plant"), &file).expect_err("a flipped bit");
            assert!(error.to_string().starts_with("7.plant: "), "{error}");
            assert!(Checkpoint::parse(Path::new("x"), &file[..offset]).is_err());
            file[offset] ^= bit;
        }
        assert!(Checkpoint::parse(Path::new("x"), &file).is_ok());
    }
}

#[test]
fn a_checkpoint_of_another_role_or_scenario_is_refused() {
    let plan = plan("paper");
    let (mut plant, _) = after_ticks(&plan, 10);
    let file = encode(&facts(Role::Plant, &plan), &mut plant, None);
    let checkpoint = Checkpoint::parse(Path::new("300.plant.safetensors"), &file).unwrap();
    let error = checkpoint.fits(Role::Controller, plan.hash).unwrap_err().to_string();
    assert!(error.contains("its role is plant, here it is controller"), "{error}");
    let error = checkpoint.fits(Role::Plant, plan.hash + 1).unwrap_err().to_string();
    assert!(error.starts_with("300.plant.safetensors: the checkpoint does not fit: its scenario is "), "{error}");
    // The same role of another scenario, in case the hashes collide.
    let mut eye = after_ticks(&self::plan("eye"), 0).0;
    let error = checkpoint.restore(&mut eye).unwrap_err().to_string();
    assert!(error.contains("is not in it"), "{error}");
    let plain = safetensors::serialize(Vec::<(String, TensorView)>::new(), None).unwrap();
    assert!(matches!(Checkpoint::parse(Path::new("x"), &plain), Err(CheckpointError::Foreign { .. })));
}
