//! Notices a lockstep run that does not get on although all of its processes live: each waits for another, because a
//! sample was lost between them. This is pure bookkeeping: the launcher passes time and boards in.

use crate::wire::{ProcessState, Status};

/// The time over which heartbeats and progress are compared, ns.
const WINDOW_NS: u64 = 1_000_000_000;

/// What has happened in a run since the last look.
#[derive(Debug)]
pub(super) struct StallWatch {
    /// Number of windows without progress that are too many; 0: never.
    limit: u64,
    began_ns: u64,
    /// The boards at the beginning of the window.
    before: [Status; 3],
    /// Windows in a row in which all processes lived and none got on.
    stalled: u64,
}

impl StallWatch {
    /// A watch that gives a run up after `limit_s` seconds without progress; 0: never.
    pub fn new(limit_s: f64, now: u64) -> Self {
        let limit = (limit_s * 1e9 / WINDOW_NS as f64).ceil() as u64;
        Self { limit, began_ns: now, before: Default::default(), stalled: 0 }
    }

    /// Takes the boards of plant, controller and logger. True if for too long no process has got on, while each gave
    /// signs of life or had finished. A process that computes for a long time gives none meanwhile.
    pub fn stalls(&mut self, boards: [Status; 3], now: u64) -> bool {
        if now.saturating_sub(self.began_ns) < WINDOW_NS {
            return false;
        }
        let progress = |boards: &[Status; 3]| boards.map(|board| (board.pid, board.ticks, board.sent, board.consumed));
        let lives = |(board, before): (&Status, &Status)| match board.state() {
            ProcessState::Running => board.beat != before.beat,
            state => state == ProcessState::Finished,
        };
        let running = boards.iter().any(|board| board.state() == ProcessState::Running);
        let stalls =
            running && progress(&boards) == progress(&self.before) && boards.iter().zip(&self.before).all(lives);
        self.stalled = if stalls { self.stalled + 1 } else { 0 };
        (self.began_ns, self.before) = (now, boards);
        self.limit > 0 && self.stalled >= self.limit
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SECOND: u64 = WINDOW_NS;

    fn boards(state: ProcessState, beat: u64, ticks: u64) -> [Status; 3] {
        [Status { state: state as u32, beat, ticks, ..Status::default() }; 3]
    }

    #[test]
    fn a_run_that_lives_and_does_not_get_on_is_given_up() {
        let mut watch = StallWatch::new(2.5, 0);
        let running = |beat, ticks| boards(ProcessState::Running, beat, ticks);
        assert!(!watch.stalls(running(1, 7), SECOND), "the first look");
        assert!(!watch.stalls(running(2, 7), 2 * SECOND) && !watch.stalls(running(3, 7), 3 * SECOND));
        assert!(!watch.stalls(running(4, 7), 3 * SECOND + 1), "the window is not over");
        assert!(watch.stalls(running(4, 7), 4 * SECOND));
    }

    #[test]
    fn progress_and_silence_are_no_stall() {
        for (limit, what) in [(1.0, "gets on"), (1.0, "is silent"), (1.0, "closes"), (0.0, "is not watched")] {
            let mut watch = StallWatch::new(limit, 0);
            for second in 1..100 {
                let mut now = boards(ProcessState::Running, second, 7);
                match what {
                    "gets on" => now[0].ticks = second,
                    "is silent" => now[1].beat = 1,
                    "closes" => now[2].state = ProcessState::Closing as u32,
                    _ => {}
                }
                assert!(!watch.stalls(now, second * SECOND), "{what}");
            }
        }
    }
}
