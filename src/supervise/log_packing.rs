//! Packs a run's log when the run is over: compressed chunks with an index, which viewers want.
//!
//! While the run goes on, each message is a record by itself, so that no death loses one. When all have ended in good
//! order nothing can be lost any more, and the packed log takes the other one's place at once or not at all.

use std::path::Path;

use super::summary::total_bytes;
use super::{RunOutcome, RunSummary};
use crate::log::{self, LogError, PackExtras};
use crate::runtime::{RunWarning, exit};
use crate::scenario::LogConfig;

/// Size of a log that is packed without being asked for, bytes. Packing it takes some tenths of a second.
const PACKED_UNASKED: u64 = 8_000_000;

/// Whether the log of a run that ended so, with `bytes` in all its segments, is to be packed. After a failure it stays
/// as it was written; after a signal somebody waits for the end.
pub(super) fn is_wanted(config: &LogConfig, ended: RunOutcome, bytes: u64) -> bool {
    let small = bytes <= PACKED_UNASKED;
    match ended {
        RunOutcome::Complete => config.pack.unwrap_or(small),
        RunOutcome::Signal(_) => config.pack != Some(false) && small,
        RunOutcome::Failed => false,
    }
}

impl RunSummary {
    /// Packs the log in `folder`. Where that fails, the log is there as it was: nothing is lost, but a scenario may
    /// have asked for it.
    pub(super) fn pack_log(&mut self, config: &LogConfig, folder: &Path) {
        if let Err(error) = pack_segments(folder, config.views) {
            let message = format!("the log was not packed, and is whole as it was written: {error}");
            if config.pack == Some(true) {
                self.complain(exit::INPUT, message);
            } else {
                self.warnings.push(RunWarning::of_log(&message));
            }
        }
        let after = total_bytes(&log::segments(folder));
        self.log_unpacked_bytes = (self.log_bytes != after).then_some(self.log_bytes);
        self.log_bytes = after;
    }
}

/// Packs all segments in `folder` that are whole; a logger that was killed has left a torn one, which stays as it is.
///
/// # Errors
/// The first error. The segments before it are packed, and all others are as they were.
fn pack_segments(folder: &Path, views: bool) -> Result<(), LogError> {
    for segment in log::segments(folder) {
        match log::pack(&segment, None, if views { PackExtras::Views } else { PackExtras::Index }) {
            Ok(_) | Err(LogError::Torn { .. }) => {}
            Err(error) => return Err(error),
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn small_logs_are_packed_unasked_and_those_of_failed_runs_never() {
        use RunOutcome::{Complete, Failed, Signal};
        let (small, large) = (PACKED_UNASKED, PACKED_UNASKED + 1);
        for (pack, ended, bytes, wanted) in [
            (None, Complete, small, true),
            (None, Complete, large, false),
            (None, Signal(2), small, true),
            (None, Failed, small, false),
            (Some(true), Complete, large, true),
            (Some(true), Signal(2), large, false),
            (Some(true), Failed, small, false),
            (Some(false), Complete, small, false),
            (Some(false), Signal(15), small, false),
        ] {
            let config = LogConfig { pack, ..LogConfig::default() };
            assert_eq!(is_wanted(&config, ended, bytes), wanted, "{pack:?} {ended:?} {bytes}");
        }
    }
}
