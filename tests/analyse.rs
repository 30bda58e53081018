//! `tectum analyse` on the logs of real runs, and on what is none.

mod support;

use std::fs;

use serde_json::Value;
use support::{Outcome, Place, TECTUM};

/// A run of the arm, `ticks` long, with these changes to its scenario.
fn ran(place: &Place, changes: &[(&str, &str)], ticks: &str) {
    let scenario = place.arm(changes);
    place.run(&[&scenario, "--ticks", ticks]).wait().expect(0);
}

fn analysed(place: &Place, arguments: &[&str]) -> Outcome {
    let mut all = vec!["analyse"];
    all.extend(arguments);
    place.start(TECTUM, &all).wait()
}

/// Refused as bad input, in one message.
#[track_caller]
fn refused(place: &Place, arguments: &[&str]) -> String {
    let outcome = analysed(place, arguments).expect(2);
    assert_eq!(outcome.stderr.lines().count(), 1, "{outcome:#?}");
    assert_eq!(outcome.stdout, "");
    outcome.stderr.trim().to_owned()
}

#[test]
fn a_runs_movements_are_measured_with_noise_and_without() {
    let place = Place::new();
    ran(&place, &[("every", "1")], "2400");
    let analysis = analysed(&place, &["run", "--json"]).expect(0).json();
    // A target every 80 ticks: 30, of which the first has no measured start and the last no end.
    assert_eq!(analysis["n"], 28, "{analysis}");
    assert_eq!(analysis["left_out"], serde_json::json!({ "without_start": 1, "gaps": 0, "unfinished": 1 }));
    assert_eq!((&analysis["torn"], &analysis["noiseless_missing"]), (&Value::Bool(false), &Value::Null));
    for view in ["noiseless", "measured"] {
        let view = &analysis[view];
        assert_eq!((&view["all"]["n"], &view["early"]["n"], &view["late"]["n"]), (&28.into(), &10.into(), &10.into()));
        assert_eq!((&view["early"]["from"], &view["late"]["to"]), (&80.into(), &2240.into()));
        assert!(view["all"]["completed"].as_f64().is_some(), "{analysis}");
    }
    let median = |view: &str, measure: &str| {
        let value = &analysis[view]["all"]["measures"][measure]["median"];
        value.as_f64().unwrap_or_else(|| panic!("{view} {measure}: {analysis}"))
    };
    // The paper's rule has hardly begun: the noise shakes the arm, and what the policy itself does is smooth.
    assert_eq!(median("noiseless", "distance_m"), median("measured", "distance_m"));
    assert!(median("measured", "peaks") >= 8.0 && median("noiseless", "peaks") <= 4.0);
    assert!(median("measured", "straightness") > 2.0 * median("noiseless", "straightness"));

    let folder = place.run_folder();
    let written: Value = serde_json::from_str(&fs::read_to_string(folder.join("analysis.json")).unwrap()).unwrap();
    assert!(written == analysis);
    assert!(fs::read_to_string(folder.join("movements.svg")).unwrap().starts_with("<svg "));
    let csv = fs::read_to_string(folder.join("movements.csv")).unwrap();
    let rows: Vec<Vec<&str>> = csv.lines().map(|line| line.split(',').collect()).collect();
    assert_eq!(rows.len(), 29);
    assert!(rows.iter().all(|row| row.len() == rows[0].len()), "{csv}");
    assert_eq!((rows[1][0], rows[1][1], rows[28][0]), ("80", "80", "2240"));

    // The log alone says it all: from elsewhere, into elsewhere, and for people.
    let log = folder.join("log.mcap");
    let text = analysed(&place, &[log.to_str().unwrap(), "--out", "deep/down"]).expect(0).stdout;
    for words in ["28 movements in 2,400 ticks", "medians, without exploration noise", "isochrony, last 10: duration"] {
        assert!(text.contains(words), "{words}: {text}");
    }
    assert_eq!(csv, fs::read_to_string(place.path().join("deep/down/movements.csv")).unwrap());

    let bare = analysed(&place, &["run", "--measured-only", "--out", "bare", "--json"]).expect(0).json();
    assert_eq!((&bare["noiseless"], &bare["measured"]), (&Value::Null, &analysis["measured"]));
}

