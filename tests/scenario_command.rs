//! `tectum scenario`, and the forms of a number of ticks, with the real program.

mod support;

use serde_json::json;
use support::{TECTUM, TestFolder};
use tectum::scenario::presets;

#[test]
fn the_list_names_every_built_in_scenario_with_one_sentence() {
    let test_folder = TestFolder::new();
    let text = test_folder.start(TECTUM, &["scenario", "list"]).wait().expect(0).stdout;
    assert_eq!(text.lines().count(), presets().len());
    for (line, preset) in text.lines().zip(presets()) {
        let (name, about) = line.split_once("  ").unwrap();
        assert_eq!((name, about.trim_start()), (preset.name, preset.about));
        assert!(preset.about.ends_with('.'), "{line}");
        assert!(line.chars().count() <= 120, "{line}");
    }
    let list = test_folder.start(TECTUM, &["scenario", "list", "--json"]).wait().expect(0).json();
    let expected: Vec<_> = presets().iter().map(|p| json!({ "name": p.name, "about": p.about })).collect();
    assert_eq!(list, json!({ "scenarios": expected }));
}

#[test]
fn show_prints_a_built_in_scenario_as_its_file() {
    let test_folder = TestFolder::new();
    for preset in presets() {
        let file = format!("{}/scenarios/{}.toml", env!("CARGO_MANIFEST_DIR"), preset.name);
        let file = std::fs::read_to_string(file).unwrap();
        assert_eq!(test_folder.start(TECTUM, &["scenario", "show", preset.name]).wait().expect(0).stdout, file);
    }
    let shown = test_folder.start(TECTUM, &["scenario", "show", "arm.toml", "--json"]).wait().expect(0).json();
    assert_eq!(shown, json!({ "name": "arm", "about": presets()[0].about, "toml": presets()[0].text }));
}

#[test]
fn an_unknown_scenario_name_gets_a_suggestion() {
    let test_folder = TestFolder::new();
    // `show` prints built-in scenarios only, not a file of that name.
    test_folder.write_file("papr", presets()[0].text);
    let outcome = test_folder.start(TECTUM, &["scenario", "show", "papr"]).wait().expect(2);
    assert_eq!(
        outcome.stderr,
        "tectum: there is no scenario \"papr\": no built-in scenario has that name; did you mean \"paper\"?\n"
    );
    assert_eq!(outcome.stdout, "");
}

#[test]
fn a_number_of_ticks_may_be_written_in_several_ways() {
    let test_folder = TestFolder::new();
    for (value, ticks) in [
        ("1e3", 1000),
        ("1E+3", 1000),
        ("1.5e3", 1500),
        ("0.001e6", 1000),
        ("1000.0", 1000),
        ("1_000", 1000),
        ("1,000", 1000),
        ("1,000e-1", 100),
        ("0100", 100),
        ("+100", 100),
    ] {
        let run = test_folder.run(&["paper", "--mode", "in-process", "--json", "--ticks", value]).wait().expect(0);
        assert_eq!(run.json()["ticks"], ticks, "{value}");
        std::fs::remove_dir_all(test_folder.run_folder()).unwrap();
    }
}

#[test]
fn every_help_has_an_example() {
    let test_folder = TestFolder::new();
    for command in [&["scenario"][..], &["scenario", "list"], &["scenario", "show"], &["run"]] {
        let help = test_folder.start(TECTUM, &[command, &["--help"]].concat()).wait().expect(0).stdout;
        assert!(help.contains("Example"), "{command:?}");
        assert!(help.contains(&format!("  tectum {}", command[0])) || help.contains("Example: tectum "), "{help}");
    }
}
