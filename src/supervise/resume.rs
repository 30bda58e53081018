//! Resuming an interrupted run from its last checkpoint.

use std::path::Path;

use super::{LaunchError, LearnedState};
use crate::checkpoint::{self, Checkpoint, CheckpointError};
use crate::runtime::{Mode, ResumePoint, RunManifest};
use crate::scenario::{Plan, Scenario};
use crate::wire::Role;

/// A run that goes on with another one.
#[derive(Debug)]
pub struct ResumedRun {
    /// Where it goes on.
    pub point: ResumePoint,
    /// Its scenario.
    pub plan: Plan,
    /// What the other run began with, if not with a fresh learner.
    pub started_from: Option<LearnedState>,
    /// Whether its learner is frozen.
    pub frozen: bool,
}

/// Where the lockstep run in the folder `given` (or with that name under `runs/`) can be resumed, and its
/// scenario. Reads both checkpoints and compares them with the scenario, before anything starts. With `ticks`, the run
/// goes on to that tick instead of the scenario's last, also if it had come to its end.
///
/// # Errors
/// [`LaunchError::Checkpoint`] when there is no checkpoint, or it is damaged or belongs to another run;
/// [`LaunchError::Scenario`] when the run's scenario cannot be read.
pub fn resume(given: &Path, ticks: Option<u64>) -> Result<ResumedRun, LaunchError> {
    let folder = crate::run_folder::find(given, Path::exists);
    let none = |what: String| LaunchError::Checkpoint(CheckpointError::None { folder: folder.clone(), what });
    let text = std::fs::read_to_string(RunManifest::path(&folder))
        .map_err(|_| none("this is not the folder of a run; name one, or its name under runs/".to_owned()))?;
    let manifest: RunManifest =
        serde_json::from_str(&text).map_err(|e| none(format!("run.json cannot be read: {e}")))?;
    if manifest.mode != Mode::Lockstep {
        return Err(none(
            "the run followed the real clock; only a lockstep run can be resumed; `tectum run --from` \
                          begins a new run with what it learned"
                .to_owned(),
        ));
    }
    let scenario = Scenario::load(&RunManifest::scenario_path(&folder))?;
    let before = scenario.clone().plan()?;
    let plan = Scenario { ticks: ticks.unwrap_or(scenario.ticks), ..scenario }.plan()?;
    let plan = plan.with_origin(&manifest.source, manifest.scenario_folder.as_deref());
    let Some(&tick) = checkpoint::ticks(&folder).last() else {
        let what = "there is no checkpoint of both plant and controller; runs leave one at their end, \
                    and every N ticks with --checkpoint-every N";
        return Err(none(what.to_owned()));
    };
    if tick >= plan.scenario.ticks {
        let end = if ticks.is_some() {
            format!("the run is at tick {tick} already")
        } else {
            format!("the run came to its end, tick {tick}")
        };
        return Err(none(format!("{end}; give --ticks more than that, and it goes on")));
    }
    let mut sequences = [0; 2];
    for (role, sequence) in [Role::Plant, Role::Controller].into_iter().zip(&mut sequences) {
        *sequence = checked_sequence(&folder, &manifest.run, &before, tick, role)?;
    }
    let start = manifest.started_from.as_ref();
    let started_from = start.map(|point| LearnedState::of_start(&folder, point)).transpose()?;
    let from = std::path::absolute(&folder).unwrap_or(folder);
    let scenario = (plan.hash != before.hash).then(|| format!("{:016x}", before.hash));
    let point = ResumePoint { from, tick, sequences, scenario };
    Ok(ResumedRun { point, plan, started_from, frozen: manifest.frozen })
}

/// The sequence number in the checkpoint of `role` at `tick`, once the checkpoint is known to fit scenario and run.
fn checked_sequence(folder: &Path, run: &str, plan: &Plan, tick: u64, role: Role) -> Result<u64, LaunchError> {
    let path = checkpoint::path(folder, tick, role);
    let checkpoint = Checkpoint::read(&path)?;
    checkpoint.fits(role, plan.hash)?;
    if (checkpoint.facts.run.as_str(), checkpoint.facts.tick) != (run, tick) {
        let (theirs, ours) = (checkpoint.facts.run, run.to_owned());
        return Err(LaunchError::Checkpoint(CheckpointError::Mismatch { path, what: "run", ours, theirs }));
    }
    Ok(checkpoint.facts.sequence)
}
