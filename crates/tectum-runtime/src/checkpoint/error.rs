//! Errors of reading a checkpoint.

use std::path::PathBuf;

/// Why a checkpoint cannot be used. No part of it has been used when this is returned.
#[derive(Debug, thiserror::Error)]
pub enum CheckpointError {
    /// The file cannot be read.
    #[error("{}: the checkpoint cannot be read ({cause}); check the path and its permissions", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// The error of the operating system.
        cause: std::io::Error,
    },
    /// The file was changed after it was written, or is incomplete.
    #[error("{}: the checkpoint is damaged: {what}; remove it to go on from the one before", path.display())]
    Damaged {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        what: String,
    },
    /// The file is a safetensors file, but not a checkpoint of this version.
    #[error(
        "{}: this is no checkpoint of this version of tectum; name the folder of a run that has one",
        path.display()
    )]
    Foreign {
        /// The file.
        path: PathBuf,
    },
    /// The state belongs to another role, scenario, schema or build.
    #[error(
        "{}: the checkpoint does not fit: its {what} is {theirs}, here it is {ours}; go on with the build, the \
         scenario and the run that wrote it",
        path.display()
    )]
    Mismatch {
        /// The file.
        path: PathBuf,
        /// The value that differs.
        what: &'static str,
        /// This process's value.
        ours: String,
        /// The checkpoint's value.
        theirs: String,
    },
    /// It holds the state of another agent than the run's.
    #[error("{}: what was learned there does not fit this learner: {what}; give it the settings under [learner] that \
             it was learned with", path.display())]
    OtherAgent {
        /// The file.
        path: PathBuf,
        /// The first row that does not fit.
        what: String,
    },
    /// There is no checkpoint to continue from.
    #[error("{}: {what}", folder.display())]
    None {
        /// The run's folder.
        folder: PathBuf,
        /// The cause and the remedy.
        what: String,
    },
}
