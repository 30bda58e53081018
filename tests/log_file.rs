//! A log is written and read back through the file system.

#[path = "support/counting_allocator.rs"]
mod counting_allocator;

use std::collections::BTreeMap;
use std::path::Path;
use std::process::Command as Process;

use counting_allocator::allocations;
use tectum::log::{
    FIXED_BYTES, LogClock, LogError, LogHeader, LogReader, LogRecord, LogTotals, LogWriter, bytes_per_tick,
};
use tectum::scenario::SignalConfig;
use tectum::wire::{ChannelNames, Command, Gap, Header, Learning, MAX_INPUTS, MAX_OUTPUTS, Observation, schema_hash};

fn header() -> LogHeader {
    let signal = |name: &str, unit: &str| SignalConfig {
        name: name.into(),
        unit: unit.into(),
        min: -1.0,
        max: 1.0,
        wraps: None,
    };
    LogHeader {
        scenario: "name = \"synthetic\"\n".repeat(50),
        run: 42,
        name: "synthetic".into(),
        seed: 1,
        ticks: 1_000_000,
        mode: "lockstep".into(),
        period_ns: 50_000_000,
        every: 1,
        schema_hash: schema_hash(),
        scenario_hash: 1,
        build: tectum::BUILD.into(),
        inputs: vec![signal("target_x", "m"), signal("target_y", "m")],
        outputs: vec![signal("rate_1", "rad/s")],
        measures: vec!["error".into()],
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

fn tick(k: u64) -> (Observation, Command, Learning) {
    let header = Header { run: 42, tick: k, sequence: k, published_ns: k * 50_000_000, ..Header::default() };
    let x = k as f32 / 1000.0;
    (
        Observation { header, inputs: [x; MAX_INPUTS], reward: -x, ..Observation::default() },
        Command { header, mean: [x; MAX_OUTPUTS], drawn: [-x; MAX_OUTPUTS] },
        Learning { header, noise: [x; MAX_OUTPUTS], ..Learning::default() },
    )
}

fn write_ticks(log: &mut LogWriter, ticks: std::ops::Range<u64>) -> Result<(), LogError> {
    for k in ticks {
        let (observation, command, learning) = tick(k);
        log.observation(&observation)?;
        log.command(&command)?;
        log.learning(&learning)?;
    }
    Ok(())
}

fn write(path: &Path, ticks: u64) -> u64 {
    let mut log = LogWriter::create(path, &header()).unwrap();
    write_ticks(&mut log, 0..ticks).unwrap();
    log.finish(&LogTotals { last_tick: ticks.checked_sub(1), complete: true, ..LogTotals::default() }).unwrap().bytes
}

#[test]
fn a_log_is_read_back_as_it_was_written() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("log.mcap");
    let mut log = LogWriter::create(&path, &header()).unwrap();
    write_ticks(&mut log, 0..10).unwrap();
    let gap = Gap { channel: 1, first: 10, count: 2, total: 2 };
    log.gap(&gap).unwrap();
    let totals = LogTotals { lost: [0, 2, 0], thinned: [9, 9, 9], last_tick: Some(99), ..LogTotals::default() };
    let summary = log.finish(&totals).unwrap();
    assert_eq!(summary.bytes, std::fs::metadata(&path).unwrap().len());

    let mut log = LogReader::open(&path).unwrap();
    assert_eq!(log.scenario(), header().scenario);
    let records: Vec<LogRecord> = log.by_ref().collect::<Result<_, _>>().unwrap();
    assert_eq!(records.len(), 31);
    let (observation, command, learning) = tick(9);
    let last = [
        LogRecord::Observation(observation),
        LogRecord::Command(command),
        LogRecord::Learning(learning),
        LogRecord::Gap(gap),
    ];
    assert_eq!(records[27..], last);
    assert!(log.finished());
    assert_eq!(log.totals(), Some(totals));
}

#[test]
fn a_torn_log_keeps_every_acknowledged_message() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("log.mcap");
    let mut log = LogWriter::create(&path, &header()).unwrap();
    write_ticks(&mut log, 0..100).unwrap();
    // The writer is not closed, like that of a process that a signal is about to end. Only the file's content counts.
    let mut reader = LogReader::open(&path).unwrap();
    assert_eq!(reader.by_ref().map(Result::unwrap).count(), 300);
    assert!(!reader.finished() && reader.totals().is_none());
    std::mem::forget(log);
}

#[test]
fn equal_runs_give_equal_files() {
    let folder = tempfile::tempdir().unwrap();
    let [a, b] = ["a", "b"].map(|name| folder.path().join(name));
    write(&a, 200);
    write(&b, 200);
    assert_eq!(std::fs::read(a).unwrap(), std::fs::read(b).unwrap());
}

