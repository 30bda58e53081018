//! `tectum bench lockstep`: ticks a second of three processes with a complete log and with a thinned one, and of one process,
//! against bare iceoryx2 that polls and yields with the same payload; in blocks that take turns.

use std::collections::BTreeSet;
use std::fmt::Write as _;
use std::path::PathBuf;

use serde::Serialize;

use super::run_block::{self, RunBlock};
use super::{BenchError, Machine, PeerExchange, Transport, Usage, latency::PERIOD_NS, usage::core_of};
use crate::clock::{TerminationSignals, monotonic_ns};
use crate::plant::SimulatedPlant;
use crate::report::thousands;
use crate::runtime::{Mode, in_process};
use crate::study::Spread;
use crate::supervise::{LaunchError, ProgressLine, RunFolder};

/// The thinned log has every so many ticks, as the paper's scenario.
const THINNED: u64 = 100;
/// The cases, in the order of their turns.
const CASES: [&str; 4] = ["complete log", "every 100th tick logged", "one process", "bare iceoryx2, poll and yield"];

/// What to measure.
#[derive(Debug, Clone)]
pub struct LockstepSettings {
    /// Ticks of a block.
    pub ticks: u64,
    /// Blocks of each case.
    pub rounds: u64,
    /// The folder; `runs/bench-lockstep-<n>` if there is none.
    pub out: Option<PathBuf>,
    /// Show a progress line on standard error.
    pub progress: bool,
}

/// One case.
#[derive(Debug, Clone, Serialize)]
pub struct CaseRate {
    /// Which.
    pub case: &'static str,
    /// Ticks, or round trips, a second: over the blocks.
    pub per_second: Spread,
    /// The same block by block.
    pub blocks: Vec<f64>,
    /// As a share of bare iceoryx2 in the same round; null for itself.
    pub share_of_bare: Option<Spread>,
    /// The cores on which its processes were seen.
    pub cores: BTreeSet<u32>,
    /// What its processes used; null for one process, and for bare iceoryx2.
    pub usage: Option<Usage>,
}

