//! `tectum compare`: the shape of its JSON object, its files, and the same numbers for the same seeds.

mod support;

use serde_json::Value;
use support::{TECTUM, TestFolder, children, example};

/// A quick comparison: few ticks and a rough optimum.
const QUICK: [&str; 8] = ["compare", "--json", "--out", "run", "--starts", "1", "--ticks", "3000"];

/// Runs a quick comparison and returns its JSON object.
fn compare(more: &[&str]) -> (TestFolder, Value) {
    let test_folder = TestFolder::new();
    let all: Vec<&str> = QUICK.iter().chain(more).copied().collect();
    let outcome = test_folder.start(TECTUM, &all).wait().expect(0);
    let json = outcome.json();
    (test_folder, json)
}

/// The object without times and machine, which differ from call to call.
fn numbers(mut json: Value) -> Value {
    for key in ["seconds", "machine"] {
        json.as_object_mut().unwrap().remove(key).unwrap();
    }
    for learner in json["learners"].as_array_mut().unwrap() {
        for key in ["ns_per_tick", "cost_ns"] {
            learner.as_object_mut().unwrap().remove(key).unwrap();
        }
    }
    json
}

#[test]
fn the_json_object_holds_every_result() {
    let (test_folder, json) = compare(&["--learners", "paper,actor-critic", "--seeds", "2", "--block", "2000"]);
    assert_eq!((&json["level"], &json["seeds"]), (&0.0375.into(), &serde_json::json!([1000, 1001])));
    let learners = json["learners"].as_array().unwrap();
    assert_eq!(learners.iter().map(|l| l["name"].as_str().unwrap()).collect::<Vec<_>>(), ["paper", "actor-critic"]);
    for learner in learners {
        for list in ["ticks_to_level", "ticks_to_recover", "weights_hash", "diverged_at"] {
            assert_eq!(learner[list].as_array().unwrap().len(), 2, "{list}");
        }
        assert!(learner["ticks_to_level"][0].is_null(), "no learner reaches that in 2,000 ticks");
        let at = &learner["loss_at"]["1000"];
        let losses = ["min", "median", "max"].map(|key| at[key].as_f64().unwrap());
        assert!(losses.is_sorted() && losses[0] > 0.0375 && losses[2] < 1.0, "{losses:?}");
        assert!(learner["loss_at"]["10000"].is_null() && learner["loss_at"]["10000000"].is_null());
        assert!(learner["ns_per_tick"].as_f64().unwrap() > 0.0 && learner["diverged"] == 0);
        assert_eq!(learner["changes"][0]["tick"], 2000);
        assert!(learner["share_of_gap"]["median"].as_f64().unwrap() > 0.1);
    }
    for world in ["unblocked", "blocked"] {
        let loss = |name: &str| json["references"][name][world]["loss"].as_f64().unwrap();
        let losses = ["trajectory-optimum", "damped-least-squares", "random", "zero"].map(loss);
        assert!(losses.is_sorted(), "{world}: {losses:?}");
    }

    let file = |name: &str| std::fs::read_to_string(test_folder.run_folder().join(name)).unwrap();
    let rows = file("compare.csv");
    assert_eq!(rows.lines().count(), 1 + 4);
    assert!(rows.starts_with("learner,seed,ticks,ticks_to_level,loss_at_1000,"));
    assert!(rows.lines().all(|row| row.split(',').count() == rows.lines().next().unwrap().split(',').count()));
    assert!(file("curves.csv").lines().any(|row| row.starts_with("actor-critic,1001,2000,0,")));
    assert!(file("curves.csv").lines().any(|row| row.starts_with("actor-critic,1001,3000,1,")));
    assert_eq!(serde_json::from_str::<Value>(&file("compare.json")).unwrap(), json);
    let figure = file("figure.svg");
    assert!(figure.contains("actor-critic") && figure.contains("joint 3 blocked") && figure.contains("level 0.0375"));
}

#[test]
fn the_same_seeds_give_the_same_numbers() {
    let arguments = ["--learners", "learned-reward,baseline", "--ticks", "300", "--seeds", "2", "--first-seed", "7"];
    let quick = |arguments: &[&str]| {
        let test_folder = TestFolder::new();
        let all: Vec<&str> = QUICK[..6].iter().chain(arguments).copied().collect();
        numbers(test_folder.start(TECTUM, &all).wait().expect(0).json())
    };
    let one = quick(&arguments);
    assert_eq!(one, quick(&arguments));
    let set = quick(&[&arguments[..], &["--set", "policy.sigma=0.004"]].concat());
    assert_ne!(one["learners"][0]["weights_hash"], set["learners"][0]["weights_hash"]);
}

