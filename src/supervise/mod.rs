//! Launching and supervising a run: a folder, a domain, processes, phases, and an orderly end.
//!
//! The launcher creates every service of the run and holds it until all processes have ended; the processes only open
//! them. It leads them through the phases (ports made, connected, go), watches their boards and their lives, and ends
//! the run when it is done, when a signal comes, or when a process fails. Whatever happens, it leaves no process and no
//! shared memory behind.

mod children;
mod error;
mod evaluation;
mod fault_injector;
mod folder;
mod history;
mod in_process;
mod learning_progress;
mod progress;
mod restarts;
mod resume;
mod summary;
mod summary_text;
mod supervisor;

pub use error::LaunchError;
pub(crate) use folder::RunFolder;
pub(crate) use history::reach;
pub use in_process::study;
pub(crate) use progress::RunProgress;
pub use restarts::RestartIncident;
pub use resume::resume;
pub use summary::{ProcessRealtime, RunOutcome, RunSummary, WindowSummary};

use std::path::{Path, PathBuf};

use children::ChildProcesses;
use supervisor::Supervisor;

use crate::channel::{DomainName, RunServices, remove_stale_domains};
use crate::clock::{RealtimeRefusal, TerminationSignals, monotonic_ns, wall_ns};
use crate::process::say;
use crate::runtime::{Mode, ResumePoint, RunManifest, WireManifest, identity, read_realtime, snapshot_path};
use crate::scenario::Plan;
use crate::wire::{Control, Role};

/// What to run, and how.
#[derive(Debug, Clone)]
pub struct Launch {
    /// The scenario.
    pub plan: Plan,
    /// Lockstep or real time.
    pub mode: Mode,
    /// The folder for the run; without one, `runs/<scenario>-<n>`.
    pub out: Option<PathBuf>,
    /// The run's name, in place of `<scenario>-<n>`.
    pub name: Option<String>,
    /// Processes that somebody else starts.
    pub by_hand: Vec<Role>,
    /// A checkpoint every so many ticks; 0: only at the end.
    pub checkpoint_every: u64,
    /// In lockstep: leave the real instants of each tick in the run's folder, for `tectum bench`.
    pub stopwatch: bool,
    /// Where the run begins, if it goes on with another one ([`resume`]).
    pub resumed: Option<ResumePoint>,
    /// Show a progress line on standard error.
    pub progress: bool,
}

/// Real time: from the last process's being connected to tick 0.
const LEAD_NS: u64 = 100_000_000;
/// Runs a scenario with its processes.
///
/// # Errors
/// When the run cannot begin. A run that began always gives a summary, which says how it ended.
pub fn run(launch: &Launch) -> Result<RunSummary, LaunchError> {
    let signals = TerminationSignals::install().map_err(LaunchError::Signals)?;
    let plan = &launch.plan;
    let folder = RunFolder::create(launch.out.as_deref(), launch.name.as_deref(), &plan.scenario.name)?;
    folder.check_room(plan)?;

    // What a launcher that was killed could not take away any more.
    for left in remove_stale_domains(false) {
        say(&format!("tectum: removed {} from shared memory, which a run that was killed had left", left.domain));
    }
    let run = run_id(plan);
    let domain = DomainName::of(run);
    let services = RunServices::create(&domain, &identity(plan), &plan.scenario.channels, plan.scenario.vision())?;
    let manifest = RunManifest {
        run: format!("{run:016x}"),
        wire: Some(WireManifest::of(plan, &domain)),
        mode: launch.mode,
        domain,
        launcher: std::process::id(),
        checkpoint_every: launch.checkpoint_every,
        stopwatch: launch.stopwatch,
        resumed: launch.resumed.clone(),
    };
    folder.write_manifest(&manifest, plan)?;

    services.control.put(Control::default());
    let children = ChildProcesses::start(plan, folder.path(), &launch.by_hand)?;
    let progress = RunProgress::new(launch, &folder);
    let mut run = Supervisor::new(launch, services, children, signals, progress, &manifest.domain);
    run.set_up(launch)?;
    folder.keep();
    if let Some(resumed) = &launch.resumed {
        // The policies of the part before. Best effort: without them the summary knows less.
        let _ = std::fs::copy(snapshot_path(&resumed.from), snapshot_path(folder.path()));
    }
    if launch.mode == Mode::Realtime {
        warn_of_refusals(folder.path());
    }

    let began = monotonic_ns();
    // At a whole multiple of the period, so that anybody can tell when ticks begin without asking; where that is long, soon.
    let start = (began + LEAD_NS).next_multiple_of(plan.period_ns.clamp(1, LEAD_NS));
    run.go(if launch.mode == Mode::Realtime { start } else { 0 });
    let seconds = run.close(began);
    // The domain goes with the run, before anything is drawn or printed.
    let end = run.end();
    for death in &end.deaths {
        folder.keep_words(death);
    }
    Ok(RunSummary::of_run(launch, folder.path(), end, seconds))
}

/// Says what the processes asked of the operating system and were refused. The run goes on without.
fn warn_of_refusals(folder: &Path) {
    for role in Role::ALL {
        for refusal in read_realtime(folder, role).into_iter().flat_map(|report| report.refused) {
            let (name, RealtimeRefusal { what, why, remedy }) = (role.name(), refusal);
            say(&format!("tectum: warning: the {name} asked for {what} and does not have it ({why}); {remedy}"));
        }
    }
}

/// A run's id: different for every run on this machine, also for two that start at the same instant.
fn run_id(plan: &Plan) -> u64 {
    let mut bytes = [0; 28];
    bytes[..8].copy_from_slice(&wall_ns().to_le_bytes());
    bytes[8..16].copy_from_slice(&monotonic_ns().to_le_bytes());
    bytes[16..20].copy_from_slice(&std::process::id().to_le_bytes());
    bytes[20..].copy_from_slice(&plan.hash.to_le_bytes());
    xxhash_rust::xxh3::xxh3_64(&bytes)
}
