//! `tectum film` on the logs of real runs, and on what has no film.

mod support;

use std::fs;

use serde_json::Value;
use support::TestFolder;

/// A run of the arm, `ticks` long, with these changes to its scenario.
fn ran(test_folder: &TestFolder, changes: &[(&str, &str)], ticks: &str) {
    let scenario = test_folder.arm_scenario(changes);
    test_folder.run(&[&scenario, "--ticks", ticks]).wait().expect(0);
}

/// The SVG's elements, if each is closed in its turn; attributes are looked at as far as their quotes go.
#[track_caller]
fn well_formed(svg: &str) -> Vec<String> {
    let (mut open, mut elements, mut rest) = (Vec::<String>::new(), Vec::new(), svg);
    while let Some(start) = rest.find('<') {
        assert!(!rest[..start].contains('>'), "a stray > before {}", &rest[start..]);
        let end = start + rest[start..].find('>').expect("a tag without an end");
        let tag = &rest[start + 1..end];
        assert!(!tag.contains('<') && tag.matches('"').count().is_multiple_of(2), "<{tag}>");
        rest = &rest[end + 1..];
        if let Some(name) = tag.strip_prefix('/') {
            assert_eq!(open.pop().as_deref(), Some(name));
            continue;
        }
        let name = tag.trim_end_matches('/').split_whitespace().next().unwrap().to_owned();
        elements.push(name.clone());
        if !tag.ends_with('/') {
            open.push(name);
        }
    }
    assert!(open.is_empty() && rest.trim().is_empty(), "left open: {open:?}");
    elements
}

#[test]
fn a_runs_film_is_an_animated_picture_without_script() {
    let test_folder = TestFolder::new();
    // The joint blocks at tick 640; `tick` stands first there.
    ran(&test_folder, &[("every", "1"), ("tick", "640")], "1000");
    let made = test_folder.tectum("film", &["run", "--json"]).expect(0);
    assert_eq!((made.stdout.lines().count(), made.stderr.as_str()), (1, ""));
    let json = made.json();
    let file = test_folder.run_folder().join("film.svg");
    let svg = fs::read_to_string(&file).unwrap();
    assert_eq!((&json["file"], &json["bytes"]), (&"run/film.svg".into(), &svg.len().into()));
    assert!(svg.len() < 150_000, "{} bytes", svg.len());

    let panels = json["panels"].as_array().unwrap();
    let of = |key: &str| panels.iter().map(|panel| panel[key].clone()).collect::<Vec<Value>>();
    assert_eq!(of("caption"), ["The first target", "After ten seconds", "After the joint blocks"]);
    let from: Vec<u64> = of("from").iter().map(|from| from.as_u64().unwrap()).collect();
    assert!(from[0] == 0 && (240..=400).contains(&from[1]) && (640..=880).contains(&from[2]), "{json}");
    let errors: Vec<f64> = of("end_error_m").iter().map(|error| error.as_f64().unwrap()).collect();
    assert!(errors.iter().all(|error| (0.0..4.0).contains(error)), "{json}");
    for panel in panels {
        assert_eq!(panel["seconds"].as_f64().unwrap(), panel["from"].as_u64().unwrap() as f64 * 0.05);
    }

    let elements = well_formed(&svg);
    assert!(elements.iter().all(|name| name != "script" && name != "foreignObject" && name != "image"));
    assert!(elements.iter().filter(|name| name.starts_with("animate")).count() >= 9);
    assert!(!svg.contains("href") && svg.contains("prefers-reduced-motion"));
    let shown = "the median of the 3 from 10 s on, and the median of the 4 since the body changed";
    for words in ["joint 3 blocked at 32 s", "untrained at the start", "in real time", "seed 1", shown] {
        assert!(svg.contains(words), "{words}");
    }

    // The same bytes again, elsewhere, from the log alone, and a table for people.
    let log = test_folder.log_path();
    let text = test_folder.tectum("film", &[log.to_str().unwrap(), "--out", "again.svg"]).expect(0).stdout;
    assert!(text.contains("After the joint blocks") && text.contains("film  again.svg ("), "{text}");
    assert_eq!(svg, fs::read_to_string(test_folder.path().join("again.svg")).unwrap());
}

#[test]
fn without_a_change_of_the_body_the_last_panel_is_the_end() {
    let test_folder = TestFolder::new();
    // The block at tick 9,300,000 of the paper's scenario is never reached.
    ran(&test_folder, &[("every", "1")], "600");
    let json = test_folder.tectum("film", &["run", "--json"]).expect(0).json();
    assert_eq!((&json["panels"][2]["caption"], &json["panels"][2]["from"]), (&"At the end".into(), &480.into()));
    assert!(!fs::read_to_string(test_folder.run_folder().join("film.svg")).unwrap().contains("blocked"));
}

#[test]
fn logs_without_a_film_are_refused_with_the_remedy() {
    let test_folder = TestFolder::new();
    ran(&test_folder, &[("every", "7")], "700");
    let message = test_folder.refused("film", &["run"]);
    assert!(message.starts_with("tectum: the log run/log.mcap holds every 7th tick only"), "{message}");

    let test_folder = TestFolder::new();
    ran(&test_folder, &[("every", "1")], "300");
    let message = test_folder.refused("film", &["run"]);
    assert!(message.contains("is too short for a film: 300 ticks hold 3 whole reaches"), "{message}");
    assert!(message.ends_with("make a longer run"), "{message}");
    assert!(!test_folder.run_folder().join("film.svg").exists());

    let test_folder = TestFolder::new();
    let eye = fs::read_to_string("scenarios/eye.toml").unwrap();
    let scenario = test_folder.write_file("eye.toml", eye).to_str().unwrap().to_owned();
    test_folder.run(&[&scenario, "--ticks", "50"]).wait().expect(0);
    let message = test_folder.refused("film", &["run"]);
    assert!(
        message.contains("the plant of scenario \"eye\" is an eye") && message.contains("[plant.arm]"),
        "{message}"
    );
}

#[test]
fn what_is_no_log_has_no_film() {
    let test_folder = TestFolder::new();
    assert_eq!(
        test_folder.refused("film", &["nowhere"]),
        "tectum: nowhere does not exist; give a log, or the folder of a run"
    );
    ran(&test_folder, &[("every", "1")], "700");
    let message = test_folder.refused("film", &["run", "--out", "nowhere/film.svg"]);
    assert!(message.contains("nowhere/film.svg cannot be written: ") && message.ends_with("--out"), "{message}");
}
