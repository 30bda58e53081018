//! Property tests: for any text, parsing and planning give either a plan that keeps its bounds or an error
//! message, and never panic.

use std::f64::consts::PI;

use proptest::prelude::*;

use super::*;
use crate::limits::{MAX_INPUTS, MAX_MEASURES, MAX_OUTPUTS};

/// Asserts all bounds on which the rest of the program relies. The numbers are repeated here instead of taken
/// from [`limits`], so that a wrong number there fails a test.
fn assert_bounds(plan: &Plan) {
    let s = &plan.scenario;
    assert!(fits(&s.name, 32) && s.name.chars().all(|c| c.is_ascii_alphanumeric() || c == '-' || c == '_'));
    assert!(s.seed <= i64::MAX as u64);
    assert!((1_000_000..=1_000_000_000).contains(&plan.period_ns));
    assert_eq!(plan.period_ns as f64 / 1e6, s.period_ms);
    assert!((2..=1_000_000_000_000).contains(&s.ticks));
    assert_signals(plan);
    assert_maps(plan);
    assert_gate(plan);
    assert!(s.overrun.max_consecutive <= 1_000_000_000_000);
    assert_faults(&s.faults);
    assert!((0.0..1.0).contains(&s.learner.beta) && (0.0..=1000.0).contains(&s.learner.alpha_over_variance));
    assert!(s.log.every >= 1 && s.log.hash_every >= 1);
    let channels = [&s.channels.observation, &s.channels.command, &s.channels.learning];
    for (i, channel) in channels.iter().enumerate() {
        assert!(fits(channel, 64) && !channels[..i].contains(channel));
        assert!(channel.bytes().all(|c| c.is_ascii_lowercase() || c.is_ascii_digit() || b"_-/".contains(&c)));
    }
    assert!(!s.plant.program.trim().is_empty());
    if s.plant.program == "tectum-simulator" {
        assert!(s.plant.body().is_some());
    }
    if let Some(arm) = &s.plant.arm {
        assert_arm(arm);
    }
    if let Some(eye) = &s.plant.eye {
        assert!((1e-3..=1e6).contains(&eye.distortion) && (1e-6..=10.0).contains(&eye.spread));
        assert!(eye.bonus.abs() <= 1000.0);
    }
}

/// A program may use the simulator's table and be another body: what runs in its place would be another experiment.
#[test]
fn another_programs_plant_is_not_simulated_in_its_place() {
    let plan = |program: &str| {
        let mut scenario = Scenario::built_in("arm").unwrap();
        scenario.plant.program = program.to_owned();
        scenario.plan().unwrap()
    };
    let own = plan("bin/my-arm");
    assert!(own.simulated_plant().is_none() && own.described_plant().is_some());
    assert!(plan("bin/tectum-simulator").simulated_plant().is_some());
}

/// Whether a text has 1 to `max_chars` characters.
fn fits(text: &str, max_chars: usize) -> bool {
    (1..=max_chars).contains(&text.chars().count())
}

fn assert_signals(plan: &Plan) {
    for (signals, max_len) in [(&plan.inputs, MAX_INPUTS), (&plan.outputs, MAX_OUTPUTS)] {
        assert!((1..=max_len).contains(&signals.len()));
        for (i, signal) in signals.iter().enumerate() {
            assert!(fits(&signal.name, 32) && signal.unit.chars().count() <= 32);
            assert!(-1e9 <= signal.min && signal.min < signal.max && signal.max <= 1e9);
            assert!(signals[..i].iter().all(|other| other.name != signal.name));
        }
    }
    assert!(plan.measures.len() <= MAX_MEASURES && plan.measures.iter().all(|name| fits(name, 32)));
}

