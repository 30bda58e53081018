//! `tectum bench latency`: from a tick's scheduled instant to the applied command, between real processes,
//! beside the bare transports; in blocks that take turns, so that what else happens on the machine affects all
//! cases alike.
//!
//! *Cadence*: ticks of 50 ms on the real clock. Tectum's instants come from the log of its run. Its plant
//! applies a command at the next tick, by design, so its total is a little more than a period. A bare transport
//! keeps the same cadence: it sleeps until an absolute instant, then asks, and has the answer at once.
//!
//! *Saturated*: back to back, in lockstep. A tick is due when the one before is over. This is what a computer
//! at full speed achieves, not what an arm experiences.
//!
//! *Caches.* At 50 ms, caches are as other programs leave them (`usual`). `cold`: in the middle of each period
//! all cores read through twice the last-level cache ([`CacheEvictor`]). `warm`: the same exchanges every
//! millisecond.

use std::path::{Path, PathBuf};

use serde::Serialize;

use super::BenchError;
use super::context::BenchContext;
use super::latency_outcome::{CaseOutcome, LatencyOutcome, ratios};
use super::run_block::{self, RunBlock};
use super::usage::Usage;
use crate::clock::TerminationSignals;
use crate::runtime::Mode;
use crate::stats::Percentiles;
use crate::timing::{CacheEvictor, Latencies, PeerExchange, Transport};

/// Time from one tick to the next, ns.
pub(super) const PERIOD_NS: u64 = 50_000_000;
/// The same with warm caches.
const WARM_PERIOD_NS: u64 = 1_000_000;
/// Ticks at the beginning of a block that warm up and are not counted.
const WARM_UP: u64 = 4;
/// Ticks of a block, about.
const BLOCK: u64 = 100;
/// Least and greatest number of blocks of each case.
const ROUNDS: [u64; 2] = [2, 20];
/// Ticks per second to assume for the first lockstep block.
const SATURATED_RATE: f64 = 100_000.0;

/// What to measure.
#[derive(Debug, Clone)]
pub struct LatencySettings {
    /// At 50 ms, or back to back.
    pub pace: Pace,
    /// For how long each case is measured, s.
    pub seconds: f64,
    /// The folder for the results; without one, `runs/bench-latency-<n>`.
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

/// The state of caches when a tick begins.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub(crate) enum Caches {
    /// As other programs leave them.
    Usual,
    /// Evicted half a period before.
    Cold,
    /// Used a millisecond before.
    Warm,
}

impl Caches {
    pub const fn name(self) -> &'static str {
        match self {
            Self::Usual => "usual",
            Self::Cold => "cold",
            Self::Warm => "warm",
        }
    }
}

/// What is measured: Tectum (no transport) or a bare transport, with caches in some state.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct LatencyCase {
    transport: Option<Transport>,
    caches: Caches,
}

impl LatencyCase {
    fn name(self) -> &'static str {
        self.transport.map_or("tectum", Transport::name)
    }

    fn period_ns(self) -> u64 {
        if self.caches == Caches::Warm { WARM_PERIOD_NS } else { PERIOD_NS }
    }
}

/// Measures latencies.
///
/// # Errors
/// When the folder cannot be used, a run or the peer process fails, or a signal ends the bench.
pub fn latency(settings: &LatencySettings) -> Result<LatencyOutcome, BenchError> {
    if !(settings.seconds.is_finite() && settings.seconds > 0.0 && settings.seconds <= 86_400.0) {
        return Err(BenchError::Asked("--seconds is to be above 0 and at most 86400; give for example 10".to_owned()));
    }
    let mut context = BenchContext::start(settings.out.as_deref(), "bench-latency", settings.progress)?;
    let mut bench = LatencyBench::new(settings, context.folder.path(), &context.signals);
    let pace = settings.pace.name();
    for round in 0..bench.rounds {
        for case in 0..bench.cases.len() {
            let name = bench.cases[case].name();
            context.progress.show(&format!("latency, {pace}: round {} of {}, {name}", round + 1, bench.rounds));
            bench.measure_block(case)?;
        }
    }
    let (rounds, slowest_eviction_ns) = (bench.rounds, bench.slowest_eviction_ns);
    let (cases, usage) = bench.finish();
    context.progress.clear();
    let mut outcome = LatencyOutcome {
        mode: settings.pace,
        period_ms: (settings.pace == Pace::Cadence).then_some(PERIOD_NS as f64 / 1e6),
        seconds_each: settings.seconds,
        rounds,
        warm_up_ticks: WARM_UP,
        ratios: ratios(settings.pace, &cases),
        cases,
        usage,
        slowest_eviction_ms: slowest_eviction_ns.map(|ns| ns as f64 / 1e6),
        seconds: context.seconds(),
        machine: context.machine,
        folder: context.folder.path().to_owned(),
    };
    context.folder.keep();
    outcome.write()?;
    Ok(outcome)
}

/// The measurement in progress.
struct LatencyBench<'a> {
    pace: Pace,
    rounds: u64,
    /// Ticks of a block at the cadence, without those that warm up.
    ticks: u64,
    /// Duration of a block back to back, ns.
    block_ns: u64,
    /// Tectum's ticks per second back to back, as far as known.
    rate: f64,
    cases: Vec<LatencyCase>,
    /// Of each case: its latencies, and by block the median of the series that is compared, us.
    results: Vec<(Latencies, Vec<f64>)>,
    usage: Usage,
    slowest_eviction_ns: Option<u64>,
    folder: &'a Path,
    signals: &'a TerminationSignals,
}

