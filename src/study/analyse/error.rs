//! Why a log's movements cannot be analysed.

use std::path::PathBuf;

use crate::log::LogError;
use crate::report::ReportError;
use crate::scenario::ScenarioError;

/// Why a log's movements cannot be analysed.
#[derive(Debug, thiserror::Error)]
pub enum AnalyseError {
    /// The log cannot be read.
    #[error(transparent)]
    Log(#[from] LogError),
    /// The scenario in the log is invalid for this build.
    #[error("the scenario in the log {} cannot be read: {error}; read it with the build that wrote it", path.display())]
    Scenario {
        /// The log.
        path: PathBuf,
        /// Why it is invalid.
        error: Box<ScenarioError>,
    },
    /// The log was written with `every` above 1.
    #[error(
        "the log {} holds every {every}th tick only, and a movement is made of all of them; run the scenario \
         again with `every = 1` under [log]", path.display()
    )]
    Thinned {
        /// The log.
        path: PathBuf,
        /// The log holds one tick in this many.
        every: u64,
    },
    /// The plant does not measure error and end-effector.
    #[error(
        "the plant of scenario \"{scenario}\" does not measure `{missing}` ({found} only), and movements are made of \
         error, end_x and end_y; a plant of your own can report them, named under [plant] measures"
    )]
    NoMeasures {
        /// The scenario's name.
        scenario: String,
        /// The measures that are missing.
        missing: String,
        /// The needed measures that exist.
        found: String,
    },
    /// The log holds no complete movement.
    #[error(
        "the log {} holds no whole movement, from one target's appearance to the next ({why}); make a longer run",
        path.display()
    )]
    NoMovement {
        /// The log.
        path: PathBuf,
        /// What the log holds instead.
        why: String,
    },
    /// The figure cannot be drawn or written.
    #[error(transparent)]
    Figure(#[from] ReportError),
    /// A result cannot be written.
    #[error("{} cannot be written: {error}; choose another --out", path.display())]
    Write {
        /// The file or folder.
        path: PathBuf,
        /// The operating system's error.
        error: std::io::Error,
    },
}
