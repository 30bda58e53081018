//! Studies: experiments of many runs in one process, and the analysis and replay of a run's log.
//!
//! A study uses no transport and writes no log. Its runs are [`in_process`](crate::runtime::in_process) runs
//! over seeds and settings, one per core at a time, and give the same numbers as lockstep. Each study has its
//! own file or folder and returns one plain result. `--json` prints this result as an object; the CSV files
//! and the figure show it.

pub mod analyse;
pub mod compare;
mod error;
pub mod film;
pub mod replay;
pub mod reproduce;
pub mod tasks;
mod text;
mod worker_pool;

pub use error::StudyError;
pub(crate) use worker_pool::{JobProgress, WorkerPool};
