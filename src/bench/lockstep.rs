//! `tectum bench lockstep`: ticks per second of three processes with a complete log and with a thinned one, and
//! of one process, against bare iceoryx2 that polls and yields with the same payload; in blocks that take
//! turns.

use std::collections::BTreeSet;
use std::fmt::Write as _;
use std::path::PathBuf;

use serde::Serialize;

use super::context::{BenchContext, check_signals, write_file};
use super::latency::PERIOD_NS;
use super::run_block::{self, RunBlock};
use super::usage::{Usage, core_of, cores_text};
use super::{BenchError, Machine};
use crate::clock::{TerminationSignals, monotonic_ns};
use crate::runtime::{Controller, Mode, simulate};
use crate::stats::Spread;
use crate::supervise::simulated_plant;
use crate::text::thousands;
use crate::timing::{PeerExchange, Transport};

/// The thinned log has one tick in this many, as in the paper's scenario.
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
    /// The folder for the results; without one, `runs/bench-lockstep-<n>`.
    pub out: Option<PathBuf>,
    /// Show a progress line on standard error.
    pub progress: bool,
}

/// The rate of one case.
#[derive(Debug, Clone, Serialize)]
pub(crate) struct CaseRate {
    /// Its name.
    pub case: &'static str,
    /// Ticks, or round trips, per second: the spread over the blocks.
    pub per_second: Spread,
    /// The same block by block.
    pub blocks: Vec<f64>,
    /// As a share of bare iceoryx2 in the same round; null for bare iceoryx2 itself.
    pub share_of_bare: Option<Spread>,
    /// The cores on which its processes ran.
    pub cores: BTreeSet<u32>,
    /// The resources that its processes used; null for one process, and for bare iceoryx2.
    pub usage: Option<Usage>,
}

/// All results: the object of `--json`.
#[derive(Debug, Clone, Serialize)]
pub struct LockstepOutcome {
    /// Ticks of a block.
    ticks: u64,
    /// Blocks of each case.
    rounds: u64,
    /// Each case.
    pub(super) cases: Vec<CaseRate>,
    /// The machine.
    machine: Machine,
    /// Duration of the bench, s.
    seconds: f64,
    /// The folder with the files.
    folder: PathBuf,
}

/// What is collected of one case, block by block.
#[derive(Default)]
struct CaseBlocks {
    rates: Vec<f64>,
    usage: Usage,
    cores: BTreeSet<u32>,
}

/// Measures ticks per second.
///
/// # Errors
/// When the folder cannot be used, a run or the peer process fails, or a signal ends the bench.
pub fn lockstep(settings: &LockstepSettings) -> Result<LockstepOutcome, BenchError> {
    if settings.ticks < 100 || settings.rounds == 0 {
        return Err(BenchError::Asked("--ticks is to be at least 100, and --rounds at least 1".to_owned()));
    }
    let mut context = BenchContext::start(settings.out.as_deref(), "bench-lockstep", settings.progress)?;
    let mut blocks: [CaseBlocks; 4] = Default::default();
    for round in 0..settings.rounds {
        for (case, name) in CASES.into_iter().enumerate() {
            context.progress.show(&format!("lockstep: round {} of {}, {name}", round + 1, settings.rounds));
            measure_block(case, settings.ticks, &context, &mut blocks[case])?;
        }
    }
    context.progress.clear();
    let outcome = LockstepOutcome {
        ticks: settings.ticks,
        rounds: settings.rounds,
        cases: rates(blocks),
        seconds: context.seconds(),
        machine: context.machine,
        folder: context.folder.path().to_owned(),
    };
    context.folder.keep();
    write_file(&outcome.folder.join("lockstep.json"), &outcome.to_json())?;
    Ok(outcome)
}

/// Measures one block of the case with the index `case`.
fn measure_block(case: usize, ticks: u64, context: &BenchContext, into: &mut CaseBlocks) -> Result<(), BenchError> {
    let block = |log_every| RunBlock { mode: Mode::Lockstep, ticks, log_every, period_ns: PERIOD_NS, timed: false };
    let rate = match case {
        0 | 1 => {
            let outcome = run_block::measure(&block([1, THINNED][case]), context.folder.path())?;
            into.cores.extend(outcome.usage.processes.iter().flat_map(|p| &p.cores));
            into.usage.add(&outcome.usage);
            outcome.ticks_per_second
        }
        2 => {
            let rate = one_process(&block(THINNED), &context.signals)?;
            into.cores.extend(core_of(std::process::id()));
            rate
        }
        _ => {
            let mut exchange = PeerExchange::start(Transport::Poll, &context.signals)?;
            let ns = exchange.rounds(ticks)?;
            into.cores.extend([std::process::id(), exchange.peer()].into_iter().filter_map(core_of));
            ticks as f64 * 1e9 / ns.max(1) as f64
        }
    };
    into.rates.push(rate);
    Ok(())
}

/// Ticks per second of plant and controller in this process.
fn one_process(block: &RunBlock, signals: &TerminationSignals) -> Result<f64, BenchError> {
    let plan = run_block::plan(block)?;
    let plant = simulated_plant(&plan)?;
    let began = monotonic_ns();
    let _ = simulate(&plan, plant, Controller::new(&plan), &mut |observation, _| {
        !observation.header.tick.is_multiple_of(4096) || signals.received() == 0
    });
    let ns = monotonic_ns() - began;
    check_signals(signals)?;
    Ok(block.ticks as f64 * 1e9 / ns.max(1) as f64)
}

/// The rates of all cases, each compared with the last one in the same round.
fn rates(blocks: [CaseBlocks; 4]) -> Vec<CaseRate> {
    let bare = blocks[3].rates.clone();
    let each = CASES.into_iter().zip(blocks).enumerate();
    each.filter_map(|(i, (case, CaseBlocks { rates, usage, cores }))| {
        let share = Spread::of(rates.iter().zip(&bare).map(|(rate, bare)| rate / bare));
        Some(CaseRate {
            case,
            per_second: Spread::of(rates.iter().copied())?,
            blocks: rates,
            share_of_bare: share.filter(|_| i < 3),
            cores,
            usage: (i < 2).then_some(usage),
        })
    })
    .collect()
}

impl LockstepOutcome {
    /// One JSON object.
    pub fn to_json(&self) -> String {
        serde_json::to_string(self).unwrap_or_default()
    }

    /// The table for people.
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
            let _ = writeln!(text, "  on core {}", cores_text(&case.cores));
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
        let rates_of = [[50.0, 90.0], [75.0, 150.0], [400.0, 400.0], [100.0, 200.0]];
        let found = rates(rates_of.map(|rates| CaseBlocks { rates: rates.to_vec(), ..CaseBlocks::default() }));
        let shares: Vec<_> = found.iter().map(|case| case.share_of_bare.map(|s| (s.min, s.max))).collect();
        assert_eq!(shares, [Some((0.45, 0.5)), Some((0.75, 0.75)), Some((2.0, 4.0)), None]);
        assert_eq!(found[0].per_second.max, 90.0);
    }
}
