//! A run that did not go well says so, by name and with a number: in the summary, in `--json` and in the log. Some
//! kinds make it fail.

mod support;
#[path = "support/wayward.rs"]
mod wayward;

use serde_json::Value;
use support::{ProcessOutcome, TestFolder};
use tectum::runtime::{Controller, PlantSide, RunWarning, in_process, judge};
use tectum::scenario::Scenario;
use tectum::wire::{Command, Observation};
use wayward::Wayward;

const TICKS: u64 = 600;

/// The scenario of a plant that behaves as `behaviour` says, with `more` in place of its learner and gate.
fn scenario(behaviour: &str, more: &str) -> String {
    let program = support::example("wayward");
    let signal =
        |kind: &str, name: &str| format!("[[plant.{kind}]]\nname = \"{name}\"\nunit = \"m\"\nmin = -1.0\nmax = 1.0\n");
    format!(
        "name = \"{behaviour}\"\nticks = {TICKS}\nperiod_ms = 10\n[plant]\nprogram = \"{}\"\nmeasures = [\"error\"]\n\
         {}{}{}[[encoder.maps]]\ninputs = [\"position\", \"target\"]\nunits = [12, 12]\nradius = 0.2\n\
         [policy]\nsigma = 0.2\n{more}\n[log]\nevery = 1\n",
        program.display(),
        signal("inputs", "position"),
        signal("inputs", "target"),
        signal("outputs", "speed"),
    )
}

const PAPER: &str = "[gate]\nmax_command = 1.0\n[learner]\nalpha_over_variance = 0.01";

/// The warnings of a run in this process, as name, count and failure.
fn judged(behaviour: &str, more: &str) -> Vec<(String, u64, bool)> {
    let plan = Scenario::parse(&scenario(behaviour, more), behaviour).unwrap().plan().unwrap();
    let run = in_process(&plan, Wayward::of(&plan), |_, _| true);
    brief(&judge(&plan, &run.plant, Some(&run.controller)))
}

fn brief(warnings: &[RunWarning]) -> Vec<(String, u64, bool)> {
    warnings.iter().map(|warning| (warning.key(), warning.count.unwrap(), warning.failure)).collect()
}

#[test]
fn every_kind_is_noticed_and_no_other() {
    let one = |name: &str, count: u64, failure: bool| vec![(name.to_owned(), count, failure)];
    assert_eq!(judged("well", PAPER), []);
    assert_eq!(judged("stuck", PAPER), one("input-constant.position", TICKS, false));
    assert_eq!(judged("constant-reward", PAPER), one("reward-constant", TICKS - 1, false));
    let outside = judged("outside", PAPER);
    assert!(
        outside.len() == 1 && outside[0].0 == "input-outside-range.target" && outside[0].1.is_multiple_of(40),
        "{outside:?}"
    );
    let nan = [one("reward-not-finite", TICKS - 101, false), one("little-learned", TICKS - 101, false)].concat();
    assert_eq!(judged("nan-reward", PAPER), nan);
    let none = judged("no-reward", PAPER);
    assert_eq!(none[0], ("reward-not-finite".to_owned(), TICKS - 1, true));
    assert_eq!(none[1..], [one("little-learned", TICKS - 1, false), one("weights-zero", TICKS, false)].concat());
    let model =
        "[gate]\nmax_command = 1.0\n[learner]\nrule = \"learned-reward\"\n[learner.model]\nmoved = [\"position\"]";
    assert_eq!(judged("outlier", model), one("reward-outliers", 1, false));
    // Observation 101 brings the reward of tick 100.
    assert_eq!(judged("huge-reward", PAPER), one("learner-halted", TICKS - 101, true));
    let idle = "[gate]\nmax_command = 1.0\n[learner]\nalpha_over_variance = 0.0";
    assert_eq!(judged("idle", idle), one("weights-zero", TICKS, false));
    let stiff = "[gate]\nmax_command = 1.0\nmax_step = 1e-6\n[learner]\nalpha_over_variance = 0.01";
    let stiff = judged("stiff", stiff);
    assert!(stiff[0].0 == "command-limited.speed" && stiff[0].1 >= TICKS * 9 / 10, "{stiff:?}");
}

