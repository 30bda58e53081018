//! Finds runs that are alive.

use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::time::SystemTime;

use super::WatchError;
use crate::channel::{is_member, list_watched};
use crate::clock::ProcessHandle;
use crate::run_folder;
use crate::runtime::{Mode, RunManifest};

/// A run that is alive: its folder, its manifest and its launcher.
#[derive(Debug)]
pub(super) struct LivingRun {
    /// The run's folder.
    pub folder: PathBuf,
    /// The run's manifest.
    pub manifest: RunManifest,
    /// The process that launched it.
    pub launcher: ProcessHandle,
    /// When it began.
    began: SystemTime,
}

impl LivingRun {
    /// The run in `folder`, if it is alive.
    fn of(folder: PathBuf) -> Result<Self, WatchError> {
        let path = RunManifest::path(&folder);
        let no = |cause: String| WatchError::NoRun { path: folder.clone(), cause, living_runs: Vec::new() };
        let file = path.file_name().unwrap_or_default().display();
        let text = std::fs::read_to_string(&path).map_err(|error| match error.kind() {
            _ if !folder.is_dir() => no("there is no such folder".to_owned()),
            ErrorKind::NotFound => no(format!("it has no {file}")),
            _ => no(format!("its {file} cannot be read: {error}")),
        })?;
        let manifest: RunManifest =
            serde_json::from_str(&text).map_err(|error| no(format!("its {file} is not one of a run: {error}")))?;
        let began = std::fs::metadata(&path).and_then(|file| file.modified()).unwrap_or(SystemTime::UNIX_EPOCH);
        if manifest.mode == Mode::InProcess {
            let cause = "a run in one process has no shared memory".to_owned();
            return Err(WatchError::Unwatchable { path: folder, cause });
        }
        // The process id may be another process's by now. A launcher maps its run's memory.
        let launcher = ProcessHandle::of(manifest.launcher).filter(|_| is_member(&manifest.domain, manifest.launcher));
        match launcher {
            Some(launcher) => Ok(Self { folder, manifest, launcher, began }),
            None => Err(WatchError::Over { path: folder, living_runs: Vec::new() }),
        }
    }

    /// Finds the run called `run`: a folder, or a name under `runs/`.
    pub fn named(run: &Path) -> Result<Self, WatchError> {
        let folder = run_folder::find(run, |folder| RunManifest::path(folder).exists());
        Self::of(folder).map_err(|error| match error {
            WatchError::NoRun { path, cause, .. } => WatchError::NoRun { path, cause, living_runs: living_folders() },
            WatchError::Over { path, .. } => WatchError::Over { path, living_runs: living_folders() },
            error => error,
        })
    }

    /// The run that began last among those that are alive.
    pub fn newest() -> Option<Self> {
        living().max_by_key(|run| (run.began, run.manifest.run.clone()))
    }

    /// The run that the process `launcher` has launched.
    pub fn launched_by(launcher: u32) -> Option<Self> {
        living().find(|run| run.manifest.launcher == launcher)
    }
}

fn living() -> impl Iterator<Item = LivingRun> {
    let of_domain = |(domain, folder)| LivingRun::of(folder).ok().filter(|run| run.manifest.domain == domain);
    list_watched().into_iter().filter_map(of_domain)
}

/// The folders of the runs that are alive.
fn living_folders() -> Vec<PathBuf> {
    living().map(|run| run.folder).collect()
}
