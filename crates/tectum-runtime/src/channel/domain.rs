//! A domain: the part of shared memory that belongs to one run. Names of its files, joining it, and removing it.

use std::path::{Path, PathBuf};
use std::sync::{Arc, mpsc};
use std::time::Duration;

use iceoryx2::prelude::*;

use super::ChannelError;
use super::own_files::{close_to_others, is_own, is_own_folder};
use crate::clock::maps_file;

/// The folder of shared memory.
pub(super) const SHM: &str = "/dev/shm";
/// The file in a domain's root on which its launcher holds a lock.
pub(super) const LOCK_FILE: &str = "launcher.lock";
/// How often [`reclaim_dead`] tries.
const RECLAIM_ATTEMPTS: u32 = 10;

/// Name of a domain: eight hexadecimal digits. Prefix and root follow from it. A name that is read from a file is
/// checked, because paths are made of it.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, serde::Serialize, serde::Deserialize)]
#[serde(try_from = "String")]
pub struct DomainName(String);

/// A text that is not the name of a domain.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("\"{0}\" is not the name of a domain, which has eight hexadecimal digits")]
pub struct NotADomain(String);

impl TryFrom<String> for DomainName {
    type Error = NotADomain;

    fn try_from(name: String) -> Result<Self, NotADomain> {
        if is_name(&name) { Ok(Self(name)) } else { Err(NotADomain(name)) }
    }
}

fn is_name(text: &str) -> bool {
    text.len() == 8 && text.bytes().all(|b| b.is_ascii_digit() || (b'a'..=b'f').contains(&b))
}

impl DomainName {
    /// The domain of the run with this id.
    pub fn of(run: u64) -> Self {
        Self(format!("{:08x}", (run ^ (run >> 32)) as u32))
    }

    /// The domain to which a file or folder in shared memory belongs, by its name; `None` if it is not Tectum's.
    pub(super) fn of_file(name: &str) -> Option<Self> {
        let digits = name.strip_prefix("tectum_")?;
        let (digits, rest) = digits.split_at_checked(8)?;
        (is_name(digits) && (rest.is_empty() || rest.starts_with('_'))).then(|| Self(digits.to_owned()))
    }

    /// The beginning of the names of the root and of all files.
    pub(super) fn stem(&self) -> String {
        format!("tectum_{}", self.0)
    }

    /// Prefix of all of the domain's shared-memory files.
    pub fn prefix(&self) -> String {
        format!("{}_", self.stem())
    }

    /// The folder of the domain's nodes and services. It is on tmpfs, where setting up is some fifty times
    /// faster than on a disk. It is short, because iceoryx2 allows 70 bytes for root and prefix together.
    pub fn root(&self) -> PathBuf {
        self.root_in(Path::new(SHM))
    }

    /// The same below another folder `shm`, for tests.
    pub(super) fn root_in(&self, shm: &Path) -> PathBuf {
        shm.join(self.stem())
    }
}

/// A process's membership in a domain: the iceoryx2 node.
#[derive(Debug, Clone)]
pub(super) struct Domain {
    pub(super) node: Arc<Node<ipc::Service>>,
}

impl Domain {
    /// Joins the domain `name`, and creates it if it does not exist.
    ///
    /// # Errors
    /// [`ChannelError::SetUp`] when shared memory cannot be used.
    pub fn join(name: &DomainName) -> Result<Self, ChannelError> {
        // Every failure is returned as a value and reported with our own message.
        set_log_level(LogLevel::Fatal);
        let node = NodeBuilder::new()
            .config(&configuration(name))
            .signal_handling_mode(SignalHandlingMode::Disabled)
            .create::<ipc::Service>()
            .map_err(|e| ChannelError::set_up("a node", e))?;
        Ok(Self { node: Arc::new(node) })
    }
}

/// Closes the domain's files to other users. For the launcher, when the first node exists.
pub(super) fn close_domain_to_others(name: &DomainName) {
    close_to_others(Path::new(SHM), &name.prefix());
}

/// Whether process `pid` has memory of the domain mapped, as every process of its run has.
pub fn is_member(name: &DomainName, pid: u32) -> bool {
    maps_file(pid, &name.root())
}

fn configuration(name: &DomainName) -> Config {
    let mut config = Config::default();
    config.global.prefix = FileName::new(name.prefix().as_bytes()).expect("hexadecimal digits are a file name");
    let root = name.root();
    let root = iceoryx2::prelude::Path::new(root.as_os_str().as_encoded_bytes()).expect("a short absolute path");
    config.global.set_root_path(&root);
    // Clean-up belongs to the launcher alone: two processes that clean up at once can hang each other.
    config.global.node.cleanup_dead_nodes_on_creation = false;
    config.global.node.cleanup_dead_nodes_on_destruction = false;
    config.global.service.cleanup_dead_nodes_on_open = false;
    config
}

