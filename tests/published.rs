//! The plants that follow a published environment equal it: state and reward over 200 random steps.
//!
//! The tests are ignored by default, because they need a Python with the packages of `tests/python/published.txt`.
//! `.ci/run` installs these and runs the tests:
//!
//! ```text
//! TECTUM_PUBLISHED=path/to/python cargo test --locked --test published -- --ignored
//! ```

mod support;

use std::path::Path;

use rand::RngExt as _;
use serde_json::{Value, json};
use support::TestFolder;
use tectum::plant::{
    CartPoleConfig, CartPoleModel, PendulumConfig, PendulumModel, ReacherConfig, ReacherModel, StateSpace,
};
use tectum::seed::stream;

/// Largest difference that is allowed, in the state's units and of the reward.
const ALLOWED: f64 = 1e-6;
/// Largest difference of a state where MuJoCo's solver ends early at the end of the rail. The same trajectory with a
/// solver that does not (`exact`) is within [`ALLOWED`].
const ALLOWED_AT_THE_RAIL: f64 = 1e-5;
const STEPS: usize = 200;

/// A trajectory of `model` from `start` with random commands between -1 and 1 that lean by `bias`.
fn trajectory(task: &str, model: &impl StateSpace, start: &[f64], bias: f64) -> Value {
    let mut rng = stream(7, task);
    let (mut state, mut states, mut rewards, mut commands) = (start.to_vec(), vec![], vec![], vec![]);
    for _ in 0..STEPS {
        let mut draw = || f64::from((2.0 * rng.random::<f32>() - 1.0 + bias as f32).clamp(-1.0, 1.0));
        let command: Vec<f64> = (0..model.commands()).map(|_| draw()).collect();
        rewards.push(model.step(&mut state, &command));
        states.push(state.clone());
        commands.push(command);
    }
    json!({"task": task, "start": start, "commands": commands, "states": states, "rewards": rewards})
}

#[test]
#[ignore = "needs a Python with the packages of tests/python/published.txt, named by TECTUM_PUBLISHED"]
fn plants_equal_the_published_environments() {
    let python = std::env::var("TECTUM_PUBLISHED").unwrap_or_else(|_| "python3".to_owned());
    let pendulum = PendulumModel::new(&PendulumConfig::default(), 0.05);
    let cart_pole = |period_s| CartPoleModel::new(&CartPoleConfig::default(), period_s);
    let reacher = ReacherModel::new(&ReacherConfig::default(), 0.02);
    let reacher_start = [0.05, -0.08, 0.004, -0.002, 0.11, -0.07, 0.0, 0.0];
    let cart_pole_start = [0.01, 3.13, 0.01, -0.02];
    let trajectories = json!([
        trajectory("pendulum", &pendulum, &[3.1, 0.2], 0.0),
        trajectory("pendulum", &pendulum, &[-1.0, 1.0], 0.4),
        trajectory("cart-pole", &cart_pole(0.05), &cart_pole_start, 0.0),
        // Pushed to one side: the cart hits the end of its rail.
        trajectory("cart-pole", &cart_pole(0.05), &cart_pole_start, 0.3),
        trajectory("cart-pole-exact", &cart_pole(0.05), &cart_pole_start, 0.3),
        trajectory("cart-pole-10ms", &cart_pole(0.01), &[-0.01, -3.12, 0.0, 0.01], -0.3),
        trajectory("cart-pole-10ms-exact", &cart_pole(0.01), &[-0.01, -3.12, 0.0, 0.01], -0.3),
        trajectory("reacher", &reacher, &reacher_start, 0.0),
        // The second joint hits its stop.
        trajectory("reacher", &reacher, &reacher_start, 0.2),
    ]);
    let test_folder = TestFolder::new();
    let file = test_folder.write_file("trajectories.json", trajectories.to_string());
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/python/published.py");
    let arguments = [script.to_str().unwrap(), file.to_str().unwrap()];
    let compared = test_folder.start(python, &arguments).wait().expect(0).json();
    let compared = compared.as_array().unwrap();
    assert_eq!(compared.len(), trajectories.as_array().unwrap().len());
    for differences in compared {
        println!("{differences}");
        assert_eq!(differences["steps"], STEPS, "{differences}");
        let of = |what: &str| differences[what].as_f64().unwrap();
        let is_rail = ["cart-pole", "cart-pole-10ms"].contains(&differences["task"].as_str().unwrap());
        let allowed = if is_rail { ALLOWED_AT_THE_RAIL } else { ALLOWED };
        assert!(of("reward") < ALLOWED && of("state") < allowed, "{differences}");
    }
}
