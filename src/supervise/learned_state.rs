//! What another run has learned, as the beginning of a new one (`tectum run --from`).
//!
//! It is read from the newest checkpoint of the other run's controller, or from one that the user names. The new run
//! may have another plant, another mode and another seed. Inputs, outputs and the learner must be the same, because
//! what was learned has no meaning for others; the first difference is named before anything starts. The new run keeps
//! a copy of the checkpoint in its folder, so that it can be replayed without the other run.

use std::fmt::Display;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::LaunchError;
use crate::agent::ShippedAgent;
use crate::checkpoint::{self, Checkpoint, CheckpointError};
use crate::runtime::{RunManifest, StartPoint};
use crate::scenario::{Plan, Scenario, SignalConfig};
use crate::wire::Role;

/// The learner of another run, up to the tick of a checkpoint.
#[derive(Debug, Clone)]
pub struct LearnedState {
    /// The other run's folder or its checkpoint, as the user named it.
    source: String,
    /// The checkpoint's file.
    file: PathBuf,
    checkpoint: Arc<Checkpoint>,
    /// The other run's scenario.
    plan: Plan,
}

impl LearnedState {
    /// Reads what was learned in the run `given` (a folder, or a name under `runs/`), or up to the checkpoint of that
    /// path.
    ///
    /// # Errors
    /// [`LaunchError::Checkpoint`] when there is no checkpoint of a controller, or it is damaged;
    /// [`LaunchError::Scenario`] when the scenario that it was learned in cannot be read.
    pub fn find(given: &Path) -> Result<Self, LaunchError> {
        let file = if given.is_file() { given.to_owned() } else { newest(given)? };
        let checkpoint = Checkpoint::read(&file)?;
        if checkpoint.facts.role != Role::Controller.name() {
            let what = format!("this is a checkpoint of the {}; give that of the controller", checkpoint.facts.role);
            return Err(none(&file, &what));
        }
        let plan = plan_of(&file, &checkpoint)?;
        Ok(Self { source: given.display().to_string(), file, checkpoint: Arc::new(checkpoint), plan })
    }

    /// The state with which the run in `folder` began, if it began with one; `point` is what its manifest says of it.
    pub(super) fn of_start(folder: &Path, point: &StartPoint) -> Result<Self, LaunchError> {
        Ok(Self { source: point.source.clone(), ..Self::find(&RunManifest::start_path(folder))? })
    }

    /// The scenario in which it was learned, every default filled in.
    pub fn plan(&self) -> &Plan {
        &self.plan
    }

    /// The tick until which it was learned.
    pub fn tick(&self) -> u64 {
        self.checkpoint.facts.tick
    }

    /// The checkpoint's file.
    pub fn file(&self) -> &Path {
        &self.file
    }

    pub(super) fn checkpoint(&self) -> &Checkpoint {
        &self.checkpoint
    }

    /// Checks that a run of `plan` can begin with it. Returns what is allowed and may not be meant, each in a sentence.
    ///
    /// # Errors
    /// [`LaunchError::OtherLearner`] names the first difference of inputs, outputs, learner and encoder.
    pub fn check(&self, plan: &Plan) -> Result<Vec<String>, LaunchError> {
        let path = self.file.display().to_string();
        if let Some(difference) = first_difference(&self.plan, plan) {
            return Err(LaunchError::OtherLearner { path, difference });
        }
        // A program of one's own checks its state by itself.
        if plan.scenario.controller.is_shipped() {
            self.agent(plan)?;
        }
        let mut warnings = Vec::new();
        let (theirs, ours) = (self.plan.scenario.period_ms, plan.scenario.period_ms);
        if theirs != ours {
            warnings.push(format!("{path} was learned with a period of {theirs} ms, and this run has {ours} ms"));
        }
        let build = &self.checkpoint.facts.build;
        if build != crate::BUILD {
            warnings.push(format!("{path} was written by build {build}, and this is {}", crate::BUILD));
        }
        Ok(warnings)
    }

    /// The agent of `plan`, one of this package's, with what was learned.
    ///
    /// # Errors
    /// When the checkpoint holds the state of another agent.
    pub(super) fn agent(&self, plan: &Plan) -> Result<ShippedAgent, LaunchError> {
        let mut agent = plan.agent();
        self.checkpoint.restore_agent(&mut agent)?;
        Ok(agent)
    }

