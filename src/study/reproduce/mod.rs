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

use std::path::PathBuf;

/// The size of an experiment, and where its files go.
#[derive(Debug, Clone)]
pub struct ReproduceSettings {
    /// Number of seeds.
    pub seeds: u64,
    /// The first seed; the others follow.
    pub first_seed: u64,
    /// Ticks (or trials) of each run; `None` for the paper's number.
    pub ticks: Option<u64>,
    /// Folder for the files; `None` for `runs/<experiment>-<n>`.
    pub out: Option<PathBuf>,
    /// Show a progress line on standard error, if that is a terminal.
    pub progress: bool,
}
