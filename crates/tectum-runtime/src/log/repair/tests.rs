//! Repairs of logs that are cut at any byte, damaged, or filled up with zeros.

use super::*;
use crate::log::header::tests::sample_header;
use crate::log::{ENCAPSULATION, LogHeader, LogInfo, LogRecord, LogState, LogWriter, RunLog};
use crate::wire::{Command, Gap, Learning, Observation};
use proptest::prelude::*;
use std::io::Cursor;
use std::sync::LazyLock;

/// Twelve ticks of which every third is written, a gap, and the log's end.
static WHOLE: LazyLock<Vec<u8>> = LazyLock::new(|| {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("log.mcap");
    let mut log = LogWriter::create(&path, &LogHeader { every: 3, ticks: 12, ..sample_header() }).unwrap();
    for tick in (0..12).step_by(3) {
        let (mut o, mut c, mut l) = (Observation::default(), Command::default(), Learning::default());
        for header in [&mut o.header, &mut c.header, &mut l.header] {
            (header.tick, header.sequence, header.published_ns) = (tick, tick, tick * 50_000_000);
        }
        log.observation(&o).unwrap();
        if tick == 9 {
            log.gap(&Gap { channel: 1, first: 7, count: 1, total: 1 }).unwrap();
        }
        log.command(&c).unwrap();
        log.learning(&l).unwrap();
    }
    let totals =
        LogTotals { lost: [0, 1, 0], thinned: [8, 7, 8], last_tick: Some(11), complete: true, ..LogTotals::default() };
    log.finish(&totals).unwrap();
    std::fs::read(&path).unwrap()
});

/// Offsets at which the records begin.
fn records() -> impl Iterator<Item = usize> {
    let next = |&at: &usize| Some(at + 9 + u64::from_le_bytes(WHOLE.get(at + 1..at + 9)?.try_into().ok()?) as usize);
    std::iter::successors(Some(mcap::MAGIC.len()), next).take_while(|at| at + mcap::MAGIC.len() < WHOLE.len())
}

fn open(bytes: &[u8]) -> Box<dyn Read + Send> {
    Box::new(Cursor::new(bytes.to_vec()))
}

/// The repaired log; `None` if it was whole.
fn mended(bytes: &[u8]) -> Result<Option<(TornContents, Vec<u8>)>, LogError> {
    let mut sink = Cursor::new(Vec::new());
    let mended = mend(Path::new("log.mcap"), || Ok(open(bytes)), &mut sink)?;
    Ok(mended.map(|mended| (mended, sink.into_inner())))
}

/// The messages, and the reader at its end.
fn read(bytes: &[u8]) -> (Vec<LogRecord>, LogReader) {
    let mut log = LogReader::over(Path::new("log.mcap"), open(bytes)).unwrap();
    (log.by_ref().map(Result::unwrap).collect(), log)
}

fn check_cut(length: usize) {
    let torn = &WHOLE[..length];
    let Ok(done) = mended(torn) else {
        // Cut off inside its description: not yet a log.
        assert!(LogReader::over(Path::new("log.mcap"), open(torn)).is_err(), "{length}");
        return;
    };
    let (done, whole) = done.expect("a shorter log is torn");
    let ((before, reader), (after, log)) = (read(torn), read(&whole));
    assert_eq!(before, after, "{length}");
    assert_eq!((done.torn_at, done.torn_at + done.left_out), (reader.position(), length as u64), "{length}");
    assert!((log.finished(), log.repaired()) == (true, true), "{length}");
    let totals = &log.metadata()[TOTALS_METADATA];
    let by = |key: &str| log.metadata()[REPAIR_METADATA][key].clone();
    assert_eq!(by("torn_at"), done.torn_at.to_string());
    if by("totals") == "logger" {
        assert_eq!(log.totals().map(|totals| totals.complete), Some(true), "{length}");
    } else {
        assert_eq!((totals["repaired"].as_str(), totals["complete"].as_str()), ("true", "false"), "{length}");
        // Existing records are unchanged, byte for byte.
        assert_eq!(whole[..done.torn_at as usize], torn[..done.torn_at as usize], "{length}");
    }
    let log = LogReader::over(Path::new("log.mcap"), open(&whole)).unwrap();
    let info = LogInfo::over(RunLog::of(log)).unwrap();
    assert!(info.agrees() && info.state == LogState::Repaired, "{length}: {info:?}");
    // Other readers begin with the summary.
    let summary = mcap::Summary::read(&whole).unwrap().unwrap();
    assert_eq!(summary.stats.unwrap().message_count, after.len() as u64, "{length}");
    assert_eq!(mcap::MessageStream::new(&whole).unwrap().map(Result::unwrap).count(), after.len(), "{length}");
    assert!(mended(&whole).unwrap().is_none(), "{length}: a repaired log is whole");
}

