//! Why a log's movements cannot be analysed.

use std::path::PathBuf;

use crate::log::LogError;
use crate::report::ReportError;
use crate::scenario::ScenarioError;

/// Why a log's movements cannot be analysed.
#[derive(Debug, thiserror::Error)]
pub enum AnalyseError {
    /// The log.
    #[error(transparent)]
    Log(#[from] LogError),
    /// The scenario in the log.
    #[error("the scenario in the log {} cannot be read: {error}; read it with the build that wrote it", path.display())]
    Scenario {
        /// The log.
        path: PathBuf,
        /// What is wrong with it.
        error: Box<ScenarioError>,
    },
    /// Ticks were left out on purpose.
    #[error(
        "the log {} holds every {every}th tick only, and a movement is made of all of them; run the scenario again with \
         `every = 1` under [log]", path.display()
    )]
    Thinned {
        /// The log.
        path: PathBuf,
        /// Every how many ticks are in it.
        every: u64,
    },
    /// The plant does not measure where its end-effector is.
    #[error(
        "the plant of scenario \"{scenario}\" does not measure `{missing}` ({found} only), and movements are made of error, end_x \
         and end_y; a plant of your own can report them, named under [plant] measures"
    )]
    NoMeasures {
        /// The scenario's name.
        scenario: String,
        /// The measures that are missing.
        missing: String,
        /// Those of the needed ones that are there.
        found: String,
    },
    /// Nothing is left to analyse.
    #[error(
        "the log {} holds no whole movement, from one target's appearance to the next ({why}); make a longer run",
        path.display()
    )]
    NoMovement {
        /// The log.
        path: PathBuf,
        /// What there is instead.
        why: String,
    },
    /// The figure.
    #[error(transparent)]
    Figure(#[from] ReportError),
    /// A result cannot be written.
    #[error("{} cannot be written: {error}; choose another --out", path.display())]
    Write {
        /// The file or folder.
        path: PathBuf,
        /// What the operating system said.
        error: std::io::Error,
    },
}
