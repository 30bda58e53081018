//! The paper's experiments, run again: the closed-loop arm of its figure 4, the saccades of its figure 2, the
//! open-loop arm that it mentions without results, and its outlook.
//!
//! Every experiment runs one or more built-in scenarios with several seeds. The results are shown as in the
//! paper, and with the spread over seeds, which the paper does not show. `experiment.rs` has what all
//! experiments share.

mod arm;
mod experiment;
mod eye;
mod open_loop;
mod outlook;
mod trial_windows;

pub use arm::{ArmResult, arm};
pub use eye::{EyeResult, eye};
pub use open_loop::{OpenLoopResult, open_loop};
pub use outlook::{OutlookResult, outlook};

pub(super) use experiment::seeds_in_words;

use std::path::PathBuf;

use super::{SeedRange, StudyError, StudyHead, StudyPlace};

/// The size of an experiment, and where its files go.
#[derive(Debug, Clone)]
pub struct ReproduceSettings {
    /// The seeds.
    pub seeds: SeedRange,
    /// Ticks (or trials) of each run; `None` for the paper's number.
    pub ticks: Option<u64>,
    /// Folder for the files; `None` for `runs/<experiment>-<n>`.
    pub out: Option<PathBuf>,
    /// Where the runs are kept.
    pub place: StudyPlace,
    /// Show a progress line on standard error, if that is a terminal.
    pub progress: bool,
}

impl ReproduceSettings {
    /// The settings of the experiment whose rows have the first line `head`.
    ///
    /// # Errors
    /// When the line cannot be read.
    pub fn of_head(head: &StudyHead, place: StudyPlace) -> Result<Self, StudyError> {
        let ticks = match head.definition.get("ticks") {
            Some(ticks) if ticks.is_null() => None,
            Some(ticks) if ticks.is_u64() => ticks.as_u64(),
            _ => return Err(StudyError::Asked("the study's first line does not say its ticks".to_owned())),
        };
        Ok(Self { seeds: head.seeds, ticks, out: None, place, progress: true })
    }
}
