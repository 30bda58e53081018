//! The cart and its controller: by themselves, and as processes of a run that are killed.

use cart::Cart;
use tectum_testkit::{ProcessOutcome, ScenarioFile, TestFolder, check_plant};

/// The project's scenario, with the programs that cargo built for this test.
fn scenario() -> ScenarioFile {
    ScenarioFile::read("scenario.toml")
        .set("plant.program", env!("CARGO_BIN_EXE_cart-plant"))
        .set("controller.program", env!("CARGO_BIN_EXE_cart-controller"))
        .set("restart.backoff_ms", 1)
}

/// Requires a complete run without debris, and returns every command that was applied.
fn applied(folder: &TestFolder, outcome: &ProcessOutcome) -> Vec<f32> {
    assert_eq!(outcome.json()["ended"], "complete", "{outcome:#?}");
    folder.assert_no_debris();
    folder.log().unwrap().observations.iter().map(|observation| observation.applied[0]).collect()
}

#[test]
fn the_cart_is_a_sound_plant() {
    let plan = scenario().plan();
    check_plant(&plan, 2000, || Cart::new(0.05, plan.scenario.seed));
}

#[test]
fn killed_processes_return_and_change_no_number() {
    let folder = TestFolder::new();
    let scenario = folder.write_scenario(&scenario().set("log.every", 1));
    let arguments = [scenario.as_str(), "--ticks", "20000", "--json"];
    let undisturbed = folder.run(&arguments).wait().expect(0);
    let undisturbed = applied(&folder, &undisturbed);
    assert_eq!(undisturbed.len(), 20_000);

    for program in ["cart-plant", "cart-controller"] {
        let folder = TestFolder::new();
        let mut run = folder.run(&arguments);
        run.wait_until_tick(1000);
        run.kill_child(program);
        let outcome = run.wait().expect(0);
        assert_eq!(outcome.json()["restarts"].as_array().map(Vec::len), Some(1), "{outcome:#?}");
        assert!(applied(&folder, &outcome) == undisturbed, "the death of {program} changed a command");
    }
}
