//! `tectum bench all`: all benches, and a page with figures beside the raw numbers.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use serde::Serialize;

use super::context::write_file;
use super::costs::Growth;
use super::targets::{TargetRow, targets};
use super::{
    BenchError, CallsSettings, CostsOutcome, LatencyOutcome, LatencySettings, LockstepOutcome, LockstepSettings,
    Machine, Pace, encoder, latency, learner, lockstep,
};
use crate::clock::monotonic_ns;
use crate::report::figure::{AxisScales, draw_scales};
use crate::supervise::RunFolder;
use crate::text::thousands;
use crate::timing::Latencies;

/// What to measure.
#[derive(Debug, Clone)]
pub struct AllBenches {
    /// The folder for the page, its figures and all numbers.
    pub report: PathBuf,
    /// For how long each case of the latency is measured, s.
    pub seconds: f64,
    /// Ticks of a block in lockstep.
    pub ticks: u64,
    /// Blocks of each case in lockstep.
    pub rounds: u64,
    /// Batches of each case of calls.
    pub batches: u64,
    /// Show a progress line on standard error.
    pub progress: bool,
}

/// All results: the object of `--json`.
#[derive(Debug, Clone, Serialize)]
pub struct AllOutcome {
    /// Targets and what was measured.
    targets: Vec<TargetRow>,
    /// Latency at the cadence.
    latency: LatencyOutcome,
    /// Latency back to back.
    saturated: LatencyOutcome,
    /// Ticks per second.
    lockstep: LockstepOutcome,
    /// The cost of encoding.
    encoder: CostsOutcome,
    /// The cost of learning.
    learner: CostsOutcome,
    /// The machine.
    machine: Machine,
    /// Duration of all benches, s.
    seconds: f64,
    /// The page.
    page: PathBuf,
}

/// Runs all benches, and writes the page, its figures and all numbers to the folder.
///
/// # Errors
/// As the single benches.
pub fn all(settings: &AllBenches) -> Result<AllOutcome, BenchError> {
    let folder = RunFolder::create(Some(&settings.report), None, "bench")?;
    let began = monotonic_ns();
    let machine = Machine::now(folder.path());
    let (progress, seconds, rounds) = (settings.progress, settings.seconds, settings.rounds);
    let part = |name: &str| Some(folder.path().join(name));
    // The short benches run first, so that wrong settings show early.
    let calls = |name: &str| CallsSettings { batches: settings.batches, out: part(name), progress };
    let encoder = encoder(&calls("encoder"))?;
    let learner = learner(&calls("learner"))?;
    let lockstep = lockstep(&LockstepSettings { ticks: settings.ticks, rounds, out: part("lockstep"), progress })?;
    let at = |pace: Pace| latency(&LatencySettings { pace, seconds, out: part(pace.name()), progress });
    let (saturated, latency) = (at(Pace::Saturated)?, at(Pace::Cadence)?);
    let outcome = AllOutcome {
        targets: targets(&latency, &lockstep, &encoder, &learner),
        latency,
        saturated,
        lockstep,
        encoder,
        learner,
        machine,
        seconds: (monotonic_ns() - began) as f64 / 1e9,
        page: folder.path().join("performance.md"),
    };
    folder.keep();
    outcome.write(folder.path())?;
    Ok(outcome)
}

impl AllOutcome {
    /// One JSON object.
    pub fn to_json(&self) -> String {
        serde_json::to_string(self).unwrap_or_default()
    }

    /// The table of targets, and the path of the page.
    pub fn to_text(&self) -> String {
        let mut text = self.machine.to_text() + "\n";
        for t in &self.targets {
            let met = if t.met { "met" } else { "not met" };
            let _ = writeln!(text, "{:<48} {:>9.3} for {:>6} {:<26} {met}", t.what, t.measured, t.target, t.unit);
        }
        let _ = writeln!(text, "\npage    {} ({:.0} s)", self.page.display(), self.seconds);
        text
    }

    fn write(&self, folder: &Path) -> Result<(), BenchError> {
        write_file(&folder.join("performance.json"), &self.to_json())?;
        let panels = [distributions(&self.latency), distributions(&self.saturated)];
        draw_scales("From process to process and back", &panels, &folder.join("latency.svg"))?;
        let panels = [growth("encoder", &self.encoder.growth), growth("learner", &self.learner.growth)];
        draw_scales("Cost by number of features", &panels, &folder.join("growth.svg"))?;
        write_file(&self.page, &self.page_text())
    }

