//! Runs the jobs of a study in parallel.
//!
//! One thread per core takes the next job, while the calling thread shows the progress and watches for
//! signals. A job's result depends on the job alone, never on the thread that ran it or on the time at which
//! it ran.

use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};
use std::thread;

use serde::Serialize;
use serde::de::DeserializeOwned;

use super::StudyError;
use super::study_rows::{ROWS_FILE, StudyRows};
use crate::clock::{TerminationSignals, monotonic_ns, pause};
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

    /// The signals that end the study.
    pub fn signals(&self) -> TerminationSignals {
        self.signals.clone()
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

/// A run of a study whose result is kept as a row.
#[derive(Debug, Clone)]
pub(crate) struct KeptJob<J> {
    /// Its name, unique in the study: learner or variant, and seed.
    pub name: String,
    /// Its number of ticks.
    pub ticks: u64,
    /// What to do.
    pub job: J,
}

impl WorkerPool {
    /// Like [`run`](Self::run), for jobs whose results are kept in `rows` as soon as they are done; those that are
    /// there are not run again. `work` gives no result if it had to stop.
    ///
    /// # Errors
    /// The first error of a job; [`StudyError::Interrupted`] if a signal ended the study early, and
    /// [`StudyError::Missing`] if results are missing from rows to which none can be added.
    pub fn run_kept<J: Sync, T: Serialize + DeserializeOwned + Send>(
        &self,
        name: &str,
        rows: &StudyRows,
        jobs: &[KeptJob<J>],
        work: impl Fn(&J, &JobProgress) -> Result<Option<T>, StudyError> + Sync,
    ) -> Result<Vec<T>, StudyError> {
        let mut results: Vec<Option<T>> = jobs.iter().map(|job| rows.get(&job.name)).collect::<Result<_, _>>()?;
        let open: Vec<usize> = (0..jobs.len()).filter(|&i| results[i].is_none()).collect();
        if !open.is_empty() && !rows.is_open() {
            let missing = open.iter().map(|&i| jobs[i].name.clone()).collect();
            return Err(StudyError::Missing { missing, of: jobs.len() });
        }
        let ticks = open.iter().map(|&i| jobs[i].ticks).sum();
        let one = |&i: &usize, progress: &JobProgress| {
            let KeptJob { name, job, .. } = &jobs[i];
            let began = monotonic_ns();
            let result = work(job, progress).and_then(|result| {
                let seconds = (monotonic_ns() - began) as f64 / 1e9;
                result.as_ref().map_or(Ok(()), |result| rows.put(name, seconds, result)).map(|()| result)
            });
            result.inspect_err(|_| progress.stop_all())
        };
        match self.run(name, ticks, &open, one) {
            Ok(done) => {
                for (i, result) in open.into_iter().zip(done) {
                    results[i] = result?;
                }
                Ok(results.into_iter().flatten().collect())
            }
            Err(StudyError::Signal(signal)) => Err(interrupted(rows, signal, jobs.len())),
            Err(error) => Err(error),
        }
    }
}

/// The error for a study that a signal ended.
pub(super) fn interrupted(rows: &StudyRows, signal: u32, of: usize) -> StudyError {
    if rows.count() == 0 {
        return StudyError::Signal(signal);
    }
    let path = rows.path().to_owned();
    let folder = path.parent().filter(|_| path.file_name().is_some_and(|name| name == ROWS_FILE));
    let remedy = match folder {
        Some(folder) if rows.is_open() => {
            let command = rows.head.study.split(' ').next().unwrap_or_default();
            format!("`tectum {command} --continue {}` goes on", folder.display())
        }
        _ => "the same command goes on".to_owned(),
    };
    StudyError::Interrupted { signal, done: rows.count(), of, path, remedy }
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
