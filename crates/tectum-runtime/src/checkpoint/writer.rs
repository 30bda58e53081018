//! Writing checkpoint files on a thread of their own, so that ticks do not wait for the disk.

use std::fs::File;
use std::io::{self, Write as _};
use std::os::unix::fs::FileExt as _;
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Sender, channel};
use std::thread::JoinHandle;

use super::FOLDER;
use crate::wire::Role;

/// A job of the writing thread.
enum WriteJob {
    /// A checkpoint: the whole file, synced to the disk if `sync`.
    Checkpoint { path: PathBuf, bytes: Vec<u8>, sync: bool },
    /// A part of a file that may already exist.
    Record { path: PathBuf, offset: u64, bytes: Vec<u8> },
}

/// Writes a process's checkpoints to the disk while its ticks go on.
#[derive(Debug)]
pub struct CheckpointWriter {
    folder: PathBuf,
    role: Role,
    sender: Sender<WriteJob>,
    thread: JoinHandle<Result<u64, String>>,
}

impl CheckpointWriter {
    /// Starts the writer for the process in `role` of the run in `folder`. It keeps the newest `keep` checkpoints of
    /// this process and removes the others; 0: it keeps all.
    ///
    /// # Errors
    /// When no more threads can be started.
    pub(crate) fn new(folder: &Path, role: Role, keep: u64) -> io::Result<Self> {
        let own = folder.to_owned();
        let (sender, receiver) = channel::<WriteJob>();
        let thread = std::thread::Builder::new().name("checkpoints".to_owned()).spawn(move || {
            let (mut written, mut failed) = (0, None);
            for job in receiver {
                match job {
                    WriteJob::Checkpoint { path, bytes, sync } => match write_file(&path, &bytes, sync) {
                        Ok(()) => {
                            written += 1;
                            remove_all_but(&own, role, keep);
                        }
                        Err(cause) => failed = Some(format!("{} cannot be written: {cause}", path.display())),
                    },
                    // The reader of the file sees that a record is missing. Nothing else depends on it.
                    WriteJob::Record { path, offset, bytes } => drop(write_record(&path, offset, &bytes)),
                }
            }
            failed.map_or(Ok(written), Err)
        })?;
        Ok(Self { folder: folder.to_owned(), role, sender, thread })
    }

    /// Queues the bytes of the checkpoint at `tick`.
    pub(crate) fn write(&self, tick: u64, bytes: Vec<u8>) {
        self.queue(tick, bytes, true);
    }

    /// Queues the bytes of the last checkpoint. A run that must end at once (`haste`) does not wait for the
    /// disk: every process then sees the whole file, but a power failure right now could lose it.
    pub(crate) fn write_last(&self, tick: u64, bytes: Vec<u8>, haste: bool) {
        self.queue(tick, bytes, !haste);
    }

    /// Queues bytes for the file at `path`, from `offset` on. They are no checkpoint: they are not counted, not
    /// synced to the disk, and a failure is not reported.
    pub(crate) fn write_record(&self, path: &Path, offset: u64, bytes: Vec<u8>) {
        let _ = self.sender.send(WriteJob::Record { path: path.to_owned(), offset, bytes });
    }

    fn queue(&self, tick: u64, bytes: Vec<u8>, sync: bool) {
        let path = super::path(&self.folder, tick, self.role);
        // Fails only if the thread has ended early; `finish` reports why.
        let _ = self.sender.send(WriteJob::Checkpoint { path, bytes, sync });
    }

    /// Waits until all files are written, and returns their number.
    ///
    /// # Errors
    /// The last failure, in one sentence that names the file.
    pub(crate) fn finish(self) -> Result<u64, String> {
        drop(self.sender);
        self.thread.join().unwrap_or_else(|_| Err("the writer of checkpoints has panicked".to_owned()))
    }
}

/// Removes all checkpoints of `role` but the newest `keep`. Best effort: one that stays does no harm.
fn remove_all_but(folder: &Path, role: Role, keep: u64) {
    if keep == 0 {
        return;
    }
    for tick in super::ticks_of(folder, role).into_iter().rev().skip(keep as usize) {
        let _ = std::fs::remove_file(super::path(folder, tick, role));
    }
}

/// Writes a file as a whole or not at all.
fn write_file(path: &Path, bytes: &[u8], sync: bool) -> io::Result<()> {
    let folder = path.parent().unwrap_or(Path::new(FOLDER));
    std::fs::create_dir_all(folder)?;
    let mut draft = tempfile::Builder::new().suffix(".part").tempfile_in(folder)?;
    draft.write_all(bytes)?;
    if sync {
        draft.as_file().sync_all()?;
    }
    draft.persist(path).map_err(|e| e.error)?;
    // Also syncs the name.
    if sync { File::open(folder)?.sync_all() } else { Ok(()) }
}

/// Writes a part of a file. Creates the file if it does not exist.
fn write_record(path: &Path, offset: u64, bytes: &[u8]) -> io::Result<()> {
    let file = File::options().write(true).create(true).truncate(false).open(path)?;
    file.write_all_at(bytes, offset)
}
