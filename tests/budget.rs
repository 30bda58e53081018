//! The tick budget: a run on the real clock says how its ticks were spent, a run in lockstep has none to say.

mod support;

use serde_json::Value;
use support::Place;

fn p50(part: &Value) -> f64 {
    part["p50"].as_f64().unwrap_or_else(|| panic!("a median in {part}"))
}

/// The learner of `arm` takes a thousand times longer than the answer, so that the two cannot be mixed up.
#[test]
fn a_realtime_run_says_how_its_ticks_were_spent() {
    let place = Place::new();
    let arm = std::fs::read_to_string("scenarios/arm.toml").unwrap().replacen("period_ms = 50", "period_ms = 20", 1);
    let scenario = place.file("arm.toml", arm).to_str().unwrap().to_owned();
    let summary = place.run(&[&scenario, "--mode", "realtime", "--ticks", "100", "--json"]).wait().expect(0).json();
    let budget = &summary["tick_budget"];
    assert_eq!(budget["period_us"], 20_000.0, "{summary}");
    for part in ["plant_us", "answer_us", "learner_us"] {
        assert!(p50(&budget[part]) > 0.0, "{part}: {budget}");
    }
    assert_eq!(budget["answer_us"]["count"], budget["learner_us"]["count"]);
    // What the learner took is its share of what there was.
    let (share, ticks) = (budget["learner_share"].as_f64().unwrap(), budget["learner_us"]["count"].as_f64().unwrap());
    assert!(share > 0.0 && share * 20_000.0 * ticks <= 1.01 * ticks * budget["learner_us"]["max"].as_f64().unwrap());
    let slack = &budget["slack_us"];
    let at = |key: &str| slack[key].as_f64().unwrap();
    assert!(at("min") <= at("p1") && at("p1") <= at("p50") && at("p50") < 20_000.0, "{budget}");
    assert!(budget["learner_overruns"].is_u64(), "{budget}");
}

#[test]
fn the_summary_for_people_shows_it() {
    let place = Place::new();
    let outcome = place.run(&["arm", "--mode", "realtime", "--ticks", "20"]).wait().expect(0);
    let at = outcome.stdout.lines().position(|l| l.starts_with("tick budget             50 ms: plant p50 ")).unwrap();
    let second = outcome.stdout.lines().nth(at + 1).unwrap();
    assert!(
        second.starts_with("                        learner p50 ") && second.contains(" % of the tick), slack p50 ")
    );
}

#[test]
fn a_lockstep_run_has_none() {
    for mode in ["lockstep", "in-process"] {
        let place = Place::new();
        let summary = place.run(&["arm", "--mode", mode, "--ticks", "50", "--json"]).wait().expect(0).json();
        assert_eq!(summary.get("tick_budget"), Some(&Value::Null), "{mode}");
    }
    let place = Place::new();
    let outcome = place.run(&["arm", "--ticks", "50"]).wait().expect(0);
    assert!(!outcome.stdout.contains("tick budget"), "{outcome:#?}");
}

/// A learner that takes longer than the tick: the overruns are counted, the ticks that it cost are missed, and nothing
/// is learned from those.
#[test]
fn a_learner_that_overruns_the_tick_is_counted() {
    let place = Place::new();
    let arm = std::fs::read_to_string("scenarios/arm.toml")
        .unwrap()
        .replacen("period_ms = 50", "period_ms = 1", 1)
        .replacen("rule = \"learned-reward\"", "rule = \"learned-reward\"\n\n[learner.model]\nsteps = 20", 1);
    let scenario = place.file("arm.toml", arm).to_str().unwrap().to_owned();
    let summary = place.run(&[&scenario, "--mode", "realtime", "--ticks", "300", "--json"]).wait().expect(0).json();
    assert!(summary["tick_budget"]["learner_overruns"].as_u64() > Some(0), "{summary}");
    assert!(summary["missed"].as_u64() > Some(0), "{summary}");
    assert_eq!(summary["tick_budget"]["slack_us"]["min"], 0.0, "{summary}");
}
