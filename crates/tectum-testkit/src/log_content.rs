//! A log that is read completely.

use std::path::Path;

use tectum::log::{LogError, LogReader, LogRecord, RunLog, find};
use tectum::wire::{Command, Gap, Learning, Observation};

/// All samples of a log, in the order of the file.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct LogContent {
    /// From the plant.
    pub observations: Vec<Observation>,
    /// From the controller.
    pub commands: Vec<Command>,
    /// From the controller's learner.
    pub learnings: Vec<Learning>,
    /// Where samples are missing.
    pub gaps: Vec<Gap>,
    /// Tick and channel (observation 0, command 1, learning 2) of every sample except gaps, in the order of the file.
    pub order: Vec<(u64, u8)>,
}

impl LogContent {
    /// Reads the log at `path`: one file, or all segments of the run in a folder.
    ///
    /// # Errors
    ///
    /// As [`RunLog::open`], and for the first record that makes no sense. A log without an end is no error.
    pub fn read(path: impl AsRef<Path>) -> Result<Self, LogError> {
        Self::of(&mut RunLog::open(&find(path.as_ref())?)?)
    }

    /// The samples that are left in a log.
    ///
    /// # Errors
    ///
    /// For the first record that makes no sense.
    pub fn of(log: &mut impl Iterator<Item = Result<LogRecord, LogError>>) -> Result<Self, LogError> {
        let mut content = Self::default();
        for record in log {
            let record = record?;
            let channel = match record {
                LogRecord::Observation(sample) => {
                    content.observations.push(sample);
                    0
                }
                LogRecord::Command(sample) => {
                    content.commands.push(sample);
                    1
                }
                LogRecord::Learning(sample) => {
                    content.learnings.push(sample);
                    2
                }
                LogRecord::Gap(gap) => {
                    content.gaps.push(gap);
                    continue;
                }
            };
            content.order.extend(record.header().map(|header| (header.tick, channel)));
        }
        Ok(content)
    }
}

/// The newest tick in a log that may still be written; `None` without any.
pub(crate) fn newest_tick(log: &Path) -> Option<u64> {
    let log = LogReader::open(log).ok()?;
    log.map_while(Result::ok).filter_map(|record| Some(record.header()?.tick)).max()
}
