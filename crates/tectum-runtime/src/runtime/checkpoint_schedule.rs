//! When a plant announces checkpoints.
//!
//! A checkpoint is announced one tick ahead, before the observation is sent: the plant takes its own at the start of
//! the tick, and the controller takes its own after its command. In lockstep both always do. In real time the plant may
//! pass over that tick, and the controller may never see the observation. A run goes on from a pair only, so such a
//! checkpoint is announced again.

use super::RuntimeError;
use crate::wire::Status;

/// How often a checkpoint is announced again. A controller of another language may write none at all.
const MOST_REPEATS: u32 = 8;

/// What a plant has announced, and what became of it.
#[derive(Debug)]
pub(super) struct CheckpointSchedule {
    /// Ticks from one checkpoint to the next; 0 for none.
    every: u64,
    /// Checkpoints that had been requested when the last one was announced.
    requested: u32,
    /// The last checkpoint that the plant has written, as it is announced: one more than its tick.
    written: u64,
    /// How often the announced one may be announced again; 0 when both processes have it.
    repeats: u32,
    real: bool,
}

impl CheckpointSchedule {
    /// A schedule with a checkpoint every `every` ticks (0: none), of a process that joins when `requested` were
    /// requested. `real`: in real time.
    pub fn new(every: u64, requested: u32, real: bool) -> Self {
        Self { every, requested, written: 0, repeats: 0, real }
    }

    /// Whether the plant takes the `announced` checkpoint at the start of `tick`.
    pub fn is_due(&mut self, announced: u64, tick: u64) -> bool {
        let due = announced == tick + 1;
        if due {
            self.written = announced;
        }
        due
    }

    /// What is announced at the start of `tick` in place of `announced`, when `requested` checkpoints were requested so
    /// far; `None` where that was not looked up. `controller` reads the controller's board, which is done only while a
    /// pair is incomplete.
    pub fn next(
        &mut self,
        announced: u64,
        tick: u64,
        requested: Option<u32>,
        controller: impl FnOnce() -> Result<Status, RuntimeError>,
    ) -> Result<Option<u64>, RuntimeError> {
        let (next, requested) = (tick + 1, requested.unwrap_or(self.requested));
        if requested != self.requested || self.every > 0 && next.is_multiple_of(self.every) {
            (self.requested, self.repeats) = (requested, if self.real { MOST_REPEATS } else { 0 });
            return Ok(Some(next + 1));
        }
        if self.repeats == 0 {
            return Ok(None);
        }
        let controller = controller()?;
        if self.written == announced && controller.checkpoint == announced {
            self.repeats = 0;
            return Ok(None);
        }
        // Announced is one more than a tick, and so is the number of ticks that the controller has done.
        let passed_over = announced <= tick && self.written != announced;
        let unseen = controller.ticks + 1 >= announced && controller.checkpoint != announced;
        Ok((passed_over || unseen).then(|| {
            self.repeats -= 1;
            next + 1
        }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What is announced in place of `announced`, when the controller's board shows these ticks and this checkpoint.
    fn next(
        schedule: &mut CheckpointSchedule,
        announced: u64,
        tick: u64,
        requested: u32,
        board: (u64, u64),
    ) -> Option<u64> {
        let (ticks, checkpoint) = board;
        let controller = || Ok(Status { ticks, checkpoint, ..Status::default() });
        schedule.next(announced, tick, Some(requested), controller).unwrap()
    }

    #[test]
    fn a_pair_is_announced_once() {
        let mut schedule = CheckpointSchedule::new(10, 0, true);
        assert_eq!(next(&mut schedule, 0, 8, 0, (8, 0)), None);
        // At the start of tick 9 the one of tick 10 is announced.
        assert_eq!(next(&mut schedule, 0, 9, 0, (9, 0)), Some(11));
        assert!(schedule.is_due(11, 10));
        // The controller answers tick 9 and takes its own. It may be slow.
        for (tick, board) in [(10, (9, 0)), (11, (9, 0)), (12, (12, 11)), (13, (13, 11))] {
            assert_eq!(next(&mut schedule, 11, tick, 0, board), None, "tick {tick}");
        }
        assert_eq!(next(&mut schedule, 11, 14, 1, (14, 11)), Some(16), "on request");
        // What nobody looked up was not requested; it is later, when somebody does.
        let mut schedule = CheckpointSchedule::new(0, 3, false);
        let mut next = |tick, requested| schedule.next(0, tick, requested, || unreachable!()).unwrap();
        assert_eq!([next(5, Some(3)), next(6, None), next(7, Some(4)), next(8, None)], [None, None, Some(9), None]);
    }

    #[test]
    fn what_one_of_the_two_has_not_taken_is_announced_again() {
        let mut schedule = CheckpointSchedule::new(0, 0, true);
        assert_eq!(next(&mut schedule, 0, 9, 1, (9, 0)), Some(11));
        // The plant passes over tick 10.
        assert!(!schedule.is_due(11, 12));
        assert_eq!(next(&mut schedule, 11, 12, 1, (10, 11)), Some(14));
        assert!(schedule.is_due(14, 13));
        // The controller has not seen observation 12, and answers that of tick 13 next.
        assert_eq!(next(&mut schedule, 14, 13, 1, (10, 11)), None);
        assert_eq!(next(&mut schedule, 14, 14, 1, (14, 11)), Some(16));
        // A controller that writes none is asked a few times.
        let mut announced = 16;
        for tick in 15..100 {
            schedule.is_due(announced, tick);
            announced = next(&mut schedule, announced, tick, 1, (tick, 0)).unwrap_or(announced);
        }
        assert!(announced < 50, "{announced}");
    }
}