fn assert_maps(plan: &Plan) {
    assert!((1..=64).contains(&plan.maps.len()));
    assert_eq!(plan.maps.len(), plan.scenario.encoder.maps.len());
    let mut features = 0;
    for map in &plan.maps {
        let axes = match *map {
            Map::Line(axis) => vec![axis],
            Map::Plane(first, second) => {
                assert_ne!(first.input, second.input);
                vec![first, second]
            }
        };
        for axis in &axes {
            assert!(axis.input < plan.inputs.len() && (2..=4096).contains(&axis.units));
            assert!(-1e9 <= axis.min && axis.min < axis.max && axis.max <= 1e9);
            assert!((1e-9..=1e9).contains(&axis.radius));
            assert!((axis.max - axis.min) / (axis.units - 1) as f64 <= 10.0 * axis.radius);
        }
        features += axes.iter().map(|axis| axis.units).product::<usize>();
    }
    assert!(features <= 65_536);
}

fn assert_gate(plan: &Plan) {
    let (s, outputs) = (&plan.scenario, plan.outputs.len());
    for numbers in std::iter::once(&s.gate.max_command).chain(&s.gate.max_step) {
        assert!((0..outputs).all(|i| 0.0 < numbers.of(i) && numbers.of(i) <= 1e6));
        assert!(!matches!(numbers, PerOutput::Each(list) if list.len() != outputs));
    }
    assert!((0..outputs).all(|i| 0.0 < s.policy.sigma && s.policy.sigma <= s.gate.max_command.of(i)));
    assert!(s.gate.hold_ticks <= 1_000_000 && s.gate.decay_ticks <= 1_000_000 && s.gate.ramp_ticks <= 1_000_000);
    assert!(s.gate.positions.is_empty() || (s.gate.positions.len() == outputs && s.plant.eye.is_none()));
    assert!(s.gate.positions.iter().all(|[low, high]| -1000.0 <= *low && low + 0.001 <= *high && *high <= 1000.0));
}

fn assert_arm(arm: &ArmConfig) {
    assert!((1..=8).contains(&arm.lengths.len()) && arm.lengths.iter().all(|l| (1e-3..=100.0).contains(l)));
    assert!(arm.base.iter().all(|b| b.abs() <= 1000.0) && arm.arena.iter().all(|a| a.abs() <= 1000.0));
    assert!(arm.arena[0] < arm.arena[1] && arm.gain.abs() <= 1e6 && arm.gain != 0.0 && arm.target_every >= 1);
    assert!(arm.targets.iter().flatten().all(|x| (arm.arena[0]..=arm.arena[1]).contains(x)));
    let weights = [arm.reward.scale, arm.reward.speed, arm.reward.angle, arm.reward.collision];
    assert!(weights.iter().all(|w| (0.0..=1e6).contains(w)));
    assert!(arm.reward.near.is_none_or(|near| (1e-3..=100.0).contains(&near)));
    assert!(arm.limits.is_empty() || arm.limits.len() == arm.lengths.len());
    for [low, high] in &arm.limits {
        assert!(-PI <= *low && *low <= 0.0 && 0.0 <= *high && *high <= PI && low < high && high - low <= 6.25);
    }
    assert!(!arm.open_loop || arm.target_every == 1);
    assert!(arm.shorten.len() <= 64 && arm.mirror.len() <= 64);
    for (i, change) in arm.shorten.iter().enumerate() {
        assert!((1..=arm.lengths.len()).contains(&change.segment) && (1e-3..=100.0).contains(&change.length));
        assert!(arm.shorten[..i].iter().all(|other| (other.segment, other.tick) != (change.segment, change.tick)));
    }
    for (i, block) in arm.block.iter().enumerate() {
        assert!((1..=arm.lengths.len()).contains(&block.joint) && block.angle.abs() <= PI);
        assert!(arm.block[..i].iter().all(|other| (other.joint, other.tick) != (block.joint, block.tick)));
    }
}