/// Frees what killed processes held of the domain's services, so that their successors can take it. For the
/// launcher, when no process is being set up. `Some(false)` if something could not be freed. `None` if the
/// attempt did not end within `limit`: iceoryx2 waits without end for a resource that a process began to create
/// and never finished.
pub fn reclaim_dead(name: &DomainName, limit: Duration) -> Option<bool> {
    remove_empty_segments(name);
    let config = configuration(name);
    let (done, wait) = mpsc::channel();
    // Not joined: if it hangs, it ends with the launcher.
    let thread = std::thread::Builder::new().name("reclaim".to_owned()).spawn(move || {
        // A failed attempt may succeed the next time: the node may have died while it was being created or listed.
        let clean = (0..RECLAIM_ATTEMPTS).any(|attempt| {
            if attempt > 0 {
                std::thread::sleep(Duration::from_millis(5));
            }
            let mut clean = true;
            let listed = Node::<ipc::Service>::list(&config, |state| {
                if let NodeState::Dead(dead) = state {
                    clean &= dead.try_remove_stale_resources().is_ok();
                }
                CallbackProgression::Continue
            });
            clean && listed.is_ok()
        });
        let _ = done.send(clean);
    });
    // Without a thread nothing is freed now. The start that follows fails then, and is tried again.
    thread.map_or(Some(false), |_| wait.recv_timeout(limit).ok())
}

/// Removes segments of size 0. Their creator died between creating and sizing them; opening one would hang.
fn remove_empty_segments(name: &DomainName) {
    let prefix = name.prefix();
    for entry in std::fs::read_dir(SHM).into_iter().flatten().flatten() {
        let in_domain = entry.file_name().as_encoded_bytes().starts_with(prefix.as_bytes());
        if in_domain && entry.metadata().is_ok_and(|m| m.is_file() && m.len() == 0 && is_own(&m)) {
            let _ = std::fs::remove_file(entry.path());
        }
    }
}

/// Removes every file of the domain. For the launcher, when all processes of the run have ended.
pub fn remove_domain(name: &DomainName) {
    remove_domain_in(Path::new(SHM), name);
}

/// Removes every file of the domain below `shm`.
pub(super) fn remove_domain_in(shm: &Path, name: &DomainName) {
    let prefix = name.prefix();
    let entries = std::fs::read_dir(shm).into_iter().flatten().flatten();
    let files = entries.filter(|entry| entry.file_name().as_encoded_bytes().starts_with(prefix.as_bytes()));
    remove_files(files.map(|entry| entry.path()), &name.root_in(shm));
}

/// Removes `files` and the domain's `root`, as far as they are this user's. The launcher's lock is removed last, so
/// that the domain never has files without a lock. No link is followed.
pub(super) fn remove_files(files: impl Iterator<Item = PathBuf>, root: &Path) {
    for file in files {
        if file.symlink_metadata().is_ok_and(|metadata| is_own(&metadata)) {
            let _ = std::fs::remove_file(file);
        }
    }
    if !is_own_folder(root) {
        return;
    }
    for entry in std::fs::read_dir(root).into_iter().flatten().flatten().filter(|e| e.file_name() != LOCK_FILE) {
        let folder = entry.file_type().is_ok_and(|t| t.is_dir());
        let _ = if folder { std::fs::remove_dir_all(entry.path()) } else { std::fs::remove_file(entry.path()) };
    }
    let _ = std::fs::remove_file(root.join(LOCK_FILE));
    let _ = std::fs::remove_dir(root);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn root_and_prefix_fit_into_what_iceoryx2_allows() {
        let name = DomainName::of(u64::MAX - 1);
        assert!(name.root().as_os_str().len() + name.prefix().len() <= 70);
    }

    #[test]
    fn removing_a_domain_leaves_other_domains_alone() {
        let shm = tempfile::tempdir().unwrap();
        let (removed, other) = (DomainName::of(1), DomainName::of(2));
        for name in [&removed, &other] {
            std::fs::write(shm.path().join(format!("{}x", name.prefix())), "").unwrap();
        }
        remove_domain_in(shm.path(), &removed);
        let left: Vec<_> = std::fs::read_dir(shm.path()).unwrap().flatten().collect();
        assert_eq!(left.len(), 1);
        assert!(left[0].file_name().to_str().unwrap().starts_with(&other.prefix()));
    }

    #[test]
    fn a_name_that_is_read_is_checked() {
        let read = |text: &str| serde_json::from_str::<DomainName>(&format!("\"{text}\""));
        assert_eq!(read("0123abcd").unwrap().stem(), "tectum_0123abcd");
        for text in ["", "0123abc", "0123abcde", "0123ABCD", "../../ho", "0123/bcd"] {
            assert!(read(text).unwrap_err().to_string().contains("eight hexadecimal digits"), "{text}");
        }
    }
}
