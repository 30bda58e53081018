//! Any bytes either open as a log or give an error with a message, in every function that reads logs. Repairing
//! a log that was cut off gives a complete log with the same messages.

#![no_main]

use std::io::{Cursor, Read};
use std::path::Path;

use libfuzzer_sys::fuzz_target;
use tectum::log::{CsvChannel, LogError, LogInfo, LogReader, LogRecord, RunLog, csv, mend};
use tectum::study::replay;

fn open(bytes: &[u8]) -> Result<LogReader, LogError> {
    LogReader::over(Path::new("log.mcap"), source(bytes))
}

fn source(bytes: &[u8]) -> Box<dyn Read + Send> {
    Box::new(Cursor::new(bytes.to_vec()))
}

/// The messages up to the end or the first error, and the error. Messages are compared as text, because NaN is
/// not equal to itself.
fn messages(log: &mut LogReader) -> (Vec<String>, Option<LogError>) {
    let mut all = Vec::new();
    for record in log {
        match record {
            Ok(LogRecord::Observation(s)) => all.push(as_text(&s)),
            Ok(LogRecord::Command(s)) => all.push(as_text(&s)),
            Ok(LogRecord::Learning(s)) => all.push(as_text(&s)),
            Ok(LogRecord::Gap(s)) => all.push(as_text(&s)),
            Err(error) => return (all, Some(error)),
        }
    }
    (all, None)
}

fn as_text<T: Copy + std::fmt::Debug>(sample: &T) -> String {
    format!("{sample:?}")
}

fuzz_target!(|bytes: &[u8]| {
    let Ok(mut log) = open(bytes) else { return };
    let (all, error) = messages(&mut log);
    if let Ok(info) = open(bytes).and_then(|log| LogInfo::over(RunLog::of(log))) {
        assert!(!info.to_text().is_empty() && !info.to_json().is_empty());
    }
    for channel in [CsvChannel::Observation, CsvChannel::Command, CsvChannel::Learning, CsvChannel::Gap] {
        if let Ok(log) = open(bytes) {
            csv(&mut RunLog::of(log), channel, &mut std::io::sink()).expect("a sink accepts all bytes").ok();
        }
    }
    let mut repaired = Cursor::new(Vec::new());
    match mend(Path::new("log.mcap"), || Ok(source(bytes)), &mut repaired) {
        Ok(Some(_)) => {
            assert!(error.is_none());
            let mut reader = open(repaired.get_ref()).expect("a repaired log opens");
            let (after, error) = messages(&mut reader);
            assert!(error.is_none() && after == all);
            assert!(reader.finished());
        }
        Ok(None) => assert!(log.finished()),
        Err(error) => assert!(!error.to_string().is_empty()),
    }
    if let Ok(log) = open(bytes) {
        match replay::over(RunLog::of(log), None, false) {
            Ok(result) => assert!(!result.to_text().is_empty()),
            Err(error) => assert!(!error.to_string().is_empty()),
        }
    }
});
