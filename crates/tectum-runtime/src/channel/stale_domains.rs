//! Domains in shared memory: listing them with their owners, and removing those that have no owner any more.
//!
//! The lock of [`domain_lock`](super::domain_lock) tells whether a domain's launcher is alive. A domain without
//! a launcher is removed only when no process has any of its memory mapped either: the run's processes take up
//! to a second to notice the launcher's death.
//!
//! *No races.* A launcher that finds its lock file removed or replaced after locking it starts over. So a run
//! that begins while another process cleans up loses nothing. Two processes that clean up at once exclude each
//! other by the same lock.
//!
//! *Other users.* Entries that belong to another user are counted, and otherwise left alone: their names may be made
//! up, and what they link to is not ours.

use std::collections::BTreeMap;
use std::fs::{self, File, TryLockError};
use std::io::{ErrorKind, Read as _};
use std::os::unix::fs::MetadataExt as _;
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime};

use serde::Serialize;

use super::domain::{DomainName, LOCK_FILE, SHM, remove_files};
use super::domain_lock::is_file_at;
use super::own_files::{is_own, open_own};
use crate::clock::processes_mapping;

/// Domains that are examined, and whose locks are held, at the same time.
const BATCH: usize = 256;
/// Bytes of a lock file that are read: a process id and a line end.
const LOCK_FILE_BYTES: u64 = 32;
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
pub fn list_domains() -> Vec<StaleDomain> {
    list_in(Path::new(SHM))
}

fn list_in(shm: &Path) -> Vec<StaleDomain> {
    let listed: Vec<_> = domains(shm).into_iter().collect();
    let examined = listed.chunks(BATCH).flat_map(|batch| examine(shm, batch, File::try_lock_shared));
    listed.iter().zip(examined).map(|((name, domain), found)| domain.stale_domain(name, found.owner)).collect()
}

/// Removes every domain without an owner, and returns those that it removed. Cheap when there is none. Domains
/// without a lock, which only another version of this program can have left, are removed only if `thorough`.
pub fn remove_stale_domains(thorough: bool) -> Vec<StaleDomain> {
    remove_stale_in(Path::new(SHM), thorough)
}

fn remove_stale_in(shm: &Path, thorough: bool) -> Vec<StaleDomain> {
    let listed: Vec<_> = domains(shm).into_iter().filter(|(_, domain)| !domain.is_foreign()).collect();
    let mut removed = Vec::new();
    for batch in listed.chunks(BATCH) {
        // The lock, if a domain has one, is held until all its files are removed.
        for ((name, domain), ExaminedDomain { owner, lock }) in batch.iter().zip(examine(shm, batch, File::try_lock)) {
            if owner == DomainOwner::Nobody && (lock.is_some() || thorough) {
                let root = name.root_in(shm);
                remove_files(domain.files.iter().cloned(), &root);
                if domain.files.iter().chain([&root]).all(|path| path.symlink_metadata().is_err()) {
                    removed.push(domain.stale_domain(name, owner));
                }
            }
        }
    }
    removed
}

/// What a listing of shared memory shows of a domain.
#[derive(Debug, Default)]
struct ListedDomain {
    /// This user's entries, without the root.
    files: Vec<PathBuf>,
    /// Size of the regular files among them, bytes.
    bytes: u64,
    /// Whether its root is a folder of this user.
    root: bool,
    /// When the youngest of this user's entries was changed.
    youngest: Option<SystemTime>,
}

impl ListedDomain {
    /// Whether nothing of it belongs to this user.
    fn is_foreign(&self) -> bool {
        self.files.is_empty() && !self.root
    }

    fn stale_domain(&self, name: &DomainName, owner: DomainOwner) -> StaleDomain {
        StaleDomain { domain: name.stem(), owner, files: self.files.len() as u64, bytes: self.bytes }
    }

    /// A domain whose age is unknown counts as young.
    fn is_young(&self) -> bool {
        let age = self.youngest.and_then(|changed| changed.elapsed().ok());
        age.is_none_or(|age| age < MIN_STALE_AGE)
    }
}

