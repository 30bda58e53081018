//! A run's own corner of shared memory: which names belong to it, and how they are wiped.

use std::path::{Path, PathBuf};

use iceoryx2::prelude::*;

use super::ChannelError;

/// Name of a domain, from which prefix and root follow: eight hexadecimal digits.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct DomainName(String);

impl DomainName {
    /// The domain of the run with this id.
    pub fn of(run: u64) -> Self {
        Self(format!("{:08x}", (run ^ (run >> 32)) as u32))
    }

    /// Prefix of all of the domain's shared-memory files.
    pub fn prefix(&self) -> String {
        format!("tectum_{}_", self.0)
    }

    /// The folder of the domain's nodes and services. On tmpfs, where setting up is some fifty times faster than on a
    /// disk; short, because iceoryx2 allows 70 bytes for root and prefix together.
    pub fn root(&self) -> PathBuf {
        PathBuf::from(format!("/dev/shm/tectum_{}", self.0))
    }
}

/// A process's membership in a domain: the iceoryx2 node.
#[derive(Debug)]
pub struct Domain {
    pub(super) node: Node<ipc::Service>,
}

impl Domain {
    /// Joins the domain `name` (creating it if nobody has).
    ///
    /// # Errors
    /// [`ChannelError::SetUp`] when shared memory cannot be used.
    pub fn join(name: &DomainName) -> Result<Self, ChannelError> {
        // Every failure comes back as a value and is told in our own words.
        set_log_level(LogLevel::Fatal);
        let mut config = Config::default();
        config.global.prefix = FileName::new(name.prefix().as_bytes()).expect("hexadecimal digits are a file name");
        let root = name.root();
        let root = iceoryx2::prelude::Path::new(root.as_os_str().as_encoded_bytes()).expect("a short absolute path");
        config.global.set_root_path(&root);
        // Clean-up belongs to the launcher alone: two processes that clean up at once can hang each other.
        config.global.node.cleanup_dead_nodes_on_creation = false;
        config.global.node.cleanup_dead_nodes_on_destruction = false;
        config.global.service.cleanup_dead_nodes_on_open = false;
        let node = NodeBuilder::new()
            .config(&config)
            .signal_handling_mode(SignalHandlingMode::Disabled)
            .create::<ipc::Service>()
            .map_err(|e| ChannelError::set_up("a node", e))?;
        Ok(Self { node })
    }
}

/// Removes every file of the domain. For the launcher, when all processes of the run have ended.
pub fn wipe(name: &DomainName) {
    wipe_in(Path::new("/dev/shm"), name);
}

fn wipe_in(shm: &Path, name: &DomainName) {
    let prefix = name.prefix();
    if let Ok(entries) = std::fs::read_dir(shm) {
        for entry in entries.flatten() {
            if entry.file_name().as_encoded_bytes().starts_with(prefix.as_bytes()) {
                let _ = std::fs::remove_file(entry.path());
            }
        }
    }
    let _ = std::fs::remove_dir_all(name.root());
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
    fn wiping_leaves_other_domains_alone() {
        let shm = tempfile::tempdir().unwrap();
        let (mine, other) = (DomainName::of(1), DomainName::of(2));
        for name in [&mine, &other] {
            std::fs::write(shm.path().join(format!("{}x", name.prefix())), "").unwrap();
        }
        wipe_in(shm.path(), &mine);
        let left: Vec<_> = std::fs::read_dir(shm.path()).unwrap().flatten().collect();
        assert_eq!(left.len(), 1);
        assert!(left[0].file_name().to_str().unwrap().starts_with(&other.prefix()));
    }
}
