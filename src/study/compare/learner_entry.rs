//! A learner in a comparison: its scenario, its length, and the changes of the arm during its runs.

use serde::Deserialize as _;
use serde::de::IntoDeserializer as _;

use super::ArmChange;
use crate::scenario::programs::is_simulator;
use crate::scenario::{ArmConfig, FilePosition, LearnerConfig, Plan, Rule, Scenario, ScenarioError, merge};
use crate::study::StudyError;
use crate::text::thousands;

/// All learners, in the order in which they are shown.
pub const LEARNERS: [Rule; 6] = Rule::ALL;

/// Standard deviation of the exploration noise in a comparison: that of the paper, in units of the command.
const PAPER_SIGMA: f64 = 0.003;

/// Estimated time of a tick of a program at the other end of a pipe, with its share of the tests, ns.
const PIPED_TICK_NS: u64 = 200_000;

/// Which changes of the arm the learners meet.
#[derive(Debug, Clone, PartialEq)]
pub enum Changes {
    /// Joint 3 blocks at a tick by which the learner should have learned. No change if the run is shorter.
    Usual,
    /// No changes.
    None,
    /// These changes, in the order of their ticks.
    These(Vec<ArmChange>),
}

/// A learner with its scenario.
#[derive(Debug, Clone)]
pub(crate) struct LearnerEntry {
    /// The rule's name, as in scenarios; of a scenario of one's own, that of the scenario.
    pub name: String,
    /// The scenario with seed 0.
    pub plan: Plan,
    /// The changes of the arm, in the order of their ticks.
    pub changes: Vec<ArmChange>,
    /// Estimated time of a tick, ns. It orders the jobs: long runs start first.
    pub(super) estimated_tick_ns: u64,
    /// Factor of the intervals between tests. A learner that plans takes as long for a tick of the test as for one of
    /// the run, and a test has 3,200 of them.
    pub(super) test_stride: u64,
}

/// A rule's usual length of a run (ticks), its usual tick of the block, and the estimated time of a tick
/// (ns).
///
/// The runs are long enough for the learner to reach its final loss and to recover from the block, and short
/// enough for a comparison of all learners within minutes.
fn usual(rule: Rule) -> (u64, u64, u64) {
    match rule {
        Rule::Paper => (12_000_000, 10_000_000, 2_500),
        Rule::Baseline => (5_000_000, 4_000_000, 2_500),
        Rule::ActorCritic => (400_000, 200_000, 3_000),
        Rule::NaturalActorCritic => (400_000, 200_000, 30_000),
        Rule::LearnedReward => (6_000, 3_000, 3_000_000),
        Rule::ModelPredictive => (2_400, 1_200, 20_000_000),
    }
}

/// What can be compared.
#[derive(Debug, Clone, PartialEq)]
pub enum ComparedLearner {
    /// A rule of this package, with its preset.
    Rule(Rule),
    /// Controller, encoder, policy and learner of a scenario; a controller's program of one's own among them.
    Scenario(Box<Scenario>),
}

/// Whether a learner's name is the path of a scenario.
pub(crate) fn is_path(name: &str) -> bool {
    name.contains('/') || name.ends_with(".toml")
}

/// The learner with this name: that of a rule, or the path of a scenario.
///
/// # Errors
/// [`StudyError::Asked`], with a list of the names; for a path, when there is no such scenario.
pub fn learner(name: &str) -> Result<ComparedLearner, StudyError> {
    if is_path(name) {
        return Ok(ComparedLearner::Scenario(Box::new(Scenario::find(name)?)));
    }
    let source: serde::de::value::StrDeserializer<'_, serde::de::value::Error> = name.into_deserializer();
    Rule::deserialize(source).map(ComparedLearner::Rule).map_err(|_| {
        let known = LEARNERS.map(name_of).join(", ");
        StudyError::Asked(format!(
            "there is no learner {name:?}; the learners are {known}, and a scenario file (NAME.toml) is one of your own"
        ))
    })
}

/// The name of a rule, as in scenarios.
pub(crate) fn name_of(rule: Rule) -> String {
    toml::Value::try_from(rule).ok().and_then(|name| name.as_str().map(str::to_owned)).unwrap_or_default()
}

