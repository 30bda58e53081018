//! Loggers that come and go, in front of real files: what was written stays, and what is missing is stated.

use std::collections::VecDeque;
use std::convert::Infallible;
use std::path::Path;

use super::*;
use crate::log::{LogClock, LogHeader, LogInfo, LogSegment, MessageCounts, RunLog, find, segment_path};
use crate::scenario::Scenario;
use crate::wire::{Command, Learning, Observation, flag};
use proptest::prelude::*;

const PERIOD: u64 = 1_000_000;

/// A lane that received `last` last and still holds it, or not.
fn lane(channel: u64, last: Option<u64>, held: bool) -> MergeInput {
    let head = last.filter(|_| held).map(|tick| sample(channel as usize, tick));
    MergeInput { channel, head, last, through: last, ..MergeInput::default() }
}

/// The sample of `tick` on a channel; sequence numbers are ticks.
fn sample(channel: usize, tick: u64) -> LogRecord {
    let header = Header {
        tick,
        sequence: tick,
        scheduled_ns: tick * PERIOD,
        sensed_ns: tick * PERIOD + 1000 + tick % 7 * 100,
        published_ns: tick * PERIOD + 2000 + tick % 5 * 300 + channel as u64 * 5000,
        flags: if channel == 0 && tick == 0 { flag::FIRST } else { 0 },
        ..Header::default()
    };
    match channel {
        0 => LogRecord::Observation(Observation { header, ..Observation::default() }),
        1 => LogRecord::Command(Command { header, ..Command::default() }),
        _ => LogRecord::Learning(Learning { header, ..Learning::default() }),
    }
}

#[test]
fn a_sample_waits_for_those_that_belong_before_it() {
    let lanes = |a, b, c| [a, b, c];
    // The command of tick 5 is there, its observation is not yet.
    let early = lanes(lane(0, Some(4), false), lane(1, Some(5), true), lane(2, Some(4), false));
    assert_eq!(first(&early), Some(NextHead { tick: 5, lane: 1, settled: false }));
    // With the observation there, that one comes first, and nothing of tick 4 is missing.
    let both = lanes(lane(0, Some(5), true), lane(1, Some(5), true), lane(2, Some(5), true));
    assert_eq!(first(&both), Some(NextHead { tick: 5, lane: 0, settled: true }));
    // Observation and command of tick 5 are written; the next observation may be a while.
    let last = lanes(lane(0, Some(5), false), lane(1, Some(5), false), lane(2, Some(5), true));
    assert_eq!(first(&last), Some(NextHead { tick: 5, lane: 2, settled: true }));
    // At the start nothing is known of the others.
    let start = lanes(lane(0, Some(0), true), lane(1, None, false), lane(2, None, false));
    assert_eq!(first(&start), Some(NextHead { tick: 0, lane: 0, settled: false }));
    assert_eq!(first(&[0, 1, 2].map(|i| lane(i, None, false))), None);
}

#[test]
fn gaps_are_counted_once_and_added_up() {
    let mut lane = MergeInput { channel: 2, ..MergeInput::default() };
    assert_eq!(lane.gap_until(0), None);
    lane.expected = 4;
    assert_eq!(lane.gap_until(7), Some(Gap { channel: 2, first: 4, count: 3, total: 3 }));
    assert_eq!(lane.gap_until(7), None);
    assert_eq!(lane.gap_until(8), Some(Gap { channel: 2, first: 7, count: 1, total: 4 }));
    // What was had does not take it back.
    let LogRecord::Learning(old) = sample(2, 5) else { unreachable!() };
    assert_eq!(lane.accept(&old.header, &LogRecord::Learning(old)), None);
    assert_eq!((lane.expected, lane.duplicates, lane.head.is_none()), (8, 1, true));
}

fn header(number: u32, every: u64, past: &LogRecovery) -> LogHeader {
    let plan = Scenario::find("paper").unwrap().plan().unwrap();
    LogHeader {
        every,
        period_ns: PERIOD,
        clock: LogClock::Monotonic,
        segment: LogSegment { number, ..past.segment },
        ..LogHeader::new(&plan, 5, "realtime", Default::default())
    }
}

/// The logger that is started for the `number`-th time.
fn logger(folder: &Path, number: u32, every: u64) -> LogMerger {
    let past = LogRecovery::none(PERIOD, [FIRST; 3], FIRST).with(folder, || ());
    let log = LogWriter::create(&segment_path(folder, number), &header(number, every, &past));
    LogMerger::new(log, &past, every, true)
}

/// Everything that waits on the channels, as the loop drains it; all that waits is known to be all.
fn drain(merge: &mut LogMerger, waiting: &mut [VecDeque<LogRecord>; 3], known: u64) {
    loop {
        for (i, waiting) in waiting.iter_mut().enumerate() {
            let Ok(()) = merge.fill(i, known, || Ok::<_, Infallible>(waiting.pop_front()));
        }
        if !merge.write_first(false) {
            break;
        }
    }
    merge.flush();
}

