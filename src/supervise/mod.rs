//! Launching and supervising a run: folder, shared-memory domain, processes, phases, and an orderly end.
//!
//! The launcher creates every service of the run and holds it until all processes have ended; the processes
//! only open services. The launcher leads the processes through the phases (ports created, connected, running),
//! watches their status boards and whether they still run, and restarts those that die or hang. It ends the run
//! when all ticks are done, when a signal comes, or when a process fails. In every case it leaves no process
//! and no shared memory behind.

mod children;
mod error;
mod error_output;
mod evaluation;
mod fault_injector;
mod folder;
mod folder_watch;
mod history;
mod in_process;
mod learned_state;
mod learning_progress;
mod log_packing;
mod policy_file;
mod process_world;
mod progress;
mod progress_line;
mod restarts;
mod resume;
mod run_handle;
mod run_monitor;
mod service_notifier;
mod stall;
mod stand_in;
mod summary;
mod summary_text;
mod supervisor;
mod world;

pub use error::LaunchError;
pub(crate) use folder::RunFolder;
pub(crate) use history::{body_changes, ends as window_ends, reach};
pub use in_process::run_in_process;
pub(crate) use in_process::simulated_plant;
pub use learned_state::LearnedState;
pub use policy_file::{PolicyAxis, PolicyFacts, export_policy};
pub(crate) use progress::RunProgress;
pub(crate) use progress_line::ProgressLine;
pub use restarts::RestartIncident;
pub use resume::{ResumedRun, resume};
pub use run_handle::RunHandle;
pub use run_monitor::{RunMonitor, RunStatus};
pub use stand_in::StandIn;
pub use summary::{ProcessRealtime, RunOutcome, RunSummary, WindowSummary};

use std::path::{Path, PathBuf};
use std::sync::Arc;

// For the simulation of the launcher's loop in tests/.
#[doc(hidden)]
pub use children::{DeathKind, ProcessDeath, ProcessFailure};
#[doc(hidden)]
pub use supervisor::{RunEnd, Supervisor, SupervisorRules};
#[doc(hidden)]
pub use world::{ProcessAction, SupervisedWorld};

use children::ChildProcesses;
use folder_watch::FolderWatch;
use process_world::{ProcessWorld, RunOwner};
use service_notifier::ServiceNotifier;

use crate::channel::{DomainName, RunServices, WatchFiles, check_shared_memory, remove_stale_domains};
use crate::clock::{RealtimeRefusal, TerminationSignals, monotonic_ns, wall_ns};
use crate::process::print_error_line;
use crate::runtime::{Mode, ResumePoint, RunManifest, WireManifest, identity, read_realtime, snapshot_path};
use crate::scenario::Plan;
use crate::wire::{Control, Role};

/// What to run, and how.
#[derive(Debug, Clone)]
pub struct Launch {
    /// The validated scenario.
    pub plan: Plan,
    /// Lockstep, real time or in one process.
    pub mode: Mode,
    /// The run's folder; without one, `runs/<name>` or `runs/<scenario>-<n>`.
    pub out: Option<PathBuf>,
    /// The run's name, in place of `<scenario>-<n>`.
    pub name: Option<String>,
    /// Processes that the user starts.
    pub by_hand: Vec<Role>,
    /// Number of ticks from one checkpoint to the next; 0: only one at the end.
    pub checkpoint_every: u64,
    /// Number of checkpoints of each process that are kept, the newest ones; 0: all.
    pub keep_checkpoints: u64,
    /// In lockstep: write the real instants of each tick to the run's folder, for `tectum bench`.
    pub stopwatch: bool,
    /// The program that takes the place of a process on another machine, if there is one.
    pub stand_in: Option<StandIn>,
    /// Where the run starts, if it resumes another one ([`resume()`]).
    pub resumed: Option<ResumePoint>,
    /// The learner with which the run begins, in place of a fresh one. [`LearnedState::check`] has accepted it.
    pub started_from: Option<LearnedState>,
    /// Whether the learner is frozen: it neither learns nor explores.
    pub frozen: bool,
    /// Show a progress line on standard error.
    pub progress: bool,
}

