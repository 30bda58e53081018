//! The cart and its controller: without processes, and as processes of a run that are killed.

use cart::{Cart, ProportionalDerivative};
use tectum::runtime::in_process_with_agent;
use tectum_testkit::{ProcessOutcome, ScenarioFile, TestFolder, check_plant};

/// One tick, s.
const PERIOD: f32 = 0.05;

/// The project's scenario, with the programs that cargo built for this test.
fn scenario() -> ScenarioFile {
    ScenarioFile::read("scenario.toml")
        .set("plant.program", env!("CARGO_BIN_EXE_cart-plant"))
        .set("controller.program", env!("CARGO_BIN_EXE_cart-controller"))
        .set("restart.backoff_ms", 1)
}

#[test]
fn the_cart_is_a_sound_plant() {
    let plan = scenario().plan();
    check_plant(&plan, 2000, || Cart::new(PERIOD, plan.scenario.seed));
}

#[test]
fn the_controller_brings_the_cart_to_every_target() {
    let plan = scenario().plan();
    let (cart, controller) = (Cart::new(PERIOD, plan.scenario.seed), ProportionalDerivative::new(PERIOD));
    let (mut before, mut targets) = (f32::NAN, 0);
    in_process_with_agent(&plan, cart, controller, |observation, _| {
        let [position, target] = [observation.inputs[0], observation.inputs[1]];
        if target != before && observation.header.tick > 0 {
            let error = observation.measures[0];
            assert!(error < 0.02, "{error} m from a target at its end, tick {}", observation.header.tick);
            targets += 1;
        }
        assert!(position.abs() < 1.0, "at an end of the track, tick {}", observation.header.tick);
        before = target;
        true
    });
    assert_eq!(targets, 99);
}

/// Requires a complete run without debris, and returns every command that was applied.
fn applied(folder: &TestFolder, outcome: &ProcessOutcome) -> Vec<f32> {
    assert_eq!(outcome.json()["ended"], "complete", "{outcome:#?}");
    folder.assert_no_debris();
    folder.log().unwrap().observations.iter().map(|observation| observation.applied[0]).collect()
}

#[test]
fn killed_processes_return_and_change_no_number() {
    let run = |killed: Option<&str>| {
        let folder = TestFolder::new();
        let scenario = folder.write_scenario(&scenario().set("log.every", 1));
        let mut run = folder.run(&[&scenario, "--ticks", "20000", "--json"]);
        if let Some(program) = killed {
            run.wait_until_tick(1000);
            run.kill_child(program);
        }
        let outcome = run.wait().expect(0);
        let restarts = outcome.json()["restarts"].as_array().map(Vec::len);
        assert_eq!(restarts, Some(usize::from(killed.is_some())), "{outcome:#?}");
        applied(&folder, &outcome)
    };
    let undisturbed = run(None);
    assert_eq!(undisturbed.len(), 20_000);
    for program in ["cart-plant", "cart-controller"] {
        assert!(run(Some(program)) == undisturbed, "the death of {program} changed a command");
    }
}

#[test]
fn a_replay_finds_every_bit_again() {
    let folder = TestFolder::new();
    let scenario = folder.write_scenario(&scenario().set("log.every", 1));
    folder.run(&[&scenario, "--ticks", "2000"]).wait().expect(0);
    folder.tectum("replay", &["run"]).expect(0);
}
