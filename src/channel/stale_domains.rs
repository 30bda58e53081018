//! Domains in shared memory: listing them with their owners, and removing those that have no owner any more.
//!
//! The lock of [`domain_lock`](super::domain_lock) tells whether a domain's launcher is alive. A domain without
//! a launcher is removed only when no process has any of its memory mapped either: the run's processes take up
//! to a second to notice the launcher's death.
//!
//! *No races.* A launcher that finds its lock file removed or replaced after locking it starts over. So a run
//! that begins while another process cleans up loses nothing. Two processes that clean up at once exclude each
//! other by the same lock.

use std::collections::BTreeMap;
use std::fs::{self, File, TryLockError};
use std::io::{ErrorKind, Read as _};
use std::os::unix::fs::MetadataExt as _;
use std::path::Path;
use std::time::Duration;

use serde::Serialize;

use super::domain::{DomainName, LOCK_FILE, SHM, remove_domain_in};
use super::domain_lock::is_file_at;
use crate::clock::processes_mapping;

/// Minimum age of a domain without a lock before it counts as stale: its run may be about to create the lock.
const MIN_STALE_AGE: Duration = Duration::from_secs(60);

/// The owner of a domain.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case", tag = "owner")]
pub enum DomainOwner {
    /// A live launcher, with its process id where that can be read.
    Launcher {
        /// The process id.
        pid: Option<u32>,
    },
    /// The launcher is gone, but processes still use the domain.
    Processes {
        /// Their ids.
        pids: Vec<u32>,
    },
    /// Processes use the domain, and it has no lock: a run of another version of this program.
    OtherVersion {
        /// Their ids.
        pids: Vec<u32>,
    },
    /// Nobody: the domain is stale.
    Nobody,
    /// No lock, and too young to decide: the run may just begin.
    Young,
    /// Another user; only that user can find out more.
    OtherUser,
}

/// A domain in shared memory.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct StaleDomain {
    /// Name of its root. The names of its files begin with it and `_`.
    pub domain: String,
    /// Its owner.
    #[serde(flatten)]
    pub owner: DomainOwner,
    /// Files beside its root.
    pub files: u64,
    /// Size of these files, bytes.
    pub bytes: u64,
}

/// All of Tectum's domains in shared memory, in the order of their names.
pub(crate) fn list_domains() -> Vec<StaleDomain> {
    list_in(Path::new(SHM))
}

fn list_in(shm: &Path) -> Vec<StaleDomain> {
    domains(shm)
        .into_iter()
        .map(|(name, size)| size.stale_domain(&name, examine(shm, &name, File::try_lock_shared).owner))
        .collect()
}

/// Removes every domain without an owner, and returns those that it removed. Cheap when there is none. Domains
/// without a lock, which only another version of this program can have left, are removed only if `thorough`.
pub(crate) fn remove_stale_domains(thorough: bool) -> Vec<StaleDomain> {
    remove_stale_in(Path::new(SHM), thorough)
}

fn remove_stale_in(shm: &Path, thorough: bool) -> Vec<StaleDomain> {
    let mut removed = Vec::new();
    for (name, size) in domains(shm) {
        // The lock, if the domain has one, is held until all files are removed.
        let ExaminedDomain { owner, lock } = examine(shm, &name, File::try_lock);
        if owner == DomainOwner::Nobody && (lock.is_some() || thorough) {
            remove_domain_in(shm, &name);
            if !domains(shm).contains_key(&name) {
                removed.push(size.stale_domain(&name, owner));
            }
        }
    }
    removed
}

/// Files and bytes of a domain.
#[derive(Debug, Default)]
struct DomainSize {
    files: u64,
    bytes: u64,
}

impl DomainSize {
    fn stale_domain(&self, name: &DomainName, owner: DomainOwner) -> StaleDomain {
        StaleDomain { domain: name.stem(), owner, files: self.files, bytes: self.bytes }
    }
}

fn domains(shm: &Path) -> BTreeMap<DomainName, DomainSize> {
    let mut domains: BTreeMap<DomainName, DomainSize> = BTreeMap::new();
    for entry in fs::read_dir(shm).into_iter().flatten().flatten() {
        let Some(name) = entry.file_name().to_str().and_then(DomainName::of_file) else { continue };
        let size = domains.entry(name).or_default();
        if let Ok(metadata) = entry.metadata().as_ref().map(|m| (m.is_file(), m.blocks() * 512))
            && metadata.0
        {
            size.files += 1;
            size.bytes += metadata.1;
        }
    }
    domains
}

/// The result of examining a domain.
struct ExaminedDomain {
    owner: DomainOwner,
    /// The domain's lock, held, if its launcher is gone.
    lock: Option<File>,
}