#[test]
fn the_size_of_a_log_can_be_predicted() {
    let folder = tempfile::tempdir().unwrap();
    let (ticks, long) = (1_000, 11_000);
    let short = write(&folder.path().join("short"), ticks);
    let long_bytes = write(&folder.path().join("long"), long);
    let per_tick = (long_bytes - short) as f64 / (long - ticks) as f64;
    // The numbers of digits in the totals differ.
    assert!((per_tick - bytes_per_tick(1)).abs() < 0.01, "{per_tick}");
    let predicted = FIXED_BYTES as f64 + long as f64 * bytes_per_tick(1);
    assert!((predicted / long_bytes as f64 - 1.0).abs() < 0.01, "{predicted} against {long_bytes}");
}

#[test]
fn writing_a_message_allocates_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let mut log = LogWriter::create(&folder.path().join("log.mcap"), &header()).unwrap();
    // The checksum's batch buffer grows to its final size within the first 32 KiB.
    write_ticks(&mut log, 0..200).unwrap();
    let before = allocations();
    write_ticks(&mut log, 200..1200).unwrap();
    for _ in 0..1000 {
        log.append(&LogRecord::Gap(Gap::default())).unwrap();
    }
    log.flush().unwrap();
    assert_eq!(allocations() - before, 0);
}

/// Runs one of these tests in a new process under a limit on the size of its files, as `ulimit -f` sets it.
fn under_a_limit(test: &str, path: &Path) {
    let output = Process::new("sh")
        // Without the trap the kernel ends the process with SIGXFSZ.
        .args(["-c", "trap '' XFSZ; ulimit -S -f 4096; exec \"$0\" --exact \"$1\" --nocapture"])
        .arg(std::env::current_exe().unwrap())
        .arg(test)
        .env("TECTUM_TEST_LIMITED_LOG", path)
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}

/// Sets another limit for this process, in bytes; `None` sets the largest that it may have.
fn limit(bytes: Option<u64>) {
    use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};
    let maximum = getrlimit(Resource::Fsize).maximum;
    setrlimit(Resource::Fsize, Rlimit { current: bytes.or(maximum), maximum }).unwrap();
}

