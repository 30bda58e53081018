//! A run's folder: made for the run, checked before anything starts, and taken away again if nothing did.

use std::cell::Cell;
use std::fs;
use std::io::Write as _;
use std::path::{Path, PathBuf};

use super::LaunchError;
use super::children::ProcessFailure;
use crate::log::{FIXED_BYTES, bytes_per_tick};
use crate::run_folder::RUNS;
use crate::runtime::{RunManifest, realtime_path};
use crate::scenario::Plan;
use crate::wire::Role;

/// Room that a run leaves on the disk, bytes: figure, reports, and other people's files.
const SPARE_BYTES: u64 = 16 << 20;

/// The folder of a run.
#[derive(Debug)]
pub(crate) struct RunFolder {
    path: PathBuf,
    /// Whether this run made it.
    made: bool,
    /// Whether it stays.
    kept: Cell<bool>,
}

impl RunFolder {
    /// Makes the folder `out`, or `runs/<name>`, or the first free `runs/<scenario>-<n>`.
    pub fn create(out: Option<&Path>, name: Option<&str>, scenario: &str) -> Result<Self, LaunchError> {
        let path = match (out, name) {
            (Some(out), _) => out.to_owned(),
            (None, Some(name)) => Path::new(RUNS).join(name),
            (None, None) => return Self::numbered(scenario),
        };
        let made = !path.exists();
        fs::create_dir_all(&path).map_err(|e| refuse(&path, &e.to_string()))?;
        let folder = Self { path, made, kept: Cell::new(false) };
        if RunManifest::path(&folder.path).exists() || RunManifest::log_path(&folder.path).exists() {
            folder.kept.set(true);
            return Err(refuse(&folder.path, "it holds a run already"));
        }
        // Whether files can be made here shows only when one is made.
        let probe = folder.path.join(".tectum-probe");
        fs::write(&probe, b"x")
            .and_then(|()| fs::remove_file(&probe))
            .map_err(|e| refuse(&folder.path, &e.to_string()))?;
        Ok(folder)
    }

    fn numbered(scenario: &str) -> Result<Self, LaunchError> {
        let runs = Path::new(RUNS);
        fs::create_dir_all(runs).map_err(|e| refuse(runs, &e.to_string()))?;
        let mut number = 1_u64;
        loop {
            let path = runs.join(format!("{scenario}-{number}"));
            match fs::create_dir(&path) {
                Ok(()) => return Ok(Self { path, made: true, kept: Cell::new(false) }),
                Err(e) if e.kind() == std::io::ErrorKind::AlreadyExists => number += 1,
                Err(e) => return Err(refuse(&path, &e.to_string())),
            }
        }
    }

    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Refuses a run whose log cannot fit.
    pub fn check_room(&self, plan: &Plan) -> Result<(), LaunchError> {
        let Ok(disk) = rustix::fs::statvfs(&self.path) else { return Ok(()) };
        let free = disk.f_bavail * disk.f_frsize;
        let log = bytes_per_tick(plan.scenario.log.every) * plan.scenario.ticks as f64;
        let needed = log as u64 + FIXED_BYTES + SPARE_BYTES;
        if needed > free {
            let path = self.path.display().to_string();
            return Err(LaunchError::NoRoom { path, needed: needed >> 20, free: free >> 20 });
        }
        Ok(())
    }

    /// Leaves what a process needs to join.
    pub fn write_manifest(&self, manifest: &RunManifest, plan: &Plan) -> Result<(), LaunchError> {
        let text = serde_json::to_string_pretty(manifest).unwrap_or_default();
        self.write_scenario(plan)?;
        // Last, because its being there is what makes the folder a run.
        fs::write(RunManifest::path(&self.path), text).map_err(|e| refuse(&self.path, &e.to_string()))
    }

    /// Leaves the scenario with every default filled in.
    pub fn write_scenario(&self, plan: &Plan) -> Result<(), LaunchError> {
        fs::write(RunManifest::scenario_path(&self.path), plan.scenario.to_toml())
            .map_err(|e| refuse(&self.path, &e.to_string()))
    }

    /// The run has begun: the folder stays.
    pub fn keep(&self) {
        self.kept.set(true);
    }

    /// Keeps all that a process said which failed, for those who look into it. Best effort: the summary has the essence.
    pub(super) fn keep_words(&self, failure: &ProcessFailure) {
        let (role, said) = &failure.said;
        if !said.is_empty() {
            // One after the other, for a process that failed more than once.
            let path = self.path.join(format!("{}.stderr", role.name()));
            let file = fs::OpenOptions::new().create(true).append(true).open(path);
            let _ = file.and_then(|mut file| file.write_all(said.as_bytes()));
        }
    }
}

impl Drop for RunFolder {
    fn drop(&mut self) {
        if self.kept.get() {
            return;
        }
        let accounts = Role::ALL.map(|role| realtime_path(&self.path, role));
        for path in [RunManifest::path(&self.path), RunManifest::scenario_path(&self.path)].into_iter().chain(accounts)
        {
            let _ = fs::remove_file(path);
        }
        if self.made {
            // Fails, as it should, when somebody has put something else there.
            let _ = fs::remove_dir(&self.path);
            let _ = self.path.parent().filter(|p| *p == Path::new(RUNS)).map(fs::remove_dir);
        }
    }
}

fn refuse(path: &Path, cause: &str) -> LaunchError {
    LaunchError::Folder { path: path.display().to_string(), cause: cause.to_owned() }
}