/// The domains in shared memory, from one listing.
fn domains(shm: &Path) -> BTreeMap<DomainName, ListedDomain> {
    let mut domains: BTreeMap<DomainName, ListedDomain> = BTreeMap::new();
    for entry in fs::read_dir(shm).into_iter().flatten().flatten() {
        let Some(name) = entry.file_name().to_str().and_then(DomainName::of_file) else { continue };
        let is_root = entry.file_name() == name.stem().as_str();
        let domain = domains.entry(name).or_default();
        // Of a link, this is the link's own.
        let Some(metadata) = entry.metadata().ok().filter(is_own) else { continue };
        domain.youngest = domain.youngest.max(metadata.modified().ok());
        if is_root && metadata.is_dir() {
            domain.root = true;
        } else {
            domain.files.push(entry.path());
            domain.bytes += if metadata.is_file() { metadata.blocks() * 512 } else { 0 };
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

/// Finds the owners of some domains. `lock` is a shared lock when the domains are only listed, so that two listing
/// processes do not take each other for a launcher. The processes are searched for users of the domains after all
/// locks have been tried: a domain whose launcher is gone gets no new users.
fn examine(
    shm: &Path,
    batch: &[(DomainName, ListedDomain)],
    lock: fn(&File) -> Result<(), TryLockError>,
) -> Vec<ExaminedDomain> {
    let mut examined: Vec<_> = batch.iter().map(|(name, domain)| try_lock(shm, name, domain, lock)).collect();
    if examined.iter().all(|domain| domain.owner != DomainOwner::Nobody) {
        return examined;
    }
    let users =
        processes_mapping(|path| DomainName::of_file(Path::new(path).strip_prefix(shm).ok()?.iter().next()?.to_str()?));
    for ((name, _), ExaminedDomain { owner, lock }) in batch.iter().zip(&mut examined) {
        if let (DomainOwner::Nobody, Some(pids)) = (&owner, users.get(name)) {
            let pids = pids.clone();
            *owner = if lock.take().is_some() {
                DomainOwner::Processes { pids }
            } else {
                DomainOwner::OtherVersion { pids }
            };
        }
    }
    examined
}

/// The owner of a domain as far as its lock tells: `Nobody` if its launcher is gone.
fn try_lock(
    shm: &Path,
    name: &DomainName,
    domain: &ListedDomain,
    lock: fn(&File) -> Result<(), TryLockError>,
) -> ExaminedDomain {
    let unlocked = |owner| ExaminedDomain { owner, lock: None };
    let path = name.root_in(shm).join(LOCK_FILE);
    match if domain.root { open_own(&path, File::options().read(true)) } else { Err(ErrorKind::NotFound.into()) } {
        _ if domain.is_foreign() => unlocked(DomainOwner::OtherUser),
        Ok(file) => match lock(&file) {
            // A free lock may also be one that its launcher is about to take; that launcher starts over if the file
            // is removed.
            Ok(()) if is_file_at(&path, &file) => ExaminedDomain { owner: DomainOwner::Nobody, lock: Some(file) },
            // The process that held the lock has removed the file just now.
            Ok(()) => unlocked(DomainOwner::Young),
            Err(_) => {
                let mut text = String::new();
                let _ = file.take(LOCK_FILE_BYTES).read_to_string(&mut text);
                unlocked(DomainOwner::Launcher { pid: text.trim().parse().ok() })
            }
        },
        // Without a lock, the age decides.
        Err(error) if error.kind() == ErrorKind::NotFound && !domain.is_young() => unlocked(DomainOwner::Nobody),
        Err(error) if error.kind() == ErrorKind::NotFound => unlocked(DomainOwner::Young),
        Err(_) => unlocked(DomainOwner::OtherUser),
    }
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
            // A panic below must end the other threads, too.
            let _end = EndOfCleaning(&done);
            for round in 0..200 {
                let name = DomainName::of(round % 3);
                let lock = DomainLock::take_in(shm.path(), &name).unwrap();
                let file = shm.path().join(format!("{}x", name.prefix()));
                fs::write(&file, "").unwrap();
                std::thread::yield_now();
                assert!(file.exists() && name.root_in(shm.path()).join(LOCK_FILE).exists(), "round {round}");
                drop(lock);
            }
        });
    }

    /// Ends the cleaning threads when it is dropped.
    struct EndOfCleaning<'a>(&'a AtomicBool);

    impl Drop for EndOfCleaning<'_> {
        fn drop(&mut self) {
            self.0.store(true, Ordering::Relaxed);
        }
    }

    /// What a user can place in shared memory to make another user's clean-up do harm.
    #[test]
    fn links_pipes_and_huge_locks_do_no_harm() {
        let (shm, elsewhere) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
        let old = SystemTime::now() - 2 * MIN_STALE_AGE;
        fs::write(elsewhere.path().join("precious"), "x").unwrap();
        let (link, pipe, huge) = (DomainName::of(1), DomainName::of(2), DomainName::of(3));
        std::os::unix::fs::symlink(elsewhere.path(), link.root_in(shm.path())).unwrap();
        std::os::unix::fs::symlink(elsewhere.path(), shm.path().join(format!("{}x", link.prefix()))).unwrap();
        for name in [&pipe, &huge] {
            fs::create_dir(name.root_in(shm.path())).unwrap();
        }
        let mode = rustix::fs::Mode::RUSR | rustix::fs::Mode::WUSR;
        let fifo = pipe.root_in(shm.path()).join(LOCK_FILE);
        rustix::fs::mknodat(rustix::fs::CWD, &fifo, rustix::fs::FileType::Fifo, mode, 0).unwrap();
        let lock = File::create(huge.root_in(shm.path()).join(LOCK_FILE)).unwrap();
        lock.set_len(1 << 40).unwrap();
        lock.lock().unwrap();
        for name in [&pipe, &huge] {
            File::open(name.root_in(shm.path())).unwrap().set_modified(old).unwrap();
        }
        let held = DomainOwner::Launcher { pid: None };
        assert_eq!(owners(shm.path()), [DomainOwner::Young, DomainOwner::OtherUser, held]);
        remove_stale_in(shm.path(), true);
        // A launcher that meets the link where its root should be does not use it.
        assert!(DomainLock::take_in(shm.path(), &link).is_err());
        drop(lock);
        remove_stale_in(shm.path(), true);
        assert_eq!(fs::read(elsewhere.path().join("precious")).unwrap(), b"x");
        assert_eq!(fs::read_dir(elsewhere.path()).unwrap().count(), 1);
    }

    /// Only root can give files to another user, so the test needs root.
    #[test]
    fn entries_of_another_user_are_left_alone() {
        if !rustix::process::geteuid().is_root() {
            return;
        }
        let shm = tempfile::tempdir().unwrap();
        let (other, mixed) = (DomainName::of(1), DomainName::of(2));
        for name in [&other, &mixed] {
            drop(DomainLock::take_in(shm.path(), name).unwrap());
            create_domain(shm.path(), name);
        }
        let foreign = shm.path().join(format!("{}y.data", mixed.prefix()));
        fs::write(&foreign, "x").unwrap();
        for path in [other.root_in(shm.path()), shm.path().join(format!("{}x.data", other.prefix())), foreign.clone()] {
            std::os::unix::fs::chown(path, Some(65534), Some(65534)).unwrap();
        }
        assert_eq!(owners(shm.path()), [DomainOwner::OtherUser, DomainOwner::Nobody]);
        let removed: Vec<_> = remove_stale_in(shm.path(), true).into_iter().map(|removed| removed.domain).collect();
        assert_eq!(removed, [mixed.stem()]);
        assert!(foreign.exists() && other.root_in(shm.path()).exists());
        assert_eq!(owners(shm.path()), [DomainOwner::OtherUser, DomainOwner::OtherUser]);
    }
}
