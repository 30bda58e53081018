//! `tectum compare` as its users start it: the shape of its object, its files, and the same numbers again.

mod support;

use serde_json::Value;
use support::{Place, TECTUM};

/// Quick: few ticks, one or two seeds, and a rough optimum.
const QUICK: [&str; 8] = ["compare", "--json", "--out", "run", "--starts", "1", "--ticks", "3000"];

fn compared(more: &[&str]) -> (Place, Value) {
    let place = Place::new();
    let all: Vec<&str> = QUICK.iter().chain(more).copied().collect();
    let outcome = place.start(TECTUM, &all).wait().expect(0);
    let json = outcome.json();
    (place, json)
}

/// Everything but times and machine.
fn lasting(mut json: Value) -> Value {
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
fn one_object_says_it_all() {
    let (place, json) = compared(&["--learners", "paper,actor-critic", "--seeds", "2", "--block", "2000"]);
    assert_eq!((&json["level"], &json["seeds"]), (&0.0375.into(), &serde_json::json!([1000, 1001])));
    let learners = json["learners"].as_array().unwrap();
    assert_eq!(learners.iter().map(|l| l["name"].as_str().unwrap()).collect::<Vec<_>>(), ["paper", "actor-critic"]);
    for learner in learners {
        for list in ["ticks_to_level", "ticks_to_recover", "weights_hash", "diverged_at"] {
            assert_eq!(learner[list].as_array().unwrap().len(), 2, "{list}");
        }
        assert!(learner["ticks_to_level"][0].is_null(), "nobody learns that in 2,000 ticks");
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

    let file = |name: &str| std::fs::read_to_string(place.run_folder().join(name)).unwrap();
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
        let place = Place::new();
        let all: Vec<&str> = QUICK[..6].iter().chain(arguments).copied().collect();
        lasting(place.start(TECTUM, &all).wait().expect(0).json())
    };
    let one = quick(&arguments);
    assert_eq!(one, quick(&arguments));
    let set = quick(&[&arguments[..], &["--set", "policy.sigma=0.004"]].concat());
    assert_ne!(one["learners"][0]["weights_hash"], set["learners"][0]["weights_hash"]);
}

#[test]
fn people_get_tables() {
    let place = Place::new();
    let arguments = ["compare", "--learners", "paper", "--ticks", "500", "--seeds", "1", "--starts", "1"];
    let said = place.start(TECTUM, &arguments).wait().expect(0).stdout;
    for words in ["seed 1000: ", "to the level", "paper", "never", "trajectory-optimum", "runs/compare-1/figure.svg"] {
        assert!(said.contains(words), "{words}: {said}");
    }
    assert!(place.path().join("runs/compare-1/compare.csv").exists());
}

#[test]
fn what_makes_no_sense_is_refused_and_leaves_nothing() {
    for (arguments, message) in [
        (&["--learners", "papers"][..], "tectum: there is no learner \"papers\"; the learners are paper, baseline, "),
        (&["--learners", "paper,paper"], "tectum: --learners names paper twice; "),
        (&["--seeds", "0"], "tectum: --seeds is 0; "),
        (&["--block", "soon"], "tectum: --block soon: it is not a number; "),
        (&["--learners", "paper", "--set", "learner.beta=1"], "tectum: paper: learner.beta is 1; give at least 0"),
        (&["--learners", "paper", "--change", "block:9@50"], "tectum: paper: plant.arm.block[0].joint is 9; "),
    ] {
        let place = Place::new();
        let all: Vec<&str> = QUICK.iter().chain(arguments).copied().collect();
        let outcome = place.start(TECTUM, &all).wait().expect(2);
        assert!(outcome.stderr.starts_with(message) && outcome.stderr.lines().count() == 1, "{outcome:#?}");
        assert!(!place.run_folder().exists());
    }
}

#[test]
fn ctrl_c_ends_it_and_leaves_nothing() {
    let place = Place::new();
    let arguments = ["compare", "--learners", "paper", "--ticks", "1000000000", "--seeds", "2", "--out", "run"];
    let mut run = place.start(TECTUM, &arguments);
    let folder = place.run_folder();
    run.until("its folder", || folder.exists());
    run.signal("INT");
    let outcome = run.wait().expect(130);
    assert!(outcome.stderr.contains("so there are none"), "{outcome:#?}");
    assert!(!folder.exists());
}
