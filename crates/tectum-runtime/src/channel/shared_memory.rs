//! Whether this machine's shared memory can hold a run. It is checked before a run creates anything, because a
//! process that writes into a page for which there is no room is killed (SIGBUS).

use std::fs::File;
use std::path::Path;

use rustix::fs::{Access, FallocateFlags, StatVfsMountFlags, access, fallocate, statvfs};

use super::ChannelError;
use super::domain::{DomainName, SHM};
use super::own_files::open_own;

/// A run takes about this much, bytes, and its processes' states beside that.
const NEEDED: u64 = 6 << 20;

/// Requires that shared memory is there, can be written and has room for a run.
///
/// # Errors
/// [`ChannelError::SharedMemory`] says what is wrong, and the remedy.
pub fn check_shared_memory() -> Result<(), ChannelError> {
    let refused = |found: String, remedy| Err(ChannelError::SharedMemory { found, remedy });
    let Ok(shm) = statvfs(SHM) else {
        return refused(format!("there is no {SHM}"), "`sudo mount -t tmpfs tmpfs /dev/shm`");
    };
    if shm.f_flag.contains(StatVfsMountFlags::RDONLY) {
        return refused(format!("{SHM} is mounted read-only"), "`sudo mount -o remount,rw /dev/shm`");
    }
    if access(SHM, Access::WRITE_OK | Access::READ_OK | Access::EXEC_OK).is_err() {
        return refused(format!("{SHM} is closed to this user"), "`sudo chmod 1777 /dev/shm`");
    }
    let free = shm.f_bavail * shm.f_frsize;
    if free < NEEDED {
        let (needed, free) = (NEEDED >> 10, free >> 10);
        return refused(
            format!("a run needs about {needed} KiB of shared memory, and {SHM} has {free} KiB free"),
            "`sudo mount -o remount,size=256M /dev/shm`, in Docker `--shm-size=256m`; `tectum doctor --clean` frees \
             what runs have left",
        );
    }
    Ok(())
}

/// Gives every page of the domain's files its memory. For the launcher, when all processes have their ports and none
/// has begun: from then on no write can find shared memory full.
///
/// # Errors
/// [`ChannelError::SetUp`] when there is no room.
pub fn fill_domain(name: &DomainName) -> Result<(), ChannelError> {
    let prefix = name.prefix();
    for entry in std::fs::read_dir(Path::new(SHM)).into_iter().flatten().flatten() {
        let ours = entry.file_name().as_encoded_bytes().starts_with(prefix.as_bytes());
        let Some(size) = entry.metadata().ok().filter(|m| ours && m.is_file() && m.len() > 0).map(|m| m.len()) else {
            continue;
        };
        // A file that its process has removed again, or that is not this user's, needs nothing.
        let Ok(file) = open_own(&entry.path(), File::options().read(true).write(true)) else { continue };
        fallocate(&file, FallocateFlags::empty(), 0, size).map_err(|e| ChannelError::set_up("the memory", e))?;
    }
    Ok(())
}