/// Finds the owner of a domain. `lock` is a shared lock when the domain is only listed, so that two listing
/// processes do not take each other for a launcher.
fn examine(shm: &Path, name: &DomainName, lock: fn(&File) -> Result<(), TryLockError>) -> ExaminedDomain {
    let unlocked = |owner| ExaminedDomain { owner, lock: None };
    let path = name.root_in(shm).join(LOCK_FILE);
    let lock = match File::open(&path) {
        Ok(mut file) => match lock(&file) {
            Ok(()) if is_file_at(&path, &file) => Some(file),
            // The process that held the lock has removed the file just now.
            Ok(()) => return unlocked(DomainOwner::Young),
            Err(_) => {
                let mut text = String::new();
                let _ = file.read_to_string(&mut text);
                return unlocked(DomainOwner::Launcher { pid: text.trim().parse().ok() });
            }
        },
        Err(error) if error.kind() == ErrorKind::NotFound => None,
        Err(_) => return unlocked(DomainOwner::OtherUser),
    };
    // A free lock may also be one that its launcher is about to take; that launcher starts over if the file is
    // removed. Without a lock, the age decides.
    if lock.is_none() && min_age(shm, name).is_none_or(|age| age < MIN_STALE_AGE) {
        return unlocked(DomainOwner::Young);
    }
    let pids = processes_mapping(&name.root_in(shm));
    let owner = match (pids.is_empty(), &lock) {
        (true, _) => DomainOwner::Nobody,
        (false, Some(_)) => DomainOwner::Processes { pids },
        (false, None) => DomainOwner::OtherVersion { pids },
    };
    ExaminedDomain { owner, lock }
}

/// The age of the domain's youngest entry.
fn min_age(shm: &Path, name: &DomainName) -> Option<Duration> {
    let entries = fs::read_dir(shm).ok()?.flatten();
    let of_domain = entries.filter(|e| e.file_name().to_str().and_then(DomainName::of_file).as_ref() == Some(name));
    of_domain.filter_map(|e| e.metadata().ok()?.modified().ok()?.elapsed().ok()).min()
}

#[cfg(test)]
mod tests {
    use super::super::domain_lock::DomainLock;
    use super::*;
    use std::sync::atomic::{AtomicBool, Ordering};

    /// Creates a domain with a file, as a run would leave it.
    fn create_domain(shm: &Path, name: &DomainName) {
        fs::create_dir_all(name.root_in(shm).join("nodes")).unwrap();
        fs::write(shm.join(format!("{}x.data", name.prefix())), vec![1; 5000]).unwrap();
    }

    fn owners(shm: &Path) -> Vec<DomainOwner> {
        list_in(shm).into_iter().map(|stale_domain| stale_domain.owner).collect()
    }

    #[test]
    fn a_domain_without_a_launcher_is_removed_and_a_locked_one_is_kept() {
        let shm = tempfile::tempdir().unwrap();
        let (dead, alive) = (DomainName::of(1), DomainName::of(2));
        let lock = DomainLock::take_in(shm.path(), &alive).unwrap();
        drop(DomainLock::take_in(shm.path(), &dead).unwrap());
        create_domain(shm.path(), &dead);
        create_domain(shm.path(), &alive);
        fs::write(shm.path().join("tectum_else"), "").unwrap();
        let launcher = DomainOwner::Launcher { pid: Some(std::process::id()) };
        assert_eq!(owners(shm.path()), [DomainOwner::Nobody, launcher.clone()]);
        let removed = remove_stale_in(shm.path(), false);
        assert_eq!(removed.len(), 1);
        assert_eq!((removed[0].domain.as_str(), removed[0].files), ("tectum_00000001", 1));
        assert!(removed[0].bytes >= 5000);
        assert_eq!(owners(shm.path()), [launcher]);
        assert!(shm.path().join("tectum_else").exists(), "not a run's");
        drop(lock);
        assert_eq!((remove_stale_in(shm.path(), false).len(), owners(shm.path()).len()), (1, 0));
    }

    /// An older build leaves such a domain, and so does a run that is about to create its lock.
    #[test]
    fn a_domain_without_a_lock_is_left_alone_while_it_is_young() {
        let shm = tempfile::tempdir().unwrap();
        let name = DomainName::of(3);
        create_domain(shm.path(), &name);
        assert_eq!(owners(shm.path()), [DomainOwner::Young]);
        assert!(remove_stale_in(shm.path(), true).is_empty());
        let old = std::time::SystemTime::now() - 2 * MIN_STALE_AGE;
        for path in [shm.path().join(format!("{}x.data", name.prefix())), name.root_in(shm.path())] {
            File::open(path).unwrap().set_modified(old).unwrap();
        }
        assert_eq!(owners(shm.path()), [DomainOwner::Nobody]);
        assert!(
            remove_stale_in(shm.path(), false).is_empty(),
            "only a domain that certainly had a launcher is removed"
        );
        assert_eq!(remove_stale_in(shm.path(), true).len(), 1);
        assert!(owners(shm.path()).is_empty());
    }

    /// Launchers begin while other threads clean up as fast as they can: no locked domain is removed.
    #[test]
    fn a_locked_domain_survives_concurrent_cleaning() {
        let shm = tempfile::tempdir().unwrap();
        let done = AtomicBool::new(false);
        std::thread::scope(|scope| {
            for _ in 0..2 {
                scope.spawn(|| {
                    while !done.load(Ordering::Relaxed) {
                        remove_stale_in(shm.path(), true);
                    }
                });
            }
            for round in 0..200 {
                let name = DomainName::of(round % 3);
                let lock = DomainLock::take_in(shm.path(), &name).unwrap();
                let file = shm.path().join(format!("{}x", name.prefix()));
                fs::write(&file, "").unwrap();
                std::thread::yield_now();
                assert!(file.exists() && name.root_in(shm.path()).join(LOCK_FILE).exists(), "round {round}");
                drop(lock);
            }
            done.store(true, Ordering::Relaxed);
        });
    }
}
