//! `tectum bench latency`: from a tick's scheduled instant to the applied command, between real processes, beside the bare
//! ways that there are; in blocks that take turns, so that what the machine does meanwhile befalls all alike.
//!
//! *Cadence*: ticks of 50 ms on the real clock. Tectum's instants are those of its own log; its plant applies a command at
//! the next tick, by design, so its whole is a period and a little. The bare ways do the same at the same cadence: asleep
//! until an absolute instant, then ask, and have the answer in hand.
//!
//! *Saturated*: back to back, in lockstep; a tick is due when the one before is over. That is what a computer in a hurry
//! sees, not what an arm sees.
//!
//! *Caches.* At 50 ms, caches are as other programs leave them. `cold`: in the middle of each period all cores read through
//! twice the last-level cache ([`CacheEvictor`](super::Evictor)). `warm`: the same exchanges every millisecond.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use serde::Serialize;

use super::run_block::{self, RunBlock};
use super::tick_times::{Latencies, SERIES, SeriesPercentiles, hgrm};
use super::{BenchError, CacheEvictor, Machine, PeerExchange, Transport, Usage};
use crate::clock::{TerminationSignals, monotonic_ns};
use crate::runtime::{Mode, Percentiles};
use crate::study::Spread;
use crate::supervise::{LaunchError, ProgressLine, RunFolder};

/// From one tick to the next, ns.
pub const PERIOD_NS: u64 = 50_000_000;
/// The same with warm caches.
const WARM_PERIOD_NS: u64 = 1_000_000;
/// Ticks at the beginning of a block that warm up, and are not counted.
const WARM_UP: u64 = 4;
/// Ticks of a block, about.
const BLOCK: u64 = 100;
/// Blocks of each way, at least and at most.
const ROUNDS: [u64; 2] = [2, 20];
/// Ticks of a lockstep block to begin with, and a guess at their rate.
const SATURATED_RATE: f64 = 100_000.0;

/// What to measure.
#[derive(Debug, Clone)]
pub struct LatencySettings {
    /// At 50 ms, or back to back.
    pub pace: Pace,
    /// For how long each way is measured, s.
    pub seconds: f64,
    /// The folder; `runs/bench-latency-<n>` if there is none.
    pub out: Option<PathBuf>,
    /// Show a progress line on standard error.
    pub progress: bool,
}

/// How exchanges follow each other.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Pace {
    /// Every 50 ms.
    Cadence,
    /// Back to back.
    Saturated,
}

impl Pace {
    /// Its name.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Cadence => "cadence",
            Self::Saturated => "saturated",
        }
    }
}

/// In what state caches are when a tick begins.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Caches {
    /// As they come.
    Usual,
    /// Emptied half a period before.
    Cold,
    /// Used a millisecond before.
    Warm,
}

impl Caches {
    const fn name(self) -> &'static str {
        match self {
            Self::Usual => "usual",
            Self::Cold => "cold",
            Self::Warm => "warm",
        }
    }
}

/// One thing that is measured: Tectum (no way) or a bare way, in a state of caches.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct LatencyCase {
    way: Option<Transport>,
    caches: Caches,
}

impl LatencyCase {
    fn name(self) -> &'static str {
        self.way.map_or("tectum", Transport::name)
    }
}

/// What one of them came to.
#[derive(Debug, Clone, Serialize)]
pub struct CaseOutcome {
    /// `tectum`, or a bare way's name.
    pub way: &'static str,
    /// State of the caches.
    pub caches: Caches,
    /// Ticks counted.
    pub ticks: u64,
    /// Of these, those whose command was not applied.
    pub missed: u64,
    /// Ticks passed over in stalls, which are in the series as long as they would have waited.
    pub swallowed: u64,
    /// Percentiles of all series.
    #[serde(flatten)]
    pub series: SeriesPercentiles,
    /// Files with the whole distributions, in the bench's folder.
    pub files: Vec<String>,
    #[serde(skip)]
    latencies: Latencies,
    /// Median by block, us, of the series that is compared.
    #[serde(skip)]
    medians: Vec<f64>,
}

/// Tectum over a bare way.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Ratio {
    /// Of what: Tectum's series.
    pub of: &'static str,
    /// To what: the way's name.
    pub to: &'static str,
    /// The way's series.
    pub series: &'static str,
    /// State of the caches.
    pub caches: Caches,
    /// Ratio of the medians.
    pub p50: f64,
    /// Ratio of the 99th percentiles.
    pub p99: f64,
    /// The ratio of the medians block by block.
    pub p50_by_block: Option<Spread>,
}

