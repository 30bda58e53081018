//! Why a log cannot be replayed.

use std::path::PathBuf;

use crate::log::LogError;
use crate::scenario::{Rule, ScenarioError};

/// Why a log cannot be replayed. A log that can be, and says something else, is no error but a
/// [`Difference`](super::Difference).
#[derive(Debug, thiserror::Error)]
pub enum ReplayError {
    /// The log.
    #[error(transparent)]
    Log(#[from] LogError),
    /// The scenario in the log.
    #[error("the scenario in the log {} cannot be read: {error}; replay it with the build that wrote it ({build})", path.display())]
    Scenario {
        /// The log.
        path: PathBuf,
        /// What is wrong with it.
        error: Box<ScenarioError>,
        /// The build that wrote it.
        build: String,
    },
    /// Ticks were left out on purpose.
    #[error(
        "the log {} holds every {every}th tick only, and a replay needs all that was learned from; run the scenario again \
         with `every = 1` under [log]", path.display()
    )]
    Thinned {
        /// The log.
        path: PathBuf,
        /// Every how many ticks are in it.
        every: u64,
    },
    /// The logger lost samples.
    #[error(
        "the log {} states a gap on channel {channel}, {count} missing from sequence number {first} on; {until}, \
         and what was learned behind that{behind} cannot be told; run the scenario again in lockstep, where nothing is lost \
         while its logger lives, or on a machine with less to do", path.display()
    )]
    Lost {
        /// The log.
        path: PathBuf,
        /// The channel.
        channel: &'static str,
        /// Sequence number of the first missing sample.
        first: u64,
        /// How many are missing in a row.
        count: u64,
        /// How far it was replayed.
        until: String,
        /// The ticks that come behind.
        behind: String,
    },
    /// What comes before is not in it.
    #[error(
        "the log {} begins in the middle of what was learned, and what came before cannot be told from it; {remedy}",
        path.display()
    )]
    Middle {
        /// The log.
        path: PathBuf,
        /// What to do about it.
        remedy: &'static str,
    },
    /// The other learner cannot be given this experience.
    #[error("the learner {rule:?} cannot learn from the log {}: {error}", path.display())]
    Learner {
        /// The log.
        path: PathBuf,
        /// Its rule.
        rule: Rule,
        /// Why not.
        error: Box<ScenarioError>,
    },
}
