//! Runs the jobs of a study in parallel.
//!
//! One thread per core takes the next job, while the calling thread shows the progress and watches for
//! signals. A job's result depends on the job alone, never on the thread that ran it or on the time at which
//! it ran.

use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};
use std::thread;

use super::StudyError;
use crate::clock::{TerminationSignals, pause};
use crate::supervise::{LaunchError, RunProgress};

/// How often the calling thread checks for signals and shows the progress, ns.
const POLL_NS: u64 = 20_000_000;

/// Runs the jobs of a study on all cores.
#[derive(Debug)]
pub(crate) struct WorkerPool {
    signals: TerminationSignals,
    progress: bool,
}

/// A job's connection to the pool: it counts the ticks done, and asks the job to stop.
#[derive(Debug)]
pub(crate) struct JobProgress<'a> {
    done: &'a AtomicU64,
    stop: &'a AtomicBool,
    signals: &'a TerminationSignals,
}

impl JobProgress<'_> {
    /// Reports that `ticks` more ticks are done. False when the job has to stop.
    pub fn report(&self, ticks: u64) -> bool {
        self.done.fetch_add(ticks, Ordering::Relaxed);
        !self.stop.load(Ordering::Relaxed)
    }

    /// Asks all jobs to stop, because this one has failed.
    pub fn stop_all(&self) {
        self.stop.store(true, Ordering::Relaxed);
    }

    /// The signals that end the study.
    pub fn signals(&self) -> TerminationSignals {
        self.signals.clone()
    }
}

impl WorkerPool {
    /// A pool that stops on SIGINT and SIGTERM. With `progress` it shows a progress line on standard error,
    /// if that is a terminal.
    ///
    /// # Errors
    /// When the signal handlers cannot be installed.
    pub fn new(progress: bool) -> Result<Self, StudyError> {
        let signals = TerminationSignals::install().map_err(LaunchError::Signals)?;
        Ok(Self { signals, progress })
    }

    /// Runs `work` for all `jobs`, which have `ticks` ticks together. Gives the results in the order of the
    /// jobs.
    ///
    /// # Errors
    /// [`StudyError::Signal`] if a signal ended the study early.
    pub fn run<J: Sync, T: Send>(
        &self,
        name: &str,
        ticks: u64,
        jobs: &[J],
        work: impl Fn(&J, &JobProgress) -> T + Sync,
    ) -> Result<Vec<T>, StudyError> {
        let (done, stop, next) = (AtomicU64::new(0), AtomicBool::new(false), AtomicUsize::new(0));
        let threads = thread::available_parallelism().map_or(1, usize::from).min(jobs.len());
        let mut progress = RunProgress::study(name, ticks, self.progress);
        let mut results: Vec<Option<T>> = jobs.iter().map(|_| None).collect();
        thread::scope(|scope| {
            let worker = || {
                let mut results = Vec::new();
                while let Some((index, job)) = {
                    let index = next.fetch_add(1, Ordering::Relaxed);
                    jobs.get(index).map(|job| (index, job))
                } {
                    let progress = JobProgress { done: &done, stop: &stop, signals: &self.signals };
                    results.push((index, work(job, &progress)));
                }
                results
            };
            let workers: Vec<_> = (0..threads).map(|_| scope.spawn(worker)).collect();
            while !workers.iter().all(thread::ScopedJoinHandle::is_finished) {
                if self.signals.received() != 0 {
                    stop.store(true, Ordering::Relaxed);
                }
                if stop.load(Ordering::Relaxed) {
                    next.store(jobs.len(), Ordering::Relaxed);
                }
                progress.show_study(done.load(Ordering::Relaxed), (f32::NAN, f32::NAN));
                pause(POLL_NS);
            }
            for worker in workers {
                match worker.join() {
                    Ok(finished) => finished.into_iter().for_each(|(index, result)| results[index] = Some(result)),
                    Err(panic) => std::panic::resume_unwind(panic),
                }
            }
        });
        progress.clear();
        match self.signals.received() {
            0 => Ok(results.into_iter().flatten().collect()),
            signal => Err(StudyError::Signal(signal)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn results_keep_the_order_of_the_jobs() {
        let jobs: Vec<u64> = (0..20).collect();
        let pool = WorkerPool::new(false).unwrap();
        let squares = pool.run("test", 20, &jobs, |&job, ticks| {
            assert!(ticks.report(1));
            job * job
        });
        assert_eq!(squares.unwrap(), jobs.iter().map(|j| j * j).collect::<Vec<_>>());
    }
}