fn assert_faults(faults: &FaultsConfig) {
    assert!(faults.channel.len() <= 16 && faults.process.len() <= 16);
    for fault in &faults.channel {
        assert!(fault.probability.is_none_or(|p| 0.0 < p && p <= 1.0));
        assert!(fault.probability.is_some() || fault.from.is_some() || fault.until.is_some());
        assert!(fault.until.is_none_or(|until| fault.from.unwrap_or(0) < until && until <= 1_000_000_000_000));
        assert!(fault.from.is_none_or(|from| from <= 1_000_000_000_000));
        let max_ticks = match fault.kind {
            FaultKind::Delay | FaultKind::Duplicate => 16,
            FaultKind::Freeze => 1_000_000,
            _ => 1,
        };
        assert!((1..=max_ticks).contains(&fault.ticks()));
        assert_eq!(fault.value.is_some(), fault.kind == FaultKind::Corrupt);
    }
    for fault in &faults.process {
        assert!((1..=1000).contains(&fault.at.len()) && fault.at.is_sorted_by(|a, b| a < b));
        assert!(fault.at.iter().all(|&tick| tick <= 1_000_000_000_000));
        assert_eq!(fault.for_ms.is_some(), fault.act == ProcessFaultKind::Stop);
        assert!(fault.for_ms.is_none_or(|ms| (1.0..=60_000.0).contains(&ms)));
    }
    assert_eq!(faults.in_words().len(), faults.channel.len() + faults.process.len());
}

/// Parses and plans a text. Asserts the bounds of the plan, or the form of the message.
fn assert_plan_or_message(text: &str) {
    match Scenario::parse(text, "x.toml") {
        Ok(scenario) => {
            let written = scenario.to_toml();
            assert_eq!(Scenario::parse(&written, "y.toml").unwrap().to_toml(), written, "{written}");
            match scenario.plan() {
                Ok(plan) => {
                    assert_bounds(&plan);
                    assert_eq!(Scenario::parse(&plan.scenario.to_toml(), "y.toml").unwrap().plan().unwrap(), plan);
                }
                Err(error) => assert_message(&error),
            }
        }
        Err(error) => assert_message(&error),
    }
}

/// Asserts that a message is one line of fewer than 1000 characters, begins with the file, and has none of
/// serde's terms.
fn assert_message(error: &ScenarioError) {
    let message = error.to_string();
    assert!(message.starts_with("x.toml:"), "{message}");
    assert!(message.chars().count() < 1000 && !message.chars().any(char::is_control), "{message}");
    for word in ["invalid type", "invalid value", "unknown field", "missing field", "struct ", "f64", "usize"] {
        assert!(!message.contains(word), "{message}");
    }
}

/// Byte ranges of the numbers in a text. Includes numbers in comments, where an edit has no effect.
fn numbers(text: &str) -> Vec<std::ops::Range<usize>> {
    let bytes = text.as_bytes();
    let digit = |i: usize| i < bytes.len() && (bytes[i].is_ascii_digit() || b"._".contains(&bytes[i]));
    let starts = (1..bytes.len()).filter(|&i| bytes[i].is_ascii_digit() && b" [-".contains(&bytes[i - 1]));
    starts.map(|start| start..(start..).find(|&i| !digit(i)).unwrap_or(bytes.len())).collect()
}