/// Everything that was measured: the object of `--json`.
#[derive(Debug, Clone, Serialize)]
pub struct LatencyOutcome {
    /// How exchanges followed each other.
    pub mode: Pace,
    /// From one tick to the next, ms; null back to back.
    pub period_ms: Option<f64>,
    /// For how long each way was measured, s.
    pub seconds_each: f64,
    /// Blocks of each.
    pub rounds: u64,
    /// Ticks at the beginning of each block that are not counted.
    pub warm_up_ticks: u64,
    /// Each way.
    pub ways: Vec<CaseOutcome>,
    /// What Tectum adds.
    pub ratios: Vec<Ratio>,
    /// What Tectum's processes used, caches as usual.
    pub usage: Usage,
    /// When the slowest eviction of caches was done, ms after the middle of its period; null where none was asked for.
    pub slowest_eviction_ms: Option<f64>,
    /// What it ran on.
    pub machine: Machine,
    /// Seconds that it took.
    pub seconds: f64,
    /// The folder with the files.
    pub folder: PathBuf,
}

/// Measures.
///
/// # Errors
/// When the folder cannot be used, a run or another process fails, or a signal ends it.
pub fn latency(asked: &LatencySettings) -> Result<LatencyOutcome, BenchError> {
    if !(asked.seconds.is_finite() && asked.seconds > 0.0 && asked.seconds <= 86_400.0) {
        return Err(BenchError::Asked("--seconds is to be above 0 and at most 86400; give for example 10".to_owned()));
    }
    let signals = TerminationSignals::install().map_err(LaunchError::Signals)?;
    let folder = RunFolder::create(asked.out.as_deref(), None, "bench-latency")?;
    let began = monotonic_ns();
    let machine = Machine::now(folder.path());
    let mut progress = ProgressLine::new(asked.progress);
    let mut bench = LatencyBench::new(asked, folder.path().to_owned(), signals);
    for round in 0..bench.rounds {
        for case in 0..bench.cases.len() {
            let name = bench.cases[case].name();
            progress.show(&format!("latency, {}: round {} of {}, {name}", asked.pace.name(), round + 1, bench.rounds));
            bench.turn(case)?;
        }
    }
    drop(progress);
    let mut outcome = bench.outcome(asked, machine);
    outcome.seconds = (monotonic_ns() - began) as f64 / 1e9;
    folder.keep();
    outcome.write()?;
    Ok(outcome)
}

/// A bench in progress.
struct LatencyBench {
    pace: Pace,
    rounds: u64,
    /// Ticks of a block at the cadence, without those that warm up.
    ticks: u64,
    /// Length of a block back to back, ns.
    block_ns: u64,
    /// Ticks a second of Tectum back to back, as far as known.
    rate: f64,
    cases: Vec<LatencyCase>,
    found: Vec<(Latencies, Vec<f64>)>,
    usage: Usage,
    slowest_eviction: Option<u64>,
    folder: PathBuf,
    signals: TerminationSignals,
}

impl LatencyBench {
    fn new(asked: &LatencySettings, folder: PathBuf, signals: TerminationSignals) -> Self {
        let ways = || std::iter::once(None).chain(Transport::ALL.map(Some));
        let mut cases: Vec<LatencyCase> = ways().map(|way| LatencyCase { way, caches: Caches::Usual }).collect();
        if asked.pace == Pace::Cadence {
            for caches in [Caches::Cold, Caches::Warm] {
                cases.extend([None, Some(Transport::Event)].map(|way| LatencyCase { way, caches }));
            }
        }
        let ticks = ((asked.seconds * 1e9 / PERIOD_NS as f64) as u64).max(2);
        let rounds = (ticks / BLOCK).clamp(ROUNDS[0], ROUNDS[1]);
        Self {
            pace: asked.pace,
            rounds,
            ticks: ticks.div_ceil(rounds),
            block_ns: (asked.seconds * 1e9) as u64 / rounds,
            rate: SATURATED_RATE,
            found: vec![Default::default(); cases.len()],
            cases,
            usage: Usage::default(),
            slowest_eviction: None,
            folder,
            signals,
        }
    }