    /// The text of the page, in Markdown.
    fn page_text(&self) -> String {
        let mut text = format!(
            "# Performance\n\nMeasured by `tectum bench all` on {} in {:.0} s.\n\n```text\n{}```\n\n{}",
            self.machine.date,
            self.seconds,
            self.machine.to_text(),
            table(&self.targets)
        );
        text += "\n## Latency\n\nDistributions by transport, caches as usual: at the cadence from the sensed \
                 observation to the sent command, back to back the whole round trip. Whole distributions of all \
                 series are in `cadence` and `saturated`, in HdrHistogram's text form (us).\n\n\
                 ![Distributions](latency.svg)\n\n";
        for part in [&self.latency, &self.saturated] {
            let _ = write!(text, "```text\n{}```\n\n", part.to_text());
        }
        let _ = write!(text, "## Lockstep\n\n```text\n{}```\n\n", self.lockstep.to_text());
        text += "## Calls\n\n![Growth](growth.svg)\n\n";
        for part in [&self.encoder, &self.learner] {
            let _ = write!(text, "```text\n{}```\n\n", part.to_text());
        }
        text
    }
}

/// The table of targets in Markdown.
fn table(targets: &[TargetRow]) -> String {
    let mut text = "| what | target | measured | measured / target | |\n|---|---|---|---|---|\n".to_owned();
    for t in targets {
        let met = if t.met { "met" } else { "not met" };
        let number = |x: f64| if x >= 1000.0 { thousands(x.round() as u64) } else { format!("{x:.3}") };
        let measured = number(t.measured);
        let _ = writeln!(text, "| {} | {} {} | {measured} | {:.2} | {met} |", t.what, t.target, t.unit, t.ratio);
    }
    text
}

/// The latency distributions by transport: us over 1 / (1 - percentile).
fn distributions(outcome: &LatencyOutcome) -> AxisScales {
    let (name, pick): (&str, fn(&Latencies) -> &hdrhistogram::Histogram<u64>) = match outcome.mode {
        Pace::Cadence => ("every 50 ms: sensed to command", |l| &l.sensed_to_command),
        Pace::Saturated => ("back to back: sensed to applied", |l| &l.sensed_to_applied),
    };
    let curve = |latencies: &Latencies| {
        let histogram = pick(latencies);
        let steps = histogram.iter_quantiles(5).filter(|step| step.quantile_iterated_to() < 1.0);
        steps.map(|s| (1.0 / (1.0 - s.quantile_iterated_to()), s.value_iterated_to() as f64 / 1000.0)).collect()
    };
    AxisScales {
        name: name.to_owned(),
        x: "percentile".to_owned(),
        y: "us".to_owned(),
        label_x: |x| {
            let digits = (x.log10().round() as usize).saturating_sub(2);
            format!("{:.digits$} %", 100.0 * (1.0 - 1.0 / x))
        },
        curves: outcome.distributions().into_iter().map(|(name, all)| (name.to_owned(), curve(all))).collect(),
    }
}

/// The growth of costs: ns per call over features.
fn growth(name: &str, growth: &[Growth]) -> AxisScales {
    let mut curves: Vec<(String, Vec<(f64, f64)>)> = Vec::new();
    for g in growth {
        let name = format!("{}, {}", g.what, g.path);
        let point = (g.features as f64, g.ns.median);
        match curves.iter_mut().find(|(known, _)| *known == name) {
            Some((_, curve)) => curve.push(point),
            None => curves.push((name, vec![point])),
        }
    }
    AxisScales {
        name: name.to_owned(),
        x: "features".to_owned(),
        y: "ns a call".to_owned(),
        label_x: |x| thousands(x.round() as u64),
        curves,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_table_is_markdown() {
        let target = TargetRow { what: "a", target: 85.0, measured: 42.5, unit: "ns", ratio: 0.5, met: true };
        let text = table(&[target]);
        assert_eq!(text.lines().last(), Some("| a | 85 ns | 42.500 | 0.50 | met |"));
        assert!(text.lines().all(|line| line.matches('|').count() == 6), "{text}");
    }
}
