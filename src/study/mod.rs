//! Studies: many runs in one process, side by side on all cores, and what they say together.
//!
//! A study has no transport and no log: it is [`in_process`](crate::runtime::in_process) over seeds and settings, and its
//! numbers are those of lockstep. Each study stands in a file (or folder) of its own and gives one plain result, which is
//! the object of `--json`, the rows of a CSV and the matter of a figure.

pub mod analyse;
pub mod compare;
mod error;
pub mod replay;
pub mod reproduce;
mod spread;
mod worker_pool;

pub use crate::reference;
pub use error::StudyError;
pub use spread::Spread;
pub use worker_pool::{ChildProcesses, JobProgress};