/// The limit is noticed before it cuts off a write. The log is closed in the space that is reserved for that.
#[test]
fn a_log_without_room_states_what_is_missing() {
    let gap = |count| Gap { channel: 1, first: 0, count, total: count };
    if let Some(path) = std::env::var_os("TECTUM_TEST_LIMITED_LOG") {
        let mut log = LogWriter::create(Path::new(&path), &header()).unwrap();
        let error = write_ticks(&mut log, 0..1_000_000).unwrap_err();
        assert!(error.is_full() && !log.broken(), "{error}");
        assert!(error.to_string().contains("the limit on the size of a file is reached; raise the limit"), "{error}");
        let tick = log.written()[2];
        assert!(write_ticks(&mut log, tick..tick + 1).unwrap_err().is_full(), "and again");
        log.missing_from(tick, &error).unwrap();
        log.gap(&gap(tick)).unwrap();
        log.finish(&LogTotals { missing_from: Some(tick), ..LogTotals::default() }).unwrap();
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("log.mcap");
    under_a_limit("a_log_without_room_states_what_is_missing", &path);
    let mut log = LogReader::open(&path).unwrap();
    let records: Vec<LogRecord> = log.by_ref().map(Result::unwrap).collect();
    let ticks = (records.len() as u64 - 1) / 3;
    assert!(ticks > 1000 && log.finished(), "{ticks}");
    assert_eq!((records.last(), log.missing_from()), (Some(&LogRecord::Gap(gap(ticks))), Some(ticks)));
    assert!(log.metadata()["tectum.missing"]["why"].contains("ulimit -f"));
}

/// When even the reserved space is not available, everything that was written before stays readable.
#[test]
fn a_failed_write_leaves_a_torn_log() {
    if let Some(path) = std::env::var_os("TECTUM_TEST_LIMITED_LOG") {
        let mut log = LogWriter::create(Path::new(&path), &header()).unwrap();
        write_ticks(&mut log, 0..500).unwrap();
        limit(Some(std::fs::metadata(&path).unwrap().len() + 400));
        let error = write_ticks(&mut log, 500..1_000).unwrap_err();
        assert!(error.is_full() && log.broken(), "{error}");
        // There is space again, but the file may end with half a message, so nothing is appended.
        limit(None);
        assert_eq!(log.flush().unwrap_err().to_string(), error.to_string());
        let again = log.finish(&LogTotals::default()).unwrap_err();
        assert_eq!(again.to_string(), error.to_string());
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("log.mcap");
    under_a_limit("a_failed_write_leaves_a_torn_log", &path);
    let mut log = LogReader::open(&path).unwrap();
    let records = log.by_ref().map(Result::unwrap).count();
    // When the log was dropped, the rest of the message that was cut off was written.
    assert!(records == 1502 && !log.finished(), "{records}");
}

/// Writes a log for the scripts in `tests/python`. The arm and the paper's learner are a few plain loops in single
/// precision. `TECTUM_TEST_LOG=log.mcap cargo test --test log_file -- --ignored a_log_for_python` starts it.
#[test]
#[ignore = "writes a file for the Python scripts; TECTUM_TEST_LOG names its path"]
fn a_log_for_python() {
    use rand_distr::{Distribution, Normal, Uniform};
    use std::f32::consts::PI;
    let path = std::env::var_os("TECTUM_TEST_LOG").expect("TECTUM_TEST_LOG names the log to write");
    let path = Path::new(&path);
    let mut rng = tectum::seed::stream(1, "python");
    let (uniform, normal) = (Uniform::new(-1.0f32, 1.0).unwrap(), Normal::new(0.0f32, 0.003).unwrap());
    let row = |x: f32, limit: f32| -> Vec<f32> {
        (0..16).map(|i| (-(x + limit - 2.0 * limit * i as f32 / 15.0).powi(2) / 0.5).exp()).collect()
    };
    let mut log = LogWriter::create(path, &header()).unwrap();
    let (mut theta, mut target, mut reward) = ([0.0f32; 4], [0.0f32; 2], 0.0f32);
    let (mut w, mut z) = (vec![[0.0f32; 4]; 320], vec![[0.0f32; 4]; 320]);
    let ticks = 2000;
    for k in 0..ticks {
        // A few ticks are not learned from, as after a late command.
        let cut = k % 97 == 50;
        let learned = k > 0 && !cut;
        if k % 80 == 0 {
            target = [uniform.sample(&mut rng), uniform.sample(&mut rng)];
        }
        if learned {
            for (w, z) in w.iter_mut().zip(&z) {
                (0..4).for_each(|d| w[d] += 0.01 * reward * z[d]);
            }
        }
        if cut {
            z.fill([0.0; 4]);
        }
        let (a, b) = (row(target[0], 1.0), row(target[1], 1.0));
        let mut g: Vec<f32> = a.iter().flat_map(|a| b.iter().map(move |b| a * b)).collect();
        g.extend(theta.iter().flat_map(|&t| row(t, PI)));
        let norm = g.iter().map(|x| x * x).sum::<f32>().sqrt();
        g.iter_mut().for_each(|x| *x /= norm);
        let (mut observation, mut command, mut learning) = tick(k);
        observation.inputs = [0.0; MAX_INPUTS];
        observation.inputs[..2].copy_from_slice(&target);
        observation.inputs[2..6].copy_from_slice(&theta);
        observation.reward = reward;
        (command.mean, command.drawn, learning.noise) = ([0.0; MAX_OUTPUTS], [0.0; MAX_OUTPUTS], [0.0; MAX_OUTPUTS]);
        let (mut end, mut rates) = ([0.0f32, -1.0], 0.0);
        for d in 0..4 {
            let noise = normal.sample(&mut rng);
            let mean = g.iter().zip(&w).map(|(g, w)| g * w[d]).sum::<f32>();
            (command.mean[d], command.drawn[d], learning.noise[d]) = (mean, mean + noise, noise);
            g.iter().zip(&mut z).for_each(|(g, z)| z[d] = 0.9 * z[d] + 0.1 * noise * g);
            let rate = 200.0 * PI * (mean + noise);
            theta[d] = (theta[d] + 0.05 * rate + PI).rem_euclid(2.0 * PI) - PI;
            rates += rate * rate;
            end = [end[0] + 0.5 * theta[d].cos(), end[1] + 0.5 * theta[d].sin()];
        }
        learning.header.flags = if learned { 1 << 16 } else { 0 } | if cut { 1 << 17 } else { 0 };
        learning.reward = reward;
        log.observation(&observation).unwrap();
        log.command(&command).unwrap();
        log.learning(&learning).unwrap();
        let error = (end[0] - target[0]).powi(2) + (end[1] - target[1]).powi(2);
        reward = -0.1 * (error + 0.025 * rates + 0.01 * theta.iter().map(|t| t * t).sum::<f32>());
    }
    log.finish(&LogTotals { last_tick: Some(ticks - 1), complete: true, ..LogTotals::default() }).unwrap();
}
