//! Work side by side: one thread a core, each taking the next job, while the calling thread shows how it goes and looks
//! for signals. What a job gives depends on the job alone, never on which thread took it or when.

use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};
use std::thread;

use crate::clock::{TerminationSignals, pause};
use crate::supervise::RunProgress;

/// How often the calling thread looks up, ns.
const LOOK_NS: u64 = 20_000_000;

/// Does the jobs of a study.
#[derive(Debug)]
pub struct ChildProcesses {
    signals: TerminationSignals,
    progress: bool,
}

/// What a job sees of its surroundings: it reports ticks, and hears when to stop.
#[derive(Debug)]
pub struct JobProgress<'a> {
    done: &'a AtomicU64,
    stop: &'a AtomicBool,
}

impl JobProgress<'_> {
    /// Reports `ticks` more ticks done. False when the study is to end.
    pub fn report(&self, ticks: u64) -> bool {
        self.done.fetch_add(ticks, Ordering::Relaxed);
        !self.stop.load(Ordering::Relaxed)
    }
}

impl ChildProcesses {
    /// A crew that ends on SIGINT and SIGTERM, and shows a line on standard error if `progress` and that is a terminal.
    ///
    /// # Errors
    /// When signals cannot be handled.
    pub fn new(progress: bool) -> std::io::Result<Self> {
        Ok(Self { signals: TerminationSignals::install()?, progress })
    }

    /// Does `work` for all `jobs`, `ticks` in all, and gives what came of them in their order; `Err` with the number of the
    /// signal that ended it early.
    ///
    /// # Errors
    /// The number of the signal.
    pub fn work<J: Sync, T: Send>(
        &self,
        name: &str,
        ticks: u64,
        jobs: &[J],
        work: impl Fn(&J, &JobProgress) -> T + Sync,
    ) -> Result<Vec<T>, u32> {
        let (done, stop, next) = (AtomicU64::new(0), AtomicBool::new(false), AtomicUsize::new(0));
        let threads = thread::available_parallelism().map_or(1, usize::from).min(jobs.len());
        let mut progress = RunProgress::study(name, ticks, self.progress);
        let mut results: Vec<Option<T>> = jobs.iter().map(|_| None).collect();
        thread::scope(|scope| {
            let busy = || {
                let mut mine = Vec::new();
                while let Some((at, job)) = {
                    let at = next.fetch_add(1, Ordering::Relaxed);
                    jobs.get(at).map(|job| (at, job))
                } {
                    mine.push((at, work(job, &JobProgress { done: &done, stop: &stop })));
                }
                mine
            };
            let pool: Vec<_> = (0..threads).map(|_| scope.spawn(busy)).collect();
            while !pool.iter().all(thread::ScopedJoinHandle::is_finished) {
                if self.signals.received() != 0 {
                    stop.store(true, Ordering::Relaxed);
                    next.store(jobs.len(), Ordering::Relaxed);
                }
                progress.show_study(done.load(Ordering::Relaxed), (f32::NAN, f32::NAN));
                pause(LOOK_NS);
            }
            for member in pool {
                match member.join() {
                    Ok(mine) => mine.into_iter().for_each(|(at, result)| results[at] = Some(result)),
                    Err(panic) => std::panic::resume_unwind(panic),
                }
            }
        });
        progress.clear();
        match self.signals.received() {
            0 => Ok(results.into_iter().flatten().collect()),
            signal => Err(signal),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn results_stand_in_the_order_of_the_jobs() {
        let jobs: Vec<u64> = (0..20).collect();
        let pool = ChildProcesses::new(false).unwrap();
        let squares = pool.work("test", 20, &jobs, |&job, ticks| {
            assert!(ticks.report(1));
            job * job
        });
        assert_eq!(squares.unwrap(), jobs.iter().map(|j| j * j).collect::<Vec<_>>());
    }
}
