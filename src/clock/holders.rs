//! Which processes use a piece of shared memory: what tells a file in use from one that was left behind.

use std::path::Path;

/// The ids of the processes that have a file mapped whose path begins with `prefix`; sorted. Other users' processes
/// cannot be asked, and are left out.
pub fn mapping(prefix: &Path) -> Vec<u32> {
    let Ok(processes) = std::fs::read_dir("/proc") else { return Vec::new() };
    let prefix = prefix.as_os_str().to_string_lossy().into_owned();
    let mut holders: Vec<u32> = processes
        .flatten()
        .filter_map(|entry| entry.file_name().to_str()?.parse().ok())
        .filter(|pid| {
            let maps = std::fs::read(format!("/proc/{pid}/maps")).unwrap_or_default();
            // address permissions offset device inode path
            String::from_utf8_lossy(&maps).lines().any(|line| {
                line.find('/').and_then(|start| line.get(start..)).is_some_and(|path| path.starts_with(&prefix))
            })
        })
        .collect();
    holders.sort_unstable();
    holders
}
