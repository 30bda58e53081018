//! `tectum reproduce` on short runs. Its results have the documented shape, are a function of the seeds, and equal
//! those of the same scenarios under `tectum run`.

mod support;

use serde_json::Value;
use support::{TECTUM, TestFolder};

/// The JSON object that the command prints; its files are in `out`.
fn reproduce(test_folder: &TestFolder, arguments: &[&str]) -> Value {
    test_folder.tectum("reproduce", &[arguments, &["--out", "out", "--json"]].concat()).expect(0).json()
}

/// The object without the values that differ from call to call.
fn numbers(mut value: Value) -> Value {
    for key in ["seconds", "machine"] {
        value.as_object_mut().unwrap().remove(key).unwrap_or_else(|| panic!("no {key}"));
    }
    value
}

/// Minimum, median and maximum, which must be in order.
fn spread(value: &Value) -> [f64; 3] {
    let [min, median, max] = ["min", "median", "max"].map(|key| value[key].as_f64().unwrap());
    assert!(min <= median && median <= max, "{value}");
    [min, median, max]
}

#[test]
fn the_arm_study_reports_windows_with_spread() {
    let test_folder = TestFolder::new();
    let arguments = ["arm", "--seeds", "3", "--first-seed", "7", "--ticks", "20000"];
    let first = reproduce(&test_folder, &arguments);
    assert_eq!(first["seeds"], serde_json::json!([7, 8, 9]));
    assert_eq!((&first["ticks"], &first["block_tick"]), (&20000.into(), &Value::Null));
    let windows = first["windows"].as_array().unwrap();
    assert_eq!((windows.len(), &windows[0]["upto"]), (1, &20000.into()));
    assert!(spread(&windows[0]["loss"])[0] > 0.03, "noise alone costs 0.0355");
    spread(&windows[0]["end_error_m"]);
    for file in ["figure.svg", "windows.csv", "curve.csv", "result.json"] {
        assert!(test_folder.path().join("out").join(file).exists(), "{file}");
    }
    let curve = std::fs::read_to_string(test_folder.path().join("out/curve.csv")).unwrap();
    assert_eq!(curve.lines().count(), 1 + 3 * 400);

    assert_eq!(numbers(first.clone()), numbers(reproduce(&TestFolder::new(), &arguments)));
    // One seed gives the same as one run of the scenario.
    let run = test_folder.run(&["paper", "--mode", "in-process", "--ticks", "20000", "--seed", "8", "--json"]);
    assert_eq!(run.wait().expect(0).json()["weights_hash"], first["weights_hash"][1]);
}

#[test]
fn three_of_the_four_eye_variants_learn() {
    let test_folder = TestFolder::new();
    let eyes = reproduce(&test_folder, &["eye", "--seeds", "2", "--ticks", "60000"]);
    let names: Vec<_> = eyes["variants"].as_array().unwrap().iter().map(|v| [&v["retina"], &v["coding"]]).collect();
    let expected = ["linear scalar", "linear topographic", "log-polar scalar", "log-polar topographic"];
    for (name, expected) in names.iter().zip(expected) {
        assert_eq!(format!("{} {}", name[0].as_str().unwrap(), name[1].as_str().unwrap()), expected);
    }
    let last = |i: usize| spread(&eyes["variants"][i]["windows"].as_array().unwrap().last().unwrap()["error"])[1];
    assert!(last(0) < 0.15 && last(1) < 0.3 && last(3) < 0.3 && last(2) > 0.4, "{eyes}");
}

#[test]
fn open_loop_and_outlook_report_their_results() {
    let test_folder = TestFolder::new();
    let arms = reproduce(&test_folder, &["open-loop", "--seeds", "2", "--ticks", "5000"]);
    assert_eq!(arms["arms"].as_array().unwrap().len(), 2);
    assert_eq!(arms["arms"][0]["ways"].as_array().unwrap().len(), 2);
    assert!(test_folder.path().join("out/postures.csv").exists());

    let outlook = reproduce(&TestFolder::new(), &["outlook", "--seeds", "1", "--ticks", "200"]);
    let rows = outlook["rows"].as_array().unwrap();
    assert_eq!((rows.len(), &rows[0]["name"]), (8, &"the paper's arm".into()));
    assert!(rows[1]["stopped"].is_object() && rows[0]["stopped"].is_null(), "{outlook}");
}

#[test]
fn bad_input_is_refused_and_a_signal_ends_a_study() {
    let test_folder = TestFolder::new();
    test_folder.write_file("taken", "a file");
    for (arguments, words) in [
        (&["arm", "--ticks", "1"][..], "ticks is 1; "),
        (&["arm", "--seeds", "0"], "--seeds"),
        (&["eye", "--ticks", "100", "--out", "taken"], "taken cannot be used"),
    ] {
        let outcome = test_folder.tectum("reproduce", arguments).expect(2);
        assert!(outcome.stderr.contains(words), "{outcome:#?}");
    }
    let mut long = test_folder.start(TECTUM, &["reproduce", "arm", "--ticks", "1000000000", "--out", "long"]);
    long.wait_until("the folder", || test_folder.path().join("long").exists());
    long.signal("INT");
    let outcome = long.wait().expect(130);
    assert!(outcome.stderr.contains("ended by signal 2"), "{outcome:#?}");
    assert!(!test_folder.path().join("long").exists(), "nothing is left: {outcome:#?}");
}
