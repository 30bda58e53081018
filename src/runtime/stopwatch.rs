//! The real instants of a lockstep run's ticks, which its samples do not tell: their stamps are the ticks' own time. For
//! `tectum bench`; a run that is not asked for them spends nothing on it, and either way they touch nothing that is learned.

use std::path::{Path, PathBuf};

use super::{Mode, Participant, RuntimeError};
use crate::clock::monotonic_ns;
use crate::wire::Role;

/// More ticks than anybody looks at one by one.
const MOST: u64 = 1 << 22;

/// Takes two instants a tick.
#[derive(Debug)]
pub(super) struct Stopwatch {
    tick_times: Option<Vec<[u64; 2]>>,
    path: PathBuf,
}

impl Stopwatch {
    /// The stopwatch of the process in `participant`; one that stands still unless the run asks for it.
    pub fn of(participant: &Participant) -> Self {
        let wanted = participant.manifest.stopwatch && participant.manifest.mode == Mode::Lockstep;
        let ticks = participant.plan.scenario.ticks.min(MOST) as usize;
        Self {
            tick_times: wanted.then(|| Vec::with_capacity(ticks)),
            path: path(&participant.folder, participant.role),
        }
    }

    /// The next tick begins: the plant has sensed, the controller has the observation in hand.
    #[inline]
    pub fn begin(&mut self) {
        if let Some(tick_times) = &mut self.tick_times
            && tick_times.len() < tick_times.capacity()
        {
            tick_times.push([monotonic_ns(), 0]);
        }
    }

    /// It ends: the plant has the command in hand, the controller sends it.
    #[inline]
    pub fn end(&mut self) {
        if let Some(lap) = self.tick_times.as_mut().and_then(|tick_times| tick_times.last_mut())
            && lap[1] == 0
        {
            lap[1] = monotonic_ns();
        }
    }

    /// Leaves the instants in the run's folder.
    pub fn leave(&self) -> Result<(), RuntimeError> {
        let Some(tick_times) = &self.tick_times else { return Ok(()) };
        std::fs::write(&self.path, bytemuck::cast_slice(tick_times))
            .map_err(|cause| RuntimeError::File { path: self.path.display().to_string(), cause })
    }
}

fn path(folder: &Path, role: Role) -> PathBuf {
    folder.join(format!("{}.tick_times", role.name()))
}

/// The instants that the process in `role` has left in a run's folder, tick by tick from the first: of the plant, when it
/// had sensed and when it had the command in hand; of the controller, when it had the observation in hand and when it sent
/// the command. CLOCK_MONOTONIC, ns; 0 for one that did not come. `None` where there are none.
pub fn tick_times(folder: &Path, role: Role) -> Option<Vec<[u64; 2]>> {
    let bytes = std::fs::read(path(folder, role)).ok()?;
    Some(bytes.as_chunks::<16>().0.iter().map(|lap| bytemuck::pod_read_unaligned(lap)).collect())
}
