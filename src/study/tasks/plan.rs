//! A task as a scenario: the plant's tables, maps for the linear policies, and the length of its runs and tests.

use super::candidate::Candidate;
use super::levels::{Level, level};
use crate::plant::BodyConfig;
use crate::plant::task::{self, Task};
use crate::scenario::{FilePosition, LearnerConfig, MapConfig, PerAxis, Plan, Rule, Scenario, ScenarioError};
use crate::study::StudyError;

/// A task with all that a study of it needs.
#[derive(Debug, Clone)]
pub(super) struct TaskPlan {
    /// The task's number, for the order of results.
    pub number: usize,
    /// The task.
    pub task: Task,
    /// Length of a run, ticks.
    pub ticks: u64,
    /// The level at the beginning, and the one after the change.
    pub levels: [Level; 2],
    /// The scenario with seed 0 and the paper's rule.
    plan: Plan,
}

/// Trials of a test, by body: enough to tell a level, few enough for a learner that plans for milliseconds a tick.
fn test_trials(body: &BodyConfig) -> u64 {
    match body {
        BodyConfig::Pendulum(config) if config.start == crate::scenario::Start::Hanging => 2,
        BodyConfig::CartPole(_) => 2,
        BodyConfig::Furuta(_) => 1,
        BodyConfig::Reacher(_) => 8,
        _ => 5,
    }
}

impl TaskPlan {
    /// The plan of a task, with runs of `ticks` or of its usual length.
    ///
    /// # Errors
    /// When the length is invalid.
    pub fn new(task: Task, ticks: Option<u64>) -> Result<Self, StudyError> {
        let ticks = ticks.unwrap_or(task.ticks);
        let number = task::names().iter().position(|name| *name == task.name).unwrap_or(0);
        let plan = scenario(&task, ticks)?.plan().map_err(|error| without_line(error, &task.name))?;
        let levels = [level(&task, false), level(&task, true)];
        Ok(Self { number, ticks, levels, plan, task })
    }

    /// Whether a learner's scenario is valid for this task.
    ///
    /// # Errors
    /// The reason why not.
    pub fn check(&self, candidate: &Candidate) -> Result<(), StudyError> {
        match candidate {
            Candidate::Reference(_) => Ok(()),
            Candidate::Learner(_) | Candidate::Own(_) => {
                let name = format!("{}, {}", self.task.name, candidate.name());
                self.scenario(candidate, 0).plan().map(drop).map_err(|error| without_line(error, &name))
            }
        }
    }

    /// The plan of a run; it is valid, as [`check`](Self::check) found.
    pub fn of_run(&self, candidate: &Candidate, seed: u64) -> Option<Plan> {
        self.scenario(candidate, seed).plan().ok()
    }

    /// The task with a learner. Of a scenario of one's own, `[controller]` and `[learner]` count: its encoder and its
    /// noise are made for another plant.
    fn scenario(&self, candidate: &Candidate, seed: u64) -> Scenario {
        let mut scenario = self.plan.scenario.clone();
        match candidate {
            Candidate::Reference(_) => {}
            Candidate::Learner(rule) => scenario.learner = preset(*rule, &self.task.body),
            Candidate::Own(own) => {
                scenario.controller = own.controller.clone();
                (scenario.learner, scenario.own_learner) = (own.learner.clone(), own.own_learner.clone());
                scenario.restart.hang_s = own.restart.hang_s;
                scenario.source = own.source.clone();
            }
        }
        scenario.seed = seed;
        scenario
    }

    /// The plan without a rule of its own.
    pub fn plan(&self) -> &Plan {
        &self.plan
    }

    /// Length of a test, ticks.
    pub fn test_ticks(&self) -> u64 {
        test_trials(&self.task.body) * self.task.body.trial_ticks().max(1)
    }

    /// The tick of the change, if it comes within the run.
    pub fn change(&self) -> Option<u64> {
        self.task.change.filter(|change| *change < self.ticks)
    }

    /// Number of conditions of the plant: before the change, and after it.
    pub fn conditions(&self) -> usize {
        1 + usize::from(self.change().is_some())
    }

    /// The first tick of a test: the plant is in the wanted condition from then on.
    pub fn test_begins(&self, changed: bool) -> u64 {
        if changed { self.task.change.unwrap_or(0) } else { 0 }
    }
}

/// A rule's preset for a plant. `learned-reward` is told what the commands move within a tick, unless the plant says so
/// itself.
fn preset(rule: Rule, body: &BodyConfig) -> LearnerConfig {
    let mut learner = LearnerConfig::preset(rule);
    let moved: &[&str] = match body {
        BodyConfig::Pendulum(_) | BodyConfig::CartPole(_) => &["omega"],
        BodyConfig::Reacher(_) => &["from_target_x", "from_target_y"],
        BodyConfig::Furuta(_) => &["alpha_rate"],
        BodyConfig::PointMass(_) => &["v_x", "v_y"],
        BodyConfig::Arm(_) | BodyConfig::Eye(_) | BodyConfig::So101(_) => &[],
    };
    if rule == Rule::LearnedReward {
        learner.model.get_or_insert_default().moved = moved.iter().map(|&name| name.to_owned()).collect();
    }
    learner
}

/// The scenario of a task.
fn scenario(task: &Task, ticks: u64) -> Result<Scenario, StudyError> {
    let mut scenario = Scenario::built_in("paper")?;
    scenario.name = "tasks".to_owned();
    scenario.seed = 0;
    scenario.period_ms = task.period_ms;
    scenario.ticks = ticks;
    scenario.plant = scenario.plant.with_body(task.body.clone());
    scenario.plant.timing = task.timing.clone();
    scenario.gate.max_command = crate::scenario::PerOutput::All(task.max_command);
    scenario.policy.sigma = task.sigma;
    scenario.encoder.maps = maps(task);
    Ok(scenario)
}

/// Maps for the linear policies: a plane over the target, and a line over every other input. A kernel's radius is a
/// twelfth of its range, which is that of the paper's maps over angles.
fn maps(task: &Task) -> Vec<MapConfig> {
    let signals = task.body.signals();
    let is_plane = signals.seen >= 2;
    let radius = |i: usize| (signals.inputs[i].max - signals.inputs[i].min) / 12.0;
    let name = |i: usize| signals.inputs[i].name.clone();
    let map = |inputs: Vec<String>, radius: f64| MapConfig {
        inputs,
        units: Vec::new(),
        radius: PerAxis::All(radius),
        ranges: Vec::new(),
    };
    let plane = is_plane.then(|| map(vec![name(0), name(1)], 3.0 * radius(0)));
    let first = if is_plane { 2 } else { 0 };
    plane.into_iter().chain((first..signals.inputs.len()).map(|i| map(vec![name(i)], radius(i)))).collect()
}

/// The scenario's error without its line number: the line is of a text that is in no file.
fn without_line(mut error: ScenarioError, name: &str) -> StudyError {
    if let ScenarioError::Invalid { place, .. } = &mut error {
        *place = FilePosition { file: name.to_owned(), line: None };
    }
    error.into()
}
