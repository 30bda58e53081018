//! The launcher's lock on its domain, and the guard that removes the domain on drop.
//!
//! A launcher that is killed cannot remove its domain. So that other processes can detect this, it holds a lock
//! (`flock`) on a file in the domain's root, from before the domain has any other file until all files are
//! removed. The kernel releases the lock when the launcher ends, however it ends, and a reused process id does
//! no harm. A process that gets the lock knows that the launcher is gone.

use std::fs::{self, DirBuilder, File, TryLockError};
use std::io::{ErrorKind, Write as _};
use std::os::unix::fs::{DirBuilderExt as _, MetadataExt as _};
use std::path::Path;

use super::ChannelError;
use super::domain::{DomainName, LOCK_FILE, SHM, remove_domain};
use super::own_files::{is_own, open_own};
use crate::clock::pause;

/// How often [`DomainLock::take_in`] tries.
const ATTEMPTS: u32 = 1000;

/// The lock on a domain, held as long as this lives.
#[derive(Debug)]
pub(super) struct DomainLock {
    _lock: File,
}

impl DomainLock {
    /// Creates the root of the domain below `shm` and locks it.
    ///
    /// # Errors
    /// When shared memory cannot be used, or another process keeps the lock.
    pub(super) fn take_in(shm: &Path, name: &DomainName) -> std::io::Result<Self> {
        let root = name.root_in(shm);
        let path = root.join(LOCK_FILE);
        // Only a process that cleans up this very domain right now can be in the way, and it is done in no time.
        for _ in 0..ATTEMPTS {
            match DirBuilder::new().mode(0o700).create(&root) {
                Err(error) if error.kind() != ErrorKind::AlreadyExists => return Err(error),
                // Looked at once: another process may remove it at any moment.
                Err(_) if root.symlink_metadata().is_ok_and(|metadata| !metadata.is_dir() || !is_own(&metadata)) => {
                    return Err(std::io::Error::new(ErrorKind::PermissionDenied, "it belongs to another user"));
                }
                _ => {}
            }
            let mut lock = match open_own(&path, File::options().create(true).truncate(false).write(true)) {
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
            if is_file_at(&path, &lock) {
                // For people and for `tectum doctor`; the lock is what counts.
                writeln!(lock, "{}", std::process::id())?;
                return Ok(Self { _lock: lock });
            }
        }
        Err(std::io::Error::other("another program holds it"))
    }
}

/// Whether the locked `file` is the one at `path`, and not one that was removed before it was locked.
pub(super) fn is_file_at(path: &Path, file: &File) -> bool {
    match (fs::metadata(path), file.metadata()) {
        (Ok(at_path), Ok(locked)) => (at_path.dev(), at_path.ino()) == (locked.dev(), locked.ino()),
        _ => false,
    }
}

/// Owns a domain: holds its lock, and removes all its files on drop. The owner must drop everything else in the
/// domain first. The lock is released after the removal.
#[derive(Debug)]
pub(super) struct DomainGuard {
    name: DomainName,
    _lock: DomainLock,
}

impl DomainGuard {
    /// Creates the root of the domain and locks it.
    ///
    /// # Errors
    /// [`ChannelError::SetUp`] when shared memory cannot be used, or another process keeps the lock.
    pub(super) fn take(name: &DomainName) -> Result<Self, ChannelError> {
        let lock = DomainLock::take_in(Path::new(SHM), name).map_err(|e| ChannelError::set_up("the root", e.kind()))?;
        Ok(Self { name: name.clone(), _lock: lock })
    }

    /// The domain.
    pub(super) fn name(&self) -> &DomainName {
        &self.name
    }
}

impl Drop for DomainGuard {
    fn drop(&mut self) {
        remove_domain(&self.name);
    }
}
