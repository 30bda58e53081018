//! Scenario files as a user meets them: the shipped ones load, and a bad one is refused in words that help.
//!
//! The table of messages is exact on purpose: a change of wording is a change of what users read, and is reviewed here.

use std::path::Path;

use tectum::{
    encoder::Map,
    scenario::{Scenario, ScenarioError, presets},
};

/// The shipped arm, as the base of most edits.
const ARM: &str = include_str!("../scenarios/arm.toml");
/// The shipped eye.
const EYE: &str = include_str!("../scenarios/eye.toml");
/// A plant of somebody else's.
const OTHER: &str = r#"name = "lab"
ticks = 100

[plant]
program = "./rig"
inputs = [{ name = "angle", unit = "rad", min = -1, max = 1 }, { name = "speed", min = -2.0, max = 2.0 }]
outputs = [{ name = "torque", unit = "Nm", min = -0.1, max = 0.1 }]
measures = ["error"]

[[encoder.maps]]
inputs = ["angle", "speed"]
radius = 0.5
"#;

/// The message for a text, whether reading or planning refuses it.
fn refusal(text: &str) -> String {
    match Scenario::parse(text, "x.toml").and_then(Scenario::plan) {
        Ok(_) => "accepted".to_owned(),
        Err(error) => error.to_string(),
    }
}

fn edited(base: &str, from: &str, to: &str) -> String {
    assert!(base.contains(from), "the base text has no {from:?}");
    base.replacen(from, to, 1)
}

#[test]
fn the_shipped_files_load_and_are_the_built_in_ones() {
    for preset in presets() {
        let path = format!("{}/scenarios/{}.toml", env!("CARGO_MANIFEST_DIR"), preset.name);
        let loaded = Scenario::load(Path::new(&path)).unwrap().plan().unwrap();
        let built_in = preset.scenario().unwrap().plan().unwrap();
        assert_eq!(loaded, built_in);
        assert_eq!(loaded.scenario.name, preset.name);
    }
    let files = std::fs::read_dir(concat!(env!("CARGO_MANIFEST_DIR"), "/scenarios")).unwrap().count();
    assert_eq!(files, presets().len(), "every shipped file is built in");
}

#[test]
fn the_papers_arm_is_the_papers() {
    let plan = Scenario::find("paper").unwrap().plan().unwrap();
    let names: Vec<_> = plan.inputs.iter().map(|input| input.name.as_str()).collect();
    assert_eq!(names, ["target_x", "target_y", "theta_1", "theta_2", "theta_3", "theta_4"]);
    assert_eq!(plan.outputs.len(), 4);
    assert_eq!(plan.measures, ["error", "end_x", "end_y"]);
    assert_eq!(plan.period_ns, 50_000_000);
    assert_eq!(plan.scenario.ticks, 12_000_000);
    let block = &plan.scenario.plant.arm.as_ref().unwrap().block;
    assert_eq!((block[0].joint, block[0].tick, block[0].angle), (3, 9_300_000, 0.0));
    assert_eq!(features(&plan.maps), 320);
    assert_eq!(plan.scenario.plant.arm.as_ref().unwrap().gain, 200.0 * std::f64::consts::PI);

    // The arm to start with is the same arm under the same rule.
    let arm = Scenario::find("arm").unwrap().plan().unwrap();
    assert_eq!((&arm.inputs, &arm.outputs, &arm.maps), (&plan.inputs, &plan.outputs, &plan.maps));
    assert_eq!(arm.scenario.learner, plan.scenario.learner);
    assert_eq!(arm.scenario.policy, plan.scenario.policy);
}

#[test]
fn the_eye_has_two_log_polar_maps() {
    let plan = Scenario::find("eye").unwrap().plan().unwrap();
    let names: Vec<_> = plan.inputs.iter().map(|input| input.name.as_str()).collect();
    assert_eq!(names, ["position_rho", "position_phi", "velocity_rho", "velocity_phi"]);
    let names: Vec<_> = plan.outputs.iter().map(|output| output.name.as_str()).collect();
    assert_eq!(names, ["up", "down", "left", "right"]);
    assert_eq!(plan.measures, ["error"]);
    assert_eq!(features(&plan.maps), 512);
}

