//! Watches the run's folder while the run is going. A folder that somebody removes (a cleaner of `/tmp`, another
//! user of the disk) is made again, so that processes can still leave their reports and rejoin the run. What it
//! held is lost, which is said at once and again at the end.

use std::path::{Path, PathBuf};

use super::folder::RunFolder;
use crate::runtime::RunManifest;

/// How often the folder is looked at, ns.
const CHECK_NS: u64 = 500_000_000;

/// The run's folder, and what a process needs in it.
#[derive(Debug)]
pub(super) struct FolderWatch {
    path: PathBuf,
    manifest: String,
    scenario: String,
    /// When it was last looked at, ns.
    checked_ns: u64,
    /// The tick at which it was found to be removed.
    pub removed_at: Option<u64>,
}

impl FolderWatch {
    /// Watches `folder`, whose manifest and scenario have just been written.
    pub fn new(folder: &RunFolder) -> Self {
        let path = folder.path().to_owned();
        let read = |path: PathBuf| std::fs::read_to_string(path).unwrap_or_default();
        let manifest = read(RunManifest::path(&path));
        let scenario = read(RunManifest::scenario_path(&path));
        // A folder given by a relative path is found again whatever happens to the folder above it.
        let path = std::path::absolute(&path).unwrap_or(path);
        Self { path, manifest, scenario, checked_ns: 0, removed_at: None }
    }

    /// Looks whether the folder is there, if that is due, and makes it again if not. Returns true when it has been
    /// removed since the last look. `tick` is the run's current tick.
    pub fn check(&mut self, now: u64, tick: u64) -> bool {
        if now.saturating_sub(self.checked_ns) < CHECK_NS {
            return false;
        }
        self.checked_ns = now;
        self.check_now(tick)
    }

    /// The same at once.
    pub fn check_now(&mut self, tick: u64) -> bool {
        let is_gone = |path: &Path| path.symlink_metadata().is_err_and(|e| e.kind() == std::io::ErrorKind::NotFound);
        let manifest = RunManifest::path(&self.path);
        if !is_gone(&manifest) {
            return false;
        }
        // Best effort: without the folder the run goes on all the same.
        let _ = std::fs::create_dir_all(&self.path);
        let scenario = RunManifest::scenario_path(&self.path);
        if is_gone(&scenario) {
            let _ = std::fs::write(scenario, &self.scenario);
        }
        let _ = std::fs::write(manifest, &self.manifest);
        let first = self.removed_at.is_none();
        self.removed_at.get_or_insert(tick);
        first
    }
}