/// Everything that was measured: the object of `--json`.
#[derive(Debug, Clone, Serialize)]
pub struct LockstepOutcome {
    /// Ticks of a block.
    pub ticks: u64,
    /// Blocks of each case.
    pub rounds: u64,
    /// Each case.
    pub cases: Vec<CaseRate>,
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
pub fn lockstep(asked: &LockstepSettings) -> Result<LockstepOutcome, BenchError> {
    if asked.ticks < 100 || asked.rounds == 0 {
        return Err(BenchError::Asked("--ticks is to be at least 100, and --rounds at least 1".to_owned()));
    }
    let signals = TerminationSignals::install().map_err(LaunchError::Signals)?;
    let folder = RunFolder::create(asked.out.as_deref(), None, "bench-lockstep")?;
    let began = monotonic_ns();
    let machine = Machine::now(folder.path());
    let mut progress = ProgressLine::new(asked.progress);
    let mut rates: [Vec<f64>; 4] = Default::default();
    let mut usage = [Usage::default(), Usage::default()];
    let mut seen: [BTreeSet<u32>; 4] = Default::default();
    for round in 0..asked.rounds {
        for (case, name) in CASES.into_iter().enumerate() {
            progress.show(&format!("lockstep: round {} of {}, {name}", round + 1, asked.rounds));
            let block =
                |every| RunBlock { mode: Mode::Lockstep, ticks: asked.ticks, every, period: PERIOD_NS, timed: false };
            let rate = match case {
                0 | 1 => {
                    let lived = run_block::measure(&block([1, THINNED][case]), folder.path())?;
                    seen[case].extend(lived.usage.processes.iter().flat_map(|p| &p.cores));
                    usage[case].add(&lived.usage);
                    lived.ticks_per_second
                }
                2 => {
                    let rate = alone(&block(THINNED), &signals)?;
                    seen[case].extend(core_of(std::process::id()));
                    rate
                }
                _ => {
                    let mut exchange = PeerExchange::start(Transport::Poll, &signals)?;
                    let ns = exchange.rounds(asked.ticks)?;
                    seen[case].extend([std::process::id(), exchange.peer()].into_iter().filter_map(core_of));
                    asked.ticks as f64 * 1e9 / ns.max(1) as f64
                }
            };
            rates[case].push(rate);
        }
    }
    drop(progress);
    let [complete, thinned] = usage;
    let usage = [Some(complete), Some(thinned), None, None];
    let outcome = LockstepOutcome {
        ticks: asked.ticks,
        rounds: asked.rounds,
        cases: cases(rates, usage, seen),
        machine,
        seconds: (monotonic_ns() - began) as f64 / 1e9,
        folder: folder.path().to_owned(),
    };
    folder.keep();
    let path = folder.path().join("lockstep.json");
    std::fs::write(&path, outcome.to_json()).map_err(BenchError::write(&path))?;
    Ok(outcome)
}

/// Plant and controller in this process: ticks a second.
fn alone(block: &RunBlock, signals: &TerminationSignals) -> Result<f64, BenchError> {
    let plan = run_block::plan(block)?;
    let body =
        SimulatedPlant::of(&plan).ok_or_else(|| LaunchError::NotSimulated(plan.scenario.plant.program.clone()))?;
    let began = monotonic_ns();
    let _ = in_process(&plan, body, |_, _| signals.received() == 0);
    let ns = monotonic_ns() - began;
    match signals.received() {
        0 => Ok(block.ticks as f64 * 1e9 / ns.max(1) as f64),
        number => Err(BenchError::Signal(number)),
    }
}

/// From the rates by case and round to what is told. The last case is the one that the others are compared with.
fn cases(rates: [Vec<f64>; 4], usage: [Option<Usage>; 4], cores: [BTreeSet<u32>; 4]) -> Vec<CaseRate> {
    let bare = rates[3].clone();
    let each = CASES.into_iter().zip(rates).zip(usage.into_iter().zip(cores)).enumerate();
    each.filter_map(|(i, ((case, blocks), (usage, cores)))| {
        let share = Spread::of(blocks.iter().zip(&bare).map(|(rate, bare)| rate / bare));
        Some(CaseRate {
            case,
            per_second: Spread::of(blocks.iter().copied())?,
            blocks,
            share_of_bare: share.filter(|_| i < 3),
            cores,
            usage,
        })
    })
    .collect()
}

impl LockstepOutcome {
    /// One JSON object.
    pub fn to_json(&self) -> String {
        serde_json::to_string(self).unwrap_or_default()
    }

    /// What a reader of tables needs to know.
    pub fn to_text(&self) -> String {
        let mut text = format!(
            "lockstep: {} blocks of {} ticks of each, in turns\n{}\n{:<30} {:>11}  {:>23}  share of bare iceoryx2\n",
            self.rounds,
            thousands(self.ticks),
            self.machine.to_text(),
            "",
            "ticks/s",
            "least to most",
        );
        let count = |x: f64| thousands(x.round() as u64);
        for case in &self.cases {
            let Spread { min, median, max } = case.per_second;
            let span = format!("{} to {}", count(min), count(max));
            let _ = write!(text, "{:<30} {:>11}  {span:>23}", case.case, count(median));
            if let Some(share) = case.share_of_bare {
                let _ = write!(text, "  {:.3} ({:.3} to {:.3})", share.median, share.min, share.max);
            }
            let cores: Vec<_> = case.cores.iter().map(u32::to_string).collect();
            let _ = writeln!(text, "  on core {}", cores.join(", "));
        }
        for case in &self.cases {
            if let Some(usage) = &case.usage {
                let _ = write!(text, "\n{}: {}", case.case, usage.to_text());
            }
        }
        let _ = writeln!(text, "files   {}", self.folder.display());
        text
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shares_are_taken_round_by_round() {
        let rates = [vec![50.0, 90.0], vec![75.0, 150.0], vec![400.0, 400.0], vec![100.0, 200.0]];
        let told = cases(rates, [const { None }; 4], Default::default());
        let shares: Vec<_> = told.iter().map(|case| case.share_of_bare.map(|s| (s.min, s.max))).collect();
        assert_eq!(shares, [Some((0.45, 0.5)), Some((0.75, 0.75)), Some((2.0, 4.0)), None]);
        assert_eq!(told[0].per_second.max, 90.0);
    }
}