fn features(maps: &[Map]) -> usize {
    let units = |map: &Map| match map {
        Map::Line(axis) => axis.units,
        Map::Plane(first, second) => first.units * second.units,
    };
    maps.iter().map(units).sum()
}

#[test]
fn another_program_brings_its_signals_or_borrows_the_arms() {
    let plan = Scenario::parse(OTHER, "lab.toml").unwrap().plan().unwrap();
    assert_eq!((plan.inputs.len(), plan.outputs.len(), plan.measures.len()), (2, 1, 1));
    let Map::Plane(angle, speed) = plan.maps[0] else { panic!("one plane") };
    assert_eq!((angle.units, angle.min, angle.max, angle.radius), (16, -1.0, 1.0, 0.5));
    assert_eq!((speed.input, speed.min, speed.max), (1, -2.0, 2.0));

    let bridge = edited(ARM, "\"tectum-simulator\"", "\"tectum-bridge\"");
    let plan = Scenario::parse(&bridge, "bridge.toml").unwrap().plan().unwrap();
    assert_eq!((plan.inputs.len(), plan.outputs.len(), plan.measures.len()), (6, 4, 3));

    let own = edited(&bridge, "[plant.arm]", "measures = [\"current\"]\n[plant.arm]");
    let plan = Scenario::parse(&own, "bridge.toml").unwrap().plan().unwrap();
    assert_eq!((plan.inputs.len(), plan.measures), (6, vec!["current".to_owned()]));
}

#[test]
fn a_resolved_file_says_everything_and_means_the_same() {
    for text in presets().iter().map(|preset| preset.text).chain([OTHER]) {
        let plan = Scenario::parse(text, "x.toml").unwrap().plan().unwrap();
        let resolved = plan.scenario.to_toml();
        let again = Scenario::parse(&resolved, "resolved.toml").unwrap().plan().unwrap();
        assert_eq!(again, plan);
        assert_eq!(again.scenario.to_toml(), resolved);
        assert_eq!(Scenario::parse(text, "x.toml").unwrap().to_toml(), resolved, "resolving needs no plan");
        for key in ["seed", "period_ms", "units", "ranges", "beta", "hold_ticks", "hash_every", "learning"] {
            assert!(resolved.contains(&format!("\n{key} = ")), "{key} is not written out:\n{resolved}");
        }
    }
}

#[test]
fn the_hash_sees_every_setting_and_no_layout() {
    let hash = |text: &str| Scenario::parse(text, "x.toml").unwrap().plan().unwrap().hash;
    let arm = hash(ARM);
    assert_eq!(hash(&edited(ARM, "# of all randomness", "# else")), arm);
    assert_eq!(hash(&edited(ARM, "units = [16, 16]", "")), arm, "a default written out is the default");
    assert_ne!(hash(&edited(ARM, "seed = 1", "seed = 2")), arm);
    assert_ne!(hash(&edited(ARM, "ticks = 2_000_000", "ticks = 2_000_001")), arm);
    assert_ne!(hash(&edited(ARM, "sigma = 0.003", "sigma = 0.0030000000000000005")), arm);
    assert_ne!(hash(&edited(ARM, "learning = \"learning\"", "learning = \"l\"")), arm);
}

#[test]
fn a_preset_is_found_by_any_of_its_names_and_a_file_comes_first() {
    for name in ["arm", "arm.toml", "scenarios/arm.toml", "scenarios/arm", "./scenarios/arm.toml", "./arm"] {
        assert_eq!(Scenario::find(name).unwrap().name, "arm", "{name}");
    }
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("arm.toml");
    assert_eq!(
        Scenario::find(&path).unwrap_err().to_string(),
        format!(
            "there is no file {path:?} and no built-in scenario of that name; the built-in ones are arm, paper and eye"
        )
    );
    std::fs::write(&path, edited(ARM, "name = \"arm\"", "name = \"mine\"")).unwrap();
    assert_eq!(Scenario::find(&path).unwrap().name, "mine");
    assert!(matches!(Scenario::find(folder.path()), Err(ScenarioError::Folder { .. })));
    assert_eq!(
        Scenario::find("arms").unwrap_err().to_string(),
        "there is no file \"arms\" and no built-in scenario of that name; the built-in ones are arm, paper and eye"
    );
}

