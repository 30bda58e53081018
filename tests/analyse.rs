//! `tectum analyse` on the logs of real runs, and on paths that are not logs.

mod support;

use std::fs;

use serde_json::Value;
use support::{TestFolder, read_json};

/// Runs the arm for `ticks` ticks, with these changes to its scenario.
fn run(test_folder: &TestFolder, changes: &[(&str, &str)], ticks: &str) {
    let scenario = test_folder.arm_scenario(changes);
    test_folder.run(&[&scenario, "--ticks", ticks]).wait().expect(0);
}

#[test]
fn a_runs_movements_are_measured_with_noise_and_without() {
    let test_folder = TestFolder::new();
    run(&test_folder, &[("every", "1")], "2400");
    let analysis = test_folder.tectum("analyse", &["run", "--json"]).expect(0).json();
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
    // The paper's rule has learned hardly anything: noise shakes the arm, and the movements without noise are smooth.
    assert_eq!(median("noiseless", "distance_m"), median("measured", "distance_m"));
    assert!(median("measured", "peaks") >= 8.0 && median("noiseless", "peaks") <= 4.0);
    assert!(median("measured", "straightness") > 2.0 * median("noiseless", "straightness"));

    let folder = test_folder.run_folder();
    assert!(read_json(folder.join("analysis.json")) == analysis);
    assert!(fs::read_to_string(folder.join("movements.svg")).unwrap().starts_with("<svg "));
    let csv = fs::read_to_string(folder.join("movements.csv")).unwrap();
    let rows: Vec<Vec<&str>> = csv.lines().map(|line| line.split(',').collect()).collect();
    assert_eq!(rows.len(), 29);
    assert!(rows.iter().all(|row| row.len() == rows[0].len()), "{csv}");
    assert_eq!((rows[1][0], rows[1][1], rows[28][0]), ("80", "80", "2240"));

    // The log alone is enough, with another output folder, and the text output has the same.
    let log = folder.join("log.mcap");
    let text = test_folder.tectum("analyse", &[log.to_str().unwrap(), "--out", "deep/down"]).expect(0).stdout;
    for words in ["28 movements in 2,400 ticks", "medians, without exploration noise", "isochrony, last 10: duration"] {
        assert!(text.contains(words), "{words}: {text}");
    }
    assert_eq!(csv, fs::read_to_string(test_folder.path().join("deep/down/movements.csv")).unwrap());

    let measured_only =
        test_folder.tectum("analyse", &["run", "--measured-only", "--out", "bare", "--json"]).expect(0).json();
    assert_eq!((&measured_only["noiseless"], &measured_only["measured"]), (&Value::Null, &analysis["measured"]));
}

#[test]
fn a_torn_log_is_analysed_up_to_where_it_is_torn() {
    let test_folder = TestFolder::new();
    run(&test_folder, &[("every", "1")], "1000");
    let whole = fs::read(test_folder.log_path()).unwrap();
    let torn = test_folder.write_file("torn.mcap", &whole[..whole.len() / 2]);
    let analysis = test_folder.tectum("analyse", &[torn.to_str().unwrap(), "--json"]).expect(0).json();
    assert_eq!(analysis["torn"], true);
    let n = analysis["n"].as_u64().unwrap();
    assert!((3..=5).contains(&n), "half of 1000 ticks: {analysis}");
    assert_eq!(analysis["noiseless"]["all"]["n"], n);
    let text = test_folder.tectum("analyse", &[torn.to_str().unwrap()]).expect(0).stdout;
    assert!(text.contains("The log was cut off; it was analysed as far as it goes."), "{text}");
}

/// A log whose learning differs from that of this build: movements without noise end where the difference is found.
#[test]
fn a_log_that_does_not_replay_is_analysed_as_measured_only() {
    let test_folder = TestFolder::new();
    run(&test_folder, &[("every", "1")], "1000");
    let mut log = fs::read(test_folder.log_path()).unwrap();
    // Another seed of the same length in the log's scenario: targets and noise differ from the first tick on.
    let at = log.windows(9).position(|w| w == b"\nseed = 1").unwrap();
    log[at + 8] = b'2';
    // The log is torn, so that no checksum reveals the change first.
    let other = test_folder.write_file("other.mcap", &log[..log.len() * 9 / 10]);
    let analysis = test_folder.tectum("analyse", &[other.to_str().unwrap(), "--json"]).expect(0).json();
    assert!(analysis["n"].as_u64() >= Some(8), "{analysis}");
    assert_eq!((&analysis["torn"], &analysis["noiseless"]), (&Value::Bool(true), &Value::Null));
    let why = analysis["noiseless_missing"].as_str().unwrap();
    assert!(why.starts_with("from tick 0 on the log is not what this build makes of it"), "{why}");
}

#[test]
fn logs_without_the_needed_data_are_refused_with_a_remedy() {
    let test_folder = TestFolder::new();
    run(&test_folder, &[("every", "7")], "1000");
    let message = test_folder.refused("analyse", &["run"]);
    assert!(message.starts_with("tectum: the log run/log.mcap holds every 7th tick only"), "{message}");
    assert!(message.ends_with("with `every = 1` under [log]"), "{message}");

    let test_folder = TestFolder::new();
    run(&test_folder, &[("every", "1")], "100");
    let message = test_folder.refused("analyse", &["run"]);
    assert!(message.contains("holds no whole movement") && message.contains("make a longer run"), "{message}");

    let test_folder = TestFolder::new();
    let eye = fs::read_to_string("scenarios/eye.toml").unwrap();
    let every = eye.lines().find(|line| line.starts_with("every = ")).unwrap().to_owned();
    let scenario =
        test_folder.write_file("eye.toml", eye.replacen(&every, "every = 1", 1)).to_str().unwrap().to_owned();
    test_folder.run(&[&scenario, "--ticks", "50"]).wait().expect(0);
    let message = test_folder.refused("analyse", &["run"]);
    assert!(
        message.contains("does not measure `end_x and end_y`") && message.contains("[plant] measures"),
        "{message}"
    );
    assert!(!test_folder.run_folder().join("analysis.json").exists());
}

#[test]
fn a_path_that_is_not_a_log_is_refused() {
    let test_folder = TestFolder::new();
    assert_eq!(
        test_folder.refused("analyse", &["nowhere"]),
        "tectum: nowhere does not exist; give a log, or the folder of a run"
    );
    fs::create_dir(test_folder.path().join("empty")).unwrap();
    assert!(test_folder.refused("analyse", &["empty"]).contains("empty is a folder without a log.mcap"));
    for (name, bytes) in [("text.mcap", &b"not a log at all"[..]), ("nothing.mcap", b"")] {
        test_folder.write_file(name, bytes);
        let message = test_folder.refused("analyse", &[name]);
        assert!(message.contains(&format!("{name} is not a log of this program: ")), "{message}");
    }
    run(&test_folder, &[("every", "1")], "300");
    test_folder.write_file("file", "");
    let message = test_folder.refused("analyse", &["run", "--out", "file/out"]);
    assert!(
        message.starts_with("tectum: file/out cannot be written: ") && message.ends_with("choose another --out"),
        "{message}"
    );
}