/// The number of a learner's colour in figures. A rule's does not depend on the other learners; those of one's own come
/// after the rules, in the order of `names`.
pub(crate) fn colour_number<'a>(name: &str, names: impl Iterator<Item = &'a str>) -> usize {
    let place = |name: &str| LEARNERS.iter().position(|&rule| name_of(rule) == name);
    let own = names.filter(|other| place(other).is_none());
    place(name).unwrap_or_else(|| LEARNERS.len() + own.take_while(|other| *other != name).count())
}

/// The built-in arm with seed 0: the arm that the reference controllers know, with no changes.
fn arm() -> Result<Scenario, StudyError> {
    let mut scenario = Scenario::built_in("arm")?;
    scenario.name = "compare".to_owned();
    scenario.seed = 0;
    scenario.plant.arm = Some(ArmConfig::default());
    Ok(scenario)
}

impl LearnerEntry {
    /// The entry of `learner`. `settings` such as `learner.beta=0.5` replace its own. Without `ticks`, its runs have
    /// their usual length.
    ///
    /// # Errors
    /// When a setting, a change or the length is invalid, or the scenario has another plant than the arm.
    pub fn of(
        learner: &ComparedLearner,
        ticks: Option<u64>,
        changes: &Changes,
        settings: &[String],
    ) -> Result<Self, StudyError> {
        match learner {
            ComparedLearner::Rule(rule) => Self::new(*rule, ticks, changes, settings),
            ComparedLearner::Scenario(own) => Self::own(own, ticks, changes, settings),
        }
    }

    /// The learner of `rule` with its preset.
    ///
    /// # Errors
    /// When a setting, a change or the length is invalid.
    pub fn new(rule: Rule, ticks: Option<u64>, changes: &Changes, settings: &[String]) -> Result<Self, StudyError> {
        let name = name_of(rule);
        let (usual_ticks, usual_block, estimated_tick_ns) = usual(rule);
        let mut scenario = arm()?;
        scenario.ticks = ticks.unwrap_or(usual_ticks);
        scenario.learner = LearnerConfig::preset(rule);
        // The paper's exploration noise: the rules that need many ticks were tuned with it.
        scenario.policy.sigma = PAPER_SIGMA;
        let scenario = with_settings(scenario, settings, &name)?;
        let plan = |scenario: Scenario| scenario.plan().map_err(|error| without_line(error, &name));
        Self::meeting(changes, usual_block, scenario, &name, plan, estimated_tick_ns)
    }

    /// The learner of a scenario: its controller, encoder, policy and learner, on the arm of all others.
    fn own(own: &Scenario, ticks: Option<u64>, changes: &Changes, settings: &[String]) -> Result<Self, StudyError> {
        // What is wrong with the file as it is has its line there.
        own.clone().plan()?;
        if own.plant.arm.is_none() || !is_simulator(&own.plant.program) {
            let file = own.source.name();
            return Err(StudyError::Asked(format!(
                "{file} has another plant than the simulator's arm, on which learners are compared; \
                 give a scenario with [plant.arm] and without plant.program"
            )));
        }
        let mut scenario = arm()?;
        scenario.ticks = ticks.unwrap_or(own.ticks);
        if scenario.is_endless() {
            let file = own.source.name();
            return Err(StudyError::Asked(format!("{file} is endless, and a comparison is not; give --ticks")));
        }
        scenario.controller = own.controller.clone();
        (scenario.learner, scenario.own_learner) = (own.learner.clone(), own.own_learner.clone());
        (scenario.encoder, scenario.policy) = (own.encoder.clone(), own.policy.clone());
        scenario.restart.hang_s = own.restart.hang_s;
        scenario.source = own.source.clone();
        let estimated_tick_ns = if own.controller.is_shipped() { usual(own.learner.rule).2 } else { PIPED_TICK_NS };
        let scenario = with_settings(scenario, settings, &own.name)?;
        let block = scenario.ticks / 2;
        Self::meeting(changes, block, scenario, &own.name, |s| Ok(s.plan()?), estimated_tick_ns)
    }

