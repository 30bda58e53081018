//! `tectum tasks`: the list, the shape of its JSON object, the same numbers for the same seeds, and bad input.

mod support;

use serde_json::{Value, json};
use support::{TECTUM, TestFolder, example};

/// Measures some cells of the table and returns the JSON object.
fn tasks(arguments: &[&str]) -> Value {
    tasks_in(&TestFolder::new(), arguments)
}

fn tasks_in(test_folder: &TestFolder, arguments: &[&str]) -> Value {
    let all: Vec<&str> = ["tasks", "--json"].iter().chain(arguments).copied().collect();
    test_folder.start(TECTUM, &all).wait().expect(0).json()
}

/// A scenario with a program of one's own as its controller, for another plant than those of the tasks. Returns its
/// path.
fn own_scenario(test_folder: &TestFolder, rule: &str) -> String {
    let program = example("foreign");
    let text = format!(
        "name = \"own\"\nticks = 9\n[plant]\nprogram = \"elsewhere\"\n\
         inputs = [{{ name = \"x\", unit = \"m\", min = 0.0, max = 1.0 }}]\n\
         outputs = [{{ name = \"v\", unit = \"m/s\", min = -1.0, max = 1.0 }}]\n\
         [controller]\nprogram = {program:?}\n[learner]\nrule = {rule:?}\n"
    );
    test_folder.write_file("own.toml", text).to_str().unwrap().to_owned()
}

/// The entries without times, which differ from call to call.
fn numbers(json: &Value) -> Vec<Value> {
    let mut entries = json["tasks"].as_array().unwrap().clone();
    for entry in &mut entries {
        assert!(entry.as_object_mut().unwrap().remove("ms_per_tick").unwrap().as_f64().unwrap() >= 0.0);
    }
    entries
}

#[test]
fn the_json_object_has_an_entry_for_each_task_and_controller() {
    let arguments = ["--task", "arm-block", "--task", "point-mass", "--seeds", "2", "--ticks", "1300"];
    let controllers = ["--learner", "zero", "--learner", "damped-least-squares", "--learner", "actor-critic"];
    let arguments = [&arguments[..], &controllers].concat();
    let table = tasks(&arguments);
    let entries = numbers(&table);
    let names: Vec<_> = entries.iter().map(|e| (e["task"].as_str().unwrap(), e["learner"].as_str().unwrap())).collect();
    let expected = [
        ("arm-block", "zero"),
        ("arm-block", "damped-least-squares"),
        ("arm-block", "actor-critic"),
        ("point-mass", "zero"),
        ("point-mass", "actor-critic"),
    ];
    assert_eq!(names, expected);
    for entry in &entries {
        let lengths = ["ticks_to_level", "end", "reward"].map(|list| entry[list].as_array().unwrap().len());
        let is_reference = entry["reference"].as_bool().unwrap();
        assert_eq!(lengths, if is_reference { [1; 3] } else { [2; 3] }, "{entry}");
        assert_eq!(entry["seeds"], if is_reference { json!([]) } else { json!([5000, 5001]) });
        let recoveries = if entry["task"] == "point-mass" { 0 } else { lengths[0] };
        assert_eq!(entry["recovery"].as_array().unwrap().len(), recoveries, "{entry}");
    }
    // A controller that does nothing is never at the level; one that knows the arm is much better, before and after.
    assert_eq!((&entries[0]["ticks_to_level"], &entries[0]["recovery"]), (&json!([null]), &json!([null])));
    let after = |entry: usize| entries[entry]["reward_after_change"][0].as_f64().unwrap();
    assert!(after(1) > 0.2 * after(0), "{entries:#?}");
    let reward = |entry: usize| entries[entry]["reward"][0].as_f64().unwrap();
    assert!(reward(0) < reward(1) && reward(1) < 0.0, "{entries:#?}");
    assert_eq!(numbers(&tasks(&arguments)), entries, "the same seeds give the same numbers");
}

#[test]
fn a_planner_is_at_the_level_and_a_learner_comes_near_it() {
    let arguments = ["--task", "point-mass", "--learner", "ilqr"];
    let entry = numbers(&tasks(&arguments)).remove(0);
    assert_eq!((&entry["ticks_to_level"], &entry["worst_seconds_to_level"]), (&json!([0]), &json!(0.0)), "{entry}");
    assert!(entry["end"][0].as_f64().unwrap() < 0.01, "{entry}");
    let arguments = ["--task", "arm", "--learner", "learned-reward", "--seeds", "1", "--first-seed", "3"];
    let entry = numbers(&tasks(&[&arguments[..], &["--ticks", "400"]].concat())).remove(0);
    // Standing still costs 0.6 a tick.
    assert!(entry["reward"][0].as_f64().unwrap() > -0.1 && entry["end"][0].as_f64().unwrap() < 0.4, "{entry}");
}

/// A program that runs the paper's rule over a pipe, beside the same rule in this process: every number is the same, on
/// plants with other numbers of inputs, with episodes, and after a change.
#[test]
fn a_controllers_program_is_measured_as_the_rule_that_it_runs() {
    let test_folder = TestFolder::new();
    let own = own_scenario(&test_folder, "paper");
    let arguments = ["--task", "pendulum", "--task", "arm-block", "--seeds", "2", "--ticks", "1300"];
    let table = tasks_in(&test_folder, &[&arguments[..], &["--learner", &own, "--learner", "paper"]].concat());
    assert!(table["tasks"].as_array().unwrap().iter().all(|entry| entry["ms_per_tick"].as_f64().unwrap() > 0.0));
    let mut entries = numbers(&table);
    let names: Vec<Value> =
        entries.iter_mut().map(|entry| entry.as_object_mut().unwrap().remove("learner").unwrap()).collect();
    assert_eq!(names, ["own", "paper", "own", "paper"], "in the order in which they were asked for");
    assert_eq!((&entries[0], &entries[2]), (&entries[1], &entries[3]));
}

