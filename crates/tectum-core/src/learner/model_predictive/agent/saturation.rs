//! Commands that stay saturated and lead nowhere: at their limit, while all inputs stay near where they were. A plan
//! whose models are wrong about what lies beyond can hold there for good, as a pendulum that is held up as far as its
//! motor can, and learns nothing new. Then the commands are turned around for some ticks: what they do is new. One that
//! stands there with good reason loses little, because turns become rarer each time.

use super::super::world::wrap;
use crate::state::{Persist, StateVisitor};
use crate::{MAX_INPUTS, MAX_OUTPUTS};

/// Inputs that are no further than this from where they were, in half ranges, lead nowhere.
const NEAR: f64 = 0.25;
/// Ticks until the first turn, and at most until a later one: they double.
const FIRST_WAIT: u32 = 40;
const LONGEST_WAIT: u32 = 640;
/// Ticks for which commands are turned around.
const TURN: u32 = 10;

/// Watches for saturated commands that lead nowhere.
#[derive(Debug, Clone, PartialEq)]
pub struct SaturationWatch {
    /// The inputs when this began.
    began_at: [f64; MAX_INPUTS],
    /// The limit at which a command has been since then: its sign; 0 for other commands.
    held: [f64; MAX_OUTPUTS],
    /// Ticks since then.
    ticks: u32,
    /// Ticks until the next turn.
    wait: u32,
    /// Ticks that are left of a turn.
    turning: u32,
}

impl SaturationWatch {
    /// Nothing was seen yet.
    pub fn new() -> Self {
        Self { began_at: [0.0; MAX_INPUTS], held: [0.0; MAX_OUTPUTS], ticks: 0, wait: FIRST_WAIT, turning: 0 }
    }

    /// Watches a tick, with inputs and commands that are scaled, and turns commands around while it is time to. The
    /// inputs that come round, and those that move at all (bits), are known. Returns whether a turn begins.
    pub fn watch(&mut self, inputs: &[f64], (wraps, moving): (&[bool], u32), commands: &mut [f64]) -> bool {
        if self.turning == 0 && !self.leads_nowhere(inputs, (wraps, moving), commands) {
            self.ticks = 0;
            return false;
        }
        let begins = self.turning == 0 && self.ticks >= self.wait;
        if begins {
            self.ticks = 0;
            self.turning = TURN;
            self.wait = (2 * self.wait).min(LONGEST_WAIT);
        }
        if self.turning > 0 {
            self.turning -= 1;
            for (u, held) in commands.iter_mut().zip(&self.held).filter(|(_, held)| **held != 0.0) {
                *u = -held;
            }
        }
        begins
    }

    /// Whether some command is at the limit at which it was when this began, and all inputs are near where they were.
    /// Counts the tick; with the first, this begins.
    fn leads_nowhere(&mut self, inputs: &[f64], (wraps, moving): (&[bool], u32), commands: &[f64]) -> bool {
        if self.ticks == 0 {
            self.began_at[..inputs.len()].copy_from_slice(inputs);
        }
        let mut nowhere = false;
        for (u, held) in commands.iter().zip(&mut self.held) {
            let limit = if u.abs() >= 1.0 { u.signum() } else { 0.0 };
            *held = if self.ticks == 0 || limit == *held { limit } else { 0.0 };
            nowhere |= *held != 0.0;
        }
        for (i, (z, at)) in inputs.iter().zip(&self.began_at).enumerate().filter(|(i, _)| moving >> i & 1 == 1) {
            let apart = if wraps[i] { wrap(z - at) } else { z - at };
            nowhere &= apart.abs() <= NEAR;
        }
        self.ticks += 1;
        nowhere
    }
}

impl Persist for SaturationWatch {
    fn visit_state(&mut self, visitor: &mut dyn StateVisitor) {
        visitor.numbers("began_at", &mut self.began_at);
        visitor.numbers("held", &mut self.held);
        visitor.number("ticks", &mut self.ticks);
        visitor.number("wait", &mut self.wait);
        visitor.number("turning", &mut self.turning);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The first ticks of the turns in `ticks` ticks of these inputs and the command.
    fn turns(ticks: u32, inputs: impl Fn(u32) -> f64, command: impl Fn(u32) -> f64) -> Vec<u32> {
        let mut watch = SaturationWatch::new();
        let mut turns = Vec::new();
        for tick in 0..ticks {
            let asked = command(tick);
            let mut u = [0.5, asked];
            if watch.watch(&[inputs(tick), 0.1], (&[true, false], 1), &mut u) {
                turns.push(tick);
            }
            assert_eq!(u[0], 0.5);
            assert!(u[1] == asked || u[1] == -asked, "{u:?}");
            assert_eq!(u[1] == -asked, turns.last().is_some_and(|begun| tick < begun + TURN), "tick {tick}");
        }
        turns
    }

    #[test]
    fn commands_that_lead_nowhere_are_turned_around_ever_more_rarely() {
        let swings = |tick: u32| 0.99 + 0.1 * f64::from(tick % 3);
        assert_eq!(turns(400, swings, |_| -1.0), [39, 39 + 9 + 80, 39 + 9 + 80 + 9 + 160]);
    }

    #[test]
    fn commands_that_move_something_or_are_within_their_limits_are_left_alone() {
        assert!(turns(400, |tick| 0.01 * f64::from(tick), |_| 1.0).is_empty());
        assert!(turns(400, |_| 0.0, |_| 0.999).is_empty());
        assert!(turns(400, |_| 0.0, |tick| if tick % 30 == 0 { -1.0 } else { 1.0 }).is_empty());
    }

    #[test]
    fn inputs_that_do_not_move_do_not_count() {
        let mut watch = SaturationWatch::new();
        let begun = (0..60).filter(|tick| watch.watch(&[0.0, f64::from(*tick)], (&[true, false], 1), &mut [1.0]));
        assert_eq!(begun.collect::<Vec<_>>(), [39]);
    }
}
