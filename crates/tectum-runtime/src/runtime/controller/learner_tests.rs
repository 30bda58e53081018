//! What holds for every rule: order on short runs, determinism, the presets' validity, and stopping at a bad number.

use super::Controller;
use crate::learner::{LearnerConfig, Rule};
use crate::runtime::{InProcess, in_process};
use crate::scenario::{Plan, Scenario};
use crate::wire::{Command, Observation, flag};

const RULES: [Rule; 6] = Rule::ALL;

fn plan(rule: Rule, seed: u64, ticks: u64) -> Plan {
    let mut scenario = Scenario::find("paper").unwrap();
    (scenario.seed, scenario.ticks) = (seed, ticks);
    scenario.learner = if rule == Rule::ModelPredictive { small_planner() } else { LearnerConfig::preset(rule) };
    scenario.plan().unwrap()
}

/// A planner with small models and short plans, so that debug builds are quick.
pub(super) fn small_planner() -> LearnerConfig {
    let table = "rule = \"model-predictive\"\n[plan]\nhorizon = 6\nmemory = 200\npoints = 30\nreward_features = 100\n\
        dynamics_features = 100\nrival_iterations = 1\nrefit_operations = 2.0";
    toml::from_str(table).unwrap()
}

fn run(plan: &Plan) -> InProcess {
    in_process(plan, plan.simulated_plant().unwrap(), |_, _| true)
}

/// Mean loss of the last of the run's windows.
fn loss(rule: Rule, ticks: u64) -> f64 {
    run(&plan(rule, 3, ticks)).controller.windows.last().unwrap().loss
}

#[test]
fn every_rule_gives_the_same_weights_twice_and_others_with_another_seed() {
    for rule in RULES {
        let ticks = if matches!(rule, Rule::LearnedReward | Rule::ModelPredictive) { 60 } else { 500 };
        let hash = |seed| run(&plan(rule, seed, ticks)).controller.weights_hash;
        assert_eq!(hash(5), hash(5), "{rule:?}");
        assert_ne!(hash(5), hash(6), "{rule:?}");
    }
}

#[test]
fn threads_side_by_side_learn_what_one_alone_does() {
    for rule in RULES {
        let ticks = if matches!(rule, Rule::LearnedReward | Rule::ModelPredictive) { 40 } else { 300 };
        let plan = plan(rule, 5, ticks);
        let alone = run(&plan).controller.weights_hash;
        std::thread::scope(|scope| {
            let threads: Vec<_> = (0..3).map(|_| scope.spawn(|| run(&plan).controller.weights_hash)).collect();
            for thread in threads {
                assert_eq!(thread.join().unwrap(), alone, "{rule:?}");
            }
        });
    }
}

#[test]
fn actor_critic_is_better_than_the_papers_rule_and_that_than_noise_alone() {
    let mut still = plan(Rule::Paper, 3, 60_000);
    still.scenario.learner.alpha_over_variance = 0.0;
    let still = run(&still).controller.windows.last().unwrap().loss;
    // The paper's rule first makes it worse, and needs some hundred thousand ticks to be better than nothing.
    let (paper, critic) = (loss(Rule::Paper, 600_000), loss(Rule::ActorCritic, 60_000));
    assert!(critic < 0.8 * paper && paper < 0.9 * still, "{still} {paper} {critic}");
}

#[test]
fn a_rule_that_halts_says_so_in_the_log_and_leaves_the_weights_alone() {
    let plan = plan(Rule::ActorCritic, 3, 100);
    let mut controller = Controller::new(&plan);
    let (mut observation, mut command) = (Observation::default(), Command::default());
    let mut answer = |tick, reward| {
        observation.header.tick = tick;
        observation.header.flags = if tick == 0 { flag::FIRST } else { 0 };
        observation.reward = reward;
        controller.respond(&observation, &mut command);
        controller.after_command(&observation);
        (controller.halted(), controller.policy().unwrap().hash())
    };
    for tick in 0..5 {
        assert!(!answer(tick, -0.1).0);
    }
    // Finite, but the error that comes of it is not.
    answer(5, f32::MAX);
    let (halted, hash) = answer(6, f32::MIN);
    assert!(halted);
    assert_eq!(answer(7, -0.1), (true, hash));
}