    /// One block of one case.
    fn turn(&mut self, case: usize) -> Result<(), BenchError> {
        let LatencyCase { way, caches } = self.cases[case];
        let period = if caches == Caches::Warm { WARM_PERIOD_NS } else { PERIOD_NS };
        let ticks = match caches {
            // A millisecond each: as many again and again cost little.
            Caches::Warm => 5 * self.ticks,
            _ => self.ticks,
        } + WARM_UP;
        let evictor = (caches == Caches::Cold).then(|| CacheEvictor::start(period));
        let mut block = Latencies::default();
        match (way, self.pace) {
            (Some(way), Pace::Cadence) => {
                let tick_times = PeerExchange::start(way, &self.signals)?.cadence(ticks, period)?;
                block.record(&tick_times, WARM_UP, period);
            }
            (Some(way), Pace::Saturated) => {
                PeerExchange::start(way, &self.signals)?.saturated(self.block_ns, &mut block)?;
            }
            (None, Pace::Cadence) => {
                // One more, for what becomes of the last.
                let of = RunBlock { mode: Mode::Realtime, ticks: ticks + 1, every: 1, period, timed: false };
                let lived = run_block::measure(&of, &self.folder)?;
                block.record(&lived.tick_times, WARM_UP, period);
                if caches == Caches::Usual {
                    self.usage.add(&lived.usage);
                }
            }
            (None, Pace::Saturated) => {
                let ticks = (self.rate * self.block_ns as f64 / 1e9) as u64;
                let ticks = ticks.clamp(run_block::LEAST, run_block::room(&self.folder).max(run_block::LEAST));
                let of = RunBlock { mode: Mode::Lockstep, ticks, every: 1, period: PERIOD_NS, timed: true };
                let lived = run_block::measure(&of, &self.folder)?;
                self.rate = lived.ticks_per_second;
                block.record(&lived.tick_times, WARM_UP, 0);
                self.usage.add(&lived.usage);
            }
        }
        if let Some(evictor) = evictor {
            self.slowest_eviction = self.slowest_eviction.max(Some(evictor.longest_ns()));
        }
        let (all, medians) = &mut self.found[case];
        let compared = self.pace.compared().1;
        medians.extend(Percentiles::of(compared(&block)).map(|p| p.p50));
        all.add(&block);
        Ok(())
    }

    fn outcome(self, asked: &LatencySettings, machine: Machine) -> LatencyOutcome {
        let ways: Vec<CaseOutcome> = self
            .cases
            .iter()
            .zip(self.found)
            .map(|(case, (latencies, medians))| CaseOutcome {
                way: case.name(),
                caches: case.caches,
                ticks: latencies.ticks,
                missed: latencies.missed,
                swallowed: latencies.swallowed,
                series: latencies.percentiles(),
                files: Vec::new(),
                latencies,
                medians,
            })
            .collect();
        let mut ratios = Vec::new();
        for ours in ways.iter().filter(|case| case.way == "tectum") {
            for theirs in ways.iter().filter(|case| case.way != "tectum" && case.caches == ours.caches) {
                ratios.extend(ratio(self.pace, ours, theirs));
                if self.pace == Pace::Cadence {
                    ratios.extend(over_the_whole_round_trip(ours, theirs));
                }
            }
        }
        LatencyOutcome {
            mode: asked.pace,
            period_ms: (asked.pace == Pace::Cadence).then_some(PERIOD_NS as f64 / 1e6),
            seconds_each: asked.seconds,
            rounds: self.rounds,
            warm_up_ticks: WARM_UP,
            ways,
            ratios,
            usage: self.usage,
            slowest_eviction_ms: self.slowest_eviction.map(|ns| ns as f64 / 1e6),
            machine,
            seconds: 0.0,
            folder: self.folder,
        }
    }
}

type Pick = fn(&Latencies) -> &hdrhistogram::Histogram<u64>;

impl Pace {
    /// The series that is compared, of Tectum and of a bare way. At the cadence that is the way from the sensed observation to
    /// the sent command: how long it then lies until it is applied is a matter of Tectum's design, not of its speed.
    fn compared(self) -> (&'static str, Pick) {
        match self {
            Self::Cadence => (SERIES[1], |l| &l.sensed_to_command),
            Self::Saturated => (SERIES[3], |l| &l.sensed_to_applied),
        }
    }
}

/// Tectum over a bare way in the same series.
fn ratio(pace: Pace, ours: &CaseOutcome, theirs: &CaseOutcome) -> Option<Ratio> {
    let (name, pick) = pace.compared();
    let blocks = ours.medians.iter().zip(&theirs.medians).map(|(ours, theirs)| ours / theirs);
    over(name, ours, theirs, name, pick, pick, Spread::of(blocks))
}