#[test]
fn the_text_output_has_tables() {
    let test_folder = TestFolder::new();
    let arguments = ["compare", "--learners", "paper", "--ticks", "500", "--seeds", "1", "--starts", "1"];
    let text = test_folder.start(TECTUM, &arguments).wait().expect(0).stdout;
    for words in ["seed 1000: ", "to the level", "paper", "never", "trajectory-optimum", "runs/compare-1/figure.svg"] {
        assert!(text.contains(words), "{words}: {text}");
    }
    assert!(test_folder.path().join("runs/compare-1/compare.csv").exists());
}

#[test]
fn bad_input_is_refused_and_leaves_no_files() {
    for (arguments, message) in [
        (&["--learners", "papers"][..], "tectum: there is no learner \"papers\"; the learners are paper, baseline, "),
        (&["--learners", "paper,paper"], "tectum: --learners names paper twice; "),
        (&["--seeds", "0"], "tectum: --seeds is 0; "),
        (&["--block", "soon"], "tectum: --block soon: it is not a number; "),
        (&["--learners", "paper", "--set", "learner.beta=1"], "tectum: paper: learner.beta is 1; give at least 0"),
        (&["--learners", "paper", "--change", "block:9@50"], "tectum: paper: plant.arm.block[0].joint is 9; "),
    ] {
        let test_folder = TestFolder::new();
        let all: Vec<&str> = QUICK.iter().chain(arguments).copied().collect();
        let outcome = test_folder.start(TECTUM, &all).wait().expect(2);
        assert!(outcome.stderr.starts_with(message) && outcome.stderr.lines().count() == 1, "{outcome:#?}");
        assert!(!test_folder.run_folder().exists());
    }
}

#[test]
fn ctrl_c_ends_a_comparison_and_leaves_no_files() {
    let test_folder = TestFolder::new();
    let arguments = ["compare", "--learners", "paper", "--ticks", "1000000000", "--seeds", "2", "--out", "run"];
    let mut run = test_folder.start(TECTUM, &arguments);
    let folder = test_folder.run_folder();
    run.wait_until("its folder", || folder.exists());
    run.signal("INT");
    let outcome = run.wait().expect(130);
    assert!(outcome.stderr.contains("so there are none"), "{outcome:#?}");
    assert!(!folder.exists());
}

/// A scenario of the built-in arm with a controller's program of one's own. Returns its path.
fn own_scenario(test_folder: &TestFolder, program: &str, learner: &str) -> String {
    let text = std::fs::read_to_string("scenarios/arm.toml").unwrap();
    let (head, rest) = text.split_once("[learner]").unwrap();
    let (_, gate) = rest.split_once("# The gate").unwrap();
    let program = format!("{:?}", example(program));
    let head = head.replace("\"tectum-controller\"", &program).replace("sigma = 0.001", "sigma = 0.003");
    let head = head.replace("name = \"arm\"", "name = \"own\"");
    let text = format!("{head}[learner]\n{learner}\n\n[restart]\nhang_s = 0\n\n# The gate{gate}");
    test_folder.write_file("own.toml", text).to_str().unwrap().to_owned()
}

/// A program that runs the paper's rule over a pipe, beside the same rule in this process: every number is the same.
#[test]
fn a_controllers_program_is_measured_as_the_rule_that_it_runs() {
    let test_folder = TestFolder::new();
    let learners = format!("paper,{}", own_scenario(&test_folder, "foreign", "rule = \"paper\"\ncalled = \"mine\""));
    let arguments = ["compare", "--json", "--out", "run", "--starts", "1", "--ticks", "300", "--seeds", "2"];
    let more = ["--block", "200", "--learners", &learners];
    let json = test_folder.start(TECTUM, &[&arguments[..], &more].concat()).wait().expect(0).json();
    let learners = numbers(json)["learners"].as_array().unwrap().clone();
    let [paper, own] = &learners[..] else { panic!("two learners: {learners:?}") };
    assert_eq!((&paper["name"], &own["name"]), (&"paper".into(), &"own".into()));
    assert_eq!(own["settings"], serde_json::json!({ "rule": "paper", "called": "mine" }));
    for (key, value) in paper.as_object().unwrap().iter().filter(|(key, _)| *key != "name" && *key != "settings") {
        assert_eq!(own[key], *value, "{key}");
    }
    let curves = std::fs::read_to_string(test_folder.run_folder().join("curves.csv")).unwrap();
    let of = |name: &str| -> Vec<String> {
        let rows = curves.lines().filter_map(|row| row.split_once(',')).filter(|(learner, _)| *learner == name);
        rows.map(|(_, numbers)| numbers.to_owned()).collect()
    };
    assert_eq!(of("paper"), of("own"));
    assert_eq!(of("own").len(), 2 * (10 + 5), "tests every 20 ticks, from the beginning and from the change");
}

