//! What runs have in shared memory, whose it is, and the removal of what nobody will remove any more.
//!
//! A launcher that is killed cannot wipe its domain. So that others can tell, it holds a lock (`flock`) on a file in the
//! domain's root from before there is anything else until everything is wiped; the kernel releases the lock at its
//! death, whatever the death, and process ids that are used again do not matter. Whoever gets the lock knows that the
//! launcher is gone. A domain goes only when no process has any of its memory mapped either: the run's processes take up
//! to a second to notice.
//!
//! *No races.* A launcher that finds its lock file gone or replaced after it has locked it starts over, so that a run
//! that begins while another cleans up loses nothing; two that clean up at once keep each other out by the same lock.

use std::collections::BTreeMap;
use std::fs::{self, DirBuilder, File, TryLockError};
use std::io::{ErrorKind, Read as _, Write as _};
use std::os::unix::fs::{DirBuilderExt as _, MetadataExt as _};
use std::path::Path;
use std::time::Duration;

use serde::Serialize;

use super::domain::{DomainName, SHM, remove_domain_in};
use crate::clock::{pause, processes_mapping};

/// The file in a domain's root on which its launcher holds a lock.
pub(super) const LOCK_FILE: &str = "launcher.lock";
/// How old a domain without a lock must be before it counts as left behind: a run may be about to make its lock.
const YOUNG: Duration = Duration::from_secs(60);

/// A launcher's hold on its domain, from before its first file until it is wiped.
#[derive(Debug)]
pub(super) struct DomainLock {
    _lock: File,
}

impl DomainLock {
    /// Makes the root of the domain and locks it.
    ///
    /// # Errors
    /// When shared memory cannot be used.
    pub fn take(name: &DomainName) -> std::io::Result<Self> {
        Self::take_in(Path::new(SHM), name)
    }

    fn take_in(shm: &Path, name: &DomainName) -> std::io::Result<Self> {
        let root = name.root_in(shm);
        let path = root.join(LOCK_FILE);
        // Only somebody who cleans up this very domain at this instant can be in the way, and is done in no time.
        for _ in 0..1000 {
            match DirBuilder::new().mode(0o750).create(&root) {
                Err(error) if error.kind() != ErrorKind::AlreadyExists => return Err(error),
                _ => {}
            }
            let mut lock = match File::options().create(true).truncate(false).write(true).open(&path) {
                Ok(lock) => lock,
                Err(error) if error.kind() == ErrorKind::NotFound => continue,
                Err(error) => return Err(error),
            };
            match lock.try_lock() {
                Ok(()) => {}
                Err(TryLockError::WouldBlock) => {
                    pause(1_000_000);
                    continue;
                }
                Err(TryLockError::Error(error)) => return Err(error),
            }
            if is_still(&path, &lock) {
                // For people and for `tectum doctor`; the lock is what counts.
                writeln!(lock, "{}", std::process::id())?;
                return Ok(Self { _lock: lock });
            }
        }
        Err(std::io::Error::other("another program holds it"))
    }
}

/// Whether the locked file is the one at `path`, and not one that was removed before it was locked.
fn is_still(path: &Path, file: &File) -> bool {
    match (fs::metadata(path), file.metadata()) {
        (Ok(there), Ok(ours)) => (there.dev(), there.ino()) == (ours.dev(), ours.ino()),
        _ => false,
    }
}

/// To whom a domain belongs.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case", tag = "owner")]
pub enum DomainOwner {
    /// A launcher that lives, by its process id where that can be read.
    Launcher {
        /// The process id.
        pid: Option<u32>,
    },
    /// No launcher any more, but processes that use it.
    Processes {
        /// Their ids.
        pids: Vec<u32>,
    },
    /// Processes, without a lock: a run of another version of this program.
    OtherVersion {
        /// Their ids.
        pids: Vec<u32>,
    },
    /// Nobody: what was left behind.
    Nobody,
    /// Without a lock and too young to tell: a run that just begins.
    Young,
    /// Another user, who can tell more.
    OtherUser,
}

/// A domain as it lies in shared memory.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct StaleDomain {
    /// Name of its root, and of all its files until the next `_`.
    pub domain: String,
    /// Whose it is.
    #[serde(flatten)]
    pub owner: DomainOwner,
    /// Files beside its root.
    pub files: u64,
    /// Their size, bytes.
    pub bytes: u64,
}

/// All of Tectum's domains in shared memory, in the order of their names.
pub fn list_domains() -> Vec<StaleDomain> {
    survey_in(Path::new(SHM))
}

fn survey_in(shm: &Path) -> Vec<StaleDomain> {
    domains(shm)
        .into_iter()
        .map(|(name, size)| size.stale_domain(&name, examine(shm, &name, File::try_lock_shared).owner))
        .collect()
}

/// Removes every domain that belongs to nobody, and says which. Cheap where there is none. Domains without a lock, which
/// only another version of this program can have left, are removed if `thorough`.
pub fn remove_stale_domains(thorough: bool) -> Vec<StaleDomain> {
    sweep_in(Path::new(SHM), thorough)
}

