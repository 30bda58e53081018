//! Tests of the merger with loggers that are killed and restarted, on real files: written samples stay, and
//! missing samples are stated.

use std::collections::VecDeque;
use std::path::{Path, PathBuf};

use super::*;
use crate::log::{LogClock, LogHeader, LogInfo, LogSegment, MessageCounts, RunLog, find, remove_account, segment_path};
use crate::scenario::Scenario;
use crate::wire::{Command, Learning, Observation, flag};
use proptest::prelude::*;

const PERIOD: u64 = 1_000_000;

/// An input whose last received sample is that of tick `last`, still held or already written.
fn input(channel: u64, last: Option<u64>, held: bool) -> MergeInput {
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
fn a_sample_waits_for_earlier_samples() {
    // The command of tick 5 has arrived, and its observation has not.
    let early = [input(0, Some(4), false), input(1, Some(5), true), input(2, Some(4), false)];
    assert_eq!(first_head(&early), Some(NextHead { tick: 5, input: 1, settled: false }));
    // Once the observation has arrived, it is first, and nothing of tick 4 is missing.
    let both = [input(0, Some(5), true), input(1, Some(5), true), input(2, Some(5), true)];
    assert_eq!(first_head(&both), Some(NextHead { tick: 5, input: 0, settled: true }));
    // Observation and command of tick 5 are written, and the next observation has not arrived.
    let last = [input(0, Some(5), false), input(1, Some(5), false), input(2, Some(5), true)];
    assert_eq!(first_head(&last), Some(NextHead { tick: 5, input: 2, settled: true }));
    // At the start nothing is known of the other channels.
    let start = [input(0, Some(0), true), input(1, None, false), input(2, None, false)];
    assert_eq!(first_head(&start), Some(NextHead { tick: 0, input: 0, settled: false }));
    assert_eq!(first_head(&[0, 1, 2].map(|i| input(i, None, false))), None);
}

#[test]
fn gaps_are_counted_once_and_summed_up() {
    let mut input = MergeInput { channel: 2, ..MergeInput::default() };
    assert_eq!(input.gap_until(0), None);
    input.expected = 4;
    assert_eq!(input.gap_until(7), Some(Gap { channel: 2, first: 4, count: 3, total: 3 }));
    assert_eq!(input.gap_until(7), None);
    assert_eq!(input.gap_until(8), Some(Gap { channel: 2, first: 7, count: 1, total: 4 }));
    // A duplicate does not move the expected number back.
    let LogRecord::Learning(old) = sample(2, 5) else { unreachable!() };
    assert_eq!(input.accept(&old.header, &LogRecord::Learning(old)), None);
    assert_eq!((input.expected, input.duplicates, input.head.is_none()), (8, 1, true));
}

fn header(number: u32, every: u64, recovered: &LogRecovery) -> LogHeader {
    let plan = Scenario::find("paper").unwrap().plan().unwrap();
    LogHeader {
        every,
        period_ns: PERIOD,
        clock: LogClock::Monotonic,
        segment: LogSegment { number, ..recovered.segment },
        ..LogHeader::new(&plan, 5, "realtime", Default::default())
    }
}

/// The logger of incarnation `number`.
fn logger(folder: &Path, number: u32, every: u64) -> LogMerger {
    let recovered = LogRecovery::none(PERIOD, [FIRST; 3], FIRST).with(folder, || ());
    let log = LogWriter::create(&segment_path(folder, number), &header(number, every, &recovered));
    let keeper = AccountKeeper::new(folder, header(number, every, &recovered).run_text(), 20);
    LogMerger::new(log, &recovered, every, true).accounting(keeper)
}

/// Writes all waiting samples, as the logger's loop does. No other samples of ticks before `known` will arrive.
fn drain(merger: &mut LogMerger, waiting: &mut [VecDeque<LogRecord>; 3], known: u64) {
    loop {
        for (i, waiting) in waiting.iter_mut().enumerate() {
            merger.fill(i, known, || waiting.pop_front());
        }
        if !merger.write_first(false) {
            break;
        }
    }
    merger.flush();
}

/// A log from which ticks were left out unread, or written at once, is the same as one of which every sample was
/// received.
#[test]
fn whole_ticks_change_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let written = [false, true].map(|unread| {
        let folder = folder.path().join(unread.to_string());
        std::fs::create_dir(&folder).unwrap();
        let recovered = LogRecovery::none(PERIOD, [0; 3], 0);
        let log = LogWriter::create(&segment_path(&folder, 0), &header(0, 10, &recovered));
        let mut merger = LogMerger::new(log, &recovered, 10, false);
        let (mut left_out, mut written_at_once, mut tick) = (0, 0, 0);
        while tick < 48 {
            let count = if unread { merger.unlogged_ticks() } else { 0 };
            // Some before a tick that is logged are received all the same.
            if count > 0 && tick + count < 40 && tick % 10 != 7 {
                merger.leave_out(count.min(3));
                left_out += count.min(3);
                tick += count.min(3);
                continue;
            }
            let samples = [0, 1, 2].map(|i| sample(i, tick));
            if let [LogRecord::Observation(observation), LogRecord::Command(command), LogRecord::Learning(learning)] =
                &samples
            {
                let late = Learning { header: Header { sequence: tick + 1, ..learning.header }, ..*learning };
                assert!(!merger.write_tick(observation, command, &late));
                if unread && tick % 20 == 0 && merger.write_tick(observation, command, learning) {
                    written_at_once += 1;
                    tick += 1;
                    continue;
                }
            }
            let mut waiting = samples.map(|sample| VecDeque::from([sample]));
            merger.fill(0, tick, || waiting[0].pop_front());
            assert_eq!(merger.unlogged_ticks(), 0, "a sample was received already");
            drain(&mut merger, &mut waiting, tick + 1);
            tick += 1;
        }
        assert_eq!(written_at_once, if unread { 3 } else { 0 });
        assert_eq!(left_out, if unread { 24 } else { 0 });
        let outcome = merger.close([48; 3], true, BTreeMap::new());
        (outcome.totals, outcome.written, std::fs::read(segment_path(&folder, 0)).unwrap())
    });
    assert_eq!(written[0], written[1]);
}

