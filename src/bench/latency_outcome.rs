//! The results of `tectum bench latency`: percentiles by case, Tectum over each bare transport, text and files.

use std::fmt::Write as _;
use std::path::PathBuf;

use serde::Serialize;

use super::context::write_file;
use super::latency::{Caches, Pace};
use super::usage::Usage;
use super::{BenchError, Machine};
use crate::stats::{Percentiles, Spread};
use crate::timing::{Latencies, SERIES, SeriesPercentiles, hgrm};

/// The results of one case.
#[derive(Debug, Clone, Serialize)]
pub(crate) struct CaseOutcome {
    /// `tectum`, or a bare transport's name.
    #[serde(rename = "way")]
    pub transport: &'static str,
    /// State of the caches.
    pub caches: Caches,
    /// Ticks counted.
    pub ticks: u64,
    /// Among them, those whose command was not applied.
    pub missed: u64,
    /// Ticks skipped in stalls. Each is in the series with the time that it would have waited.
    #[serde(rename = "swallowed")]
    pub skipped: u64,
    /// Percentiles of all series.
    #[serde(flatten)]
    pub series: SeriesPercentiles,
    /// Files with the whole distributions, in the bench's folder.
    pub files: Vec<String>,
    #[serde(skip)]
    pub latencies: Latencies,
    /// By block, the median of the series that is compared, us.
    #[serde(skip)]
    pub medians: Vec<f64>,
}

/// Tectum over a bare transport.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct Ratio {
    /// Tectum's series.
    pub of: &'static str,
    /// The transport's name.
    pub to: &'static str,
    /// The transport's series.
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

/// All results: the object of `--json`.
#[derive(Debug, Clone, Serialize)]
pub struct LatencyOutcome {
    /// How exchanges followed each other.
    pub(super) mode: Pace,
    /// Time from one tick to the next, ms; null back to back.
    pub(super) period_ms: Option<f64>,
    /// For how long each case was measured, s.
    pub(super) seconds_each: f64,
    /// Blocks of each case.
    pub(super) rounds: u64,
    /// Ticks at the beginning of each block that are not counted.
    pub(super) warm_up_ticks: u64,
    /// Each case.
    #[serde(rename = "ways")]
    pub(super) cases: Vec<CaseOutcome>,
    /// Tectum over the bare transports.
    pub(super) ratios: Vec<Ratio>,
    /// What Tectum's processes used, with caches as usual.
    pub(super) usage: Usage,
    /// When the slowest eviction of caches ended, ms after the middle of its period; null without cold caches.
    pub(super) slowest_eviction_ms: Option<f64>,
    /// The machine.
    pub(super) machine: Machine,
    /// Duration of the bench, s.
    pub(super) seconds: f64,
    /// The folder with the files.
    pub(super) folder: PathBuf,
}

/// Selects a series.
type Pick = fn(&Latencies) -> &hdrhistogram::Histogram<u64>;

impl Pace {
    /// The series in which Tectum and a bare transport are compared. At the cadence that is from the sensed
    /// observation to the sent command: how long the command then waits until it is applied depends on Tectum's
    /// design, not on its speed.
    pub(super) fn compared(self) -> (&'static str, Pick) {
        match self {
            Self::Cadence => (SERIES[1], |l| &l.sensed_to_command),
            Self::Saturated => (SERIES[3], |l| &l.sensed_to_applied),
        }
    }
}

/// Tectum over each bare transport with the same state of caches.
pub(super) fn ratios(pace: Pace, cases: &[CaseOutcome]) -> Vec<Ratio> {
    let mut ratios = Vec::new();
    for ours in cases.iter().filter(|case| case.transport == "tectum") {
        for theirs in cases.iter().filter(|case| case.transport != "tectum" && case.caches == ours.caches) {
            ratios.extend(same_series(pace, ours, theirs));
            if pace == Pace::Cadence {
                ratios.extend(over_round_trip(ours, theirs));
            }
        }
    }
    ratios
}

