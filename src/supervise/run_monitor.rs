//! What a run shows to others in the launcher's own process: where it is, and a copy of its boards, made whenever the
//! launcher looks at them. Looking costs the run nothing.

use std::path::PathBuf;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use crate::channel::BoardsCopy;
use crate::wire::{Phase, Role};

/// A window into a run of this process; clones show the same run.
#[derive(Debug, Clone, Default)]
pub struct RunMonitor(Arc<Mutex<Monitored>>);

#[derive(Debug, Default)]
struct Monitored {
    folder: Option<PathBuf>,
    boards: BoardsCopy,
}

/// How far a run is.
#[derive(Debug, Clone, PartialEq)]
pub struct RunStatus {
    /// The run's folder; `None` until it exists.
    pub folder: Option<PathBuf>,
    /// The phase that the launcher has announced.
    pub phase: Phase,
    /// Ticks that the plant has done.
    pub ticks: u64,
    /// Ticks whose command had not arrived in time.
    pub missed: u64,
    /// Samples that the logger lost.
    pub lost: u64,
    /// How often each process was started again, by [`Role`].
    pub restarts: [u32; 3],
    /// The controller's mean loss over the window in progress.
    pub loss: f32,
}

impl RunMonitor {
    fn lock(&self) -> MutexGuard<'_, Monitored> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Whether somebody else has this window.
    pub(super) fn is_shared(&self) -> bool {
        Arc::strong_count(&self.0) > 1
    }

    /// The run's folder exists.
    pub(super) fn begin(&self, folder: PathBuf) {
        self.lock().folder = Some(folder);
    }

    pub(super) fn put(&self, boards: BoardsCopy) {
        self.lock().boards = boards;
    }

    /// How far the run is, as the launcher saw it last: in lockstep some milliseconds ago, in real time up to 0.2 s.
    pub fn status(&self) -> RunStatus {
        let monitored = self.lock();
        let BoardsCopy { control, status } = monitored.boards;
        RunStatus {
            folder: monitored.folder.clone(),
            phase: control.phase(),
            ticks: status[Role::Plant as usize].ticks,
            missed: status[Role::Plant as usize].missed,
            lost: status[Role::Logger as usize].lost,
            restarts: control.incarnations,
            loss: status[Role::Controller as usize].loss,
        }
    }
}
