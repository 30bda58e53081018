//! The reader with whole, torn, damaged and foreign files.

use super::*;
use crate::log::header::tests::sample_header;
use crate::log::{LogClock, LogHeader, LogSummary, LogWriter};
use crate::wire::{Header, MAX_INPUTS, MAX_OUTPUTS};
use proptest::prelude::*;
use std::sync::LazyLock;

fn header_of(tick: u64) -> Header {
    Header { run: 0xabc, tick, sequence: tick, published_ns: tick * 50_000_000, ..Header::default() }
}

/// Nine ticks and a gap after the fifth.
fn messages() -> Vec<LogRecord> {
    let mut all = Vec::new();
    for tick in 0..9 {
        let header = header_of(tick);
        let x = tick as f32;
        all.push(LogRecord::Observation(Observation {
            header,
            inputs: [x; MAX_INPUTS],
            reward: -x,
            ..Observation::default()
        }));
        all.push(LogRecord::Command(Command { header, mean: [x; MAX_OUTPUTS], drawn: [-x; MAX_OUTPUTS] }));
        all.push(LogRecord::Learning(Learning {
            header,
            noise: [0.5; MAX_OUTPUTS],
            weights_hash: tick,
            ..Learning::default()
        }));
        if tick == 5 {
            all.push(LogRecord::Gap(Gap { channel: 2, first: 6, count: 1, total: 1 }));
        }
    }
    all
}

fn write(header: &LogHeader, finish: bool) -> (Vec<u8>, Option<LogSummary>) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("log.mcap");
    let mut log = LogWriter::create(&path, header).unwrap();
    for record in messages() {
        log.append(&record).unwrap();
    }
    let totals = LogTotals { last_tick: Some(8), complete: true, ..LogTotals::default() };
    let summary = finish.then(|| log.finish(&totals).unwrap());
    (std::fs::read(&path).unwrap(), summary)
}

static WHOLE: LazyLock<Vec<u8>> = LazyLock::new(|| write(&sample_header(), true).0);

fn open(bytes: &[u8]) -> Result<LogReader, LogError> {
    LogReader::over(Path::new("log.mcap"), Box::new(std::io::Cursor::new(bytes.to_vec())))
}

/// Reads to the end; returns the messages, whether the log was whole, and the error if there was one.
fn read(bytes: &[u8]) -> (Vec<LogRecord>, bool, Option<LogError>) {
    let mut log = match open(bytes) {
        Ok(log) => log,
        Err(e) => return (Vec::new(), false, Some(e)),
    };
    let mut records = Vec::new();
    let mut error = None;
    for record in &mut log {
        match record {
            Ok(record) => records.push(record),
            Err(e) => error = Some(e),
        }
    }
    assert!(log.next().is_none(), "an ended reader stays ended");
    (records, log.finished(), error)
}

#[test]
fn the_written_messages_are_read() {
    let (bytes, summary) = write(&sample_header(), true);
    let mut log = open(&bytes).unwrap();
    assert_eq!(log.scenario(), sample_header().scenario);
    assert_eq!((log.run("seed"), log.run("clock")), (Some("7"), Some("virtual")));
    assert_eq!((log.finished(), log.totals()), (false, None), "not known before the end");
    let records: Vec<_> = log.by_ref().map(Result::unwrap).collect();
    assert_eq!(records, messages());
    let summary = summary.unwrap();
    assert_eq!((log.finished(), log.totals()), (true, Some(summary.totals)));
    assert_eq!(summary.written, [9, 9, 9, 1]);
    assert_eq!(summary.bytes, bytes.len() as u64);
    assert_eq!(log.position() + mcap::MAGIC.len() as u64, bytes.len() as u64);
    assert_eq!(log.metadata()[TOTALS_METADATA]["command.written"], "9");
}

#[test]
fn a_dropped_log_is_readable_and_known_to_be_torn() {
    let (bytes, _) = write(&sample_header(), false);
    let (records, finished, error) = read(&bytes);
    assert_eq!((records, finished), (messages(), false));
    assert!(error.is_none());
}

#[test]
fn a_log_cut_at_any_byte_gives_a_prefix_of_its_messages() {
    let all = messages();
    let mut seen = 0;
    for length in 0..WHOLE.len() {
        let (records, finished, error) = read(&WHOLE[..length]);
        assert!(!finished, "{length}");
        assert_eq!(records, all[..records.len()], "{length}");
        assert!(records.len() >= seen, "{length}: a longer piece gives no less");
        seen = records.len();
        match error {
            None => {}
            Some(LogError::NotALog { why, .. }) => assert!(why.contains("ends") && seen == 0, "{length}: {why}"),
            Some(other) => panic!("{length}: {other}"),
        }
    }
    assert_eq!(seen, all.len());
}

#[test]
fn zeros_at_the_end_are_a_tear() {
    let (mut bytes, _) = write(&sample_header(), false);
    let whole = bytes.len() as u64;
    bytes.extend([0; 4096]);
    let mut log = open(&bytes).unwrap();
    assert_eq!(log.by_ref().map(Result::unwrap).count(), messages().len());
    assert_eq!((log.finished(), log.position()), (false, whole));
}

