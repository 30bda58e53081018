//! Any bytes are a log or an error that says something, for everything that reads logs; and what is torn becomes whole with
//! the same messages.

#![no_main]

use std::io::{Cursor, Read};
use std::path::Path;

use libfuzzer_sys::fuzz_target;
use tectum::log::{CsvChannel, LogInfo, LogError, LogReader, LogRecord, RunLog, csv, mend};
use tectum::study::replay;

fn open(bytes: &[u8]) -> Result<LogReader, LogError> {
    LogReader::over(Path::new("log.mcap"), source(bytes))
}

fn source(bytes: &[u8]) -> Box<dyn Read + Send> {
    Box::new(Cursor::new(bytes.to_vec()))
}

/// The messages up to the end or the first error, as bytes: not-a-numbers are not equal to themselves.
fn messages(log: &mut LogReader) -> (Vec<Vec<u8>>, Option<LogError>) {
    let mut all = Vec::new();
    for record in log {
        match record {
            Ok(LogRecord::Observation(s)) => all.push(bytes(&s)),
            Ok(LogRecord::Command(s)) => all.push(bytes(&s)),
            Ok(LogRecord::Learning(s)) => all.push(bytes(&s)),
            Ok(LogRecord::Gap(s)) => all.push(bytes(&s)),
            Err(error) => return (all, Some(error)),
        }
    }
    (all, None)
}

fn bytes<T: Copy + std::fmt::Debug>(sample: &T) -> Vec<u8> {
    format!("{sample:?}").into_bytes()
}

fuzz_target!(|bytes: &[u8]| {
    let Ok(mut log) = open(bytes) else { return };
    let (all, error) = messages(&mut log);
    if let Ok(info) = open(bytes).and_then(|log| LogInfo::over(RunLog::of(log))) {
        assert!(!info.to_text().is_empty() && !info.to_json().is_empty());
    }
    for channel in [CsvChannel::Observation, CsvChannel::Command, CsvChannel::Learning, CsvChannel::Gap] {
        if let Ok(log) = open(bytes) {
            csv(&mut RunLog::of(log), channel, &mut std::io::sink()).expect("a sink takes everything").ok();
        }
    }
    let mut whole = Cursor::new(Vec::new());
    match mend(Path::new("log.mcap"), || Ok(source(bytes)), &mut whole) {
        Ok(Some(_)) => {
            assert!(error.is_none());
            let mut mended = open(whole.get_ref()).expect("a mended log opens");
            let (after, error) = messages(&mut mended);
            assert!(error.is_none() && after == all);
            assert!(mended.finished());
        }
        Ok(None) => assert!(log.finished()),
        Err(error) => assert!(!error.to_string().is_empty()),
    }
    if let Ok(log) = open(bytes) {
        match replay::over(RunLog::of(log), None, false) {
            Ok(done) => assert!(!done.to_text().is_empty()),
            Err(error) => assert!(!error.to_string().is_empty()),
        }
    }
});