#[test]
fn a_torn_log_is_analysed_as_far_as_it_goes() {
    let place = Place::new();
    ran(&place, &[("every", "1")], "1000");
    let whole = fs::read(place.run_folder().join("log.mcap")).unwrap();
    let torn = place.file("torn.mcap", &whole[..whole.len() / 2]);
    let analysis = analysed(&place, &[torn.to_str().unwrap(), "--json"]).expect(0).json();
    assert_eq!(analysis["torn"], true);
    let n = analysis["n"].as_u64().unwrap();
    assert!((3..=5).contains(&n), "half of 1000 ticks: {analysis}");
    assert_eq!(analysis["noiseless"]["all"]["n"], n);
    let text = analysed(&place, &[torn.to_str().unwrap()]).expect(0).stdout;
    assert!(text.contains("The log was cut off; it was analysed as far as it goes."), "{text}");
}

/// A log whose learning another build, or another hand, has made: the movements without noise end where it is noticed.
#[test]
fn a_log_that_cannot_be_followed_is_analysed_as_measured() {
    let place = Place::new();
    ran(&place, &[("every", "1")], "1000");
    let mut log = fs::read(place.run_folder().join("log.mcap")).unwrap();
    // Another seed in the scenario of the log, of as many letters: other targets and other noise from the first tick on.
    let at = log.windows(9).position(|w| w == b"\nseed = 1").unwrap();
    log[at + 8] = b'2';
    // Torn, so that no checksum tells it first.
    let other = place.file("other.mcap", &log[..log.len() * 9 / 10]);
    let analysis = analysed(&place, &[other.to_str().unwrap(), "--json"]).expect(0).json();
    assert!(analysis["n"].as_u64() >= Some(8), "{analysis}");
    assert_eq!((&analysis["torn"], &analysis["noiseless"]), (&Value::Bool(true), &Value::Null));
    let why = analysis["noiseless_missing"].as_str().unwrap();
    assert!(why.starts_with("from tick 0 on the log is not what this build makes of it"), "{why}");
}

#[test]
fn logs_that_say_too_little_are_refused_with_the_remedy() {
    let place = Place::new();
    ran(&place, &[("every", "7")], "1000");
    let said = refused(&place, &["run"]);
    assert!(said.starts_with("tectum: the log run/log.mcap holds every 7th tick only"), "{said}");
    assert!(said.ends_with("with `every = 1` under [log]"), "{said}");

    let place = Place::new();
    ran(&place, &[("every", "1")], "100");
    let said = refused(&place, &["run"]);
    assert!(said.contains("holds no whole movement") && said.contains("make a longer run"), "{said}");

    let place = Place::new();
    let eye = fs::read_to_string("scenarios/eye.toml").unwrap();
    let every = eye.lines().find(|line| line.starts_with("every = ")).unwrap().to_owned();
    let scenario = place.file("eye.toml", eye.replacen(&every, "every = 1", 1)).to_str().unwrap().to_owned();
    place.run(&[&scenario, "--ticks", "50"]).wait().expect(0);
    let said = refused(&place, &["run"]);
    assert!(said.contains("does not measure `end_x and end_y`") && said.contains("[plant] measures"), "{said}");
    assert!(!place.run_folder().join("analysis.json").exists());
}

#[test]
fn what_is_no_log_is_refused() {
    let place = Place::new();
    assert_eq!(refused(&place, &["nowhere"]), "tectum: nowhere does not exist; give a log, or the folder of a run");
    fs::create_dir(place.path().join("empty")).unwrap();
    assert!(refused(&place, &["empty"]).contains("empty is a folder without a log.mcap"));
    for (name, bytes) in [("text.mcap", &b"not a log at all"[..]), ("nothing.mcap", b"")] {
        place.file(name, bytes);
        let said = refused(&place, &[name]);
        assert!(said.contains(&format!("{name} is not a log of this program: ")), "{said}");
    }
    ran(&place, &[("every", "1")], "300");
    place.file("file", "");
    let said = refused(&place, &["run", "--out", "file/out"]);
    assert!(
        said.starts_with("tectum: file/out cannot be written: ") && said.ends_with("choose another --out"),
        "{said}"
    );
}
