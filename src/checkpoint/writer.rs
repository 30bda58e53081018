//! Writing checkpoints beside the ticks: a thread that does nothing else.

use std::fs::File;
use std::io::{self, Write as _};
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Sender, channel};
use std::thread::JoinHandle;

use super::FOLDER;
use crate::wire::Role;

/// Brings a process's checkpoints to the disk while its ticks go on.
#[derive(Debug)]
pub struct CheckpointWriter {
    folder: PathBuf,
    role: Role,
    sender: Sender<(PathBuf, Vec<u8>, bool)>,
    thread: JoinHandle<Result<u64, String>>,
}

impl CheckpointWriter {
    /// A writer for the process in the place of `role` of the run in `folder`.
    ///
    /// # Errors
    /// When there can be no more threads.
    pub fn new(folder: &Path, role: Role) -> io::Result<Self> {
        let (sender, receiver) = channel::<(PathBuf, Vec<u8>, bool)>();
        let thread = std::thread::Builder::new().name("checkpoints".to_owned()).spawn(move || {
            let (mut written, mut failed) = (0, None);
            for (path, bytes, sync) in receiver {
                match put(&path, &bytes, sync) {
                    Ok(()) => written += 1,
                    Err(cause) => failed = Some(format!("{} cannot be written: {cause}", path.display())),
                }
            }
            failed.map_or(Ok(written), Err)
        })?;
        Ok(Self { folder: folder.to_owned(), role, sender, thread })
    }

    /// Takes the bytes of the checkpoint at `tick` over.
    pub fn write(&self, tick: u64, bytes: Vec<u8>) {
        // A thread that is gone has left its reason, which `finish` tells.
        let _ = self.sender.send((super::path(&self.folder, tick, self.role), bytes, true));
    }

    /// The same for the last one. A run that is to end at once (`haste`) does not wait for the disk: the file is whole for
    /// everybody, unless the machine loses its power now.
    pub fn write_last(&self, tick: u64, bytes: Vec<u8>, haste: bool) {
        let _ = self.sender.send((super::path(&self.folder, tick, self.role), bytes, !haste));
    }

    /// Waits until all are on the disk. Gives how many there are, or why the last that failed did so.
    ///
    /// # Errors
    /// One sentence, with the file.
    pub fn finish(self) -> Result<u64, String> {
        drop(self.sender);
        self.thread.join().unwrap_or_else(|_| Err("the writer of checkpoints has panicked".to_owned()))
    }
}

/// Writes a file, whole or not at all.
fn put(path: &Path, bytes: &[u8], sync: bool) -> io::Result<()> {
    let folder = path.parent().unwrap_or(Path::new(FOLDER));
    std::fs::create_dir_all(folder)?;
    let mut draft = tempfile::Builder::new().suffix(".part").tempfile_in(folder)?;
    draft.write_all(bytes)?;
    if sync {
        draft.as_file().sync_all()?;
    }
    draft.persist(path).map_err(|e| e.error)?;
    // The name, too.
    if sync { File::open(folder)?.sync_all() } else { Ok(()) }
}