#[derive(Debug, Clone)]
enum Edit {
    Flip(prop::sample::Index, u8),
    Delete(prop::sample::Index, usize),
    Repeat(prop::sample::Index, usize),
    Number(prop::sample::Index, &'static str),
    DropLine(prop::sample::Index),
}

fn edit() -> impl Strategy<Value = Edit> {
    let values = vec![
        "nan",
        "-nan",
        "inf",
        "-inf",
        "-1",
        "0",
        "-0.0",
        "1",
        "2",
        "3",
        "1e300",
        "-1e300",
        "1e-300",
        "5e-324",
        "0.5",
        "9223372036854775807",
        "-9223372036854775808",
        "9223372036854775808",
        "1_000_000_000_001",
        "65536",
        "4096",
        "0x7fffffff",
        "true",
        "\"x\"",
        "[]",
        "{}",
        "1979-05-27",
        "1.0",
    ];
    let at = any::<prop::sample::Index>;
    prop_oneof![
        2 => (at(), any::<u8>()).prop_map(|(at, byte)| Edit::Flip(at, byte)),
        2 => (at(), 1..40usize).prop_map(|(at, n)| Edit::Delete(at, n)),
        1 => (at(), 1..400usize).prop_map(|(at, n)| Edit::Repeat(at, n)),
        6 => (at(), prop::sample::select(values)).prop_map(|(at, value)| Edit::Number(at, value)),
        2 => at().prop_map(Edit::DropLine),
    ]
}

fn applied(text: &str, edit: &Edit) -> String {
    let mut bytes = text.as_bytes().to_vec();
    if bytes.is_empty() {
        return String::new();
    }
    match edit {
        Edit::Flip(at, byte) => {
            let at = at.index(bytes.len());
            bytes[at] = *byte;
        }
        Edit::Delete(at, n) => {
            let at = at.index(bytes.len());
            bytes.drain(at..(at + n).min(text.len()));
        }
        Edit::Repeat(at, n) => {
            let at = at.index(bytes.len());
            let piece = bytes[at..(at + n).min(text.len())].to_vec();
            bytes.splice(at..at, piece);
        }
        Edit::Number(at, value) => {
            let numbers = numbers(text);
            if !numbers.is_empty() {
                bytes.splice(numbers[at.index(numbers.len())].clone(), value.bytes());
            }
        }
        Edit::DropLine(at) => {
            let lines: Vec<_> = text.lines().collect();
            let at = at.index(lines.len());
            bytes = [&lines[..at], &lines[at + 1..]].concat().join("\n").into_bytes();
        }
    }
    String::from_utf8_lossy(&bytes).into_owned()
}

/// An arm scenario with all keys of arm, gate, overrun and faults.
fn scenario_with_all_tables() -> Scenario {
    let mut scenario = presets()[0].scenario().unwrap();
    let arm = scenario.plant.arm.get_or_insert_default();
    arm.targets = vec![[0.5, 0.0], [-0.5, 0.2]];
    arm.block = vec![BlockConfig { joint: 3, tick: 1000, angle: 0.5 }, BlockConfig { joint: 1, tick: 9, angle: 0.0 }];
    arm.shorten = vec![ShortenConfig { segment: 2, tick: 500, length: 0.3 }];
    arm.mirror = vec![MirrorConfig { axis: MirrorAxis::Y, tick: 700 }];
    arm.limits = vec![[-2.6, 2.6]; arm.lengths.len()];
    arm.hidden_limits = true;
    (arm.reward.near, arm.reward.collision, arm.reward.blocked_pays) = (Some(0.5), 0.1, true);
    scenario.plant.args = vec!["--quiet".to_owned()];
    scenario.gate = toml::from_str(
        "max_command = [0.1, 0.2, 0.05, 0.1]\nmax_step = 0.02\nramp_ticks = 10\n\
         positions = [[-2.5, 2.5], [-1, 1], [-100, 100], [0, 3]]",
    )
    .unwrap();
    scenario.overrun.max_consecutive = 20;
    scenario.faults = toml::from_str(
        "[[channel]]\nchannel = \"observation\"\nkind = \"delay\"\nprobability = 0.1\nticks = 3\n\
         [[channel]]\nchannel = \"command\"\nkind = \"freeze\"\nfrom = 10\nuntil = 20\nticks = 100\n\
         [[channel]]\nchannel = \"command\"\nkind = \"corrupt\"\nfrom = 5\nvalue = \"nan\"\n\
         [[process]]\nprocess = \"logger\"\ndo = \"stop\"\nat = [100, 200]\nfor_ms = 250\n\
         [[process]]\nprocess = \"plant\"\ndo = \"kill\"\nat = [7]",
    )
    .unwrap();
    scenario
}

/// The presets, an arm with all tables, and a plant of another program.
fn texts() -> Vec<String> {
    let mut other = presets()[0].scenario().unwrap();
    other.plant = PlantConfig {
        program: "./rig".to_owned(),
        inputs: ["angle", "speed"]
            .map(|name| SignalConfig { name: name.into(), unit: "".into(), min: -1.0, max: 2.0, wraps: None })
            .into(),
        outputs: vec![SignalConfig { name: "torque".into(), unit: "Nm".into(), min: -0.1, max: 0.1, wraps: None }],
        measures: vec!["error".into(), "current".into()],
        ..other.plant
    };
    other.plant.arm = None;
    other.encoder.maps.truncate(1);
    other.encoder.maps[0].inputs = vec!["angle".to_owned(), "speed".to_owned()];
    if let Some(model) = &mut other.learner.model {
        model.moved = vec!["angle".to_owned(), "speed".to_owned()];
    }
    let built = [scenario_with_all_tables().to_toml(), other.to_toml()];
    presets().iter().map(|preset| preset.text.to_owned()).chain(built).collect()
}

/// A file may say which inputs wrap, which measure is the error, and the radius along each axis. What it leaves out is
/// as before.
#[test]
fn roles_wrapping_and_radii_are_explicit() {
    let text = |measures: &str, wraps: &str, radius: &str| {
        format!(
            "name = \"x\"\nticks = 100\n[plant]\nprogram = \"p\"\nmeasures = {measures}\n\
             inputs = [{{ name = \"a\", unit = \"deg\", min = -3.141592653589793, max = 3.141592653589793{wraps} }},\n\
             {{ name = \"b\", unit = \"rad\", min = -3.141592653589793, max = 3.141592653589793 }}]\n\
             outputs = [{{ name = \"c\", min = -1, max = 1 }}]\n\
             [encoder]\nmaps = [{{ inputs = [\"a\", \"b\"], radius = {radius} }}]\n"
        )
    };
    let plan = |text: &str| Scenario::parse(text, "x.toml").unwrap().plan().unwrap();
    let usual = plan(&text("[\"size\", \"error\"]", "", "1"));
    assert_eq!((usual.error, usual.inputs[0].wraps(), usual.inputs[1].wraps()), (Some(1), false, true));
    let other = plan(&text("[{ name = \"size\", role = \"error\" }, \"error\"]", ", wraps = true", "[1, 2]"));
    assert_eq!((other.error, other.inputs[0].wraps()), (Some(0), true));
    assert_eq!(other.measures, ["size", "error"]);
    let Map::Plane(a, b) = &other.maps[0] else { panic!("{:?}", other.maps) };
    assert_eq!((a.radius, b.radius), (1.0, 2.0));
    // The file with every default written out is the same scenario.
    assert_eq!(plan(&other.scenario.to_toml()).hash, other.hash);
    let wrong = text("[]", ", wraps = true", "1").replacen("max = 3.141592653589793", "max = 3.2", 1);
    let message = Scenario::parse(&wrong, "x.toml").unwrap().plan().unwrap_err().to_string();
    assert!(message.contains("plant.inputs[0].wraps is true, and the range is"), "{message}");
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 1500, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn an_edited_file_gives_a_plan_or_a_message(
        which in any::<prop::sample::Index>(),
        edits in prop::collection::vec(edit(), 1..4),
    ) {
        let text = edits.iter().fold(which.get(&texts()).clone(), |text, edit| applied(&text, edit));
        assert_plan_or_message(&text);
    }

    #[test]
    fn any_text_gives_a_plan_or_a_message(text in "(?s).{0,200}") {
        assert_plan_or_message(&text);
    }
}

#[test]
fn the_texts_that_the_tests_edit_are_valid() {
    for text in texts() {
        let plan = Scenario::parse(&text, "x.toml").unwrap().plan().unwrap();
        assert_bounds(&plan);
    }
}

#[test]
fn any_number_replaced_by_an_extreme_one_gives_a_plan_or_a_message() {
    for text in texts() {
        for range in numbers(&text) {
            for value in ["nan", "inf", "-inf", "-1", "0", "1e300", "9223372036854775807"] {
                let mut text = text.clone();
                text.replace_range(range.clone(), value);
                assert_plan_or_message(&text);
            }
        }
    }
}

#[test]
fn deep_and_long_texts_give_a_message() {
    assert_plan_or_message(&format!("name = {}", "[".repeat(100_000)));
    assert_plan_or_message(&"a.".repeat(100_000));
    assert_plan_or_message(&"[a]\n".repeat(10_000));
    assert_plan_or_message(&format!("name = \"{}\"\n", "\u{e9}".repeat(100_000)));
    assert_plan_or_message(&format!("{} = 1\n", "k".repeat(100_000)));
    assert_plan_or_message(&format!("seed = \"{}\"\n", "\\n".repeat(100_000)));
    assert_plan_or_message(&format!("seed = {}\n", "9".repeat(100_000)));
    let mut many = scenario_with_all_tables();
    many.plant.arm.get_or_insert_default().targets = vec![[0.5, 0.0]; 50_000];
    assert_plan_or_message(&many.to_toml());
}

#[test]
fn a_scenario_built_in_memory_is_checked_too() {
    let mut scenario = presets()[0].scenario().unwrap();
    scenario.encoder.maps[0].units = vec![usize::MAX, usize::MAX];
    scenario.log.every = u64::MAX;
    assert_plan_or_message(&scenario.to_toml());
    let error = scenario.plan().unwrap_err();
    assert!(error.to_string().contains("encoder.maps[0].units[0] is 18446744073709551615"), "{error}");
}

#[test]
fn missing_keys_get_the_defaults_of_the_files_rule() {
    use super::{LearnerConfig, Rule};
    let learner = |table: &str| {
        let arm = std::fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/scenarios/arm.toml")).unwrap();
        let text = arm.replacen("[learner]\nrule = \"model-predictive\"", &format!("[learner]\n{table}"), 1);
        assert_ne!(text, arm);
        Scenario::parse(&text, "x").unwrap().learner
    };
    for (name, rule) in [("actor-critic", Rule::ActorCritic), ("natural-actor-critic", Rule::NaturalActorCritic)] {
        assert_eq!(learner(&format!("rule = \"{name}\"")), LearnerConfig::preset(rule));
        let given = learner(&format!("rule = \"{name}\"\nbeta = 0.5\n[learner.critic]\nstep = 0.125"));
        let mut expected = LearnerConfig { beta: 0.5, ..LearnerConfig::preset(rule) };
        expected.critic.as_mut().unwrap().step = 0.125;
        assert_eq!(given, expected);
    }
    assert_eq!(learner("alpha_over_variance = 0.02").rule, Rule::Paper);
}

#[test]
fn encoders_that_a_rule_does_not_support_are_refused() {
    use super::{LearnerConfig, Rule};
    let message = |rule: Rule, change: &dyn Fn(&mut Scenario)| {
        let mut scenario = Scenario::built_in("paper").unwrap();
        scenario.learner = LearnerConfig::preset(rule);
        change(&mut scenario);
        scenario.plan().err().map_or("fine".to_owned(), |e| e.to_string())
    };
    let wide = |s: &mut Scenario| s.encoder.maps[1].units = vec![257];
    let wider = |s: &mut Scenario| s.encoder.maps[1].units = vec![1024];
    let scalar = |s: &mut Scenario| s.encoder.scalars = vec!["theta_1".to_owned()];
    assert!(
        message(Rule::LearnedReward, &wide).contains("encoder.maps[1].units is 257; the rule learned-reward supports")
    );
    assert!(message(Rule::LearnedReward, &scalar).contains("encoder.scalars is given, and the rule learned-reward"));
    assert!(message(Rule::NaturalActorCritic, &wider).contains("learner.rule is natural-actor-critic, for which 1328"));
    assert_eq!(message(Rule::NaturalActorCritic, &wide), "fine");
    assert_eq!([message(Rule::ActorCritic, &wider), message(Rule::Paper, &scalar)], ["fine"; 2]);
}