/// The plant passes over a tick before each that it begins, and so nothing can be learned at all.
#[test]
fn a_plant_that_is_always_late_has_failed() {
    let plan = Scenario::parse(&scenario("well", PAPER), "late").unwrap().plan().unwrap();
    let (mut side, mut controller) = (PlantSide::new(Wayward::of(&plan), &plan), Controller::new(&plan));
    let (mut observation, mut command) = (Observation::default(), Command::default());
    for tick in (0..TICKS).step_by(2) {
        side.observe(tick, 0, u32::from(tick > 0), &mut observation);
        controller.respond(&observation, &mut command);
        controller.after_command(&observation);
        side.step(tick, Some(&command));
        side.skip(tick + 1, tick + 2);
    }
    let warnings = brief(&judge(&plan, side.report(), Some(&controller.finish())));
    assert_eq!(warnings[0], ("ticks-passed-over".to_owned(), TICKS / 2, true));
    assert_eq!(warnings[1], ("little-learned".to_owned(), TICKS / 2 - 1, false));
}

/// Runs `behaviour` as three processes.
fn run(test_folder: &TestFolder, behaviour: &str, more: &str, arguments: &[&str]) -> ProcessOutcome {
    let file = test_folder.write_file("my.toml", scenario(behaviour, more));
    test_folder.run(&[&[file.to_str().unwrap()], arguments].concat()).wait()
}

fn names(warnings: &Value) -> Vec<&str> {
    warnings.as_array().unwrap().iter().map(|warning| warning["name"].as_str().unwrap()).collect()
}

#[test]
fn summary_json_and_log_say_the_same() {
    let test_folder = TestFolder::new();
    let summary = run(&test_folder, "nan-reward", PAPER, &["--json"]).expect(0).json();
    let warnings = &summary["warnings"];
    assert_eq!(names(warnings), ["reward-not-finite", "little-learned"]);
    assert_eq!((&warnings[0]["count"], &warnings[0]["of"]), (&499.into(), &599.into()));
    assert!(summary["failure"].is_null(), "{summary}");
    let log = test_folder.log_path();
    let info = test_folder.tectum("log", &["info", log.to_str().unwrap(), "--json"]).expect(0).json();
    let text = test_folder.tectum("log", &["info", log.to_str().unwrap()]).expect(0).stdout;
    for warning in warnings.as_array().unwrap() {
        assert_eq!(info["warnings"][warning["name"].as_str().unwrap()], warning["text"], "{info}");
        assert!(text.contains(warning["text"].as_str().unwrap()), "{text}");
    }
    // The text for people.
    let test_folder = TestFolder::new();
    let text = run(&test_folder, "nan-reward", PAPER, &[]).expect(0).stdout;
    assert!(text.contains("reward-not-finite: 499 of 599 rewards were not finite, and nothing was learned"), "{text}");
}

#[test]
fn a_killed_controller_still_knows_what_it_counted() {
    let kill = "\n[[faults.process]]\nprocess = \"controller\"\ndo = \"kill\"\nat = [350]\n";
    let [calm, killed] = ["", kill].map(|faults| {
        let test_folder = TestFolder::new();
        let summary = run(&test_folder, "nan-reward", &format!("{PAPER}{faults}"), &["--json"]).expect(0).json();
        let controller = support::read_json(test_folder.run_folder().join("controller.json"));
        (summary["warnings"].clone(), controller["counts"].clone(), summary["restarts"].as_array().unwrap().len())
    });
    assert_eq!((calm.2, killed.2), (0, 1));
    assert_eq!((&calm.0, &calm.1), (&killed.0, &killed.1));
}

#[test]
fn a_run_without_a_single_reward_fails() {
    let test_folder = TestFolder::new();
    let outcome = run(&test_folder, "no-reward", PAPER, &["--json"]).expect(4);
    let summary = outcome.json();
    let sentence = "599 of 599 rewards were not finite, so nothing could be learned";
    assert!(summary["failure"].as_str().unwrap().starts_with(sentence), "{summary}");
    assert!(outcome.stderr.contains(sentence), "{}", outcome.stderr);
}

#[test]
fn a_plant_that_is_late_in_every_tick_fails_in_real_time() {
    let test_folder = TestFolder::new();
    let outcome = run(&test_folder, "late", PAPER, &["--mode", "realtime", "--ticks", "150", "--json"]).expect(4);
    let summary = outcome.json();
    assert_eq!(names(&summary["warnings"])[0], "ticks-passed-over");
    assert!(summary["failure"].as_str().unwrap().contains("the plant passed over"), "{summary}");
}