#[test]
fn a_controllers_program_that_fails_ends_the_study_with_a_sentence() {
    for (rule, code, expected) in [
        ("ends", 4, "foreign ended with exit code 7 at tick 100, before the run was over"),
        ("fails-in-tests", 4, "foreign ended with exit code 8 at tick 50, before the run was over"),
        ("none", 2, ": learner.rule is \"none\"; foreign has \"paper\", \"wide\", \"ends\","),
    ] {
        let test_folder = TestFolder::new();
        let own = own_scenario(&test_folder, rule);
        let all = ["tasks", "--task", "pendulum", "--seeds", "2", "--ticks", "200", "--learner", &own];
        let outcome = test_folder.start(TECTUM, &all).wait().expect(code);
        assert!(outcome.stderr.starts_with("tectum: own on pendulum with seed 500"), "{outcome:#?}");
        assert!(outcome.stderr.contains(expected) && outcome.stderr.lines().count() == 1, "{outcome:#?}");
        assert_eq!(outcome.stdout, "");
    }
}

#[test]
fn the_list_names_tasks_levels_and_controllers() {
    let list = tasks(&["--list"]);
    let names: Vec<&str> = list["tasks"].as_array().unwrap().iter().map(|t| t["task"].as_str().unwrap()).collect();
    for name in ["arm", "arm-relative-stops-delay-1", "so101", "pendulum", "cart-pole", "reacher", "furuta"] {
        assert!(names.contains(&name), "{name}");
    }
    for task in list["tasks"].as_array().unwrap() {
        for text in ["about", "level", "reason"] {
            assert!(!task[text].as_str().unwrap().is_empty(), "{task}");
        }
    }
    let test_folder = TestFolder::new();
    let text = test_folder.start(TECTUM, &["tasks", "--list"]).wait().expect(0).stdout;
    assert!(text.contains("arm-relative-stops-payload") && text.contains("learned-reward") && text.contains("ilqr"));
}

#[test]
fn a_folder_has_table_tests_and_a_figure_for_each_task() {
    let test_folder = TestFolder::new();
    let arguments = ["--task", "cart-pole", "--task", "point-mass", "--seeds", "2", "--ticks", "200", "--out", "run"];
    let learners = ["--learner", "actor-critic", "--learner", "zero"];
    let table = tasks_in(&test_folder, &[&arguments[..], &learners].concat());
    let file = |name: &str| std::fs::read_to_string(test_folder.run_folder().join(name)).unwrap();
    assert_eq!(
        (&table["folder"], serde_json::from_str::<Value>(&file("tasks.json")).unwrap()),
        (&"run".into(), table.clone())
    );
    let curves = file("curves.csv");
    // Four tests of two seeds, and one of the reference, on each.
    assert_eq!(curves.lines().count(), 1 + 2 * (2 * 4 + 1), "{curves}");
    assert!(curves.contains("\ncart-pole,actor-critic,5001,200,0,") && curves.contains("\npoint-mass,zero,,0,0,"));
    for (task, words) in [("cart-pole", "1 - reward a tick"), ("point-mass", "Loss a tick in the test")] {
        let figure = file(&format!("{task}.svg"));
        assert!(
            figure.contains(words) && figure.contains("of 2 seeds, 5000 to 5001") && figure.contains("actor-critic"),
            "{task}"
        );
        assert!(figure.contains("level 0.1"), "{task}");
    }
}

#[test]
fn the_table_is_text_for_people() {
    let test_folder = TestFolder::new();
    let arguments = ["tasks", "--task", "pendulum", "--learner", "energy-swing-up", "--learner", "zero"];
    let outcome = test_folder.start(TECTUM, &arguments).wait().expect(0);
    for words in ["pendulum: ", "energy-swing-up", "never", "ms a tick"] {
        assert!(outcome.stdout.contains(words), "{words}: {}", outcome.stdout);
    }
    assert_eq!(outcome.stderr, "", "no progress line outside a terminal");
}

#[test]
fn bad_input_is_refused_in_one_sentence() {
    for (arguments, message) in [
        (&["--task", "pendlum"][..], "tectum: there is no task \"pendlum\"; did you mean \"pendulum\"?"),
        (&["--task", "bicycle"], "tectum: there is no task \"bicycle\"; `tectum tasks --list` lists them"),
        (&["--learner", "learned-rewards"], "tectum: there is no learner \"learned-rewards\"; did you mean \"learned-"),
        (&["--learner", "x"], "tectum: there is no learner \"x\"; the learners and reference controllers are zero, "),
        (&["--task", "arm", "--task", "arm"], "tectum: --task names arm twice; name each once"),
        (&["--learner", "zero", "--learner", "zero"], "tectum: --learner names zero twice; name each once"),
        (&["--learner", "nowhere.toml"], "tectum: there is no scenario"),
        (&["--seeds", "0"], "tectum: --seeds is 0; give at least 1"),
        (&["--ticks", "1"], "tectum: arm: ticks is 1; give 2 to 1000000000000 ticks"),
        (&["--first-seed", "9223372036854775807"], "tectum: --first-seed and --seeds go beyond the largest seed; "),
    ] {
        let test_folder = TestFolder::new();
        let all: Vec<&str> = ["tasks"].iter().chain(arguments).copied().collect();
        let outcome = test_folder.start(TECTUM, &all).wait().expect(2);
        assert!(outcome.stderr.starts_with(message) && outcome.stderr.lines().count() == 1, "{outcome:#?}");
    }
}
