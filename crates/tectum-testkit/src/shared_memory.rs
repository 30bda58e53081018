//! What a run leaves in shared memory: nothing, once it is over.

use std::fs;
use std::path::Path;

use crate::read_json;

/// The prefix of everything that the run in `folder` has in shared memory.
///
/// # Panics
///
/// If the folder has no `run.json`, which the launcher writes before it starts processes.
#[track_caller]
pub fn domain(folder: impl AsRef<Path>) -> String {
    format!("tectum_{}", read_json(folder.as_ref().join("run.json"))["domain"].as_str().unwrap_or_default())
}

/// The names of files and folders in shared memory that begin with `prefix`.
///
/// # Panics
///
/// If `/dev/shm` cannot be read.
pub fn shared_memory(prefix: &str) -> Vec<String> {
    let entries = fs::read_dir("/dev/shm").unwrap_or_else(|error| panic!("/dev/shm: {error}"));
    let names = entries.flatten().map(|entry| entry.file_name().to_string_lossy().into_owned());
    names.filter(|name| name.starts_with(prefix)).collect()
}

/// Requires that nothing of the run in `folder` is left in shared memory.
///
/// # Panics
///
/// If something is left, with the names of the files.
#[track_caller]
pub fn assert_no_debris(folder: impl AsRef<Path>) {
    let left = shared_memory(&domain(folder));
    assert!(left.is_empty(), "left in /dev/shm: {left:?}");
}