    /// The entry `name` of `scenario`, which meets `changes`; a usual one comes at `usual_block`.
    fn meeting(
        changes: &Changes,
        usual_block: u64,
        mut scenario: Scenario,
        name: &str,
        plan: impl FnOnce(Scenario) -> Result<Plan, StudyError>,
        estimated_tick_ns: u64,
    ) -> Result<Self, StudyError> {
        let ticks = scenario.ticks;
        let changes = match changes {
            Changes::None => Vec::new(),
            Changes::Usual if ticks <= usual_block => Vec::new(),
            Changes::Usual => vec![ArmChange::block(usual_block)],
            Changes::These(changes) => changes.clone(),
        };
        check_order(&changes, ticks, name)?;
        if let Some(arm) = &mut scenario.plant.arm {
            changes.iter().for_each(|change| change.apply(arm));
        }
        let plans = scenario.controller.is_shipped() && !scenario.learner.rule.is_linear();
        let test_stride = if plans { 10 } else { 1 };
        Ok(Self { name: name.to_owned(), plan: plan(scenario)?, changes, estimated_tick_ns, test_stride })
    }

    /// The arm that this entry meets, with a learner that all comparisons know: what the tests are made for.
    pub(super) fn test_plan(&self) -> Result<Plan, StudyError> {
        let mut scenario = arm()?;
        scenario.ticks = self.plan.scenario.ticks;
        scenario.plant.arm.clone_from(&self.plan.scenario.plant.arm);
        scenario.policy.sigma = PAPER_SIGMA;
        if self.plan.scenario.controller.is_shipped() {
            scenario.policy.clone_from(&self.plan.scenario.policy);
        }
        Ok(scenario.plan()?)
    }

    /// The scenario with one seed.
    pub fn plan(&self, seed: u64) -> Plan {
        let mut plan = self.plan.clone();
        plan.scenario.seed = seed;
        plan
    }
}

/// Checks that the changes lie within the run, in the order of their ticks, each at another tick.
fn check_order(changes: &[ArmChange], ticks: u64, name: &str) -> Result<(), StudyError> {
    for (i, change) in changes.iter().enumerate() {
        let at = thousands(change.tick);
        if change.tick == 0 || change.tick >= ticks {
            return Err(StudyError::Asked(format!(
                "tick {at} of a change lies outside the run of {name}, which has {} ticks; \
                 give another tick, or --ticks",
                thousands(ticks)
            )));
        }
        if i > 0 && change.tick <= changes[i - 1].tick {
            return Err(StudyError::Asked(format!(
                "two changes at tick {at}, or one after a later one; \
                 give them in the order of their ticks, all different"
            )));
        }
    }
    Ok(())
}

/// The scenario, with some of its settings replaced.
fn with_settings(scenario: Scenario, settings: &[String], learner: &str) -> Result<Scenario, StudyError> {
    if settings.is_empty() {
        return Ok(scenario);
    }
    let refused = |text: &str, why: &str| StudyError::Asked(format!("--set {text}: {why}"));
    let mut table: toml::Table = toml::from_str(&scenario.text().unwrap_or_default()).unwrap_or_default();
    for text in settings {
        let form = "write learner.KEY=VALUE or policy.KEY=VALUE in TOML, with words in quotes";
        let setting: toml::Table = toml::from_str(text).map_err(|_| refused(text, form))?;
        // All other settings are the same for all learners, so that their test is the same.
        if setting.is_empty() || setting.keys().any(|key| key != "learner" && key != "policy") {
            return Err(refused(text, form));
        }
        if setting.get("learner").is_some_and(|learner| learner.get("rule").is_some()) {
            return Err(refused(text, "name rules with --learners"));
        }
        merge(&mut table, setting);
    }
    let text = toml::to_string(&table).unwrap_or_default();
    let read = Scenario::parse(&text, "--set").map_err(|error| without_line(error, learner))?;
    // A program of one's own checks its `[learner]` when it starts; the file is what its user knows.
    Ok(Scenario { source: scenario.source, ..read })
}

