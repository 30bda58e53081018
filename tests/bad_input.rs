//! Bad input: exit code 2, one message that names the place and the remedy, nothing started, nothing left.

mod support;

use support::{Outcome, Place, TECTUM};

/// Runs with bad input and checks the promise.
#[track_caller]
fn refused(place: &Place, arguments: &[&str]) -> String {
    let outcome = place.run(arguments).wait();
    let message = said_once(&outcome);
    assert!(!place.run_folder().exists(), "nothing is left: {message}");
    message
}

#[track_caller]
fn said_once(outcome: &Outcome) -> String {
    assert_eq!(outcome.code, Some(2), "{outcome:#?}");
    assert_eq!(outcome.stderr.lines().count(), 1, "one message: {outcome:#?}");
    outcome.stderr.trim().to_owned()
}

/// `scenarios/arm.toml` with one change.
#[track_caller]
fn changed(from: &str, to: &str) -> String {
    let text = std::fs::read_to_string("scenarios/arm.toml").unwrap();
    assert!(text.contains(from), "{from}");
    let place = Place::new();
    let path = place.file("s.toml", text.replacen(from, to, 1));
    refused(&place, &[path.to_str().unwrap()]).replace(&format!("{}/", place.path().display()), "")
}

#[test]
fn scenarios_that_are_not() {
    let place = Place::new();
    assert_eq!(
        refused(&place, &["nowhere.toml"]),
        format!(
            "tectum: there is no scenario \"nowhere.toml\": no file {}/nowhere.toml exists, and no built-in scenario \
             has that name; the built-in ones are arm, paper, eye, near, laplace, limited, relative, collision, todorov, \
             open-loop-3, open-loop-4, office, servo-simulated, servo-emulated and servo-vision",
            place.path().display()
        )
    );
    assert!(refused(&place, &["papper"]).ends_with("; did you mean \"paper\"?"));
    let broken = place.file("broken.toml", "name = \"x\"\nticks = = 5\n");
    assert!(refused(&place, &[broken.to_str().unwrap()]).contains("broken.toml:2: "));
}

#[test]
fn values_that_cannot_be() {
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
        let said = changed(from, to);
        assert!(said.contains(message), "{to}: {said}");
    }
}

#[test]
fn arguments_that_cannot_be() {
    let place = Place::new();
    assert!(refused(&place, &["--ticks", "0"]).contains("ticks is 0; "));
    for arguments in [&["--ticks", "many"][..], &["--mode", "fast"], &["--colour"]] {
        let outcome = place.run(arguments).wait().expect(2);
        assert!(outcome.stderr.starts_with("error: "), "{outcome:#?}");
        assert!(!place.run_folder().exists());
    }
}

/// What clap writes about the value of `--ticks`, between the option's name and its own closing line.
#[track_caller]
fn refused_ticks(command: &[&str], value: &str) -> String {
    let place = Place::new();
    let outcome = place.start(TECTUM, &[command, &["--ticks", value]].concat()).wait().expect(2);
    let prefix = format!("error: invalid value '{value}' for '--ticks <N>': ");
    let message = outcome.stderr.strip_prefix(&prefix).unwrap_or_else(|| panic!("{outcome:#?}"));
    message.lines().next().unwrap().to_owned()
}

#[test]
fn numbers_of_ticks_that_cannot_be() {
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
    let place = Place::new();
    let outcome = place.run(&["--ticks", ""]).wait().expect(2);
    assert!(outcome.stderr.contains(&format!("it is empty{EXAMPLES}")), "{outcome:#?}");
}

#[test]
fn folders_that_cannot_be_used() {
    let place = Place::new();
    place.file("file", "");
    let outcome = place.start(TECTUM, &["run", "--out", "file/run"]).wait();
    let message = said_once(&outcome);
    assert!(message.starts_with("tectum: the run's folder file/run cannot be used: "), "{message}");
    assert!(message.ends_with("; choose another with --out"), "{message}");

    // A folder with a run in it is never written over.
    place.run(&["--ticks", "10"]).wait().expect(0);
    let before = std::fs::read(place.run_folder().join("log.mcap")).unwrap();
    let message = said_once(&place.run(&["--ticks", "10"]).wait());
    assert!(message.contains("it holds a run already"), "{message}");
    assert!(before == std::fs::read(place.run_folder().join("log.mcap")).unwrap());
}

#[test]
fn a_log_that_cannot_fit_is_refused_before_the_start() {
    let place = Place::new();
    let message = refused(&place, &["--ticks", "1000000000000"]);
    assert!(message.starts_with("tectum: the log needs about "), "{message}");
    assert!(message.contains("[log] every"), "{message}");
}

#[test]
fn a_plant_that_is_not_there() {
    assert!(
        changed("program = \"tectum-simulator\"", "program = \"./nothing\"").contains("the plant cannot be started")
    );
}

#[test]
fn a_step_that_is_likely_to_diverge_is_warned_of_and_the_run_goes_on() {
    let place = Place::new();
    let scenario = place.arm(&[("alpha_over_variance", "0.5")]);
    let outcome = place.run(&[&scenario, "--ticks", "20", "--mode", "in-process", "--json"]).wait().expect(0);
    let warnings = outcome.json()["warnings"].clone();
    let warning = warnings[0].as_str().unwrap();
    assert!(warning.starts_with("learner.alpha_over_variance is 0.5"), "{warning}");
    assert_eq!(outcome.stderr.matches(&format!("tectum: warning: {warning}")).count(), 1, "{}", outcome.stderr);
}
