//! `tectum film` on the logs of real runs, and on what has no film.

mod support;

use std::fs;
use std::os::unix::fs::PermissionsExt as _;

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

/// A GIF holds what the SVG holds, ffmpeg gets every frame, and both names are known before the log is read.
#[test]
fn a_film_is_a_gif_or_a_video_by_its_name() {
    let test_folder = TestFolder::new();
    ran(&test_folder, &[("every", "1"), ("tick", "640")], "1000");
    let json = test_folder.tectum("film", &["run", "-o", "film.GIF", "--json"]).expect(0).json();
    let gif = fs::read(test_folder.path().join("film.GIF")).unwrap();
    assert_eq!((&json["bytes"], &json["panels"][2]["caption"]), (&gif.len().into(), &"After the joint blocks".into()));
    assert!(gif.starts_with(b"GIF89a") && gif.ends_with(b";") && gif.len() < 1_500_000, "{} bytes", gif.len());
    // 960 pixels wide; 80 ticks a reach, and a fifth of the film is its end.
    assert_eq!(gif[6..8], 960_u16.to_le_bytes());
    assert_eq!(
        gif.windows(4).filter(|bytes| *bytes == b"\x21\xf9\x04\x04" || *bytes == b"\x21\xf9\x04\x05").count(),
        100
    );

    let message = test_folder.refused("film", &["run", "-o", "film.png"]);
    assert!(message.contains("film.png is no name of a film") && message.ends_with(".svg, .gif or .mp4"), "{message}");

    // A program in ffmpeg's place, which counts what it gets.
    let programs = test_folder.path().join("programs");
    fs::create_dir(&programs).unwrap();
    let film = |path: &str| {
        let mut command = std::process::Command::new(support::TECTUM);
        command.args(["film", "run", "-o", "film.mp4"]).env("PATH", path).current_dir(test_folder.path());
        test_folder.start_command(command).wait()
    };
    let message = film(programs.to_str().unwrap()).refusal();
    assert!(
        message.contains("ffmpeg, which writes MP4, is not installed") && message.contains("film.gif"),
        "{message}"
    );
    let ffmpeg = programs.join("ffmpeg");
    let path = format!("{}:{}", programs.display(), std::env::var("PATH").unwrap());
    let install = |script: &str| {
        fs::write(&ffmpeg, format!("#!/bin/sh\n[ \"$1\" = -version ] && exit\n{script}\n")).unwrap();
        fs::set_permissions(&ffmpeg, fs::Permissions::from_mode(0o755)).unwrap();
    };
    install("echo Unknown encoder >&2; exit 1");
    let message = film(&path).refusal();
    assert!(message.contains("failed: Unknown encoder"), "{message}");
    assert!(!test_folder.path().join("film.mp4").exists());
    install("for last; do :; done\nwc -c > \"$last\"");
    film(&path).expect(0);
    let height = u64::from(u16::from_le_bytes([gif[8], gif[9]]));
    let got = fs::read_to_string(test_folder.path().join("film.mp4")).unwrap();
    assert_eq!(got.trim().parse::<u64>().unwrap(), 100 * 3 * 960 * height);
    let permissions = |name: &str| fs::metadata(test_folder.path().join(name)).unwrap().permissions();
    assert_eq!(permissions("film.mp4"), permissions("film.GIF"));
}

/// The README's picture is what its command makes today, byte for byte.
#[test]
fn the_film_in_the_readme_is_current() {
    let test_folder = TestFolder::new();
    test_folder.run(&["arm"]).wait().expect(0);
    test_folder.tectum("film", &["run"]).expect(0);
    let made = fs::read_to_string(test_folder.run_folder().join("film.svg")).unwrap();
    let shown = fs::read_to_string("docs/figures/film.svg").unwrap();
    assert!(made == shown, "make it anew: tectum run arm; tectum film runs/arm-1 --out docs/figures/film.svg");
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

/// An episode is a movement. It ends where the rod has got to, and not with the hanging rod of the next one, 2 m from
/// upright.
#[test]
fn a_pendulums_film_shows_episodes() {
    let test_folder = TestFolder::new();
    let pendulum = fs::read_to_string("scenarios/pendulum.toml").unwrap();
    let quick = pendulum.replace("episode_ticks = 200", "episode_ticks = 60").replace("model-predictive", "paper");
    let scenario = test_folder.write_file("swing.toml", quick).to_str().unwrap().to_owned();
    test_folder.run(&[&scenario, "--ticks", "700"]).wait().expect(0);
    let json = test_folder.tectum("film", &["run", "--json"]).expect(0).json();
    let panels = json["panels"].as_array().unwrap();
    let captions: Vec<_> = panels.iter().map(|panel| panel["caption"].as_str().unwrap()).collect();
    assert_eq!(captions, ["The first episode", "After ten seconds", "At the end"]);
    assert!(panels.iter().all(|panel| panel["from"].as_u64().unwrap().is_multiple_of(60)), "{json}");
    let error = |panel: &Value| panel["end_error_m"].as_f64().unwrap();
    assert!(panels.iter().all(|panel| (0.0..1.9999).contains(&error(panel))), "{json}");
    let svg = fs::read_to_string(test_folder.run_folder().join("film.svg")).unwrap();
    assert!(svg.contains("Shown: the first episode") && well_formed(&svg).contains(&"polyline".to_owned()), "{json}");
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
