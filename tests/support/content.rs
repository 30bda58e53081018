//! A log that is read completely.

use std::path::Path;

use tectum::log::LogReader;
pub use tectum_testkit::LogContent;

/// Reads a log of one file to its end.
pub fn read_log(path: &Path) -> (LogReader, LogContent) {
    let mut reader = LogReader::open(path).unwrap();
    let content = LogContent::of(&mut reader).unwrap();
    (reader, content)
}