/// What a logger takes over from the account is what reading all segments gives, and only the tail is read.
#[test]
fn an_account_spares_reading_all_but_the_tail() {
    let folder = tempfile::tempdir().unwrap();
    for (number, ticks) in [(0, FIRST..70), (1, 71..100), (2, 100..TICKS)] {
        let mut merger = logger(folder.path(), number, 1);
        for tick in ticks {
            let mut waiting = [0, 1, 2].map(|i| VecDeque::from([sample(i, tick)]));
            if tick == 40 {
                waiting[1].clear();
            }
            drain(&mut merger, &mut waiting, tick + 1);
        }
    }
    let recover = || LogRecovery::none(PERIOD, [FIRST; 3], FIRST).with(folder.path(), || ());
    let with_account = recover();
    remove_account(folder.path());
    let whole = recover();
    assert!(with_account.read < 20, "{with_account:?}");
    assert_eq!(whole.read, whole.segment.written.iter().sum::<u64>());
    assert_eq!((with_account.segment, with_account.last_ticks), (whole.segment, whole.last_ticks));
    assert_eq!((with_account.bytes, with_account.missing_from), (whole.bytes, whole.missing_from));
    assert_eq!(with_account.timings.histograms(), whole.timings.histograms());
}

/// An event at a tick.
#[derive(Debug, Clone, Copy)]
enum MergeEvent {
    /// The sample of one channel does not reach the logger.
    Lost(usize),
    /// The sample of one channel arrives twice.
    Duplicate(usize),
    /// The logger receives and writes all waiting samples.
    Drain,
    /// The logger is killed. The next one starts after so many ticks, and the file loses so many bytes.
    Kill(u64, u64),
}

fn any_event() -> impl Strategy<Value = MergeEvent> {
    prop_oneof![
        2 => (0..3_usize).prop_map(MergeEvent::Lost),
        2 => (0..3_usize).prop_map(MergeEvent::Duplicate),
        4 => Just(MergeEvent::Drain),
        1 => (0..9_u64, 0..700_u64).prop_map(|(ticks, bytes)| MergeEvent::Kill(ticks, bytes)),
    ]
}

/// The run's first tick, as of a run that resumes another one, and the end of its ticks.
const FIRST: u64 = 7;
const TICKS: u64 = 120;

/// A run's channels and its logger, which may be killed and restarted.
struct LoggedRun<'a> {
    folder: &'a Path,
    every: u64,
    waiting: [VecDeque<LogRecord>; 3],
    /// The logger's incarnation.
    number: u32,
    /// Ticks until the next logger starts, while there is none.
    downtime: u64,
    killed: bool,
    /// Samples sent twice while a logger ran.
    duplicates: [u64; 3],
    merger: Option<LogMerger>,
}

impl<'a> LoggedRun<'a> {
    fn new(folder: &'a Path, every: u64) -> Self {
        Self {
            folder,
            every,
            waiting: Default::default(),
            number: 0,
            downtime: 0,
            killed: false,
            duplicates: [0; 3],
            merger: Some(logger(folder, 0, every)),
        }
    }