#[test]
fn what_is_not_a_readable_text_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let load = |path: &Path| {
        let message = Scenario::load(path).unwrap_err().to_string();
        message.replace(&folder.path().display().to_string(), "DIR")
    };
    assert_eq!(load(folder.path()), "DIR: this is a folder; name a scenario file in it");
    let file = folder.path().join("x.toml");
    assert_eq!(load(&file), "DIR/x.toml: there is no such file; check the path");
    std::fs::write(&file, b"name = \"a\"\nticks = 1\xff\n").unwrap();
    assert_eq!(load(&file), "DIR/x.toml:2: the text is not UTF-8 here; save the file as UTF-8");
    std::fs::write(&file, " ".repeat((1 << 20) + 1)).unwrap();
    assert_eq!(
        load(&file),
        "DIR/x.toml: the file is larger than 1 MiB; a scenario is a short TOML file, so check that this is one"
    );
    let padded = format!("{ARM}{}", " ".repeat((1 << 20) - ARM.len()));
    std::fs::write(&file, padded).unwrap();
    assert!(Scenario::load(&file).is_ok(), "1 MiB itself is allowed");
    #[cfg(target_os = "linux")]
    assert!(matches!(Scenario::load(Path::new("/dev/zero")), Err(ScenarioError::TooLarge { .. })));
}

#[test]
fn a_value_changed_after_reading_is_not_blamed_on_a_line() {
    let mut scenario = Scenario::find("arm").unwrap();
    scenario.ticks = 1;
    assert_eq!(
        scenario.plan().unwrap_err().to_string(),
        "arm.toml (built in): ticks is 1; give 2 to 1000000000000 ticks"
    );
    let mut scenario = Scenario::find("arm").unwrap();
    scenario.seed = u64::MAX;
    assert!(Scenario::parse(&scenario.to_toml(), "x.toml").is_ok(), "even this can be written");
    assert_eq!(
        scenario.plan().unwrap_err().to_string(),
        "arm.toml (built in): seed is 18446744073709551615; give 0 to 9223372036854775807, the largest integer of TOML"
    );
}

/// Base text, what is replaced in it, by what, and the message that comes of it.
type Case = (&'static str, &'static str, &'static str, &'static str);

