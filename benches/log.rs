//! The cost of a tick's three messages for the logger, with criterion: written to the file one by one, or together.
//!
//! The file is in the system's temporary folder. It is replaced regularly, so that it never outgrows the page
//! cache.

use std::collections::BTreeMap;
use std::path::Path;
use std::time::{Duration, Instant};

use criterion::{BatchSize, Criterion, criterion_group, criterion_main};
use tectum::log::{LogClock, LogHeader, LogRecord, LogWriter};
use tectum::wire::{ChannelNames, Command, Learning, Observation, schema_hash};

/// Ticks in a file before the next file begins: about 10 MB.
const TICKS_IN_A_FILE: u64 = 20_000;

fn header() -> LogHeader {
    LogHeader {
        scenario: "name = \"bench\"\n".into(),
        run: 1,
        name: "bench".into(),
        seed: 1,
        ticks: 1,
        mode: "lockstep".into(),
        period_ns: 50_000_000,
        every: 1,
        schema_hash: schema_hash(),
        scenario_hash: 0,
        build: tectum::BUILD.into(),
        inputs: Vec::new(),
        outputs: Vec::new(),
        measures: Vec::new(),
        columns: Vec::new(),
        channels: ChannelNames::default(),
        machine: BTreeMap::new(),
        realtime: Default::default(),
        beginning: Default::default(),
        clock: LogClock::Virtual,
        t0_ns: 0,
        wall_at_t0_ns: 0,
        segment: Default::default(),
    }
}

fn new_log(path: &Path) -> LogWriter {
    let _ = std::fs::remove_file(path);
    LogWriter::create(path, &header()).expect("a log in the temporary folder")
}

/// The time of `ticks` runs of `tick`, without the time to create files.
fn timed(path: &Path, ticks: u64, mut tick: impl FnMut(&mut LogWriter)) -> Duration {
    let mut total = Duration::ZERO;
    let mut remaining = ticks;
    while remaining > 0 {
        let mut log = new_log(path);
        let in_this_file = remaining.min(TICKS_IN_A_FILE);
        let start = Instant::now();
        for _ in 0..in_this_file {
            tick(&mut log);
        }
        total += start.elapsed();
        remaining -= in_this_file;
    }
    total
}

fn append(criterion: &mut Criterion) {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("log.mcap");
    let (observation, command, learning) = (Observation::default(), Command::default(), Learning::default());
    let mut group = criterion.benchmark_group("log/tick of 3 messages");
    group.bench_function("flush per message", |b| {
        b.iter_custom(|ticks| {
            timed(&path, ticks, |log| {
                log.observation(&observation).expect("room");
                log.command(&command).expect("room");
                log.learning(&learning).expect("room");
            })
        });
    });
    group.bench_function("flush per tick", |b| {
        b.iter_custom(|ticks| {
            timed(&path, ticks, |log| {
                log.append(&LogRecord::Observation(observation)).expect("room");
                log.append(&LogRecord::Command(command)).expect("room");
                log.append(&LogRecord::Learning(learning)).expect("room");
                log.flush().expect("room");
            })
        });
    });
    group.finish();
    criterion.bench_function("log/finish with fsync", |b| {
        b.iter_batched(
            || new_log(&path),
            |log| log.finish(&Default::default()).expect("room"),
            BatchSize::PerIteration,
        );
    });
}

criterion_group!(benches, append);
criterion_main!(benches);
