//! Why a project cannot be made.

use std::io;
use std::path::PathBuf;

use thiserror::Error;

/// Why a project cannot be made.
#[derive(Debug, Error)]
pub enum NewProjectError {
    /// The name cannot be that of a package.
    #[error("{name:?} cannot be the name of a project: {why}")]
    Name {
        /// The name.
        name: String,
        /// What is wrong with it, and what is right.
        why: String,
    },
    /// There is something of this name already.
    #[error("{} exists already; give another name, or move it away", .path.display())]
    Exists {
        /// The project's folder.
        path: PathBuf,
    },
    /// A file cannot be written.
    #[error("{} cannot be written: {source}", .path.display())]
    Write {
        /// The file or folder.
        path: PathBuf,
        /// The cause.
        source: io::Error,
    },
}
