//! Which processes have a file mapped. This tells shared memory in use from shared memory that a dead process
//! left behind.

use std::collections::BTreeMap;
use std::path::Path;

/// The sorted ids of the processes that have a file mapped, by what `key_of` makes of the file's path. Files of
/// which it makes nothing are left out, and so are the processes of other users, whose maps cannot be read.
pub fn processes_mapping<K: Ord>(key_of: impl Fn(&str) -> Option<K>) -> BTreeMap<K, Vec<u32>> {
    let mut holders: BTreeMap<K, Vec<u32>> = BTreeMap::new();
    let Ok(processes) = std::fs::read_dir("/proc") else { return holders };
    for pid in processes.flatten().filter_map(|entry| entry.file_name().to_str()?.parse().ok()) {
        for path in mapped_files(&maps_of(pid)) {
            if let Some(key) = key_of(path) {
                let pids = holders.entry(key).or_default();
                if !pids.contains(&pid) {
                    pids.push(pid);
                }
            }
        }
    }
    holders.values_mut().for_each(|pids| pids.sort_unstable());
    holders
}

/// Whether process `pid` has a file mapped whose path begins with `prefix`.
pub fn maps_file(pid: u32, prefix: &Path) -> bool {
    let prefix = prefix.to_string_lossy();
    mapped_files(&maps_of(pid)).any(|path| path.starts_with(&*prefix))
}

fn maps_of(pid: u32) -> String {
    let maps = std::fs::read(format!("/proc/{pid}/maps")).unwrap_or_default();
    String::from_utf8_lossy(&maps).into_owned()
}

/// The paths in a process's map. The columns of a line: address, permissions, offset, device, inode, path.
fn mapped_files(maps: &str) -> impl Iterator<Item = &str> {
    maps.lines().filter_map(|line| line.get(line.find('/')?..))
}
