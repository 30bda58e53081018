//! A run's folder: created for the run, checked before anything starts, and removed again if the run does not
//! start.

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

/// Disk space that a run leaves free for figure, reports and other programs, bytes.
const SPARE_BYTES: u64 = 16 << 20;

/// The folder of a run.
#[derive(Debug)]
pub(crate) struct RunFolder {
    path: PathBuf,
    /// Whether this run created it.
    created: bool,
    /// Whether it stays when this is dropped.
    kept: Cell<bool>,
    /// The folder itself, locked: no other run that is being started takes it.
    _lock: Option<fs::File>,
}

impl RunFolder {
    /// Creates the folder `out`, or `runs/<name>`, or the first free `runs/<scenario>-<n>`.
    pub fn create(out: Option<&Path>, name: Option<&str>, scenario: &str) -> Result<Self, LaunchError> {
        let path = match (out, name) {
            (Some(out), _) => out.to_owned(),
            (None, Some(name)) => Path::new(RUNS).join(name),
            (None, None) => return Self::numbered(scenario),
        };
        let created = !path.exists();
        fs::create_dir_all(&path).map_err(|e| unusable(&path, &e.to_string()))?;
        let _lock = lock(&path)?;
        let folder = Self { path, created, kept: Cell::new(false), _lock };
        if RunManifest::path(&folder.path).exists() || RunManifest::log_path(&folder.path).exists() {
            folder.kept.set(true);
            return Err(unusable(&folder.path, "it holds a run already"));
        }
        // Only an attempt shows whether files can be created here.
        let probe = folder.path.join(".tectum-probe");
        fs::write(&probe, b"x")
            .and_then(|()| fs::remove_file(&probe))
            .map_err(|e| unusable(&folder.path, &e.to_string()))?;
        Ok(folder)
    }

    fn numbered(scenario: &str) -> Result<Self, LaunchError> {
        let runs = Path::new(RUNS);
        fs::create_dir_all(runs).map_err(|e| unusable(runs, &e.to_string()))?;
        let mut number = 1_u64;
        loop {
            let path = runs.join(format!("{scenario}-{number}"));
            match fs::create_dir(&path) {
                Ok(()) => {
                    let _lock = lock(&path)?;
                    return Ok(Self { path, created: true, kept: Cell::new(false), _lock });
                }
                Err(e) if e.kind() == std::io::ErrorKind::AlreadyExists => number += 1,
                Err(e) => return Err(unusable(&path, &e.to_string())),
            }
        }
    }

    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Refuses a run whose log would not fit on the disk.
    pub fn check_room(&self, plan: &Plan) -> Result<(), LaunchError> {
        let Ok(disk) = rustix::fs::statvfs(&self.path) else { return Ok(()) };
        let free = disk.f_bavail * disk.f_frsize;
        let whole = bytes_per_tick(plan.scenario.log.every) * plan.scenario.ticks as f64;
        // What is removed on the way needs no room. An endless run without a limit has whatever room there is.
        let log = match plan.scenario.log.limit_mb {
            Some(limit) => whole.min(1e6 * limit),
            None if plan.scenario.is_endless() => 0.0,
            None => whole,
        };
        let needed = log as u64 + FIXED_BYTES + SPARE_BYTES;
        if needed > free {
            let path = self.path.display().to_string();
            return Err(LaunchError::NoRoom { path, needed: needed >> 20, free: free >> 20 });
        }
        Ok(())
    }

    /// Writes the scenario and the manifest, which a process needs to join the run.
    pub fn write_manifest(&self, manifest: &RunManifest, plan: &Plan) -> Result<(), LaunchError> {
        let text = serde_json::to_string_pretty(manifest).unwrap_or_default();
        self.write_scenario(plan)?;
        // The manifest is written last, because it marks the folder as a run. It is whole or not there.
        let path = RunManifest::path(&self.path);
        let draft = path.with_extension("json.part");
        self.write(&draft, &text)?;
        fs::rename(draft, path).map_err(|e| unusable(&self.path, &e.to_string()))
    }

    /// Writes the scenario with every default filled in.
    pub fn write_scenario(&self, plan: &Plan) -> Result<(), LaunchError> {
        self.write(&RunManifest::scenario_path(&self.path), &plan.scenario.to_toml())
    }

    fn write(&self, path: &Path, text: &str) -> Result<(), LaunchError> {
        fs::write(path, text).map_err(|e| unusable(&self.path, &e.to_string()))
    }

    /// Keeps the folder from now on, because the run has started.
    pub fn keep(&self) {
        self.kept.set(true);
    }

    /// Writes the standard error of a failed process to `<role>.stderr`. Best effort: the summary has the last
    /// line.
    pub(super) fn write_stderr(&self, failure: &ProcessFailure) {
        if !failure.stderr.is_empty() {
            // Appended, for a process that failed more than once.
            let path = self.path.join(format!("{}.stderr", failure.role.name()));
            let file = fs::OpenOptions::new().create(true).append(true).open(path);
            let _ = file.and_then(|mut file| file.write_all(failure.stderr.as_bytes()));
        }
    }
}

impl Drop for RunFolder {
    fn drop(&mut self) {
        if self.kept.get() {
            return;
        }
        let reports = Role::ALL.map(|role| realtime_path(&self.path, role));
        let start = RunManifest::start_path(&self.path);
        let own = [RunManifest::path(&self.path), RunManifest::scenario_path(&self.path), start];
        for path in own.into_iter().chain(reports) {
            let _ = fs::remove_file(path);
        }
        if self.created {
            // Fails, as it should, when the folder holds files of another program.
            let _ = fs::remove_dir(&self.path);
            let _ = self.path.parent().filter(|p| *p == Path::new(RUNS)).map(fs::remove_dir);
        }
    }
}

/// Locks the folder at `path` against other runs. The lock ends with this process. Without it, two runs that begin
/// at the same time would both find an empty folder. A file system without locks has none.
fn lock(path: &Path) -> Result<Option<fs::File>, LaunchError> {
    let Ok(folder) = fs::File::open(path) else { return Ok(None) };
    match folder.try_lock() {
        Ok(()) => Ok(Some(folder)),
        Err(fs::TryLockError::WouldBlock) => Err(unusable(path, "another run has just begun in it")),
        Err(fs::TryLockError::Error(_)) => Ok(None),
    }
}

fn unusable(path: &Path, cause: &str) -> LaunchError {
    LaunchError::Folder { path: path.display().to_string(), cause: cause.to_owned() }
}
