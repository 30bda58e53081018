//! Scenario files: the shipped ones load, and a bad one is refused with a helpful message.
//!
//! The table of messages is exact on purpose: a change of wording changes what users read and must be reviewed here.

#[path = "support/scenario_mistakes.rs"]
mod scenario_mistakes;

use std::path::Path;

use scenario_mistakes::{ARM, CASES, EYE, OTHER};
use tectum::{
    encoder::Map,
    plant::Plant as _,
    scenario::{LearnerConfig, Retina, Rule, Scenario, ScenarioError, presets},
};

/// The message that reading or planning gives for a text.
fn refusal(text: &str) -> String {
    match Scenario::parse(text, "x.toml").and_then(Scenario::plan) {
        Ok(_) => "accepted".to_owned(),
        Err(error) => error.to_string(),
    }
}

/// The base text with one replacement.
fn edited(base: &str, from: &str, to: &str) -> String {
    assert!(base.contains(from), "the base text has no {from:?}");
    base.replacen(from, to, 1)
}

#[test]
fn the_shipped_files_equal_the_built_in_scenarios() {
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
fn the_paper_scenario_has_the_papers_settings() {
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

    // The scenario `arm` has the same signals.
    let arm = Scenario::find("arm").unwrap().plan().unwrap();
    assert_eq!((&arm.inputs, &arm.outputs, &arm.measures), (&plan.inputs, &plan.outputs, &plan.measures));
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

/// Targets are drawn from a normal distribution: the declared ranges hold all that a run will see.
#[test]
fn the_eyes_inputs_lie_within_their_ranges() {
    for retina in [Retina::LogPolar, Retina::Linear] {
        let mut scenario = Scenario::find("eye").unwrap();
        scenario.plant.eye.as_mut().unwrap().retina = retina;
        let linear = ["position_x", "position_y", "velocity_x", "velocity_y"];
        if retina == Retina::Linear {
            for (map, names) in scenario.encoder.maps.iter_mut().zip(linear.chunks(2)) {
                map.inputs = names.iter().map(|&name| name.to_owned()).collect();
            }
        }
        let plan = scenario.plan().unwrap();
        let mut eye = plan.simulated_plant().unwrap();
        let (mut inputs, mut farthest) = ([0.0; 4], 0.0_f32);
        for tick in 0..200_000 {
            eye.sense(tick, &mut inputs);
            for (value, input) in inputs.iter().zip(&plan.inputs) {
                assert!((input.min..=input.max).contains(&f64::from(*value)), "{} is {value}", input.name);
            }
            farthest = farthest.max(inputs[0]);
        }
        assert!(farthest > 1.0, "targets appear beyond the retina's edge, too");
    }
}

/// `learned-reward` must know which inputs the commands move. Nothing is guessed.
#[test]
fn what_the_commands_move_is_said_by_the_plant_or_by_the_scenario() {
    let plan = |name: &str, moved: &[&str]| {
        let mut scenario = Scenario::find(name).unwrap();
        scenario.learner = LearnerConfig::preset(Rule::LearnedReward);
        let moved = moved.iter().map(|&name| name.to_owned()).collect();
        scenario.learner.model.get_or_insert_default().moved = moved;
        scenario.plan()
    };
    for name in ["arm", "so101", "so101-planar"] {
        let spec = plan(name, &[]).unwrap().learner_spec();
        let outputs = plan(name, &[]).unwrap().outputs.len();
        let angles = spec.inputs[spec.inputs.len() - outputs..].iter().map(|input| input.name.clone());
        assert_eq!(spec.moved, angles.collect::<Vec<_>>(), "{name}");
    }
    let missing = plan("pendulum", &[]).unwrap_err().to_string();
    let expected = "learner.model.moved is missing, and the plant does not say it; name the inputs that the commands \
                    move, of \"theta\", \"omega\"";
    assert!(missing.contains(expected), "{missing}");
    plan("pendulum", &["omega"]).unwrap();
}

#[test]
fn the_number_of_updates_is_part_of_a_scenario() {
    let arm = Scenario::find("arm").unwrap();
    let with = |updates: u32| {
        let mut scenario = arm.clone();
        scenario.controller.updates = updates;
        scenario.plan()
    };
    let hash = |updates| with(updates).unwrap().hash;
    assert!(hash(1) == arm.clone().plan().unwrap().hash && hash(2) != hash(1));
    let refused = with(0).unwrap_err().to_string();
    assert!(refused.contains("controller.updates is 0; give 1 to 1000 updates a tick"), "{refused}");
    assert!(with(1001).is_err());
}

#[test]
fn arm_settings_determine_inputs_outputs_and_measures() {
    let plan = |text: &str| Scenario::parse(text, "x.toml").and_then(Scenario::plan).unwrap();
    let limits = "limits = [[-1, 0.5], [-2, 2], [-2.6, 2.6], [0, 3]]";
    let limited = plan(&edited(ARM, "base = [0.0, -1.0]", limits));
    let ranges: Vec<_> = limited.inputs[2..].iter().map(|input| [input.min, input.max]).collect();
    assert_eq!(ranges, [[-1.0, 0.5], [-2.0, 2.0], [-2.6, 2.6], [0.0, 3.0]]);
    let Map::Line(axis) = limited.maps[1] else { panic!("a line") };
    assert_eq!((axis.min, axis.max), (-1.0, 0.5), "maps follow the limits");

    let costly = plan(&edited(ARM, "scale = 0.1", "collision = 0.5"));
    assert_eq!(costly.measures, ["error", "end_x", "end_y", "crossings"]);

    let tilted = edited(ARM, "arena = [-1.0, 1.0]", "arena = [-0.5, 1.0]\nmirror = [{ axis = \"y\", tick = 7 }]");
    let [x, y] = [0, 1].map(|i| plan(&tilted).inputs[i].clone());
    assert_eq!(([x.min, x.max], [y.min, y.max]), ([-0.5, 1.0], [-1.0, 1.0]));

    let open = Scenario::find("open-loop-3").unwrap();
    let inputs: Vec<_> = open.clone().plan().unwrap().inputs.into_iter().map(|input| input.name).collect();
    let outputs: Vec<_> = open.clone().plan().unwrap().outputs.into_iter().map(|output| output.name).collect();
    assert_eq!(inputs, ["target_x", "target_y"]);
    assert_eq!(outputs, ["angle_1", "angle_2", "angle_3"]);
    let mut open = open;
    open.learner.rule = tectum::scenario::Rule::LearnedReward;
    assert!(open.plan().unwrap_err().to_string().ends_with(
        "learner.rule is learned-reward, which needs inputs that the commands move; an arm in an open loop has \
             none, so give it paper"
    ));
}

/// The number of units of all maps.
fn features(maps: &[Map]) -> usize {
    let units = |map: &Map| match map {
        Map::Line(axis) => axis.units,
        Map::Plane(first, second) => first.units * second.units,
    };
    maps.iter().map(units).sum()
}

#[test]
fn another_plant_program_has_its_own_signals_or_the_arms() {
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
fn a_resolved_file_writes_out_every_key_and_gives_the_same_plan() {
    for text in presets().iter().map(|preset| preset.text).chain([ARM, EYE, OTHER]) {
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
fn the_hash_depends_on_settings_and_not_on_layout() {
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
            "there is no scenario {path:?}: no file {} exists, and no built-in scenario has that name; \
             did you mean \"arm\"?",
            path.display()
        )
    );
    std::fs::write(&path, edited(ARM, "name = \"arm\"", "name = \"mine\"")).unwrap();
    assert_eq!(Scenario::find(&path).unwrap().name, "mine");
    assert!(matches!(Scenario::find(folder.path()), Err(ScenarioError::Folder { .. })));
}

#[test]
fn a_misspelt_name_gets_suggestions() {
    let remedy = |name: &str| {
        let message = Scenario::find(name).unwrap_err().to_string();
        let here = std::env::current_dir().unwrap().join(name);
        let start = format!(
            "there is no scenario {name:?}: no file {} exists, and no built-in scenario has that name; ",
            here.display()
        );
        message.strip_prefix(&start).unwrap_or_else(|| panic!("{message}")).to_owned()
    };
    for (name, remedies) in [
        ("arms", "did you mean \"arm\"?"),
        ("PAPRE.toml", "did you mean \"paper\"?"),
        ("openloop3", "did you mean \"open-loop-3\"?"),
        ("open-loop", "did you mean \"open-loop-3\" or \"open-loop-4\"?"),
        ("servo", "did you mean \"servo-simulated\", \"servo-emulated\" or \"servo-vision\"?"),
        (
            "nowhere",
            "the built-in ones are arm, paper, eye, near, laplace, limited, relative, collision, todorov, \
             open-loop-3, open-loop-4, office, pendulum, cart-pole, so101, so101-emulated, so101-planar, \
             servo-simulated, servo-emulated and servo-vision",
        ),
    ] {
        assert_eq!(remedy(name), remedies, "{name}");
    }
    // A file whose extension was left out is nearer than any built-in scenario.
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("arms.toml"), ARM).unwrap();
    let message = Scenario::find(folder.path().join("arms")).unwrap_err().to_string();
    assert!(message.ends_with("/arms.toml\"?"), "{message}");
}

#[test]
fn unreadable_files_are_refused() {
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
fn a_value_changed_after_reading_has_no_line_number() {
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

#[test]
fn every_mistake_has_its_message() {
    let wrong: Vec<_> = CASES
        .iter()
        .map(|(base, from, to, message)| (refusal(&edited(base, from, to)), *message))
        .filter(|(refusal, message)| refusal != message)
        .map(|(refusal, message)| format!("expected {message}\n   found {refusal}\n"))
        .collect();
    assert!(wrong.is_empty(), "{}", wrong.concat());
}
