//! What the launcher leaves for watchers in the run's domain: the run's folder, a copy of all boards, and what the
//! processes said.
//!
//! A watcher reads these files and the log rings. It opens no node and no service of iceoryx2: a node that is stopped
//! or killed while it is set up can keep the launcher from cleaning up after a process of the run, and takes one of few
//! places. So there may be any number of watchers, and whatever happens to one of them, nobody in the run notices.
//!
//! The copy of the boards is written whole with one call. A reader that meets it half written sees that by its
//! checksum, and reads again. A reader holds a shared lock on the file, which ends with it however it ends: so the
//! launcher knows whether somebody watches, and that a copy every now and then is enough if nobody does.

use std::fs::File;
use std::io::{Read as _, Write as _};
use std::os::unix::ffi::OsStrExt as _;
use std::os::unix::fs::FileExt as _;
use std::path::PathBuf;
use std::sync::atomic::{AtomicU64, Ordering};

use super::domain::SHM;
use super::own_files::{is_own_folder, open_own};
use super::{ChannelError, DomainName};
use crate::wire::{Control, Status};

/// The file with the path of the run's folder.
const FOLDER: &str = "watch.folder";
/// The file with the copy of the boards.
const BOARDS: &str = "watch.boards";
/// The file with what was said, a line each.
const MESSAGES: &str = "watch.messages";
/// Most bytes of messages that are kept. A process that says more is not heard any more by watchers.
const MOST_BYTES: u64 = 256 << 10;
/// Longest path of a folder that is read, bytes.
const LONGEST_PATH: u64 = 4096;
/// How often a reader tries to read a copy that is being written.
const ATTEMPTS: u32 = 20;

/// All boards of a run at one instant.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct BoardsCopy {
    /// The launcher's board.
    pub control: Control,
    /// The boards of plant, controller and logger.
    pub status: [Status; 3],
}

/// Bytes of a copy: checksum, control board, status boards.
const COPY_BYTES: usize = 8 + size_of::<Control>() + 3 * size_of::<Status>();

impl BoardsCopy {
    fn to_bytes(self) -> [u8; COPY_BYTES] {
        let mut bytes = [0; COPY_BYTES];
        let (sum, rest) = bytes.split_at_mut(8);
        let (control, status) = rest.split_at_mut(size_of::<Control>());
        control.copy_from_slice(bytemuck::bytes_of(&self.control));
        status.copy_from_slice(bytemuck::bytes_of(&self.status));
        sum.copy_from_slice(&xxhash_rust::xxh3::xxh3_64(rest).to_le_bytes());
        bytes
    }

    fn from_bytes(bytes: &[u8; COPY_BYTES]) -> Option<Self> {
        let (sum, rest) = bytes.split_at(8);
        let whole = xxhash_rust::xxh3::xxh3_64(rest).to_le_bytes() == sum;
        let (control, status) = rest.split_at(size_of::<Control>());
        whole.then(|| Self {
            control: bytemuck::pod_read_unaligned(control),
            status: bytemuck::pod_read_unaligned(status),
        })
    }
}

/// The launcher's end. What cannot be written is left out, because the run works without watchers.
#[derive(Debug, Default)]
pub struct WatchFiles {
    boards: Option<File>,
    messages: Option<File>,
    said: AtomicU64,
}

impl WatchFiles {
    /// Creates the files in the run's domain. `folder` is the run's folder.
    pub fn create(domain: &DomainName, folder: &std::path::Path) -> Self {
        let root = domain.root();
        let create = |name: &str| open_own(&root.join(name), File::options().write(true).create_new(true)).ok();
        let [boards, messages] = [BOARDS, MESSAGES].map(create);
        // Written under another name first, so that a watcher that finds it finds all of it.
        let draft = root.join("watch.part");
        let path = std::path::absolute(folder).unwrap_or_else(|_| folder.to_owned());
        let file = open_own(&draft, File::options().write(true).create_new(true));
        let written = file.and_then(|mut file| file.write_all(path.as_os_str().as_bytes()));
        let _ = written.and_then(|()| std::fs::rename(&draft, root.join(FOLDER)));
        Self { boards, messages, said: AtomicU64::new(0) }
    }

    /// Replaces the copy of the boards.
    pub fn put(&self, boards: BoardsCopy) {
        if let Some(file) = &self.boards {
            let _ = file.write_all_at(&boards.to_bytes(), 0);
        }
    }

    /// Whether somebody has the copy of the boards open. Says yes where that cannot be known.
    pub fn is_watched(&self) -> bool {
        let Some(file) = &self.boards else { return false };
        let locked = file.try_lock();
        locked.is_err() || file.unlock().is_err()
    }

    /// Adds a line that somebody said.
    pub fn say(&self, line: &str) {
        let Some(mut file) = self.messages.as_ref() else { return };
        let text = line.replace('\n', " ") + "\n";
        if self.said.fetch_add(text.len() as u64, Ordering::Relaxed) + text.len() as u64 <= MOST_BYTES {
            let _ = file.write_all(text.as_bytes());
        }
    }
}