impl<'a> LatencyBench<'a> {
    fn new(settings: &LatencySettings, folder: &'a Path, signals: &'a TerminationSignals) -> Self {
        let transports = || std::iter::once(None).chain(Transport::ALL.map(Some));
        let usual = |transport| LatencyCase { transport, caches: Caches::Usual };
        let mut cases: Vec<LatencyCase> = transports().map(usual).collect();
        if settings.pace == Pace::Cadence {
            for caches in [Caches::Cold, Caches::Warm] {
                cases.extend([None, Some(Transport::Event)].map(|transport| LatencyCase { transport, caches }));
            }
        }
        let ticks = ((settings.seconds * 1e9 / PERIOD_NS as f64) as u64).max(2);
        let rounds = (ticks / BLOCK).clamp(ROUNDS[0], ROUNDS[1]);
        Self {
            pace: settings.pace,
            rounds,
            ticks: ticks.div_ceil(rounds),
            block_ns: (settings.seconds * 1e9) as u64 / rounds,
            rate: SATURATED_RATE,
            results: vec![Default::default(); cases.len()],
            cases,
            usage: Usage::default(),
            slowest_eviction_ns: None,
            folder,
            signals,
        }
    }

    /// Measures one block of the case with the index `index`.
    fn measure_block(&mut self, index: usize) -> Result<(), BenchError> {
        let case = self.cases[index];
        let evictor = (case.caches == Caches::Cold).then(|| CacheEvictor::start(case.period_ns()));
        let block = match (case.transport, self.pace) {
            (Some(transport), Pace::Cadence) => self.transport_cadence(transport, case)?,
            (Some(transport), Pace::Saturated) => self.transport_saturated(transport)?,
            (None, Pace::Cadence) => self.tectum_cadence(case)?,
            (None, Pace::Saturated) => self.tectum_saturated()?,
        };
        if let Some(evictor) = evictor {
            self.slowest_eviction_ns = self.slowest_eviction_ns.max(Some(evictor.longest_ns()));
        }
        let (latencies, medians) = &mut self.results[index];
        let compared = self.pace.compared().1;
        medians.extend(Percentiles::of(compared(&block)).map(|p| p.p50));
        latencies.add(&block);
        Ok(())
    }

    /// Ticks of a block at the cadence, with those that warm up.
    fn ticks_of(&self, case: LatencyCase) -> u64 {
        match case.caches {
            // Five times as many: at a millisecond each they take little time.
            Caches::Warm => 5 * self.ticks + WARM_UP,
            _ => self.ticks + WARM_UP,
        }
    }

    fn transport_cadence(&self, transport: Transport, case: LatencyCase) -> Result<Latencies, BenchError> {
        let mut block = Latencies::default();
        let period_ns = case.period_ns();
        let tick_times = PeerExchange::start(transport, self.signals)?.cadence(self.ticks_of(case), period_ns)?;
        block.record(&tick_times, WARM_UP, period_ns);
        Ok(block)
    }

    fn transport_saturated(&self, transport: Transport) -> Result<Latencies, BenchError> {
        let mut block = Latencies::default();
        PeerExchange::start(transport, self.signals)?.saturated(self.block_ns, &mut block)?;
        Ok(block)
    }

    fn tectum_cadence(&mut self, case: LatencyCase) -> Result<Latencies, BenchError> {
        let mut block = Latencies::default();
        // One more tick, because the last command is applied in the tick after it.
        let (ticks, period_ns) = (self.ticks_of(case) + 1, case.period_ns());
        let of = RunBlock { mode: Mode::Realtime, ticks, log_every: 1, period_ns, timed: false };
        let outcome = run_block::measure(&of, self.folder)?;
        block.record(&outcome.tick_times, WARM_UP, period_ns);
        if case.caches == Caches::Usual {
            self.usage.add(&outcome.usage);
        }
        Ok(block)
    }

    fn tectum_saturated(&mut self) -> Result<Latencies, BenchError> {
        let mut block = Latencies::default();
        let ticks = (self.rate * self.block_ns as f64 / 1e9) as u64;
        let most = run_block::max_ticks(self.folder).max(run_block::MIN_TICKS);
        let ticks = ticks.clamp(run_block::MIN_TICKS, most);
        let of = RunBlock { mode: Mode::Lockstep, ticks, log_every: 1, period_ns: PERIOD_NS, timed: true };
        let outcome = run_block::measure(&of, self.folder)?;
        self.rate = outcome.ticks_per_second;
        block.record(&outcome.tick_times, WARM_UP, 0);
        self.usage.add(&outcome.usage);
        Ok(block)
    }

    /// The results of all cases, and what Tectum's processes used.
    fn finish(self) -> (Vec<CaseOutcome>, Usage) {
        let each = self.cases.into_iter().zip(self.results);
        let outcomes = each.map(|(case, (latencies, medians))| CaseOutcome {
            transport: case.name(),
            caches: case.caches,
            ticks: latencies.ticks,
            missed: latencies.missed,
            skipped: latencies.skipped,
            series: latencies.percentiles(),
            files: Vec::new(),
            latencies,
            medians,
        });
        (outcomes.collect(), self.usage)
    }
}
