//! A log that is read completely.

use std::path::Path;

use tectum::log::{LogReader, LogRecord};
use tectum::wire::{Command, Gap, Learning, Observation};

/// All samples of a log.
#[derive(Default)]
pub struct LogContent {
    pub observations: Vec<Observation>,
    pub commands: Vec<Command>,
    pub learnings: Vec<Learning>,
    pub gaps: Vec<Gap>,
    /// Tick and channel of every sample except gaps, in the order of the file.
    pub order: Vec<(u64, u8)>,
}

/// Reads a log to its end.
pub fn read_log(path: &Path) -> (LogReader, LogContent) {
    let mut reader = LogReader::open(path).unwrap();
    let mut content = LogContent::default();
    for record in reader.by_ref() {
        match record.unwrap() {
            LogRecord::Observation(s) => {
                content.order.push((s.header.tick, 0));
                content.observations.push(s);
            }
            LogRecord::Command(s) => {
                content.order.push((s.header.tick, 1));
                content.commands.push(s);
            }
            LogRecord::Learning(s) => {
                content.order.push((s.header.tick, 2));
                content.learnings.push(s);
            }
            LogRecord::Gap(s) => content.gaps.push(s),
        }
    }
    (reader, content)
}
