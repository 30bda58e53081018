//! A run as a library call: a thread of this process is its launcher, and the caller has a handle on it.

use std::thread::JoinHandle;

use super::service_notifier::ServiceNotifier;
use super::{Launch, LaunchError, RunMonitor, RunOwner, RunStatus, RunSummary, launch_run};
use crate::clock::TerminationSignals;

/// A run that this process has launched. Dropping the handle stops the run and waits for its end.
///
/// The launcher's thread takes no signals: what a signal does to a run is up to the program. A program that is killed
/// takes the run with it, as a killed `tectum run` does.
#[derive(Debug)]
pub struct RunHandle {
    monitor: RunMonitor,
    signals: TerminationSignals,
    /// `None` once it has been waited for.
    thread: Option<JoinHandle<Result<RunSummary, LaunchError>>>,
}

impl RunHandle {
    /// Starts a run in processes of its own. Returns at once; whether the run could start shows in
    /// [`look`](Self::look) and in the result of [`wait`](Self::wait).
    ///
    /// # Errors
    /// [`LaunchError::Thread`] when the operating system allows no further thread.
    pub fn start(launch: Launch) -> Result<Self, LaunchError> {
        let (monitor, signals) = (RunMonitor::default(), TerminationSignals::default());
        let owner =
            RunOwner { signals: signals.clone(), monitor: monitor.clone(), notifier: ServiceNotifier::default() };
        let thread = std::thread::Builder::new().name("launcher".to_owned());
        let thread = thread.spawn(move || launch_run(&launch, owner)).map_err(LaunchError::Thread)?;
        Ok(Self { monitor, signals, thread: Some(thread) })
    }

    /// How far the run is. Costs the run nothing.
    pub fn look(&self) -> RunStatus {
        self.monitor.status()
    }

    /// Asks plant and controller for a checkpoint, as SIGUSR1 asks `tectum run`.
    pub fn checkpoint(&self) {
        self.signals.ask_checkpoint();
    }

    /// Asks the run to end in good order, as SIGTERM asks `tectum run`; within a second it has. Its summary says
    /// [`RunOutcome::Signal`](super::RunOutcome::Signal), unless it had come to its end before.
    pub fn stop(&self) {
        self.signals.ask_stop();
    }

    /// Whether the run is over.
    pub fn is_over(&self) -> bool {
        self.thread.as_ref().is_none_or(JoinHandle::is_finished)
    }

    /// Waits for the end of the run, and gives its summary.
    ///
    /// # Errors
    /// When the run could not start, as [`run`](super::run()).
    pub fn wait(mut self) -> Result<RunSummary, LaunchError> {
        self.join().unwrap_or(Err(LaunchError::LauncherPanicked))
    }

    fn join(&mut self) -> Option<Result<RunSummary, LaunchError>> {
        self.thread.take()?.join().ok()
    }
}

impl Drop for RunHandle {
    fn drop(&mut self) {
        self.stop();
        drop(self.join());
    }
}