    /// What the manifest of a run says that begins with it.
    pub(super) fn point(&self) -> StartPoint {
        StartPoint { source: self.source.clone(), tick: self.tick(), check: self.checkpoint.check() }
    }

    /// Copies the checkpoint into the folder of a run that begins with it.
    pub(super) fn copy_to(&self, folder: &Path) -> Result<(), LaunchError> {
        std::fs::copy(&self.file, RunManifest::start_path(folder)).map(drop).map_err(|cause| LaunchError::Folder {
            path: folder.display().to_string(),
            cause: format!("{} cannot be copied into it ({cause})", self.file.display()),
        })
    }
}

fn none(folder: &Path, what: &str) -> LaunchError {
    LaunchError::Checkpoint(CheckpointError::None { folder: folder.to_owned(), what: what.to_owned() })
}

/// The newest checkpoint of the controller in the run called `given`.
fn newest(given: &Path) -> Result<PathBuf, LaunchError> {
    let folder = crate::run_folder::find(given, Path::exists);
    if !RunManifest::path(&folder).exists() {
        let what = "this is neither the folder of a run nor a checkpoint; name one, or a run's name under runs/";
        return Err(none(&folder, what));
    }
    checkpoint::newest_of_controller(&folder).ok_or_else(|| {
        none(&folder, "there is no checkpoint of its controller; runs leave one at their end, and on SIGUSR1")
    })
}

/// The scenario in which the checkpoint was written: its own text, or else that of its run's folder.
fn plan_of(file: &Path, checkpoint: &Checkpoint) -> Result<Plan, LaunchError> {
    let folder = file.parent().and_then(Path::parent);
    let manifest = folder.and_then(|folder| std::fs::read_to_string(RunManifest::path(folder)).ok());
    let manifest: Option<RunManifest> = manifest.and_then(|text| serde_json::from_str(&text).ok());
    let manifest = manifest.filter(|manifest| manifest.run == checkpoint.facts.run);
    let plan = match (&checkpoint.facts.scenario_text, folder) {
        (Some(text), _) => Scenario::parse(text, &file.display().to_string())?.plan()?,
        (None, Some(folder)) if manifest.is_some() => Scenario::load(&RunManifest::scenario_path(folder))?.plan()?,
        _ => return Err(none(file, "it does not say in which scenario it was written; leave it in its run's folder")),
    };
    Ok(match manifest {
        Some(manifest) => plan.with_origin(&manifest.source, manifest.scenario_folder.as_deref()),
        None => plan,
    })
}

/// The first difference between the scenario in which something was learned and this one, for which what was learned
/// has no meaning here.
fn first_difference(there: &Plan, here: &Plan) -> Option<String> {
    let differs =
        |what: &str, there: &dyn Display, here: &dyn Display| Some(format!("its {what} is {there}, here it is {here}"));
    let count = |what: &str, there: usize, here: usize| Some(format!("it has {there} {what}, here there are {here}"));
    let (a, b) = (&there.scenario, &here.scenario);
    let program = |scenario: &Scenario| {
        let path = Path::new(&scenario.controller.program);
        path.file_name().unwrap_or_default().to_string_lossy().into_owned()
    };
    if (a.controller.is_shipped(), program(a)) != (b.controller.is_shipped(), program(b)) {
        return differs("controller", &a.controller.program, &b.controller.program);
    }
    if a.controller.is_shipped() && a.learner.rule != b.learner.rule {
        return differs("learner", &rule(a), &rule(b));
    }
    if !a.controller.is_shipped() && a.own_learner != b.own_learner {
        return Some("its [learner] has other settings than this run's".to_owned());
    }
    if there.inputs.len() != here.inputs.len() {
        return count("inputs", there.inputs.len(), here.inputs.len());
    }
    for (i, (a, b)) in there.inputs.iter().zip(&here.inputs).enumerate() {
        if a != b {
            return differs(&format!("input {}", i + 1), &signal(a), &signal(b));
        }
    }
    if there.outputs.len() != here.outputs.len() {
        return count("outputs", there.outputs.len(), here.outputs.len());
    }
    for (i, (a, b)) in there.outputs.iter().zip(&here.outputs).enumerate() {
        if (&a.name, &a.unit) != (&b.name, &b.unit) {
            return differs(&format!("output {}", i + 1), &signal(a), &signal(b));
        }
    }
    if a.controller.is_shipped() { difference_of_learners(there, here) } else { None }
}

