//! The tick budget: a run in real time reports how its ticks were spent. A run in lockstep has no budget.

mod support;

use serde_json::Value;
use support::TestFolder;

fn p50(part: &Value) -> f64 {
    part["p50"].as_f64().unwrap_or_else(|| panic!("a median in {part}"))
}

/// The learner of `arm` takes a thousand times longer than the answer, so that the two cannot be confused.
#[test]
fn a_realtime_run_reports_its_tick_budget() {
    let test_folder = TestFolder::new();
    let arm = std::fs::read_to_string("scenarios/arm.toml").unwrap().replacen("period_ms = 50", "period_ms = 20", 1);
    let scenario = test_folder.write_file("arm.toml", arm).to_str().unwrap().to_owned();
    let summary =
        test_folder.run(&[&scenario, "--mode", "realtime", "--ticks", "100", "--json"]).wait().expect(0).json();
    let budget = &summary["tick_budget"];
    assert_eq!(budget["period_us"], 20_000.0, "{summary}");
    for part in ["plant_us", "answer_us", "learner_us"] {
        assert!(p50(&budget[part]) > 0.0, "{part}: {budget}");
    }
    assert_eq!(budget["answer_us"]["count"], budget["learner_us"]["count"]);
    // The learner's time is its share of the time available.
    let (share, ticks) = (budget["learner_share"].as_f64().unwrap(), budget["learner_us"]["count"].as_f64().unwrap());
    assert!(share > 0.0 && share * 20_000.0 * ticks <= 1.01 * ticks * budget["learner_us"]["max"].as_f64().unwrap());
    let slack = &budget["slack_us"];
    let at = |key: &str| slack[key].as_f64().unwrap();
    assert!(at("min") <= at("p1") && at("p1") <= at("p50") && at("p50") < 20_000.0, "{budget}");
    assert!(budget["learner_overruns"].is_u64(), "{budget}");
}

#[test]
fn the_text_summary_shows_the_tick_budget() {
    let test_folder = TestFolder::new();
    let outcome = test_folder.run(&["arm", "--mode", "realtime", "--ticks", "20"]).wait().expect(0);
    let at = outcome.stdout.lines().position(|l| l.starts_with("tick budget             50 ms: plant p50 ")).unwrap();
    let second = outcome.stdout.lines().nth(at + 1).unwrap();
    assert!(
        second.starts_with("                        learner p50 ") && second.contains(" % of the tick), slack p50 ")
    );
}

#[test]
fn a_lockstep_run_has_no_tick_budget() {
    for mode in ["lockstep", "in-process"] {
        let test_folder = TestFolder::new();
        let summary = test_folder.run(&["arm", "--mode", mode, "--ticks", "50", "--json"]).wait().expect(0).json();
        assert_eq!(summary.get("tick_budget"), Some(&Value::Null), "{mode}");
    }
    let test_folder = TestFolder::new();
    let outcome = test_folder.run(&["arm", "--ticks", "50"]).wait().expect(0);
    assert!(!outcome.stdout.contains("tick budget"), "{outcome:#?}");
}

/// A learner that takes longer than the tick: its overruns are counted, and the ticks that it delays are missed.
#[test]
fn learner_overruns_are_counted() {
    let test_folder = TestFolder::new();
    let arm = std::fs::read_to_string("scenarios/arm.toml")
        .unwrap()
        .replacen("period_ms = 50", "period_ms = 1", 1)
        .replacen("rule = \"model-predictive\"", "rule = \"learned-reward\"\n\n[learner.model]\nsteps = 20", 1);
    let scenario = test_folder.write_file("arm.toml", arm).to_str().unwrap().to_owned();
    let summary =
        test_folder.run(&[&scenario, "--mode", "realtime", "--ticks", "300", "--json"]).wait().expect(0).json();
    assert!(summary["tick_budget"]["learner_overruns"].as_u64() > Some(0), "{summary}");
    assert!(summary["missed"].as_u64() > Some(0), "{summary}");
    assert_eq!(summary["tick_budget"]["slack_us"]["min"], 0.0, "{summary}");
}