/// A test leaves no trace in the state of an agent with a memory and a random stream.
#[test]
fn a_test_changes_nothing_in_a_controllers_run() {
    let test_folder = TestFolder::new();
    let learner =
        "rule = \"pd\"\nposition = \"theta_1\"\ntarget = \"target_x\"\ngain = 0.002\ndamping = 0.005\ntrial = 20";
    let own = own_scenario(&test_folder, "pd", learner);
    let run = ["run", &own, "--mode", "in-process", "--ticks", "200", "--seed", "1001", "--json", "--out", "alone"];
    let alone = test_folder.start(TECTUM, &run).wait().expect(0).json();
    let arguments = ["compare", "--json", "--starts", "1", "--ticks", "200", "--seeds", "2"];
    let compare = |more: &[&str]| {
        let all = [&arguments[..], &["--learners", &own], more].concat();
        test_folder.start(TECTUM, &all).wait().expect(0).json()["learners"][0].clone()
    };
    let never = compare(&["--block", "never"]);
    assert_eq!(never["weights_hash"][1], alone["weights_hash"], "{never}");
    let usual = compare(&[]);
    assert_eq!(usual["changes"][0]["tick"], 100, "the usual block comes in the middle");
    assert_ne!(usual["weights_hash"][1], alone["weights_hash"]);
}

#[test]
fn a_controllers_program_that_fails_ends_the_comparison_with_a_sentence() {
    for (learner, code, expected) in [
        ("rule = \"ends\"", 4, "foreign ended with exit code 7 at tick 100, before the run was over"),
        ("rule = \"fails-in-tests\"", 4, "foreign ended with exit code 8 at tick 20, before the run was over"),
        ("rule = \"none\"", 2, ": learner.rule is \"none\"; foreign has \"paper\", \"wide\", \"ends\","),
    ] {
        let test_folder = TestFolder::new();
        let own = own_scenario(&test_folder, "foreign", learner);
        let all: Vec<&str> = QUICK.iter().chain(&["--learners", &own]).copied().collect();
        let outcome = test_folder.start(TECTUM, &all).wait().expect(code);
        assert!(outcome.stderr.starts_with("tectum: own with seed 100"), "{outcome:#?}");
        assert!(outcome.stderr.contains(expected) && outcome.stderr.lines().count() == 1, "{outcome:#?}");
        assert!(!test_folder.run_folder().exists());
    }
    let test_folder = TestFolder::new();
    let all: Vec<&str> = QUICK.iter().chain(&["--learners", "pendulum.toml"]).copied().collect();
    let refused = test_folder.start(TECTUM, &all).wait().expect(2).stderr;
    assert!(refused.contains("has another plant than the simulator's arm"), "{refused}");
}

/// Also where the program never answers and may take any time.
#[test]
fn ctrl_c_ends_a_comparison_with_a_program_that_hangs() {
    let test_folder = TestFolder::new();
    let own = own_scenario(&test_folder, "foreign", "rule = \"hangs\"");
    let mut run = test_folder.start(TECTUM, &["compare", "--learners", &own, "--seeds", "2", "--out", "run"]);
    let id = run.id();
    run.wait_until("a controller that hangs", || test_folder.path().join("hangs").exists());
    let started = children(id);
    run.signal("INT");
    let outcome = run.wait().expect(130);
    assert!(outcome.stderr.contains("so there are none"), "{outcome:#?}");
    assert!(!test_folder.run_folder().exists());
    assert!(!started.is_empty() && started.iter().all(|(pid, _)| support::has_ended(*pid)), "{started:?}");
}
