//! Resuming an interrupted run from its last checkpoint.

use std::path::Path;

use super::LaunchError;
use crate::checkpoint::{self, Checkpoint, CheckpointError};
use crate::runtime::{Mode, ResumePoint, RunManifest};
use crate::scenario::{Plan, Scenario};
use crate::wire::Role;

/// Where the lockstep run in the folder `given` (or with that name under `runs/`) can be resumed, and its
/// scenario. Reads both checkpoints and compares them with the scenario, before anything starts.
///
/// # Errors
/// [`LaunchError::Checkpoint`] when there is no checkpoint, or it is damaged or belongs to another run;
/// [`LaunchError::Scenario`] when the run's scenario cannot be read.
pub fn resume(given: &Path) -> Result<(ResumePoint, Plan), LaunchError> {
    let folder = crate::run_folder::find(given, Path::exists);
    let none = |what: String| LaunchError::Checkpoint(CheckpointError::None { folder: folder.clone(), what });
    let text = std::fs::read_to_string(RunManifest::path(&folder))
        .map_err(|_| none("this is not the folder of a run; name one, or its name under runs/".to_owned()))?;
    let manifest: RunManifest =
        serde_json::from_str(&text).map_err(|e| none(format!("run.json cannot be read: {e}")))?;
    if manifest.mode != Mode::Lockstep {
        return Err(none("the run followed the real clock; only a lockstep run can be resumed".to_owned()));
    }
    let plan = Scenario::load(&RunManifest::scenario_path(&folder))?.plan()?;
    let Some(&tick) = checkpoint::ticks(&folder).last() else {
        let what = "there is no checkpoint of both plant and controller; runs leave one at their end, \
                    and every N ticks with --checkpoint-every N";
        return Err(none(what.to_owned()));
    };
    if tick >= plan.scenario.ticks {
        return Err(none(format!("the run came to its end, tick {tick}; there is nothing to go on with")));
    }
    let mut sequences = [0; 2];
    for (role, sequence) in [Role::Plant, Role::Controller].into_iter().zip(&mut sequences) {
        *sequence = checked_sequence(&folder, &manifest.run, &plan, tick, role)?;
    }
    let from = std::path::absolute(&folder).unwrap_or(folder);
    Ok((ResumePoint { from, tick, sequences }, plan))
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
