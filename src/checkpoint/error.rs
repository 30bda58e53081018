//! Why a checkpoint cannot be used.

use std::path::PathBuf;

/// Why a checkpoint cannot be used. Nothing of it has been.
#[derive(Debug, thiserror::Error)]
pub enum CheckpointError {
    /// The operating system refuses to give the file.
    #[error("{}: the checkpoint cannot be read ({cause}); check the path and its permissions", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// What the operating system says.
        cause: std::io::Error,
    },
    /// The file is not as it was written.
    #[error("{}: the checkpoint is damaged: {what}; remove it to go on from the one before", path.display())]
    Damaged {
        /// The file.
        path: PathBuf,
        /// What does not fit.
        what: String,
    },
    /// The file is a safetensors file, and none of ours.
    #[error("{}: this is no checkpoint of this version of tectum; name the folder of a run that has one", path.display())]
    Foreign {
        /// The file.
        path: PathBuf,
    },
    /// The state is another's.
    #[error(
        "{}: the checkpoint does not fit: its {what} is {theirs}, here it is {ours}; go on with the build, the scenario \
         and the run that wrote it",
        path.display()
    )]
    Mismatch {
        /// The file.
        path: PathBuf,
        /// What differs.
        what: &'static str,
        /// The value here.
        ours: String,
        /// The checkpoint's.
        theirs: String,
    },
    /// There is nothing to go on from.
    #[error("{}: {what}", folder.display())]
    None {
        /// The run's folder.
        folder: PathBuf,
        /// What is the matter, and the remedy.
        what: String,
    },
}