/// What was said in a run, line by line.
#[derive(Debug)]
pub struct MessageTail {
    file: File,
    at: u64,
    /// The begin of a line whose end has not come yet.
    open: Vec<u8>,
}

impl MessageTail {
    /// Opens the messages of a run.
    ///
    /// # Errors
    /// [`ChannelError::SetUp`] when there are none.
    pub fn open(domain: &DomainName) -> Result<Self, ChannelError> {
        let file = open_own(&domain.root().join(MESSAGES), File::options().read(true));
        let file = file.map_err(|e| ChannelError::set_up("the messages", e))?;
        Ok(Self { file, at: 0, open: Vec::new() })
    }

    /// The lines that have come since the last call.
    pub fn read(&mut self) -> Vec<String> {
        let mut bytes = [0; 4096];
        while let Ok(n @ 1..) = self.file.read_at(&mut bytes, self.at) {
            self.at += n as u64;
            self.open.extend(&bytes[..n]);
        }
        let Some(end) = self.open.iter().rposition(|&byte| byte == b'\n') else { return Vec::new() };
        let lines: Vec<u8> = self.open.drain(..=end).collect();
        String::from_utf8_lossy(&lines).lines().map(str::to_owned).collect()
    }
}

/// The copy of a run's boards, to be read again and again.
#[derive(Debug)]
pub struct BoardsFile {
    file: File,
    /// Whether this process holds its lock. For a moment the launcher may hold it.
    locked: bool,
}

impl BoardsFile {
    /// Opens the copy.
    ///
    /// # Errors
    /// [`ChannelError::SetUp`] when there is none.
    pub fn open(domain: &DomainName) -> Result<Self, ChannelError> {
        let file = open_own(&domain.root().join(BOARDS), File::options().read(true));
        let file = file.map_err(|e| ChannelError::set_up("the copy of the boards", e))?;
        let locked = file.try_lock_shared().is_ok();
        Ok(Self { file, locked })
    }

    /// Reads the copy; `None` if it has not been written yet.
    pub fn read(&mut self) -> Option<BoardsCopy> {
        self.locked = self.locked || self.file.try_lock_shared().is_ok();
        let mut bytes = [0; COPY_BYTES];
        (0..ATTEMPTS).find_map(|_| {
            self.file.read_exact_at(&mut bytes, 0).ok()?;
            BoardsCopy::from_bytes(&bytes)
        })
    }
}

/// The domains of this user in which a launcher has left a folder's path, and that path. Whether the runs are alive is
/// another question.
pub fn list_watched() -> Vec<(DomainName, PathBuf)> {
    let mut found = Vec::new();
    for entry in std::fs::read_dir(SHM).into_iter().flatten().flatten() {
        let Some(name) = entry.file_name().to_str().and_then(DomainName::of_file) else { continue };
        let root = name.root();
        if entry.path() != root || !is_own_folder(&root) {
            continue;
        }
        let mut path = Vec::new();
        let file = open_own(&root.join(FOLDER), File::options().read(true));
        if file.and_then(|file| file.take(LONGEST_PATH).read_to_end(&mut path)).is_ok() && !path.is_empty() {
            found.push((name, PathBuf::from(std::ffi::OsStr::from_bytes(&path))));
        }
    }
    found.sort();
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_watcher_reads_what_the_launcher_left() {
        let name = DomainName::of(u64::from(std::process::id()) << 32 ^ 0x3a7c);
        std::fs::create_dir_all(name.root()).unwrap();
        let files = WatchFiles::create(&name, std::path::Path::new("/somewhere/runs/arm-1"));
        assert!(!files.is_watched());
        let mut boards = BoardsFile::open(&name).unwrap();
        assert!(files.is_watched() && boards.read().is_none());
        let mut copy = BoardsCopy::default();
        (copy.control.phase, copy.status[1].ticks) = (2, 77);
        files.put(copy);
        assert_eq!(boards.read(), Some(copy));
        let other = BoardsFile::open(&name).unwrap();
        drop(boards);
        assert!(files.is_watched(), "by the other one");
        drop(other);
        assert!(!files.is_watched());
        let mut torn = copy.to_bytes();
        torn[40] ^= 1;
        assert_eq!(BoardsCopy::from_bytes(&torn), None);
        let mut messages = MessageTail::open(&name).unwrap();
        files.say("one\ntwo");
        files.say("three");
        assert_eq!(messages.read(), ["one two", "three"]);
        files.say(&"x".repeat(MOST_BYTES as usize));
        assert!(messages.read().is_empty());
        assert!(list_watched().contains(&(name.clone(), PathBuf::from("/somewhere/runs/arm-1"))));
        super::super::remove_domain(&name);
        assert!(!name.root().exists());
    }
}
