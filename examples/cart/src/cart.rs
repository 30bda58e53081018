//! The plant: a cart on a track, pushed by a motor, that has to stand at a target.

use rand::RngExt as _;
use tectum::plant::{Outcome, Plant};
use tectum::seed::{Rng, stream};
use tectum::state::{Persist, StateVisitor};
use tectum::wire::MAX_MEASURES;

/// Ends of the track, m from its middle.
const TRACK: f32 = 1.0;
/// Targets are this far from the middle at most, m.
const REACH: f32 = 0.8;
/// Ticks from one target to the next.
const TARGET_EVERY: u64 = 60;
/// Acceleration for a command of 1, m/s^2.
const PUSH: f32 = 4.0;
/// Share of its speed that the cart loses in a second.
const FRICTION: f32 = 0.5;

/// The cart and its target.
#[derive(Debug)]
pub struct Cart {
    /// One tick, s.
    period: f32,
    position: f32,
    speed: f32,
    target: f32,
    /// Targets shown so far.
    shown: u64,
    rng: Rng,
}

impl Cart {
    /// A cart in the middle of its track, for ticks of `period` seconds and the run's `seed`.
    pub fn new(period: f32, seed: u64) -> Self {
        Self { period, position: 0.0, speed: 0.0, target: 0.0, shown: 0, rng: stream(seed, "targets") }
    }
}

/// All that the cart needs to go on where it was when its process was killed.
impl Persist for Cart {
    fn visit_state(&mut self, visitor: &mut dyn StateVisitor) {
        visitor.number("position", &mut self.position);
        visitor.number("speed", &mut self.speed);
        visitor.number("target", &mut self.target);
        visitor.number("shown", &mut self.shown);
        visitor.nested("rng", &mut self.rng);
    }
}

impl Plant for Cart {
    fn sense(&mut self, tick: u64, inputs: &mut [f32]) -> bool {
        // Ticks may jump when the machine stalls; the sequence of targets stays the same.
        let due = tick / TARGET_EVERY + 1;
        let new_target = due > self.shown;
        while self.shown < due {
            self.target = self.rng.random_range(-REACH..REACH);
            self.shown += 1;
        }
        inputs.copy_from_slice(&[self.position, self.target]);
        new_target
    }

    fn advance(&mut self, _tick: u64, applied: &[f32]) -> Outcome {
        self.speed += self.period * (PUSH * applied[0] - FRICTION * self.speed);
        self.position += self.period * self.speed;
        if self.position.abs() > TRACK {
            (self.position, self.speed) = (self.position.clamp(-TRACK, TRACK), 0.0);
        }
        let error = (self.position - self.target).abs();
        let mut measures = [0.0; MAX_MEASURES];
        measures[0] = error;
        Outcome { reward: -error * error, measures }
    }
}
