//! Writing checkpoints beside the ticks: a thread that does nothing else.

use std::fs::File;
use std::io::{self, Write as _};
use std::os::unix::fs::FileExt as _;
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Sender, channel};
use std::thread::JoinHandle;

use super::FOLDER;
use crate::wire::Role;

/// What the thread is given to write.
enum WriteJob {
    /// A checkpoint: the whole file, brought to the disk if `sync`.
    Checkpoint { path: PathBuf, bytes: Vec<u8>, sync: bool },
    /// A part of a file that may already be there.
    Record { path: PathBuf, offset: u64, bytes: Vec<u8> },
}

/// Brings a process's checkpoints to the disk while its ticks go on.
#[derive(Debug)]
pub struct CheckpointWriter {
    folder: PathBuf,
    role: Role,
    sender: Sender<WriteJob>,
    thread: JoinHandle<Result<u64, String>>,
}

impl CheckpointWriter {
    /// A writer for the process in the place of `role` of the run in `folder`.
    ///
    /// # Errors
    /// When there can be no more threads.
    pub fn new(folder: &Path, role: Role) -> io::Result<Self> {
        let (sender, receiver) = channel::<WriteJob>();
        let thread = std::thread::Builder::new().name("checkpoints".to_owned()).spawn(move || {
            let (mut written, mut failed) = (0, None);
            for job in receiver {
                match job {
                    WriteJob::Checkpoint { path, bytes, sync } => match put(&path, &bytes, sync) {
                        Ok(()) => written += 1,
                        Err(cause) => failed = Some(format!("{} cannot be written: {cause}", path.display())),
                    },
                    // A record that is missing is seen by its reader, and costs nothing else.
                    WriteJob::Record { path, offset, bytes } => drop(put_record(&path, offset, &bytes)),
                }
            }
            failed.map_or(Ok(written), Err)
        })?;
        Ok(Self { folder: folder.to_owned(), role, sender, thread })
    }

    /// Takes the bytes of the checkpoint at `tick` over.
    pub fn write(&self, tick: u64, bytes: Vec<u8>) {
        // A thread that is gone has left its reason, which `finish` tells.
        let _ = self.sender.send(WriteJob::Checkpoint { path: self.path(tick), bytes, sync: true });
    }

    /// The same for the last one. A run that is to end at once (`haste`) does not wait for the disk: the file
    /// is whole for everybody, unless the machine loses its power now.
    pub fn write_last(&self, tick: u64, bytes: Vec<u8>, haste: bool) {
        let _ = self.sender.send(WriteJob::Checkpoint { path: self.path(tick), bytes, sync: !haste });
    }

    /// Takes over bytes for the file at `path`, from `offset` on. They are no checkpoint: they are not
    /// counted, nobody waits for the disk, and a failure ends nothing.
    pub fn write_record(&self, path: &Path, offset: u64, bytes: Vec<u8>) {
        let _ = self.sender.send(WriteJob::Record { path: path.to_owned(), offset, bytes });
    }

    fn path(&self, tick: u64) -> PathBuf {
        super::path(&self.folder, tick, self.role)
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

/// Writes a part of a file, which is made if it is not there.
fn put_record(path: &Path, offset: u64, bytes: &[u8]) -> io::Result<()> {
    let file = File::options().write(true).create(true).truncate(false).open(path)?;
    file.write_all_at(bytes, offset)
}