/// Tectum over a bare transport in the same series.
fn same_series(pace: Pace, ours: &CaseOutcome, theirs: &CaseOutcome) -> Option<Ratio> {
    let (name, pick) = pace.compared();
    let blocks = ours.medians.iter().zip(&theirs.medians).map(|(ours, theirs)| ours / theirs);
    ratio((ours, name, pick), (theirs, name, pick), Spread::of(blocks))
}

/// Tectum's observation to command over a bare transport's whole round trip.
fn over_round_trip(ours: &CaseOutcome, theirs: &CaseOutcome) -> Option<Ratio> {
    ratio((ours, SERIES[1], |l| &l.sensed_to_command), (theirs, SERIES[3], |l| &l.sensed_to_applied), None)
}

fn ratio(
    (ours, of, our_series): (&CaseOutcome, &'static str, Pick),
    (theirs, series, their_series): (&CaseOutcome, &'static str, Pick),
    p50_by_block: Option<Spread>,
) -> Option<Ratio> {
    let ours_us = Percentiles::of(our_series(&ours.latencies))?;
    let theirs_us = Percentiles::of(their_series(&theirs.latencies))?;
    let (p50, p99) = (ours_us.p50 / theirs_us.p50, ours_us.p99 / theirs_us.p99);
    Some(Ratio { of, to: theirs.transport, series, caches: ours.caches, p50, p99, p50_by_block })
}

impl LatencyOutcome {
    /// One JSON object.
    pub fn to_json(&self) -> String {
        serde_json::to_string(self).unwrap_or_default()
    }

    /// Writes the distributions and the object to the folder.
    pub(super) fn write(&mut self) -> Result<(), BenchError> {
        for case in &mut self.cases {
            for (name, histogram) in SERIES.into_iter().zip(case.latencies.series()) {
                let file = format!("{}.{}.{name}.hgrm", case.transport, case.caches.name());
                write_file(&self.folder.join(&file), &hgrm(histogram))?;
                case.files.push(file);
            }
        }
        write_file(&self.folder.join("latency.json"), &self.to_json())
    }

    /// The tables for people.
    pub fn to_text(&self) -> String {
        let how = match self.mode {
            Pace::Cadence => "every 50 ms",
            Pace::Saturated => "back to back",
        };
        let mut text = format!(
            "latency, {how}: {} s of each transport in {} blocks that took turns; \
             us from a tick's scheduled instant\n{}\n",
            self.seconds_each,
            self.rounds,
            self.machine.to_text()
        );
        self.cases.iter().for_each(|case| case.write_text(&mut text));
        text += "\nTectum over                      series             caches    p50   p99  (p50 by block)\n";
        self.ratios.iter().for_each(|ratio| ratio.write_text(&mut text));
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

    /// The latencies of every case with caches as usual, by transport.
    pub(super) fn distributions(&self) -> Vec<(&'static str, &Latencies)> {
        let usual = self.cases.iter().filter(|case| case.caches == Caches::Usual);
        usual.map(|case| (case.transport, &case.latencies)).collect()
    }
}

impl CaseOutcome {
    fn write_text(&self, text: &mut String) {
        let (name, caches) = (self.transport, self.caches.name());
        let counts = format!("{} ticks, missed {}, passed over {}", self.ticks, self.missed, self.skipped);
        let _ = writeln!(text, "{name}, caches {caches}: {counts}");
        for (name, p) in SERIES.into_iter().zip(self.series.all()) {
            let Some(p) = p else { continue };
            let _ = writeln!(
                text,
                "  {name:<21} p50 {:>9.1}  p90 {:>9.1}  p99 {:>9.1}  p99.9 {:>9.1}  max {:>9.1}",
                p.p50, p.p90, p.p99, p.p999, p.max
            );
        }
    }
}

impl Ratio {
    fn write_text(&self, text: &mut String) {
        let Self { of, to, series, caches, p50, p99, p50_by_block } = self;
        let series = if of == series { (*of).to_owned() } else { format!("{of} over its {series}") };
        let blocks = p50_by_block.map_or(String::new(), |s| format!("  ({:.2} to {:.2})", s.min, s.max));
        let _ = writeln!(text, "  {to:<15} {series:<42} {:<6} {p50:>5.2} {p99:>5.2}{blocks}", caches.name());
    }
}
