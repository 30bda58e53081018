//! Files in shared memory that belong to this user.
//!
//! `/dev/shm` is open to every user of the machine. Whoever likes can create a link, a pipe or a huge file under a
//! name that looks like one of Tectum's. So a file there is used, read or removed only if it belongs to this user,
//! and is opened without following a link and without waiting for the other end of a pipe.

use std::fs::{self, File, Metadata, OpenOptions};
use std::io::{Error, ErrorKind};
use std::os::unix::fs::{MetadataExt as _, OpenOptionsExt as _, PermissionsExt as _};
use std::path::Path;

use rustix::fs::OFlags;

/// Whether an entry belongs to this user. Of a link, `metadata` must be the link's own.
pub(super) fn is_own(metadata: &Metadata) -> bool {
    metadata.uid() == rustix::process::geteuid().as_raw()
}

/// Whether there is a folder at `path` that belongs to this user and is no link to one.
pub(super) fn is_own_folder(path: &Path) -> bool {
    fs::symlink_metadata(path).is_ok_and(|metadata| metadata.is_dir() && is_own(&metadata))
}

/// Opens a regular file of this user.
///
/// # Errors
/// When the file cannot be opened, is a link or something else than a regular file, or belongs to another user.
pub(super) fn open_own(path: &Path, options: &mut OpenOptions) -> std::io::Result<File> {
    let flags = OFlags::NOFOLLOW | OFlags::NONBLOCK;
    let file = options.mode(0o600).custom_flags(flags.bits() as i32).open(path)?;
    let metadata = file.metadata()?;
    if metadata.is_file() && is_own(&metadata) {
        Ok(file)
    } else {
        Err(Error::new(ErrorKind::PermissionDenied, "it is not a regular file of this user"))
    }
}

/// Closes the files in `folder` whose names begin with `prefix` to other users. iceoryx2 creates some of them with
/// permissions for everybody.
pub(super) fn close_to_others(folder: &Path, prefix: &str) {
    for entry in fs::read_dir(folder).into_iter().flatten().flatten() {
        if !entry.file_name().as_encoded_bytes().starts_with(prefix.as_bytes()) {
            continue;
        }
        let open = |m: &Metadata| m.is_file() && is_own(m) && m.permissions().mode() & 0o077 != 0;
        if entry.metadata().is_ok_and(|metadata| open(&metadata))
            && let Ok(file) = open_own(&entry.path(), File::options().read(true))
        {
            // Best effort: the run works in either case.
            let _ = file.set_permissions(fs::Permissions::from_mode(0o600));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_regular_files_of_this_user_are_opened() {
        let folder = tempfile::tempdir().unwrap();
        let [file, link, pipe] = ["file", "link", "pipe"].map(|name| folder.path().join(name));
        fs::write(&file, "x").unwrap();
        std::os::unix::fs::symlink(&file, &link).unwrap();
        let fifo = rustix::fs::FileType::Fifo;
        rustix::fs::mknodat(rustix::fs::CWD, &pipe, fifo, rustix::fs::Mode::RUSR | rustix::fs::Mode::WUSR, 0).unwrap();
        let open = |path: &Path| open_own(path, File::options().read(true));
        assert!(open(&file).is_ok());
        // A pipe without a writer would block for ever.
        assert!(open(&link).is_err() && open(&pipe).is_err() && open(folder.path()).is_err());
        assert!(is_own_folder(folder.path()) && !is_own_folder(&file));
        // Only root can give a file to another user.
        if rustix::process::geteuid().is_root() {
            std::os::unix::fs::chown(&file, Some(65534), Some(65534)).unwrap();
            assert_eq!(open(&file).unwrap_err().kind(), ErrorKind::PermissionDenied);
        }
    }

    #[test]
    fn files_are_closed_to_other_users() {
        let folder = tempfile::tempdir().unwrap();
        let [ours, other] = ["ours_a", "other"].map(|name| folder.path().join(name));
        for path in [&ours, &other] {
            fs::write(path, "x").unwrap();
            fs::set_permissions(path, fs::Permissions::from_mode(0o666)).unwrap();
        }
        close_to_others(folder.path(), "ours_");
        let mode = |path: &Path| fs::metadata(path).unwrap().permissions().mode() & 0o777;
        assert_eq!((mode(&ours), mode(&other)), (0o600, 0o666));
    }
}
