//! Which processes have a file mapped. This tells shared memory in use from shared memory that a dead process
//! left behind.

use std::path::Path;

/// The sorted ids of the processes that have a file mapped whose path begins with `prefix`. Processes of other
/// users are left out, because their maps cannot be read.
pub(crate) fn processes_mapping(prefix: &Path) -> Vec<u32> {
    let Ok(processes) = std::fs::read_dir("/proc") else { return Vec::new() };
    let prefix = prefix.as_os_str().to_string_lossy().into_owned();
    let mut holders: Vec<u32> = processes
        .flatten()
        .filter_map(|entry| entry.file_name().to_str()?.parse().ok())
        .filter(|pid| {
            let maps = std::fs::read(format!("/proc/{pid}/maps")).unwrap_or_default();
            // The columns of a line: address, permissions, offset, device, inode, path.
            String::from_utf8_lossy(&maps).lines().any(|line| {
                line.find('/').and_then(|start| line.get(start..)).is_some_and(|path| path.starts_with(&prefix))
            })
        })
        .collect();
    holders.sort_unstable();
    holders
}