/// What happens at a tick.
#[derive(Debug, Clone, Copy)]
enum MergeEvent {
    /// The sample of one channel does not reach the logger.
    Lost(usize),
    /// The sample of one channel comes twice.
    Twice(usize),
    /// The logger looks at its channels.
    Drains,
    /// It is killed; the next comes back after so many ticks, and its predecessor's file may have lost so many bytes.
    Dies(u64, u64),
}

fn happens() -> impl Strategy<Value = MergeEvent> {
    prop_oneof![
        2 => (0..3_usize).prop_map(MergeEvent::Lost),
        2 => (0..3_usize).prop_map(MergeEvent::Twice),
        4 => Just(MergeEvent::Drains),
        1 => (0..9_u64, 0..700_u64).prop_map(|(ticks, bytes)| MergeEvent::Dies(ticks, bytes)),
    ]
}

/// The run's ticks: it goes on with another one.
const FIRST: u64 = 7;
const TICKS: u64 = 120;

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    /// Whatever happens, the segments together say what they lack, tick by tick in order, and totals and histograms are
    /// those of the run.
    #[test]
    fn segments_together_say_what_they_lack(
        events in prop::collection::btree_map(FIRST..TICKS, happens(), 0..30),
        every in prop_oneof![3 => Just(1_u64), 1 => Just(3)],
    ) {
        let folder = tempfile::tempdir().unwrap();
        let mut waiting: [VecDeque<LogRecord>; 3] = Default::default();
        let (mut number, mut away, mut killed, mut twice) = (0, 0, false, [0; 3]);
        let mut merge = Some(logger(folder.path(), 0, every));
        for tick in FIRST..TICKS {
            let event = events.get(&tick).copied();
            if merge.is_none() {
                if away > 0 {
                    away -= 1;
                    // Nobody is there to receive.
                    continue;
                }
                number += 1;
                merge = Some(logger(folder.path(), number, every));
            }
            for (i, waiting) in waiting.iter_mut().enumerate() {
                match event {
                    Some(MergeEvent::Lost(lost)) if lost == i => continue,
                    Some(MergeEvent::Twice(again)) if again == i => {
                        waiting.push_back(sample(i, tick));
                        twice[i] += 1;
                    }
                    _ => {}
                }
                waiting.push_back(sample(i, tick));
            }
            match event {
                Some(MergeEvent::Drains) => drain(merge.as_mut().unwrap(), &mut waiting, tick + 1),
                Some(MergeEvent::Dies(ticks, bytes)) => {
                    let path = segment_path(folder.path(), number);
                    let flushed = std::fs::metadata(&path).unwrap().len();
                    drop(merge.take());
                    // At most what was not flushed, and then a piece of what was, as after a loss of power.
                    let file = std::fs::File::options().write(true).open(&path).unwrap();
                    file.set_len(flushed.saturating_sub(bytes)).unwrap();
                    waiting.iter_mut().for_each(VecDeque::clear);
                    (killed, away) = (true, ticks);
                }
                _ => {}
            }
        }
        let mut merge = merge.unwrap_or_else(|| logger(folder.path(), number + 1, every));
        drain(&mut merge, &mut waiting, TICKS);
        let closed = merge.close([TICKS; 3], true);
        prop_assert_eq!(closed.failure, None);

        let segments = find(folder.path()).unwrap();
        let mut log = RunLog::open(&segments).unwrap();
        let mut counts: MessageCounts = log.message_counts();
        let mut order = Vec::new();
        for record in log.by_ref() {
            let record = record.unwrap();
            counts.take(&record);
            order.extend(record.header().map(|header| header.tick));
        }
        prop_assert!(log.finished());
        prop_assert!(order.is_sorted(), "{:?}", order);
        let totals = log.totals().unwrap();
        prop_assert_eq!(totals, closed.totals);
        for (i, lane) in counts.channels.iter().enumerate() {
            let (written, lost, thinned) = (closed.written[i], totals.lost[i], totals.thinned[i]);
            prop_assert_eq!((lane.messages, lane.stated, lane.contradictions), (written, lost, 0));
            prop_assert_eq!(written + lost + thinned, TICKS - FIRST);
            if every == 1 {
                prop_assert_eq!((lane.unexplained, thinned), (0, 0));
            }
            // A kill takes what was counted of them and not written.
            if !killed {
                prop_assert_eq!(totals.duplicates[i], twice[i]);
            }
        }
        let info = LogInfo::of(&segments).unwrap();
        prop_assert!(info.agrees(), "{:?}", info);
        // Each by itself, too.
        for segment in &segments {
            if let Ok(alone) = LogInfo::of(std::slice::from_ref(segment)) {
                prop_assert!(alone.agrees(), "{:?}", alone);
            }
        }
        // What is counted again from the samples is what is stored, where all are there.
        if every == 1 {
            let mut again = LatencyHistograms::new(PERIOD);
            RunLog::open(&segments).unwrap().for_each(|record| again.take(&record.unwrap()));
            let stored = closed.timings.unwrap();
            prop_assert_eq!(again.histograms(), stored.histograms());
            prop_assert_eq!((info.wake_up_lateness_us, info.recounted), (stored.percentiles()[0], false));
        }
    }
}