/// In real time: from the moment when the last process is connected to tick 0, ns, at least. Long enough for all to see
/// it, also on a machine that is busy.
const LEAD_NS: u64 = 30_000_000;
/// The longest period at a multiple of which a run begins, ns.
const LONGEST_ALIGNED_NS: u64 = 100_000_000;

impl Launch {
    /// A run of `plan` in processes of their own (`mode` is lockstep or real time), with no more than that: in a new
    /// folder under `runs/`, with a checkpoint at its end, without a progress line.
    pub fn new(plan: Plan, mode: Mode) -> Self {
        Self {
            plan,
            mode,
            out: None,
            name: None,
            by_hand: Vec::new(),
            checkpoint_every: 0,
            keep_checkpoints: 0,
            stopwatch: false,
            stand_in: None,
            resumed: None,
            started_from: None,
            frozen: false,
            progress: false,
        }
    }
}

/// Runs a scenario in processes of its own. Signals end it in good order.
///
/// # Errors
/// When the run cannot start. A run that started always returns a summary, which tells how it ended.
pub fn run(launch: &Launch) -> Result<RunSummary, LaunchError> {
    run_owned(launch, RunMonitor::default())
}

/// The same, and others in this process see through `monitor` how far it is.
///
/// # Errors
/// As [`run`].
pub fn run_monitored(launch: &Launch, monitor: &RunMonitor) -> Result<RunSummary, LaunchError> {
    run_owned(launch, monitor.clone())
}

fn run_owned(launch: &Launch, monitor: RunMonitor) -> Result<RunSummary, LaunchError> {
    let signals = TerminationSignals::install_with_pipe().map_err(LaunchError::Signals)?;
    let notifier = ServiceNotifier::from_environment().unwrap_or_else(|cause| {
        print_error_line(&format!("tectum: warning: {cause}; the service manager is told nothing"));
        ServiceNotifier::default()
    });
    launch_run(launch, RunOwner { signals, monitor, notifier })
}

fn launch_run(launch: &Launch, owner: RunOwner) -> Result<RunSummary, LaunchError> {
    owner.notifier.extend_set_up(launch.plan.scenario.restart.set_up_s);
    let plan = &launch.plan;
    let folder = RunFolder::create(launch.out.as_deref(), launch.name.as_deref(), &plan.scenario.name)?;
    folder.check_room(plan)?;

    // A launcher that was killed could not remove its own.
    for left in remove_stale_domains(false) {
        print_error_line(&format!(
            "tectum: removed {} from shared memory, which a run that was killed had left",
            left.domain
        ));
    }
    check_shared_memory()?;
    let run_id = run_id(plan);
    let domain = DomainName::of(run_id);
    let scenario = &plan.scenario;
    let (vision, ahead) = (scenario.vision(), scenario.link.ahead > 0);
    let services = RunServices::create(&domain, &identity(plan), &scenario.channels, vision, ahead)?;
    // Before the manifest, by which watchers know a run.
    let watch_files = Arc::new(WatchFiles::create(&domain, folder.path()));
    if let Some(learned) = launch.started_from.as_ref().filter(|_| launch.resumed.is_none()) {
        learned.copy_to(folder.path())?;
    }
    folder.write_manifest(&manifest(launch, run_id, &domain), plan)?;
    owner.monitor.begin(folder.path().to_owned());

    services.control.put(Control::default());
    let children = ChildProcesses::start(launch, folder.path(), Arc::clone(&watch_files))?;
    let progress = RunProgress::new(launch, &folder);
    let folder_watch = FolderWatch::new(&folder);
    let world = ProcessWorld::new(children, services, folder_watch, watch_files, progress, owner);
    let mut supervisor = Supervisor::new(world, &rules(launch));
    if let Err(error) = supervisor.set_up() {
        // A traceback is more than the sentence that the error repeats.
        let long = |death: &&ProcessFailure| death.stderr.trim().lines().count() > 1;
        supervisor.deaths().iter().filter(long).for_each(|death| folder.write_stderr(death));
        return Err(error);
    }
    folder.keep();
    if let Some(resumed) = &launch.resumed {
        // The policies of the part before. Best effort: without them the summary knows less. Their checksums hold the
        // scenario's hash, which another number of ticks changes.
        if resumed.scenario.is_none() {
            let _ = std::fs::copy(snapshot_path(&resumed.from), snapshot_path(folder.path()));
        }
    }
    if launch.mode == Mode::Realtime {
        warn_of_refusals(folder.path());
    }

    let began = monotonic_ns();
    // At a whole multiple of the period, so that every process can compute when ticks begin. With a longer period, the
    // run does not wait for the next one.
    let start = (began + LEAD_NS).next_multiple_of(plan.period_ns.clamp(1, LONGEST_ALIGNED_NS));
    let start = launch.stand_in.as_ref().and_then(|stand_in| stand_in.start_ns(folder.path())).unwrap_or(start);
    supervisor.run_ticks(if launch.mode == Mode::Realtime { start } else { 0 });
    let seconds = supervisor.close(began);
    // This removes the domain, before anything is drawn or printed.
    let end = supervisor.into_end();
    for death in &end.deaths {
        folder.write_stderr(death);
    }
    Ok(RunSummary::of_run(launch, folder.path(), end, seconds))
}