    /// Sends the samples of a tick, and then lets the event happen.
    fn run_tick(&mut self, tick: u64, event: Option<MergeEvent>) {
        if self.merger.is_none() {
            if self.downtime > 0 {
                // Without a logger, the samples are lost.
                self.downtime -= 1;
                return;
            }
            self.number += 1;
            self.merger = Some(logger(self.folder, self.number, self.every));
        }
        for (i, waiting) in self.waiting.iter_mut().enumerate() {
            match event {
                Some(MergeEvent::Lost(lost)) if lost == i => continue,
                Some(MergeEvent::Duplicate(again)) if again == i => {
                    waiting.push_back(sample(i, tick));
                    self.duplicates[i] += 1;
                }
                _ => {}
            }
            waiting.push_back(sample(i, tick));
        }
        match event {
            Some(MergeEvent::Drain) => drain(self.merger.as_mut().unwrap(), &mut self.waiting, tick + 1),
            Some(MergeEvent::Kill(downtime, bytes)) => self.kill(downtime, bytes),
            _ => {}
        }
    }

    /// Kills the logger. Its file loses what was not flushed, and `bytes` of what was, as after a loss of
    /// power.
    fn kill(&mut self, downtime: u64, bytes: u64) {
        let path = segment_path(self.folder, self.number);
        let flushed = std::fs::metadata(&path).unwrap().len();
        drop(self.merger.take());
        let file = std::fs::File::options().write(true).open(&path).unwrap();
        file.set_len(flushed.saturating_sub(bytes)).unwrap();
        self.waiting.iter_mut().for_each(VecDeque::clear);
        (self.killed, self.downtime) = (true, downtime);
    }

    /// Ends the run; a logger that was killed is restarted first.
    fn finish(&mut self) -> MergeOutcome {
        let merger = self.merger.take();
        let mut merger = merger.unwrap_or_else(|| logger(self.folder, self.number + 1, self.every));
        drain(&mut merger, &mut self.waiting, TICKS);
        merger.close([TICKS; 3], true, BTreeMap::from([("some-warning".to_owned(), "3 of 5 ticks".to_owned())]))
    }

    /// The segments together contain every sample or state that it is missing, in the order of ticks.
    fn check_log(&self, segments: &[PathBuf], outcome: &MergeOutcome) -> Result<(), TestCaseError> {
        let mut log = RunLog::open(segments).unwrap();
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
        prop_assert_eq!(totals, outcome.totals);
        let warnings = log.current_segment().metadata().get(crate::log::WARNINGS_METADATA).unwrap();
        prop_assert_eq!(&warnings["some-warning"], "3 of 5 ticks");
        for (i, channel) in counts.channels.iter().enumerate() {
            let (written, lost, thinned) = (outcome.written[i], totals.lost[i], totals.thinned[i]);
            prop_assert_eq!((channel.messages, channel.stated, channel.contradictions), (written, lost, 0));
            prop_assert_eq!(written + lost + thinned, TICKS - FIRST);
            if self.every == 1 {
                prop_assert_eq!((channel.unexplained, thinned), (0, 0));
            }
            // A kill loses counts of duplicates that were not yet written.
            if !self.killed {
                prop_assert_eq!(totals.duplicates[i], self.duplicates[i]);
            }
        }
        Ok(())
    }

    /// The descriptions of the log and of each segment agree with their contents, and so do the stored
    /// histograms.
    fn check_info(&self, segments: &[PathBuf], outcome: &MergeOutcome) -> Result<(), TestCaseError> {
        let info = LogInfo::of(segments).unwrap();
        prop_assert!(info.agrees(), "{:?}", info);
        for segment in segments {
            if let Ok(alone) = LogInfo::of(std::slice::from_ref(segment)) {
                prop_assert!(alone.agrees(), "{:?}", alone);
            }
        }
        // Where the log has all samples, counting them again gives the stored histograms.
        if self.every == 1 {
            let mut again = LatencyHistograms::new(PERIOD);
            RunLog::open(segments).unwrap().for_each(|record| again.take(&record.unwrap()));
            let stored = outcome.timings.as_ref().unwrap();
            prop_assert_eq!(again.histograms(), stored.histograms());
            prop_assert_eq!((info.wake_up_lateness_us, info.recounted), (stored.percentiles()[0], false));
        }
        Ok(())
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    /// With any events, the segments together state what is missing from them, and totals and histograms are
    /// those of the run.
    #[test]
    fn segments_together_state_what_is_missing(
        events in prop::collection::btree_map(FIRST..TICKS, any_event(), 0..30),
        every in prop_oneof![3 => Just(1_u64), 1 => Just(3)],
    ) {
        let folder = tempfile::tempdir().unwrap();
        let mut run = LoggedRun::new(folder.path(), every);
        for tick in FIRST..TICKS {
            run.run_tick(tick, events.get(&tick).copied());
        }
        let outcome = run.finish();
        prop_assert_eq!(&outcome.failure, &None);
        let segments = find(folder.path()).unwrap();
        run.check_log(&segments, &outcome)?;
        run.check_info(&segments, &outcome)?;
    }
}
