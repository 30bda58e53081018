//! The launcher's real world: its children, the run's services in shared memory, and those who look at the run.

use std::sync::Arc;
use std::time::Duration;

use super::children::{ChildProcesses, ProcessDeath};
use super::folder_watch::FolderWatch;
use super::run_monitor::RunMonitor;
use super::service_notifier::ServiceNotifier;
use super::world::{ProcessAction, SupervisedWorld};
use super::{LaunchError, RunProgress};
use crate::channel::{BoardsCopy, DomainName, RunServices, WatchFiles, fill_domain, reclaim_dead};
use crate::clock::{TerminationSignals, monotonic_ns, pause};
use crate::process::print_error_line;
use crate::wire::{Control, Role, Status};

/// How long it may take to reclaim the shared memory of a dead process.
const RECLAIM_LIMIT: Duration = Duration::from_secs(5);

/// How a run is connected with whoever started it.
#[derive(Debug)]
pub(super) struct RunOwner {
    /// The signals that end the run or ask for a checkpoint.
    pub signals: TerminationSignals,
    /// Who looks at it from this process.
    pub monitor: RunMonitor,
    /// The service manager that has started this process, if one has.
    pub notifier: ServiceNotifier,
}

/// The real world of a run.
pub(super) struct ProcessWorld {
    // `children` drops before `services`: a process that is still setting up would create files in a domain
    // that is already removed.
    children: ChildProcesses,
    services: RunServices,
    domain: DomainName,
    folder: FolderWatch,
    watch_files: Arc<WatchFiles>,
    progress: RunProgress,
    owner: RunOwner,
}

impl ProcessWorld {
    pub fn new(
        children: ChildProcesses,
        services: RunServices,
        folder: FolderWatch,
        watch_files: Arc<WatchFiles>,
        progress: RunProgress,
        owner: RunOwner,
    ) -> Self {
        let domain = services.domain().clone();
        Self { children, services, domain, folder, watch_files, progress, owner }
    }
}

impl SupervisedWorld for ProcessWorld {
    fn now_ns(&self) -> u64 {
        monotonic_ns()
    }

    fn pause(&mut self, ns: u64) {
        pause(ns);
    }

    fn await_event(&mut self, ns: u64) {
        if self.children.await_end(ns, self.owner.signals.pipe()) {
            self.owner.signals.drain_pipe();
        }
    }

    fn signal(&self) -> u32 {
        self.owner.signals.received()
    }

    fn checkpoint_asked(&mut self) -> bool {
        self.owner.signals.checkpoint_asked()
    }

    fn status(&self, role: Role) -> Status {
        self.services.status(role)
    }

    fn put_control(&mut self, control: Control) {
        self.services.control.put(control);
    }

    fn publish(&mut self, boards: BoardsCopy) {
        self.watch_files.put(boards);
        self.owner.monitor.put(boards);
        self.owner.notifier.look(&boards, monotonic_ns());
    }

    fn is_watched(&self) -> bool {
        self.progress.follows()
            || self.owner.notifier.has_manager()
            || self.owner.monitor.is_shared()
            || self.watch_files.is_watched()
    }

    fn fill_memory(&mut self) -> Result<(), LaunchError> {
        Ok(fill_domain(&self.domain)?)
    }

    fn reap(&mut self) -> Vec<ProcessDeath> {
        self.children.reap(&self.services)
    }

    fn is_empty(&self, role: Role) -> bool {
        self.children.is_empty(role)
    }

    fn has_child(&self, role: Role) -> bool {
        self.children.child(role).is_some()
    }

    fn all_ended(&self) -> bool {
        self.children.all_ended()
    }

    fn act(&mut self, role: Role, action: ProcessAction) {
        let Some(process) = self.children.child(role) else { return };
        match action {
            ProcessAction::Kill => process.kill(),
            ProcessAction::KillGroup => process.kill_group(),
            ProcessAction::Stop => process.stop(true),
            ProcessAction::Continue => process.stop(false),
            ProcessAction::Terminate => process.terminate(),
        }
    }

    fn kill_all(&mut self) {
        self.children.kill();
    }

    fn reclaim(&mut self) -> bool {
        // What it could not reclaim may do no harm (`Some(false)`). If it does, the start fails and is tried again.
        reclaim_dead(&self.domain, RECLAIM_LIMIT).is_some()
    }

    fn set_incarnation(&mut self, role: Role, incarnation: u32) -> Result<(), String> {
        self.services.set_incarnation(role, incarnation).map_err(|error| error.to_string())
    }

    fn start_again(&mut self, role: Role) -> Result<(), String> {
        self.children.start_again(role).map_err(|error| error.to_string())
    }

    fn await_last_words(&mut self) {
        self.children.await_last_words();
    }

    fn folder_removed(&mut self, now: bool, tick: u64) -> bool {
        if now { self.folder.check_now(tick) } else { self.folder.check(monotonic_ns(), tick) }
    }

    fn folder_removed_at(&self) -> Option<u64> {
        self.folder.removed_at
    }

    fn say(&mut self, message: &str) {
        print_error_line(message);
        self.watch_files.say(message);
    }

    fn say_to_watchers(&mut self, message: &str) {
        self.watch_files.say(message);
    }

    fn show_progress(&mut self) {
        self.progress.show(&self.services);
    }

    fn clear_progress(&mut self) {
        self.progress.clear();
    }
}