/// The scenario's error without its line number: the line is of a text that is in no file.
pub(in crate::study) fn without_line(mut error: ScenarioError, learner: &str) -> StudyError {
    match &mut error {
        ScenarioError::UnknownKey { place, .. }
        | ScenarioError::MissingKey { place, .. }
        | ScenarioError::WrongType { place, .. }
        | ScenarioError::Invalid { place, .. } => *place = FilePosition { file: learner.to_owned(), line: None },
        _ => {}
    }
    error.into()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn message(rule: Rule, ticks: Option<u64>, changes: &Changes, settings: &[&str]) -> String {
        let settings: Vec<_> = settings.iter().map(|&s| s.to_owned()).collect();
        LearnerEntry::new(rule, ticks, changes, &settings).err().map_or("fine".to_owned(), |error| error.to_string())
    }

    #[test]
    fn every_learner_has_its_name_and_preset() {
        for rule_ in LEARNERS {
            let entry = LearnerEntry::new(rule_, None, &Changes::Usual, &[]).unwrap();
            assert_eq!(learner(&entry.name).unwrap(), ComparedLearner::Rule(rule_));
            assert_eq!(entry.plan.scenario.learner, LearnerConfig::preset(rule_).within(50.0));
            assert_eq!(entry.changes.len(), 1);
            let short = LearnerEntry::new(rule_, Some(1000), &Changes::Usual, &[]).unwrap();
            assert_eq!(short.changes, []);
            assert_eq!(short.plan.scenario.plant.arm, Some(ArmConfig::default()), "no changes unless asked for");
        }
        assert_eq!(
            learner("papers").unwrap_err().to_string(),
            "there is no learner \"papers\"; \
             the learners are paper, baseline, actor-critic, natural-actor-critic, learned-reward, model-predictive, \
             and a scenario file (NAME.toml) is one of your own"
        );
    }

    #[test]
    fn settings_replace_those_of_the_preset() {
        let settings = ["learner.beta = 0.5".to_owned(), "learner.critic.step=0.1".to_owned()];
        let entry = LearnerEntry::new(Rule::ActorCritic, None, &Changes::None, &settings).unwrap();
        let settings = &entry.plan.scenario.learner;
        assert_eq!((settings.beta, settings.critic.as_ref().unwrap().step), (0.5, 0.1));
        assert_eq!(settings.alpha_over_variance, LearnerConfig::preset(Rule::ActorCritic).alpha_over_variance);
    }

    #[test]
    fn invalid_arguments_are_refused_by_name() {
        let block = |tick| Changes::These(vec![ArmChange::block(tick)]);
        let two = Changes::These(vec![ArmChange::block(9), ArmChange::block(9)]);
        for (rule, ticks, changes, settings, expected) in [
            (Rule::Paper, None, Changes::None, &["learner.beta=2"][..], "paper: learner.beta is 2; give at least 0"),
            (
                Rule::Paper,
                None,
                Changes::None,
                &["learner.btea=0.2"],
                "paper: unknown key \"learner.btea\"; did you mean",
            ),
            (Rule::Paper, None, Changes::None, &["learner.critic.step=0.1"], "paper: learner.critic is a table that"),
            (Rule::Paper, None, Changes::None, &["learner.beta=x"], "--set learner.beta=x: write learner.KEY=VALUE"),
            (Rule::Paper, None, Changes::None, &["ticks=3"], "--set ticks=3: write learner.KEY=VALUE"),
            (Rule::Paper, None, Changes::None, &["learner.rule='paper'"], "name rules with --learners"),
            (Rule::Paper, Some(0), Changes::None, &[], "paper: ticks is 0; "),
            (Rule::Paper, Some(500), block(500), &[], "tick 500 of a change lies outside the run of paper"),
            (Rule::Paper, Some(500), block(0), &[], "tick 0 of a change lies outside"),
            (Rule::Paper, Some(500), two, &[], "two changes at tick 9"),
        ] {
            let found = message(rule, ticks, &changes, settings);
            assert!(found.contains(expected), "{settings:?}: {found}");
        }
        let joint = Changes::These(vec![ArmChange { what: super::super::ArmChangeKind::Block(7, 0.0), tick: 5 }]);
        assert!(
            message(Rule::Paper, None, &joint, &[]).contains("paper: plant.arm.block[0].joint is 7; the arm's joints")
        );
    }
}