fn rules(launch: &Launch) -> SupervisorRules {
    SupervisorRules {
        realtime: launch.mode == Mode::Realtime,
        waits: !launch.by_hand.is_empty() || launch.stand_in.is_some(),
        restart: launch.plan.scenario.restart.clone(),
        faults: launch.plan.scenario.faults.clone(),
    }
}

fn manifest(launch: &Launch, run_id: u64, domain: &DomainName) -> RunManifest {
    RunManifest {
        run: format!("{run_id:016x}"),
        wire: Some(WireManifest::of(&launch.plan, domain)),
        mode: launch.mode,
        source: launch.plan.scenario.source.name().to_owned(),
        scenario_folder: launch.plan.scenario.source.folder().map(Into::into),
        domain: domain.clone(),
        launcher: std::process::id(),
        launched_wall_ns: wall_ns(),
        checkpoint_every: launch.checkpoint_every,
        keep_checkpoints: launch.keep_checkpoints,
        stopwatch: launch.stopwatch,
        resumed: launch.resumed.clone(),
        started_from: launch.started_from.as_ref().filter(|_| launch.resumed.is_none()).map(LearnedState::point),
        frozen: launch.frozen,
    }
}

/// Warns of what the processes asked of the operating system and did not get. The run continues without it.
fn warn_of_refusals(folder: &Path) {
    for role in Role::ALL {
        for refusal in read_realtime(folder, role).into_iter().flat_map(|report| report.refused) {
            let (name, RealtimeRefusal { what, why, remedy }) = (role.name(), refusal);
            print_error_line(&format!(
                "tectum: warning: the {name} asked for {what} and does not have it ({why}); {remedy}"
            ));
        }
    }
}

/// A run's id. It differs between all runs on this machine, even between two that start at the same instant.
fn run_id(plan: &Plan) -> u64 {
    let mut bytes = [0; 28];
    bytes[..8].copy_from_slice(&wall_ns().to_le_bytes());
    bytes[8..16].copy_from_slice(&monotonic_ns().to_le_bytes());
    bytes[16..20].copy_from_slice(&std::process::id().to_le_bytes());
    bytes[20..].copy_from_slice(&plan.hash.to_le_bytes());
    xxhash_rust::xxh3::xxh3_64(&bytes)
}
