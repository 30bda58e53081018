//! Bad input: exit code 2, one message with the location and the remedy. Nothing is started and no file is left.

mod support;

use support::{ProcessOutcome, TECTUM, TestFolder};

/// Starts a run with bad input, checks that it is refused and leaves no folder, and returns the message.
#[track_caller]
fn refused(test_folder: &TestFolder, arguments: &[&str]) -> String {
    let outcome = test_folder.run(arguments).wait();
    let message = single_message(&outcome);
    assert!(!test_folder.run_folder().exists(), "nothing is left: {message}");
    message
}

/// The message of a refused run, which must have one line.
#[track_caller]
fn single_message(outcome: &ProcessOutcome) -> String {
    assert_eq!(outcome.code, Some(2), "{outcome:#?}");
    assert_eq!(outcome.stderr.lines().count(), 1, "one message: {outcome:#?}");
    outcome.stderr.trim().to_owned()
}

/// The message for `scenarios/arm.toml` with one change.
#[track_caller]
fn refused_change(from: &str, to: &str) -> String {
    let text = std::fs::read_to_string("scenarios/arm.toml").unwrap();
    assert!(text.contains(from), "{from}");
    let test_folder = TestFolder::new();
    let path = test_folder.write_file("s.toml", text.replacen(from, to, 1));
    refused(&test_folder, &[path.to_str().unwrap()]).replace(&format!("{}/", test_folder.path().display()), "")
}

#[test]
fn unknown_and_broken_scenarios_are_refused() {
    let test_folder = TestFolder::new();
    assert_eq!(
        refused(&test_folder, &["nowhere.toml"]),
        format!(
            "tectum: there is no scenario \"nowhere.toml\": no file {}/nowhere.toml exists, and no built-in scenario \
             has that name; the built-in ones are arm, paper, eye, near, laplace, limited, relative, collision, \
             todorov, open-loop-3, open-loop-4, office, pendulum, cart-pole, so101, so101-emulated, so101-planar, \
             servo-simulated, servo-emulated and servo-vision",
            test_folder.path().display()
        )
    );
    assert!(refused(&test_folder, &["papper"]).ends_with("; did you mean \"paper\"?"));
    let broken = test_folder.write_file("broken.toml", "name = \"x\"\nticks = = 5\n");
    assert!(refused(&test_folder, &[broken.to_str().unwrap()]).contains("broken.toml:2: "));
}

#[test]
fn impossible_values_are_refused() {
    for (from, to, message) in [
        ("period_ms = 50", "perod_ms = 50", "tectum: s.toml:12: unknown key \"perod_ms\"; did you mean \"period_ms\"?"),
        ("period_ms = 50", "period_ms = \"x\"", "tectum: s.toml:12: period_ms is "),
        ("period_ms = 50", "period_ms = 0", "tectum: s.toml:12: period_ms is 0; "),
        ("units = [16, 16]", "units = [16, 0]", "encoder.maps[0].units[1] is 0; "),
        ("units = [16, 16]", "units = [1000000, 16]", "encoder.maps[0].units[0] is 1000000; "),
        ("radius = 0.5", "radius = nan", "encoder.maps[0].radius is nan; "),
        ("sigma = 0.001", "sigma = inf", "policy.sigma is inf; "),
        ("learning = \"learning\"", "learning = \"command\"", "channels."),
    ] {
        let refusal = refused_change(from, to);
        assert!(refusal.contains(message), "{to}: {refusal}");
    }
}

#[test]
fn impossible_arguments_are_refused() {
    let test_folder = TestFolder::new();
    assert!(refused(&test_folder, &["--ticks", "0"]).contains("ticks is 0; "));
    for arguments in [&["--ticks", "many"][..], &["--mode", "fast"], &["--colour"]] {
        let outcome = test_folder.run(arguments).wait().expect(2);
        assert!(outcome.stderr.starts_with("error: "), "{outcome:#?}");
        assert!(!test_folder.run_folder().exists());
    }
}

/// The reason that clap gives for refusing the value of `--ticks`, without the option's name and clap's closing line.
#[track_caller]
fn refused_ticks(command: &[&str], value: &str) -> String {
    let test_folder = TestFolder::new();
    let outcome = test_folder.start(TECTUM, &[command, &["--ticks", value]].concat()).wait().expect(2);
    let prefix = format!("error: invalid value '{value}' for '--ticks <N>': ");
    let message = outcome.stderr.strip_prefix(&prefix).unwrap_or_else(|| panic!("{outcome:#?}"));
    message.lines().next().unwrap().to_owned()
}