#[test]
fn foreign_files_are_refused() {
    let why = |bytes: &[u8]| match open(bytes) {
        Err(e @ LogError::NotALog { .. }) => e.to_string(),
        other => panic!("{:?}", other.map(|_| ()).err()),
    };
    assert!(why(b"").contains("log.mcap is not a log of this program: it is empty"));
    assert!(why(b"name = \"a scenario, not a log\"").contains("does not start like an MCAP file"));
    for chunks in [false, true] {
        let mut other = mcap::WriteOptions::new().use_chunks(chunks).create(std::io::Cursor::new(Vec::new())).unwrap();
        let channel = other.add_channel(0, "/other", "json", &BTreeMap::new()).unwrap();
        let header = mcap::records::MessageHeader { channel_id: channel, sequence: 0, log_time: 0, publish_time: 0 };
        other.write_to_known_channel(&header, b"{}").unwrap();
        other.finish().unwrap();
        let text = why(&other.into_inner().into_inner());
        assert!(text.contains("not one that describes a run"), "{text}");
    }
    let folder = tempfile::tempdir().unwrap();
    let folder = LogReader::open(folder.path()).err().unwrap().to_string();
    assert!(folder.contains("it is a folder"), "{folder}");
    let missing = LogReader::open(Path::new("/no/such/log.mcap")).err().unwrap().to_string();
    assert!(missing.contains("/no/such/log.mcap") && missing.contains("no such file"), "{missing}");
}

#[test]
fn another_layout_is_refused_by_name() {
    // The same length, so that only the version differs that the channel states.
    let from = Observation::NAME.as_bytes();
    let mut bytes = write(&sample_header(), false).0;
    let places: Vec<_> = (0..bytes.len() - from.len()).filter(|&i| bytes[i..].starts_with(from)).collect();
    for i in places {
        bytes[i + from.len() - 1] = b'9';
    }
    let error = open(&bytes).err().unwrap();
    assert!(matches!(error, LogError::Version { .. }));
    let text = error.to_string();
    for part in ["log.mcap", "tectum.Observation.v9 on /observation", "reads tectum.Observation.v2", "(test)"] {
        assert!(text.contains(part), "{part} in {text}");
    }
    // A definition that was changed without a new version.
    let mut bytes = write(&sample_header(), false).0;
    let at = bytes.windows(13).position(|w| w == b"weights_norm\n").unwrap();
    bytes[at..at + 7].copy_from_slice(b"heights");
    let text = open(&bytes).err().unwrap().to_string();
    assert!(text.contains("another definition of tectum.Learning.v2 on /learning"), "{text}");
}

#[test]
fn times_are_wall_times_and_lockstep_starts_at_zero() {
    let real = LogHeader { clock: LogClock::Monotonic, t0_ns: 1_000, wall_at_t0_ns: 5_000, ..sample_header() };
    for (header, first) in [(sample_header(), 0), (real, 4_000)] {
        let bytes = write(&header, true).0;
        let times: Vec<u64> = mcap::MessageStream::new(&bytes).unwrap().map(|m| m.unwrap().log_time).collect();
        assert_eq!(times[..4], [first, first, first, first + 50_000_000]);
        // The gap follows the learning record of tick 5.
        assert_eq!(times[18], times[17]);
    }
}

/// A tick that no run of this scenario has would let an analysis go through all ticks up to it.
#[test]
fn a_tick_beyond_the_run_is_damage() {
    for tick in [9, 1 << 62, u64::MAX] {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("log.mcap");
        let mut log = LogWriter::create(&path, &sample_header()).unwrap();
        for tick in [8, tick] {
            let header = Header { tick, ..header_of(8) };
            log.observation(&Observation { header, ..Observation::default() }).unwrap();
        }
        log.finish(&LogTotals::default()).unwrap();
        let (records, finished, error) = read(&std::fs::read(&path).unwrap());
        let error = error.unwrap().to_string();
        assert!(error.contains("beyond the last tick of its run"), "{error}");
        assert_eq!((records.len(), finished), (1, false));
    }
}

#[test]
fn equal_runs_write_equal_bytes() {
    assert_eq!(write(&sample_header(), true).0, *WHOLE);
}

proptest! {
    /// Checksums cover a whole finished log: every flipped bit is detected, and none makes the reader panic.
    #[test]
    fn a_flipped_bit_is_found(at in 0..WHOLE.len(), bit in 0..8u8) {
        let mut bytes = WHOLE.clone();
        bytes[at] ^= 1 << bit;
        let (_, finished, _) = read(&bytes);
        prop_assert!(!finished, "bit {bit} of byte {at}");
    }

    /// A torn log has no checksum, but damage must not cause a panic or an allocation as large as a length
    /// field states.
    #[test]
    fn damage_to_a_torn_log_never_panics(
        length in 0..WHOLE.len(),
        flips in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 0..20),
    ) {
        let mut bytes = WHOLE[..length].to_vec();
        for (at, value) in flips {
            if length > 0 {
                bytes[at.index(length)] = value;
            }
        }
        prop_assert!(!read(&bytes).1 || bytes == *WHOLE);
    }

    /// Bytes that only start like an MCAP file.
    #[test]
    fn random_bytes_never_panic(noise in prop::collection::vec(any::<u8>(), 0..2000)) {
        prop_assert!(!read(&noise).1);
        prop_assert!(!read(&[mcap::MAGIC, &noise[..]].concat()).1);
    }
}