#[test]
fn a_log_cut_at_the_ends_of_records_is_repaired() {
    for at in records() {
        [at - 1, at, at + 1, at + 9].into_iter().filter(|&length| length < WHOLE.len()).for_each(check_cut);
    }
    assert!(mended(&WHOLE).unwrap().is_none());
}

#[test]
fn a_damaged_log_is_refused() {
    // The learning record of tick 6, and within it the byte after its sequence number, where its instants begin.
    let end = records().filter(|&at| WHOLE[at] == crate::log::parse::op::MESSAGE).nth(3 + 3 + 2).unwrap();
    let at = end + 9 + 22 + ENCAPSULATION.len() + 24;
    let mut bytes = WHOLE.clone();
    bytes[at] ^= 1;
    assert!(matches!(mended(&bytes), Err(LogError::Damaged { .. })));
    // Zeros followed by other bytes are damage, however they are read.
    for n in 9..200 {
        let mut bytes = WHOLE.clone();
        bytes[end..end + n].fill(0);
        let text = mended(&bytes).unwrap_err().to_string();
        assert!(text.contains(&format!("damaged at byte {end}: ")), "{n}: {text}");
    }
    // Cut off inside the record, after its length field.
    let zeros = [&WHOLE[..end + 30], &[0; 5000]].concat();
    assert!(matches!(mended(&zeros), Err(LogError::Damaged { .. })), "a record that zeros fill up");
    let (done, _) = mended(&[&WHOLE[..end], &[0; 5000]].concat()).unwrap().unwrap();
    assert_eq!((done.torn_at, done.left_out), (end as u64, 5000));
}

proptest! {
    #[test]
    fn a_log_cut_at_any_byte_is_repaired(length in 0..WHOLE.len()) {
        check_cut(length);
    }

    /// For any bytes, the result is a whole log or an error.
    #[test]
    fn random_damage_never_panics(
        length in 0..=WHOLE.len(),
        flips in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 0..8),
    ) {
        let mut bytes = WHOLE[..length].to_vec();
        for (at, value) in flips {
            if length > 0 {
                bytes[at.index(length)] = value;
            }
        }
        if let Ok(Some((_, whole))) = mended(&bytes) {
            prop_assert!(read(&whole).1.finished());
        }
    }
}

/// The end magic twice, zeros up to a block's end, half another log: all is cut off, and nothing else is changed.
#[test]
fn what_stands_behind_the_end_is_cut_off() {
    for behind in [mcap::MAGIC, &[0; 3000], &WHOLE[..WHOLE.len() / 2], &[1]] {
        let bytes = [&WHOLE[..], behind].concat();
        let mut log = LogReader::over(Path::new("log.mcap"), open(&bytes)).unwrap();
        let error = log.find_map(Result::err).unwrap();
        assert!(matches!(error, LogError::BehindEnd { end, .. } if end == WHOLE.len() as u64), "{error}");
        assert!(error.to_string().contains("`tectum log repair` cuts them off"), "{error}");
        let (done, whole) = mended(&bytes).unwrap().unwrap();
        assert_eq!((done.torn_at, done.left_out, done.whole), (WHOLE.len() as u64, behind.len() as u64, true));
        assert!(whole == *WHOLE);
    }
}