#[test]
fn impossible_numbers_of_ticks_are_refused() {
    const EXAMPLES: &str = "; give a whole number of ticks, such as 3600, 1_000_000, 1,000,000 or 1e6";
    for (value, why) in [
        ("-5", "it is negative"),
        ("-1e6", "it is negative"),
        ("1.5", "it is a fraction"),
        ("1e-3", "it is a fraction"),
        ("1,5", "a comma may only separate groups of three digits"),
        ("1000,000", "a comma may only separate groups of three digits"),
        ("1__0", "it is not a number"),
        ("many", "it is not a number"),
        ("1e", "it is not a number"),
        ("0x10", "it is not a number"),
        (".5", "it is not a number"),
        ("inf", "it is not a number"),
    ] {
        assert_eq!(refused_ticks(&["run"], value), format!("{why}{EXAMPLES}"), "{value}");
    }
    for value in ["18446744073709551616", "1e20", "1e999999999", "99e19"] {
        assert_eq!(refused_ticks(&["run"], value), "it is too large; give at most 18446744073709551615", "{value}");
    }
    // All commands that take a number of ticks share one parser.
    for command in [&["reproduce", "arm"][..], &["compare"], &["bench", "lockstep"], &["bench", "all", "--report", "x"]]
    {
        assert_eq!(refused_ticks(command, "1.5"), format!("it is a fraction{EXAMPLES}"), "{command:?}");
    }
    let test_folder = TestFolder::new();
    let outcome = test_folder.run(&["--ticks", ""]).wait().expect(2);
    assert!(outcome.stderr.contains(&format!("it is empty{EXAMPLES}")), "{outcome:#?}");
}

#[test]
fn unusable_run_folders_are_refused() {
    let test_folder = TestFolder::new();
    test_folder.write_file("file", "");
    let outcome = test_folder.start(TECTUM, &["run", "--out", "file/run"]).wait();
    let message = single_message(&outcome);
    assert!(message.starts_with("tectum: the run's folder file/run cannot be used: "), "{message}");
    assert!(message.ends_with("; choose another with --out"), "{message}");

    // A folder that contains a run is never overwritten.
    test_folder.run(&["--ticks", "10"]).wait().expect(0);
    let before = std::fs::read(test_folder.log_path()).unwrap();
    let message = single_message(&test_folder.run(&["--ticks", "10"]).wait());
    assert!(message.contains("it holds a run already"), "{message}");
    assert!(before == std::fs::read(test_folder.log_path()).unwrap());
}

#[test]
fn a_log_that_cannot_fit_is_refused_before_the_start() {
    let test_folder = TestFolder::new();
    let message = refused(&test_folder, &["--ticks", "999_999_999_999"]);
    assert!(message.starts_with("tectum: the log needs about "), "{message}");
    assert!(message.contains("[log] every"), "{message}");
}

#[test]
fn a_missing_plant_program_is_refused() {
    assert!(
        refused_change("program = \"tectum-simulator\"", "program = \"./nothing\"")
            .contains("the plant cannot be started")
    );
}

#[test]
fn a_step_size_that_may_diverge_causes_a_warning() {
    let test_folder = TestFolder::new();
    let scenario = test_folder.arm_scenario(&[("alpha_over_variance", "0.5")]);
    let outcome = test_folder.run(&[&scenario, "--ticks", "20", "--mode", "in-process", "--json"]).wait().expect(0);
    let warnings = outcome.json()["warnings"].clone();
    let warning = warnings[0]["text"].as_str().unwrap();
    assert!(warning.starts_with("learner.alpha_over_variance is 0.5"), "{warning}");
    assert_eq!(outcome.stderr.matches(&format!("tectum: warning: {warning}")).count(), 1, "{}", outcome.stderr);
}

/// A relative path in a scenario begins at the scenario's folder, wherever the run is started.
#[test]
fn paths_begin_at_the_scenarios_folder() {
    use std::os::unix::fs::PermissionsExt as _;
    let test_folder = TestFolder::new();
    let project = test_folder.path().join("project");
    std::fs::create_dir_all(project.join("bin")).unwrap();
    let text = std::fs::read_to_string("examples/point.toml").unwrap();
    let text = text.replace("target/release/examples/point", "bin/plant.sh");
    std::fs::write(project.join("point.toml"), text).unwrap();
    let message = test_folder.refused("run", &["project/point.toml"]);
    for folder in [&project, test_folder.path()] {
        assert!(message.contains(folder.join("bin/plant.sh").to_str().unwrap()), "{message}");
    }
    let script = project.join("bin/plant.sh");
    std::fs::write(&script, "#!/bin/sh\necho 'plant.sh: this is the plant' >&2\nexit 2\n").unwrap();
    std::fs::set_permissions(&script, std::fs::Permissions::from_mode(0o700)).unwrap();
    let message = test_folder.refused("run", &["project/point.toml"]);
    assert!(message.contains("this is the plant"), "{message}");
}
