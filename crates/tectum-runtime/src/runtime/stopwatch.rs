//! The real instants of a lockstep run's ticks, for `tectum bench`. The run's samples do not have them, because
//! their stamps are virtual time.
//!
//! A run without a stopwatch spends no time on it. A stopwatch does not influence learning.

use std::path::{Path, PathBuf};

use super::{Mode, Participant, RuntimeError};
use crate::clock::monotonic_ns;
use crate::wire::Role;

/// Limit on the number of recorded ticks.
const MAX_TICKS: u64 = 1 << 22;

/// Records two instants per tick.
#[derive(Debug)]
pub(super) struct Stopwatch {
    /// `None` when the run does not want them.
    tick_times: Option<Vec<[u64; 2]>>,
    path: PathBuf,
}

impl Stopwatch {
    /// The stopwatch of a process. It records nothing unless the run's manifest asks for it.
    pub fn of(participant: &Participant) -> Self {
        let wanted = participant.manifest.stopwatch && participant.manifest.mode == Mode::Lockstep;
        let ticks = participant.plan.scenario.ticks.min(MAX_TICKS) as usize;
        Self {
            tick_times: wanted.then(|| Vec::with_capacity(ticks)),
            path: path(&participant.folder, participant.role),
        }
    }

    /// The start of the next tick: the plant has sensed, or the controller has received the observation.
    #[inline]
    pub fn begin(&mut self) {
        if let Some(tick_times) = &mut self.tick_times
            && tick_times.len() < tick_times.capacity()
        {
            tick_times.push([monotonic_ns(), 0]);
        }
    }

    /// The end of the tick: the plant has received the command, or the controller is about to send it.
    #[inline]
    pub fn end(&mut self) {
        if let Some(instants) = self.tick_times.as_mut().and_then(|tick_times| tick_times.last_mut())
            && instants[1] == 0
        {
            instants[1] = monotonic_ns();
        }
    }

    /// Writes the instants into the run's folder.
    pub fn write(&self) -> Result<(), RuntimeError> {
        let Some(tick_times) = &self.tick_times else { return Ok(()) };
        std::fs::write(&self.path, bytemuck::cast_slice(tick_times))
            .map_err(|cause| RuntimeError::File { path: self.path.display().to_string(), cause })
    }
}

/// The file of the instants of `role`.
fn path(folder: &Path, role: Role) -> PathBuf {
    folder.join(format!("{}.tick_times", role.name()))
}

/// The instants that the process in `role` has written into a run's folder, tick by tick from the first. Of the
/// plant: when it had sensed, and when it had received the command. Of the controller: when it had received the
/// observation, and when it sent the command. CLOCK_MONOTONIC, ns; 0 for an instant that is missing. `None`
/// where there is no file.
pub fn tick_times(folder: &Path, role: Role) -> Option<Vec<[u64; 2]>> {
    let bytes = std::fs::read(path(folder, role)).ok()?;
    Some(bytes.as_chunks::<16>().0.iter().map(|instants| bytemuck::pod_read_unaligned(instants)).collect())
}
