//! Follows runs: the one that was named, or the newest that is alive, and when that is over, the next.

use std::path::{Path, PathBuf};

use tectum_view::RunView;

use super::WatchError;
use super::living::LivingRun;
use super::run_watcher::RunWatcher;
use crate::clock::go_behind_others;
use crate::log::{LogRecord, ViewFacts};
use crate::wire::ChannelNames;

/// How often it looks for a run, s.
const SEARCH_EVERY_S: f64 = 0.2;

/// Which run to watch.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum WatchTarget {
    /// The newest run that is alive.
    Newest,
    /// A run by its folder, or its name under `runs/`.
    Named(PathBuf),
    /// The run that a process launches.
    LaunchedBy(u32),
}

/// Follows runs. Whoever owns it calls [`look`](Self::look) some times a second.
pub struct Follower {
    target: WatchTarget,
    /// The run that is watched, or was watched last.
    watched: Option<Watched>,
    /// Why there is no run yet.
    waits_for: String,
    next_search: f64,
    /// Counts the runs that were found.
    generation: u64,
    /// Whether samples are kept for [`take_samples`](Self::take_samples), and those that are.
    keeps_samples: bool,
    samples: Vec<LogRecord>,
}

/// A run that is alive, with all that is mapped for it, or what is left of one that is over.
enum Watched {
    Alive(Box<RunWatcher>),
    Over { view: Box<RunView>, run: u64 },
}

impl Follower {
    /// Finds the run. With `wait`, a run that is not there yet may begin later. From now on the calling thread leaves
    /// the processors to others, above all to the run.
    ///
    /// # Errors
    /// [`WatchError`] if there is no such run, or it is over.
    pub fn open(target: WatchTarget, wait: bool) -> Result<Self, WatchError> {
        go_behind_others();
        let (waits_for, samples) = (String::new(), Vec::new());
        let mut follower =
            Self { target, watched: None, waits_for, next_search: 0.0, generation: 0, keeps_samples: false, samples };
        match follower.find() {
            Ok(run) => follower.begin(run)?,
            Err(WatchError::NoRun { .. } | WatchError::NoneLiving) if wait => {
                follower.waits_for = follower.what_it_waits_for();
            }
            Err(error) => return Err(error),
        }
        Ok(follower)
    }

    fn find(&self) -> Result<LivingRun, WatchError> {
        match &self.target {
            WatchTarget::Newest => LivingRun::newest().ok_or(WatchError::NoneLiving),
            WatchTarget::Named(run) => LivingRun::named(run),
            WatchTarget::LaunchedBy(pid) => LivingRun::launched_by(*pid).ok_or(WatchError::NoneLiving),
        }
    }

    fn begin(&mut self, run: LivingRun) -> Result<(), WatchError> {
        self.watched = Some(Watched::Alive(Box::new(RunWatcher::new(run)?)));
        self.generation += 1;
        Ok(())
    }

    fn what_it_waits_for(&self) -> String {
        match &self.target {
            WatchTarget::Named(run) => format!("Waiting for the run {}.", Path::new(run).display()),
            WatchTarget::Newest => "Waiting for a run.".to_owned(),
            WatchTarget::LaunchedBy(_) => "The run is being set up.".to_owned(),
        }
    }

    /// Takes what has come since the last look, or looks for a run. `now` is the watcher's own time, s.
    pub fn look(&mut self, now: f64) {
        if let Some(Watched::Alive(watcher)) = &mut self.watched {
            let samples = self.keeps_samples.then_some(&mut self.samples);
            if !watcher.look(now, samples) {
                // What is mapped is unmapped at once, so that nobody takes this process for one of the run.
                let (view, run) = (Box::new(std::mem::take(&mut watcher.view)), watcher.id());
                self.watched = Some(Watched::Over { view, run });
            }
        } else if now >= self.next_search {
            self.next_search = now + SEARCH_EVERY_S;
            let known = match &self.watched {
                Some(Watched::Over { run, .. }) => *run,
                _ => 0,
            };
            if let Ok(run) = self.find()
                && run.manifest.run_id() != known
                && let Err(error) = self.begin(run)
            {
                self.waits_for = error.to_string();
            }
        }
    }

    /// What is known of the run that is watched, or was watched last.
    pub fn view(&self) -> Option<&RunView> {
        match &self.watched {
            Some(Watched::Alive(watcher)) => Some(&watcher.view),
            Some(Watched::Over { view, .. }) => Some(view),
            None => None,
        }
    }

    /// Keeps the samples of each look from now on, for those who need them as they are.
    pub fn keep_samples(&mut self) {
        self.keeps_samples = true;
    }

    /// The samples that were kept since the last call, in the order of their ticks.
    pub fn take_samples(&mut self) -> Vec<LogRecord> {
        self.samples.sort_by_key(|sample| (sample.header().map_or(0, |header| header.tick), sample.channel()));
        std::mem::take(&mut self.samples)
    }

    /// What views of the run's samples are made of, and the names of its channels. `None` if no run is alive.
    pub fn view_facts(&self) -> Option<(ViewFacts, ChannelNames)> {
        match &self.watched {
            Some(Watched::Alive(watcher)) => Some(watcher.view_facts()),
            _ => None,
        }
    }

    /// Why there is nothing to see yet.
    pub fn waits_for(&self) -> &str {
        &self.waits_for
    }

    /// Counts the runs that were found: another number is another run.
    pub fn generation(&self) -> u64 {
        self.generation
    }

    /// Whether a run was found and is over.
    pub fn is_over(&self) -> bool {
        matches!(self.watched, Some(Watched::Over { .. }))
    }
}