/// Tectum's observation to command over a bare way's whole round trip.
fn over_the_whole_round_trip(ours: &CaseOutcome, theirs: &CaseOutcome) -> Option<Ratio> {
    over(SERIES[1], ours, theirs, SERIES[3], |l| &l.sensed_to_command, |l| &l.sensed_to_applied, None)
}

fn over(
    of: &'static str,
    ours: &CaseOutcome,
    theirs: &CaseOutcome,
    series: &'static str,
    our: Pick,
    their: Pick,
    p50_by_block: Option<Spread>,
) -> Option<Ratio> {
    let (us, them) = (Percentiles::of(our(&ours.latencies))?, Percentiles::of(their(&theirs.latencies))?);
    let (p50, p99) = (us.p50 / them.p50, us.p99 / them.p99);
    Some(Ratio { of, to: theirs.way, series, caches: ours.caches, p50, p99, p50_by_block })
}

impl LatencyOutcome {
    /// One JSON object.
    pub fn to_json(&self) -> String {
        serde_json::to_string(self).unwrap_or_default()
    }

    /// Leaves the distributions and the object in the folder.
    fn write(&mut self) -> Result<(), BenchError> {
        for case in &mut self.ways {
            for (name, histogram) in SERIES.into_iter().zip(case.latencies.series()) {
                let file = format!("{}.{}.{name}.hgrm", case.way, case.caches.name());
                let path = self.folder.join(&file);
                std::fs::write(&path, hgrm(histogram)).map_err(BenchError::write(&path))?;
                case.files.push(file);
            }
        }
        let path = self.folder.join("latency.json");
        std::fs::write(&path, self.to_json()).map_err(BenchError::write(&path))
    }

    /// What a reader of tables needs to know.
    pub fn to_text(&self) -> String {
        let how = match self.mode {
            Pace::Cadence => "every 50 ms",
            Pace::Saturated => "back to back",
        };
        let mut text = format!(
            "latency, {how}: {} s of each way in {} blocks that took turns; us from a tick's scheduled instant\n{}\n",
            self.seconds_each,
            self.rounds,
            self.machine.to_text()
        );
        for case in &self.ways {
            let _ = writeln!(
                text,
                "{}, caches {}: {} ticks, missed {}, passed over {}",
                case.way,
                case.caches.name(),
                case.ticks,
                case.missed,
                case.swallowed
            );
            for (name, p) in SERIES.into_iter().zip(case.series.all()) {
                let Some(p) = p else { continue };
                let _ = writeln!(
                    text,
                    "  {name:<21} p50 {:>9.1}  p90 {:>9.1}  p99 {:>9.1}  p99.9 {:>9.1}  max {:>9.1}",
                    p.p50, p.p90, p.p99, p.p999, p.max
                );
            }
        }
        text += "\nTectum over                      series             caches    p50   p99  (p50 by block)\n";
        for r in &self.ratios {
            let series = if r.of == r.series { r.of.to_owned() } else { format!("{} over its {}", r.of, r.series) };
            let blocks = r.p50_by_block.map_or(String::new(), |s| format!("  ({:.2} to {:.2})", s.min, s.max));
            let _ = writeln!(
                text,
                "  {:<15} {series:<42} {:<6} {:>5.2} {:>5.2}{blocks}",
                r.to,
                r.caches.name(),
                r.p50,
                r.p99
            );
        }
        text.push('\n');
        text += &self.usage.to_text();
        if self.mode == Pace::Saturated {
            text += "  (plant and controller keep the instants of every tick in memory here, 16 bytes each)\n";
        }
        if let Some(ms) = self.slowest_eviction_ms {
            let _ = writeln!(text, "the slowest eviction of caches was done {ms:.1} ms after the middle of its period");
        }
        let _ = writeln!(text, "files   {}", self.folder.display());
        text
    }

    /// The whole distributions of the compared series, by way, caches as usual.
    pub(super) fn distributions(&self) -> Vec<(&'static str, &Latencies)> {
        let usual = self.ways.iter().filter(|case| case.caches == Caches::Usual);
        usual.map(|case| (case.way, &case.latencies)).collect()
    }

    /// Where its files are.
    pub fn folder(&self) -> &Path {
        &self.folder
    }
}