/// The same for learners of this package with the same rule.
fn difference_of_learners(there: &Plan, here: &Plan) -> Option<String> {
    let (a, b) = (&there.scenario, &here.scenario);
    if !a.learner.rule.is_linear() {
        // It takes commands in units of their limits.
        for output in 0..there.outputs.len() {
            let [theirs, ours] = [a, b].map(|scenario| scenario.gate.max_command.of(output));
            if theirs != ours {
                let what = format!("gate.max_command of output {}", output + 1);
                return Some(format!("its {what} is {theirs}, here it is {ours}"));
            }
        }
        return None;
    }
    if there.maps.len() != here.maps.len() {
        return Some(format!("its encoder has {} maps, here it has {}", there.maps.len(), here.maps.len()));
    }
    for (i, (theirs, ours)) in there.maps.iter().zip(&here.maps).enumerate() {
        if theirs != ours {
            let map = i + 1;
            return Some(format!("map {map} of its encoder has other inputs, units, ranges or radius than here"));
        }
    }
    if there.scalars != here.scalars {
        return Some("its encoder has other scalars than here".to_owned());
    }
    if a.encoder.normalise != b.encoder.normalise {
        let [theirs, ours] = [a, b].map(|scenario| scenario.encoder.normalise);
        return Some(format!("its encoder.normalise is {theirs}, here it is {ours}"));
    }
    let critic = |scenario: &Scenario| scenario.learner.critic.as_ref().map(|critic| critic.sees);
    let basis = |scenario: &Scenario| scenario.learner.model.as_ref().map(|model| model.basis);
    if critic(a) != critic(b) {
        return Some("its critic sees something else (learner.critic.sees) than here".to_owned());
    }
    (basis(a) != basis(b)).then(|| "its learner.model.basis is another than here".to_owned())
}

/// A rule by its name in scenarios.
pub(super) fn rule(scenario: &Scenario) -> String {
    let name = serde_json::to_value(scenario.learner.rule).unwrap_or_default();
    name.as_str().unwrap_or_default().to_owned()
}

fn signal(signal: &SignalConfig) -> String {
    let unit = if signal.unit.is_empty() { String::new() } else { format!("{}, ", signal.unit) };
    format!("{} ({unit}{} to {})", signal.name, signal.min, signal.max)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plan(name: &str, change: impl Fn(&mut Scenario)) -> Plan {
        let mut scenario = Scenario::find(name).unwrap();
        change(&mut scenario);
        scenario.plan().unwrap()
    }

    #[test]
    fn the_first_difference_is_named() {
        let arm = plan("arm", |_| ());
        let difference = |here: &Plan| first_difference(&arm, here).unwrap_or_default();
        assert_eq!(difference(&plan("arm", |s| (s.seed, s.ticks, s.policy.sigma) = (7, 9000, 0.002))), "");
        assert_eq!(difference(&plan("arm", |s| s.learner.beta = 0.1)), "", "settings of a rule may change");
        let other = difference(&plan("eye", |s| s.learner.rule = crate::scenario::Rule::Paper));
        assert_eq!(other, "its learner is model-predictive, here it is paper");
        let paper = plan("paper", |_| ());
        let eye = plan("eye", |s| s.learner.rule = crate::scenario::Rule::Paper);
        let fewer = first_difference(&paper, &eye).unwrap();
        assert!(fewer.starts_with("it has 6 inputs, here there are "), "{fewer}");
        let wider = plan("paper", |s| s.encoder.maps[0].radius = crate::scenario::PerAxis::All(0.45));
        let wider = first_difference(&paper, &wider).unwrap();
        assert_eq!(wider, "map 1 of its encoder has other inputs, units, ranges or radius than here");
        let mut other = arm.clone();
        other.inputs[2].name = "elbow".to_owned();
        let renamed = first_difference(&other, &arm).unwrap();
        assert!(renamed.starts_with("its input 3 is elbow (rad, ") && renamed.contains("), here it is "), "{renamed}");
    }
}