#[test]
fn every_mistake_has_its_message() {
    #[rustfmt::skip]
    let cases: &[Case] = &[
        (ARM, "name = \"arm\" ", "name = arm ", ""),
        (ARM, "seed = 1", "seed = 1\nseed = 1", ""),
        (ARM, "seed = 1", "seed = 01", ""),
        (ARM, "[plant]", "[plant", ""),
        (ARM, "hash_every = 1000", "hash_every =", ""),
        (ARM, "seed = 1", "seed = 99999999999999999999", ""),
        (ARM, "period_ms", "perod_ms", ""),
        (ARM, "lengths = ", "lenghts = ", ""),
        (ARM, "sigma = ", "temperature = ", ""),
        (ARM, "beta = ", "betta = ", ""),
        (ARM, "radius = 0.5            # rad", "raduis = 0.5", ""),
        (ARM, "[gate]", "[gates]", ""),
        (OTHER, "unit = \"rad\"", "units = \"rad\"", ""),
        (ARM, "seed = 1", "source = 1", ""),
        (EYE, "retina = \"log-polar\"", "\"a\\nb\" = \"log-polar\"", ""),
        (ARM, "name = \"arm\"", "", ""),
        (ARM, "ticks = 2_000_000", "", ""),
        (OTHER, "radius = 0.5", "", ""),
        (OTHER, ", max = 1 }", " }", ""),
        (ARM, "ticks = 2_000_000", "ticks = 2e6", ""),
        (ARM, "ticks = 2_000_000", "ticks = -5", ""),
        (ARM, "gain = 628.3185307179587", "gain = \"fast\"", ""),
        (ARM, "normalise = true", "normalise = 1", ""),
        (ARM, "base = [0.0, -1.0]", "base = [0.0]", ""),
        (ARM, "base = [0.0, -1.0]", "base = [0.0, -1.0, 0.0]", ""),
        (ARM, "base = [0.0, -1.0]", "base = 0.0", ""),
        (ARM, "lengths = [0.5, 0.5, 0.5, 0.5]", "lengths = [0.5, true]", ""),
        (ARM, "name = \"arm\"", "name = 5", ""),
        (ARM, "rule = \"paper\"", "rule = \"papers\"", ""),
        (ARM, "rule = \"paper\"", "rule = 3", ""),
        (EYE, "retina = \"log-polar\"", "retina = \"polar\"", ""),
        (ARM, "units = [16, 16]", "units = 16", ""),
        (ARM, "units = [16, 16]", "units = [16, -16]", ""),
        (ARM, "hold_ticks = 2", "hold_ticks = 5_000_000_000", ""),
        (ARM, "seed = 1", "seed = 2026-01-01", ""),
        (OTHER, "ticks = 100", "ticks = 100\nlog = 3", ""),
        (OTHER, "ticks = 100", "ticks = 100\nlog = []", ""),
        (ARM, "arena = [-1.0, 1.0]", "arena = []", ""),
        (ARM, "arena = [-1.0, 1.0]", "arena = [\"low\", 1.0]", ""),
        (ARM, "ranges = [[-1.0, 1.0], [-1.0, 1.0]]", "ranges = [[-1.0, 1.0], [-1.0, 0.0, 1.0]]", ""),
        (ARM, "ranges = [[-1.0, 1.0], [-1.0, 1.0]]", "ranges = [-1.0, 1.0]", ""),
        (ARM, "[policy]", "[policy]\n\"a.b\" = 1", ""),
        (ARM, "[policy]", "[policy]\nsigma.x = 1\n[x]", ""),
        (ARM, "name = \"arm\"", "\"\" = \"arm\"", ""),
        (ARM, "name = \"arm\"", "name = \"\"", ""),
        (ARM, "name = \"arm\"", "name = \"my arm\"", ""),
        (ARM, "name = \"arm\"", "name = \"a123456789012345678901234567890123\"", ""),
        (ARM, "period_ms = 50", "period_ms = 0.5", ""),
        (ARM, "period_ms = 50", "period_ms = nan", ""),
        (ARM, "period_ms = 50", "period_ms = 16.66666667", ""),
        (ARM, "ticks = 2_000_000", "ticks = 1", ""),
        (ARM, "ticks = 2_000_000", "ticks = 1_000_000_000_001", ""),
        (ARM, "\"tectum-simulator\"", "\" \"", ""),
        (ARM, "\"tectum-simulator\"", "\"rig\\u0000\"", ""),
        (ARM, "program = \"tectum-simulator\"", "args = [\"a\", \"b\\u0000\"]", ""),
        (OTHER, "\"./rig\"", "\"/opt/tectum-simulator\"", ""),
        (ARM, "[plant.arm]", "[plant.eye]\n[plant.arm]", ""),
        (ARM, "[plant.arm]", "measures = [\"error\"]\n[plant.arm]", ""),
        (EYE, "\"tectum-simulator\"", "\"./rig\"", ""),
        (OTHER, "inputs = [{ name = \"angle\", unit = \"rad\", min = -1, max = 1 }, { name = \"speed\", min = -2.0, max = 2.0 }]", "", ""),
        (OTHER, "outputs = [{ name = \"torque\", unit = \"Nm\", min = -0.1, max = 0.1 }]", "outputs = []", ""),
        (OTHER, "measures = [\"error\"]", "measures = [\"a\", \"b\", \"c\", \"d\", \"e\", \"f\", \"g\"]", ""),
        (OTHER, "measures = [\"error\"]", "measures = [\"a\", \"a\"]", ""),
        (OTHER, "measures = [\"error\"]", "measures = [\"\"]", ""),
        (OTHER, "\"speed\", min", "\"angle\", min", ""),
        (OTHER, "\"speed\", min", "\"forward speed\", min", ""),
        (OTHER, "unit = \"Nm\"", "unit = \"N\\tm\"", ""),
        (OTHER, "min = -1,", "min = 1,", ""),
        (OTHER, "min = -1,", "min = -inf,", ""),
        (OTHER, "max = 2.0", "max = 1e300", ""),
        (ARM, "lengths = [0.5, 0.5, 0.5, 0.5]", "lengths = []", ""),
        (ARM, "lengths = [0.5, 0.5, 0.5, 0.5]", "lengths = [1, 1, 1, 1, 1, 1, 1, 1, 1]", ""),
        (ARM, "lengths = [0.5, 0.5, 0.5, 0.5]", "lengths = [0.5, 0.5, -0.5, 0.5]", ""),
        (ARM, "base = [0.0, -1.0]", "base = [0.0, inf]", ""),
        (ARM, "gain = 628.3185307179587", "gain = 0", ""),
        (ARM, "gain = 628.3185307179587", "gain = nan", ""),
        (ARM, "arena = [-1.0, 1.0]", "arena = [1.0, -1.0]", ""),
        (ARM, "arena = [-1.0, 1.0]", "arena = [5.0, 6.0]", ""),
        (ARM, "target_every = 80", "target_every = 0", ""),
        (ARM, "# targets = [[0.5, 0.0], [-0.5, 0.2]]", "targets = [[0.5, 0.0], [-0.5, 1.2]]", ""),
        (ARM, "# targets = [[0.5, 0.0], [-0.5, 0.2]]", "targets = [[0.5, nan]]", ""),
        (ARM, "scale = 0.1", "scale = -0.1", ""),
        (ARM, "# [[plant.arm.block]]", "[[plant.arm.block]]\njoint = 5\ntick = 10", ""),
        (ARM, "# [[plant.arm.block]]", "[[plant.arm.block]]\njoint = 0\ntick = 10", ""),
        (ARM, "# [[plant.arm.block]]", "[[plant.arm.block]]\njoint = 3\ntick = 2_000_000_000_000", ""),
        (ARM, "# [[plant.arm.block]]", "[[plant.arm.block]]\njoint = 3\ntick = 10\nangle = 4.0", ""),
        (ARM, "# [[plant.arm.block]]", "[[plant.arm.block]]\njoint = 3\ntick = 10\n[[plant.arm.block]]\njoint = 3\ntick = 10", ""),
        (EYE, "distortion = 4.0", "distortion = 0", ""),
        (EYE, "spread = 0.3", "spread = inf", ""),
        (EYE, "bonus = 0.5", "bonus = 2000", ""),
        (OTHER, "[[encoder.maps]]\ninputs = [\"angle\", \"speed\"]\nradius = 0.5", "[encoder]\nmaps = []", ""),
        (OTHER, "inputs = [\"angle\", \"speed\"]", "inputs = []", ""),
        (OTHER, "inputs = [\"angle\", \"speed\"]", "inputs = [\"angle\", \"speed\", \"angle\"]", ""),
        (ARM, "inputs = [\"theta_2\"]", "inputs = [\"theta_5\"]", ""),
        (OTHER, "inputs = [\"angle\", \"speed\"]", "inputs = [\"angle\", \"angle\"]", ""),
        (ARM, "units = [16, 16]", "units = [16]", ""),
        (ARM, "ranges = [[-1.0, 1.0], [-1.0, 1.0]]", "ranges = [[-1.0, 1.0]]", ""),
        (ARM, "units = [16, 16]", "units = [16, 1_000_000]", ""),
        (ARM, "units = [16, 16]", "units = [1, 16]", ""),
        (ARM, "units = [16, 16]", "units = [256, 256]", ""),
        (ARM, "ranges = [[-1.0, 1.0], [-1.0, 1.0]]", "ranges = [[-1.0, 1.0], [1.0, 1.0]]", ""),
        (ARM, "radius = 0.5   ", "radius = 0   ", ""),
        (ARM, "radius = 0.5   ", "radius = 0.01   ", ""),
        (ARM, "sigma = 0.003", "sigma = 0", ""),
        (ARM, "sigma = 0.003", "sigma = 0.06", ""),
        (ARM, "beta = 0.9", "beta = 1", ""),
        (ARM, "alpha_over_variance = 0.01", "alpha_over_variance = -0.01", ""),
        (ARM, "max_command = 0.05", "max_command = nan", ""),
        (ARM, "hold_ticks = 2", "hold_ticks = 1_000_001", ""),
        (ARM, "every = 20", "every = 0", ""),
        (ARM, "hash_every = 1000", "hash_every = 0", ""),
        (ARM, "command = \"command\"", "command = \"observation\"", ""),
        (ARM, "command = \"command\"", "command = \"Command\"", ""),
        (ARM, "learning = \"learning\"", "learning = \"\"", ""),
    ];
    for (base, from, to, message) in cases {
        println!("@@{}", refusal(&edited(base, from, to)));
        let _ = message;
    }
}
