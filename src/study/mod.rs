//! Studies: experiments of many runs in one process, and the analysis and replay of a run's log.
//!
//! A study uses no transport and writes no log. Its runs are [`in_process`](crate::runtime::in_process) runs
//! over seeds and settings, one per core at a time, and give the same numbers as lockstep. Each study has its
//! own file or folder and returns one plain result. `--json` prints this result as an object; the CSV files
//! and the figure show it.

pub mod analyse;
pub mod compare;
mod error;
mod exact;
pub mod film;
mod merge;
mod opened_study;
pub mod replay;
pub mod report_page;
pub mod reproduce;
mod study_rows;
mod subject;
pub mod sweep;
pub mod tasks;
mod text;
mod verify;
mod worker_pool;

pub use error::StudyError;
pub use merge::{MergedStudy, continue_study, merge};
pub use study_rows::{SeedRange, StudyEnd, StudyHead, StudyPart, StudyPlace};
pub use verify::{RunDifference, Verification, verify};
pub(crate) use worker_pool::{JobProgress, KeptJob, WorkerPool};