fn sweep_in(shm: &Path, thorough: bool) -> Vec<StaleDomain> {
    let mut removed = Vec::new();
    for (name, size) in domains(shm) {
        // The lock, where there is one, is held until all is gone.
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

struct ExaminedDomain {
    owner: DomainOwner,
    /// The domain's lock, held, if its launcher is gone.
    lock: Option<File>,
}

/// Looks whose a domain is. `lock` is shared where it is only looked at, so that those who look do not take each other for
/// a launcher.
fn examine(shm: &Path, name: &DomainName, lock: fn(&File) -> Result<(), TryLockError>) -> ExaminedDomain {
    let owned = |owner| ExaminedDomain { owner, lock: None };
    let path = name.root_in(shm).join(LOCK_FILE);
    let lock = match File::open(&path) {
        Ok(mut file) => match lock(&file) {
            Ok(()) if is_still(&path, &file) => Some(file),
            // Removed just now, by whoever had the lock.
            Ok(()) => return owned(DomainOwner::Young),
            Err(_) => {
                let mut text = String::new();
                let _ = file.read_to_string(&mut text);
                return owned(DomainOwner::Launcher { pid: text.trim().parse().ok() });
            }
        },
        Err(error) if error.kind() == ErrorKind::NotFound => None,
        Err(_) => return owned(DomainOwner::OtherUser),
    };
    // A lock that is free may also be about to be taken by its launcher, which will start over if the file goes. Without
    // a lock, age must do.
    if lock.is_none() && youngest(shm, name).is_none_or(|age| age < YOUNG) {
        return owned(DomainOwner::Young);
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
fn youngest(shm: &Path, name: &DomainName) -> Option<Duration> {
    let entries = fs::read_dir(shm).ok()?.flatten();
    let ours = entries.filter(|e| e.file_name().to_str().and_then(DomainName::of_file).as_ref() == Some(name));
    ours.filter_map(|e| e.metadata().ok()?.modified().ok()?.elapsed().ok()).min()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::atomic::{AtomicBool, Ordering};

    /// A domain with a file, as a run would leave it.
    fn lay(shm: &Path, name: &DomainName) {
        fs::create_dir_all(name.root_in(shm).join("nodes")).unwrap();
        fs::write(shm.join(format!("{}x.data", name.prefix())), vec![1; 5000]).unwrap();
    }

    fn owners(shm: &Path) -> Vec<DomainOwner> {
        survey_in(shm).into_iter().map(|stale_domain| stale_domain.owner).collect()
    }

    #[test]
    fn what_a_launcher_left_goes_and_what_one_holds_stays() {
        let shm = tempfile::tempdir().unwrap();
        let (dead, alive) = (DomainName::of(1), DomainName::of(2));
        let held = DomainLock::take_in(shm.path(), &alive).unwrap();
        drop(DomainLock::take_in(shm.path(), &dead).unwrap());
        lay(shm.path(), &dead);
        lay(shm.path(), &alive);
        fs::write(shm.path().join("tectum_else"), "").unwrap();
        let living = DomainOwner::Launcher { pid: Some(std::process::id()) };
        assert_eq!(owners(shm.path()), [DomainOwner::Nobody, living.clone()]);
        let removed = sweep_in(shm.path(), false);
        assert_eq!(removed.len(), 1);
        assert_eq!((removed[0].domain.as_str(), removed[0].files), ("tectum_00000001", 1));
        assert!(removed[0].bytes >= 5000);
        assert_eq!(owners(shm.path()), [living]);
        assert!(shm.path().join("tectum_else").exists(), "not a run's");
        drop(held);
        assert_eq!((sweep_in(shm.path(), false).len(), owners(shm.path()).len()), (1, 0));
    }

    /// As an older build leaves it, or one that is just about to make its lock.
    #[test]
    fn a_domain_without_a_lock_is_left_alone_while_it_is_young() {
        let shm = tempfile::tempdir().unwrap();
        let name = DomainName::of(3);
        lay(shm.path(), &name);
        assert_eq!(owners(shm.path()), [DomainOwner::Young]);
        assert!(sweep_in(shm.path(), true).is_empty());
        let old = std::time::SystemTime::now() - 2 * YOUNG;
        for path in [shm.path().join(format!("{}x.data", name.prefix())), name.root_in(shm.path())] {
            File::open(path).unwrap().set_modified(old).unwrap();
        }
        assert_eq!(owners(shm.path()), [DomainOwner::Nobody]);
        assert!(sweep_in(shm.path(), false).is_empty(), "a run takes away only what certainly had a launcher");
        assert_eq!(sweep_in(shm.path(), true).len(), 1);
        assert!(owners(shm.path()).is_empty());
    }

    /// Launchers that begin while others clean up as fast as they can: nobody loses a domain that is held.
    #[test]
    fn a_claim_holds_whoever_cleans_up_meanwhile() {
        let shm = tempfile::tempdir().unwrap();
        let over = AtomicBool::new(false);
        std::thread::scope(|scope| {
            for _ in 0..2 {
                scope.spawn(|| {
                    while !over.load(Ordering::Relaxed) {
                        sweep_in(shm.path(), true);
                    }
                });
            }
            for round in 0..200 {
                let name = DomainName::of(round % 3);
                let claim = DomainLock::take_in(shm.path(), &name).unwrap();
                let file = shm.path().join(format!("{}x", name.prefix()));
                fs::write(&file, "").unwrap();
                std::thread::yield_now();
                assert!(file.exists() && name.root_in(shm.path()).join(LOCK_FILE).exists(), "round {round}");
                drop(claim);
            }
            over.store(true, Ordering::Relaxed);
        });
    }
}
