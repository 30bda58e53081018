//! A plant with as many inputs and outputs as a sample has room for, and a controller of its own for it: run, killed,
//! log, CSV and replay. One more of either is refused by name, and so is a learner that takes fewer.

mod support;

use support::{TECTUM, TestFolder, assert_no_debris, example};
use tectum::wire::{MAX_INPUTS, MAX_OUTPUTS};

/// The plant `wide` of `tests/support/wayward.rs`, with so many inputs and outputs. `more` has controller and learner.
fn scenario(inputs: usize, outputs: usize, more: &str) -> String {
    let list = |kind: &str, name: &str, count: usize| {
        let one = |i| format!("[[plant.{kind}]]\nname = \"{name}_{i}\"\nunit = \"m\"\nmin = -1.0\nmax = 1.0\n");
        (0..count).map(one).collect::<String>()
    };
    format!(
        "name = \"wide\"\nticks = 100_000\n[plant]\nprogram = {:?}\nmeasures = [\"error\"]\n{}{}\
         [gate]\nmax_command = 1.0\n[log]\nhash_every = 10\n[restart]\nbackoff_ms = 1\n{more}",
        example("wayward").to_str().unwrap(),
        list("inputs", "input", inputs),
        list("outputs", "output", outputs)
    )
}

fn own_controller() -> String {
    let program = example("foreign");
    format!("[controller]\nprogram = {:?}\nupdates = 3\n[learner]\nrule = \"wide\"\n", program.to_str().unwrap())
}

/// Ticks of a run in which there is time for a kill.
const TICKS: &str = "4000";

#[test]
fn as_many_signals_as_a_sample_holds_are_run_logged_and_replayed() {
    let run = |kill: bool| {
        let test_folder = TestFolder::new();
        let text = scenario(MAX_INPUTS, MAX_OUTPUTS, &own_controller());
        let scenario = test_folder.write_file("wide.toml", text).to_str().unwrap().to_owned();
        let mut run = test_folder.run(&[&scenario, "--ticks", TICKS, "--json"]);
        if kill {
            run.wait_until_ticking();
            run.kill_child("foreign");
        }
        let summary = run.wait().expect(0).json();
        assert_no_debris(test_folder.run_folder());
        assert_eq!(summary["restarts"].as_array().unwrap().len(), usize::from(kill), "{summary}");
        (test_folder, summary)
    };
    let (test_folder, undisturbed) = run(false);
    let (killed_folder, killed) = run(true);
    assert_eq!(undisturbed["weights_hash"], killed["weights_hash"]);

    // 32 inputs and 16 outputs, each with its own name and numbers.
    let csv = |folder: &TestFolder, channel: &str| {
        folder.start(TECTUM, &["log", "csv", "run", "--channel", channel]).wait().expect(0).stdout
    };
    let observations = csv(&test_folder, "observation");
    let names: Vec<_> = observations.lines().next().unwrap().split(',').collect();
    for (name, count) in [("input_", MAX_INPUTS), ("output_", MAX_OUTPUTS)] {
        let columns: Vec<_> = names.iter().enumerate().filter(|(_, column)| column.contains(name)).collect();
        assert_eq!(columns.len(), count, "{names:?}");
        let last: Vec<_> = observations.lines().last().unwrap().split(',').collect();
        assert!(columns.iter().filter(|(at, _)| last[*at] != "0").count() >= count - 1, "{last:?}");
    }
    let commands = csv(&test_folder, "command");
    let count = |name: &str| commands.lines().next().unwrap().matches(name).count();
    assert_eq!(count("output_"), 2 * MAX_OUTPUTS, "means and commands");
    // Each tick has three updates.
    let learning = csv(&test_folder, "learning");
    let updates = learning.lines().next().unwrap().split(',').position(|name| name == "updates").unwrap();
    let of_row = |row: usize| learning.lines().nth(row + 1).unwrap().split(',').nth(updates).unwrap().to_owned();
    assert_eq!((of_row(0), of_row(99)), ("3.0".to_owned(), "300.0".to_owned()));

    for folder in [&test_folder, &killed_folder] {
        let replay = folder.tectum("replay", &["run", "--json"]).expect(0).json();
        assert_eq!(replay["difference"], serde_json::Value::Null, "{replay}");
        assert_eq!(replay["weights_hash"], undisturbed["weights_hash"], "{replay}");
    }
}

#[test]
fn one_more_is_refused_by_name_and_so_is_a_learner_that_takes_fewer() {
    let paper = "[[encoder.maps]]\ninputs = [\"input_0\"]\nradius = 0.5\n[learner]\nrule = \"paper\"\n";
    for (inputs, outputs, more, expected) in [
        (
            33,
            16,
            own_controller(),
            "plant.inputs has 33 entries; give at most 32: a sample has no room for \"input_32\"",
        ),
        (
            32,
            17,
            own_controller(),
            "plant.outputs has 17 entries; give at most 16: a sample has no room for \"output_16\"",
        ),
        (
            17,
            8,
            paper.to_owned(),
            "learner.rule is paper, for which 17 inputs are too many; it supports at most 16, and a",
        ),
        (
            16,
            9,
            paper.to_owned(),
            "learner.rule is paper, for which 9 outputs are too many; it supports at most 8, and a",
        ),
    ] {
        let test_folder = TestFolder::new();
        let scenario = test_folder.write_file("wide.toml", scenario(inputs, outputs, &more));
        let message = test_folder.run(&[scenario.to_str().unwrap()]).wait().expect(2).stderr;
        assert!(message.contains(expected), "{message}");
        assert!(message.contains("wide.toml:"), "{message}");
    }
}
