//! A program that takes the place of a process which runs on another machine.
//!
//! The launcher starts it, watches it and restarts it like the process whose place it takes. It waits for the other
//! machine, so that the launcher sets no limit to how long the run takes to set up.

use std::path::{Path, PathBuf};

use crate::wire::Role;

/// The program that takes the place of a process which runs on another machine.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct StandIn {
    /// The process whose place it takes.
    pub role: Role,
    /// The program. It is started with its arguments, and then with `--run FOLDER`.
    pub program: PathBuf,
    /// Its arguments.
    pub arguments: Vec<String>,
}

impl StandIn {
    /// The file in the run's folder in which the one that takes the plant's place leaves the start of tick 0: in real
    /// time the other machine decides it.
    pub fn start_path(folder: &Path) -> PathBuf {
        folder.join("link.start")
    }

    /// The start of tick 0 on this machine's clock, ns, where the other machine has decided it.
    pub(super) fn start_ns(&self, folder: &Path) -> Option<u64> {
        if self.role != Role::Plant {
            return None;
        }
        std::fs::read_to_string(Self::start_path(folder)).ok()?.trim().parse().ok()
    }
}
